"""iFacialMocap (and Facemotion3D): ARKit's shapes as text over UDP.

    mouthSmile_R-0|eyeLookOut_L-12| ... |=head#rx,ry,rz,px,py,pz|rightEye#rx,ry,rz|leftEye#rx,ry,rz|

Names end in _L and _R, or are ARKit's own; values are whole hundredths after "-" (in later versions "&"). Angles are
degrees about ARKit's axes, which are ours: x to the person's left, y up, z forward; of eyes, those of a sample agree
with its eyeLook* values. The phone sends to the port of the machine that is named in the app.
"""

import numpy as np

from avatar.face import SHAPES
from avatar.face_names import shapes_called
from player.live.face_sender import SentFace, sent_face
from player.live.frame import MalformedError

ANGLES = ("=head", "rightEye", "leftEye")
# a frame has all the shapes, of which a version may lack one
FEWEST = 40


def parse_ifacialmocap(data: bytes) -> SentFace:
    """Read one datagram.

    Raises:
        MalformedError: no such text, cut short, or with numbers that are none.
    """
    weights, angles, known = np.zeros(len(SHAPES)), {}, 0
    try:
        for item in data.decode("ascii").strip("|\0\r\n ").split("|"):
            name, mark, numbers = item.partition("#")
            if mark:
                if name in ANGLES:
                    angles[name] = np.radians([float(number) for number in numbers.split(",")])[:3]
                continue
            name, mark, number = item.partition("&") if "&" in item else item.partition("-")
            shapes = shapes_called(name)
            if shapes is not None and len(shapes) == 1:
                weights[next(iter(shapes))] = float(number) / 100
                known += 1
    except ValueError as error:
        raise MalformedError(f"no text of iFacialMocap: {error}") from None
    # what is cut short lacks the head, which comes after the shapes
    head = angles.get("=head")
    if known < FEWEST or head is None or any(len(turn) != 3 or not np.isfinite(turn).all() for turn in angles.values()):
        raise MalformedError(f"expected {FEWEST} shapes and =head, found {known} and {sorted(angles)}")
    gaze = None
    if "leftEye" in angles and "rightEye" in angles:
        gaze = np.array([[turn[1], -turn[0]] for turn in (angles["leftEye"], angles["rightEye"])])
    pitch, yaw, roll = head.tolist()
    return SentFace(sent_face(weights, gaze), (yaw, pitch, roll))
