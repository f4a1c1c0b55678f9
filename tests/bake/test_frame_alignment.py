"""Frames whose poses are a little off are moved onto the texture that they agree on."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.sparse import csr_matrix

from bake.texture.frame_alignment import FARTHEST, ShownVideo, align_frames, frame_shift, moved_colors
from bake.texture.texture_solve import Equations

SIZE = 96
PIXEL = 0.005  # metres


def picture(seed, blur=1.5):
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(SIZE, SIZE, 3)), (blur, blur, 0))
    return np.clip(0.5 + 0.2 * noise / noise.std(), 0, 1)


def beside(image, shift):
    """The picture with what lay at x now at x + shift."""
    grid = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij"), -1) - shift
    return np.stack([map_coordinates(image[..., c], np.moveaxis(grid, -1, 0), order=1) for c in range(3)], -1)


def disc():
    rows, columns = np.mgrid[:SIZE, :SIZE] - SIZE / 2
    return np.hypot(rows, columns) < 40


def smooth_shift():
    """Two pixels, turning slowly over the picture."""
    angle = np.linspace(0, 1.5, SIZE)
    return np.stack([2 * np.sin(angle)[None].repeat(SIZE, 0), 2 * np.cos(angle)[None].repeat(SIZE, 0)], -1)


def test_a_smooth_shift_is_found_and_undone():
    drawn, known = picture(0), disc()
    frame = beside(drawn, smooth_shift())
    shift = frame_shift(drawn, frame, known, PIXEL)
    inner = gaussian_filter(known.astype(float), 4) > 0.95
    assert np.abs(shift - smooth_shift())[inner].max() < 0.5
    assert np.abs(shift - smooth_shift())[inner].mean() < 0.1
    moved, whole = moved_colors(frame, known, shift)
    both = inner & whole
    assert np.abs(moved - drawn)[both].mean() < 0.25 * np.abs(frame - drawn)[both].mean()


@pytest.mark.parametrize("case", ["same", "one color", "noise"])
def test_what_tells_nothing_moves_nothing(case):
    drawn = np.full((SIZE, SIZE, 3), 0.5) if case == "one color" else picture(0)
    rng = np.random.default_rng(1)
    frame = drawn + {"same": 0, "one color": 0.002, "noise": 0.02}[case] * rng.normal(size=drawn.shape)
    shift = frame_shift(drawn, frame, disc(), PIXEL)
    assert np.isfinite(shift).all()
    assert np.abs(shift).max() < {"same": 1e-9, "one color": 0.2, "noise": 0.1}[case]


def test_another_picture_moves_it_no_farther_than_is_believed():
    shift = frame_shift(picture(0), picture(7), disc(), PIXEL)
    assert np.linalg.norm(shift, axis=-1).max() <= FARTHEST / PIXEL + 1e-9
    nobody = frame_shift(picture(0), picture(7), np.zeros((SIZE, SIZE), bool), PIXEL)
    assert (nobody == 0).all()


def test_equations_are_moved_onto_the_atlas_frame_by_frame():
    image, known = picture(0), disc()
    pixels = np.flatnonzero(known).astype(np.int32)
    rng = np.random.default_rng(2)
    given = np.full((len(pixels), 3), 0.5, np.float32)
    true = image[known].astype(np.float32)
    weight = rng.uniform(0.1, 1, 2 * len(pixels)).astype(np.float32)
    rows = np.arange(2 * len(pixels))
    matrix = csr_matrix((weight, (rows, np.tile(np.arange(len(pixels)), 2))))
    frames = [beside(image, smooth_shift()), image]
    wanted = np.concatenate([frame[known] - 0.5 for frame in frames]) * weight[:, None]
    equations = Equations(matrix, wanted.astype(np.float32))
    before = wanted.copy()
    moved = align_frames(equations, ShownVideo([pixels, pixels, pixels[:0]], SIZE, PIXEL), given, true - given)
    assert moved == pytest.approx(0.5 * 2 * PIXEL, rel=0.1)  # half of the frames, by two pixels
    right = matrix @ (true - given)
    first = slice(0, len(pixels))
    assert np.abs(equations.wanted - right)[first].mean() < 0.3 * np.abs(before - right)[first].mean()
    np.testing.assert_allclose(equations.wanted[len(pixels) :], before[len(pixels) :], atol=1e-4)
