"""Motion of another skeleton onto an avatar's: bone directions are kept, the root follows the middle of the hips.

Let G_k be the turn of a bone away from its rest pose, in the world. Rest poses differ (legs spread, arms down),
so each of our bones gets a constant A_k that lays the avatar's rest bone along the other skeleton's rest bone:

    G_ours(t) = W G_theirs(t) A        local_k = G_parent^T G_k

W turns their world's up axis to +y. A_k starts as the turn between the two rest frames (up axis, facing) and is
passed down each limb with the smallest turn that aligns the bone (rotation_between), so twist is carried along.
Spine and neck chains of any length are interpolated along their length. Lengths scale by the ratio of the legs.
A rig whose rest pose is no person's (every bone along +x) gets its A_k from its motion: avatar/motion/calibrate.py.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.motion.calibrate import Sampled, calibrated_alignment
from avatar.motion.clip import Motion, RestSkeleton, builtin_skeleton, spread_frames
from avatar.motion.pose_vector import TURNS, up_axis
from avatar.motion.rest_pose import Alignment, rest_alignment, rests_standing
from avatar.motion.rig import AnimatedRig, JointMap, find_joints
from avatar.motion.smplh_rig import leg_length
from avatar.rotation import axis_angle_from_matrix, axis_name, matrix_from_quaternion, rotation_part_way
from avatar.skeleton import JOINT_NUMBERS as J
from avatar.skeleton import JOINTS, PARENTS, pose_of_rotations
from command.errors import AssetError

# looked at for up axis, rest pose and soles
SAMPLED_FRAMES = 200
# the share of one axis' spread of the lowest joint's heights below which another axis is certainly up instead
LEVEL = 0.5


def retarget(
    rig: AnimatedRig, skeleton: RestSkeleton | None = None, *, up_known: bool = False, assumed: tuple[str, ...] = (),
    alignment: Alignment | None = None,
) -> Motion:  # fmt: skip
    """The motion on our skeleton, with the bones of `skeleton` (the built-in man's where none is given).

    `up_known` says that the file's world is y-up by its format; `assumed` are the reader's own notes, put first.
    `alignment` is given where it is known how the rig's axes lie; else it comes from its rest pose or its motion.
    The root keeps the file's heights: avatar/motion/ground.py finds the ground.

    Facts and assumptions are in the notes: joints not found, rest pose, up axis, scale, calibration frame.

    Raises:
        AssetError: hips, knees, ankles, shoulders, elbows or head cannot be found by name, or have no length or sides.
    """
    skeleton = builtin_skeleton() if skeleton is None else skeleton
    ours = skeleton.joints.astype(np.float64)
    notes: list[str] = list(assumed)
    joints = find_joints(rig)
    if joints.absent:
        notes.append(f"joints not in the file, kept straight: {', '.join(joints.absent)}")
    if not any("index1" in k for k in joints.turns):
        notes.append("hands: no separate fingers in the file, flat")
    hips = [joints.places["left_hip"], joints.places["right_hip"]]

    G, at = rig.transforms(spread_frames(rig.frames, SAMPLED_FRAMES))
    upright = (at[:, joints.head] - at[:, hips].mean(1)).mean(0)
    if not (at[0, hips[0]] != at[0, hips[1]]).any() or not upright.any():
        raise AssetError(f"{rig.path}: hips or hips and head rest at the same place")
    W = matrix_from_quaternion(np.array(TURNS["+y" if up_known else _up(rig, joints, at, upright, notes)])).round()
    rig_leg, our_leg = leg_length(rig.rest_positions, joints.places), leg_length(ours, J)
    if not rig_leg > 0:
        raise AssetError(f"{rig.path}: the legs have no length")
    # metres of the avatar in one unit of the file
    scale = our_leg / rig_leg
    notes.append(f"scale: leg {rig_leg:.4g} units -> {our_leg:.3f} m, root scaled by {scale:.5g}")
    if alignment is None:
        if rests_standing(rig, joints):
            alignment = _flatter(joints, G, W, *rest_alignment(rig, joints, ours, notes), notes)
        else:
            alignment = calibrated_alignment(rig, joints, Sampled(G, at, W[1]), ours, notes)
        _note_calibration(rig, joints, notes)
    # from the pelvis joint to the middle of the hips, in the pelvis's frame
    offset = (ours[J["left_hip"]] + ours[J["right_hip"]]) / 2

    def block(start: int, stop: int) -> tuple[Array, Array]:
        G, at = rig.transforms(np.arange(start, stop))
        R = W @ _rotations(joints, alignment, G)
        return pose_of_rotations(R), scale * at[:, hips].mean(1) @ W.T - R[:, 0] @ offset

    return Motion(rig.path.name, rig.frames, rig.rate, tuple(notes), block, skeleton.pelvis_height)


def _up(rig: AnimatedRig, joints: JointMap, at: Array, upright: Float[Array, "3"], notes: list[str]) -> str:
    """The axis that the body stands along on average, unless it crawls: then the one that the rig rests along.

    The lowest joint of who crawls keeps its height over the ground, and goes along with the trunk.
    """
    if rests_standing(rig, joints):
        rest, places = rig.rest_positions, list(joints.places.values())
        hips = (rest[joints.places["left_hip"]] + rest[joints.places["right_hip"]]) / 2
        rested, stood = (axis_name(way) for way in (rest[joints.head] - hips, upright))
        lowest = [(at[:, places] @ matrix_from_quaternion(np.array(TURNS[up]))[1]).min(1) for up in (rested, stood)]
        over_rested, over_stood = np.subtract(*np.percentile(lowest, [90, 10], axis=1))
        if over_rested < LEVEL * over_stood:
            notes.append(f"up: {rested}, as the rig rests: the body crawls or lies")
            return rested
    return up_axis(upright, notes)


def _rotations(joints: JointMap, alignment: Alignment, G: Array) -> Float[Array, "frames 52 3 3"]:
    """Rotation of each of our joints in the file's world."""
    out = np.zeros((len(G), 52, 3, 3))
    column = {k: G[:, k] @ A for k, A in alignment.column.items()}
    line = [column[k] for k in (joints.pelvis, *joints.spine)]
    out[:, 0] = line[0]
    for n, name in enumerate(("spine1", "spine2", "spine3"), start=1):
        out[:, J[name]] = _along(line, n / 3)
    head = column[joints.head]
    out[:, J["neck"]] = column[joints.neck[-1]] if joints.neck else _along([line[-1], head], 0.5)
    out[:, J["head"]] = head
    for joint in range(1, 52):
        name = JOINTS[joint]
        if name in joints.turns and name != "head":
            out[:, joint] = G[:, joints.turns[name]] @ alignment.limbs[name]
        elif (joint >= 13 and name != "head") or name.endswith(("_foot", "_ankle")):
            out[:, joint] = out[:, PARENTS[joint]]
    return out


def _along(chain: list[Array], part: float) -> Array:
    """Rotation at a fraction of the way along a chain of rotations (frames 3 3)."""
    first = min(int(part * (len(chain) - 1) + 1e-9), len(chain) - 1)
    rest = part * (len(chain) - 1) - first
    return chain[first] if rest < 1e-9 else rotation_part_way(chain[first], chain[first + 1], rest)


def _flatter(joints: JointMap, G: Array, W: Array, with_leg: Alignment, flat: Alignment, notes: list[str]) -> Alignment:
    """Settle how the foot is rolled at rest: with the leg (CMU rests on spread legs) or flat on the ground.

    The direction ankle to toe cannot decide it; the choice is the one whose soles lie flatter over the sampled
    frames (median tilt of the foot's up axis).
    """

    def tilt(alignment: Alignment) -> float:
        R = W @ _rotations(joints, alignment, G)
        ups = R[:, [J["left_ankle"], J["right_ankle"]], 1, 1]
        return float(np.median(np.degrees(np.arccos(np.clip(ups, -1, 1)))))

    a, b = tilt(with_leg), tilt(flat)
    if abs(a - b) > 2:
        how, least, most = "with the leg" if a <= b else "flat", min(a, b), max(a, b)
        notes.append(f"feet: rolled {how} at rest (soles tilt {least:.0f}, else {most:.0f} degrees)")
    return with_leg if a <= b else flat


def _note_calibration(rig: AnimatedRig, joints: JointMap, notes: list[str]) -> None:
    """Say so when frame 0 is a rest pose followed by a jump, as in CMU's files; it is kept."""
    if rig.frames < 2:
        return
    G, _ = rig.transforms(np.arange(2))
    used = sorted(set(joints.turns.values()))
    jump = axis_angle_from_matrix(np.swapaxes(G[0, used], -1, -2) @ G[1, used])
    largest = float(np.degrees(np.linalg.norm(jump, axis=-1)).max())
    if largest > 20 and largest * rig.rate > 1500:  # no limb turns faster
        notes.append(f"frame 0: the pose jumps by {largest:.0f} degrees to frame 1; a calibration pose, kept")
