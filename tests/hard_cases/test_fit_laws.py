"""Laws of the fit: a film asked about in another way, or a part of it, is the same person in the same poses.

Each row of LAWS changes the footage of a known person who turns, and says how the joints of the change lie beside
those of the whole; bounds stand beside it. Masks are not looked at: outlines have their own rows.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from turning_twin import turning_twin

from avatar.skeleton import JOINTS
from capture.fit.body import fit_keypoints
from capture.fit.directions import opposite
from capture.fit.footage import Estimate, Footage
from capture.fit.person import person_of
from capture.fit.solve import posed_frames
from player.pose.mirror import PARTNER

Array = np.ndarray
# what points show: the free body's collars and head are 5 to 7 mm off its own mirror image
PARTS = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
LIMBS = [JOINTS.index(f"{side}_{part}") for part in PARTS for side in ("left", "right")]
# outer brows, corners of the mouth
FACE_PAIRS = (("face_17", "face_26"), ("face_48", "face_54"))


def fitted(footage: Footage, stature: float = 1.8) -> Array:
    """Where the fit has the limbs in each frame: frames, joints, 3; metres, the camera's frame."""
    estimate: Estimate = fit_keypoints(person_of("male", stature), footage, lambda note: None)[0]
    return posed_frames(estimate).place[:, LIMBS]


def twice_as_large(footage: Footage, whole: Array) -> Array:
    masks = np.zeros((len(footage.masks), 2 * footage.size[1], 2 * footage.size[0]), np.uint8)
    larger = replace(footage, pixels=2 * footage.pixels, sure=footage.sure / 2, masks=masks, focal=2 * footage.focal)
    return fitted(larger) - whole


def points_in_another_order(footage: Footage, whole: Array) -> Array:
    order = np.random.default_rng(0).permutation(len(footage.names))
    names = tuple(footage.names[k] for k in order)
    return fitted(replace(footage, names=names, pixels=footage.pixels[:, order], sure=footage.sure[:, order])) - whole


def played_backwards(footage: Footage, whole: Array) -> Array:
    return fitted(footage.rows(np.arange(len(footage.pixels))[::-1])) - whole[::-1]


def one_frame_in_two(footage: Footage, whole: Array) -> Array:
    return fitted(footage.rows(np.arange(0, len(footage.pixels), 2))) - whole[::2]


def mirrored(footage: Footage, whole: Array) -> Array:
    other = opposite(footage.names)
    for left, right in FACE_PAIRS:
        a, b = footage.names.index(left), footage.names.index(right)
        other[[a, b]] = b, a
    pixels = footage.pixels[:, other] * [-1, 1] + [footage.size[0], 0]
    found = np.zeros((len(whole), len(JOINTS), 3))
    found[:, LIMBS] = fitted(replace(footage, pixels=pixels, sure=footage.sure[:, other]))
    return found[:, PARTNER[LIMBS]] * [-1, 1, 1] - whole


def sides_exchanged_for_a_while(footage: Footage, whole: Array) -> Array:
    pixels = footage.pixels.copy()
    pixels[6:9] = pixels[6:9, opposite(footage.names)]
    return fitted(replace(footage, pixels=pixels)) - whole


def a_point_elsewhere(footage: Footage, whole: Array) -> Array:
    """One wrist 60 pixels off in one frame."""
    pixels = footage.pixels.copy()
    pixels[4, footage.names.index("left_wrist")] += [60, -60]
    return fitted(replace(footage, pixels=pixels)) - whole


def a_taller_person(footage: Footage, whole: Array) -> Array:
    """Who says that they are a tenth taller stands a tenth farther off; parts of the size."""
    return (fitted(footage, 1.98) / 1.1 - whole) / 1.8


class Law(NamedTuple):
    off: Callable[[Footage, Array], Array]
    bound: float
    unit: str


LAWS = {
    "pictures twice the size": Law(twice_as_large, 1e-6, "m"),
    "points in another order": Law(points_in_another_order, 1e-6, "m"),
    "played backwards": Law(played_backwards, 1e-3, "m"),
    "one frame in two": Law(one_frame_in_two, 0.03, "m"),
    "mirrored": Law(mirrored, 0.005, "m"),
    "sides exchanged for three frames": Law(sides_exchanged_for_a_while, 1e-9, "m"),
    "a point elsewhere": Law(a_point_elsewhere, 0.015, "m"),
    "a taller person": Law(a_taller_person, 0.02, "of the size"),
}


@pytest.fixture(scope="module")
def filmed() -> tuple[Footage, Array]:
    footage = turning_twin(12).footage
    return footage, fitted(footage)


@pytest.mark.parametrize("name", LAWS)
def test_a_law_of_the_fit_holds(filmed, within, name):
    law = LAWS[name]
    within(np.linalg.norm(law.off(*filmed), axis=-1), law.bound, f"{law.unit}, {name}")
