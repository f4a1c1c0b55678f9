"""Motion of another skeleton onto ours: bone directions are kept, the root follows the middle of the hips.

Let G_k be the turn of a bone away from its rest pose, in the world. Rest poses differ (legs spread, arms down),
so each of our bones gets a constant A_k that lays our rest bone along the other skeleton's rest bone:

    G_ours(t) = W G_theirs(t) A        local_k = G_parent^T G_k

W turns their world's up axis to +y. A_k starts as the turn between the two rest frames (up axis, facing) and is
passed down each limb with the smallest turn that aligns the bone (rotation_between), so twist is carried along.
Spine and neck chains of any length are interpolated along their length. Lengths scale by the ratio of the legs.
"""

import re
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from avatar.body import Body, builtin_body
from avatar.errors import AssetError
from avatar.motion.clip import Motion
from avatar.rotation import (
    axis_angle_from_matrix,
    matrix_from_axis_angle,
    matrix_from_quaternion,
    quaternion_from_matrix,
    rotation_between,
    slerp,
)
from avatar.skeleton import JOINTS, PARENTS, joint_transforms

Array = np.ndarray

# Names of one side, without "left" or "right", lower case; the earliest that is present is taken.
LIMB_NAMES = {
    "hip": ("upleg", "thightwist", "thighbend", "thigh", "upperleg", "femur", "hip"),
    "knee": ("loleg", "lowerleg", "shin", "calf", "knee", "tibia", "leg"),
    "ankle": ("ankle", "foot"),
    "foot": ("toebase", "toe", "toes", "ball", "foot"),
    "shoulder": ("uparm", "upperarm", "shldrtwist", "shldrbend", "shldr", "humerus", "arm", "shoulder"),
    "collar": ("collar", "clavicle", "shoulder"),
    "elbow": ("loarm", "lowerarm", "forearmtwist", "forearmbend", "forearm", "elbow"),
    "wrist": ("wrist", "hand"),
}
# Of two joints on one bone the first places the bone, the second (a twist joint) turns it.
BONE_START = {"thightwist": "thighbend", "shldrtwist": "shldrbend", "forearmtwist": "forearmbend"}
FINGER_NAMES = {
    "index": ("index",),
    "middle": ("middle", "mid"),
    "pinky": ("pinky", "little"),
    "ring": ("ring",),
    "thumb": ("thumb",),
}
REQUIRED = ("hip", "knee", "ankle", "shoulder", "elbow")


@runtime_checkable
class AnimatedRig(Protocol):
    """An animated skeleton in its own units and axes: a BVH file (avatar/motion/bvh.py),
    a glTF animation (gltf_motion.py).
    """

    @property
    def path(self) -> Path: ...
    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    # -1 for a root; parents come first
    def parents(self) -> tuple[int, ...]: ...
    @property
    # of joints without a child
    def ends(self) -> tuple[tuple[int, tuple[float, float, float]], ...]: ...
    @property
    def frames(self) -> int: ...
    @property
    def rate(self) -> float | int: ...
    def values(self, start: int, stop: int) -> Float[np.ndarray, "frames channels"]: ...
    # turn of each joint away from its rest pose, and its place, in the file's world
    def transforms(
        self, values: Float[np.ndarray, "frames channels"]
    ) -> tuple[Float[np.ndarray, "frames joints 3 3"], Float[np.ndarray, "frames joints 3"]]: ...
    def rest_positions(self) -> Float[np.ndarray, "joints 3"]: ...


# looked at for up axis, ground and soles
SAMPLED_FRAMES = 200
J = {name: index for index, name in enumerate(JOINTS)}


def side_and_base(name: str) -> tuple[str, str]:
    """("left" | "right" | "", rest of the name): "mixamorig:LeftUpLeg", "lThighBend", "UpLeg_L" alike."""
    name = name.rsplit(":", 1)[-1].strip()
    for side, letter in (("left", "l"), ("right", "r")):
        if name.lower().startswith(side):
            base = name[len(side) :]
        elif name.lower().endswith(("_" + side, "." + side)):
            base = name[: -len(side)]
        elif re.match(f"[{letter}{letter.upper()}](_|[A-Z])", name):
            base = name[1:]
        elif re.search(f"[_.][{letter}{letter.upper()}]$", name):
            base = name[:-2]
        else:
            continue
        return side, re.sub(r"[^a-z0-9]", "", base.lower())
    return "", re.sub(r"[^a-z0-9]", "", name.lower())


