"""The built-in motions, authored by formulas: `python -m experiments.builtin_motions` writes avatar/data/motions again.

Everything is described for the left side; the right side is its mirror image at x -> -x, under which an
axis-angle vector (x, y, z) becomes (x, -y, -z). In pose 0 the left arm points along +x, the palm down and the
thumb forward, hence (fingers: avatar/motion/fingers.py):

    elbow flexion      turns +x forward (+z): about -y
    forearm pronation  about +x
    knee flexion       turns -y backward (-z): about +x
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from avatar.body import builtin_body
from avatar.motion.amass import write_amass
from avatar.motion.clip import Clip
from avatar.motion.fingers import HAND_RELAXED, MIRROR, hand_pose
from avatar.motion.read import MOTIONS_FOLDER
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, LEFT_HAND, RIGHT_HAND

Array = np.ndarray

RATE = 30.0
J = {name: index for index, name in enumerate(JOINTS)}

# An arm: upper arm direction (3), where the forearm goes as the elbow bends (3), elbow, pronation, wrist
# flexion, wrist deviation towards the thumb (radians)
ARM_DOWN = np.array([0.20, -0.97, 0.00, -0.25, 0.00, 0.95, 0.32, 0.15, 0.05, 0.00])
ARM_COUNTING = np.array([0.42, -0.80, 0.44, 0.10, 0.50, 0.86, 1.85, 1.30, -0.15, 0.00])
ARM_WAVING = np.array([0.86, -0.40, 0.22, 0.12, 0.90, 0.40, 1.75, 0.10, -0.10, 0.00])
# A hand: curl of index, middle, pinky, ring, thumb (0 straight, 1 closed), spread (radians between neighbours)
HAND_OPEN = np.array([0.02, 0.00, 0.04, 0.02, -0.10, 0.13])
HAND_FIST = np.array([1.06, 1.08, 1.06, 1.08, 0.85, -0.10])


def nearest_axis_angle(axis_angle: Float[Array, "*b 3"], reference: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """The vector of the same rotation that lies closest to `reference` (v + 2 pi n axis).

    Keeps a sequence continuous where the angle passes pi: near pi the two signs of the axis are almost the
    same rotation, and a filter or a plot would jump by 2 pi between neighbouring frames.
    """
    v, r = np.asarray(axis_angle, np.float64), np.asarray(reference, np.float64)
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    length = np.linalg.norm(r, axis=-1, keepdims=True)
    reference_axis = r / np.where(length > 0, length, 1.0)
    axis = np.where(angle > 1e-12, v / np.where(angle > 1e-12, angle, 1.0), reference_axis)
    turns = np.round((np.sum(r * axis, -1, keepdims=True) - angle) / (2 * np.pi))
    return v + 2 * np.pi * turns * axis


def minimum_jerk(t: Array | float) -> Array | float:
    """Minimum-jerk ease from 0 to 1 (Flash and Hogan 1985): 10 t^3 - 15 t^4 + 6 t^5."""
    t = np.clip(t, 0, 1)
    return t * t * t * (10 + t * (6 * t - 15))


def keyed(keys: Sequence[tuple[float, Array]]) -> Callable[[float], Array]:
    """A curve through (time, value) that rests at each key."""
    times = [t for t, _ in keys]

    def at(time: float) -> Array:
        k = int(np.searchsorted(times, time, side="right")) - 1
        if k < 0 or k == len(keys) - 1:
            return keys[min(max(k, 0), len(keys) - 1)][1]
        part = minimum_jerk((time - times[k]) / (times[k + 1] - times[k]))
        return keys[k][1] + part * (keys[k + 1][1] - keys[k][1])

    return at


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v)


def _frame(first: Array, second: Array) -> Float[Array, "3 3"]:
    """Rotation with columns `first`, `second` made orthogonal to it, and their cross product."""
    a = _unit(first)
    b = _unit(second - a * (a @ second))
    return np.stack([a, b, np.cross(a, b)], -1)


def set_arm(pose: Float[Array, "52 3"], side: str, arm: Float[Array, "10"], chest: Float[Array, "3 3"]) -> None:
    """Collar, shoulder, elbow and wrist from an arm's description; `chest` is world_from_spine3.

    The collar takes a tenth of the raising of the arm above the horizontal T-pose, as shoulders do.
    """
    mirror = np.diag([-1.0, 1, 1]) if side == "right" else np.eye(3)
    chest = mirror @ chest @ mirror
    upper, bend, (elbow, pronation, wrist, deviation) = arm[:3], arm[3:6], arm[6:]
    shoulder = _frame(upper, bend) @ _frame(np.array([1.0, 0, 0]), np.array([0.0, 0, 1])).T
    lift = 0.12 * np.arctan2(upper[1], np.hypot(upper[0], upper[2]))
    collar = np.array([0, 0.12 * upper[2] * -1.0, lift])
    parts = {
        "collar": matrix_from_axis_angle(collar),
        "shoulder": (chest @ matrix_from_axis_angle(collar)).T @ shoulder,
        "elbow": matrix_from_axis_angle(np.array([0, -elbow, 0]))
        @ matrix_from_axis_angle(np.array([0.55 * pronation, 0, 0])),
        "wrist": matrix_from_axis_angle(np.array([0.45 * pronation, 0, 0]))
        @ matrix_from_axis_angle(np.array([0, -deviation, -wrist])),
    }
    for name, R in parts.items():
        v = axis_angle_from_matrix(R)
        pose[J[f"{side}_{name}"]] = v * MIRROR if side == "right" else v


def set_hands(pose: Float[Array, "52 3"], left: Float[Array, "6"], right: Float[Array, "6"]) -> None:
    pose[LEFT_HAND] = hand_pose(left)
    pose[RIGHT_HAND] = hand_pose(right) * MIRROR


def set_leg(
    pose: Float[Array, "52 3"],
    side: str,
    root: Float[Array, "3"],
    ankle: Float[Array, "3"],
    foot: Float[Array, "3 3"],
    toes: float = 0.0,
) -> None:
    """Two-bone IK: hip and knee so that the ankle joint reaches `ankle`, the foot turned to `foot`, both in world.

    The knee bends about its own x axis and points where the foot points; a target out of reach is approached
    to 1 mm of the stretched leg. `toes` bends the toe joint upwards, radians.
    """
    joints = builtin_body("male").joints
    hip, knee, end, toe = (J[f"{side}_{n}"] for n in ("hip", "knee", "ankle", "foot"))
    pelvis = matrix_from_axis_angle(pose[0])
    start = root + pelvis @ (joints[hip] - joints[0])
    thigh, shin = joints[knee] - joints[hip], joints[end] - joints[knee]
    reach = ankle - start
    length = min(float(np.linalg.norm(reach)), float(np.linalg.norm(thigh) + np.linalg.norm(shin)) - 0.001)
    # |thigh + Rx(angle) shin|^2 = length^2, of the form a cos + b sin = c
    a, b = thigh[1] * shin[1] + thigh[2] * shin[2], thigh[2] * shin[1] - thigh[1] * shin[2]
    c = (length**2 - thigh @ thigh - shin @ shin) / 2 - thigh[0] * shin[0]
    angle = float(np.arctan2(b, a) + np.arccos(np.clip(c / np.hypot(a, b), -1, 1)))
    bend = matrix_from_axis_angle(np.array([angle, 0, 0]))
    forward = np.array([0.0, 0, 1])
    rest = _frame(thigh + bend @ shin, forward)
    G_hip = _frame(reach, foot @ forward) @ rest.T
    pose[hip] = axis_angle_from_matrix(pelvis.T @ G_hip)
    pose[knee] = [angle, 0, 0]
    pose[end] = axis_angle_from_matrix((G_hip @ bend).T @ foot)
    pose[toe] = [-toes, 0, 0]


def _chest(pose: Float[Array, "52 3"]) -> Float[Array, "3 3"]:
    R = matrix_from_axis_angle(pose[0])
    for name in ("spine1", "spine2", "spine3"):
        R = R @ matrix_from_axis_angle(pose[J[name]])
    return R


def _standing() -> tuple[float, dict[str, Array]]:
    """Pelvis height with straight legs on the ground at 0, and the ankles' places under it."""
    body = builtin_body("male")
    height = float(-body.vertices[:, 1].min())
    return height, {side: body.joints[J[f"{side}_ankle"]] + [0, height, 0] for side in ("left", "right")}


