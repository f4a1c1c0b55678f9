"""Training rays of one part: which pixels supervise it, and where along each ray the surface can be.

Everything that does not change while the field learns is computed once: the march to the template, the posed to
canonical map at every section end (Eq. 3, or the rigid motion of Eq. 4), the pixel colours.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from avatar.camera import pixel_rays
from avatar.rotation import quaternion_from_matrix
from avatar.skeleton import PARTS, skin_transforms
from avatar.skinning import SkinWeights, skin_normals, skin_points
from capture.folder import CaptureSubject, PartVideo
from capture.template import SurfaceCloud, sample_grid, signed
from geometry.cells import distance_to
from train.deform import apply_rows, canonical_from_posed, inverse_transforms
from train.parts import Part
from train.template_grid import TemplateGrid

Array = np.ndarray


@dataclass(frozen=True)
class Band:
    """How far from the template a surface is looked for, metres."""

    # rays enter the band here
    outside: float
    # and leave it this deep under the template
    inside: float
    # march step within the band
    step: float


@dataclass(frozen=True)
class TrainingRays:
    """Rays with their cached section ends, all canonical; R rays, E ends each."""

    ends: Float[Array, "rays ends 3"]  # canonical, metres
    # template sample that each end follows
    row: Int[Array, "rays ends"]
    # unit, away from the camera; world (body, hands) or canonical (head)
    direction: Float[Array, "rays 3"]
    frame: Int[Array, "rays"]
    color: Float[Array, "rays 3"]  # sRGB in [0, 1], black outside the mask
    mask: Float[Array, "rays"]
    # posed_from_canonical, xyzw; None: rigid, canonical directions
    bones: Float[Array, "frames 52 4"] | None
    # share of rays left out because their map to the canonical pose did not settle
    flagged: float
    # share of the chosen pixels on the person whose ray meets no template: too far from it, or lost on the way
    lost: float


class Focus(NamedTuple):
    """Where sections are short: round the surfaces of the part's closed template distance."""

    template: TemplateGrid
    # metres off the surface at which a section is twice as long as on it
    reach: float

    def distance(self, points: Float[Array, "n 3"]) -> tuple[Float[Array, "n"], Bool[Array, "n"]]:
        """The template's distance at canonical points, and which of them its grid holds."""
        at = torch.as_tensor(points, dtype=torch.float32)
        with torch.no_grad():
            distance = torch.cat([self.template(piece) for piece in at.split(262144)] or [at.new_zeros(0)])
        low = self.template.low
        high = low + self.template.cell * (torch.tensor(self.template.values.shape) - 1)
        return distance.double().numpy(), ((at >= low) & (at <= high)).all(1).numpy()


# takes points and the nearest sample of each; distances with the sign put right
Resign = Callable[[Array, Array, Array], Array]


