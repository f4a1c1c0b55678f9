"""What AniNeRF and NeuralBody share: posed rays, volume rendering of a density, and meshes by a threshold.

Both map posed points on their own, so the section ends that train/rays.py caches in the canonical frame are of no use
to them. Rays are marched to the same template in the same bands, but stay where the person stands, in the *root frame*:
the person in its pose with the pelvis where it is at rest, unturned. A head's video shows the big pose (Eq. 6 moves it
there). Rendering is NeRF's (Mildenhall et al. 2020, Eq. 3): log(1 - alpha_i) = -sigma(x_i) |x_{i+1} - x_i|.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.ndimage import binary_dilation
from scipy.spatial import KDTree
from torch import Tensor, nn

from avatar.camera import Camera, project
from avatar.skeleton import BIG_POSE, PARTS, skin_transforms
from avatar.skinning import skin_normals, skin_points
from bench.field.posed_field import MaskedPicture
from capture.fit.refine import with_learned
from capture.folder import Capture, CaptureSubject, PartVideo, read_capture, read_subject
from capture.template.parts import part_boxes
from capture.template.surface import SurfaceCloud, signed, surface_cloud, visible_faces
from command.errors import AssetError
from experiments.rivals.single import joined_cloud, place_read_from
from geometry.cells import distance_to
from geometry.isosurface import zero_set_mesh
from geometry.mesh import TriangleMesh, largest_component
from train.deform import positional_encoding
from train.networks import frame_codes
from train.preset import Preset
from train.rays import Band, FilmedPart, PosedTemplate, choose_pixels, march, spread_ends
from train.render import accumulated, section_lengths

# per metre: a density from which on a mesh is solid, as the authors' code extracts it (mesh_th)
SOLID = 50.0


class PosedRays(NamedTuple):
    """Rays of one frame in its root frame, metres; R rays, E section ends each."""

    ends: Float[Array, "rays ends 3"]
    # template sample near each end
    row: Int[Array, "rays ends"]
    # whether an end lies in the band of the part it is near
    near: Bool[Array, "rays ends"]
    direction: Float[Array, "rays 3"]  # unit, away from the camera
    pixel: Int[Array, "rays 2"]  # row, column


class Frame(NamedTuple):
    """Rays of one frame on the training device, and how its person stands."""

    ends: Float[Tensor, "rays ends 3"]
    row: Int[Tensor, "rays ends"]
    near: Bool[Tensor, "rays ends"]
    direction: Float[Tensor, "rays 3"]
    bones: Float[Tensor, "52 3 4"]  # root frame from canonical
    # of the four videos together; -1: none of them
    number: int
    color: Float[Tensor, "rays 3"]  # sRGB, black beside the person
    mask: Float[Tensor, "rays"]

    def chosen(self, rays: Int[Tensor, "b"]) -> "Frame":
        """Some of the rays."""
        of = lambda values: values[rays]
        return Frame(of(self.ends), of(self.row), of(self.near), of(self.direction), self.bones, self.number,
                     of(self.color), of(self.mask))  # fmt: skip


class Sections(NamedTuple):
    """What a system says of the sections of rays, each where it begins."""

    density: Float[Tensor, "b k"]  # per metre
    color: Float[Tensor, "b k 3"]
    # a term of its own in the loss
    extra: Float[Tensor, ""] | None = None


class DensityField(nn.Module, ABC):
    """A system whose geometry is a density."""

    @abstractmethod
    def sections(self, points: Float[Tensor, "b k 3"], frame: Frame) -> Sections:
        """Density and color at points of the frame's root frame; `frame` holds the rays that they lie on."""

    def settle(self, body_frames: int) -> None:
        """Called after the last step; the first `body_frames` frames are the body video's."""


