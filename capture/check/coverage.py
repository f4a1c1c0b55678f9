"""From where a part was seen: share of its surface, gaps of the turn."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.skeleton import LEFT_HAND, PARTS, RIGHT_HAND, skin_transforms
from capture.check.silhouette import canonical_from_head
from capture.folder import Capture
from capture.template.views import part_views
from geometry.mesh import vertex_areas, vertex_normals

# frames that should see a point: two to place it, one to confirm
ENOUGH = 3


@dataclass(frozen=True)
class Coverage:
    # share of its outer surface seen in at least ENOUGH frames
    seen: float
    # degrees: the largest angle of the turn without a frame
    gap: float


def coverage(capture: Capture, part: str, visible: Bool[Array, "faces"]) -> Coverage:
    """Of one part, over its own video; `visible` are the faces of the template that can be seen at all.

    The turn is about the vertical for body and head, about the forearm for a hand, in the part's own frame.
    """
    subject, video, index = capture.subject, capture.videos[part], PARTS.index(part)
    transform = canonical_from_head(capture) if part == "head" else None
    own = (subject.part == index) & ~subject.hair
    normals = vertex_normals(subject.vertices, subject.faces)
    # where the person was in view, whatever the outline of the mask: that is judged elsewhere
    anywhere = np.broadcast_to(video.masks.any((1, 2), keepdims=True), video.masks.shape)
    in_view = replace(video, masks=anywhere)
    sums = part_views(in_view, subject, subject.vertices, normals, subject.skin, own, transform)
    area = vertex_areas(subject.vertices, subject.faces[visible]) * own
    seen = float(area[sums.count >= ENOUGH].sum() / max(area.sum(), 1e-12))
    return Coverage(seen, largest_gap(turn_angles(camera_directions(capture, part), part)))


def camera_directions(capture: Capture, part: str) -> Float[Array, "frames 3"]:
    """Unit direction from the middle of the part to the camera in every frame, canonical frame."""
    subject, video = capture.subject, capture.videos[part]
    middle = subject.vertices[subject.part == PARTS.index(part)].mean(0)
    out = []
    for frame, camera in enumerate(video.cameras):
        if video.axis_angle is None or video.root is None:
            eye = canonical_from_head(capture) @ np.append(camera.eye, 1)
        else:
            bone = {"body": 0, "hand_left": LEFT_HAND.start - 2, "hand_right": RIGHT_HAND.start - 16}[part]
            B = skin_transforms(video.axis_angle[frame], subject.joints, video.root[frame])[bone]
            eye = np.linalg.solve(B, np.append(camera.eye, 1))
        out.append(eye[:3] - middle)
    return np.array(out) / np.linalg.norm(out, axis=1, keepdims=True)


def turn_angles(towards: Float[Array, "frames 3"], part: str) -> Float[Array, "frames"]:
    """Angle about the part's long axis, 0 to 2 pi.

    Body and head: about +y, from the chest (+z) to the left. Hands: about the forearm, from the thumb's side (+z) to
    the back of the hand (+y).
    """
    x, y, z = towards.T
    return np.arctan2(x if part in ("body", "head") else y, z) % (2 * np.pi)


def largest_gap(azimuth: Float[Array, "frames"]) -> float:
    """Degrees of the largest arc without a frame; 360 for a single direction."""
    order = np.sort(azimuth)
    return float(np.degrees(np.diff(np.append(order, order[0] + 2 * np.pi)).max()))
