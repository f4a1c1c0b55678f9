"""Training logs: LOGS/PART.csv for people and spreadsheets, events beside it for TensorBoard."""

import csv
import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxtyping import UInt8
from numpy import ndarray as Array

from command.errors import AssetError
from files.whole import whole_file


class TrainingLog:
    """One row every few steps: the step, seconds of training, learning rate, and every number of its report."""

    def __init__(self, folder: Path, part: str):
        self.path, self.folder, self.part = folder / f"{part}.csv", folder, part
        self.columns: list[str] | None = None
        self.file: int | None = None
        self.events: Any = None

    def begin(self, last_step: int) -> None:
        """Open the log, anew or, after `last_step` > 0, to go on.

        Rows beyond that step are dropped, since the steps after a checkpoint are taken again. TensorBoard drops
        its own by the same rule (`purge_step`).
        """
        rows = _rows_until(self.path, last_step) if last_step and self.path.exists() else []
        self.columns = rows[0] if rows else None
        self.folder.mkdir(exist_ok=True)
        with whole_file(self.path, "w") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)
        # a row is one write in append mode: readers and a kill never see half of one
        self.file = os.open(self.path, os.O_WRONLY | os.O_APPEND)
        self.events = _event_writer(self.folder / "events" / self.part, last_step)

    def row(self, step: int, seconds: float, rate: float, numbers: Mapping[str, float]) -> None:
        """Add a row. `rate` is the learning rate against its first value."""
        facts = {"step": step, "seconds": f"{seconds:.3f}", "rate": f"{rate:.6g}"}
        facts |= {name: f"{value:.6g}" for name, value in numbers.items()}
        if self.columns is None:
            self.columns = list(facts)
            self._write(self.columns)
        if list(facts) != self.columns:
            raise AssetError(f"{self.path}: columns should be {list(facts)}, are {self.columns}")
        self._write([str(value) for value in facts.values()])
        if self.events is not None:
            for name, value in {"rate": rate, **numbers}.items():
                self.events.add_scalar(name, value, step)

    def image(self, step: int, image: UInt8[Array, "height width 3"]) -> None:
        """Add a preview to the events, where TensorBoard shows how it changed."""
        if self.events is not None:
            self.events.add_image("preview", image, step, dataformats="HWC")

    def close(self) -> None:
        """After the last row; a log that was never begun has nothing to close."""
        if self.file is not None:
            os.close(self.file)
            self.file = None
        if self.events is not None:
            self.events.close()

    def _write(self, values: list[str]) -> None:
        assert self.file is not None, "begin() comes first"
        line = io.StringIO()
        csv.writer(line, lineterminator="\n").writerow(values)
        os.write(self.file, line.getvalue().encode())


def _rows_until(path: Path, last_step: int) -> list[list[str]]:
    """Header and rows up to `last_step`; a last line cut short by a power loss is left out."""
    try:
        with open(path, newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except (OSError, ValueError, csv.Error) as error:
        raise AssetError(f"{path}: expected a log of this training, found: {error}") from None
    if not rows or rows[0][:1] != ["step"]:
        return []
    whole = [row for row in rows[1:] if len(row) == len(rows[0]) and row[0].isdigit()]
    return [rows[0]] + [row for row in whole if int(row[0]) <= last_step]


def _event_writer(folder: Path, last_step: int) -> Any:
    """TensorBoard's writer, or None without the package."""
    if not tensorboard_installed():
        return None
    from torch.utils.tensorboard import SummaryWriter

    return SummaryWriter(str(folder), purge_step=last_step + 1 if last_step else None, flush_secs=20)


def tensorboard_installed() -> bool:
    """Whether events can be written; CSV needs nothing."""
    try:
        import torch.utils.tensorboard  # noqa: F401
    except ImportError:
        return False
    return True
