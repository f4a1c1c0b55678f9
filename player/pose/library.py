"""The pose library: poses that ship with the project, and a folder of the user's own.

The user's poses are one-frame AMASS files in our own world (up_axis "y"), so that they come back to the last bit
and play like any motion: `selfscan render AVATAR --motion POSE.npz`. Built-in poses are written down as degrees of
the joints' named angles (avatar/limits.py) and hand shapes; they stand on the ground of whoever takes them.
"""

import os
from collections.abc import Callable
from pathlib import Path

from jaxtyping import Float
from numpy import ndarray as Array

from avatar.face import REST
from avatar.limits import posed
from avatar.motion.amass import write_amass
from avatar.motion.clip import Clip, fitted
from avatar.motion.read import read_motion
from command.errors import AssetError
from player.pose.fingers import PRESETS, with_hand
from player.pose.history import KeptPose

Angles = dict[str, dict[str, float | int]]

LONGEST_NAME = 80


def _both(part: str, **angles: float | int) -> Angles:
    return _one(f"left_{part}", **angles) | _one(f"right_{part}", **angles)


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


def user_folder() -> Path:
    """Where a user's poses are kept: $XDG_DATA_HOME/selfscan/poses, usually ~/.local/share/selfscan/poses."""
    data = os.environ.get("XDG_DATA_HOME", "")
    return (Path(data) if os.path.isabs(data) else Path.home() / ".local" / "share") / "selfscan" / "poses"


class Library:
    """Built-in poses and those of a folder, by name. The folder is made when the first pose is saved."""

    def __init__(self, folder: Path | str | None = None):
        self.folder = Path(folder) if folder is not None else user_folder()

    def names(self) -> list[str]:
        """The built-in poses, then the user's in alphabetical order; broken files are found when they are read."""
        own = sorted(
            (p.stem for p in self.folder.glob("*.npz") if not p.name.startswith(".") and p.is_file()), key=str.casefold
        )
        return [*BUILTIN, *(name for name in own if name not in BUILTIN)]

    def read(
        self,
        name: str,
        *,
        root: Float[Array, "3"],
        pelvis_height: float | None = None,
        ground: Callable[[Float[Array, "52 3"], Float[Array, "3"]], Float[Array, "3"]] | None = None,
    ) -> KeptPose:
        """The pose of that name.

        A built-in one stands where `root` is, put on the ground by `ground` (player/draw/posing.py). A user's own
        comes with the place it was saved at, its height scaled to `pelvis_height`.

        Raises:
            AssetError: there is none of that name, or its file is damaged.
        """
        if name in BUILTIN:
            axis_angle = builtin_pose(name)
            return KeptPose(axis_angle, root if ground is None else ground(axis_angle, root))
        if name not in self.names():
            raise AssetError(f"{self.folder}: no pose {name!r}; there are {', '.join(self.names())}")
        return read_pose(self.folder / f"{name}.npz", pelvis_height=pelvis_height)

    def write(self, name: str, pose: KeptPose, *, pelvis_height: float | None = None) -> Path:
        """Keep a pose under a name, in place of the user's pose that had it.

        Raises:
            ValueError: the name is a built-in pose's or cannot be a file's.
            AssetError: the folder cannot be written.
        """
        check_name(name)
        path = self.folder / f"{name}.npz"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise AssetError(f"{self.folder}: cannot be made: {error.strerror}") from None
        write_pose(path, pose, pelvis_height=pelvis_height, up="y")
        return path

    def delete(self, name: str) -> None:
        """Remove a pose of the user's own.

        Raises:
            ValueError: it is built in, or there is none.
        """
        check_name(name)
        path = self.folder / f"{name}.npz"
        if not path.is_file():
            raise ValueError(f"no pose {name!r} in {self.folder}")
        path.unlink()


def write_pose(path: Path | str, pose: KeptPose, *, pelvis_height: float | None, up: str = "z") -> None:
    """One pose as a motion of one frame, whole or not at all. up="z" is what AMASS and its tools expect, and is as
    exact as a quarter turn in double precision; up="y" keeps our world and comes back to the last bit."""
    face = (None, None) if pose.face is None else (pose.weights[None], pose.gaze[None])
    write_amass(path, Clip(pose.axis_angle[None], pose.root[None], 30.0, (), pelvis_height, *face), up=up)


def read_pose(path: Path | str, *, pelvis_height: float | None = None) -> KeptPose:
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
    face = clip.face_at(0) or REST
    return KeptPose(clip.axis_angle[0], clip.root[0], face.weights, face.gaze)


def check_name(name: str) -> None:
    """Refuse what cannot be the name of a pose of one's own, on any file system.

    Raises:
        ValueError: empty, too long, with characters that file systems reserve, ending in a dot or space, or built in.
    """
    reserved = set('/\\:*?"<>|')
    if not name.strip() or len(name) > LONGEST_NAME or name != name.strip() or name[0] == "." or name[-1] == ".":
        raise ValueError(f"a pose's name should be 1 to {LONGEST_NAME} letters without dots at its ends, is {name!r}")
    if any(c in reserved or ord(c) < 32 for c in name):
        raise ValueError(f"a pose's name should be without {' '.join(sorted(reserved))}, is {name!r}")
    if name.casefold() in {known.casefold() for known in BUILTIN}:
        raise ValueError(f"{name!r} is a built-in pose; choose another name")
