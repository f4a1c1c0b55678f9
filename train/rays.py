"""Training rays of one part: which pixels supervise it, and where along each ray the surface can be.

Everything that does not change while the field learns is computed once: the march to the template, the posed to
canonical map at every section end (Eq. 3, or the rigid motion of Eq. 4), the pixel colors.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.spatial import KDTree
from torch import Tensor

from avatar.camera import pixel_rays
from avatar.rotation import quaternion_from_matrix
from avatar.skeleton import PARTS, skin_transforms
from avatar.skinning import SkinWeights, skin_normals, skin_points
from capture.folder import CaptureSubject, PartVideo
from capture.template.parts import Part
from capture.template.surface import SampleGrid, SurfaceCloud, sample_grid, signed
from command.errors import AssetError
from geometry.cells import distance_to
from train.deform import apply_rows, canonical_from_posed, inverse_transforms

# metres round the samples of a rigid head in which the nearest of them is looked up
BESIDE = 0.045


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
class RayTensors:
    """Rays with their cached section ends, on the training device."""

    ends: Float[Tensor, "rays ends 3"]  # canonical, metres
    # template sample that each end follows
    row: Int[Tensor, "rays ends"]
    # unit, away from the camera; world (body, hands) or canonical (head)
    direction: Float[Tensor, "rays 3"]
    frame: Int[Tensor, "rays"]
    color: Float[Tensor, "rays 3"]  # sRGB in [0, 1], black outside the mask
    mask: Float[Tensor, "rays"]
    # posed_from_canonical, xyzw; None: rigid, canonical directions
    bones: Float[Tensor, "frames 52 4"] | None
    # the template samples' skin, heaviest bone first
    joints: Int[Tensor, "samples 4"]
    weights: Float[Tensor, "samples 4"]


class PartRays(NamedTuple):
    """The rays of a video that train its part."""

    rays: RayTensors
    # share of rays left out because their map to the canonical pose did not settle
    flagged: float
    # share of the chosen pixels on the person whose ray meets no template: too far from it, or lost on the way
    lost: float


class StillSamples(NamedTuple):
    """Samples that the rays of all frames are marched to, so that the nearest is looked up: that of a cell, or one
    of those beside it. A search tree took four fifths of a head's preparation."""

    points: Float[Array, "s 3"]
    grid: SampleGrid
    beside: Int[Array, "s near"]  # the nearest samples of each, itself first

    @classmethod
    def of(cls, points: Float[Array, "s 3"], cell: float) -> "StillSamples":
        """Looked up in `cell` (metres), in a box that is BESIDE wider than they are."""
        grid = sample_grid(points, points.min(0) - BESIDE, points.max(0) + BESIDE, cell)
        return cls(points, grid, KDTree(points).query(points, k=min(9, len(points)))[1].reshape(len(points), -1))

    def nearest(self, points: Float[Array, "n 3"]) -> tuple[Float[Array, "n"], Int[Array, "n"]]:
        """Distance to the nearest sample and its number."""
        high = self.grid.low + self.grid.cell * (np.array(self.grid.rows.shape) - 0.5)
        near = self.beside[self.grid.nearest(np.clip(points, self.grid.low, high))]
        away = np.square(self.points[near] - points[:, None]).sum(-1)
        best = away.argmin(1)[:, None]
        return np.sqrt(np.take_along_axis(away, best, 1)[:, 0]), np.take_along_axis(near, best, 1)[:, 0]


class Samples(NamedTuple):
    points: Float[Array, "s 3"]
    normals: Float[Array, "s 3"]  # unit
    gap: Float[Array, "s"]  # as SurfaceCloud.gap
    still: StillSamples | None = None

    def finder(self, reach: float) -> Callable[[Float[Array, "n 3"]], tuple[Float[Array, "n"], Int[Array, "n"]]]:
        """What finds the distance to the nearest sample and its number; beyond `reach` (metres) neither counts."""
        if self.still is not None:
            return self.still.nearest
        tree, cores = KDTree(self.points), torch.get_num_threads()

        def nearest(points: Array) -> tuple[Array, Array]:
            length, sample = tree.query(points, distance_upper_bound=reach, workers=cores)
            return np.asarray(length), np.asarray(sample)

        return nearest