def counting() -> Clip:
    """Ten seconds, standing: wave with the right hand, count to ten on both hands, lower the arms."""
    height, ankles = _standing()
    right_arm = keyed([(0.3, ARM_DOWN), (1.1, ARM_WAVING), (2.5, ARM_WAVING), (3.2, ARM_COUNTING),
                       (8.9, ARM_COUNTING), (9.8, ARM_DOWN)])  # fmt: skip
    left_arm = keyed([(2.4, ARM_DOWN), (3.3, ARM_COUNTING), (8.9, ARM_COUNTING), (9.8, ARM_DOWN)])
    # seconds: the first count, between counts, of a finger's way
    first, beat, move = 3.4, 0.52, 0.26

    def hand_keys(start: float, before: list[tuple[float, Array]]) -> Callable[[float], Array]:
        keys, hand = list(before), HAND_FIST.copy()
        keys.append((start - 0.05, hand.copy()))
        # index, middle, ring, pinky, thumb
        for n, finger in enumerate((0, 1, 3, 2, 4)):
            keys.append((start + n * beat, hand.copy()))
            hand[finger] = HAND_OPEN[finger]
            if n == 4:
                hand[5] = HAND_OPEN[5]
            elif n:
                hand[5] = 0.06
            keys.append((start + n * beat + move, hand.copy()))
        return keyed([*keys, (8.9, hand.copy()), (9.7, HAND_RELAXED)])

    right_hand = hand_keys(first, [(0.3, HAND_RELAXED), (1.1, HAND_OPEN), (2.5, HAND_OPEN)])
    left_hand = hand_keys(first + 5 * beat, [(2.4, HAND_RELAXED), (3.2, HAND_FIST)])
    look = keyed(
        [
            (0.0, np.array([0.0, 0, 0])),
            (0.9, np.array([0.03, -0.12, 0.04])),
            (2.5, np.array([0.02, -0.08, -0.04])),
            (3.4, np.array([0.14, -0.22, 0.0])),
            (6.0, np.array([0.14, -0.20, 0.02])),
            (6.5, np.array([0.14, 0.20, -0.02])),
            (8.8, np.array([0.10, 0.16, 0])),
            (9.6, np.array([0.0, 0, 0])),
        ]
    )

    poses, roots = [], []
    for frame in range(300):
        t = frame / RATE
        pose = np.zeros((52, 3))
        sway, breath = np.sin(2 * np.pi * t / 5), np.sin(2 * np.pi * t / 2.5)
        root = np.array([0.018 * sway, height - 0.012 + 0.002 * breath, 0.004 * breath])
        pose[0] = [0.0, 0.03 * sway, -0.015 * sway]
        pose[J["spine1"]] = [0.015, -0.01 * sway, 0.02 * sway]
        pose[J["spine2"]] = [0.01 + 0.008 * breath, -0.015 * sway, 0.015 * sway]
        pose[J["spine3"]] = [-0.01 - 0.008 * breath, 0, 0]
        turned = look(t)
        pose[J["neck"]], pose[J["head"]] = 0.45 * turned, 0.55 * turned
        wave = minimum_jerk((t - 1.0) / 0.3) * minimum_jerk((2.6 - t) / 0.3) * np.sin(2 * np.pi * (t - 1.0) / 0.5)
        right = right_arm(t) + np.array([0, 0, 0, 0, 0, 0, 0.26, 0, 0, 0.22]) * wave
        accent = sum(np.exp(-(((t - first - k * beat - 0.13) / 0.1) ** 2)) for k in range(10))
        left = left_arm(t).copy()
        # the counting hand nods a little with each number
        if 3.3 < t < 8.9:
            (right if t < first + 5 * beat else left)[6] += 0.05 * accent
        chest = _chest(pose)
        set_arm(pose, "left", left, chest)
        set_arm(pose, "right", right, chest)
        set_hands(pose, left_hand(t), right_hand(t))
        for side, turn in (("left", 0.12), ("right", -0.12)):
            set_leg(pose, side, root, ankles[side], matrix_from_axis_angle(np.array([0, turn, 0])))
        poses.append(pose)
        roots.append(root)
    return Clip(np.array(poses), np.array(roots), RATE, (), height)


