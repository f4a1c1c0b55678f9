"""The Virtual Motion Capture protocol (V3.1): bones over OSC, to and from our 52 joints, fingers included.

`/VMC/Ext/Bone/Pos` gives each bone's local pose under its Unity name. Unity is left-handed, +y up, facing +z;
we are right-handed, so x is mirrored and left stays left:

    p' = (-x, y, z)        q' = (x, -y, -z, w)

Bones that a sender lacks (often UpperChest) stay at rest; jaw and unknown names are ignored. The pelvis is
root pose times Hips pose. A sender's bones are taken as normalised (identity in T-pose, as VRM 0) until
`calibration` says otherwise.

`/VMC/Ext/Blend/Val` gives a value under an expression's name (avatar/face_names.py), as often as a sender likes;
`/VMC/Ext/Blend/Apply` shows what came since the last one, and values hold until they are sent again. Eyes look where
both eyes' bones turn, where they are sent and turn at all, else where the eyeLook* shapes say.
"""

from collections import deque
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.face import SHAPES, FaceFrame
from avatar.face_names import shapes_called, weights_of
from avatar.gaze import angles_of, within_reach
from avatar.rotation import matrix_from_quaternion, quaternion_from_axis_angle
from avatar.skeleton import PARENTS
from player.draw.drawing import Pose
from player.live.face_sender import sent_face
from player.live.frame import RESTART, Counters, Decoded
from player.live.osc import LARGEST, Message, build_bundle, build_message, parse_packet

# datagrams, to know a repeated one
REMEMBERED = 16
# names of expressions that are held
MOST_VALUES = 256

_BODY = (
    "Hips LeftUpperLeg RightUpperLeg Spine LeftLowerLeg RightLowerLeg Chest LeftFoot RightFoot UpperChest "
    "LeftToes RightToes Neck LeftShoulder RightShoulder Head LeftUpperArm RightUpperArm LeftLowerArm RightLowerArm "
    "LeftHand RightHand"
).split()
_PARTS = ("Proximal", "Intermediate", "Distal")
_FINGERS = [finger + part for finger in ("Index", "Middle", "Little", "Ring", "Thumb") for part in _PARTS]
# UnityEngine.HumanBodyBones in the order of our joints
BONES = (*_BODY, *(side + finger for side in ("Left", "Right") for finger in _FINGERS))
_JOINT = {name.lower(): joint for joint, name in enumerate(BONES)}
_LEGS = [(1, 4, 7), (2, 5, 8)]

Bone = tuple[float, ...]  # seven: position xyz, rotation xyzw, as sent
Blend = tuple[str, float] | None  # an expression's value; None: those since the last time are shown

# VRM 1 calls the thumb's bones metacarpal, proximal, distal
_THUMBS = {"leftthumbmetacarpal": 34, "leftthumbproximal": 35, "rightthumbmetacarpal": 49, "rightthumbproximal": 50}
# lower-case names to joints: without and with those thumbs
JOINT_OF = {False: _JOINT, True: _JOINT | _THUMBS}
EYES = ("lefteye", "righteye")
KNOWN = frozenset(JOINT_OF[True]) | {*EYES}
# messages in which a mistake is said; all others that are not known are passed over
EXPECTED = ("/VMC/Ext/Bone/Pos", "/VMC/Ext/Root/Pos", "/VMC/Ext/Blend/Val", "/VMC/Ext/T")


class VmcState(NamedTuple):
    """The newest pose of every bone that the sender has sent, by lower-case name, in Unity's axes."""

    bones: dict[str, Bone]
    root: Bone | None
    face: FaceFrame | None = None


class VmcRig(NamedTuple):
    """A state in our axes and order, not yet normalised."""

    rotations: Float[Array, "52 4"]  # parent_from_bone
    hips: Float[Array, "3"]  # in the root's frame
    root_rotation: Float[Array, "4"]
    root: Float[Array, "3"]
    # metres from the pelvis' height to the ankle, along the bones
    leg: float | None
    # parent_from_bone of the left and of the right one; None: not sent
    eyes: Float[Array, "2 4"] | None = None


