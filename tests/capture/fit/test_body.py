"""A known person is found again: heading, sides, focal length, poses and shape, no farther off than clothes stand."""

from dataclasses import replace

import numpy as np
import pytest
from turning_twin import in_clothes, limb_error, pixels_of, turned_hand, turning_twin

from avatar.rotation import axis_angle_from_matrix
from capture.fit.body import first_guess, fit_keypoints, fit_outlines
from capture.fit.directions import opposite
from capture.fit.focal import marginal, weighed
from capture.fit.offsets import bilaplacian, dressed, fit_offsets
from capture.fit.outline_term import Outlines
from capture.fit.person import person_of
from capture.fit.points import body_points
from capture.fit.priors import standing
from capture.fit.refusals import check_fit, check_footage, check_upright
from capture.fit.scan import STEPS
from capture.fit.sides import sides_restored
from capture.fit.standoff import LIMBS, SCALP, body_standoff, scalp_standoff
from capture.keypoints.record import FACE
from command.errors import AssetError
from geometry.mesh import vertex_normals

QUIET = lambda note: None


def degrees_off(truth, found):
    return np.degrees(np.linalg.norm(axis_angle_from_matrix(np.swapaxes(truth.heading, 1, 2) @ found.heading), axis=1))


@pytest.fixture(scope="module")
def twin():
    return turning_twin()


def test_first_guess_faces_the_right_way_in_every_frame_and_keypoints_alone_find_the_limbs(twin):
    guess, _ = first_guess(person_of("male", 1.8), twin.footage)
    assert degrees_off(twin.truth, guess).max() < 25
    assert np.abs(guess.root - twin.truth.root).max() < 0.25
    found, _ = fit_keypoints(person_of("male", 1.8), twin.footage, QUIET)
    assert limb_error(twin.truth, found) < 0.02
    assert np.median(degrees_off(twin.truth, found)) < 3.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
def test_sway_noise_and_other_places_of_toes_and_ears_do_not_draw_the_person_nearer(seed):
    truth, footage = turning_twin(24, seed=seed)
    rng = np.random.default_rng(seed)
    elsewhere = np.array(["toe" in name or "ear" in name for name in footage.names])
    outward = np.where([name.startswith("right") for name in footage.names], -1, 1)
    bias = 0.02 * elsewhere[:, None] * np.stack([outward, np.full(len(outward), -0.5), np.ones(len(outward))], 1)
    bias += rng.normal(0, 0.005, bias.shape)
    truth = replace(truth, root=truth.root + rng.normal(0, 0.015, truth.root.shape), bias=bias, g=0 * truth.g)
    pixels = pixels_of(truth, footage) + rng.normal(0, 1.0, footage.pixels.shape)
    seen = replace(footage, pixels=pixels, sure=np.ones_like(footage.sure))
    found, _ = fit_keypoints(person_of("male", 1.8), seen, QUIET)
    # 5 and 8 cm of 3 m with twice as wide priors of toes, ears and feet and a third of the sway
    assert abs((found.root - truth.root)[:, 2].mean()) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_sides_exchanged_in_all_points_and_in_the_arms_alone_are_put_back(seed):
    truth, footage = turning_twin(seed=seed)
    pixels, other = footage.pixels.copy(), opposite(footage.names)
    pixels[5] = pixels[5, other]
    arms = [k for k, name in enumerate(footage.names) if name.split("_")[-1] in ("shoulder", "elbow", "wrist")]
    pixels[9, arms] = footage.pixels[9, other[arms]]
    found, restored = fit_keypoints(person_of("male", 1.8), replace(footage, pixels=pixels), QUIET)
    np.testing.assert_array_equal(restored.pixels[9], footage.pixels[9])
    np.testing.assert_array_equal(restored.pixels[5], footage.pixels[5])
    assert limb_error(truth, found) < 0.02


def test_sides_that_are_right_stay(twin):
    np.testing.assert_array_equal(sides_restored(twin.truth, twin.footage).pixels, twin.footage.pixels)


@pytest.mark.slow
@pytest.mark.parametrize("error", [0.1, -0.1])
def test_of_a_focal_length_told_wrong_by_a_tenth_half_or_more_is_found(error):
    _, footage = turning_twin(24, focal_error=error, noise=0.3)
    found, _ = fit_keypoints(person_of("male", 1.8), footage, QUIET)
    true = footage.focal / (1 + error)
    assert abs(np.log(found.camera(footage).K[0, 0] / true)) < 0.055


