"""Textures solved against videos that show nothing, once, a thousand times and never the same."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from charted_ball import charted_ball, line
from filmed_part import FoundVideos
from scipy.sparse import csr_matrix, identity

from avatar.camera import orbit_camera
from avatar.light import CaptureLight, Lamp
from avatar.skeleton import PARTS
from avatar.texture import bytes_of, mipmaps
from bake.level import BakedLevel
from bake.texture.pixel_reads import atlas_mesh
from bake.texture.seams import edge_reads, solve_seams
from bake.texture.texels import neighbour_pairs, spread
from bake.texture.texture_solve import Equations, Prior, solve_change
from bake.texture.video_texture import solve_texture
from capture.folder import PartVideo
from experiments.texture import level_of_file
from player.scene.mannequin import mannequin

STAY, MIX = 0.06, 0.24


def solved(matrix: csr_matrix, wanted: np.ndarray, *, smooth: float = 0.0, rounds: int = 40) -> np.ndarray:
    count = matrix.shape[1]
    prior = Prior(np.full(count, STAY), np.full(count, smooth))
    equations = [Equations(matrix.astype(np.float32), wanted.astype(np.float32))]
    return solve_change(equations, prior, neighbour_pairs(line(count)), rounds=rounds)


@pytest.mark.parametrize("smooth", [0.0, MIX])
def test_no_pixels_change_nothing(smooth, within):
    within(solved(csr_matrix((0, 20)), np.zeros((0, 3)), smooth=smooth), 0.0)


@pytest.mark.parametrize("views", [1, 2, 1000])
@pytest.mark.parametrize("apart", [0.0, 0.6])
def test_a_texel_ends_at_the_mean_of_all_views_and_its_neighbours_stay(views, apart, within):
    """Views that disagree by `apart`; the closed form of one texel: sum w r / (sum w + lambda)."""
    rows = csr_matrix((np.ones(views), (np.arange(views), np.full(views, 7))), (views, 20))
    wanted = np.full((views, 3), 0.3) + apart * (np.arange(views)[:, None] % 2 - 0.5)
    found = solved(rows, wanted)
    within(found[7] - wanted.sum(0) / (views + STAY), 1e-5)
    within(np.delete(found, 7, 0), 0.0, "beside it")


@pytest.mark.parametrize("rounds", [12, 60])
@pytest.mark.parametrize("width", [1, 2, 4])
def test_frames_that_contradict_each_other_end_between_them(width, rounds, within):
    """Two frames whose pixels are `width` texels wide, one dark, one bright, half a pixel apart: from grey. Wide pixels
    are sharpened, which goes a little beyond at the line's two ends."""
    count, rows, wanted = 240, [], []
    for color, offset in ((-0.3, 0.0), (0.3, 0.5 * width)):
        for first in np.arange(offset, count - width, width):
            row = np.clip(np.minimum(np.arange(count) + 1, first + width) - np.maximum(np.arange(count), first), 0, 1)
            rows.append(row / row.sum())
            wanted.append([color])
    found = solved(csr_matrix(np.array(rows)), np.array(wanted), smooth=STAY * 4, rounds=rounds)
    within(np.maximum(np.abs(found) - 0.3, 0).max(), 0.04, "beyond both")
    within(np.median(found[4:-4]), 0.01, "median")


@pytest.fixture(scope="module")
def grey() -> tuple[BakedLevel, np.ndarray, FoundVideos]:
    """A grey mannequin, and four frames of each part that show a grey square."""
    avatar = mannequin()
    level = avatar.levels[0]
    level = replace(level, base_color=np.full((128, 128, 3), 128, np.uint8))
    size, videos = (48, 48), {}
    for part in PARTS:
        middle, far = ((0, 0.6, 0), 0.8) if part == "head" else ((0, -0.1, 0), 3.2)
        cameras = tuple(orbit_camera(middle, far, turn, 0.05, size) for turn in np.pi / 2 * np.arange(4))
        posed = part != "head"
        videos[part] = PartVideo(
            part, np.full((4, 48, 48, 3), 128, np.uint8), np.ones((4, 48, 48), bool), cameras,
            np.tile(np.asarray(avatar.canonical_pose, np.float64), (4, 1, 1)) if posed else None,
            np.zeros((4, 3)) if posed else None, None, None,
        )  # fmt: skip
    return (
        level_of_file(level),
        np.asarray(avatar.joint_positions),
        FoundVideos(Path(), None, np.eye(4), {}, False, None, False, None, videos),
    )


def textured(grey, lights: dict[str, CaptureLight] | None = None, **changes) -> tuple[np.ndarray, dict]:
    """Texels of the mannequin from videos with some fields changed."""
    baked, joints, videos = grey
    found = {
        part: replace(one, **{name: change(one) for name, change in changes.items()})
        for part, one in videos.found.items()
    }
    if lights is not None:
        light = np.tile(np.float32([1, 0]), (len(baked.level.positions), 1))
        baked = baked._replace(level=replace(baked.level, light=light))
    result = solve_texture(baked, joints, replace(videos, found=found, lights=lights or {}), lambda line: None)
    assert np.isfinite(result.image).all()
    assert result.image.min() >= 0 and result.image.max() <= 1
    return result.image.reshape(-1, 3)[atlas_mesh(baked.level, joints).texels.index], result.facts


def test_videos_that_show_nobody_leave_the_texture_as_it_was(grey, within):
    found, facts = textured(grey, masks=lambda video: np.zeros_like(video.masks))
    within(found - 128 / 255, 1e-6)
    assert facts["unseen_share"] == 1
    assert all(facts[part]["pixels"] == 0 for part in PARTS)


