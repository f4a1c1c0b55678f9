"""A built-in person who acts: own gains, a mouth that opens on teeth, eyes that turn; raw films of it, read."""

import json
from dataclasses import replace

import numpy as np
import pytest
from refusals import refused

from avatar.face import SHAPES
from avatar.face_template import BODY, builtin_face
from capture.fit.face_film import moving_points
from capture.own_face import FITTED, OWN_FACE, read_own_face
from command.errors import AssetError
from selfscan.__main__ import main
from synth.command import load_subject
from synth.raw import film
from synth.raw.acting import acting

PERSON = load_subject("builtin:female")


@pytest.fixture(scope="module")
def acts():
    return acting(PERSON, 70, seed=3)


def test_each_act_moves_points_and_skin_by_the_built_in_shape_times_the_persons_gain(acts):
    gains = acts.truth["gains"]
    assert tuple(gains) == FITTED and len(set(gains.values())) == 10
    for name in FITTED:
        shape = SHAPES.index(name)
        frame = int(acts.weights[:, shape].argmax())
        assert acts.weights[frame, shape] == 1
        for other in np.flatnonzero(acts.weights[frame]):
            assert SHAPES[other][:4] == name[:4]
    vertex = moving_points()["face_57"]
    frame, jaw = int(acts.weights[:, SHAPES.index("jawOpen")].argmax()), builtin_face().offsets[SHAPES.index("jawOpen")]
    moved = gains["jawOpen"] * jaw[vertex]
    np.testing.assert_allclose(acts.named(frame)["face_57"], moved)
    assert np.abs(acts.vertices(frame)[: len(PERSON.vertices)] - moved).sum(1).min() < 1e-8
    # lower teeth go with the jaw
    teeth = acts.vertices(frame)[-len(builtin_face().parts) :]
    np.testing.assert_allclose(teeth, gains["jawOpen"] * jaw[BODY:], atol=1e-8)
    assert not acts.vertices(0).any()


def test_eyes_turn_about_their_middles_to_one_side_and_the_other(acts):
    left, right = (int(acts.weights[:, SHAPES.index(f"eyeLook{way}Left")].argmax()) for way in ("Out", "In"))
    for rows, middle in acts.eyes:
        arm = PERSON.vertices[rows] - middle
        for frame, sign in ((left, 1), (right, -1)):
            turned = arm + acts.vertices(frame)[rows]
            np.testing.assert_allclose(np.linalg.norm(turned, axis=1), np.linalg.norm(arm, axis=1), atol=1e-6)
            front = arm[:, 2].argmax()
            assert sign * turned[front, 0] > 0.4 * np.linalg.norm(arm[front])


def test_others_than_built_in_people_are_refused_in_one_sentence():
    other = replace(PERSON, name="White_M_1_Casual")
    refused(AssetError, r"^White_M_1_Casual: --face-film films builtin, .* alone", acting, other, 70, 0)


@pytest.mark.slow
def test_raw_films_and_one_of_the_face_become_a_capture_with_the_persons_own_gains(tmp_path, capsys, monkeypatch):
    raw, out = tmp_path / "raw", tmp_path / "capture"
    monkeypatch.setattr(film, "PARTS", ("body", "head"))
    asked = ["--raw", "--keypoints", "--face-film", "--size", "240", "--seconds", "2", "--light", "even", "--no-truth"]
    assert main(["synth", "builtin", str(raw), *asked]) == 0
    assert main(["check", str(raw)]) == 0
    said = capsys.readouterr().out
    assert "face.mp4   426 x 240, 30 frames/s, 4.0 s; the face in 120 frames; " in said
    assert said.count(f"then: selfscan make {raw} -o NAME.glb\n") == 2
    assert main(["import", "video", str(raw), "--frames", "12", "--stature", "1.753", "-o", str(out)]) == 0
    own = read_own_face(out / OWN_FACE)
    truth = json.loads((raw / "truth" / "face" / "face.json").read_text())
    off = own.gains - list(truth["gains"].values())
    assert np.abs(off[:3]).max() < 0.15 and np.sqrt(np.mean(off**2)) < 0.2
    assert own.teeth is not None and own.red is not None
    assert own.teeth[2] / own.teeth[0] > 1.2 * own.red[2] / own.red[0]
