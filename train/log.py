"""Training logs: LOGS/PART.csv, for people and spreadsheets."""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import TextIO

from command.errors import AssetError
from files.whole import whole_file


class TrainingLog:
    """One row every few steps: the step, seconds of training, learning rate, and every number of its report."""

    def __init__(self, folder: Path, part: str):
        self.path = folder / f"{part}.csv"
        self.columns: list[str] | None = None
        self.file: TextIO | None = None

    def begin(self, last_step: int) -> None:
        """Open the log, anew or, after `last_step` > 0, to go on.

        Rows beyond that step are dropped, since the steps after a checkpoint are taken again.
        """
        rows = _rows_until(self.path, last_step) if last_step and self.path.exists() else []
        self.columns = rows[0] if rows else None
        self.path.parent.mkdir(exist_ok=True)
        with whole_file(self.path, "w") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)
        # a row is one write in append mode: readers and a kill never see half of one
        self.file = self.path.open("a", buffering=1, encoding="utf-8", newline="")

    def row(self, step: int, seconds: float, rate: float, numbers: Mapping[str, float]) -> None:
        """Add a row. `rate` is the learning rate against its first value."""
        assert self.file is not None, "begin() comes first"
        lines = csv.writer(self.file, lineterminator="\n")
        facts = {"step": step, "seconds": f"{seconds:.3f}", "rate": f"{rate:.6g}"}
        facts |= {name: f"{value:.6g}" for name, value in numbers.items()}
        if self.columns is None:
            self.columns = list(facts)
            lines.writerow(self.columns)
        if list(facts) != self.columns:
            raise AssetError(f"{self.path}: columns should be {list(facts)}, are {self.columns}")
        lines.writerow(facts.values())

    def close(self) -> None:
        """After the last row; a log that was never begun has nothing to close."""
        if self.file is not None:
            self.file.close()
            self.file = None


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
