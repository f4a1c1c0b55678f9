"""Training logs: CSV that survives resuming."""

import csv

import pytest

from command.errors import AssetError
from train.log import TrainingLog


def read(path):
    with open(path, newline="") as file:
        return list(csv.reader(file))


def log_steps(folder, begin, steps):
    log = TrainingLog(folder, "head")
    log.begin(begin)
    for step in steps:
        log.row(step, step / 8, 0.5, {"loss": 1.0 / step, "psnr": 20.0 + step})
    log.close()


def test_a_resumed_log_has_every_step_once(tmp_path):
    """Ten rows, a checkpoint after step 50, and a kill that left rows beyond it and half a row."""
    log_steps(tmp_path / "whole", 0, range(10, 110, 10))
    log_steps(tmp_path / "halves", 0, range(10, 80, 10))
    path = tmp_path / "halves" / "head.csv"
    path.write_text(path.read_text() + "80,9.9")
    log_steps(tmp_path / "halves", 50, range(60, 110, 10))
    assert path.read_text() == (tmp_path / "whole" / "head.csv").read_text()
    assert read(path)[:2] == [["step", "seconds", "rate", "loss", "psnr"], ["10", "1.250", "0.5", "0.1", "30"]]


def test_a_log_begun_anew_holds_nothing_of_the_old_one(tmp_path):
    log_steps(tmp_path, 0, [10, 20])
    log_steps(tmp_path, 0, [10])
    assert [row[0] for row in read(tmp_path / "head.csv")] == ["step", "10"]


def test_rows_are_on_the_disk_when_written(tmp_path):
    log = TrainingLog(tmp_path, "head")
    log.begin(0)
    log.row(10, 1.0, 1.0, {"loss": float("nan")})
    assert read(tmp_path / "head.csv")[1] == ["10", "1.000", "1", "nan"]
    log.close()


def test_a_log_with_other_columns_is_refused(tmp_path):
    log_steps(tmp_path, 0, [10])
    log = TrainingLog(tmp_path, "head")
    log.begin(10)
    with pytest.raises(AssetError, match=r"head\.csv: columns should be"):
        log.row(20, 1.0, 1.0, {"loss": 1.0})
    log.close()
