"""Fused signed distance -> closed mesh on its zero set, finer where the axes are finer."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer
from numpy import ndarray as Array
from scipy.ndimage import binary_dilation, find_objects
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from command.errors import AssetError
from geometry.cells import distance_to, pieces
from geometry.mesh import TriangleMesh, concatenated, enclosed_volume, face_areas, largest_component, separate_pieces

PointFunction = Callable[[Float[Array, "n 3"]], Array]
# samples of a block that is asked at its centre first, and the steepest slope of a distance that is believed
BLOCK, STEEPEST = 8, 1.5
# samples: slits of air less than twice as wide are filled
SLIT = 2.5
# metres between points of one group, about half
CLUSTER = 0.03


class Detail(NamedTuple):
    """A box whose surface has smaller features than the grid would otherwise hold."""

    low: Float[Array, "3"]  # metres
    high: Float[Array, "3"]
    step: float  # metres


class Hints(NamedTuple):
    """Points near the surface that is looked for."""

    points: Float[Array, "hints 3"]  # canonical, metres
    # head and hands: the grid is fine along every axis they span
    fine: Bool[Array, "hints"]
    # unit normals; where they are given nothing is kept that lies more than a coarse step in front of them: an island,
    # which a coarse grid may join to the surface
    facing: Float[Array, "hints 3"] | None = None


class GridSteps(NamedTuple):
    """How far the lines of the grid lie apart, metres."""

    coarse: float = 0.004
    fine: float = 0.002


class Extraction(NamedTuple):
    """The zero set of a field, and how well it was found."""

    mesh: TriangleMesh
    normals: Float[Array, "vertices 3"]  # unit gradient of the field
    # distance queries spent on the grid
    queries: int
    islands: int  # components dropped
    island_area: float  # their share of the whole area
    # metres, |distance| that one vertex in a thousand exceeds
    residual: float
    # grid samples of air that were filled
    slits: int
    # the layer of each vertex; extract makes one layer, numbered 0
    layer: Integer[Array, "vertices"]


def graded_axis(
    low: float, high: float, fine_spans: Sequence[tuple[float, float]], coarse: float, fine: float,
    details: Sequence[tuple[float, float, float]] = (),
) -> Float[Array, "samples"]:  # fmt: skip
    """Grid coordinates from low to at least high: step `fine` inside the spans, `coarse` elsewhere.

    `details` are spans with a step of their own; the finest counts.

    A rectilinear grid with graded axes keeps marching cubes free of cracks, which two grids would have
    where they meet. The number of samples is a multiple of BLOCK.
    """
    if not (high > low and coarse >= fine > 0):
        raise ValueError(f"axis from {low} to {high} with steps {coarse}, {fine}")
    samples = [low]
    while samples[-1] < high or len(samples) % BLOCK:
        here = samples[-1]
        inside = any(a - coarse <= here < b for a, b in fine_spans)
        own = [step for a, b, step in details if a - fine <= here < b]
        samples.append(here + min([fine if inside else coarse, *own]))
    return np.array(samples)


def sample_near_surface(
    distance: PointFunction, axes: tuple[Array, ...], hints: Float[Array, "hints 3"]
) -> tuple[Float[Array, "x y z"], int]:
    """Signed distance on a rectilinear grid, evaluated only where the surface can be.

    Blocks of 8, 4 and 2 samples are asked at their centre; one whose |distance| exceeds STEEPEST times its
    half diagonal cannot hold the surface (|grad| <= STEEPEST) and takes the centre's value, the others are
    split. Blocks that hold a hint (a vertex known to be close to the surface) are always split.

    Returns:
        the volume, and how many distances were asked.
    """
    shape = tuple(len(axis) for axis in axes)
    if any(n % BLOCK for n in shape):
        raise ValueError(f"axes of {shape} samples are not multiples of {BLOCK}")
    volume = np.empty(shape, np.float32)
    hint_cell = np.stack([np.clip(np.searchsorted(a, hints[:, i]) - 1, 0, len(a) - 1) for i, a in enumerate(axes)], 1)
    origins = np.stack(np.meshgrid(*[np.arange(0, n, BLOCK) for n in shape], indexing="ij"), -1).reshape(-1, 3)
    queries, stride = 0, BLOCK
    while True:
        first = np.stack([axes[i][origins[:, i]] for i in range(3)], 1)
        if stride == 1:
            values = distance(first)
            queries += len(values)
            volume[tuple(origins.T)] = values
            return volume, queries
        # the block owns its samples and the gap up to the next block
        last = np.stack([axes[i][np.minimum(origins[:, i] + stride, shape[i] - 1)] for i in range(3)], 1)
        values = distance(0.5 * (first + last))
        queries += len(values)
        near = np.abs(values) <= STEEPEST * 0.5 * np.linalg.norm(last - first, axis=1)
        hinted = np.zeros(tuple(n // stride for n in shape), bool)
        hinted[tuple((hint_cell // stride).T)] = True
        near |= hinted[tuple((origins // stride).T)]
        offsets = np.stack(np.meshgrid(*[np.arange(stride)] * 3, indexing="ij"), -1).reshape(-1, 3)
        far = origins[~near]
        for chunk in range(0, len(far), 1 << 16):
            index = (far[chunk : chunk + (1 << 16), None] + offsets).reshape(-1, 3)
            volume[tuple(index.T)] = np.repeat(values[~near][chunk : chunk + (1 << 16)], len(offsets))
        half = stride // 2
        corners = half * np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
        origins = (origins[near][:, None] + corners).reshape(-1, 3)
        stride = half


def front_samples(
    volume: Float[Array, "x y z"], axes: tuple[Array, ...], places: Float[Array, "places 3"],
    facing: Float[Array, "places 3"], reach: float,
) -> tuple[Array, ...]:  # fmt: skip
    """Index of the samples inside that lie more than `reach` metres off the nearest place, on the side that it faces.

    From the skin of what is inside inwards: to ask all that lies deep within a person cost 40 CPU s.
    """
    tree, asked = KDTree(places), np.zeros(volume.shape, bool)
    skin = (volume < 0) & np.asarray(binary_dilation(volume > 0), bool)
    found, new = [np.zeros((0, 3), np.int64)], np.argwhere(skin)
    steps = np.concatenate([np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)])
    while len(new):
        asked[tuple(new.T)] = True
        points = np.stack([axes[i][new[:, i]] for i in range(3)], 1)
        away, near = tree.query(points, workers=-1)
        along = ((points - places[near]) * facing[near]).sum(1)
        found.append(new[(away > reach) & (along > 0.5 * away)])
        beside = np.clip((found[-1][:, None] + steps).reshape(-1, 3), 0, np.array(volume.shape) - 1)
        beside = np.unique(beside, axis=0)
        at = tuple(beside.T)
        new = beside[(volume[at] < 0) & ~asked[at]]
    return tuple(np.concatenate(found).T)


def slits_filled(volume: Float[Array, "x y z"], axes: tuple[Array, ...]) -> tuple[Float[Array, "x y z"], int]:
    """Slits of air that end where the field was made solid (capture/template/solid.py), filled; and how many samples.

    A sheet inside the body that is joined to the skin is no component of its own. Its air is at most
    2 SLIT samples wide and ends in a jump: there the distance changes sign by far more than the samples are
    apart. Gaps between fingers, armpits and pits of the skin have no such end and stay as they are.
    """
    air = volume > 0
    ends = np.zeros(volume.shape, bool)
    for axis in range(3):
        one, other = np.moveaxis(volume, axis, 0)[:-1], np.moveaxis(volume, axis, 0)[1:]
        apart = np.diff(axes[axis]).astype(np.float32)[:, None, None]
        jump = ((one > 0) != (other > 0)) & (np.abs(one - other) > 4 * apart)
        marked = np.moveaxis(ends, axis, 0)
        marked[:-1] |= jump & (one > 0)
        marked[1:] |= jump & (other > 0)
    if not ends.any():
        return volume, 0
    filled = volume.copy()
    count = 0
    groups = pieces(np.asarray(binary_dilation(ends, iterations=4), bool))
    pad = int(4 * SLIT) + 8
    for box in find_objects(groups):
        box = tuple(slice(max(s.start - pad, 0), s.stop + pad) for s in box)
        here = air[box]
        # air that a ball of SLIT samples fills when it rolls in from where there is room
        room = distance_to(~here) > SLIT
        wide = distance_to(room) <= SLIT if room.any() else np.zeros_like(here)
        found = pieces(here & ~wide, 3)
        slit = np.isin(found, np.setdiff1d(np.unique(found[ends[box]]), [0]))
        step = min(float(np.diff(axis).min()) for axis in axes)
        count += int((slit & (filled[box] > 0)).sum())
        filled[box][slit] = -0.5 * step
    return filled, count


def zero_set_mesh(volume: Float[Array, "x y z"], axes: Sequence[Array]) -> TriangleMesh:
    """Marching cubes (Lewiner et al. 2003) on a rectilinear grid; triangles face where the values grow."""
    # "descent" turns triangles outwards for distances that grow outwards (skimage names it for densities)
    vertices, faces, _, _ = marching_cubes(volume, 0.0, gradient_direction="descent")
    places = [np.interp(vertices[:, i], np.arange(len(axis)), axis) for i, axis in enumerate(axes)]
    return TriangleMesh(np.stack(places, 1), faces.astype(np.int64))


def project_to_zero(
    distance: PointFunction, points: Float[Array, "n 3"], directions: Float[Array, "n 3"], *, reach: float,
    steps: int = 5, tolerance: float = 2e-5,
) -> tuple[Float[Array, "n 3"], Float[Array, "n"]]:  # fmt: skip
    """Points moved along the field's normals (`directions`) onto its zero set: secant steps with a safeguard.

    The distance's slope along the normal is one only where the Eikonal term held, so the slope is taken
    from the last two values (Newton with a measured derivative); a step leaves neither `reach` (metres)
    nor the bracket found. The best point visited is returned with its |distance|: a point whose field has
    no zero within reach stays where it was least far, and its distance shows it.
    """
    n = len(points)
    value = distance(points)
    offset = np.zeros(n)
    best_offset, best = offset.copy(), np.abs(value)
    low, high = np.full(n, -reach), np.full(n, reach)
    slope = np.ones(n)
    active = np.flatnonzero(best > tolerance)
    for _ in range(steps):
        if len(active) == 0:
            break
        at, d = offset[active], value[active]
        # distance grows along the normal: negative values bound the root from below
        low[active] = np.where(d < 0, np.maximum(low[active], at), low[active])
        high[active] = np.where(d > 0, np.minimum(high[active], at), high[active])
        step = at - d / slope[active]
        inside = (step > low[active]) & (step < high[active])
        step = np.where(inside, step, 0.5 * (low[active] + high[active]))
        new = distance(points[active] + step[:, None] * directions[active])
        moved = step - at
        with np.errstate(divide="ignore", invalid="ignore"):
            measured = (new - d) / moved
        slope[active] = np.where(np.isfinite(measured) & (measured > 0.1), np.minimum(measured, 10.0), 1.0)
        offset[active], value[active] = step, new
        better = np.abs(new) < best[active]
        best_offset[active[better]] = step[better]
        best[active[better]] = np.abs(new[better])
        active = active[np.abs(new) > tolerance]
    return points + best_offset[:, None] * directions, best


def extract(
    distance: PointFunction, normal: PointFunction, hints: Hints, steps: GridSteps = GridSteps(), *,  # noqa: B008 frozen
    margin: float = 0.03, least: float | None = None, details: Sequence[Detail] = (),
) -> Extraction:  # fmt: skip
    """The field's zero set as one closed mesh, its vertices on the surface to under 0.1 mm where it is smooth.

    `details` get their own steps. The largest connected piece is kept, or with `least` all pieces of so much area
    (square metres).

    Raises:
        AssetError: the field is not finite, never changes sign, or leaves the hints' box.
    """
    axes = _axes(hints, steps, margin, details)
    volume, queries = sample_near_surface(distance, axes, hints.points)
    if not np.isfinite(volume).all():
        raise AssetError(f"fused field: distance should be finite, {int((~np.isfinite(volume)).sum())} samples are not")
    for side, there in (("positive", (volume < 0).any()), ("negative", (volume > 0).any())):
        if not there:
            raise AssetError(f"fused field: distance should change sign, it is {side} everywhere (no surface)")
    # before the box's faces are looked at: off the template's band the field was never trained to be air
    if hints.facing is not None:
        volume[front_samples(volume, axes, hints.points, hints.facing, steps.coarse)] = 0.5 * steps.fine
    border = min(np.take(volume, end, axis).min() for axis in range(3) for end in (0, -1))
    if border <= 0:
        raise AssetError(
            f"fused field: distance should be positive {margin * 100:.0f} cm outside the template, is {border:.4f} m"
        )
    volume, slits = slits_filled(volume, axes)
    # a sample exactly on the surface would make triangles without area
    volume[volume == 0] = 1e-9
    whole = zero_set_mesh(volume, axes)
    mesh, islands, island_area = largest_component(whole)
    if least is not None:
        kept = separate_pieces(whole, least)
        if not kept:
            raise AssetError(f"field: no piece of its surface has {least * 1e4:.0f} square centimetres")
        mesh, islands = concatenated(kept), islands + 1 - len(kept)
        island_area = 1 - float(face_areas(*mesh).sum() / face_areas(*whole).sum())
    if enclosed_volume(mesh) <= 0:
        raise AssetError("fused field: distance should be negative inside the person, its surface is inside out")
    projected, residual = project_to_zero(distance, mesh.vertices, normal(mesh.vertices), reach=steps.coarse)
    mesh = TriangleMesh(projected, mesh.faces)
    exceeded = float(np.quantile(residual, 0.999))
    return Extraction(mesh, normal(projected), queries, islands, island_area, exceeded, slits,
                      np.zeros(len(projected), np.int64))  # fmt: skip


def _axes(hints: Hints, steps: GridSteps, margin: float, details: Sequence[Detail]) -> tuple[Array, ...]:
    """Lines of the grid, fine along the spans of every group of fine points, a centimetre wider on both sides."""
    low, high, points = hints.points.min(0) - margin, hints.points.max(0) + margin, hints.points[hints.fine]
    # points closer than about two cells: the head and each hand get spans of their own
    index = np.floor(points / CLUSTER).astype(np.int64)
    index -= index.min(0, initial=0)
    occupied = np.zeros(index.max(0, initial=0) + 1, bool)
    occupied[tuple(index.T)] = True
    labels = pieces(occupied, 3)[tuple(index.T)]
    groups = [points[labels == label] for label in np.unique(labels)]
    return tuple(
        graded_axis(
            low[i], high[i], [(own[:, i].min() - 0.01, own[:, i].max() + 0.01) for own in groups], *steps,
            details=[(float(one.low[i]), float(one.high[i]), one.step) for one in details],
        )
        for i in range(3)
    )  # fmt: skip
