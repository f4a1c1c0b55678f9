"""Two processes of torchrun train as one does."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from train.distributed import ONE_PROCESS, Ranks

TESTS = Path(__file__).parents[1]
# seconds after which a process is no longer slow, on a machine however busy
HANGS = 900


def run(command: list[str], **environment: str) -> None:
    env = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": f"{TESTS.parent}{os.pathsep}{TESTS}", **environment}
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=HANGS)
    assert done.returncode == 0, done.stdout + done.stderr


TORCHRUN = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]


@pytest.mark.slow
def test_two_processes_equal_one_after_a_dozen_steps(tmp_path):
    """In float64, on a ball, up to the order of summation.

    One process sums the gradients of 63 rays, two sum 32 and 31 and then the two sums: each element differs by at
    most 63 eps sum|terms|, eps = 1.1e-16. Adam divides by the element's own size, so where the terms cancel to
    1/c of their sum, a step differs by 63 eps c rate = 3e-17 c, with rate = 4e-3. For c up to a thousand, and
    twelve steps that act on each other, that stays below 1e-12 (measured 6e-16, of weights that moved by 1e-2).
    """
    script = str(TESTS / "ranks_training.py")
    run([sys.executable, script, str(tmp_path / "one.pt")])
    run([*TORCHRUN, script, str(tmp_path / "two.pt")])
    one, two = (torch.load(tmp_path / name, weights_only=True) for name in ("one.pt", "two.pt"))
    assert two["count"] == 2 and one["count"] == 1
    moved = 0.0
    for name, value in one["after"].items():
        torch.testing.assert_close(two["after"][name], value, rtol=0, atol=1e-12, msg=name)
        moved = max(moved, float((value - one["before"][name]).abs().max()))
    assert moved > 0.01  # it did learn
    assert two["loss"] == pytest.approx(one["loss"], abs=1e-12)  # the report is of the whole batch


@pytest.mark.slow
def test_torchrun_trains_from_the_command_line_like_one_process(tiny_capture, tmp_path):
    """float32, where Adam's first steps turn rounding of vanishing gradients into whole steps: the loss, not bits."""
    driver = str(TESTS / "hands_training.py")
    run([sys.executable, driver, str(tiny_capture), "-o", str(tmp_path / "one")], SELFSCAN_TEST_STEPS="12")
    run([*TORCHRUN, driver, str(tiny_capture), "-o", str(tmp_path / "two")], SELFSCAN_TEST_STEPS="12")
    for name in ("hand_left", "hand_right"):
        logs = [(tmp_path / run / f"logs/{name}.csv").read_text().splitlines() for run in ("one", "two")]
        assert len(logs[1]) == 3  # header, step 10, step 12: one rank wrote
        for first, second in zip(*(log[1:] for log in logs), strict=True):
            one, two = ([float(value) for value in row.split(",")] for row in (first, second))
            assert two[0] == one[0] and two[3] == pytest.approx(one[3], rel=2e-3)


def test_the_shares_of_a_batch_are_the_batch():
    batch = torch.arange(7)
    shares = [Ranks(rank, 3).share(batch) for rank in range(3)]
    assert torch.equal(torch.cat(shares).sort().values, batch)
    assert [Ranks(rank, 3).weight(7) for rank in range(3)] == [len(share) / 7 for share in shares]
    assert ONE_PROCESS.weight(7) == 1.0