def march(
    origins: Float[Array, "n 3"], directions: Float[Array, "n 3"], template: Samples, band: Band
) -> tuple[Int[Array, "k"], Float[Array, "k"], Float[Array, "k"], Int[Array, "k"]]:
    """Steps of every ray inside the band around the (posed) template: ray, t, signed distance, nearest sample.

    Far from the surface a ray jumps by its distance less the band (sphere tracing); inside the band it walks in
    fixed steps until it is `inside` deep or out of the box. Steps come in order of ray, then t.

    Raises:
        ValueError: a direction is not of unit length (zero, NaN), or an origin is not finite.
    """
    bad = np.flatnonzero(~(np.abs((directions**2).sum(1) - 1) < 1e-3) | ~np.isfinite(origins).all(1))
    if len(bad):
        raise ValueError(f"ray {bad[0]}: expected a finite origin and a unit direction, is {directions[bad[0]]}")
    cloud_points = template.points
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
    found: list[tuple[Array, ...]] = [(np.zeros(0, int), np.zeros(0), np.zeros(0), np.zeros(0, int))]
    reach = 3 * band.outside
    nearest = template.finder(reach)
    waiting = active
    for _ in range(24):
        length, _ = thin_tree.query(origins[waiting] + t[waiting, None] * directions[waiting])
        jump = length - margin - band.outside
        t[waiting] += np.maximum(jump, 0)
        waiting = waiting[(jump > 0.3 * reach) & (t[waiting] < far[waiting])]
    active = active[t[active] < far[active]]
    # a ray along an arm stays in the band for some hundred steps, and is through the box in these
    for _ in range(int((far - t)[active].max(initial=0) / band.step) + 2):
        if len(active) == 0:
            break
        points = origins[active] + t[active, None] * directions[active]
        length, sample = nearest(points)
        length, sample = np.minimum(length, reach), np.minimum(sample, len(cloud_points) - 1)
        distance = signed(points, length, cloud_points[sample], template.normals[sample], template.gap[sample])
        distance = np.where(length < reach, distance, reach)
        within = (length <= band.outside * 1.001) & (distance > -band.inside - band.step)
        found.append((active[within], t[active[within]], distance[within], sample[within]))
        t[active] += np.maximum(length - band.outside, band.step)
        active = active[(distance > -band.inside) & (t[active] < far[active])]
    ray, at, distance, sample = (np.concatenate([step[i] for step in found]) for i in range(4))
    order = np.lexsort((at, ray))
    return ray[order], at[order], distance[order], sample[order]


def spread_ends(counts: Int[Array, "n"], ends: int) -> tuple[Int[Array, "n ends"], Float[Array, "n ends"]]:
    """Section ends spread evenly over the steps of each ray: index of the step, and how far into it."""
    place = np.linspace(0, 1, ends)[None, :] * counts[:, None]
    step = np.minimum(place.astype(int), counts[:, None] - 1)
    return step, place - step


class PosedTemplate(NamedTuple):
    """The template in one frame of a video, in the frame that its rays are marched in."""

    # thinned samples
    samples: Samples
    # the part's own middle
    middle: Float[Array, "3"]
    # canonical_from_posed of every sample; None: rays are canonical
    inverse: Float[Array, "samples 3 4"] | None = None
    invertible: Bool[Array, "samples"] | None = None
    bones: Float[Array, "52 4"] | None = None  # posed_from_canonical, xyzw