def test_offsets_add_what_clothes_do():
    """A person who wears 1 cm everywhere, poses known: offsets of 1 cm where outlines look."""
    truth, footage = turning_twin(6, 200, seed=1)
    normals = vertex_normals(truth.person.vertices(truth.g), truth.person.body.faces)
    footage = in_clothes(truth, footage, 0.01)
    outlines = Outlines(footage)
    every = np.ones(len(normals), bool)
    offsets = fit_offsets(truth, footage, outlines, every)
    height = truth.person.vertices(truth.g)[:, 1]
    trunk = (height > 0.05) & (height < 0.35)
    found = (offsets * normals).sum(1)[trunk]
    assert np.median(found) == pytest.approx(0.01, abs=0.002)
    assert np.mean(np.abs(found - 0.01) < 0.004) > 0.7


@pytest.mark.slow
def test_outlines_of_somebody_with_hair_and_shoes_do_not_draw_the_person_nearer():
    truth, footage = turning_twin(10, 200, seed=1)
    height = truth.person.vertices(truth.g)[:, 1]
    # 3 cm on the scalp, 2 under the soles, 1 elsewhere
    thick = np.select([height > height.max() - 0.06, height < height.min() + 0.03], [0.03, 0.02], 0.01)
    told: list[str] = []
    bare = replace(truth, person=replace(truth.person, offsets=np.zeros((len(height), 3))))
    found = fit_outlines(bare, in_clothes(truth, footage, thick), told.append)
    # after a first guess and two rounds of keypoints
    assert 3 + len(told) == STEPS["body"]
    # 1.9 cm; 7.4 of 3 m where poses and shape moved before offsets
    assert abs((found.root - truth.root)[:, 2].mean()) < 0.03


def test_the_bilaplacian_of_constants_is_nothing_and_points_of_the_face_lie_right():
    free = person_of("male").body
    Q = bilaplacian(free.vertices, free.faces)
    assert abs(np.ones(len(free.vertices)) @ Q @ np.ones(len(free.vertices))) < 1e-6
    rng = np.random.default_rng(0)
    rough, smooth = rng.standard_normal(len(free.vertices)), free.vertices[:, 1]
    assert rough @ Q @ rough > 1e3 * (smooth @ Q @ smooth) > 0
    points, free = body_points(), person_of("female").body
    place = lambda name: points[name].place(free.vertices, free.joints)
    assert place("face_45")[0] > place("face_42")[0] > 0 > place("face_39")[0] > place("face_36")[0]
    assert place("face_30")[2] > place("face_27")[2] and place("face_08")[1] < place("face_57")[1]
    # none inside of mouth or nose
    assert all(place("face_30")[2] - place(f"face_{k:02d}")[2] < 0.045 for k in range(17, 68))
    for name in ("left_ear", "left_heel", "left_big_toe", "left_index_tip", "left_eye"):
        np.testing.assert_allclose(place(name), place(name.replace("left", "right")) * [-1, 1, 1], atol=0.012)
    assert place("left_heel")[2] < place("left_ankle")[2] < place("left_big_toe")[2]


def test_keypoints_beside_the_person_pictures_upside_down_and_fits_of_nothing_are_refused(twin):
    _, footage = turning_twin(4, 200, masks=True)
    check_footage("body", footage)
    with pytest.raises(AssetError, match="body video: keypoints should lie on the person of the masks"):
        check_footage("body", replace(footage, masks=np.roll(footage.masks, 80, axis=2)))
    check_upright(twin.footage)
    height = twin.footage.size[1]
    turned = replace(twin.footage, pixels=height - twin.footage.pixels)
    with pytest.raises(AssetError, match="upside down"):
        check_upright(turned)
    pixels = twin.footage.pixels.copy()
    pixels[3] += 25
    usable = check_fit("body", twin.truth, replace(twin.footage, pixels=pixels))
    assert not usable[3] and usable.sum() == len(usable) - 1
    with pytest.raises(AssetError, match="body video: keypoints should lie within 6 cm of a person's"):
        check_fit("body", twin.truth, replace(twin.footage, pixels=twin.footage.pixels + 30))
    # a hand's points are as far from the lens as the hand; its body may hang behind it
    truth, footage = turned_hand("left")
    assert check_fit("hand_left", truth, footage).all()
    near = truth.root[:, 2].argmax()
    truth = replace(
        truth, root=truth.root[[near] * 4], heading=truth.heading[[near] * 4], angles=truth.angles[[near] * 4]
    )
    pixels = footage.pixels[[near] * 4] + 0.04 * footage.focal / 0.5 * np.array([0, 1])
    with pytest.raises(AssetError, match="lie 4 cm off"):
        check_fit("hand_left", truth, replace(footage.rows(np.array([near] * 4)), pixels=pixels))


