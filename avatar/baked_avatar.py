"""The baked avatar: what `bake` makes, the avatar file holds, and the player draws.

A surface in levels of detail, each with skin, base colour and the view statistics of Eq. 14, and one tiny view
network (or a linear map) shared by all. Canonical frame (big pose, pelvis joint at the origin), metres.
docs/avatar-format.md gives the equations.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Float32, UInt8, UInt32
from numpy import ndarray as Array

from avatar.bend import BEND_JOINTS, BENDS
from avatar.face import SHAPES, SIDES, Eye, FaceShapes, followed
from avatar.helper_joints import BONES, CARRIER
from avatar.light import CaptureLight
from avatar.skeleton import JOINT_NUMBERS, JOINTS
from avatar.skinning import SkinWeights
from files.input_file import JsonObject

HEAD = JOINT_NUMBERS["head"]
# vertices that a face may move, and metres that a shape may move one by
MOST_MOVING, FARTHEST = 1 << 15, 1.0
VIEW_MODES = ("network", "linear", "off")


@dataclass(frozen=True)
class TwistSkin:
    """Skin for a skeleton with helper joints (avatar/helper_joints.py): what the file holds, and other programs use.

    Row by row, each helper joint's weight counted for the joint whose child it is, it is the skin of the 52.
    """

    joints: UInt8[Array, "vertices 4"]
    weights: UInt8[Array, "vertices 4"]  # rows sum to 255

    def folded(self) -> tuple[UInt8[Array, "vertices 4"], UInt8[Array, "vertices 4"]]:
        """Joints and weights of the 52: a joint's parts gathered in its first slot; slots of weight 0 name joint 0."""
        joints, weights = CARRIER[self.joints].astype(np.uint8), self.weights.copy()
        for slot in range(1, 4):
            for first in range(slot):
                twice = (joints[:, slot] == joints[:, first]) & (weights[:, first] > 0)
                weights[twice, first] += weights[twice, slot]
                weights[twice, slot] = 0
        return np.where(weights > 0, joints, 0).astype(np.uint8), weights


@dataclass(frozen=True)
class Level:
    positions: Float32[Array, "vertices 3"]  # canonical, metres
    normals: Float32[Array, "vertices 3"]  # canonical, unit
    # as in glTF: v downwards, (0, 0) the image's top left corner
    uv: Float32[Array, "vertices 2"]
    faces: UInt32[Array, "faces 3"]
    joints: UInt8[Array, "vertices 4"]
    weights: UInt8[Array, "vertices 4"]  # rows sum to 255
    view_dir: Float32[Array, "vertices 3"]  # global view direction (Eq. 14), canonical, camera to surface, unit
    # Q as xx, xy, xz, yy, yz, zz; positive semi-definite
    view_q: Float32[Array, "vertices 6"]
    # v in [0, 1], 0 where no camera looked
    view_seen: Float32[Array, "vertices"]
    base_color: UInt8[Array, "height width 3"]  # sRGB
    # linear, f = value / 255
    features: UInt8[Array, "feature_height feature_width 4"] | None
    # mean S and H (avatar/light.py) that the base colour shows; None: they are not separated from the albedo
    light: Float32[Array, "vertices 2"] | None = None
    # None: the file has no helper joints
    twist: TwistSkin | None = None
    # 0 where it is skin, 1 where it hangs far off the body: hair, skirts, sleeves; None: nothing is loose
    loose: Float32[Array, "vertices"] | None = None
    # None: the level's face stays still
    face: FaceShapes | None = None

    @property
    def drawn_skin(self) -> tuple[UInt8[Array, "vertices 4"], UInt8[Array, "vertices 4"]]:
        """Joints and weights that it is drawn with, helper joints among them where the file has them."""
        return (self.joints, self.weights) if self.twist is None else (self.twist.joints, self.twist.weights)

    @cached_property
    def influences(self) -> int:
        """How many joints the vertex that follows most of them does."""
        return int((self.drawn_skin[1] > 0).sum(1).max(initial=1))

    @property
    def bones(self) -> int:
        """How many that may name, with bend joints."""
        return len(JOINTS) if self.twist is None else BONES

    @property
    def skin(self) -> SkinWeights:
        """Joints and weights as skinning takes them; rows of weights sum to 1."""
        return SkinWeights(self.joints.astype(np.int64), self.weights.astype(np.float32) / np.float32(255))


@dataclass(frozen=True)
class ViewNetwork:
    """The view network of x = [f (4), t' (3), |t'|]: y = w2 relu(w1 x + b1) + b2, 8 -> 16 -> 3."""

    w1: Float32[Array, "16 8"]
    b1: Float32[Array, "16"]
    w2: Float32[Array, "3 16"]
    b2: Float32[Array, "3"]


