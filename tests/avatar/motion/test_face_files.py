"""Files of faces: a table with ARKit's names, and MediaPipe's scores."""

import json

import numpy as np
import pytest

from avatar.face import SHAPES
from avatar.motion.read import read_motion
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINT_NUMBERS as J
from command.errors import AssetError

# as Live Link Face's header has them: two pairs have Right before Left
SWAPPED = {"jawLeft": "jawRight", "jawRight": "jawLeft", "mouthLeft": "mouthRight", "mouthRight": "mouthLeft"}
HEADER = [SWAPPED.get(name, name) for name in SHAPES]


def table(path, rows=150, rate=60, change=lambda text: text):
    """A take that begins and ends in the middle of a second; shape k of row n is 0.01 k + 0.001 n."""
    names = [name[0].upper() + name[1:] for name in HEADER]
    lines = [",".join(["Timecode", "BlendShapeCount", *names, "HeadYaw", "HeadPitch", "HeadRoll"])]
    for n in range(rows):
        second, part = divmod(n + rate // 2, rate)
        values = [0.01 * SHAPES.index(name) + 0.001 * n for name in HEADER]
        lines.append(f"12:00:{second:02}:{part:02}.123,61," + ",".join(f"{v:.4f}" for v in [*values, 0.2, 0.0, 0.0]))
    path.write_text(change("\n".join(lines)))
    return path


@pytest.mark.parametrize("rate", [30, 60])
def test_a_table_goes_by_its_names_and_its_clock(tmp_path, rate):
    motion = read_motion(table(tmp_path / "take.csv", rate=rate))
    clip = motion.read()
    assert motion.rate == rate and motion.frames == 150
    assert np.allclose(clip.face[3], np.minimum(0.01 * np.arange(52) + 0.003, 1), atol=1e-4)
    turned = clip.axis_angle[:, [J["neck"], J["head"]], 1].sum(1)
    assert np.allclose(turned, -0.2) and clip.axis_angle[:, J["left_elbow"]].max() == 0
    # eyes of shapes that are larger downwards look down
    assert clip.gaze.shape == (150, 2, 2)


@pytest.mark.parametrize(("change", "said"), [
    (lambda t: "a,b\n1,2", "expected a table of ARKit's shapes"),
    (lambda t: t.split("\n")[0], "a row a frame"),
    (lambda t: t.replace("0.0100", "nan", 1), "line 2 should be finite"),
    (lambda t: t.replace("0.0100", "x", 1), "line 2: could not"),
    (lambda t: t + ",1", "line 151 should have 57 values"),
    (lambda t: t.replace("JawOpen", "EyeBlinkLeft", 1), "each shape once"),
])  # fmt: skip
def test_what_is_no_table_of_faces_is_refused(tmp_path, change, said):
    with pytest.raises(AssetError, match=rf"take\.csv.*{said}"):
        read_motion(table(tmp_path / "take.csv", change=change)).read()


def scores(weight, matrix=None):
    items = [{"category_name": name, "score": weight} for name in ("_neutral", "jawOpen", "eyeBlinkLeft")]
    return {"face_blendshapes": [items]} | ({"facial_transformation_matrixes": [matrix]} if matrix is not None else {})


def test_scores_of_mediapipe_move_the_face_gaps_are_filled_and_the_matrix_turns_the_head(tmp_path):
    turn = np.eye(4)
    turn[:3, :3] = 2.0 * matrix_from_axis_angle(np.array([0.0, 0.3, 0.0]))
    frames = [scores(0.2, turn.tolist()), None, {"face_blendshapes": []}, scores(0.8)]
    (tmp_path / "a.json").write_text(json.dumps({"frames": frames, "fps": 25}))
    motion = read_motion(tmp_path / "a.json")
    clip = motion.read()
    assert np.allclose(clip.face[:, SHAPES.index("jawOpen")], [0.2, 0.4, 0.6, 0.8]) and motion.rate == 25
    assert np.allclose(clip.face.sum(1), 2 * clip.face[:, SHAPES.index("jawOpen")])
    assert np.allclose(clip.axis_angle[:, [J["neck"], J["head"]], 1].sum(1), 0.3)
    assert any("face: not found in 2 of 4 frames" in note for note in motion.notes)
    for wrong in ({"face_blendshapes": [[{"score": 1}]]}, scores(0.5, [[0.0] * 4] * 4)):
        (tmp_path / "a.json").write_text(json.dumps({"frames": [wrong]}))
        with pytest.raises(AssetError, match="frame 0"):
            read_motion(tmp_path / "a.json")
