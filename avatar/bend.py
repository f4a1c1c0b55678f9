"""Bend joints: bones at elbows, knees and shoulders that keep linear blending from flattening what bends.

Linear blending of two bones that differ by an angle t draws a section half way between them in to cos(t / 2) of its
thickness, and the way round a bend gets shorter besides. A bend joint stands where joint J does, turns by half of J's
swing S (avatar/twist.py separates it from the twist about J's bone), and is pushed out of the bend, in the frame of J's
parent:

    S^1/2 about J, then moved by c (e - S e)        e the unit vector along J's bone, pose 0; c in metres, J's own

e - S e points out of the bend, has the length 2 sin(t / 2), and is 0 where nothing bends. c is found at the bake
(bake/bend.py) so that J's flesh keeps its volume. At a shoulder c is the less the higher an arm is raised above the
T-pose, c (1 - max(0, y of S e)): the armpit then opens, and pushed down it would hang out.

An elbow or knee has two of them that always stand in the same place: bend0 is the child of J's parent, bend1 of J, so
that their weights, counted for those, are the skin of a file without. A shoulder has bend1 alone: the torso's part of
a vertex lies on up to three joints, which leaves no room for a fourth. Numbers follow those of the twist joints.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.rotation import affine, quaternion_from_axis_angle, quaternion_inverse, quaternion_product, unit_or_zero
from avatar.skeleton import JOINTS, PARENTS


class Bend(NamedTuple):
    joint: int
    # the end of its bone
    child: int
    # one of them is the parent's
    both: bool


BENDS: dict[str, Bend] = {
    f"{side}_{joint}": Bend(JOINTS.index(f"{side}_{joint}"), JOINTS.index(f"{side}_{child}"), both)
    for side in ("left", "right")
    for joint, child, both in (("elbow", "wrist", True), ("knee", "ankle", True), ("shoulder", "elbow", False))
}
BEND_JOINTS = tuple(f"{name}_bend{k}" for name, bend in BENDS.items() for k in ((0, 1) if bend.both else (1,)))
# for each bend joint: which of BENDS, and whether it is the child of the joint itself
_OF = np.array([k for k, bend in enumerate(BENDS.values()) for _ in range(1 + bend.both)])
_OWN = np.array([name.endswith("1") for name in BEND_JOINTS])
_JOINT = np.array([bend.joint for bend in BENDS.values()])
_CHILD = np.array([bend.child for bend in BENDS.values()])
# _LEVI_CIVITA[c, a, b] v[a] e[c] is (v x e)[b]
_LEVI_CIVITA = np.zeros((3, 3, 3))
_LEVI_CIVITA[[2, 0, 1], [1, 2, 0], [0, 1, 2]], _LEVI_CIVITA[[1, 2, 0], [2, 0, 1], [0, 1, 2]] = 1.0, -1.0
# shoulders
_RAISED = np.array([float(not bend.both) for bend in BENDS.values()])
# the joint of the skeleton whose child each is
BEND_CARRIER = np.where(_OWN, _JOINT[_OF], PARENTS[_JOINT[_OF]])
BEND_CARRIER.setflags(write=False)


class BendJoints:
    """The bend joints of one skeleton, whose joints rest at `joints`, metres; `push` is c of each of BENDS."""

    def __init__(self, joints: Float[Array, "52 3"], push: Float[Array, "bends"]):
        # a bone without length has no axis: all of its turn is a swing, and nothing is pushed
        self.axes = unit_or_zero(joints[_CHILD] - joints[_JOINT])
        # from their parent, pose 0, metres
        self.offsets = np.where(_OWN[:, None], 0.0, (joints[_JOINT] - joints[PARENTS[_JOINT]])[_OF])
        self._places = joints[_JOINT] - joints[PARENTS[_JOINT]]
        self._push = push
        # v @ _crossed is v x e
        self._crossed = np.einsum("jc,cab->jab", self.axes, _LEVI_CIVITA)

    def local(self, pose: Float[Array, "*b 52 3"]) -> tuple[Float[Array, "*b joints 4"], Float[Array, "*b joints 3"]]:
        """parent_from_bend_joint: unit quaternions and places, metres."""
        half, outwards = self._halves(pose)
        back = quaternion_inverse(quaternion_from_axis_angle(np.asarray(pose[..., _JOINT, :], np.float64)))
        own, of, u, w = _OWN[:, None], _OF, back[..., :3], back[..., 3:]
        turns = np.where(own, quaternion_product(back, half)[..., of, :], half[..., of, :])
        # v turned by a unit quaternion (u, w): v + 2 u x (u x v + w v)
        inwards = outwards + 2 * np.cross(u, np.cross(u, outwards) + w * outwards)
        return turns, self.offsets + np.where(own, inwards[..., of, :], outwards[..., of, :])

    def transforms(
        self, pose: Float[Array, "52 3"], outer_from_joint: Float[Array, "52 4 4"]
    ) -> Float[Array, "joints 4 4"]:
        """outer_from_bend_joint of each, from the skeleton's own transforms in this pose."""
        half, outwards = self._halves(pose)
        K = (half[:, :3] @ _LEVI_CIVITA.reshape(3, 9)).reshape(-1, 3, 3)
        # rotation of a unit quaternion (u, w): I + 2 w [u]x + 2 [u]x^2
        local = affine(np.eye(3) + 2 * (half[:, 3:, None] * K + K @ K), self._places + outwards)
        # both of a hinge stand in the same place
        return (outer_from_joint[PARENTS[_JOINT]] @ local)[_OF]

    def _halves(self, pose: Float[Array, "*b 52 3"]) -> tuple[Float[Array, "*b bends 4"], Float[Array, "*b bends 3"]]:
        """Half of each swing, a unit quaternion, and c (e - S e), in the frame of the joint's parent.

        A rotation (v, w) with the twist a = v . e has the swing (s, n), n = sqrt(a^2 + w^2) and
        s = (w p - a p x e) / n with p = v - a e; so S e = (2 n^2 - 1) e + 2 n s x e.
        """
        turn = np.asarray(pose[..., _JOINT, :], np.float64)
        angle = np.sqrt(np.einsum("...jc,...jc->...j", turn, turn))
        v, w = (0.5 * np.sinc(angle / (2 * np.pi)))[..., None] * turn, np.cos(0.5 * angle)
        a = np.einsum("...jc,jc->...j", v, self.axes)
        n = np.hypot(a, w)
        # a swing of half a turn leaves the twist open: none
        some = n > 1e-12
        size = np.where(some, n, 1.0)
        p = v - a[..., None] * self.axes
        s = np.where(some, w / size, 1.0)[..., None] * p - (a / size)[..., None] * self._cross(p)
        half = np.concatenate([s / np.sqrt(2 + 2 * n)[..., None], np.sqrt(0.5 + 0.5 * n)[..., None]], axis=-1)
        # a bone without length is all swing and is not pushed
        turned = (2 * n * n - 1)[..., None] * self.axes + (2 * n)[..., None] * self._cross(s)
        push = self._push * (1 - _RAISED * np.maximum(turned[..., 1], 0))
        return half, push[..., None] * (self.axes - turned)

    def _cross(self, v: Float[Array, "*b bends 3"]) -> Float[Array, "*b bends 3"]:
        return np.einsum("...ja,jab->...jb", v, self._crossed)