@dataclass(frozen=True)
class Avatar:
    """A person, ready to be posed and drawn."""

    name: str
    joint_positions: Float[Array, "52 3"]  # pose 0, pelvis at the origin, metres
    # axis-angle, the pose that the levels are stored in
    canonical_pose: Float[Array, "52 3"]
    levels: tuple[Level, ...]  # finest first
    # colour = clamp(base + A |t'| y / (1 + |y|))
    network: ViewNetwork | None
    linear: Float32[Array, "4 3 3"] | None  # colour = clamp(base + (sum_i f_i M_i) t')
    # A, the largest change of colour per unit of |t'|
    amplitude: float
    default_view: Literal["network", "linear", "off"]
    # preset, data, body licence, measured accuracy ...: anything JSON holds
    provenance: JsonObject
    # the capture's, in the world where the camera stands before the T-pose; levels say what of it is in their base
    # colour. None: light is not separated from albedo
    light: CaptureLight | None = None
    # how far bend joints are pushed (avatar/bend.py), metres, only beside twist joints; None: the file has none
    bend: Float[Array, "bends"] | None = None
    # the left and the right one, of every level whose face moves; None: none does
    eyes: tuple[Eye, Eye] | None = None

    def level(self, number: int) -> Level:
        """A level of detail, 0 the finest; the coarsest where there are fewer."""
        return self.levels[min(number, len(self.levels) - 1)]


# as many rows as positions have
ROWS = -2
# field: dtype and shape, -1 for any size
LEVEL_ARRAYS = {
    "positions": ("float32", (-1, 3)),
    "normals": ("float32", (ROWS, 3)),
    "uv": ("float32", (ROWS, 2)),
    "faces": ("uint32", (-1, 3)),
    "joints": ("uint8", (ROWS, 4)),
    "weights": ("uint8", (ROWS, 4)),
    "view_dir": ("float32", (ROWS, 3)),
    "view_q": ("float32", (ROWS, 6)),
    "view_seen": ("float32", (ROWS,)),
    "base_color": ("uint8", (-1, -1, 3)),
    "features": ("uint8", (-1, -1, 4)),
    "light": ("float32", (ROWS, 2)),
    "loose": ("float32", (ROWS,)),
}
MAY_BE_NONE = ("features", "light", "loose")
NETWORK_ARRAYS = {"w1": (16, 8), "b1": (16,), "w2": (3, 16), "b2": (3,)}


def check_level(level: Mapping[str, Any], where: str) -> None:
    """Refuse fields of a level that break a promise of `Level`, with a ValueError that says which."""
    for name, (dtype, shape) in LEVEL_ARRAYS.items():
        values = level.get(name)
        if values is not None or name not in MAY_BE_NONE:
            rows = tuple(len(level["positions"]) if n == ROWS else n for n in shape)
            _check_array(values, f"{where}.{name}", dtype, rows)
    count, light, loose = len(level["positions"]), level.get("light"), level.get("loose")
    if light is not None:
        right = (light[:, 0] >= 0.009) & (light[:, 0] < 100) & (light[:, 1] >= 0) & (light[:, 1] < 100)
        _check_rows(right, f"{where}.light", "S from .01 and H from 0, both below 100", light)
    if loose is not None:
        _check_rows((loose >= 0) & (loose <= 1), f"{where}.loose", "from 0 to 1", loose)

    _check_rows(level["faces"].max(axis=1) < count, f"{where}.faces", f"below {count}", level["faces"])
    for name in ("normals", "view_dir"):
        length = np.linalg.norm(level[name].astype(np.float64), axis=1)
        _check_rows(np.abs(length - 1) < 1e-3, f"{where}.{name}", "of unit length", level[name])
    joints, weights, seen = level["joints"], level["weights"], level["view_seen"]
    _check_rows(joints.max(axis=1) < 52, f"{where}.joints", "below 52", joints)
    _check_rows(weights.sum(axis=1, dtype=int) == 255, f"{where}.weights", "a sum of 255", weights)
    # slots of weight 0 count as joints of their own
    used = np.sort(np.where(weights > 0, joints, 300 + np.arange(4)), axis=1)
    _check_rows(np.all(np.diff(used) > 0, axis=1), f"{where}.joints", "each joint once among weights above 0", joints)
    _check_rows((seen >= 0) & (seen <= 1), f"{where}.view_seen", "from 0 to 1", seen)
    if level.get("twist") is not None:
        _check_twist(level["twist"], joints, weights, where)
    if level.get("face") is not None:
        _check_face(level["face"], joints, weights, f"{where}.face")
    q = level["view_q"].astype(np.float64)
    eigenvalues = np.linalg.eigvalsh(q[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3))
    rounding = 1e-5 * np.maximum(np.abs(eigenvalues).max(axis=1), 1)
    _check_rows(eigenvalues[:, 0] >= -rounding, f"{where}.view_q", "positive semi-definite", level["view_q"])