class VmcDecoder:
    """Datagrams to states. A frame may be cut into several datagrams: a bone seen again begins the next frame; so does
    a face where no bone ever came."""

    largest = LARGEST

    def __init__(self):
        self.bones: dict[str, Bone] = {}
        self.root: Bone | None = None
        self.seen: set[str] = set()  # in the frame that is being filled
        self.clock: float | None = None  # the sender's, newest
        self.frame_clock: float | None = None
        self.clock_is_new = False
        self.recent: deque[int] = deque(maxlen=REMEMBERED)
        self.tracking = True
        # expressions as they were sent, and the face that they were applied to
        self.values: dict[str, float] = {}
        self.face: FaceFrame | None = None

    def decode(self, data: bytes | str, _received: float | int, counters: Counters) -> Decoded | None:
        """The state after this datagram; None where it held no bone and no face or is not used (see the counters)."""
        assert isinstance(data, bytes)
        clock, found, root, blends, bad = self._read(parse_packet(data))
        if clock is not None and self._is_old(data, clock, counters):
            return None
        restarted = clock is not None and self.clock is not None and clock < self.clock - RESTART
        if clock is not None:
            self.clock, self.clock_is_new = clock, True
        if bad:
            counters.malformed += 1
        names = set(found) | ({"root"} if root else set())
        if not self._blended(blends) and not names:
            return None
        begins = not self.seen or not self.seen.isdisjoint(names)
        if begins:
            self.seen = names
            self.frame_clock = self.clock if self.clock_is_new else None
        else:
            self.seen |= names
            self.frame_clock = clock if clock is not None else self.frame_clock
        self.clock_is_new = False
        self.bones.update(found)
        self.root = root or self.root
        return Decoded(VmcState(dict(self.bones), self.root, self.face), begins, self.frame_clock, restarted)

    def _read(self, messages: list[Message]) -> tuple[float | None, dict[str, Bone], Bone | None, list[Blend], bool]:
        clock, found, root, blends, bad = None, {}, None, [], False
        for message in messages:
            match message:
                case ("/VMC/Ext/Bone/Pos", (str(name), *numbers)) if pose := _pose(numbers):
                    if name.lower() in KNOWN:
                        found[name.lower()] = pose
                case ("/VMC/Ext/Root/Pos", (str(), *numbers)) if pose := _pose(numbers):
                    root = pose
                case ("/VMC/Ext/Blend/Val", (str(name), int() | float() as value, *_)) if abs(value) < 1e6:
                    blends.append((name, float(value)))
                case ("/VMC/Ext/Blend/Apply", _):
                    blends.append(None)
                case ("/VMC/Ext/T", (int() | float() as seconds, *_)) if abs(seconds) < 1e12:
                    clock = float(seconds)
                case ("/VMC/Ext/OK", arguments):
                    numbers = [value for value in arguments if isinstance(value, int)]
                    self.tracking = bool(numbers and numbers[0]) and (len(numbers) < 4 or numbers[3] != 0)
                case (address, _):
                    bad |= address in EXPECTED
        return clock, found, root, blends, bad

    def _blended(self, blends: list[Blend]) -> bool:
        """Hold what was sent of expressions; whether they were applied to the face. Unknown names are not held."""
        applied = False
        for blend in blends:
            if blend is None:
                if self.values:
                    self.face, applied = sent_face(weights_of(self.values)), True
            elif shapes_called(blend[0]) is not None and (blend[0] in self.values or len(self.values) < MOST_VALUES):
                self.values[blend[0]] = min(max(blend[1], 0.0), 1.0)
        return applied

    def _is_old(self, data: bytes, clock: float, counters: Counters) -> bool:
        """Whether a datagram with a clock came before, or belongs before what was used already."""
        key = hash(data)
        if key in self.recent:
            counters.duplicate += 1
            return True
        if self.clock is not None and self.clock - RESTART <= clock < self.clock:
            counters.late += 1
            return True
        self.recent.append(key)
        return False


def _pose(numbers: list[float]) -> Bone | None:
    """The first seven numbers, where they are finite and their rotation is one; else None."""
    pose = tuple(map(float, numbers[:7]))
    # false for NaN
    sound = len(pose) == 7 and sum(map(abs, pose)) < 1e6 and sum(value * value for value in pose[3:]) > 1e-6
    return pose if sound else None