def march(
    origins: Float[Array, "n 3"],
    directions: Float[Array, "n 3"],
    cloud_points: Float[Array, "s 3"],
    cloud_normals: Float[Array, "s 3"],
    gap: Float[Array, "s"],
    band: Band,
    *,
    iterations: int = 72,
    resign: Resign | None = None,
) -> tuple[Int[Array, "k"], Float[Array, "k"], Float[Array, "k"], Int[Array, "k"]]:
    """Steps of every ray inside the band around the (posed) template: ray, t, signed distance, nearest sample.

    Far from the surface a ray jumps by its distance less the band (sphere tracing); inside the band it walks in
    fixed steps until it is `inside` deep or out of the box. Steps come in order of ray, then t. `resign` judges
    points that the nearest sample's normal says are inside: where it is wrong, a ray would end before the surface.

    Raises:
        ValueError: a direction is not of unit length (zero, NaN), or an origin is not finite.
    """
    bad = np.flatnonzero(~(np.abs((directions**2).sum(1) - 1) < 1e-3) | ~np.isfinite(origins).all(1))
    if len(bad):
        raise ValueError(f"ray {bad[0]}: expected a finite origin and a unit direction, is {directions[bad[0]]}")
    tree = KDTree(cloud_points)
    low, high = cloud_points.min(0) - band.outside, cloud_points.max(0) + band.outside
    safe = np.where(np.abs(directions) > 1e-12, directions, 1e-12)
    t0, t1 = (low - origins) / safe, (high - origins) / safe
    t = np.maximum(np.minimum(t0, t1).max(1), 0.0)
    far = np.maximum(t0, t1).min(1)
    active = np.flatnonzero(t < far)
    # far from the surface a search tree visits half its leaves: come near with a thinned cloud first
    thin = cloud_points[:: max(len(cloud_points) // 1500, 1)]
    thin_tree = KDTree(thin)
    margin = float(thin_tree.query(cloud_points[::7])[0].max()) * 1.05
    found: list[tuple[Array, ...]] = []
    reach = 3 * band.outside
    waiting = active
    for _ in range(24):
        length, _ = thin_tree.query(origins[waiting] + t[waiting, None] * directions[waiting])
        jump = length - margin - band.outside
        t[waiting] += np.maximum(jump, 0)
        waiting = waiting[(jump > 0.3 * reach) & (t[waiting] < far[waiting])]
        if len(waiting) == 0:
            break
    active = active[t[active] < far[active]]
    for _ in range(iterations):
        if len(active) == 0:
            break
        points = origins[active] + t[active, None] * directions[active]
        length, sample = tree.query(points, distance_upper_bound=reach)
        length, sample = np.minimum(length, reach), np.minimum(sample, len(cloud_points) - 1)
        distance = signed(points, length, cloud_points[sample], cloud_normals[sample], gap[sample])
        distance = np.where(length < reach, distance, reach)
        if resign is not None and len(under := np.flatnonzero(distance < 0)):
            distance[under] = resign(points[under], sample[under], distance[under])
        within = (length <= band.outside * 1.001) & (distance > -band.inside - band.step)
        found.append((active[within], t[active[within]], distance[within], sample[within]))
        t[active] += np.maximum(length - band.outside, band.step)
        active = active[(distance > -band.inside) & (t[active] < far[active])]
    if not found:
        return np.zeros(0, int), np.zeros(0), np.zeros(0), np.zeros(0, int)
    ray, at, distance, sample = (np.concatenate([step[i] for step in found]) for i in range(4))
    order = np.lexsort((at, ray))
    return ray[order], at[order], distance[order], sample[order]


def spread_ends(counts: Int[Array, "n"], ends: int) -> tuple[Int[Array, "n ends"], Float[Array, "n ends"]]:
    """Section ends spread evenly over the steps of each ray: index of the step, and how far into it."""
    place = np.linspace(0, 1, ends)[None, :] * counts[:, None]
    step = np.minimum(place.astype(int), counts[:, None] - 1)
    return step, place - step


# parts of a march step in which the template's distance is taken as linear
THIRDS = 3
# a ray's share of sections behind the surface that it has been through, against the same place before it
BEHIND = 0.3


def focused_ends(
    begin: Int[Array, "rays"], distance: Float[Array, "steps 2"], reach: float, ends: int
) -> tuple[Int[Array, "rays ends"], Float[Array, "rays ends"]]:
    """Section ends of each ray, dense where it meets the template: index of the step, and how far into it.

    Between the ends lie equal shares of the integral of 1 / (reach + |d|) along the ray, so that a section is as long
    as it is far from the surface, in proportion to reach + |d|. Behind the first surface that the ray went through
    (by `reach`) the integrand counts BEHIND: a thin part may be missing in truth. `distance` is d where a step begins
    and where it ends, taken as linear in between; steps come in order of ray, which begin at `begin`.
    """
    sign = np.sign(distance)
    # the integral's antiderivative over d, and its mean over the step
    F = sign * np.log1p(np.abs(distance) / reach)
    change = distance[:, 1] - distance[:, 0]
    steep = np.abs(change) > 1e-6
    weight = np.where(steep, (F[:, 1] - F[:, 0]) / np.where(steep, change, 1.0), 1 / (reach + np.abs(distance[:, 0])))
    of_ray = np.repeat(np.arange(len(begin)), np.diff(np.r_[begin, len(distance)]))
    # through the first surface: a running count of steps that are deep, restarted with each ray
    deep = np.cumsum(distance[:, 0] < -reach)
    passed = deep - (deep[begin] - (distance[begin, 0] < -reach))[of_ray] > 0
    weight = weight * np.where(passed, BEHIND, 1.0)

    total = np.cumsum(weight)
    before = total[begin] - weight[begin]
    last = np.r_[begin[1:], len(distance)] - 1
    place = before[:, None] + np.linspace(0, 1, ends) * (total[last] - before)[:, None]
    step = np.clip(np.searchsorted(total, place.ravel()).reshape(place.shape), begin[:, None], last[:, None])
    share = np.clip((place - (total - weight)[step]) / weight[step], 0, 1)
    # back from the share of the step's integral to the share of its length
    mixed = F[step, 0] + share * (F[step, 1] - F[step, 0])
    at = np.sign(mixed) * reach * np.expm1(np.abs(mixed))
    into = np.where(steep[step], (at - distance[step, 0]) / np.where(steep, change, 1.0)[step], share)
    return step, np.clip(into, 0, 1)


class PosedTemplate(NamedTuple):
    """The template in one frame of a video, in the frame that its rays are marched in."""

    points: Float[Array, "thin 3"]  # of the thinned samples
    normals: Float[Array, "thin 3"]
    inverse: Float[Array, "samples 3 4"] | None  # canonical_from_posed of every sample; None: rays are canonical
    invertible: Bool[Array, "samples"] | None


def posed_template(cloud: SurfaceCloud, thin: Int[Array, "thin"], transforms: Float[Array, "52 4 4"]) -> PosedTemplate:
    """The samples skinned to the world with their inverse maps (Eq. 3); points and normals of the `thin` ones."""
    skin = SkinWeights(cloud.skin.joints[thin], cloud.skin.weights[thin])
    inverse, invertible = inverse_transforms(cloud.skin, transforms)
    points = skin_points(cloud.points[thin], skin, transforms)
    return PosedTemplate(points, skin_normals(cloud.normals[thin], skin, transforms), inverse, invertible)


def part_rays(
    video: PartVideo,
    subject: CaptureSubject,
    cloud: SurfaceCloud,
    part: Part,
    band: Band,
    *,
    ends: int,
    per_frame: int,
    canonical_from_head: Float[Array, "4 4"] | None,
    rng: np.random.Generator,
    background: float = 1.0,
    prepared: Callable[[float], None] = lambda share: None,
    focus: Focus | None = None,
) -> TrainingRays:
    """The rays of a video that train `part`, at most `per_frame` of each frame.

    Of these at most the share `background` lies beside the person. `prepared` hears the share of the frames done.
    With `focus` the template's closed distance says where a ray is inside, and sections are short at its surface.

    A pixel supervises a part when its ray first meets the template inside the part's box, or, for a ray that
    passes by, when its closest approach lies in the box (FRAMES.md). Sections never leave the box.
    """
    frames, index = len(video.masks), PARTS.index(part.name)
    kept: list[tuple[Array, ...]] = []
    bones = []
    # the march needs the template to a few millimetres only: a quarter of the samples, twice as far apart
    thin = np.arange(0, len(cloud.points), 4)
    grid = sample_grid(cloud, part.extent.low - 0.02, part.extent.high + 0.02, cloud.spacing)
    # neighbouring samples differ by this much near a joint
    settled = max(1e-4, 0.25 * cloud.spacing)
    tried = dropped = on_person = lost = 0
    for frame in range(frames):
        prepared(frame / frames)
        mask = video.masks[frame]
        camera, scale = video.cameras[frame], 1.0
        if canonical_from_head is not None:
            scale = float(np.cbrt(np.linalg.det(canonical_from_head[:3, :3])))
            posed = PosedTemplate(cloud.points[thin], cloud.normals[thin], None, None)
            middle = posed.points[cloud.part[thin] == index].mean(0)
            middle = np.linalg.solve(canonical_from_head, np.append(middle, 1))[:3]
        else:
            assert video.axis_angle is not None and video.root is not None
            B = skin_transforms(video.axis_angle[frame], subject.joints, video.root[frame])
            posed = posed_template(cloud, thin, B)
            bones.append(quaternion_from_matrix(B[:, :3, :3]))
            middle = posed.points[cloud.part[thin] == index].mean(0)
        # background pixels farther from the person than this see no band
        reach = camera.K[0, 0] * band.outside / scale / max(float(np.linalg.norm(middle - camera.eye)), 1e-9)
        unsure = None if video.unsure is None else video.unsure[frame]
        pixels = _choose_pixels(mask, unsure, per_frame, background, reach, rng)
        origins, directions = pixel_rays(camera, pixels[:, ::-1] + 0.5)
        if canonical_from_head is not None:
            origins = origins @ canonical_from_head[:3, :3].T + canonical_from_head[:3, 3]
            directions = directions @ canonical_from_head[:3, :3].T / scale
        resign = None if focus is None else _by_closed_distance(focus, posed, thin)
        ray, t, distance, sample = march(
            origins, directions, posed.points, posed.normals, 2 * cloud.gap[thin], band, resign=resign
        )
        sample = thin[sample]
        pictured = mask[pixels[:, 0], pixels[:, 1]]
        met = np.zeros(len(pixels), bool)
        met[ray] = True
        on_person, lost = on_person + int(pictured.sum()), lost + int((pictured & ~met).sum())
        if len(ray) == 0:
            continue
        at = origins[ray] + t[:, None] * directions[ray]
        if posed.inverse is None or posed.invertible is None:
            row, ok, canonical = sample, np.ones(len(ray), bool), at
        else:
            row, canonical, ok = canonical_from_posed(at, sample, posed.inverse, grid.nearest, settled=settled)
            ok &= posed.invertible[row]
        if focus is not None:
            closed, held = focus.distance(canonical)
            distance = np.where(held, closed, distance)
        trains, doubtful, keep = _choose_steps(ray, distance, canonical, ok, part, band)
        tried, dropped = tried + trains, dropped + doubtful
        if not keep.any():
            continue
        ray, t, row = ray[keep], t[keep], row[keep]
        begin = _first_steps(ray)
        which = ray[begin]
        if focus is None:
            step, into = spread_ends(np.diff(np.r_[begin, len(ray)]), ends)
            at_step = begin[:, None] + step
            length = band.step
        else:
            # the template turns within a step: thirds of it, mapped as the step is
            t, row, ray = (np.repeat(values, THIRDS) for values in (t, row, ray))
            length = band.step / THIRDS
            t = t + np.tile(np.arange(THIRDS) * length, len(t) // THIRDS)
            begin = THIRDS * begin
            point = origins[ray] + t[:, None] * directions[ray]
            if posed.inverse is not None:
                point = apply_rows(posed.inverse, row, point)
            here, _ = focus.distance(point)
            # the end of a step is the next one's beginning, but where the ray leaves the band for a while
            joined = (np.r_[ray[1:], -1] == ray) & (np.abs(np.r_[t[1:], 0] - t - length) < 0.1 * length)
            there = np.where(joined, np.r_[here[1:], 0], here)
            at_step, into = focused_ends(begin, np.stack([here, there], 1), focus.reach, ends)
        end = origins[which][:, None] + (t[at_step] + into * length)[..., None] * directions[which][:, None]
        if posed.inverse is not None:
            end = apply_rows(posed.inverse, row[at_step].ravel(), end.reshape(-1, 3)).reshape(end.shape)
        pixel = pixels[which]
        lit = mask[pixel[:, 0], pixel[:, 1]]
        color = video.images[frame][pixel[:, 0], pixel[:, 1]] / np.float32(255) * lit[:, None]
        kept.append(
            (
                end.astype(np.float32),
                row[at_step].astype(np.int32),
                directions[which].astype(np.float32),
                np.full(len(which), frame, np.int32),
                color.astype(np.float32),
                lit.astype(np.float32),
            )
        )
    if not kept:
        raise ValueError(f"no ray of the {video.part} video meets the template inside the {part.name} box")
    end, row, direction, of_frame, color, lit = (np.concatenate([rows[i] for rows in kept]) for i in range(6))
    quaternions = np.stack(bones).astype(np.float32) if bones else None
    return TrainingRays(end, row, direction, of_frame, color, lit, quaternions, dropped / max(tried, 1),
                        lost / max(on_person, 1))  # fmt: skip


def _by_closed_distance(focus: Focus, posed: PosedTemplate, thin: Int[Array, "thin"]) -> Resign:
    """Signs by the template's closed grid instead of the nearest sample's normal, where the grid holds the point."""

    def resign(points: Array, sample: Array, distance: Array) -> Array:
        canonical = points
        if posed.inverse is not None:
            canonical = apply_rows(posed.inverse, thin[sample], points)
        closed, held = focus.distance(canonical)
        return np.where(held & (closed > 0), np.abs(distance), distance)

    return resign


def _choose_pixels(
    mask: Array, unsure: Array | None, count: int, background: float, reach: float, rng: np.random.Generator
) -> Array:
    """Random pixels (row, column) on the person and within `reach` pixels of it, all equally likely; none unsure.

    Were the two sides of an outline drawn unequally often, their losses would balance beside it and not on it.
    At most the share `background` lies beside the person all the same.
    """
    if not mask.any():
        return np.zeros((0, 2), int)
    away = distance_to(mask)
    near = away < max(reach, 2.0)
    if unsure is not None:
        near &= ~unsure
    chosen = rng.permutation(np.argwhere(near))
    beside = away[tuple(chosen.T)] > 0
    share = min(float(beside.mean()), background) if len(chosen) else 0.0
    outside = int(count * share)
    chosen = np.concatenate([chosen[beside][:outside], chosen[~beside][: count - outside]])
    return chosen[:count]


def _first_steps(ray: Int[Array, "steps"]) -> Int[Array, "rays"]:
    """Where each ray's steps begin; steps are in order of ray."""
    return np.flatnonzero(np.r_[True, ray[1:] != ray[:-1]])


def _choose_steps(
    ray: Int[Array, "steps"],
    distance: Float[Array, "steps"],
    canonical: Float[Array, "steps 3"],
    ok: Bool[Array, "steps"],
    part: Part,
    band: Band,
) -> tuple[int, int, Bool[Array, "steps"]]:
    """Steps that train the part: inside its box, of rays that meet the template there.

    Rays whose map to the canonical pose did not settle (`ok`) near the surface are left out whole.

    Returns:
        how many rays meet the template in the box, how many of them are left out, and the steps to keep.
    """
    first = _first_steps(ray)
    of_ray = np.repeat(np.arange(len(first)), np.diff(np.r_[first, len(ray)]))
    inside = part.extent.contains(canonical)
    trains = part.extent.contains(canonical[_meeting_step(ray, first, distance)])
    doubtful = np.zeros(len(first), bool)
    np.logical_or.at(doubtful, of_ray[~ok & inside & (np.abs(distance) < band.outside / 3)], True)
    keep = (trains & ~doubtful)[of_ray] & inside
    return int(trains.sum()), int((trains & doubtful).sum()), keep


def _meeting_step(ray: Array, first: Array, distance: Array) -> Array:
    """Of each ray the step that first lies under the template, else the one closest to it."""
    last = np.r_[first[1:], len(ray)]
    index = np.arange(len(ray))
    under = np.where(distance < 0, index, len(ray))
    first_under = np.minimum.reduceat(under, first)
    closest = np.lexsort((np.abs(distance), ray))[first]
    return np.where(first_under < last, first_under, closest)