def _check_face(face: FaceShapes, joints: Array, weights: Array, where: str) -> None:
    count = len(joints)
    _check_array(face.vertices, f"{where}.vertices", "uint32", (-1,))
    _check_array(face.offsets, f"{where}.offsets", "float32", (len(SHAPES), len(face.vertices), 3))
    _check_array(face.balls, f"{where}.balls", "uint32", (2, 2))
    vertices, balls = face.vertices.astype(np.int64), face.balls.astype(np.int64)
    if vertices[-1] >= count or (np.diff(vertices) <= 0).any() or len(vertices) > MOST_MOVING:
        raise ValueError(f"{where}.vertices should be at most {MOST_MOVING}, ascending and below {count}, are not")
    far = np.abs(face.offsets).max(axis=(1, 2))
    _check_rows(far < FARTHEST, f"{where}.offsets", f"below {FARTHEST} m", far)
    (left, left_count), (right, right_count) = balls.tolist()
    apart = left + left_count <= right or right + right_count <= left
    if not (apart and (balls[:, 1] > 0).all() and (balls.sum(axis=1) <= count).all()):
        raise ValueError(f"{where}.balls should be two runs of the {count} vertices, are {balls.tolist()}")
    on_ball = np.zeros(count, bool)
    on_ball[left : left + left_count] = on_ball[right : right + right_count] = True
    _check_rows(~on_ball[vertices], f"{where}.vertices", "outside of the balls", face.vertices)
    head = (np.where(weights > 0, joints, HEAD) == HEAD).all(axis=1)
    _check_rows(head | ~on_ball, f"{where}.balls", "bound to the head alone", joints)


def _check_eyes(avatar: Avatar) -> None:
    faces = [level.face for level in avatar.levels]
    if (avatar.eyes is not None) != any(face is not None for face in faces):
        raise ValueError("eyes should be there where a level has a face, and only there")
    for number, face in enumerate(faces):
        if face is not None and face.follow is not None:
            _check_follow(face, avatar.levels[0], f"levels[{number}].face.follow")
    for side, eye in zip(SIDES, avatar.eyes or (), strict=False):
        for name, values in (("center", eye.center), ("axis", eye.axis)):
            _check_array(values, f"eyes.{side}.{name}", values.dtype.name, (3,))
        if abs(np.linalg.norm(eye.axis) - 1) > 1e-3:
            raise ValueError(f"eyes.{side}.axis should be of unit length, is {eye.axis.tolist()}")
        if not 1e-3 <= eye.radius <= 1:
            raise ValueError(f"eyes.{side}.radius should be from .001 to 1 m, is {eye.radius}")


def _check_follow(face: FaceShapes, finest: Level, where: str) -> None:
    assert face.follow is not None, "asked of levels that follow"
    if finest.face is None or finest.face.follow is not None:
        raise ValueError(f"{where} should be below a finest level with a face of its own, is not")
    rows, (sources, weights) = (len(face.vertices), 4), (face.follow.sources, face.follow.weights)
    _check_array(sources, f"{where}.sources", "uint32", rows)
    _check_array(weights, f"{where}.weights", "uint8", rows)
    count = len(finest.positions)
    _check_rows(sources.max(axis=1) < count, f"{where}.sources", f"below {count}", sources)
    _check_rows(weights.sum(axis=1, dtype=int) == 255, f"{where}.weights", "a sum of 255", weights)
    off = np.abs(face.offsets - followed(finest.face, face.follow)).max(axis=(1, 2))
    _check_rows(off < 1e-6, f"{where}", "what the offsets are", off)


def _check_twist(twist: TwistSkin, joints: Array, weights: Array, where: str) -> None:
    for name, values in vars(twist).items():
        _check_array(values, f"{where}.twist.{name}", "uint8", joints.shape)
    _check_rows(twist.joints.max(axis=1) < BONES, f"{where}.twist.joints", f"below {BONES}", twist.joints)
    sums = twist.weights.sum(axis=1, dtype=int)
    _check_rows(sums == 255, f"{where}.twist.weights", "a sum of 255", twist.weights)
    folded_joints, folded_weights = twist.folded()
    same = (folded_weights == weights).all(1) & ((folded_joints == joints) | (weights == 0)).all(1)
    _check_rows(same, f"{where}.twist.weights", "those of the 52 joints, divided", twist.weights)