class FrameCodes(nn.Module):
    """A code for each frame, and the one that frames outside of the videos get: the body frames' mean."""

    reference: Float[Tensor, "l"]

    def __init__(self, frames: int, size: int):
        super().__init__()
        self.of_frame = frame_codes(frames, size)
        self.register_buffer("reference", torch.zeros(size))

    def forward(self, number: int, count: int) -> Float[Tensor, "n l"]:
        """The code of a frame, for `count` points."""
        code = self.reference if number < 0 else self.of_frame.weight[number]
        return code.expand(count, -1)

    @torch.no_grad()
    def settle(self, body_frames: int) -> None:
        """Take the mean of the first frames, the body video's."""
        self.reference.copy_(self.of_frame.weight[:body_frames].mean(0))


class NerfColor(nn.Module):
    """Color of features, a frame's code, a direction, and what stands `beside` it, as both systems' code has it."""

    def __init__(self, feature: int, code: int, width: int, beside: int = 0):
        super().__init__()
        self.feature, self.with_code = nn.Linear(feature, width), nn.Linear(width + code, width)
        self.seen, self.out = nn.Linear(width + 27 + beside, width // 2), nn.Linear(width // 2, 3)
        for layer, gain in ((self.feature, 1.0), (self.with_code, 1.0), (self.seen, 2.0)):
            begin_as_wide(layer, gain)

    def forward(
        self, feature: Float[Tensor, "n f"], code: Float[Tensor, "n l"], direction: Float[Tensor, "n 3"],
        beside: Float[Tensor, "n b"] | None = None,
    ) -> Float[Tensor, "n 3"]:  # fmt: skip
        """sRGB in [0, 1]."""
        inputs = [self.with_code(torch.cat([self.feature(feature), code], -1)), positional_encoding(direction, 4)]
        inputs += [] if beside is None else [beside]
        return torch.sigmoid(self.out(torch.relu(self.seen(torch.cat(inputs, -1)))))


def begin_as_wide(network: nn.Module, gain: float) -> None:
    """He et al.'s weights (2015): what a network is given is as wide after each layer. By torch's own it shrinks at
    each, and a hundred steps go by before colors depend on features."""
    for layer in network.modules():
        if isinstance(layer, nn.Linear):
            nn.init.normal_(layer.weight, std=(gain / layer.in_features) ** 0.5)
            nn.init.zeros_(layer.bias)


def density_of(raw: Float[Tensor, "n"]) -> Float[Tensor, "n"]:
    """Per metre. The published networks' rectified output has to climb to hundreds; this one begins near SOLID."""
    return 2 * SOLID * nn.functional.softplus(raw)


def blended(weights: Float[Tensor, "n 52"], bones: Float[Tensor, "52 3 4"]) -> Float[Tensor, "n 3 4"]:
    """sum_k w_k B_k."""
    return (weights @ bones.flatten(1)).unflatten(1, (3, 4))


def render(field: DensityField, frame: Frame, u: Float[Tensor, "b"]) -> tuple[Tensor, Tensor, Tensor | None]:
    """Colors on black, log transmittances, and the system's own loss; `u` in [0, 1) jitters each ray."""
    ends = torch.lerp(frame.ends[:, :-1], frame.ends[:, 1:], u[:, None, None])
    sections = field.sections(ends[:, :-1], frame)
    density = torch.where(frame.near[:, :-2], sections.density, 0.0)
    weights = accumulated(-density * section_lengths(ends))
    return (weights.weights[..., None] * sections.color).sum(1), weights.log_transmittance, sections.extra


def root_bones(axis_angle: Float[Array, "52 3"], joints: Float[Array, "52 3"]) -> Float[Array, "52 4 4"]:
    """posed_from_canonical of every bone in the root frame of a pose."""
    return skin_transforms(np.concatenate([np.zeros((1, 3)), axis_angle[1:]]), joints)


def posed_rays(
    filmed: FilmedPart, posed: PosedTemplate, frame: int, pixels: Int[Array, "n 2"], bands: Sequence[Band], ends: int
) -> PosedRays | None:
    """The rays of some pixels of a frame that come near the template, `posed` there, in the root frame; None: none do.

    The march's band is the first of `bands`, which are of the parts in the order of PARTS.
    """
    cloud, band = filmed.cloud, bands[0]
    origins, directions = filmed.pixel_rays(frame, pixels)
    ray, t, distance, sample = march(origins, directions, posed.samples, band)
    if len(ray) == 0:
        return None
    begin = np.flatnonzero(np.r_[True, ray[1:] != ray[:-1]])
    which = ray[begin]
    step, into = spread_ends(np.diff(np.r_[begin, len(ray)]), ends)
    at = begin[:, None] + step
    row = filmed.thin[sample[at]]
    outside = np.array([own.outside for own in bands])[cloud.part[row]]
    points = origins[which][:, None] + (t[at] + into * band.step)[..., None] * directions[which][:, None]
    M = np.eye(4)
    if filmed.canonical_from_head is None:
        assert filmed.video.axis_angle is not None and filmed.video.root is not None
        pose, joints = filmed.video.axis_angle[frame], filmed.subject.joints
        world = skin_transforms(pose, joints, filmed.video.root[frame])[0]
        M = root_bones(pose, joints)[0] @ np.linalg.inv(world)
    return PosedRays(points @ M[:3, :3].T + M[:3, 3], row, distance[at] < outside, directions[which] @ M[:3, :3].T,
                     pixels[which])  # fmt: skip


class Skin(NamedTuple):
    """Skin of the template's samples."""

    joints: Int[Tensor, "samples 4"]
    weights: Float[Tensor, "samples 4"]

    @classmethod
    def of(cls, clouds: Sequence[SurfaceCloud]) -> "Skin":
        """The samples of several clouds, one after the other."""
        return cls(torch.cat([torch.as_tensor(cloud.skin.joints).long() for cloud in clouds]),
                   torch.cat([torch.as_tensor(cloud.skin.weights).float() for cloud in clouds]))  # fmt: skip

    def dense(self, row: Int[Tensor, "n"]) -> Float[Tensor, "n 52"]:
        """The weights of samples for all bones."""
        out = torch.zeros(len(row), 52)
        return out.scatter_add_(1, self.joints[row], self.weights[row])


@dataclass(frozen=True)
class Person:
    """A template, posable, and the bands round it where a surface is looked for."""

    subject: CaptureSubject
    cloud: SurfaceCloud  # fine on every part
    # each fine on one part, for that part's video
    of_video: list[SurfaceCloud]
    preset: Preset  # of four parts

    @property
    def skin(self) -> Skin:
        """That of all samples: of the cloud that is fine everywhere, then of the videos'."""
        return Skin.of([self.cloud, *self.of_video])

    def first_sample(self, part: int) -> int:
        """Where the samples of a part's video begin among those of `skin`."""
        return sum(len(cloud.points) for cloud in [self.cloud, *self.of_video][: part + 1])

    @property
    def bands(self) -> list[Band]:
        return [part.band for part in self.preset.parts]

    def filmed(self, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"], camera: Camera) -> FilmedPart:
        """The whole person in one picture that nobody has taken."""
        width, height = camera.size
        video = PartVideo("body", np.zeros((1, 1, 1, 3), np.uint8), np.ones((1, height, width), bool), (camera,),
                          axis_angle[None], root[None], None, None)  # fmt: skip
        return FilmedPart(part_boxes(self.subject)[0], video, self.subject, self.cloud)

    def frame(self, rays: PosedRays, axis_angle: Float[Array, "52 3"]) -> Frame:
        """Rays of a pose that no video has."""
        bones = root_bones(axis_angle, self.subject.joints)
        count = len(rays.ends)
        return frame_of(rays, bones, -1, np.zeros((count, 3), np.float32), np.zeros(count, np.float32))


def frame_of(rays: PosedRays, bones: Float[Array, "52 4 4"], number: int, color: Array, mask: Array) -> Frame:
    """Rays as tensors."""
    put = lambda array: torch.as_tensor(np.ascontiguousarray(array, np.float32))
    return Frame(put(rays.ends), torch.as_tensor(rays.row), torch.as_tensor(rays.near), put(rays.direction),
                 put(bones[:, :3]), number, put(color), put(mask))  # fmt: skip


def person_of(subject: CaptureSubject, preset: Preset) -> Person:
    """The template with samples that are fine on every part."""
    visible = visible_faces(subject)
    clouds = [surface_cloud(subject, index, visible, own.spacing) for index, own in enumerate(preset.parts)]
    # the cells in which a still head's samples are looked up may be twice as wide: the nearest nine are tried
    return Person(subject, joined_cloud(clouds), [replace(own, spacing=2 * own.spacing) for own in clouds], preset)


@dataclass(frozen=True)
class Scene:
    """What a density field learns from."""

    person: Person
    frames: list[Frame]
    # of the body's video, which come first
    body_frames: int
    # what is said of videos that are absent
    said: str = ""


def read_scene(capture_path: Path, run: Path, preset: Preset, seed: int, frames: int | None = None) -> Scene:
    """The rays of a capture's videos with what a run of four parts found before and after training: its template with
    hair and clothes, its poses, and where it put the head. `frames`: only the first so many of each video.

    Raises:
        AssetError: the run is none of four parts on this capture, or the capture is unusable.
    """
    videos = filmed_parts(capture_path)
    capture = read_capture(capture_path, parts=videos)
    place = place_read_from(run, capture).canonical_from_head
    capture = with_learned(capture, run)
    capture = first_frames(replace(capture, subject=read_subject(run / "subject.npz", capture.subject.name)), frames)
    person, found, body_frames = person_of(capture.subject, preset), [], 0
    for name in videos:
        found += video_frames(capture, name, person, place, len(found), seed)
        body_frames = body_frames or len(found)
    absent = [name for name in PARTS if name not in videos]
    said = f"no video of {', '.join(absent)}: {' and '.join(videos)} alone are learned from" if absent else ""
    return Scene(person, found, body_frames, said)


def first_frames(capture: Capture, count: int | None) -> Capture:
    """The capture with the first frames of each of its videos; None: all."""
    if count is None:
        return capture
    cut = lambda values: None if values is None else values[:count]
    videos = {}
    for name, video in capture.videos.items():
        videos[name] = replace(video, images=video.images[:count], masks=video.masks[:count],
                               cameras=video.cameras[:count], axis_angle=cut(video.axis_angle), root=cut(video.root),
                               unsure=cut(video.unsure))  # fmt: skip
    return replace(capture, videos=videos)


def filmed_parts(capture: Path) -> tuple[str, ...]:
    """The parts that a capture has videos of; body and head it must have.

    Raises:
        AssetError: one of these is absent.
    """
    found = tuple(name for name in PARTS if (capture / name).is_dir())
    for name in PARTS[:2]:
        if name not in found:
            raise AssetError(f"{capture}: no folder {name}; a person needs the videos of {' and '.join(PARTS[:2])}")
    return found


def video_frames(
    capture: Capture, name: str, person: Person, place: Float[Array, "4 4"], first: int, seed: int
) -> list[Frame]:
    """The frames of one video, numbered from `first`; `place` is canonical_from_head.

    A pixel supervises where its ray first meets the template inside the part's box, as in train/rays.py.
    """
    index, video = PARTS.index(name), capture.videos[name]
    cloud = person.of_video[index]
    part, settings = part_boxes(capture.subject)[index], person.preset.parts[index]
    filmed = FilmedPart(part, video, capture.subject, cloud, place if name == "head" else None)
    rng = np.random.default_rng([seed, index])
    bands, out = [settings.band] * len(PARTS), []
    for frame in range(len(video.images)):
        mask = video.masks[frame]
        unsure = None if video.unsure is None else video.unsure[frame]
        posed = filmed.posed(frame)
        reach = filmed.reach(frame, posed, settings.band)
        pixels = choose_pixels(mask, unsure, person.preset.rays_per_frame, settings.background, reach, rng)
        rays = posed_rays(filmed, posed, frame, pixels, bands, person.preset.sections + 2)
        if rays is None:
            continue
        own = part.extent.contains(cloud.points[rays.row[:, -1]])
        rays = PosedRays(*(values[own] for values in rays))
        rays = rays._replace(row=rays.row + person.first_sample(index))
        pose = BIG_POSE if video.axis_angle is None else video.axis_angle[frame]
        on = mask[tuple(rays.pixel.T)]
        color = video.images[frame][tuple(rays.pixel.T)] / np.float32(255) * on[:, None]
        if len(on):
            out.append(frame_of(rays, root_bones(pose, capture.subject.joints), first + len(out), color, on))
    return out


@torch.no_grad()
def draw(
    field: DensityField, person: Person, pose: tuple[Array, Array], camera: Camera,
    where: Bool[Array, "height width"] | None = None,
) -> MaskedPicture:  # fmt: skip
    """The person on black in a pose (angles and root), a ray through the middle of each pixel of `where`."""
    width, height = camera.size
    picture = MaskedPicture(np.zeros((height, width, 3), np.float32), np.zeros((height, width), bool))
    filmed = person.filmed(*pose, camera)
    posed = filmed.posed(0)
    at, depth = project(camera, posed.samples.points)
    column, row = np.floor(at[depth > 0]).astype(int).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    if not inside.any():
        return picture
    covered = np.zeros((height, width), bool)
    covered[row[inside], column[inside]] = True
    # twice as far: the person is nearer to the camera than its middle here and there
    close = distance_to(covered) < 2 * max(filmed.reach(0, posed, person.bands[0]), 4.0)
    pixels = np.argwhere(close if where is None else close & where)
    rays = posed_rays(filmed, posed, 0, pixels, person.bands, person.preset.sections + 2)
    if rays is None:
        return picture
    frame = person.frame(rays, pose[0])
    for piece in torch.arange(len(rays.ends)).split(4096):
        color, log_transmittance, _ = render(field, frame.chosen(piece), torch.zeros(len(piece)))
        at = tuple(rays.pixel[piece.numpy()].T)
        picture.color[at] = color.clamp(0, 1).numpy()
        picture.mask[at] = (log_transmittance < np.log(0.5)).numpy()
    return picture


def solid_mesh(
    cloud: SurfaceCloud, bones: Float[Array, "52 4 4"], bands: Sequence[Band], cell: float,
    density: Callable[[Float[Tensor, "n 3"], Int[Tensor, "n"]], Float[Tensor, "n"]],
) -> TriangleMesh:  # fmt: skip
    """The surface of what is denser than SOLID round the template under `bones`; `density` takes points and the
    template samples nearest to them.

    Deeper under the template than rays go all is solid: nothing was learned there.

    Raises:
        ValueError: nothing is solid.
    """
    points, normals = skin_points(cloud.points, cloud.skin, bones), skin_normals(cloud.normals, cloud.skin, bones)
    margin = max(band.outside for band in bands) + 2 * cell
    low, high = points.min(0) - margin, points.max(0) + margin
    axes = [np.arange(low[i], high[i] + cell, cell) for i in range(3)]
    close = np.zeros([len(axis) for axis in axes], bool)
    close[tuple(np.rint((points - low) / cell).astype(int).T)] = True
    near = np.argwhere(binary_dilation(close, iterations=int(np.ceil(margin / cell))))
    at = np.stack([axes[i][near[:, i]] for i in range(3)], 1)
    length, row = KDTree(points).query(at)
    row = np.asarray(row)
    distance = signed(at, length, points[row], normals[row], cloud.gap[row])
    outside = np.array([band.outside for band in bands])[cloud.part[row]]
    inside = np.array([band.inside for band in bands])[cloud.part[row]]
    value = np.where(distance < -inside, -1.0, 1.0).astype(np.float32)
    asked = np.flatnonzero((distance > -inside) & (distance < outside))
    with torch.no_grad():
        found = [density(torch.as_tensor(at[piece], dtype=torch.float32), torch.as_tensor(row[piece])).numpy()
                 for piece in np.array_split(asked, max(len(asked) // 65536, 1))]  # fmt: skip
    value[asked] = np.clip(1 - np.concatenate(found) / SOLID, -1, 1)
    values = np.ones(close.shape, np.float32)
    values[tuple(near.T)] = value
    if not values.min() < 0:
        raise ValueError(f"nothing is denser than {SOLID:g} per metre")
    return largest_component(zero_set_mesh(values, axes))[0]
