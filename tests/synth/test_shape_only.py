"""Captures that are told a shape and no more: coefficients of the free body, its own joints, no hair."""

import json

import numpy as np
import pytest

from avatar.body import builtin_body
from avatar.camera import project, read_cameras
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINTS
from capture.folder import input_kind, read_capture
from synth.command import SynthConfig, load_subject, synth
from synth.cutout import cut_out

LIMBS = [JOINTS.index(f"{side}_{name}") for side in ("left", "right") for name in ("hip", "knee", "shoulder", "wrist")]


@pytest.fixture(scope="module")
def captured(tmp_path_factory):
    out = tmp_path_factory.mktemp("shape") / "capture"
    synth("builtin", out, SynthConfig(size=96, frames=4, truth=False, template="shape"))
    return out


def test_the_template_is_a_shape_of_the_free_body_with_its_own_joints_and_no_hair(captured):
    with np.load(captured / "subject.npz") as data:
        fields = dict(data)
    body = builtin_body("male")
    assert not fields["hair"].any() and "eyes" not in fields
    np.testing.assert_allclose(fields["joints"][0], 0, atol=1e-7)
    # linear in ten coefficients, a size and a place: nothing else is left over
    places = np.tile(np.eye(3), (len(body.vertices), 1, 1))
    basis = np.concatenate([body.vertices[..., None], body.shape_directions, places], 2)
    basis = basis.reshape(-1, basis.shape[2])
    flat = fields["v_template"].astype(np.float64).ravel()
    left = flat - basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]
    assert np.abs(left).max() < 1e-5
    assert input_kind(json.loads((captured / "capture.json").read_text())) == "shape only"


@pytest.mark.slow
def test_its_joints_stand_near_the_persons_in_every_frame(captured):
    """Poses are of the template's pelvis, which is not the person's."""
    capture, person = read_capture(captured), cut_out(load_subject("builtin"))
    off = capture.subject.joints - capture.subject.joints[0] - (person.joints - person.joints[0])
    assert 0.001 < np.linalg.norm(off[LIMBS], axis=1).mean() < 0.02
    exact = captured.with_name("exact")
    synth("builtin", exact, SynthConfig(size=96, frames=4, truth=False))
    given = read_capture(exact)
    assert input_kind(given.facts) == "given"
    for part in ("body", "hand_left"):
        ours, true = capture.videos[part], given.videos[part]
        np.testing.assert_array_equal(ours.axis_angle, true.axis_angle)
        # one offset in the person's own frame
        turned = np.swapaxes(matrix_from_axis_angle(ours.axis_angle[:, 0]), 1, 2)
        offset = np.einsum("fij,fj->fi", turned, ours.root - true.root)
        np.testing.assert_allclose(offset, offset[:1].repeat(len(offset), 0), atol=1e-9)
        assert 1e-4 < np.linalg.norm(offset[0]) < 0.03
        # the truth of the frames is the person's, whatever was told
        for folder in (captured, exact):
            with np.load(folder / "truth" / part / "video.npz") as filmed:
                np.testing.assert_allclose(filmed["root"], true.root, atol=1e-12)
                np.testing.assert_array_equal(filmed["poses"], true.axis_angle)
                np.testing.assert_array_equal(filmed["camera_from_world"], true.cameras[0].camera_from_world)


def test_landmarks_of_the_head_lie_where_the_template_has_them_in_the_pictures(captured):
    """The head's frame is the person's; points are moved by what lies between both pelvises."""
    capture = read_capture(captured)
    video = capture.videos["head"]
    seen = []
    for camera, mask in zip(read_cameras(captured / "head" / "cameras.npz"), video.masks, strict=True):
        pixels, depth = project(camera, video.landmarks)
        assert (depth > 0).all()
        x, y = np.clip(pixels.round().astype(int), 0, 95).T
        seen.append(mask[y, x].mean())
    assert np.mean(seen) > 0.9
