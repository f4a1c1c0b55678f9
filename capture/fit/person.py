"""The person who is looked for: the free body with its shape directions and its bones, and offsets from it.

    joints(g) = joints + D_j g        vertices(g) = vertices + D_v g + offsets

g holds the coefficients of the body's shape directions, the head's size, then of bones, mirrored left to right. A
bone that ends in a hinge or a finger's middle joint grows along itself only: across it, a bone's direction and the
rotation of its joint are the same movement, and the rest pose would mean nothing. So in pose 0 of every fitted person
arms lie along x, thighs and shins stand as the free body's, fingers point as its fingers do. Bones carry their
surface with them. Last come places of limb joints in the flesh, which carry nothing.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from avatar.body import Body, builtin_body
from avatar.constant import constant
from avatar.kinematics import DESCENDS
from avatar.skeleton import JOINTS, PARENTS
from avatar.skinning import SkinWeights, dense_weights
from capture.read.template import TemplateMesh

# standard deviations: of a shape coefficient, its own unit; of the head's size, a share of it; of bones, metres
SHAPE, HEAD_SIZE = 1.0, 0.025
BONE = 0.02
FINGER = 0.006
# ball of the foot from the ankle: across, height, forwards. The stature counts from the soles: ankles that may
# rise let the rest of the body shrink
FOOT = (0.005, 0.004, 0.01)
# metres, a joint's place in the flesh round it
WITHIN = 0.015
# bones that may only grow
ALONG = ("knee", "ankle", "elbow", "wrist")
# heads are as large as stature to this power: heads of tall people are hardly larger (ANSUR II, Gordon et al. 2014: the
# deviations of head length and stature are 3.5 and 3.8 %, their correlation about .35)
HEAD_POWER = 0.33
HEAD = JOINTS.index("head")
# joints that may lie elsewhere in the flesh: people's and rigs' do, and surface and joints are both seen
SETTLING = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")


@dataclass(frozen=True)
class Person:
    """Linear space of people of one sex and stature, and the offsets that clothes and hair add."""

    body: Body  # scaled to the stature
    vertex_directions: Float[Array, "vertices 3 g"]
    joint_directions: Float[Array, "52 3 g"]
    sigma: Float[Array, "g"]
    fingers: Bool[Array, "g"]  # which of g are bones of fingers
    stature: float  # metres, without offsets
    offsets: Float[Array, "vertices 3"]  # pose 0

    def vertices(self, g: Float[Array, "g"], chosen: Int[Array, "n"] | slice = slice(None)) -> Float[Array, "n 3"]:
        """Surface in pose 0, or `chosen` vertices of it."""
        return self.body.vertices[chosen] + self.vertex_directions[chosen] @ g + self.offsets[chosen]

    def joints(self, g: Float[Array, "g"]) -> Float[Array, "52 3"]:
        return self.body.joints + self.joint_directions @ g

    def height(self) -> tuple[float, Float[Array, "g"]]:
        """Height of the body at g = 0, and how it changes with g."""
        y = self.body.vertices[:, 1]
        top, sole = int(y.argmax()), int(y.argmin())
        return float(y[top] - y[sole]), self.vertex_directions[top, 1] - self.vertex_directions[sole, 1]


def person_of(sex: str, stature: float | None = None) -> Person:
    """The people of one sex ("male", "female") who are `stature` metres tall; None: as tall as the free body is."""
    body = builtin_body(sex)
    height = float(np.ptp(body.vertices[:, 1]))
    stature = height if stature is None else stature
    scale = stature / height
    body = replace(body, vertices=scale * body.vertices, joints=scale * body.joints)
    # from the free body's head to this one's, about the head's joint
    skull = dense_weights(body.skin)[:, HEAD, None] * (body.vertices - body.joints[HEAD])
    body = replace(body, vertices=body.vertices + (scale ** (HEAD_POWER - 1) - 1) * skull)
    bones, sigma = _bones(body)
    within = _settling()
    before = body.shape_directions.shape[2] + 1
    fingers = np.r_[np.zeros(before, bool), sigma == FINGER, np.zeros(within.shape[2], bool)]
    shapes = scale * body.joint_directions - scale * body.joint_directions[:1]
    skin_shapes = scale * body.shape_directions - scale * body.joint_directions[:1]
    joint_directions = np.concatenate([shapes, np.zeros((52, 3, 1)), bones, within], 2)
    carried = np.einsum("vj,jcg->vcg", _carried(sex), bones)
    nothing = np.zeros((len(carried), 3, within.shape[2]))
    vertex_directions = np.concatenate([skin_shapes, skull[:, :, None], carried, nothing], 2)
    shared = np.r_[np.full(shapes.shape[2], SHAPE), HEAD_SIZE]
    sigma = np.r_[shared, scale * sigma, np.full(within.shape[2], scale * WITHIN)]
    return Person(body, vertex_directions, joint_directions, sigma, fingers, stature, np.zeros_like(body.vertices))


def _bones(body: Body) -> tuple[Float[Array, "52 3 n"], Float[Array, "n"]]:
    """Directions of the joints when single bones change, the same on both sides, and their standard deviations."""
    directions, sigma = [], []
    for joint in range(1, 52):
        name = JOINTS[joint]
        if name.startswith("right_"):
            continue
        bone = body.joints[joint] - body.joints[PARENTS[joint]]
        finger = joint >= 22
        if name.removeprefix("left_") in ALONG or (finger and not name.endswith("1")):
            axes = [bone / np.linalg.norm(bone)]
        else:
            axes = list(np.eye(3) if name.startswith("left_") else np.eye(3)[1:])
        for axis in axes:
            moved = np.zeros((52, 3))
            moved[DESCENDS[:, joint]] += axis
            if name.startswith("left_"):
                other = JOINTS.index(name.replace("left_", "right_"))
                moved[DESCENDS[:, other]] += axis * [-1, 1, 1]
            directions.append(moved)
            sigma.append(FINGER if finger else FOOT[int(np.argmax(axis))] if name == "left_foot" else BONE)
    return np.stack(directions, -1), np.array(sigma)


def _settling() -> Float[Array, "52 3 n"]:
    """Directions of single limb joints, mirrored: the joint alone moves."""
    directions = []
    for part in SETTLING:
        left, right = JOINTS.index(f"left_{part}"), JOINTS.index(f"right_{part}")
        for axis in np.eye(3):
            moved = np.zeros((52, 3))
            moved[left], moved[right] = axis, axis * [-1, 1, 1]
            directions.append(moved)
    return np.stack(directions, -1)


@constant
def _carried(sex: str) -> Float[Array, "vertices 52"]:
    """How far each vertex goes with each joint when bones grow; rows sum to 1.

    A vertex of bone k, at the share t of the way to the bone's end c, goes with (1 - t) J_k + t J_c; where a bone has
    several ends, the nearer ones count more.
    """
    body = builtin_body(sex)
    x, joints, weights = body.vertices, body.joints, dense_weights(body.skin)
    carried = np.zeros_like(weights)
    for k in range(52):
        rows = np.flatnonzero(weights[:, k] > 0)
        ends = np.flatnonzero(k == PARENTS)
        if len(ends) == 0:
            carried[rows, k] += weights[rows, k]
            continue
        along = joints[ends] - joints[k]
        t = np.einsum("vi,ei->ve", x[rows] - joints[k], along) / (along**2).sum(1)
        t = np.clip(t, 0, 1)
        gap = np.linalg.norm(x[rows, None] - joints[k] - t[:, :, None] * along, axis=2)
        share = 1 / (gap + 0.01) ** 4
        share *= weights[rows, k, None] / share.sum(1, keepdims=True)
        carried[rows, k] += (share * (1 - t)).sum(1)
        carried[rows[:, None], ends] += share * t
    return carried


def known_person(template: TemplateMesh) -> Person:
    """A person whose shape is known: nothing of it is free."""
    count, height = len(template.vertices), float(np.ptp(template.vertices[:, 1]))
    skin = SkinWeights(template.skin.joints, template.skin.weights.astype(np.float64))
    nothing, no_joints = np.zeros((count, 3, 0)), np.zeros((52, 3, 0))
    body = Body("known", template.vertices, template.faces, skin, template.joints, nothing, no_joints, None, None,
                template.licence, np.zeros(3))  # fmt: skip
    return Person(body, nothing, no_joints, np.zeros(0), np.zeros(0, bool), height, np.zeros((count, 3)))
