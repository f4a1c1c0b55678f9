"""Fewer triangles for the same surface: quadric collapse, denser on face and hands, closed and manifold."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import fast_simplification
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial import KDTree

from command.errors import AssetError
from geometry.isosurface import PointFunction
from geometry.mesh import TriangleMesh, area_normals, compact, component_labels, face_areas, largest_component
from geometry.repair import find_faults, repair, split_nonmanifold

# metres over which the growth of a part fades in
RAMP = 0.06


class Enlargement(NamedTuple):
    """A part that is blown up before collapsing, so that it keeps more triangles: Garland's quadrics measure
    length, and a part twice as large counts four times as much."""

    anchor: Float[Array, "3"]  # canonical, metres: wrist or head joint
    axis: Float[Array, "3"]  # unit, from the anchor into the part
    radius: float  # metres around the axis
    scale: float


class Magnifier(NamedTuple):
    """A ball that is blown up before collapsing; what lies farther off is pushed outwards, not pressed together."""

    centre: Float[Array, "3"]  # canonical, metres
    radius: float  # metres
    scale: float


def magnified(points: Float[Array, "n 3"], balls: Sequence[Magnifier]) -> Float[Array, "n 3"]:
    """Points with each ball grown about its centre.

    x + (scale - 1) min(r, radius) (x - centre) / r, a sum of gradients of convex functions: one to one for any balls.
    """
    result = points.copy()
    for ball in balls:
        offset = points - ball.centre
        r = np.linalg.norm(offset, axis=1)
        result += ((ball.scale - 1) * np.minimum(1, ball.radius / np.maximum(r, 1e-12)))[:, None] * offset
    return result


def enlarged(vertices: Float[Array, "vertices 3"], parts: Sequence[Enlargement | Magnifier]) -> Array:
    """Vertices with balls magnified, then parts grown away from their anchors; growth fades in over RAMP."""
    vertices = magnified(vertices, [part for part in parts if isinstance(part, Magnifier)])
    result = vertices.copy()
    for part in (part for part in parts if isinstance(part, Enlargement)):
        offset = vertices - part.anchor
        along = offset @ part.axis
        across = np.linalg.norm(offset - along[:, None] * part.axis, axis=1)
        s = np.clip(along / RAMP, 0, 1)
        weight = np.where(across < part.radius, s * s * (3 - 2 * s), 0.0)
        result += (weight * (part.scale - 1))[:, None] * offset
    return result


def decimate(
    mesh: TriangleMesh, target: int, parts: Sequence[Enlargement | Magnifier] = (), *,
    report: Callable[[str], None] = lambda line: None,
) -> TriangleMesh:  # fmt: skip
    """Closed manifold mesh of about `target` triangles (Garland and Heckbert 1997, quadric collapse).

    Collapsed in gentle passes: the library's own default raises its threshold so fast that it takes twice the
    error. It does not check the link condition and can tear or crowd edges: such a pass is tried again towards
    other targets, and what is left is repaired. Where repair took more than LOST of the surface (a finger pinched
    off is half a percent), the whole collapse is tried again towards another number of triangles; where all took
    more, the least loss is taken up to BEARABLE, else towards FINER ones (locks of hair that no 70 triangles
    hold), and what is lost is reported.

    Raises:
        ValueError: fewer than 4 triangles asked, or a mesh that is not a closed manifold given.
        AssetError: no attempt could be closed, or all lost more than WORTHLESS of the surface.
    """
    if target < 4:
        raise ValueError(f"a closed surface has at least 4 triangles, {target} asked")
    mesh, _ = compact(mesh.vertices, mesh.faces)
    fault = find_faults(mesh.faces, len(mesh.vertices))
    if fault:
        raise ValueError(f"mesh to decimate should be closed and manifold, has {fault}")
    if len(mesh.faces) <= target:
        return mesh
    grown = enlarged(mesh.vertices, parts)
    problems: list[str] = []
    best: tuple[float, TriangleMesh] | None = None
    for share in (*RETRIES, *FINER):
        # a collapse ends within a hundredth of its target
        if share in FINER and (1.01 * share * target > MOST_FACES or (best is not None and best[0] <= BEARABLE)):
            break
        try:
            collapsed, lost = _collapsed(TriangleMesh(grown, mesh.faces), max(4, int(share * target)))
        except AssetError as problem:
            problems.append(str(problem))
            continue
        if best is None or lost < best[0]:
            best = lost, collapsed
        if lost <= LOST:
            break
        problems.append(f"repairing {len(collapsed.faces)} triangles lost {lost * 100:.1f} % of the surface")
    if best is None or best[0] > WORTHLESS:
        raise AssetError(
            f"surface: should collapse to about {target} triangles without a hole, did in none of {len(problems)} "
            f"attempts ({'; '.join(problems)})"
        )
    lost, collapsed = best
    if lost > LOST:
        report(f"collapsing to {len(collapsed.faces)} triangles pinched off {lost * 100:.1f} % of the surface")
    return TriangleMesh(shrunk(collapsed.vertices, grown, mesh.vertices, parts), collapsed.faces)


# multiples of the target, in this order
RETRIES = (1.0, 1.03, 0.96, 1.1, 1.2, 0.9)
FINER = (1.5, 2.0, 3.0, 5.0)
# triangles, more than which no level may have: the unwrapper of charts would take minutes
MOST_FACES = 200_000
# shares of the area
LOST = 0.003
BEARABLE = 0.015
WORTHLESS = 0.1


def _collapsed(mesh: TriangleMesh, target: int) -> tuple[TriangleMesh, float]:
    """The mesh collapsed, closed and in one piece, and the share of its area that repair took or put in."""
    points, faces = (np.ascontiguousarray(mesh.vertices, np.float32), np.ascontiguousarray(mesh.faces, np.int32))
    aggression = GENTLE
    while len(faces) > 1.01 * target and aggression <= 10:
        points, faces, aggression = _gentle_pass(points, faces, target, aggression)
    collapsed = TriangleMesh(points.astype(np.float64), faces.astype(np.int64))
    if not find_faults(collapsed.faces, len(points)) and component_labels(collapsed.faces, len(points)).max() == 0:
        return collapsed, 0.0
    before = face_areas(*collapsed).sum()
    collapsed, _, _ = largest_component(split_nonmanifold(collapsed))
    if find_faults(collapsed.faces, len(collapsed.vertices)):
        collapsed = repair(collapsed)
    return collapsed, float(abs(face_areas(*collapsed).sum() / before - 1))


# aggressiveness of a pass; 7, the library's default, has 2.4 times the error at 30k triangles
GENTLE = 3


def _gentle_pass(points: Array, faces: Array, target: int, aggression: int) -> tuple[Array, Array, int]:
    """One call of the library; the attempt with the fewest faults, and the aggressiveness of the next pass."""
    tried: list[tuple[int, Array, Array]] = []
    for attempt in (target, int(target * 1.008), int(target * 0.985)):
        found, triangles = fast_simplification.simplify(points, faces, target_count=attempt, agg=aggression)[:2]
        tried.append((sum(find_faults(triangles.astype(np.int64), len(found))), found, triangles))
        if not tried[-1][0]:
            break
    _, found, triangles = min(tried, key=lambda one: one[0])
    slow = len(triangles) > 0.9 * len(faces)
    return np.ascontiguousarray(found, np.float32), triangles.astype(np.int32), aggression + slow


def shrunk(
    points: Float[Array, "n 3"], grown: Float[Array, "vertices 3"], original: Float[Array, "vertices 3"],
    parts: Sequence[Enlargement | Magnifier],
) -> Float[Array, "n 3"]:  # fmt: skip
    """Inverse of `enlarged`: start at the displacement of the nearest vertex, then x <- x - J^-1 (f(x) - y)
    with J approximated by the local scale, which converges because the growth is monotone along the axis."""
    _, nearest = KDTree(grown).query(points)
    guess = original[nearest] + (points - grown[nearest])
    moved = np.linalg.norm(grown[nearest] - original[nearest], axis=1) > 1e-9
    target, x = points[moved], guess[moved]
    top = max((part.scale for part in parts if isinstance(part, Enlargement)), default=1.0)
    top *= 1 + sum(part.scale - 1 for part in parts if isinstance(part, Magnifier))
    for _ in range(60):
        error = enlarged(x, parts) - target
        x = x - error / top
        if np.abs(error).max(initial=0) < 1e-7:
            break
    guess[moved] = x
    return guess


def balanced(
    mesh: TriangleMesh, distance: PointFunction, normal: PointFunction, *, rounds: int = 2, reach: float = 0.006
) -> TriangleMesh:
    """Vertices moved along the field's normal until the triangles around each lie half inside, half outside.

    With its vertices on the zero set a mesh lies inside every convex part; balanced, its mean distance to the
    surface is less than half (measured: .117 -> .053 mm at 30k triangles). A move that would turn a triangle
    over is not made, nor one longer than `reach` (metres).
    """
    vertices, faces = mesh.vertices, mesh.faces
    for _ in range(rounds):
        a, b, c = (vertices[faces[:, i]] for i in range(3))
        probes = np.concatenate([(a + b + c) / 3, 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)])
        middle, ab, bc, ca = distance(probes).reshape(4, -1)
        areas = face_areas(vertices, faces)
        total, weight = np.zeros(len(vertices)), np.zeros(len(vertices))
        for corner, beside in enumerate((ab + ca, ab + bc, bc + ca)):
            total += np.bincount(faces[:, corner], areas * (middle + beside) / 3, len(vertices))
            weight += np.bincount(faces[:, corner], areas, len(vertices))
        error = 0.75 * total / np.maximum(weight, 1e-20) + 0.25 * distance(vertices)
        # farther from the surface than triangles of a level can be, the distance is not the surface's
        error = np.where(np.abs(error) > reach, 0.0, error)
        moved = vertices - error[:, None] * normal(vertices)
        vertices = unfolded(moved, vertices, faces)
    return TriangleMesh(vertices, faces)


def unfolded(moved: Array, before: Array, faces: Array) -> Array:
    """The moved vertices, less the moves at triangles they would turn over."""
    vertices = moved.copy()
    facing = area_normals(before, faces)
    for _ in range(8):
        turned = (area_normals(vertices, faces) * facing).sum(1) < 0
        if not turned.any():
            return vertices
        index = np.unique(faces[turned])
        vertices[index] = before[index]
    return before.copy()