@dataclass(frozen=True)
class FilmedPart:
    """A part, its video, and the template that the video's rays are marched to."""

    part: Part
    video: PartVideo
    subject: CaptureSubject
    cloud: SurfaceCloud
    # moves the rays of a head, which is rigid; None: the video shows a posed person
    canonical_from_head: Float[Array, "4 4"] | None = None

    @cached_property
    def thin(self) -> Int[Array, "thin"]:
        """Samples that rays are marched to: to a few millimetres a quarter of them, twice as far apart, is enough."""
        return np.arange(0, len(self.cloud.points), 4)

    @cached_property
    def still(self) -> Samples:
        """The samples of a rigid head."""
        cloud, thin = self.cloud, self.thin
        points = cloud.points[thin]
        return Samples(points, cloud.normals[thin], 2 * cloud.gap[thin], StillSamples.of(points, cloud.spacing))

    @property
    def scale(self) -> float:
        """Canonical metres of a length in the video's frame."""
        M = self.canonical_from_head
        return 1.0 if M is None else float(np.cbrt(np.linalg.det(M[:3, :3])))

    def posed(self, frame: int) -> PosedTemplate:
        """The template in a frame: as it is for a head, else skinned to the world, with its inverse maps (Eq. 3)."""
        cloud, thin = self.cloud, self.thin
        own = cloud.part[thin] == PARTS.index(self.part.name)
        if self.canonical_from_head is not None:
            return PosedTemplate(self.still, self.still.points[own].mean(0))
        assert self.video.axis_angle is not None and self.video.root is not None
        B = skin_transforms(self.video.axis_angle[frame], self.subject.joints, self.video.root[frame])
        skin = SkinWeights(cloud.skin.joints[thin], cloud.skin.weights[thin])
        inverse, invertible = inverse_transforms(cloud.skin, B)
        points = skin_points(cloud.points[thin], skin, B)
        samples = Samples(points, skin_normals(cloud.normals[thin], skin, B), 2 * cloud.gap[thin])
        bones = quaternion_from_matrix(B[:, :3, :3])
        return PosedTemplate(samples, points[own].mean(0), inverse, invertible, bones)

    def reach(self, frame: int, posed: PosedTemplate, band: Band) -> float:
        """Pixels beside the person in which a ray may still meet the band."""
        camera, middle = self.video.cameras[frame], posed.middle
        if self.canonical_from_head is not None:
            middle = np.linalg.solve(self.canonical_from_head, np.append(middle, 1))[:3]
        away = max(float(np.linalg.norm(middle - camera.eye)), 1e-9)
        return float(camera.K[0, 0] * band.outside / self.scale / away)

    def pixel_rays(self, frame: int, pixels: Int[Array, "n 2"]) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """Origins and unit directions of the rays of pixels (row, column), where the template is posed."""
        origins, directions = pixel_rays(self.video.cameras[frame], pixels[:, ::-1] + 0.5)
        M = self.canonical_from_head
        if M is None:
            return origins, directions
        return origins @ M[:3, :3].T + M[:3, 3], directions @ M[:3, :3].T / self.scale


@dataclass(frozen=True, kw_only=True)
class RaySettings:
    """Which rays of a video train its part, and how many sections each has."""

    band: Band
    # section ends of a ray
    ends: int
    # rays of each frame at most
    per_frame: int
    # share of the rays that may lie beside the person, at most
    background: float = 1.0


class _FrameRays(NamedTuple):
    """What a frame adds to RayTensors, and how many of its rays are left out."""

    rays: tuple[Array, ...] | None  # ends, row, direction, frame, color, mask; None: none of its rays trains the part
    meeting: int  # rays that meet the template in the part's box
    ambiguous: int  # those of them whose map to the canonical pose did not settle
    pictured: int  # rays of pixels on the person
    lost: int  # those of them that meet no template


def part_rays(
    filmed: FilmedPart, settings: RaySettings, rng: np.random.Generator, device: torch.device | str = "cpu"
) -> PartRays:
    """The rays of a video that train its part.

    A pixel supervises a part when its ray first meets the template inside the part's box, or, for a ray that
    passes by, when its closest approach lies in the box (FRAMES.md). Sections never leave the box.

    Raises:
        AssetError: no ray meets the template in the box.
    """
    part, cloud, count = filmed.part, filmed.cloud, len(filmed.video.masks)
    grid = sample_grid(cloud.points, part.extent.low - 0.02, part.extent.high + 0.02, cloud.spacing)
    frames, bones = [], []
    for frame in range(count):
        posed = filmed.posed(frame)
        frames.append(_frame_rays(filmed, frame, posed, grid, settings, rng))
        if posed.bones is not None:
            bones.append(posed.bones)
    kept = [one.rays for one in frames if one.rays is not None]
    if not kept:
        raise AssetError(
            f"the {filmed.video.part} video: no ray meets the template inside the {part.name} box, nothing can be "
            "learned from it; `selfscan check` shows how its masks, cameras and poses fit"
        )
    put = lambda array: torch.as_tensor(np.ascontiguousarray(array)).to(device)
    ends, row, direction, of_frame, color, on = (put(np.concatenate(columns)) for columns in zip(*kept))
    quaternions = put(np.stack(bones).astype(np.float32)) if bones else None
    joints, weights = put(cloud.skin.joints).long(), put(cloud.skin.weights)
    rays = RayTensors(ends, row, direction, of_frame.long(), color, on, quaternions, joints, weights)
    flagged = sum(one.ambiguous for one in frames) / max(sum(one.meeting for one in frames), 1)
    lost = sum(one.lost for one in frames) / max(sum(one.pictured for one in frames), 1)
    return PartRays(rays, flagged, lost)


