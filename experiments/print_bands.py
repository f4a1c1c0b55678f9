"""How much of a printed cloth an avatar's texture keeps: amplitude and coherence with the true one, by wavelength.

Both are drawn in the zero pose from the front and from behind, a pixel a millimetre. In a band of one octave round
each wavelength (a difference of Gaussians) amplitude is the avatar's standard deviation over the true one's, coherence
the correlation of the two, on the body's own part, away from outlines and from what faces sideways.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_erosion, gaussian_filter

from avatar.camera import Camera, look_at
from avatar.gltf.avatar_file import Avatar
from avatar.skeleton import skin_transforms
from avatar.skinning import SkinWeights, skin_points
from avatar.texture import sample_texture
from bench.score.true_mesh import read_true_mesh
from capture.held_out import read_arrays
from files.picture import read_picture
from geometry.mesh import face_normals
from player.draw.raster import Fragments, Rasteriser
from player.gl.context import Context

Array = np.ndarray

WAVELENGTHS = (0.004, 0.008, 0.016)  # metres
PIXEL = 0.001  # metres
SAMPLES = 2  # a side of a pixel
# metres to the camera: close to parallel
FAR = 20.0
# metres to either side of the body's middle: trunk, legs and upper arms
WIDE = 0.4
# metres from an outline, and cosine to the camera, from which a pixel counts
RIM, FACING = 0.02, 0.7


class Bands(NamedTuple):
    """Of each wavelength: the texture's amplitude over the true one's, and their correlation."""

    amplitude: dict[str, float]
    coherence: dict[str, float]


def print_bands(context: Context, avatar: Avatar, capture: Path) -> Bands:
    """The bands of an avatar's finest texture against a synthetic capture's truth."""
    truth = read_true_mesh(capture)
    surface = read_arrays(Path(capture) / "truth" / "rest.npz", {"uv": ("v", 2), "material": ("f",)})
    folder = Path(capture) / "truth"
    textures = [read_picture(folder / f"texture_{i}.png") for i in range(int(surface["material"].max()) + 1)]
    level = avatar.levels[0]
    transforms = skin_transforms(np.zeros((52, 3)), avatar.joint_positions, truth.joints[0])
    skin = SkinWeights(level.joints.astype(np.int64), level.weights.astype(np.float32) / 255)
    ours = skin_points(level.positions.astype(np.float64), skin, transforms)
    faces = level.faces.astype(np.int64)
    rasteriser = Rasteriser(context)
    theirs_all, ours_all, counted = [], [], []
    try:
        for side in (1, -1):
            camera = camera_on(truth.vertices, side)
            seen = rasteriser.draw(truth.vertices, truth.faces, camera)
            hit = seen.face >= 0
            true = np.zeros((*hit.shape, 3))
            uv = blended(surface["uv"].astype(np.float64), truth.faces, seen, hit)
            for i, texture in enumerate(textures):
                rows = surface["material"][seen.face[hit]] == i
                at = np.flatnonzero(hit.reshape(-1))[rows]
                true.reshape(-1, 3)[at] = sample_texture(texture, uv[rows] - np.floor(uv[rows]))
            drawn = rasteriser.draw(ours, faces, camera)
            both = drawn.face >= 0
            own = np.zeros_like(true)
            own[both] = sample_texture(level.base_color, blended(level.uv.astype(np.float64), faces, drawn, both))
            normals = face_normals(truth.vertices, truth.faces)
            body = (truth.part == 0) & ~truth.hair
            good = hit & both
            good[hit] &= body[truth.faces[seen.face[hit], 0]] & (side * normals[seen.face[hit], 2] > FACING)
            good &= np.abs(np.where(hit & both, seen.depth - drawn.depth, 1)) < RIM
            theirs_all.append(smaller(true))
            ours_all.append(smaller(own))
            counted.append(binary_erosion(smaller(good[..., None])[..., 0] == 1, iterations=int(RIM / PIXEL)))
    finally:
        rasteriser.release()
    return bands(theirs_all, ours_all, counted)


def bands(
    theirs: list[Float[Array, "_h _w 3"]], ours: list[Float[Array, "_h _w 3"]], counted: list[Bool[Array, "_h _w"]]
) -> Bands:
    """Amplitude and coherence over the counted pixels of all views; 0 where the truth has nothing in a band."""
    amplitude, coherence = {}, {}
    for wavelength in WAVELENGTHS:
        a, b = (
            np.concatenate([octave(one, wavelength / PIXEL)[good] for one, good in zip(views, counted, strict=True)])
            for views in (theirs, ours)
        )
        own, true = np.sqrt(np.square(b).mean()), np.sqrt(np.square(a).mean())
        name = f"{wavelength * 1e3:g} mm"
        amplitude[name] = round(float(own / max(true, 1e-9)), 3)
        coherence[name] = round(float((a * b).mean() / max(own * true, 1e-9)), 3)
    return Bands(amplitude, coherence)


def octave(image: Float[Array, "h w 3"], wavelength: float) -> Float[Array, "h w 3"]:
    """The image's content within about an octave of a wavelength in pixels."""
    sigma = wavelength / (2 * np.pi)
    fine, coarse = (gaussian_filter(image, (s, s, 0)) for s in (sigma / np.sqrt(2), sigma * np.sqrt(2)))
    return fine - coarse


def camera_on(vertices: Float[Array, "vertices 3"], side: int) -> Camera:
    """A far camera before (side 1) or behind (-1) the body, SAMPLES x SAMPLES samples a pixel."""
    low, high = vertices.min(0) - 0.02, vertices.max(0) + 0.02
    low[0], high[0] = max(low[0], -WIDE), min(high[0], WIDE)
    middle = 0.5 * (low + high)
    size = tuple(SAMPLES * int(np.ceil(extent / PIXEL)) for extent in (high - low)[:2])
    focal = SAMPLES * FAR / PIXEL
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1.0]])
    return Camera(K, look_at(middle + [0, 0, side * FAR], middle), (size[0], size[1]))


def blended(
    values: Float[Array, "vertices c"], faces: Array, drawn: Fragments, hit: Bool[Array, "h w"]
) -> Float[Array, "hits c"]:
    """Values of vertices at the drawn points."""
    return (drawn.barycentric[hit][..., None] * values[faces[drawn.face[hit]]]).sum(1)


def smaller(image: Array) -> Array:
    """Means over SAMPLES x SAMPLES."""
    h, w, c = image.shape
    return image.reshape(h // SAMPLES, SAMPLES, w // SAMPLES, SAMPLES, c).mean((1, 3))
