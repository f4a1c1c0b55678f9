"""Masks that are all too large or small: measured, and redrawn by the picture's colours."""

import numpy as np
import pytest
from scipy import ndimage

from capture.fit.masks import believed_offset, edge_by_colors, regrown, signed_pixels


@pytest.mark.parametrize("pixels", [-3.0, -1.4, 1.4, 3.0])
def test_a_disc_regrown_is_a_disc_of_another_radius(pixels):
    y, x = np.mgrid[:64, :64] + 0.5
    away = np.hypot(x - 32, y - 32)
    grown = regrown((away < 15)[None], pixels)[0]
    assert (grown != (away < 15 + pixels))[abs(away - 15 - pixels) > 1].sum() == 0


@pytest.mark.parametrize("full", [True, False])
def test_masks_without_an_edge_have_no_distance_and_stay_as_they_are(full):
    mask = np.full((20, 20), full)
    assert (signed_pixels(mask[None]) == (-np.inf if full else np.inf)).all()
    found, unsure = edge_by_colors(np.zeros((20, 20, 3), np.uint8), mask, -2.0, np.zeros_like(mask))
    assert np.array_equal(found, mask) and not unsure.any()


def test_clothes_on_the_body_alone_are_no_fault_of_the_masks():
    assert believed_offset({"body": 4.0, "hand_left": 0.2, "hand_right": 0.3}) == 0
    assert believed_offset({"body": -1.7, "hand_left": -1.5, "hand_right": -1.4}) == -1.5


def _picture(background: str):
    """A person: two legs five pixels apart, and a finger three pixels wide; light cloth before a background."""
    rng = np.random.default_rng(3)
    person = np.zeros((80, 80), bool)
    person[10:40, 20:50] = True
    person[40:75, 20:32] = person[40:75, 37:50] = True
    person[20:23, 50:62] = True
    cloth = 0.75 + 0.05 * rng.standard_normal((80, 80, 3))
    rough = ndimage.gaussian_filter(rng.random((80, 80, 3)), (4, 4, 0))
    rough = 0.45 * (rough - rough.min()) / (rough.max() - rough.min())
    behind = {"black": np.zeros((80, 80, 3)), "rough": rough, "cloth": cloth}[background]
    image = np.where(person[..., None], cloth, behind)
    return person, (255 * image.clip(0, 1)).astype(np.uint8)


def _off(mask, pixels):
    y, x = np.mgrid[-3:4, -3:4]
    disc = x * x + y * y <= pixels**2
    return ndimage.binary_dilation(mask, disc) if pixels > 0 else ndimage.binary_erosion(mask, disc, border_value=1)


@pytest.mark.parametrize("background", ["black", "rough"])
@pytest.mark.parametrize("pixels", [-2, 2])
def test_the_edge_is_where_the_colours_change(background, pixels):
    """Where the template knows of the finger, the picture gives it back; regrown masks have lost it."""
    person, image = _picture(background)
    given = _off(person, pixels)
    limb = np.asarray(ndimage.binary_dilation(person), bool) if pixels < 0 else np.zeros_like(person)
    found, unsure = edge_by_colors(image, given, 0.9 * pixels, limb)
    assert (found != person).sum() < 0.1 * (given != person).sum()
    assert ((found != person) & ~unsure).sum() < 0.04 * (given != person).sum()
    assert (found[20:23, 52:62] == (True if pixels < 0 else person[20:23, 52:62])).mean() > 0.9
    grown = regrown(given[None], -0.9 * pixels)[0]
    assert (grown != person).sum() > 2 * (found != person).sum()


@pytest.mark.parametrize("pixels", [-2.0, 2.0])
def test_where_colours_say_nothing_the_offset_does_and_the_rim_is_unsure(pixels):
    person, image = _picture("cloth")
    given = _off(person, pixels)
    found, unsure = edge_by_colors(image, given, pixels, np.zeros_like(person))
    straight = np.s_[45:70, 8:26]  # the outer side of a leg
    assert np.abs(signed_pixels(person[None])[0][straight][found[straight] != person[straight]]).max(initial=0) <= 1.5
    assert unsure[straight].any(1).mean() > 0.9  # of the rows; in few the walk turns just between two pixels
    assert not unsure[signed_pixels(given[None])[0] * np.sign(pixels) > 1].any()  # what the mask itself rules out


def test_a_limb_that_the_picture_does_not_show_stays_unsure():
    person, image = _picture("black")
    limb = np.zeros_like(person)
    limb[5:9, 60:70] = True  # the template's, on black
    found, unsure = edge_by_colors(image, _off(person, -2), -2.0, limb)
    assert not found[limb].any() and unsure[limb].all()


@pytest.mark.parametrize("value", [0, 200])
def test_a_picture_of_one_colour_leaves_the_rim_unsure_and_the_mask_as_it_was_told(value):
    person = np.zeros((40, 40), bool)
    person[12:28, 12:28] = True
    found, unsure = edge_by_colors(np.full((40, 40, 3), value, np.uint8), person, -2.0, np.zeros_like(person))
    away = signed_pixels(person[None])[0]
    assert found[person].all() and not (found | unsure)[away > 3].any()
    assert unsure.any() and (away[found] < 2.5).all()
