"""Other people's skeletons: what a reader of animated rigs provides, and which of its joints are ours, by name."""

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from command.errors import AssetError

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
FINGER_NAMES = {"index": ("index",), "middle": ("middle", "mid"), "pinky": ("pinky", "little"), "ring": ("ring",),
                "thumb": ("thumb",)}  # fmt: skip
REQUIRED = ("hip", "knee", "ankle", "shoulder", "elbow")
# rotations of joints and their places
PlacedJoints = tuple[Float[np.ndarray, "frames joints 3 3"], Float[np.ndarray, "frames joints 3"]]


@dataclass(frozen=True, kw_only=True)
class AnimatedRig(ABC):
    """An animated skeleton in its own units and axes: a BVH file (avatar/motion/bvh.py), a glTF animation
    (avatar/motion/gltf.py), MHR (avatar/motion/mhr_rig.py).
    """

    path: Path
    names: tuple[str, ...]
    # -1 for a root; parents come first
    parents: tuple[int, ...]
    # where joints without a child end: joint, offset from it
    ends: tuple[tuple[int, tuple[float, float, float]], ...] = ()
    frames: int
    rate: float  # frames per second

    @property
    @abstractmethod
    def rest_positions(self) -> Float[np.ndarray, "joints 3"]:
        """Places of the joints at rest, in the file's units."""

    @abstractmethod
    def transforms(self, frames: Int[np.ndarray, "frames"]) -> PlacedJoints:
        """Turn of each joint away from its rest pose, and its place, in the file's world."""


def runs(frames: Int[np.ndarray, "frames"]) -> list[tuple[int, int]]:
    """Neighbouring frames together, the first and the one past the last of each run."""
    together = np.split(frames, np.flatnonzero(np.diff(frames) != 1) + 1)
    return [(int(run[0]), int(run[-1]) + 1) if len(run) else (0, 0) for run in together]


@dataclass(frozen=True)
class JointMap:
    """Which joints of a rig are ours."""

    # our joint name -> the rig's joint that turns it
    turns: dict[str, int]
    # our joint name -> the rig's joint that places it
    places: dict[str, int]
    # names of ours that the rig does not have
    absent: tuple[str, ...]
    pelvis: int
    # above the pelvis, up to the joint that both shoulders hang on
    spine: tuple[int, ...]
    # between that one and the head
    neck: tuple[int, ...]

    @property
    def head(self) -> int:
        return self.turns["head"]

    @property
    def chest(self) -> int:
        return self.spine[-1] if self.spine else self.pelvis


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


def find_joints(rig: AnimatedRig) -> JointMap:
    """Our joints in a rig, by the names that exporters use.

    Raises:
        AssetError: hips, knees, ankles, shoulders, elbows or head are not found, or hang on nothing together.
    """
    by_side: dict[str, dict[str, int]] = {"left": {}, "right": {}, "": {}}
    for index, name in enumerate(rig.names):
        # MakeHuman's helper joints, named as the joints they lead to
        if not name.startswith("__"):
            side, base = side_and_base(name)
            by_side[side].setdefault(base, index)
    turns, places, absent = dict[str, int](), dict[str, int](), list[str]()
    for side in ("left", "right"):
        have, used = by_side[side], set[str]()
        for ours, aliases in LIMB_NAMES.items():
            key, found = f"{side}_{ours}", next((a for a in aliases if a in have and a not in used), "")
            if not found:
                absent.append(key)
            else:
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
    pelvis = _common(rig, turns["left_hip"], turns["right_hip"])
    chest = _common(rig, turns["left_shoulder"], turns["right_shoulder"])
    line = _ancestors(rig, chest)
    spine = line[line.index(pelvis) + 1 :] if pelvis in line else line[1:]
    above = _ancestors(rig, head)
    neck = above[above.index(chest) + 1 : -1] if chest in above else []
    return JointMap(turns, places, tuple(absent), pelvis, tuple(spine), tuple(neck))


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
        names = f"{rig.names[a]} and {rig.names[b]}"
        raise AssetError(f"{rig.path}: {names} should hang on one joint, have none above both")
    return shared[-1]
