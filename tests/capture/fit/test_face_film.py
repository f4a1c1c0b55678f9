"""What a film of a face says: gains out of moving points, what was not shown, the mouth's colors."""

import numpy as np
import pytest
from PIL import Image, ImageDraw
from refusals import refused

from avatar.body import builtin_body
from avatar.face import SHAPES
from avatar.face_template import builtin_face
from avatar.rotation import matrix_from_axis_angle
from capture.fit.face_film import USED, fit_face, gains_of, moving_points
from capture.fit.mouth_color import OPENING, mouth_colors
from capture.keypoints.record import FACE, keypoints_of
from capture.own_face import FITTED
from command.errors import AssetError

SIZE, FOCAL, FRAMES = (711, 400), 640.0, 75
ROWS = [moving_points()[name] for name in FACE]
TRUE = np.array([0.7, 1.2, 0.8, 1.25, 0.75, 1.1, 0.8, 1.2, 0.75, 1.1])
ACTS = (("jawOpen",), ("mouthSmile",), ("browInner", "browOuter"), ("browDown",), ("eyeBlink",))


def filmed(acts, noise=0.0, habit=0.003, wild=0.0):
    """Keypoints of a head that sways half a metre before the camera and does the acts, one after the other."""
    rng, time = np.random.default_rng(0), np.arange(FRAMES) / FRAMES
    weights = np.zeros((FRAMES, len(FITTED)))
    for number, act in enumerate(acts):
        on = np.abs(time - (number + 0.6) / len(acts)) < 0.3 / len(acts)
        weights[:, [name.startswith(act) for name in FITTED]] += on[:, None]
    moves = builtin_face().offsets[[SHAPES.index(name) for name in FITTED]][:, ROWS].astype(np.float64)
    places = builtin_body("female").vertices[ROWS] + habit * rng.standard_normal((68, 3)) / np.sqrt(3)
    places = places - places.mean(0) + np.tensordot(weights * TRUE, moves, 1)
    sway = np.radians(3) * np.sin(2 * np.pi * (time[:, None] * [1, 1.7, 0.6] + [0, 0.3, 0.6]))
    R = np.diag([1.0, -1, -1]) @ matrix_from_axis_angle(sway)
    at = np.einsum("fij,fkj->fki", R, places) + [0, 0, 0.5] + 0.01 * np.sin(7 * time[:, None, None])
    pixels = FOCAL * at[..., :2] / at[..., 2:] + 0.5 * np.array(SIZE) + noise * rng.standard_normal((FRAMES, 68, 2))
    pixels[rng.uniform(size=pixels.shape[:2]) < wild] += 30
    return keypoints_of(FACE, np.concatenate([pixels, np.full((FRAMES, 68, 1), 0.9)], 2), SIZE)


def fitted(keypoints):
    fit = fit_face(builtin_body("female").vertices, keypoints, SIZE, FOCAL, "face.mp4")
    return fit, gains_of(fit, 30.0)


def test_gains_come_back_through_a_detectors_habits_and_slips():
    _, found = fitted(filmed(ACTS, noise=0.7, wild=0.03))
    assert found.why == ("",) * 10
    np.testing.assert_allclose(found.gains, TRUE, atol=0.1)
    np.testing.assert_allclose(found.gains[:3], TRUE[:3], atol=0.04)
    # noise alone drives gains nowhere
    _, found = fitted(filmed(ACTS, noise=2.0))
    assert abs(np.mean(found.gains - TRUE)) < 0.04


def test_points_between_the_lips_go_each_with_its_own_lip():
    jaw = builtin_face().offsets[SHAPES.index("jawOpen"), ROWS, 1]
    assert (jaw[[61, 62, 63]] > -0.01).all() and (jaw[[65, 66, 67]] < -0.025).all()


def test_exact_points_give_gains_poses_and_a_rest_that_is_the_templates():
    fit, found = fitted(filmed(ACTS, habit=0.0))
    np.testing.assert_allclose(found.gains, TRUE, atol=0.005)
    np.testing.assert_allclose(found.offsets, 0, atol=0.005)
    at = FOCAL * fit.places[..., :2] / fit.places[..., 2:] + 0.5 * np.array(SIZE)
    assert np.abs(at - filmed(ACTS, habit=0.0).pixels[:, USED]).max() < 0.3


def test_what_was_not_shown_or_is_not_believed_stays_as_built_in(monkeypatch):
    _, found = fitted(filmed((("eyeBlink",), (), ()), noise=0.7))
    assert found.why == ("not shown",) * 8 + ("", "")
    np.testing.assert_array_equal(found.gains[:8], 1)
    np.testing.assert_allclose(found.gains[8:], TRUE[8:], atol=0.1)
    monkeypatch.setitem(globals(), "TRUE", 3 * TRUE)
    _, found = fitted(filmed((("jawOpen",), (), ())))
    assert found.gains[0] == 1 and found.why[0].endswith("is not believed")


def test_a_film_of_a_turned_head_is_refused():
    points = filmed(ACTS)
    points.confidence[:-15, 17:42] = 0
    refused(AssetError, r"^face.mp4: expected 20 frames or more .*; found 15 of 75$", fitted, points)


@pytest.mark.parametrize("light", [(1.0, 1.0, 1.0), (0.9, 0.75, 0.5)])
def test_teeth_and_tongue_have_their_colors_beside_the_cheeks(light):
    pixels = 200 + 900 * builtin_body("female").vertices[ROWS][:, :2] * [1, -1]
    pixels = pixels[list(USED)] - pixels[list(USED)].mean(0) + 200
    loop = np.stack([pixels[USED.index(number)] for number in OPENING])
    loop[:, 1] += np.where(np.arange(8) > 4, 70, 0)
    for number, at in zip(OPENING, loop):
        pixels[USED.index(number)] = at
    paint = lambda *color: tuple(int(c * share) for c, share in zip(color, light))
    picture = Image.new("RGB", (400, 400), paint(200, 150, 120))
    draw, (left, top), (right, bottom) = ImageDraw.Draw(picture), loop.min(0), loop.max(0)
    draw.rectangle((left, top, right, bottom), fill=paint(20, 5, 5))
    draw.rectangle((left, top + 12, right, top + 18), fill=paint(230, 215, 190))
    draw.rectangle((left, bottom - 40, right, bottom), fill=paint(170, 80, 80))
    teeth, red = mouth_colors([(np.asarray(picture), pixels)])
    np.testing.assert_allclose(teeth, [230 / 200, 215 / 150, 190 / 120], rtol=0.02)
    np.testing.assert_allclose(red, [170 / 200, 80 / 150, 80 / 120], rtol=0.02)
    closed = np.full((400, 400, 3), 150, np.uint8)
    assert mouth_colors([(closed, pixels)])[0] is None and mouth_colors([]) == (None, None)


def test_keypoints_of_another_film_are_refused_and_a_point_never_seen_is_left_out():
    points = filmed(ACTS, noise=0.7)
    column = FACE.index("face_57")
    points.confidence[:, column] = 0
    points.pixels[:, column] = np.nan
    np.testing.assert_allclose(fitted(points)[1].gains[:3], TRUE[:3], atol=0.05)
    points.pixels[:] = np.random.default_rng(1).uniform(0, 400, points.pixels.shape)
    said = r"^face.mp4: its keypoints lie \d+ mm off a face at rest; are they of this film\?$"
    refused(AssetError, said, fitted, points)
