"""The four self-scan videos: where the person stands in every frame, and the camera that watches.

Every video has one camera that stands still in the world; the person turns, leans and moves the arm. World:
+y up, metres; all cameras look roughly along -z. Angles below are degrees unless a name says otherwise.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.camera import Camera, look_at
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, PARTS, joint_transforms
from files.whole import whole_file
from synth.photo import Studio
from synth.subject import SynthSubject

# metres: head and hands are framed so that a pixel is at most this
FINEST_PIXEL = 0.0019
# empty border round what is framed
MARGIN = 1.06


@dataclass(frozen=True)
class Shots:
    part: str
    axis_angle: Float[Array, "faces 52 3"]
    root: Float[Array, "faces 3"]  # pelvis joint in the world
    cameras: tuple[Camera, ...]


def rotation(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Float[Array, "3 3"]:
    """R_x R_y R_z of angles in degrees: z acts first."""
    about = [matrix_from_axis_angle(np.radians(angle) * axis) for angle, axis in zip((x, y, z), np.eye(3), strict=True)]
    return about[0] @ about[1] @ about[2]


def plan_videos(studio: Studio, frames: int, size: int) -> dict[str, Shots]:
    return {
        "body": _body_video(studio, frames, size),
        "head": _head_video(studio, frames, size),
        "hand_left": _hand_video(studio, "left", frames, size),
        "hand_right": _hand_video(studio, "right", frames, size),
    }


def frame_points(eye, target, points: Float[Array, "n 3"], size: int, finest: float | None = None) -> Camera:
    """A square camera at `eye` looking at `target` whose focal length just holds `points`.

    `finest`: metres that a pixel may cover at the target's distance; the focal length grows until it does not.
    """
    camera_from_world = look_at(eye, target)
    local = points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
    reach = MARGIN * np.abs(local[:, :2] / local[:, 2:]).max()
    focal = 0.5 * size / reach
    if finest is not None:
        focal = max(focal, np.linalg.norm(np.subtract(eye, target)) / finest)
    return Camera(np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]]), camera_from_world, (size, size))


def _body_video(studio: Studio, frames: int, size: int) -> Shots:
    """One turn about y in the T-pose, leaning 8 degrees to and fro so that shoulders and chin are seen too."""
    turn = 360 * np.arange(frames) / frames
    axis_angle = np.zeros((frames, 52, 3))
    axis_angle[:, 0] = axis_angle_from_matrix(
        np.stack([rotation(x=8 * np.sin(np.radians(3 * t))) @ rotation(y=t) for t in turn])
    )
    root = np.zeros((frames, 3))
    every = np.concatenate([studio.posed(axis_angle[i], root[i])[::5] for i in range(frames)])
    middle = (every.min(0) + every.max(0)) / 2
    camera = frame_points(middle + [0, 0.25, 3.2], middle, every, size)
    return Shots("body", axis_angle, root, (camera,) * frames)


def _head_video(studio: Studio, frames: int, size: int) -> Shots:
    """Two turns of the whole person, stiff in the T-pose, about the head's middle,
    which nods 20 degrees up and down.
    """
    subject = studio.subject
    head = head_points(subject)
    middle = (head.min(0) + head.max(0)) / 2
    turn = 720 * np.arange(frames) / frames
    nod = [head_nod(t) for t in turn]
    turned = np.stack([rotation(x=n) @ rotation(y=float(t)) for n, t in zip(nod, turn, strict=True)])
    axis_angle = np.zeros((frames, 52, 3))
    axis_angle[:, 0] = axis_angle_from_matrix(turned)
    root = -(turned @ middle)
    every = np.concatenate([(head[::7] - middle) @ R.T for R in turned])
    camera = frame_points([0, 0.05, 1.0], np.zeros(3), every, size, FINEST_PIXEL)
    return Shots("head", axis_angle, root, (camera,) * frames)


def head_points(subject: SynthSubject) -> Float[Array, "points 3"]:
    """What a close-up of the head holds, pose 0: the head without hair that hangs, and a collar below."""
    low_hair = subject.hair & (subject.vertices[:, 1] < subject.joints[JOINTS.index("neck"), 1])
    head = subject.vertices[(subject.part == PARTS.index("head")) & ~low_hair].astype(np.float64)
    # the neck is where parts are joined
    collar = head[head[:, 1] < np.quantile(head[:, 1], 0.2)] - [0, 0.04, 0]
    return np.concatenate([head, collar])


def head_nod(turn: float) -> float:
    """How far the head bows at a heading, degrees: the face is seen from below in the first turn and from above
    in the second; with an arm towards the camera it always bows, so that no hand passes before the face."""
    second = 0.5 - 0.5 * np.cos(np.radians(turn / 2))
    twice = np.cos(np.radians(2 * turn))
    return float((1 - second) * (-5 - 13 * twice) + second * (17.5 + 2.5 * twice))


def relaxed_fingers() -> Float[Array, "52 3"]:
    """A hand as one holds it up to look at: fingers a little spread and a little bent, thumb off the palm."""
    pose = np.zeros((52, 3))
    # +x runs along the left fingers and against the right ones: bends and spreads change sign with it
    for side, sign in (("left", 1), ("right", -1)):
        for finger, spread in {"index": -6, "middle": -1, "ring": 5, "pinky": 11, "thumb": -8}.items():
            first = JOINTS.index(f"{side}_{finger}1")
            pose[first, 1] = sign * np.radians(spread)
            if finger != "thumb":
                pose[first : first + 3, 2] = sign * np.radians([-6.0, -9.0, -6.0])
    return pose


def _hand_video(studio: Studio, side: str, frames: int, size: int) -> Shots:
    """The arm raised at the side; the hand turned twice about its length, fingertips towards the camera and away."""
    subject = studio.subject
    roll = 720 * np.arange(frames) / frames
    axis_angle = hand_poses(subject.joints.astype(np.float64), side, roll)
    root = hand_before_camera(axis_angle, subject.joints.astype(np.float64), side, roll)
    members = subject.part == PARTS.index(f"hand_{side}")
    every = np.concatenate([studio.posed(axis_angle[i], root[i])[members] for i in range(frames)])
    camera = frame_points([0, 0, 0.8], np.zeros(3), every, size, FINEST_PIXEL)
    return Shots(f"hand_{side}", axis_angle, root, (camera,) * frames)


def hand_poses(joints: Float[Array, "52 3"], side: str, roll: Float[Array, "frames"]) -> Float[Array, "frames 52 3"]:
    """The arm raised at the side, the hand rolled about its length by so many degrees, the other arm hanging."""
    sign = 1.0 if side == "left" else -1.0
    fingers = relaxed_fingers()
    number = {name: JOINTS.index(f"{side}_{name}") for name in ("shoulder", "elbow", "wrist", "middle3")}
    other = "right" if side == "left" else "left"
    fingers[JOINTS.index(f"{other}_shoulder")] = np.radians([0, 0, sign * 70])

    length = joints[number["middle3"]] - joints[number["wrist"]]
    along = length / np.linalg.norm(length)  # fingers, in the rest frame
    palm = np.array([0, -1.0, 0])
    palm -= (palm @ along) * along
    palm /= np.linalg.norm(palm)
    across = np.cross(along, palm)

    axis_angle = np.tile(fingers, (len(roll), 1, 1))
    for i, angle in enumerate(roll):
        # the camera as the hand sees it: round its length, 15 degrees up the fingers, +-35 to and fro
        lift = np.radians(15 + 35 * np.sin(np.radians(0.75 * angle + 30)))
        a = np.radians(angle)
        to_camera = np.cos(lift) * (np.cos(a) * palm + np.sin(a) * across) + np.sin(lift) * along
        hand = _turn_to(to_camera, along, np.array([sign * 0.25, 0.97, 0.0]))
        wrist = rotation(z=12 * np.sin(a + 1), y=8 * np.sin(2 * a))
        forearm = hand @ wrist.T
        upper = _shoulder_for(forearm, sign)
        axis_angle[i, number["shoulder"]] = axis_angle_from_matrix(upper)
        axis_angle[i, number["elbow"]] = axis_angle_from_matrix(upper.T @ forearm)
        axis_angle[i, number["wrist"]] = axis_angle_from_matrix(wrist)
    return axis_angle


def hand_before_camera(
    axis_angle: Float[Array, "frames 52 3"], joints: Float[Array, "52 3"], side: str, roll: Float[Array, "frames"]
) -> Float[Array, "frames 3"]:
    """Where the pelvis is when the person steps along so that the hand stays at the origin, within 1.5 cm."""
    middle = JOINTS.index(f"{side}_middle1")
    at = joint_transforms(axis_angle, joints, np.zeros((len(roll), 3)))[:, middle, :3, 3]
    drift = [np.sin(np.radians(roll)), np.cos(np.radians(1.5 * roll)), np.sin(np.radians(0.5 * roll))]
    return 0.015 * np.stack(drift, 1) - at


def _turn_to(to_camera, along, up) -> Float[Array, "3 3"]:
    """The rotation that points `to_camera` at +z and, of those, brings `along` nearest to `up` (in the image)."""
    z = to_camera / np.linalg.norm(to_camera)
    y = along - (along @ z) * z
    y /= np.linalg.norm(y)
    source = np.stack([np.cross(y, z), y, z], 1)
    image_up = up - up[2] * np.array([0, 0, 1.0])
    image_up /= np.linalg.norm(image_up)
    goal = np.stack([np.cross(image_up, [0, 0, 1.0]), image_up, [0, 0, 1.0]], 1)
    return goal @ source.T


def _shoulder_for(forearm: Float[Array, "3 3"], sign: float) -> Float[Array, "3 3"]:
    """A shoulder that holds the upper arm out to the side, twisted so that the elbow turns as little as it can."""
    twist = np.radians(np.arange(-90.0, 91.0, 5.0))
    twisted = matrix_from_axis_angle(twist[:, None] * [1.0, 0, 0])
    candidates = rotation(y=-sign * 15) @ rotation(z=-sign * 20) @ twisted
    elbow = np.linalg.norm(axis_angle_from_matrix(candidates.swapaxes(1, 2) @ forearm), axis=1)
    return candidates[np.argmin(elbow + 0.4 * np.abs(twist))]


def write_frames(
    path: Path,
    axis_angle: Float[Array, "frames 52 3"],
    root: Float[Array, "frames 3"],
    camera: Camera,
    present: Bool[Array, "frames"],
) -> None:
    """truth/PART/video.npz: the true pose and place of every frame, whether the person is in it, and the video's one
    camera."""
    with whole_file(path) as file:
        np.savez_compressed(
            file, poses=axis_angle, root=root, present=present, K=camera.K,
            camera_from_world=camera.camera_from_world, size=np.array(camera.size),
        )  # fmt: skip


def disturbed(shots: Shots, degrees: float, seed: int) -> Shots:
    """The same video with Gaussian noise on the poses as they are written (the pictures were taken without)."""
    if degrees == 0:
        return shots
    rng = np.random.default_rng([seed, PARTS.index(shots.part), 7])
    noise = np.radians(degrees) * rng.standard_normal(shots.axis_angle.shape)
    noisy = matrix_from_axis_angle(shots.axis_angle) @ matrix_from_axis_angle(noise)
    return replace(shots, axis_angle=axis_angle_from_matrix(noisy))
