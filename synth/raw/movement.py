"""Where the person stands in every frame of the raw videos.

As in synth/film.py, but as people are: an empty second, a step into the picture, a turn of uneven speed, a T-pose with
bent elbows that sags and sways, a neck that nods. One phone films all four: one focal length, other distances.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.camera import Camera, look_at
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, LEFT_HAND, PARTS, RIGHT_HAND, joint_transforms
from synth.film import frame_points, hand_before_camera, hand_poses, head_nod, head_points, relaxed_fingers, rotation
from synth.people.mesh import smoothstep
from synth.photo import Studio
from synth.subject import SynthSubject

# seconds without the person, and of stepping in
EMPTY, ENTERING = 1.0, 1.4
# metres between the camera and what fills its picture
NEAR = {"head": 0.75, "hand_left": 0.55, "hand_right": 0.55, "face": 0.5}
# the film of a face: its length over that of the turns, and its least, seconds
FACE_SHARE, FACE_LEAST = 0.5, 4.0
# degrees: standard deviation of what a joint keeps throughout, and of what comes and goes
HABIT = {
    "shoulder": 4, "elbow": 4, "wrist": 4, "hip": 1.5, "knee": 1.5, "spine": 1, "neck": 1.5, "head": 2, "collar": 1.5,
}  # fmt: skip
SWAY = {
    "shoulder": 1.6, "elbow": 1.5, "wrist": 2, "hip": 0.5, "knee": 0.6, "spine": 0.5, "neck": 0.8, "head": 1.0,
    "collar": 0.6,
}  # fmt: skip
FINGERS = (3.0, 1.2)
# metres that the pelvis moves to and fro
STEP = np.array([0.012, 0.003, 0.012])


@dataclass(frozen=True)
class RawShots:
    part: str
    axis_angle: Float[Array, "frames 52 3"]
    root: Float[Array, "frames 3"]
    # the same without sway: what light is found for
    steady: Float[Array, "frames 52 3"]
    camera: Camera
    present: Bool[Array, "frames"]  # false: the person has not stepped in yet
    floor: float  # height of the floor in this video's world, metres


class Wander:
    """Seeded smooth motions of mean 0 and deviation 1 over time: sums of slow sines."""

    def __init__(self, seed: list[int], times: Float[Array, "frames"]):
        self.rng, self.times = np.random.default_rng(seed), times

    def draw(self, *shape: int) -> Float[Array, "frames *shape"]:
        frequency = self.rng.uniform(0.08, 0.6, (4, *shape))
        phase = self.rng.uniform(0, 2 * np.pi, (4, *shape))
        at = self.times.reshape(-1, 1, *(1,) * len(shape))
        return np.sin(2 * np.pi * frequency * at + phase).sum(1) / np.sqrt(2)


def plan_raw_video(
    studio: Studio, part: str, size: tuple[int, int], seconds: float, rate: float, sway: float, seed: int
) -> RawShots:
    """One of the four raw videos of a subject; `seconds`: of the turn, after the empty second and the step in."""
    subject = studio.subject
    joints = subject.joints.astype(np.float64)
    times = np.arange(round((EMPTY + ENTERING + seconds) * rate)) / rate
    inside = np.clip((times - EMPTY) / ENTERING, 0, 1)
    # 0 to 1, and not at an even speed
    turning = np.clip((times - EMPTY - ENTERING) / seconds, 0, 1)
    turning = turning + 0.02 * np.sin(4 * np.pi * turning)
    camera = _body_camera(studio, size)
    steady = _steady_poses(joints, part, turning, inside)
    wander = Wander([seed, PARTS.index(part), 31], times)
    poses = _swayed(steady, wander, sway)
    root = _place(subject, part, poses, turning, inside) + sway * STEP * wander.draw(3)
    if part == "body":
        floor = float(subject.vertices[:, 1].min())
    else:
        camera = Camera(camera.K, look_at([0.0, 0.04, NEAR[part]], np.zeros(3)), size)
        floor = -1.3
    return RawShots(part, poses, root, steady, camera, times >= EMPTY, floor)


def plan_face_film(
    studio: Studio, size: tuple[int, int], seconds: float, rate: float, sway: float, seed: int
) -> RawShots:
    """The film of a face, whose person sits before the camera and looks into it; `seconds`: of the others' turns."""
    subject = studio.subject
    times = np.arange(round(max(FACE_LEAST, FACE_SHARE * seconds) * rate)) / rate
    rest, here = np.zeros_like(times), np.ones_like(times)
    steady = _steady_poses(subject.joints.astype(np.float64), "head", rest, here)
    steady[:, [JOINTS.index("neck"), JOINTS.index("head")]] = 0
    wander = Wander([seed, len(PARTS), 31], times)
    poses = _swayed(steady, wander, sway)
    root = _place(subject, "head", poses, rest, here) + sway * STEP * wander.draw(3)
    K = _body_camera(studio, size).K
    camera = Camera(K, look_at([0.0, 0.0, NEAR["face"]], np.zeros(3)), size)
    return RawShots("face", poses, root, steady, camera, here > 0, -1.3)


