"""A training shortened to some of its preset's steps, as a command and in words; scores that are not made again."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from train.preset import PRESETS, shortened


def training_words(capture: Path, run: Path, preset: str, steps: int | None) -> list[str | Path]:
    """The command that trains a capture with `steps` steps of every part; None: the preset's own."""
    words: list[str | Path] = ["selfscan", "train", capture, "-o", run, "--preset", preset]
    return words + (["--iterations", str(steps)] if steps else [])


def begun(run: Path) -> bool:
    """Whether an interrupted training of this run can be gone on with."""
    return run.with_name(run.name + ".partial").exists()


def share_in_words(preset: str, steps: int | None) -> str:
    """What part of a preset's steps is taken."""
    whole = PRESETS[preset]
    if steps is None:
        return f"all steps of preset {preset}"
    share = total_steps(preset, steps) / total_steps(preset, None)
    return f"{steps} steps a part, {share:.0%} of those of preset {whole.name}"


def total_steps(preset: str, steps: int | None) -> int:
    """Of all parts together."""
    whole = PRESETS[preset]
    return sum(part.iterations for part in (whole if steps is None else shortened(whole, steps)).parts)


def read_kept(path: Path, expected: dict[str, Any]) -> dict[str, Any] | None:
    """The JSON object of a file whose entries are as expected; None where it has to be made."""
    try:
        found = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return None
    fits = isinstance(found, dict) and all(found.get(name) == value for name, value in expected.items())
    return found if fits else None


def three(values: Mapping[str, float | None], digits: int = 1) -> str:
    """A value of the whole person, head and hands, as "total / head / hands"."""
    # + 0.0: a difference that rounds to nothing is no "-0.0"
    shown = [values.get(region) for region in ("total", "head", "hands")]
    return " / ".join("-" if value is None else f"{round(value, digits) + 0.0:.{digits}f}" for value in shown)
