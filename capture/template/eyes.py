"""The eyes of the template: two balls in its sockets, and the skin round the opening between the lids.

A body template has sockets and no eyeballs. A capture whose registration measured them says where they are
(`eyes` of subject.npz); for the free body without that, each is fitted to its socket.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from avatar.body import builtin_body
from avatar.constant import constant
from avatar.rotation import fibonacci_sphere
from avatar.skeleton import BIG_POSE, JOINTS, skin_transforms
from avatar.skinning import dense_weights
from capture.folder import CaptureSubject

HEAD = JOINTS.index("head")
# metres: an eyeball, from a child's to a cartoon's
RADIUS = (0.008, 0.022)
# metres: the eye region reaches this far beyond the opening between the lids
GROWN = 0.003
# metres: an eyeball lies this deep under the edges of the lids
UNDER_LIDS = 0.0004
# metres: what lies farther in front of an eyeball is no lid of it
LID_REACH = 0.012
# directions tried on each ball: .6 mm apart on it
DIRECTIONS = 6000
# radii behind an eyeball's middle from where what lids hide is found, and directions all round: .7 mm apart at lids
BEHIND, BEHIND_DIRECTIONS = 2.0, 40_000


class EyeSpheres(NamedTuple):
    """The eyeballs, left then right, metres."""

    centres: Float[Array, "2 3"]
    radii: Float[Array, "2"]

    def distance(self, points: Float[Array, "n 3"]) -> Float[Array, "n"]:
        """Signed distance to the nearer ball, negative inside."""
        away = np.linalg.norm(points[:, None] - self.centres, axis=2) - self.radii
        return away.min(1)


def fit_sphere(points: Float[Array, "n 3"]) -> tuple[Float[Array, "3"], float]:
    """Centre and radius of the sphere through points, by linear least squares of |x|² = 2 c.x + r² - |c|².

    Raises:
        ValueError: fewer than four points, or all in a plane.
    """
    about = points.mean(0)
    system = np.concatenate([2 * (points - about), np.ones((len(points), 1))], 1)
    solution, _, rank, _ = np.linalg.lstsq(system, ((points - about) ** 2).sum(1), rcond=1e-9)
    if rank < 4:
        raise ValueError(f"a sphere needs four points that are not in a plane, found {len(points)} of rank {rank}")
    centre = solution[:3]
    return centre + about, float(np.sqrt(solution[3] + centre @ centre))


class Socket(NamedTuple):
    """Vertices of one eye socket of the free body."""

    inside: Int[Array, "n"]
    rim: Int[Array, "m"]  # the edges of the lids, which are of the socket and of the skin


@constant
def body_sockets() -> tuple[Socket, Socket]:
    """The eye sockets of the free body, left then right: islands of its texture (both sexes share them)."""
    body = builtin_body("male")
    assert body.uv is not None and body.uv_faces is not None
    u, v = body.uv[body.uv_faces].mean(1).T
    island = (u < 0.16) & (v > 0.365) & (v < 0.455) & (dense_weights(body.skin)[body.faces[:, 0], HEAD] > 0.9)
    of_socket, of_skin = np.zeros((2, len(body.vertices)), bool)
    of_socket[body.faces[island]] = True
    of_skin[body.faces[~island]] = True
    x = body.vertices[:, 0]
    left, right = (Socket(np.flatnonzero(of_socket & (side * x > 0)),
                          np.flatnonzero(of_socket & of_skin & (side * x > 0))) for side in (1, -1))  # fmt: skip
    return left, right


def eye_spheres(subject: CaptureSubject) -> EyeSpheres | None:
    """The subject's eyeballs in the canonical frame; None for a template that neither states them nor is the free
    body, whose sockets are known."""
    stated = subject.eyes
    if stated is None and subject.on_free_body:
        stated = socket_spheres(subject.rest)
    if stated is None:
        return None
    B = skin_transforms(BIG_POSE, subject.joints, rest=np.zeros((52, 3)))[HEAD]
    return EyeSpheres(stated[:, :3] @ B[:3, :3].T + B[:3, 3], stated[:, 3])


def socket_spheres(vertices: Float[Array, "vertices 3"]) -> Float[Array, "2 4"]:
    """Centre and radius of the eyeballs that the sockets of the free body, shaped as `vertices`, would hold.

    The centre is the socket's; the ball touches the edges of the lids from within.
    """
    spheres = []
    for socket in body_sockets():
        centre, _ = fit_sphere(vertices[socket.inside])
        rim = np.linalg.norm(vertices[socket.rim] - centre, axis=1)
        spheres.append([*centre, np.clip(np.percentile(rim, 5) - UNDER_LIDS, *RADIUS)])
    return np.array(spheres)


def uncovered(subject: CaptureSubject, spheres: EyeSpheres) -> list[Float[Array, "n 3"]]:
    """For each ball the unit directions from its middle in which neither lid nor socket is met within LID_REACH of it.

    Only the front can be open: behind the ball a socket may have holes, and what is behind is left out.
    """
    corners, forward = subject.vertices[subject.faces], face_forward(subject)
    middles, directions = corners.mean(1), fibonacci_sphere(DIRECTIONS)[:, [0, 2, 1]]
    found = []
    for centre, radius in zip(spheres.centres, spheres.radii):
        near = np.linalg.norm(middles - centre, axis=1) < radius + LID_REACH + 0.01
        free = first_hits(centre, directions, corners[near]) >= radius + LID_REACH
        found.append(directions[free & (directions @ forward > 0)])
    return found


class HiddenLengths(NamedTuple):
    """What lies in front of one eyeball, from far behind it: nearly as a camera in front of the face sees it."""

    origin: Float[Array, "3"]
    directions: Float[Array, "n 3"]  # unit, to what lies round the ball
    # how far off the template is first met in front of the ball's middle; inf: nowhere near the ball
    length: Float[Array, "n"]
    spacing: float  # between directions, at most


def hidden_lengths(subject: CaptureSubject, spheres: EyeSpheres) -> list[HiddenLengths]:
    """Lids before each ball, for filling what they hide.

    From the ball's middle itself the fill behind a lid that stands off the ball would narrow the opening: a slope of
    2 mm where the built-in man's lids stand 3 mm off.
    """
    forward = face_forward(subject)
    middles = subject.vertices[subject.faces].mean(1)
    around = fibonacci_sphere(BEHIND_DIRECTIONS)[:, [0, 2, 1]]
    found = []
    for centre, radius in zip(spheres.centres, spheres.radii):
        origin, reach = centre - BEHIND * radius * forward, radius + LID_REACH
        away = np.linalg.norm(middles - centre, axis=1)
        corners = subject.vertices[subject.faces[(away < reach + 0.01) & ((middles - centre) @ forward > 0)]]
        directions = around[around @ forward > np.cos(np.arctan2(reach, BEHIND * radius))]
        length = first_hits(origin, directions, corners)
        hit = origin + np.where(np.isfinite(length), length, 0.0)[:, None] * directions
        held = np.isfinite(length) & (np.linalg.norm(hit - centre, axis=1) < reach)
        found.append(HiddenLengths(origin, directions, np.where(held, length, np.inf),
                                   2 * np.sqrt(4 * np.pi / BEHIND_DIRECTIONS)))  # fmt: skip
    return found


def eye_openings(subject: CaptureSubject) -> Float[Array, "n 3"]:
    """Points on the eyeballs that no lid covers, canonical: the way out from the ball's middle meets no face there.

    A lid that was registered into the ball covers it as well. No points for a template without eyes.
    """
    spheres = eye_spheres(subject)
    if spheres is None:
        return np.zeros((0, 3))
    each = zip(spheres.centres, spheres.radii, uncovered(subject, spheres))
    return np.concatenate([centre + radius * directions for centre, radius, directions in each])


def face_forward(subject: CaptureSubject) -> Float[Array, "3"]:
    """The way the face looks in the canonical frame, unit."""
    B = skin_transforms(BIG_POSE, subject.joints, rest=np.zeros((52, 3)))[HEAD]
    return B[:3, 2] / np.linalg.norm(B[:3, 2])


def first_hits(
    origin: Float[Array, "3"], directions: Float[Array, "n 3"], corners: Float[Array, "faces 3 3"]
) -> Float[Array, "n"]:
    """How far along each ray from one origin the first triangle is met (Möller and Trumbore 1997); else inf."""
    corners = corners[_before(origin, directions, corners)]
    a, u, v = corners[:, 0] - origin, corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(u, v)
    # with one origin, the determinants are linear in the direction
    numerators = (a * normal).sum(1), np.cross(v, a).T, np.cross(a, u).T
    first = np.full(len(directions), np.inf)
    for begin in range(0, len(directions), 512):
        some = directions[begin : begin + 512]
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = 1 / (some @ normal.T)
            length, p, q = numerators[0] * slope, some @ numerators[1] * slope, some @ numerators[2] * slope
            hit = (p >= 0) & (q >= 0) & (p + q <= 1) & (length > 0)
        first[begin : begin + 512] = np.where(hit, length, np.inf).min(1, initial=np.inf)
    return first


def _before(
    origin: Float[Array, "3"], directions: Float[Array, "n 3"], corners: Float[Array, "faces 3 3"]
) -> Bool[Array, "faces"]:
    """Triangles that a ray can meet: round the middle of both the rays and a triangle's corners lie in a cone."""
    unit = lambda vectors: vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    angle = lambda cosine: np.arccos(np.clip(cosine, -1, 1))
    middle, towards = unit(directions.sum(0)), unit(corners - origin)
    own = unit(towards.sum(1))
    widest = angle((directions @ middle).min(initial=1)) + angle((towards * own[:, None]).sum(2).min(1, initial=1))
    # what has no direction is kept
    return ~(angle(own @ middle) > widest + 1e-6)
