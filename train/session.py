"""What lies at the place of a run already: nothing, a finished run, or an interrupted training to go on with."""

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from capture.folder import capture_files
from command.errors import AssetError
from files.input_file import read_json_object
from files.whole import check_folder, write_json

FILE = "session.json"


@dataclass(frozen=True)
class Session:
    # the run folder, absent until it is complete
    out: Path
    # checkpoints and logs until then
    partial: Path
    resumed: bool


def capture_digest(path: Path) -> str:
    """SHA-256 of what training reads of a capture: the same capture may lie in another folder."""
    digest = hashlib.sha256()
    for file in capture_files(path):
        digest.update(f"{file.relative_to(path).as_posix()} {file.stat().st_size}\n".encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def capture_place(capture: Path, run: Path) -> dict[str, str]:
    """What run.json says of where its capture lies: its folder, seen from the run folder, and its digest."""
    try:
        folder = Path(os.path.relpath(capture.resolve(), run.resolve()))
    except ValueError:  # another drive
        folder = capture.resolve()
    return {"folder": folder.as_posix(), "digest": capture_digest(capture)}


def digest_of(facts: dict[str, Any]) -> str:
    """Tells one preset's numbers from another's."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:12]


def open_session(
    out: Path, settings: dict[str, Any], *, resume: bool, force: bool, say: Callable[[str], None]
) -> Session | None:
    """The session of `settings` (what decides the result, JSON); None where `resume` finds the run finished.

    Hours of work are never thrown away unasked: without `resume` or `force`, a finished run and an interrupted
    training with checkpoints are refused.

    Raises:
        AssetError: one of these, or what is there was begun with other settings.
    """
    partial = out.with_name(out.name + ".partial")
    settings = json.loads(json.dumps(settings))
    if force:
        shutil.rmtree(partial, ignore_errors=True)
    interrupted = any(partial.rglob("*.ckpt"))
    finished = (out / "run.json").exists()
    if resume and interrupted:
        before = read_json_object(partial / FILE, "the settings of an interrupted training")
        other = [key for key in sorted({*before, *settings}) if before.get(key) != settings.get(key)]
        if other:
            raise AssetError(
                f"{partial}: was begun with {_listed(before, other)}, not with {_listed(settings, other)}; "
                "--resume needs the same, --force begins anew"
            )
        check_folder(out)
        return Session(out, partial, True)
    if resume and finished:
        say(f"{out} is finished already; nothing to resume (--force trains it anew)")
        return None
    if interrupted:
        raise AssetError(f"{partial}: an interrupted training lies here; --resume goes on, --force begins anew")
    if finished and not force:
        raise AssetError(
            f"{out}: a finished run lies here; --force replaces it once the new one is complete, or choose another -o"
        )
    check_folder(out)
    if resume:
        say(f"{partial} holds no checkpoint: nothing to resume, training begins")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    write_json(partial / FILE, settings)
    return Session(out, partial, False)


def _listed(settings: dict[str, Any], keys: list[str]) -> str:
    return ", ".join(f"{key} {settings.get(key)}" for key in keys)