def _joint_map(rig: AnimatedRig) -> tuple[dict[str, int], dict[str, int], list[str]]:
    """Our joint name -> their joint that turns it, and -> their joint that places it; names not found."""
    by_side: dict[str, dict[str, int]] = {"left": {}, "right": {}, "": {}}
    for index, name in enumerate(rig.names):
        # MakeHuman's helper joints, named as the joints they lead to
        if not name.startswith("__"):
            side, base = side_and_base(name)
            by_side[side].setdefault(base, index)
    turns: dict[str, int] = {}
    places: dict[str, int] = {}
    absent: list[str] = []
    for side in ("left", "right"):
        have = by_side[side]
        used: set[str] = set()
        for ours, aliases in LIMB_NAMES.items():
            key = f"{side}_{ours}"
            found = next((a for a in aliases if a in have and a not in used), "")
            if not found:
                absent.append(key)
                continue
            used.add(found)
            turns[key], places[key] = have[found], have[BONE_START.get(found, found)]
        chains: dict[str, int] = {}
        for finger, aliases in FINGER_NAMES.items():
            for n in (1, 2, 3):
                spelt = [f"{prefix}{alias}{n}" for alias in aliases for prefix in ("", "hand")]
                chains |= {f"{finger}{n}": have[name] for name in spelt if name in have}
        # fewer chains than three are lumps that mean "the fingers"
        if sum(f"{finger}2" in chains for finger in FINGER_NAMES) >= 3:
            for finger, index in chains.items():
                turns[f"{side}_{finger}"] = places[f"{side}_{finger}"] = index
    head = by_side[""].get("head", -1)
    missing = [k for k in absent if k.split("_")[1] in REQUIRED] + (["head"] if head < 0 else [])
    if missing:
        names = ", ".join(rig.names[:12])
        raise AssetError(f"{rig.path}: no joint was found for {', '.join(missing)}; the file has {names}, ...")
    turns["head"] = places["head"] = head
    return turns, places, absent


def _ancestors(rig: AnimatedRig, joint: int) -> list[int]:
    line = [joint]
    while rig.parents[line[-1]] >= 0:
        line.append(rig.parents[line[-1]])
    return line[::-1]


def _common(rig: AnimatedRig, a: int, b: int) -> int:
    """The deepest joint above both."""
    above = set(_ancestors(rig, b)[:-1])
    shared = [k for k in _ancestors(rig, a)[:-1] if k in above]
    if not shared:
        raise AssetError(
            f"{rig.path}: {rig.names[a]} and {rig.names[b]} should hang on one joint, have none above both"
        )
    return shared[-1]


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _frame(left: Array, up: Array) -> Float[Array, "3 3"]:
    """The rotation with columns left, up, forward that lies nearest, snapped to the axes."""
    up = _unit(up)
    left = _unit(left - up * (left @ up))
    R = np.stack([left, up, np.cross(left, up)], -1)
    snapped = np.zeros((3, 3))
    for column in (1, 0):  # up first
        free = np.abs(R[:, column]) * (np.abs(snapped).sum(1) == 0)
        row = int(np.argmax(free))
        snapped[row, column] = np.sign(R[row, column])
    snapped[:, 2] = np.cross(snapped[:, 0], snapped[:, 1])
    return snapped


