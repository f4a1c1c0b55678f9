"""Where the points that detectors name are on the free body: a joint, or vertices of its surface.

A vertex is found as the one nearest to a place in front of the face, at the ears, toes, heels or finger tips of the
male body; both sexes share their vertices. The jaw's points 0 to 16 slide along the outline as the head turns; only the
chin stays.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from avatar.body import builtin_body
from avatar.constant import constant
from avatar.skeleton import JOINTS
from avatar.skinning import dense_weights
from capture.keypoints.record import SIDES
from capture.template.eyes import body_sockets
from geometry.mesh import vertex_normals

HEAD = JOINTS.index("head")
# metres from the midline and height above the pelvis joint, on the male body: half a face, the person's left
JAW = (
    (0.070, 0.655), (0.069, 0.635), (0.067, 0.615), (0.063, 0.595), (0.056, 0.575), (0.045, 0.557), (0.031, 0.547),
    (0.016, 0.542), (0.0, 0.5415),
)  # fmt: skip
BROW = ((0.013, 0.668), (0.021, 0.673), (0.031, 0.675), (0.041, 0.673), (0.050, 0.667))
BRIDGE = ((0.0, 0.654), (0.0, 0.641), (0.0, 0.628), (0.0, 0.613))
NOSTRILS = ((0.012, 0.6075), (0.006, 0.6055), (0.0, 0.604))
# inner corner, upper lid, outer corner, lower lid
EYE = ((0.0225, 0.6535), (0.031, 0.6585), (0.040, 0.6585), (0.047, 0.6545), (0.040, 0.651), (0.031, 0.650))
# corner to middle: upper edge, lower edge, and the line between the lips
UPPER_LIP = ((0.026, 0.581), (0.015, 0.588), (0.006, 0.5905), (0.0, 0.5885))
LOWER_LIP = ((0.016, 0.575), (0.008, 0.5715), (0.0, 0.571))
BETWEEN_LIPS = ((0.023, 0.5815), (0.009, 0.584), (0.0, 0.584))
# iBUG's numbers of the left half, each list from the midline outwards or as above, and of its mirror image
NUMBERS = (
    (JAW, range(16, 7, -1), range(9)),
    (BROW, range(22, 27), range(21, 16, -1)),
    (BRIDGE, range(27, 31), range(27, 31)),
    (NOSTRILS, (35, 34, 33), (31, 32, 33)),
    (EYE, (42, 43, 44, 45, 46, 47), (39, 38, 37, 36, 41, 40)),
    (UPPER_LIP, (54, 53, 52, 51), (48, 49, 50, 51)),
    (LOWER_LIP, (55, 56, 57), (59, 58, 57)),
    (BETWEEN_LIPS, (64, 63, 62), (60, 61, 62)),
    (BETWEEN_LIPS[1:], (65, 66), (67, 66)),
)
# the midline of the mesh; what lies so far behind the surface beside it is inside of the head; metres
MIDDLE, BESIDE, BEHIND = 0.0018, 0.008, 0.02


class BodyPoint(NamedTuple):
    """One named point: it moves with `joint`, and lies at it (no vertices) or amid `vertices`."""

    joint: int
    vertices: Int[Array, "k"]

    def place(self, vertices: Float[Array, "vertices *c"], joints: Float[Array, "52 *c"]) -> Float[Array, "*c"]:
        """Where the point is for a body of these vertices and joints; also for their derivatives."""
        return vertices[self.vertices].mean(0) if len(self.vertices) else joints[self.joint]


@constant
def body_points() -> dict[str, BodyPoint]:
    """All named points that have a place on the body (capture/keypoints/record.py has the names)."""
    points = {name: BodyPoint(k, np.zeros(0, np.int64)) for k, name in enumerate(JOINTS) if k}
    for side in SIDES:
        points[f"{side}_hand"] = points[f"{side}_wrist"]
    for name, vertices in _surface_points().items():
        points[name] = BodyPoint(_joint_of(name), np.array(vertices))
    return points


def _joint_of(name: str) -> int:
    side = name.split("_")[0]
    if "toe" in name:
        return JOINTS.index(f"{side}_foot")
    if "heel" in name:
        return JOINTS.index(f"{side}_ankle")
    if name.endswith("_tip"):
        return JOINTS.index(name.replace("_tip", "3"))
    return HEAD


def _surface_points() -> dict[str, list[int]]:
    body = builtin_body("male")
    x = body.vertices
    weights = dense_weights(body.skin)
    normals = vertex_normals(x, body.faces)
    front = np.flatnonzero((weights[:, HEAD] > 0.5) & (normals[:, 2] > 0.1) & (x[:, 2] > 0.03))
    found: dict[str, list[int]] = {}
    left_rim, right_rim = (socket.rim for socket in body_sockets())
    for places, left, right in NUMBERS:
        for (across, height), of_left, of_right in zip(places, left, right):
            for number, sign in ((of_left, 1), (of_right, -1)):
                rim = left_rim if sign > 0 else right_rim
                among = rim if places is EYE else front
                # the nearest as seen from the front, where mouth and nostrils inside are hidden
                away = np.hypot(x[among, 0] - (MIDDLE + sign * across), x[among, 1] - height)
                outside = x[among, 2] > x[among[away < BESIDE], 2].max(initial=-1) - BEHIND
                away = np.where(outside, away, np.inf)
                found[f"face_{number:02d}"] = [int(among[away.argmin()])]
    found["nose"] = found["face_30"]
    head = np.flatnonzero(weights[:, HEAD] > 0.5)
    for side, sign, socket in zip(SIDES, (1, -1), body_sockets()):
        found[f"{side}_eye"] = [int(k) for k in socket.rim]
        # the front of the ear, where it joins the head
        ear = np.array([MIDDLE + sign * 0.078, 0.638, 0.021])
        found[f"{side}_ear"] = [int(head[np.linalg.norm(x[head] - ear, axis=1).argmin()])]
        foot = np.flatnonzero(weights[:, [JOINTS.index(f"{side}_foot"), JOINTS.index(f"{side}_ankle")]].sum(1) > 0.5)
        low = foot[x[foot, 1] < x[foot, 1].min() + 0.04]
        found[f"{side}_heel"] = [int(low[x[low, 2].argmin()])]
        ankle = x[low, 0].mean()
        inner, outer = low[sign * (x[low, 0] - ankle) < 0], low[sign * (x[low, 0] - ankle) > 0.02]
        found[f"{side}_big_toe"] = [int(inner[x[inner, 2].argmax()])]
        found[f"{side}_small_toe"] = [int(outer[(x[outer, 2] + sign * x[outer, 0]).argmax()])]
        for finger in ("thumb", "index", "middle", "ring", "pinky"):
            last = JOINTS.index(f"{side}_{finger}3")
            own = np.flatnonzero(weights[:, last] > 0.5)
            away = np.linalg.norm(x[own] - body.joints[last], axis=1)
            found[f"{side}_{finger}_tip"] = [int(own[away.argmax()])]
    return found
