"""Pictures of the trained field by volume rendering through the boxes of the bones, and how such a picture refines.

No surface says where to look: each pixel's ray is cut into sections wherever it passes the box round what a bone
moves (skipping the empty space between limbs), and their ends follow the nearest vertex of the posed surface back into
the canonical frame, as training's do (inverse skinning). So silhouettes are the field's own. A picture refines from
coarse to fine: resolution doubles until it is the camera's, then samples at other places of each pixel are accumulated.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from skimage.transform import resize

from avatar.camera import Camera, pixel_rays
from avatar.skinning import blended_rotations, blended_transforms
from bake.cone import ViewCone
from bench.field_volume import CHUNK, LEAST, crossing, section_weights
from bench.posed_field import MaskedPicture, PosedField

Array = np.ndarray
# metres round a bone's vertices, and from the nearest vertex to what is still asked: about the band of training
MARGIN = 0.03
# a bone that moves fewer vertices has no box
FEWEST = 8
# samples of a pixel from its middle, pixels; all of them together lie in the middle
OFFSETS = ((0.0, 0.0), (0.33, 0.1), (-0.25, 0.25), (-0.08, -0.35))


class Boxes(NamedTuple):
    """Boxes in frames of their own."""

    low: Float[Array, "boxes 3"]
    high: Float[Array, "boxes 3"]
    # rigid
    box_from_world: Float[Array, "boxes 4 4"]


class PosedVolume:
    """A field in one pose: boxes of its bones, and what takes a point of the world back into the canonical frame."""

    def __init__(self, field: PosedField, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"]):
        surface, self.field = field.surface, field
        transforms = surface.transforms(axis_angle, root)
        self.tree = KDTree(field.posed(axis_angle, root))
        self.back = np.linalg.inv(blended_transforms(surface.skin, transforms))
        self.turns = blended_rotations(surface.skin, transforms)
        self.boxes = self._boxes(transforms)

    def _boxes(self, transforms: Float[Array, "52 4 4"]) -> Boxes:
        """Of the posed vertices that each bone moves most, in the frame in which the bone moves them rigidly."""
        skin = self.field.surface.skin
        heaviest = np.take_along_axis(skin.joints, skin.weights.argmax(1)[:, None], 1)[:, 0]
        low, high, into = [], [], []
        for bone, transform in enumerate(transforms):
            own = np.asarray(self.tree.data)[heaviest == bone]
            if len(own) < FEWEST:
                continue
            inverse = np.linalg.inv(transform)
            points = own @ inverse[:3, :3].T + inverse[:3, 3]
            low.append(points.min(0) - MARGIN)
            high.append(points.max(0) + MARGIN)
            into.append(inverse)
        return Boxes(np.array(low), np.array(high), np.array(into))

    def distance(self, points: Float[Array, "n 3"]) -> tuple[Float[Array, "n"], Float[Array, "n 3"], Int[Array, "n"]]:
        """Signed distance at points of the world, their canonical points, their nearest vertices; farther than MARGIN
        from the surface nothing is asked: it counts as empty, also deep inside, where light has long been stopped."""
        far, nearest = self.tree.query(points, distance_upper_bound=MARGIN)
        near = np.flatnonzero(np.isfinite(far))
        nearest = np.where(np.isfinite(far), nearest, 0)
        canonical, distance = np.zeros_like(points), np.full(len(points), MARGIN)
        back = self.back[nearest[near]]
        canonical[near] = np.einsum("nij,nj->ni", back[:, :3, :3], points[near]) + back[:, :3, 3]
        if len(near):
            distance[near] = self.field.distance(canonical[near])
        return distance, canonical, nearest


def box_spans(
    boxes: Boxes, origins: Float[Array, "rays 3"], directions: Float[Array, "rays 3"]
) -> tuple[Float[Array, "rays boxes"], Float[Array, "rays boxes"]]:
    """Where each ray passes each box, in front of the eye and counted once: begin and length of pieces that do not
    overlap, in order along the ray; length 0 where there is none."""
    count = len(boxes.low)
    enter, leave = np.empty((len(origins), count)), np.empty((len(origins), count))
    for index in range(count):
        into = boxes.box_from_world[index]
        eye, ray = origins @ into[:3, :3].T + into[:3, 3], directions @ into[:3, :3].T
        # a ray along a face: huge numbers of the right sign instead of a division by zero
        ray = np.where(np.abs(ray) < 1e-12, 1e-12, ray)
        first, second = (boxes.low[index] - eye) / ray, (boxes.high[index] - eye) / ray
        enter[:, index] = np.maximum(np.minimum(first, second).max(1), 0)
        leave[:, index] = np.maximum(first, second).min(1)
    missed = leave <= enter
    enter[missed], leave[missed] = np.inf, np.inf
    order = np.argsort(enter, axis=1)
    enter, leave = np.take_along_axis(enter, order, 1), np.take_along_axis(leave, order, 1)
    passed = np.maximum.accumulate(np.where(np.isinf(leave), 0, leave), axis=1)
    begin = np.maximum(enter, np.pad(passed[:, :-1], ((0, 0), (1, 0))))
    hit = np.isfinite(begin)
    length = np.where(hit, np.maximum(np.where(hit, leave, 0) - np.where(hit, begin, 0), 0), 0)
    return np.where(hit, begin, 0), length


def spread(
    begin: Float[Array, "rays boxes"], length: Float[Array, "rays boxes"], count: int
) -> Float[Array, "rays count"]:
    """Distances along each ray, evenly over its pieces, from where the first begins to where the last ends."""
    ends = np.cumsum(length, axis=1)
    along = ends[:, -1:] * np.linspace(0, 1, count)
    piece = (along[:, :, None] > ends[:, None, :]).sum(2)
    before = np.take_along_axis(ends - length, piece, 1)
    return np.take_along_axis(begin, piece, 1) + along - before


def draw_boxes(
    volume: PosedVolume,
    camera: Camera,
    *,
    beta: float,
    sections: int,
    offset: tuple[float, float] = (0.0, 0.0),
) -> MaskedPicture:
    """One picture on black, colors inside the cone that training saw. `beta` is the surface's width, metres; `offset`
    moves the samples from the middles of the pixels."""
    width, height = camera.size
    image, opacity = np.zeros((height * width, 3)), np.zeros(height * width)
    rows, columns = np.divmod(np.arange(height * width), width)
    places = np.stack([columns, rows], -1) + 0.5 + np.asarray(offset)
    for start in range(0, len(places), CHUNK):
        origins, directions = pixel_rays(camera, places[start : start + CHUNK])
        begin, length = box_spans(volume.boxes, origins, directions)
        met = np.flatnonzero(length.sum(1) > 0)
        if len(met):
            color, share = through_boxes(
                volume, origins[met], directions[met], spread(begin[met], length[met], sections + 1), beta
            )
            image[start + met], opacity[start + met] = color, share
    color = np.clip(image, 0, 1).reshape(height, width, 3).astype(np.float32)
    return MaskedPicture(color, opacity.reshape(height, width) >= 0.5)


def through_boxes(
    volume: PosedVolume,
    origins: Float[Array, "rays 3"],
    directions: Float[Array, "rays 3"],
    along: Float[Array, "rays ends"],
    beta: float,
) -> tuple[Float[Array, "rays 3"], Float[Array, "rays"]]:
    """Color on black and opacity of rays cut at `along`."""
    points = origins[:, None] + along[:, :, None] * directions[:, None]
    distance, canonical, nearest = volume.distance(points.reshape(-1, 3))
    distance, canonical = distance.reshape(along.shape), canonical.reshape(points.shape)
    nearest = nearest.reshape(along.shape)
    shares = section_weights(distance, beta)
    ray, section = np.nonzero(shares > LEAST)
    at = crossing(distance, canonical)[ray, section]
    vertex, cone = nearest[ray, section + 1], volume.field.cone
    seen = ViewCone(cone.direction[vertex], cone.metric[vertex], cone.seen[vertex])
    shown = volume.field.shown(at, seen, volume.turns[vertex], directions[ray], "cone")
    color, opacity = np.zeros((len(origins), 3)), np.zeros(len(origins))
    np.add.at(color, ray, shares[ray, section][:, None] * shown)
    np.add.at(opacity, ray, shares[ray, section])
    return color, opacity


def progressive(
    volume: PosedVolume, camera: Camera, *, beta: float, sections: int, samples: int = len(OFFSETS)
) -> Iterator[Float[Array, "height width 3"]]:
    """The picture as it refines, at full size each time: a quarter of the resolution, half, all, then the mean of ever
    more samples a pixel."""
    width, height = camera.size
    for share in (4, 2):
        coarse = camera.resized((max(1, round(width / share)), max(1, round(height / share))))
        picture = draw_boxes(volume, coarse, beta=beta, sections=sections)
        yield enlarged(picture.color, camera.size)
    total = np.zeros((height, width, 3), np.float32)
    for count, offset in enumerate(OFFSETS[:samples], start=1):
        total += draw_boxes(volume, camera, beta=beta, sections=sections, offset=offset).color
        yield total / np.float32(count)


def enlarged(color: Float[Array, "a b 3"], size: tuple[int, int]) -> Float[Array, "height width 3"]:
    """A picture at another size, linear between its pixels."""
    scaled = np.asarray(resize(color, (size[1], size[0], 3), order=1, anti_aliasing=False))
    return np.clip(scaled, 0, 1).astype(np.float32)