def test_a_light_that_reached_nothing_leaves_the_texture_as_it_was(grey, within):
    """A lamp behind the person in the dark: no pixel tells a color."""
    dark = CaptureLight(0.1, (Lamp((0.0, 1.0, 0.0), 1e-6),), frame="world")
    found, facts = textured(grey, dict.fromkeys(PARTS, dark))
    within(found - 128 / 255, 1e-6)
    assert facts["unseen_share"] == 1


@pytest.mark.parametrize("value", [0, 255])
def test_black_and_saturated_videos_darken_and_brighten_alone(grey, value, within):
    found, _ = textured(grey, images=lambda video: np.full_like(video.images, value))
    wrong_way = found - 128 / 255 if value == 0 else 128 / 255 - found
    within(np.maximum(wrong_way, 0).max(), 0.002, "the other way")
    seen = np.abs(found - value / 255) < 0.25
    assert seen.mean() > 0.5


def test_frames_of_two_colors_give_texels_between_them(grey, within):
    """Every second frame red, the others blue, from grey between them: sharpening goes a little beyond."""

    def contrary(video: PartVideo) -> np.ndarray:
        colors = np.array([[200, 60, 60], [60, 60, 200]], np.uint8)
        return np.broadcast_to(colors[np.arange(4) % 2][:, None, None], video.images.shape).copy()

    found, _ = textured(grey, images=contrary)
    within(np.quantile(np.maximum(60 / 255 - found, found - 200 / 255), 0.999), 0.03, "beyond both, of 999 in 1000")


BEHIND = {
    "white": lambda shape: np.full(shape, 255, np.uint8),
    "grey": lambda shape: np.full(shape, 90, np.uint8),
    "noise": lambda shape: np.random.default_rng(5).integers(0, 256, shape, np.uint8),
}


@pytest.mark.rows
@pytest.mark.parametrize("behind", ["white", "noise"])
def test_what_is_behind_the_person_colors_nothing(grey, behind, within):
    def left(video: PartVideo) -> np.ndarray:
        return np.broadcast_to(np.arange(48) < 24, video.masks.shape)

    def before(video: PartVideo, back: str) -> np.ndarray:
        return np.where(left(video)[..., None], video.images // 2, BEHIND[back](video.images.shape))

    found = [textured(grey, images=lambda v, back=back: before(v, back), masks=left)[0] for back in ("grey", behind)]
    assert np.abs(found[0] - 128 / 255).max() > 0.2
    within(found[0] - found[1], 0.0, f"{behind} instead of grey")


def test_an_exposure_that_drifts_gives_texels_between_its_extremes(grey, within):
    drift = np.array([0.85, 0.95, 1.05, 1.15])[:, None, None, None]
    found, _ = textured(grey, images=lambda video: np.round(120 * drift * np.ones_like(video.images)).astype(np.uint8))
    low, high = 120 * 0.85 / 255, 120 * 1.15 / 255
    within(np.quantile(np.maximum(low - found, found - high), 0.999), 0.01, "beyond both, of 999 in 1000")


def test_videos_and_colors_1_2_times_as_bright_give_a_texture_as_much_brighter(grey, within):
    baked, joints, videos = grey
    found = []
    for value in (100, 120):
        level = replace(baked.level, base_color=np.full_like(baked.level.base_color, value))
        filmed = lambda video, value=value: np.full_like(video.images, 1.2 * value)
        found.append(textured((baked._replace(level=level), joints, videos), images=filmed)[0])
    assert np.ptp(found[0]) > 0.05
    within(1.2 * found[0] - found[1], 0.005, "1.2 times as bright")


@pytest.mark.parametrize("pattern", ["stripes", "checkerboard"])
def test_contrasts_of_one_texel_across_chart_edges_stay_within_what_was_seen(pattern, within):
    """Every texel of a ball is told its own color, edges that they agree, then mips are closed: nowhere beyond."""
    size, levels = 256, 4
    chart, texels, edges, _, points, _ = charted_ball(size, 8, faces=600, step=0.008)
    cells = np.floor(points / 0.0016).astype(int)
    on = (cells[:, 0] if pattern == "stripes" else cells.sum(1)) % 2
    low, high = np.array([0.2, 0.35, 0.3]), np.array([0.8, 0.4, 0.7])
    seen = np.where(on[:, None] == 1, high, low)
    given = np.full_like(seen, 0.4)
    row_of = np.zeros(size * size, int)
    row_of[texels.index] = np.arange(len(texels.index))
    points = edge_reads(chart.uv, edges, size)
    agree = csr_matrix((points.data, row_of[points.indices], points.indptr), (points.shape[0], len(seen)))
    agree = agree.astype(np.float32)
    own = csr_matrix(identity(len(seen), np.float32))
    equations = [Equations(own, (seen - given).astype(np.float32)), Equations(agree, -(agree @ given))]
    prior = Prior(np.full(len(seen), STAY), np.full(len(seen), MIX))
    found = given + solve_change(equations, prior, neighbour_pairs(texels))
    within(np.maximum(low - found, found - high).max(), 0.02, "beyond both, solved")
    image = spread(np.clip(found, 0, 1), texels)
    closed = solve_seams(image, texels, chart.uv, edges, levels)
    within(np.maximum(image.min((0, 1)) - closed, closed - image.max((0, 1))).max(), 1e-6, "beyond the solved")
    for mip in mipmaps(bytes_of(closed), levels):
        within(np.maximum(255 * low - mip, mip - 255 * high).max(), 6.0, "of 255, in a mip")