def gaze_of_eyes(turns: Float[Array, "2 4"]) -> Float[Array, "2 2"] | None:
    """The gaze of the eyes' bones; None where they do not turn."""
    if np.abs(turns[:, :3]).max() < 1e-6:
        return None
    return within_reach(np.stack([angles_of(ahead) for ahead in matrix_from_quaternion(turns)[:, :, 2]]))


def rig_from_state(state: VmcState) -> VmcRig:
    """The state in our axes: x mirrored, bones in the order of our joints."""
    vrm1 = any(name.endswith("thumbmetacarpal") for name in state.bones)
    poses = np.zeros((52, 7))
    poses[:, 6] = 1
    for name, pose in state.bones.items():
        joint = JOINT_OF[vrm1].get(name)
        if joint is not None:
            poses[joint] = pose
    root = np.array(state.root if state.root else (0, 0, 0, 0, 0, 0, 1), np.float64)
    mirror = np.array([-1, 1, 1, 1, -1, -1, 1.0])
    poses, root = poses * mirror, root * mirror
    rotations = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    turn, leg, eyes = root[3:] / np.linalg.norm(root[3:]), leg_length(poses[:, :3]), None
    if all(name in state.bones for name in EYES):
        eyes = np.array([state.bones[name][3:] for name in EYES]) * mirror[3:]
        eyes /= np.linalg.norm(eyes, axis=1, keepdims=True)
    return VmcRig(rotations, poses[0, :3], turn, root[:3], leg, eyes)


def leg_length(offsets: Float[Array, "52 3"]) -> float | None:
    """Metres from pelvis to ankle: the hip's drop, thigh and shin, the mean of both legs.

    `offsets` are the joints from their parents. None where that is no leg (under 0.1 m or over 5 m): the sender
    leaves positions out.
    """
    legs = [
        abs(offsets[hip, 1]) + np.linalg.norm(offsets[knee]) + np.linalg.norm(offsets[ankle])
        for hip, knee, ankle in _LEGS
    ]
    length = float(np.mean(legs))
    return length if 0.1 < length < 5 else None


def joint_offsets(joints: Float[Array, "52 3"]) -> Float[Array, "52 3"]:
    """Rest positions of the joints from their parents; the pelvis' is zero."""
    offsets = np.zeros((52, 3))
    offsets[1:] = joints[1:] - joints[PARENTS[1:]]
    return offsets


class VmcEncoder:
    """Poses to bundles, one a frame: all bones of a frame arrive, or none. 52 bones are about 4 KB, a face 3."""

    def __init__(self, joints: Float[Array, "52 3"]):
        self.offsets = joint_offsets(joints) * [-1.0, 1, 1]
        self.heads = [build_message("/VMC/Ext/Bone/Pos", name, *[0.0] * 7)[:-28] for name in BONES]
        self.root = build_message("/VMC/Ext/Root/Pos", "root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        self.ok = build_message("/VMC/Ext/OK", 1, 3, 0, 1)

    def encode(self, pose: Pose, seconds: float | int) -> bytes:
        """The bundle of a pose; `seconds` is the sender's clock. A gaze is sent as the eyeLook* shapes say it."""
        positions = self.offsets.copy()
        positions[0] = pose.root * np.array([-1.0, 1, 1])
        rotations = quaternion_from_axis_angle(pose.axis_angle) * np.array([1.0, -1, -1, 1])
        numbers = np.concatenate([positions, rotations], 1).astype(">f4")
        bones = [head + row.tobytes() for head, row in zip(self.heads, numbers, strict=True)]
        blends = []
        if pose.face is not None:
            shapes = zip(SHAPES, pose.face.weights.tolist(), strict=True)
            blends = [build_message("/VMC/Ext/Blend/Val", name, weight) for name, weight in shapes]
            blends.append(build_message("/VMC/Ext/Blend/Apply"))
        return build_bundle([self.ok, build_message("/VMC/Ext/T", float(seconds)), self.root, *bones, *blends])