def _body_camera(studio: Studio, size: tuple[int, int]) -> Camera:
    """At chest height 3.2 metres off, so that the T-pose and 8 cm round it fill the shorter side."""
    headings = np.zeros((12, len(JOINTS), 3))
    headings[:, 0] = [axis_angle_from_matrix(rotation(y=15.0 * k)) for k in range(12)]
    every = np.concatenate([studio.posed(pose, np.zeros(3))[::5] for pose in headings])
    middle = (every.min(0) + every.max(0)) / 2
    square = frame_points(middle + [0, 0.2, 3.2], middle, middle + 1.08 * (every - middle), min(size))
    K = square.K.copy()
    K[:2, 2] = size[0] / 2, size[1] / 2
    return Camera(K, square.camera_from_world, size)


def _steady_poses(
    joints: Float[Array, "52 3"], part: str, turning: Float[Array, "frames"], inside: Float[Array, "frames"]
) -> Float[Array, "frames 52 3"]:
    if part.startswith("hand"):
        return hand_poses(joints, part.removeprefix("hand_"), 720 * turning)
    poses = np.tile(0.6 * relaxed_fingers(), (len(turning), 1, 1))

    def put(joint: str, axis: int, degrees: Array | int, mirrored: int) -> None:
        poses[:, JOINTS.index(f"left_{joint}"), axis] = np.radians(degrees)
        poses[:, JOINTS.index(f"right_{joint}"), axis] = mirrored * np.radians(degrees)

    if part == "body":
        # steps in with hanging arms, raises them, turns once
        heading = -60 * (1 - smoothstep(0.0, 1.0, inside)) + 360 * turning
        put("shoulder", 2, -(72 * (1 - smoothstep(0.0, 1.0, 2 * inside - 1)) + 4), -1)
        put("elbow", 1, -7, -1)
        put("hip", 2, 4, -1)
        # small steps: either knee lifts twice in a turn
        stride = 0.5 - 0.5 * np.cos(2 * np.pi * 4 * turning)
        for side, sign in (("left", 1), ("right", -1)):
            lifting = stride * (sign * np.sin(2 * np.pi * 2 * turning) > 0)
            poses[:, JOINTS.index(f"{side}_hip"), 0] += np.radians(-9 * lifting)
            poses[:, JOINTS.index(f"{side}_knee"), 0] += np.radians(16 * lifting)
    else:
        # sits on a swivel chair, turns twice, bows and lifts the chin once in a turn
        heading = 720 * turning
        put("shoulder", 2, -74, -1)
        put("hip", 0, -80, 1)
        put("knee", 0, 80, 1)
        bow = [0.5 * (head_nod(t) - 8) + 10 * np.sin(np.radians(t / 2)) for t in heading]
        poses[:, JOINTS.index("neck"), 0] = 0.4 * np.radians(bow)
        poses[:, JOINTS.index("head"), 0] = 0.6 * np.radians(bow)
    poses[:, 0] = [axis_angle_from_matrix(rotation(y=float(angle))) for angle in heading]
    return poses


def _place(
    subject: SynthSubject,
    part: str,
    poses: Float[Array, "frames 52 3"],
    turning: Float[Array, "frames"],
    inside: Float[Array, "frames"],
) -> Float[Array, "frames 3"]:
    """Where the pelvis is: what is filmed comes in from the side and stays before the camera."""
    joints = subject.joints.astype(np.float64)
    origin = np.zeros((len(poses), 3))
    if part == "body":
        origin[:, 0] = -3.6 * (1 - smoothstep(0.0, 1.0, 2 * inside))
        return origin
    if part == "head":
        points = head_points(subject)
        G = joint_transforms(poses, joints, origin)[:, JOINTS.index("head")]
        middle = (points.min(0) + points.max(0)) / 2 - joints[JOINTS.index("head")]
        origin = -(np.einsum("fij,j->fi", G[:, :3, :3], middle) + G[:, :3, 3])
    else:
        origin = hand_before_camera(poses, joints, part.removeprefix("hand_"), 720 * turning)
    origin[:, 0] += (-1.6 if part != "hand_right" else 1.6) * (1 - smoothstep(0.0, 1.0, inside))
    return origin


def _swayed(steady: Float[Array, "frames 52 3"], wander: Wander, sway: float) -> Float[Array, "frames 52 3"]:
    """Poses as a person holds them: with habits that stay and motions that come and go."""
    if sway == 0:
        return steady
    fingers = np.r_[LEFT_HAND, RIGHT_HAND]
    habit, moving = np.zeros((len(JOINTS), 1)), np.zeros((len(JOINTS), 1))
    for j, joint in enumerate(JOINTS):
        kind = joint.split("_")[-1].rstrip("123")
        habit[j], moving[j] = HABIT.get(kind, 0), SWAY.get(kind, 0)
    habit[fingers], moving[fingers] = FINGERS
    degrees = habit * wander.rng.standard_normal((len(JOINTS), 3)) + moving * wander.draw(len(JOINTS), 3)
    noise = matrix_from_axis_angle(np.radians(sway * degrees))
    return axis_angle_from_matrix(matrix_from_axis_angle(steady) @ noise)