def retarget(
    rig: AnimatedRig, body: Body | None = None, *, up_known: bool = False, assumed: tuple[str, ...] = ()
) -> Motion:
    """The motion on our skeleton; `body` gives its bone lengths (the built-in man unless told otherwise).

    `up_known` says that the file's world is y-up by its format; `assumed` are the reader's own notes, put first.

    Facts and assumptions are in the notes: joints not found, up axis, scale, ground, calibration frame.

    Raises:
        AssetError: hips, knees, ankles, shoulders, elbows or head cannot be found by name, or have no length.
    """
    body = builtin_body("male") if body is None else body
    notes: list[str] = list(assumed)
    turns, places, absent = _joint_map(rig)
    if absent:
        notes.append(f"joints not in the file, kept straight: {', '.join(absent)}")
    if not any("index1" in k for k in turns):
        notes.append("hands: no separate fingers in the file, flat")

    pelvis = _common(rig, turns["left_hip"], turns["right_hip"])
    chest = _common(rig, turns["left_shoulder"], turns["right_shoulder"])
    line = _ancestors(rig, chest)
    spine = line[line.index(pelvis) + 1 :] if pelvis in line else line[1:]
    above = _ancestors(rig, turns["head"])
    neck = above[above.index(chest) + 1 : -1] if chest in above else []

    rest = rig.rest_positions()
    ours = body.joints
    A, soles = _rest_alignment(rig, turns, places, rest, ours, notes)
    scale = _scale(rig, places, rest, ours, notes)

    sample = np.unique(np.linspace(0, rig.frames - 1, min(rig.frames, SAMPLED_FRAMES)).astype(int))
    values = np.concatenate([rig.values(int(k), int(k) + 1) for k in sample])
    G, at = rig.transforms(values)
    mid = (at[:, places["left_hip"]] + at[:, places["right_hip"]]) / 2
    W = np.eye(3) if up_known else _world_turn((at[:, turns["head"]] - mid).mean(0), notes)

    def rotations(G: Array) -> Float[Array, "frames 52 3 3"]:
        """World rotation of each of our joints."""
        out = np.zeros((len(G), 52, 3, 3))
        root = A["pelvis"]
        bottom = G[:, pelvis] @ root
        out[:, J["pelvis"]] = bottom
        column = [bottom] + [G[:, k] @ root for k in spine]
        for n, name in enumerate(("spine1", "spine2", "spine3"), start=1):
            out[:, J[name]] = _along(column, n / 3)
        out[:, J["neck"]] = G[:, neck[-1]] @ root if neck else _along([column[-1], G[:, turns["head"]] @ root], 0.5)
        out[:, J["head"]] = G[:, turns["head"]] @ root
        for joint in range(1, 52):
            name = JOINTS[joint]
            if name in turns and name != "head":
                out[:, joint] = G[:, turns[name]] @ A[name]
            elif (joint >= 13 and name != "head") or name.endswith(("_foot", "_ankle")):
                out[:, joint] = out[:, PARENTS[joint]]
        return W @ out

    _choose_soles(rotations, G, A, soles, ours, notes)
    offset = (ours[J["left_hip"]] + ours[J["right_hip"]]) / 2  # from the pelvis joint, in its frame

    def roots(R: Array, at: Array) -> Float[Array, "frames 3"]:
        mid = (at[:, places["left_hip"]] + at[:, places["right_hip"]]) / 2
        return scale * mid @ W.T - R[:, 0] @ offset

    def pose_of(R: Array) -> Float[Array, "frames 52 3"]:
        local = R.copy()
        local[:, 1:] = np.swapaxes(R[:, PARENTS[1:]], -1, -2) @ R[:, 1:]
        return axis_angle_from_matrix(local)

    R = rotations(G)
    ground = _ground(body, pose_of(R), roots(R, at))
    notes.append(f"ground: lowered by {ground:.3f} m so that the soles stand at 0")
    _note_calibration(rig, turns, notes)

    def block(start: int, stop: int) -> tuple[Array, Array]:
        G, at = rig.transforms(rig.values(start, stop))
        R = rotations(G)
        return pose_of(R), roots(R, at) - [0, ground, 0]

    height = float(-body.vertices[:, 1].min())
    return Motion(rig.path.name, rig.frames, rig.rate, tuple(notes), block, height)


def _along(chain: list[Array], part: float) -> Array:
    """Rotation at a fraction of the way along a chain of rotations (frames 3 3)."""
    place = part * (len(chain) - 1)
    first = min(int(place + 1e-9), len(chain) - 1)
    rest = place - first
    if rest < 1e-9:
        return chain[first]
    a, b = quaternion_from_matrix(chain[first]), quaternion_from_matrix(chain[first + 1])
    return matrix_from_quaternion(slerp(a, b, rest))


