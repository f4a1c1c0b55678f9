"""Errors planted by hand, one at a time, in a copy of the tree: the tests named beside each must fail.

    python -m experiments.mutants [WORD ...]      only those whose file or new text holds a word

A planted error that lives is a hole in the tests: it gets a test, or leaves this table with the reason why it is none.
Tests that `make test` runs are named as narrowly as they still fail. Exit code 1: one lived, or its old text is gone.
"""

import os
import shutil
import signal
import sys
import tempfile
import traceback
from pathlib import Path
from typing import NamedTuple, NoReturn

ROOT = Path(__file__).parents[1]
FOLDERS = ("files command avatar geometry capture train player bake shaders synth bench selfscan "
           "experiments tests").split()  # fmt: skip
HARD = "tests/hard_cases/test_"
# seconds that tests of an error may take: a loop may have lost its end
LIMIT = 300


class Planted(NamedTuple):
    """An error: the old text stands in the file once."""

    file: str
    old: str
    new: str
    # what pytest is given, blank between
    tests: str


PLANTED = (
    # series, hemispheres, epsilons of rotations
    Planted("avatar/rotation.py", "near_zero, 1 - t2 / 6 +", "near_zero, 1 + t2 / 6 +", HARD + "rotations.py"),
    Planted("avatar/rotation.py", "q = np.where(q[..., 3:] < 0, -q, q)\n    s =", "s =", HARD + "rotations.py"),
    Planted("avatar/rotation.py", "b = np.where(np.sum(a * b, -1, keepdims=True) < 0, -b, b)", "pass",
            HARD + "rotations.py"),
    Planted("avatar/rotation.py", "small = angle < 1e-7", "small = angle < 0", HARD + "rotations.py"),
    Planted("avatar/rotation.py", "q = q / largest", "pass", HARD + "rotations.py"),
    Planted("avatar/rotation.py", "u[..., 2] *= np.linalg.det(u @ vt)[..., None]", "pass",
            "tests/avatar/test_rotation.py"),
    Planted("avatar/rotation.py", "usable = sine > 1e-12", "usable = sine > -1", "tests/avatar/test_rotation.py"),
    Planted("avatar/rotation.py", "+ np.cross(av, bv)", "+ np.cross(bv, av)", "tests/avatar/test_rotation.py"),
    Planted("experiments/builtin_motions.py", "turns = np.round(", "turns = 0 * np.round(", HARD + "rotations.py"),
    # skinning and its inverse
    Planted("avatar/skinning.py", "bones[skin.heaviest]) >= 0", "bones[skin.heaviest]) >= -2", HARD + "skinning.py"),
    Planted("avatar/skinning.py", "weights = weights / weights.sum(1, keepdims=True)", "pass", HARD + "skinning.py"),
    Planted("avatar/skinning.py", "np.abs(np.linalg.det(A)) > SINGULAR", "np.abs(np.linalg.det(A)) > -1",
            HARD + "skinning.py"),
    Planted("avatar/skeleton.py", '"pinky", "ring", "thumb")', '"ring", "pinky", "thumb")',
            "tests/player/live/test_vmc.py tests/avatar/motion/test_bvh.py tests/avatar/test_limits.py"),
    # kinematics and cameras: signs in Jacobians
    Planted("avatar/kinematics.py", "np.eye(3) - a[..., None, None] * K", "np.eye(3) + a[..., None, None] * K",
            "tests/avatar/test_rotation.py"),
    Planted("avatar/kinematics.py", "-(fx * x + skew * y) / z**2", "(fx * x + skew * y) / z**2",
            "tests/capture/fit/test_close_ups.py"),
    Planted("avatar/kinematics.py", "z = np.maximum(z, NEAREST)", "pass", "tests/avatar/test_camera.py"),
    Planted("avatar/camera.py", "1 - 2 * cx / width", "2 * cx / width - 1", "tests/avatar/test_camera.py"),
    # registration and least squares
    Planted("avatar/similarity.py", "-1.0 if mirrored else 1.0", "1.0", HARD + "registration.py"),
    Planted("geometry/icp.py", "w = 1 / np.maximum(np.abs(r) / max(residual, 1e-9), 1.0)", "w = np.ones(len(r))",
            HARD + "registration.py"),
    Planted("geometry/least_squares.py", "S[i] -= W[-1].T @ W[-1]", "S[i] += W[-1].T @ W[-1]",
            "tests/geometry/test_icp.py"),
    Planted("geometry/least_squares.py", "if not other_cost <= cost:", "if other_cost < 0:",
            "tests/geometry/test_icp.py"),
    # volume rendering and losses: clamps, epsilons, branches not taken
    Planted("train/render.py", "log_phi[:, :-1]).clamp_max(0)", "log_phi[:, :-1])", HARD + "volume_rendering.py"),
    Planted("train/render.py", "scaled.clamp(-1e6, 1e6)", "scaled", HARD + "volume_rendering.py"),
    Planted("train/render.py", "(-torch.where(above, distance, 0.0) / beta)", "(-distance / beta)",
            HARD + "volume_rendering.py"),
    Planted("train/render.py", "F.pad(log_t[:, :-1], (1, 0))", "log_t", HARD + "volume_rendering.py"),
    Planted("train/loss.py", "((gradient.square().sum(-1) + 1e-12).sqrt() - 1)",
            "(gradient.square().sum(-1).sqrt() - 1)", HARD + "volume_rendering.py"),
    Planted("train/loss.py", "hit = -log_transmittance.clamp_min(-20)", "hit = -log_transmittance",
            HARD + "volume_rendering.py"),
    # limbs, live senders, springs
    Planted("player/pose/ik.py", "d = np.clip(_length(span), np.abs(a - b), a + b)", "d = _length(span)",
            "tests/player/test_ik.py"),
    Planted("player/live/osc.py", "if depth == DEEPEST:", "if depth == 100 * DEEPEST:",
            "tests/player/live/test_vmc.py"),
    Planted("player/live/osc.py", "if size > end - at - 4:", "if size > end - at:", "tests/player/live/test_vmc.py"),
    Planted("player/live/one_euro.py", "if dt > 0:", "if True:",
            "tests/player/live/test_take.py " + HARD + "live.py"),
    Planted("player/effects/loose_motion.py", "v *= np.minimum(1, cap / np.maximum(fast, 1e-12))", "pass",
            "tests/player/effects/test_secondary_motion.py " + HARD + "effects.py"),
)  # fmt: skip