def walking() -> Clip:
    """Eight seconds: once round a circle, eight strides, arms swinging, loose fingers; ends where it began."""
    height, ankles = _standing()
    radius, duration, strides, stance = 1.1, 8.0, 8, 0.62
    stride = duration / strides
    lateral = 0.075
    ankle_height = {side: ankles[side][1] for side in ankles}
    ball, heel = np.array([0.0, -0.065, 0.135]), np.array([0.0, -0.07, -0.055])  # from the ankle joint

    def place(t: float) -> tuple[Array, float]:
        """Point below the pelvis and heading; the circle runs to the subject's left, back to the start."""
        heading = 2 * np.pi * t / duration
        return np.array([radius - radius * np.cos(heading), 0, radius * np.sin(heading)]), heading

    def turn(y: float) -> Array:
        return matrix_from_axis_angle(np.array([0, y, 0]))

    pitch_at = keyed(
        [
            (0.0, np.array([-0.30])),
            (0.12, np.array([0.0])),
            (0.36, np.array([0.0])),
            (stance, np.array([0.80])),
            (stance + 0.12, np.array([0.65])),
            (0.93, np.array([-0.30])),
            (1.0, np.array([-0.30])),
        ]
    )

    def foot_at(side: str, t: float) -> tuple[Array, Array, float]:
        """Ankle place, foot rotation and toe bend of one foot."""
        sign = 1.0 if side == "left" else -1.0
        phase = t / stride + (0.0 if side == "left" else 0.5)
        step, part = np.floor(phase), phase % 1

        def planted(step: float, pitch: float) -> tuple[Array, Array]:
            middle = (step + stance / 2 - (0.0 if side == "left" else 0.5)) * stride
            point, heading = place(middle)
            flat = turn(heading + 0.10 * sign)
            at = point + turn(heading) @ np.array([lateral * sign, 0, -0.01]) + [0, ankle_height[side], 0]
            foot = flat @ matrix_from_axis_angle(np.array([pitch, 0, 0]))
            pivot = ball if pitch > 0 else heel
            return at + flat @ pivot - foot @ pivot, foot

        pitch = float(pitch_at(part)[0])
        if part < stance:
            at, foot = planted(step, pitch)
            return at, foot, max(0.0, pitch) * 0.85
        s = (part - stance) / (1 - stance)
        a, _ = planted(step, float(pitch_at(stance)[0]))
        b, _ = planted(step + 1, float(pitch_at(0.0)[0]))
        # leaves and lands with the speed of the body, not at rest
        blend = 0.25 * s + 0.75 * float(minimum_jerk(s))
        at = a + blend * (b - a) + [0, 0.05 * np.sin(np.pi * s) ** 2, 0]
        (_, h0), (_, h1) = place(0.0), place(stride)
        heading = place((step + stance / 2 - (0.0 if side == "left" else 0.5)) * stride)[1] + blend * (h1 - h0)
        foot = turn(heading + 0.10 * sign) @ matrix_from_axis_angle(np.array([pitch, 0, 0]))
        return at, foot, max(0.0, pitch) * 0.85 * (1 - float(minimum_jerk(4 * s)))

    poses, roots = [], []
    for frame in range(int(duration * RATE)):
        t = frame / RATE
        # 0 as the left heel touches
        phase = 2 * np.pi * t / stride
        point, heading = place(t)
        pose = np.zeros((52, 3))
        # over the standing foot: the left one in the first half
        shift = 0.022 * np.sin(phase - 0.35)
        root = point + turn(heading) @ np.array([shift, 0, 0])
        root[1] = height - 0.024 - 0.012 * np.cos(2 * phase - 0.5)
        yaw, roll = 0.10 * np.cos(phase), 0.035 * np.sin(phase)
        # the left foot is ahead at phase 0: the pelvis turns its left side forward (about -y)
        pose[0] = axis_angle_from_matrix(turn(heading - yaw) @ matrix_from_axis_angle(np.array([0.04, 0, roll])))
        pose[J["spine1"]] = [0.01, 0.6 * yaw, -0.5 * roll]
        pose[J["spine2"]] = [0.01, 0.7 * yaw, -0.5 * roll]
        pose[J["spine3"]] = [0.0, 0.5 * yaw, -0.3 * roll]
        pose[J["neck"]] = [-0.02, -0.3 * yaw + 0.06, 0.1 * roll]
        pose[J["head"]] = [-0.03, -0.4 * yaw + 0.10, 0.1 * roll]
        local = turn(heading)
        chest = local.T @ _chest(pose)
        for side, sign in (("left", -1.0), ("right", 1.0)):
            # the arm goes forward with the other leg
            swing = sign * np.cos(phase + 0.2)
            arm = ARM_DOWN.copy()
            arm[:3] = [0.20, -0.97, 0.36 * swing + 0.02]
            arm[6] = 0.38 + 0.20 * swing
            arm[8] = 0.05 - 0.08 * np.sin(phase) * sign
            set_arm(pose, side, arm, chest)
        # the fingers close and open in a slow wave, little finger first
        for k in range(2):
            wave = 0.5 - 0.5 * np.cos(2 * np.pi * (t / 4 + 0.25 * k) - np.array([0.9, 0.6, 0.0, 0.3, 1.0, 0.0]))
            hand = HAND_RELAXED + np.array([0.35, 0.38, 0.40, 0.40, 0.30, 0.0]) * wave
            fingers = hand_pose(hand)
            pose[(LEFT_HAND, RIGHT_HAND)[k]] = fingers * (MIRROR if k else 1)
        for side in ("left", "right"):
            ankle, foot, toes = foot_at(side, t)
            set_leg(pose, side, root, ankle, foot, toes)
        # a full circle: past half a turn the vector grows on instead of changing its sign
        if poses:
            pose[0] = nearest_axis_angle(pose[0], poses[-1][0])
        poses.append(pose)
        roots.append(root)
    return Clip(np.array(poses), np.array(roots), RATE, (), height)


AUTHORED: dict[str, Callable[[], Clip]] = {"counting": counting, "walking": walking}


def main() -> None:
    for name, author in AUTHORED.items():
        clip = author()
        write_amass(MOTIONS_FOLDER / f"{name}.npz", clip, up="y", dtype=np.float32)
        print(f"{MOTIONS_FOLDER / name}.npz: {len(clip.root)} frames at {clip.rate:g} per second")


if __name__ == "__main__":
    main()