def seen_by(truth: float, own: float, doubt: float) -> tuple[float, float]:
    """What a video finds that alone says `truth` with deviation `own`, and that holds the guess 0."""
    precision = 1 / own**2 + 1 / doubt**2
    return truth / own**2 / precision, precision**-0.5


def test_the_guess_counts_once_sure_videos_more_and_those_that_contradict_each_other_less():
    doubt = 0.05
    found = np.array([seen_by(0.04, 0.05, doubt)] * 4)
    mean, sigma = weighed(found, doubt)
    precision = 4 / 0.05**2 + 1 / doubt**2
    assert mean == pytest.approx(0.04 * 4 / 0.05**2 / precision)
    assert sigma == pytest.approx(precision**-0.5)
    sure, vague, blind = seen_by(0.02, 0.01, 0.1), seen_by(-0.06, 0.04, 0.1), (0.0, 0.1)
    mean, sigma = weighed(np.array([sure, vague, blind]), 0.1)
    assert mean == pytest.approx((0.02 / 0.01**2 - 0.06 / 0.04**2) / (1 / 0.01**2 + 1 / 0.04**2 + 1 / 0.1**2))
    assert sigma >= (1 / 0.01**2 + 1 / 0.04**2 + 1 / 0.1**2) ** -0.5
    agreeing = np.array([seen_by(0.01, 0.01, 0.1)] * 3)
    apart = np.array([seen_by(value, 0.01, 0.1) for value in (-0.05, 0.01, 0.07)])
    assert weighed(apart, 0.1)[1] > 3 * weighed(agreeing, 0.1)[1]


@pytest.mark.slow
def test_doubt_is_what_other_noise_would_change():
    """The marginal's deviation beside the spread over draws of the noise; what the person may be is doubted too."""
    truth, footage = turning_twin(8, 256, focal_error=0.05)
    found, doubts = [], []
    for seed in range(4):
        noise = 0.5 * np.random.default_rng(seed).standard_normal(footage.pixels.shape)
        estimate, seen = fit_keypoints(truth.person, replace(footage, pixels=footage.pixels + noise), lambda note: None)
        found.append(estimate.log_focal)
        doubts.append(marginal(estimate, seen, standing(estimate, seen)))
    assert 0.05 < np.std(found, ddof=1) / np.mean(doubts) < 2
    assert abs(np.mean(found) + np.log(1.05)) < np.mean(doubts)


def test_outlines_move_no_point_of_the_face_and_no_hand_or_neck_by_the_bodys_video():
    points = body_points()
    face = [vertex for name in (*FACE, "left_ear", "right_ear") for vertex in points[name].vertices if name in points]
    assert (scalp_standoff()[face] == 0).all() and (body_standoff()[face] == 0).all()
    assert scalp_standoff().max() == SCALP and (scalp_standoff() > 0).sum() > 200
    tips = [vertex for name, point in points.items() if name.endswith("_tip") for vertex in point.vertices]
    assert (body_standoff()[tips] == 0).all()


def test_a_wide_skirt_is_not_filled_by_the_legs():
    truth, footage = turning_twin(6, 200, seed=1)
    vertices = truth.person.vertices(truth.g)
    normals = vertex_normals(vertices, truth.person.body.faces)
    # 15 cm off the thighs, all round, nothing elsewhere
    thighs = (vertices[:, 1] < -0.12) & (vertices[:, 1] > -0.45) & (np.abs(vertices[:, 0]) < 0.35)
    footage = in_clothes(truth, footage, np.where(thighs, 0.15, 0.0))
    bare = replace(truth, person=replace(truth.person, offsets=0 * normals))

    def found(standoff):
        every = np.ones(len(normals), bool) if standoff is None else standoff > 0
        offsets = dressed(bare, footage, Outlines(footage, standoff), every).person.offsets
        return np.abs((offsets * normals).sum(1))

    own, free = found(body_standoff()), found(None)
    assert own[thighs].max() <= LIMBS + 1e-9 and np.median(own[thighs]) < 0.015
    assert np.median(free[thighs]) > 1.5 * np.median(own[thighs])
