"""How far an outline may draw each vertex from the body: what stands off farther is a layer of its own.

An outline shows the outermost surface: a skirt hides the legs, hair hides neck and jaw. A template drawn out to there
is a bag. So outlines move the skin of the face and neck nowhere (the face belongs to its keypoints), scalp and limbs by
what short hair and close clothes add, and only the trunk, where people differ, by more. What is beyond is carved later
(capture/template: hull.py, clothes.py).
"""


import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.body import builtin_body
from avatar.constant import constant
from avatar.skeleton import JOINTS
from avatar.skinning import dense_weights

# metres: of the trunk, of legs, arms and feet, and of the scalp, where hair counts as standing off from there on
TRUNK, LIMBS, SCALP = 0.10, 0.03, 0.015
# metres, on the male body, above the pelvis and before it: the scalp lies over the brows, or behind the ears above
# the nape
HAIRLINE, BEHIND, NAPE = 0.705, -0.005, 0.575
# metres: half the width of the face's profile
PROFILE = 0.03
# metres over which the scalp's rises from nothing at its edge
RISE = 0.03
TRUNK_JOINTS = [JOINTS.index(name) for name in ("pelvis", "spine1", "spine2", "spine3", "left_collar", "right_collar")]
HEAD, NECK = JOINTS.index("head"), JOINTS.index("neck")


@constant
def body_standoff() -> Float[Array, "vertices"]:
    """Metres by which the outlines of the body's video may move each vertex of the free body; 0: not at all.

    Head and hands have videos of their own; the neck is where hair hangs.
    """
    weights = dense_weights(builtin_body("male").skin)
    trunk = weights[:, TRUNK_JOINTS].sum(1)
    reach = LIMBS + (TRUNK - LIMBS) * trunk
    own = np.isin(np.arange(52), [HEAD, NECK, *range(20, 52)])
    return np.where(weights[:, own].sum(1) > 0.5, 0.0, reach)


@constant
def scalp_standoff() -> Float[Array, "vertices"]:
    """The same of the head's video: the scalp alone."""
    body = builtin_body("male")
    x, head = body.vertices, dense_weights(body.skin)[:, HEAD] > 0.5
    over = x[:, 1] - HAIRLINE
    behind = np.minimum(BEHIND - x[:, 2], x[:, 1] - NAPE)
    return np.where(head, SCALP * np.clip(np.maximum(over, behind) / RISE, 0, 1), 0.0)


@constant
def head_outlined() -> Bool[Array, "vertices"]:
    """Vertices whose outlines show where the head is: over the hairline, and the face's profile.

    Long hair hides the rest: a skull that narrows towards its neck would be drawn down, and tilted, into hair that does
    not.
    """
    body = builtin_body("male")
    x, head = body.vertices, dense_weights(body.skin)[:, HEAD] > 0.5
    return head & ((x[:, 1] > HAIRLINE) | (np.abs(x[:, 0]) < PROFILE) & (x[:, 2] > 0))
