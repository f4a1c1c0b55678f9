"""Poses that ship with the project, and a pose's file.

Built-in poses are written down as degrees of the joints' named angles (avatar/limits.py) and hand shapes. A file is a
motion of one frame: `selfscan render AVATAR --motion POSE.npz` plays it.
"""

from pathlib import Path

from jaxtyping import Float
from numpy import ndarray as Array

from avatar.limits import posed
from avatar.motion.amass import write_amass
from avatar.motion.clip import Clip, fitted
from avatar.motion.read import read_motion
from command.errors import AssetError
from player.pose.fingers import PRESETS, with_hand
from player.pose.history import Pose

Angles = dict[str, dict[str, float | int]]


def _both(part: str, **angles: float | int) -> Angles:
    named = {name.replace("_", " "): degrees for name, degrees in angles.items()}
    return {f"left_{part}": named, f"right_{part}": named}


def _one(joint: str, **angles: float | int) -> Angles:
    return {joint: {name.replace("_", " "): degrees for name, degrees in angles.items()}}


ARMS_DOWN = _both("shoulder", **{"raise": -72, "forwards": 4}) | _both("elbow", flexion=14)
STANDING = ARMS_DOWN | _both("hip", rotation_outwards=8, abduction=3)

# angles and the hand shapes of left and right
BUILTIN: dict[str, tuple[Angles, str, str]] = {
    "T-pose": ({}, "flat", "flat"),
    "A-pose": (_both("shoulder", **{"raise": -45}), "relaxed", "relaxed"),
    "standing": (STANDING, "relaxed", "relaxed"),
    "hands on hips": (STANDING | _both("shoulder", **{"raise": -46, "forwards": -34, "rotation inwards": 48})
        | _both("elbow", flexion=104, palm_down=20) | _both("wrist", flexion=-25, palm_down=10),
        "relaxed", "relaxed"),
    "waving": (STANDING | _one("right_shoulder", **{"raise": -8, "forwards": 22, "rotation inwards": -75})
        | _one("right_elbow", flexion=105, palm_down=35) | _one("right_wrist", palm_down=30)
        | _one("head", bend_to_the_left=-6), "relaxed", "open"),
    "pointing": (STANDING | _one("right_shoulder", **{"raise": -8, "forwards": 82, "rotation inwards": 20})
        | _one("right_elbow", flexion=6) | _one("spine3", turn_to_the_left=8), "relaxed", "point"),
    "thumbs up": (STANDING | _one("right_shoulder", **{"raise": -62, "forwards": 30, "rotation inwards": -60})
        | _one("right_elbow", flexion=88, palm_down=-10), "relaxed", "thumbs up"),
    "victory": (STANDING | _both("collar", **{"raise": 15}) | _both("shoulder", **{"raise": 42, "forwards": 8})
        | _both("elbow", flexion=12) | _one("neck", bend_forward=-12), "peace", "peace"),
    "thinking": (STANDING | _one("right_shoulder", **{"raise": -58, "forwards": 48, "rotation inwards": 10})
        | _one("right_elbow", flexion=140, palm_down=10)
        | _one("left_shoulder", **{"raise": -62, "forwards": 30, "rotation inwards": 45})
        | _one("left_elbow", flexion=80) | _one("head", bend_forward=12, turn_to_the_left=-10), "relaxed", "fist"),
    "bowing": (STANDING | _both("hip", flexion=32, abduction=2) | _one("spine1", bend_forward=16)
        | _one("spine2", bend_forward=10) | _one("neck", bend_forward=14) | _one("pelvis", bend_forward=30),
        "relaxed", "relaxed"),
    "walking": (ARMS_DOWN | _one("left_hip", flexion=24) | _one("left_knee", flexion=6)
        | _one("left_ankle", toes_up=6) | _one("right_hip", flexion=-16) | _one("right_knee", flexion=22)
        | _one("right_ankle", toes_up=-12) | _one("right_foot", toes_up=30) | _one("spine3", turn_to_the_left=6)
        | _one("left_shoulder", **{"raise": -68, "forwards": -22})
        | _one("right_shoulder", **{"raise": -62, "forwards": 34}) | _one("right_elbow", flexion=28),
        "relaxed", "relaxed"),
    "running": (_one("pelvis", bend_forward=12) | _one("left_hip", flexion=70) | _one("left_knee", flexion=95)
        | _one("right_hip", flexion=-14) | _one("right_knee", flexion=26) | _one("right_ankle", toes_up=-28)
        | _one("right_foot", toes_up=40) | _one("spine3", turn_to_the_left=12)
        | _one("left_shoulder", **{"raise": -62, "forwards": -40}) | _one("left_elbow", flexion=85)
        | _one("right_shoulder", **{"raise": -55, "forwards": 48}) | _one("right_elbow", flexion=95)
        | _one("neck", bend_forward=-8), "fist", "fist"),
    "sitting": (_both("hip", flexion=88, abduction=6) | _both("knee", flexion=88)
        | _both("shoulder", **{"raise": -66, "forwards": 30, "rotation inwards": 25})
        | _both("elbow", flexion=42, palm_down=10) | _both("wrist", flexion=-8), "relaxed", "relaxed"),
    "squatting": (_one("pelvis", bend_forward=25) | _both("hip", flexion=112, abduction=16, rotation_outwards=14)
        | _both("knee", flexion=116) | _both("ankle", toes_up=27)
        | _both("shoulder", **{"raise": -12, "forwards": 74}) | _both("elbow", flexion=10)
        | _one("neck", bend_forward=-14), "flat", "flat"),
    "kneeling": (STANDING | _one("left_hip", flexion=88, abduction=4) | _one("left_knee", flexion=88)
        | _one("right_hip", flexion=0) | _one("right_knee", flexion=92) | _one("right_ankle", toes_up=10)
        | _one("right_foot", toes_up=60)
        | _one("left_shoulder", **{"raise": -66, "forwards": 30, "rotation inwards": 25})
        | _one("left_elbow", flexion=40), "relaxed", "relaxed"),
}  # fmt: skip


def builtin_pose(name: str) -> Float[Array, "52 3"]:
    """A built-in pose, facing +z.

    Raises:
        ValueError: there is none of that name.
    """
    if name not in BUILTIN:
        raise ValueError(f"no built-in pose {name!r}; there are {', '.join(BUILTIN)}")
    angles, left, right = BUILTIN[name]
    out = with_hand(posed(angles), "left", PRESETS[left])
    return with_hand(out, "right", PRESETS[right])


def write_pose(path: Path | str, pose: Pose, *, pelvis_height: float | None) -> None:
    """One pose as a motion of one frame, whole or not at all; z is up, as AMASS and its tools expect."""
    write_amass(path, Clip(pose.axis_angle[None], pose.root[None], 30.0, (), pelvis_height))


def read_pose(path: Path | str, *, pelvis_height: float | None = None) -> Pose:
    """The first frame of any pose file, the root scaled to a body whose pelvis stands at `pelvis_height`.

    Raises:
        AssetError: the file is no motion, is damaged, or has no frame.
    """
    motion = read_motion(path)
    if not motion.frames:
        raise AssetError(f"{path}: expected a pose, found no frame")
    if pelvis_height is not None:
        motion = fitted(motion, pelvis_height)
    clip = motion.read(0, 1)
    return Pose(clip.axis_angle[0], clip.root[0])