def _rest_alignment(
    rig: AnimatedRig, turns: dict[str, int], places: dict[str, int], rest: Array, ours: Array, notes: list[str]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """A_k of every joint, and for each ankle the other choice: the foot flat at rest."""

    def bone(a: str, b: str) -> Array:
        return rest[places[b]] - rest[places[a]]

    def our_bone(a: str, b: str) -> Array:
        return ours[J[b]] - ours[J[a]]

    left = rest[places["left_hip"]] - rest[places["right_hip"]]
    middle = (rest[places["left_hip"]] + rest[places["right_hip"]]) / 2
    up = rest[places["head"]] - middle
    if np.linalg.norm(left) == 0 or np.linalg.norm(up) == 0:
        raise AssetError(f"{rig.path}: hips or hips and head rest at the same place")
    root = _frame(left, up)
    facing = "+-"[int(root[:, 2].min() < 0)] + "xyz"[int(np.argmax(np.abs(root[:, 2])))]
    upwards = "+-"[int(root[:, 1].min() < 0)] + "xyz"[int(np.argmax(np.abs(root[:, 1])))]
    notes.append(f"rest pose: up {upwards}, facing {facing}")
    A, flat = {"pelvis": root}, {}

    def aligned(base: Array, ours_dir: Array, theirs: Array) -> Array:
        if np.linalg.norm(theirs) < 1e-9:
            return base
        return rotation_between(_unit(base @ ours_dir), _unit(theirs)) @ base

    turned = []
    for side in ("left", "right"):
        hip, knee, ankle, foot = (f"{side}_{n}" for n in ("hip", "knee", "ankle", "foot"))
        A[hip] = aligned(root, our_bone(hip, knee), bone(hip, knee))
        A[knee] = aligned(A[hip], our_bone(knee, ankle), bone(knee, ankle))
        turned.append((hip, root, A[hip]))
        if foot in places and places[foot] != places[ankle]:
            toe = bone(ankle, foot)
        else:
            toe = np.array(next((e for k, e in rig.ends if k == places[ankle]), (0.0, 0.0, 0.0)))
        A[ankle] = A[knee] @ _heading(our_bone(ankle, foot), A[knee].T @ toe)
        flat[ankle] = root @ _heading(our_bone(ankle, foot), root.T @ toe)
        A[foot] = A[ankle]

        collar, shoulder, elbow, wrist = (f"{side}_{n}" for n in ("collar", "shoulder", "elbow", "wrist"))
        A[collar] = root
        if collar in places:
            mine, theirs = root @ our_bone(collar, shoulder), bone(collar, shoulder)
            if np.linalg.norm(theirs) > 0 and _unit(mine) @ _unit(theirs) < 0.5:  # rests raised, not sideways
                A[collar] = aligned(root, our_bone(collar, shoulder), theirs)
        A[shoulder] = aligned(root, our_bone(shoulder, elbow), bone(shoulder, elbow))
        turned.append((shoulder, root, A[shoulder]))
        A[elbow] = aligned(A[shoulder], our_bone(elbow, wrist), bone(elbow, wrist)) if wrist in places else A[shoulder]
        A[wrist] = A[elbow]
        if f"{side}_index1" in places and f"{side}_pinky1" in places and f"{side}_middle1" in places:
            names = [f"{side}_{n}" for n in ("middle1", "index1", "pinky1")]
            mine = _palm(our_bone(wrist, names[0]), our_bone(names[2], names[1]))
            theirs = _palm(bone(wrist, names[0]), bone(names[2], names[1]))
            # finger joints at one place span no palm
            if np.isfinite(theirs).all():
                A[wrist] = theirs @ mine.T
        for finger in FINGER_NAMES:
            base = A[wrist]
            for n in (1, 2, 3):
                name, beyond = f"{side}_{finger}{n}", f"{side}_{finger}{n + 1}"
                if name in places and beyond in places:
                    base = aligned(base, our_bone(name, beyond), bone(name, beyond))
                A[name] = base
    for name, a, b in turned[:2]:
        angle = np.degrees(np.linalg.norm(axis_angle_from_matrix(a.T @ b)))
        if angle > 10:
            notes.append(f"rest pose: {name.split('_')[1]} bones rest {angle:.0f} degrees off our T-pose, aligned")
    return A, flat


def _palm(along: Array, across: Array) -> Float[Array, "3 3"]:
    """Frame of a palm; NaN where the two directions are parallel or have no length."""
    length = np.linalg.norm(along)
    x = along / length if length > 1e-9 else np.full(3, np.nan)
    z = across - x * (across @ x)
    length = np.linalg.norm(z)
    z = z / length if length > 1e-9 else np.full(3, np.nan)
    return np.stack([x, np.cross(z, x), z], -1)


def _heading(ours: Array, theirs: Array) -> Float[Array, "3 3"]:
    """Turn about our up axis that gives our foot their heading; both in our rest frame."""
    if np.hypot(theirs[0], theirs[2]) < 1e-9:
        return np.eye(3)
    angle = np.arctan2(theirs[0], theirs[2]) - np.arctan2(ours[0], ours[2])
    return matrix_from_axis_angle(np.array([0, angle, 0]))


def _scale(rig: AnimatedRig, places: dict[str, int], rest: Array, ours: Array, notes: list[str]) -> float:
    def leg(at: Array, index: dict[str, int]) -> float:
        pairs = [(f"{s}_{a}", f"{s}_{b}") for s in ("left", "right") for a, b in (("hip", "knee"), ("knee", "ankle"))]
        return sum(float(np.linalg.norm(at[index[b]] - at[index[a]])) for a, b in pairs) / 2

    theirs, mine = leg(rest, places), leg(ours, J)
    if not theirs > 0:
        raise AssetError(f"{rig.path}: the legs have no length")
    notes.append(f"scale: leg {theirs:.4g} units -> {mine:.3f} m, root scaled by {mine / theirs:.5g}")
    return mine / theirs


def _world_turn(upright: Array, notes: list[str]) -> Float[Array, "3 3"]:
    """Rotation taking the file's up axis, the one the body mostly stands along, to +y."""
    axis = int(np.argmax(np.abs(upright)))
    sign = "+" if upright[axis] > 0 else "-"
    up = np.eye(3)[axis] * (1 if sign == "+" else -1)
    notes.append(
        f"up: {sign}{'xyz'[axis]}, the axis the body mostly stands along" + (", turned to y" if up[1] != 1 else "")
    )
    return np.round(rotation_between(up, np.array([0.0, 1, 0])))


def _choose_soles(rotations, G: Array, A: dict, flat: dict, ours: Array, notes: list[str]) -> None:
    """Settle how the foot is rolled at rest: with the leg (CMU rests on spread legs) or flat on the ground.

    The direction ankle to toe cannot tell; the choice is the one whose soles lie flatter over the sampled
    frames (median tilt of the foot's up axis).
    """

    def tilt() -> float:
        R = rotations(G)
        ups = R[:, [J["left_ankle"], J["right_ankle"]], 1, 1]
        return float(np.median(np.degrees(np.arccos(np.clip(ups, -1, 1)))))

    with_leg = {k: A[k] for k in A if k.endswith(("_ankle", "_foot"))}
    a = tilt()
    for ankle, value in flat.items():
        A[ankle] = A[ankle.replace("ankle", "foot")] = value
    b = tilt()
    if a <= b:
        A.update(with_leg)
    if abs(a - b) > 2:
        notes.append(
            f"feet: rolled {'with the leg' if a <= b else 'flat'} at rest (soles tilt {min(a, b):.0f}, else "
            f"{max(a, b):.0f} degrees)"
        )


def _ground(body: Body, pose: Array, root: Array) -> float:
    """Height of the lowest sole point, a low percentile over the frames."""
    vertices = body.vertices
    low = np.flatnonzero(vertices[:, 1] < vertices[:, 1].min() + 0.015)
    points = []
    for side in ("left", "right"):
        for joint in (f"{side}_ankle", f"{side}_foot"):
            bones = body.skin.joints[low, np.argmax(body.skin.weights[low], -1)]
            mine = low[bones == J[joint]]
            points += [(J[joint], vertices[k] - body.joints[J[joint]]) for k in mine[:: max(1, len(mine) // 12)]]
    G = joint_transforms(pose, body.joints, root)
    index = [k for k, _ in points]
    at = np.array([p for _, p in points])
    y = np.einsum("fpc,pc->fp", G[:, index, 1, :3], at) + G[:, index, 1, 3]
    return float(np.percentile(y.min(1), 10))


def _note_calibration(rig: AnimatedRig, turns: dict[str, int], notes: list[str]) -> None:
    """Say so when frame 0 is a rest pose followed by a jump, as in CMU's files; it is kept."""
    if rig.frames < 2:
        return
    G, _ = rig.transforms(rig.values(0, 2))
    used = sorted(set(turns.values()))
    jump = axis_angle_from_matrix(np.swapaxes(G[0, used], -1, -2) @ G[1, used])
    largest = float(np.degrees(np.linalg.norm(jump, axis=-1)).max())
    if largest > 20 and largest * rig.rate > 1500:  # no limb turns faster
        notes.append(f"frame 0: the pose jumps by {largest:.0f} degrees to frame 1; a calibration pose, kept")