def copied(place: Path) -> Path:
    """The tree, without what is ignored."""
    for folder in FOLDERS:
        if (ROOT / folder).is_dir():
            shutil.copytree(ROOT / folder, place / folder, ignore=shutil.ignore_patterns("__pycache__", "results"))
    shutil.copy(ROOT / "pyproject.toml", place)
    return place


def planted_in(tree: Path, planted: Planted) -> str:
    """killed, LIVES, or why it could not be planted."""
    text = (tree / planted.file).read_text("utf-8")
    if text.count(planted.old) != 1:
        return f"NOT PLANTED: the old text stands there {text.count(planted.old)} times"
    return outcome(tree, planted.file, text.replace(planted.old, planted.new), planted.tests)


def outcome(tree: Path, file: str, code: str, tests: str) -> str:
    """killed, LIVES or NOT TRIED, with a file's text replaced; the tree is as before."""
    path = tree / file
    text = path.read_text("utf-8")
    path.write_text(code, "utf-8")
    words = ["-q", "-x", "-m", "not slow", "--jaxtyping-packages=", *tests.split()]
    with tempfile.TemporaryFile("w+") as said:
        pid = os.fork()
        if not pid:
            _tested(tree, words, said.fileno())
        status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        said.seek(0)
        lines = said.read()
    path.write_text(text, "utf-8")
    if status == -signal.SIGALRM:
        return f"killed: no end after {LIMIT} s"
    failed = next((line for line in lines.splitlines() if line.startswith(("FAILED", "ERROR"))), "")
    if status in (1, 2, 4):
        return f"killed by {failed.split('::')[-1].split(' - ')[0]}"
    return "LIVES" if status == 0 else f"NOT TRIED: {lines[-300:]}"


def _tested(tree: Path, words: list[str], said: int) -> NoReturn:
    """In a forked child: pytest in that tree. What all tests import is there already, of ours nothing."""
    signal.alarm(LIMIT)
    os.dup2(said, 1)
    os.dup2(said, 2)
    os.chdir(tree)
    sys.path[:] = [str(tree), *(place for place in sys.path if place and Path(place).resolve() != ROOT)]
    for name in [name for name in sys.modules if name.split(".")[0] in FOLDERS]:
        del sys.modules[name]
    sys.dont_write_bytecode = True
    import pytest

    code = 99
    try:
        code = int(pytest.main(words))
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def main() -> int:
    """Plant each; 1 where one lives."""
    # imported once, for all children
    import scipy.spatial  # noqa: F401
    import torch._dynamo  # noqa: F401

    words = sys.argv[1:]
    chosen = [p for p in PLANTED if not words or any(word in p.file + p.new for word in words)]
    lived = 0
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree = copied(Path(folder))
        for number, planted in enumerate(chosen, 1):
            found = planted_in(tree, planted)
            lived += not found.startswith("killed")
            print(f"{number}/{len(chosen)} {planted.file}: {planted.new.strip()[:60]!r}: {found}", flush=True)
    print(f"{lived} of {len(chosen)} live")
    return int(lived > 0)


if __name__ == "__main__":
    sys.exit(main())