def _frame_rays(
    filmed: FilmedPart, frame: int, posed: PosedTemplate, grid: SampleGrid, settings: RaySettings,
    rng: np.random.Generator,
) -> _FrameRays:  # fmt: skip
    """One frame: its rays are marched, mapped to the canonical frame, chosen, and cut into sections."""
    video, band, mask = filmed.video, settings.band, filmed.video.masks[frame]
    unsure = None if video.unsure is None else video.unsure[frame]
    reach = filmed.reach(frame, posed, band)
    pixels = choose_pixels(mask, unsure, settings.per_frame, settings.background, reach, rng)
    origins, directions = filmed.pixel_rays(frame, pixels)
    ray, t, distance, sample = march(origins, directions, posed.samples, band)
    on = mask[pixels[:, 0], pixels[:, 1]]
    met = np.zeros(len(pixels), bool)
    met[ray] = True
    pictured, lost = int(on.sum()), int((on & ~met).sum())
    if len(ray) == 0:
        return _FrameRays(None, 0, 0, pictured, lost)

    row, ok, canonical = filmed.thin[sample], np.ones(len(ray), bool), origins[ray] + t[:, None] * directions[ray]
    if posed.inverse is not None and posed.invertible is not None:
        # neighbouring samples differ by this much near a joint
        settled = max(1e-4, 0.25 * filmed.cloud.spacing)
        row, canonical, ok = canonical_from_posed(canonical, row, posed.inverse, grid.nearest, settled=settled)
        ok &= posed.invertible[row]
    meeting, ambiguous, keep = _choose_steps(ray, distance, canonical, ok, filmed.part, band)
    if not keep.any():
        return _FrameRays(None, meeting, ambiguous, pictured, lost)

    ray, t, row = ray[keep], t[keep], row[keep]
    begin = _first_steps(ray)
    which = ray[begin]
    step, into = spread_ends(np.diff(np.r_[begin, len(ray)]), settings.ends)
    at = begin[:, None] + step
    ends = origins[which][:, None] + (t[at] + into * band.step)[..., None] * directions[which][:, None]
    if posed.inverse is not None:
        ends = apply_rows(posed.inverse, row[at].ravel(), ends.reshape(-1, 3)).reshape(ends.shape)
    pixel = pixels[which]
    color = video.images[frame][pixel[:, 0], pixel[:, 1]] / np.float32(255) * on[which][:, None]
    of_frame = np.full(len(which), frame, np.int32)
    columns = (ends, row[at].astype(np.int32), directions[which], of_frame, color, on[which])
    rays = tuple(one if one.dtype == np.int32 else one.astype(np.float32) for one in columns)
    return _FrameRays(rays, meeting, ambiguous, pictured, lost)


def choose_pixels(
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
    return np.flatnonzero(np.r_[True, ray[1:] != ray[:-1]])


def _choose_steps(
    ray: Int[Array, "steps"], distance: Float[Array, "steps"], canonical: Float[Array, "steps 3"],
    ok: Bool[Array, "steps"], part: Part, band: Band,
) -> tuple[int, int, Bool[Array, "steps"]]:  # fmt: skip
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
    """The step of each ray that first lies under the template, else the one closest to it."""
    last = np.r_[first[1:], len(ray)]
    index = np.arange(len(ray))
    under = np.where(distance < 0, index, len(ray))
    first_under = np.minimum.reduceat(under, first)
    closest = np.lexsort((np.abs(distance), ray))[first]
    return np.where(first_under < last, first_under, closest)