def check_avatar(avatar: Avatar) -> None:
    """Refuse an avatar that breaks a promise of these records, with a ValueError that says which."""
    for name, values in (("joint_positions", avatar.joint_positions), ("canonical_pose", avatar.canonical_pose)):
        _check_array(values, name, values.dtype.name, (52, 3))
        if not np.issubdtype(values.dtype, np.floating):
            raise ValueError(f"{name} should be floating point, is {values.dtype}")
    if np.abs(avatar.joint_positions[0]).max() > 1e-6:
        pelvis = avatar.joint_positions[0].tolist()
        raise ValueError(f"joint_positions should have the pelvis at the origin, has it at {pelvis}")
    if np.abs(avatar.canonical_pose[0]).max() > 0:
        raise ValueError("canonical_pose should not turn the pelvis, does")
    held = [level.light is not None for level in avatar.levels]
    if any(held) != (avatar.light is not None) or any(held) != all(held):
        raise ValueError("light should be in the avatar and all of its levels, or in none of them")
    if avatar.light is not None and avatar.light.frame != "world":
        raise ValueError(f"light should stand still in the world, does in the {avatar.light.frame}'s frame")
    if not avatar.levels:
        raise ValueError("levels should be one or more, are none")
    for i, level in enumerate(avatar.levels):
        check_level(vars(level), f"levels[{i}]")
    twisted = [level.twist is not None for level in avatar.levels]
    if any(twisted) != all(twisted):
        raise ValueError("twist should be in all levels or in none of them")
    if avatar.bend is not None:
        _check_array(avatar.bend, "bend", avatar.bend.dtype.name, (len(BENDS),))
        if not all(twisted):
            raise ValueError("bend should be beside twist, is without")
    for i, level in enumerate(avatar.levels):
        if avatar.bend is None and level.twist is not None:
            joints, count = level.twist.joints, BONES - len(BEND_JOINTS)
            _check_rows(joints.max(axis=1) < count, f"levels[{i}].twist.joints", f"below {count} without bend", joints)
    _check_eyes(avatar)
    sizes = [len(level.faces) for level in avatar.levels]
    if sizes != sorted(sizes, reverse=True):
        raise ValueError(f"levels should go from finest to coarsest, have {sizes} faces")
    if avatar.network is not None:
        for name, shape in NETWORK_ARRAYS.items():
            _check_array(vars(avatar.network)[name], f"network.{name}", "float32", shape)
    if avatar.linear is not None:
        _check_array(avatar.linear, "linear", "float32", (4, 3, 3))
    if not (np.isfinite(avatar.amplitude) and 0 <= avatar.amplitude <= 1):
        raise ValueError(f"amplitude should be from 0 to 1, is {avatar.amplitude}")
    try:
        json.dumps(avatar.provenance, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"provenance should be what JSON holds: {error}") from None
    view = avatar.default_view
    if view not in VIEW_MODES:
        raise ValueError(f"default_view should be one of {VIEW_MODES}, is {view!r}")
    if view != "off" and vars(avatar)[view] is None:
        raise ValueError(f"default_view is {view!r}, but the avatar has no {view}")
    if view != "off" and avatar.levels[0].features is None:
        raise ValueError(f"default_view is {view!r}, but levels[0] has no features")


def _check_array(values: object, where: str, dtype: str, shape: tuple[int, ...]) -> None:
    expected = f"{dtype} {tuple('any' if n < 0 else n for n in shape)}"
    if not isinstance(values, Array):
        raise ValueError(f"{where} should be an array of {expected}, is {type(values).__name__}")
    fits = values.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, values.shape, strict=True))
    if values.dtype.name != dtype or not fits or values.size == 0:
        raise ValueError(f"{where} should be {expected}, is {values.dtype} {values.shape}")
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        first = tuple(np.argwhere(~np.isfinite(values))[0].tolist())
        raise ValueError(f"{where} should be finite, is {values[first]} at {first}")
    if values.dtype.kind == "f" and np.abs(values).max() > 1e8:
        raise ValueError(f"{where} should be below 1e8, reaches {np.abs(values).max()}")


def _check_rows(right: Array, where: str, expected: str, values: Array) -> None:
    if not right.all():
        first = int(np.argmin(right))
        raise ValueError(f"{where} should be {expected}, is {values[first].tolist()} in row {first}")
