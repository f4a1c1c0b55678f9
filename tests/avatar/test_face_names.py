"""Names of shapes in every spelling, and gaze from and to the shapes that say it."""

import numpy as np
import pytest

from avatar.face import SHAPES, Eye
from avatar.face_names import NUMBER, shapes_called, weights_of
from avatar.gaze import YAW, gaze_at, gaze_of, with_blinks, with_looks, within_reach


def test_every_shape_is_known_by_all_its_spellings():
    for number, name in enumerate(SHAPES):
        spellings = {name, name.upper(), name[0].upper() + name[1:]}
        for side in ("Left", "Right"):
            if name.endswith(side):
                spellings |= {name.removesuffix(side) + f"_{side[0]}", name.removesuffix(side) + f"_{side.lower()}"}
        assert all(shapes_called(each) == {number: 1.0} for each in spellings)
    assert shapes_called("Blink_L") == {NUMBER["eyeBlinkLeft"]: 1.0} == shapes_called("blinkLeft")
    assert shapes_called("A") == shapes_called("aa") and shapes_called("Joy") == shapes_called("happy")
    assert shapes_called("neutral") == {} and [shapes_called(no) for no in ("", "_l", "tail", "l")] == [None] * 4


def test_values_add_up_and_stay_shares():
    weights = weights_of({"aa": 1.0, "jawOpen": 0.3, "tail": 9.0})
    assert weights[NUMBER["jawOpen"]] == pytest.approx(0.75) and weights_of({"aa": 9.0}).max() == 1


def test_looking_to_the_left_is_out_of_the_left_eye_and_into_the_right_and_back():
    gaze = gaze_of(weights_of({"lookLeft": 1.0, "lookDown": 0.5}))
    assert np.allclose(gaze[0], gaze[1]) and gaze[0, 0] == YAW and gaze[0, 1] < 0
    for sign in (-1, 1):
        asked = np.array([[0.3, 0.2 * sign], [-0.4, 0.1]])
        assert np.allclose(gaze_of(with_looks(np.zeros(52), asked)), within_reach(asked))


@pytest.mark.parametrize("other", ["eyeLookDown", "eyeSquint", "eyeWide"])
def test_a_blink_closes_its_eye_whatever_else_the_lids_do(other):
    blinks = {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 0.25, "aa": 0.5}
    asked = weights_of({**blinks, f"{other}Left": 1.0, f"{other}Right": 0.8})
    shown = weights_of({**blinks, f"{other}Right": 0.6})
    assert np.allclose(with_blinks(np.stack([asked, 0 * asked])), [shown, 0 * shown])


def test_eyes_converge_on_a_point_wherever_the_head_is():
    eyes = [Eye(np.array([x, 0.1, 0.05]), np.array([0.0, 0.0, 1.0]), 0.012) for x in (0.03, -0.03)]
    head = np.array([[0.0, 0, -1, 1], [0, 1, 0, 2], [1, 0, 0, 3], [0, 0, 0, 1]])
    gaze = gaze_at((head @ [0.0, 0.1, 0.35, 1.0])[:3], eyes, head)
    assert np.allclose(gaze, [[-np.arctan(0.1), 0], [np.arctan(0.1), 0]])
    left, right = np.degrees(within_reach(gaze_at((head @ [0.0, 0.1, 0.09, 1.0])[:3], eyes, head)))[:, 0]
    assert (left, right) == pytest.approx((-25, 25)), "no further, of the 37 degrees that a point 4 cm away asks for"
    assert (gaze_at((head @ [0.5, 0.6, 0.35, 1.0])[:3], eyes, head) > 0.5).all()
