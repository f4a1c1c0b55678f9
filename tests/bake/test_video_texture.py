"""Textures solved against videos: what was painted comes back from its pictures, what no picture shows is filled."""

import json
from dataclasses import replace

import numpy as np
import pytest
from charted_ball import line
from painted_capture import write_capture
from scipy.sparse import csr_matrix

from avatar.light import CaptureLight, Lamp
from avatar.rotation import fibonacci_sphere
from avatar.skeleton import JOINTS, PARTS, skin_transforms
from bake.cone import ViewCone, cone_direction
from bake.level import places_on_finest
from bake.run_capture import run_videos
from bake.texture import video_texture
from bake.texture.pixel_reads import (
    FADE,
    Belief,
    ViewChange,
    atlas_mesh,
    drawn_finer,
    frame_light,
    frame_reads,
    posed_frames,
)
from bake.texture.texels import neighbour_pairs
from bake.texture.texture_solve import Equations, Prior, shown_range, solve_change, within_shown
from bake.texture.video_texture import (
    ReadVideos,
    averaged,
    averaging,
    doubted,
    solve_texture,
)
from capture.folder import read_capture
from command.errors import AssetError
from command.settings import settings_json
from experiments.texture import level_of_file
from train.session import capture_place

SIZE = (96, 96)


@pytest.fixture(scope="module")
def grey(painted):
    """Its finest level without paint."""
    level = painted.levels[0]
    return replace(level, base_color=np.full_like(level.base_color, 128))


def test_a_painted_texture_comes_back_from_its_pictures(painted, videos, grey):
    level, lines = painted.levels[0], []
    solved = solve_texture(level_of_file(grey), painted.joint_positions, videos, lines.append)
    mesh = atlas_mesh(level, painted.joint_positions)
    truth = level.base_color.reshape(-1, 3)[mesh.texels.index] / 255
    found = solved.image.reshape(-1, 3)[mesh.texels.index]
    before, after = np.median(np.abs(0.5 - truth)), np.median(np.abs(found - truth))
    assert after < 0.35 * before
    assert solved.facts["body"]["rms_after"] < 0.25 * solved.facts["body"]["rms_before"]
    assert solved.facts["head"]["rms_after"] < 0.35 * solved.facts["head"]["rms_before"]
    assert 0 < solved.facts["unseen_share"] < 0.5
    assert any("head: 8 frames" in line for line in lines)
    # the coarser level's texels show the place that they lie at
    small = replace(grey, base_color=np.full((128, 128, 3), 128, np.uint8))
    place = places_on_finest(level_of_file(small), level_of_file(grey))
    mean = level.base_color.reshape(128, 2, 128, 2, 3).mean((1, 3)).reshape(-1, 3)[place.texels.index] / 255
    assert np.median(np.abs(place.read(solved.image).reshape(-1, 3)[place.texels.index] - mean)) < 0.45 * before


def shining(level):
    """What a level shows beyond its base for who looks along +x."""
    charted = level_of_file(level).charted
    count = len(charted.points)
    everywhere = ViewCone(-charted.normals, np.zeros((count, 6)), np.ones(count))
    return ViewChange(everywhere, lambda tangent: 0.5 * np.repeat(
        (cone_direction(tangent, everywhere) - everywhere.direction)[:, :1], 3, 1))  # fmt: skip


def test_what_follows_the_eye_stays_out_of_the_texture(rasteriser, painted, videos, grey):
    mesh = atlas_mesh(painted.levels[0], painted.joint_positions)
    change, found = shining(painted.levels[0]), {}
    for part, video in videos.found.items():
        images = video.images.astype(np.float64)
        for image, frame in zip(images, posed_frames(mesh, video, videos.head_from_canonical)):
            drawn = rasteriser.draw(frame.vertices, mesh.faces, frame.camera)
            added = (drawn.barycentric[..., None] * change.seen_along(frame.along)[mesh.faces[drawn.face]]).sum(2)
            image[drawn.face >= 0] += 255 * added[drawn.face >= 0]
        found[part] = replace(video, images=np.uint8(np.clip(np.round(images), 0, 255)))
    filmed = replace(videos, found=found)
    # what the solution leaves of each video's pixels, of 255: a shine that turns with the camera fits no texture
    left = {}
    for known in (change, None):
        solved = solve_texture(level_of_file(grey), painted.joint_positions, filmed, lambda line: None, known)
        left[known is None] = {part: solved.facts[part]["rms_after"] for part in PARTS}
    assert left[False]["body"] < 0.5 * left[True]["body"]
    assert left[False]["head"] < 0.8 * left[True]["head"]


def test_pixels_read_what_the_player_draws(rasteriser, painted, videos):
    """Rows of the reads, applied to the true atlas, are the pictures, up to the player's nearest mip."""
    mesh = atlas_mesh(painted.levels[0], painted.joint_positions)
    true = painted.levels[0].base_color.reshape(-1, 3)[mesh.texels.index] / 255
    video = videos.video("body")
    frame = next(posed_frames(mesh, video, videos.head_from_canonical))
    drawn, ones = drawn_finer(rasteriser, mesh, frame, 3), np.ones(len(mesh.positions))
    reads = frame_reads(mesh, frame, drawn, video.images[0], video.masks[0], Belief(ones, ones, 2))
    np.testing.assert_allclose(np.asarray(reads.reads.sum(1)).ravel(), 1, atol=1e-5)
    assert len(reads.color) > 300
    assert np.median(np.abs(reads.reads @ true - reads.color)) < 0.02
    # a lens moves what each pixel reads
    bent = frame._replace(camera=replace(frame.camera, distortion=np.array([-0.3, 0.1, 0, 0, 0])))
    moved = drawn_finer(rasteriser, mesh, bent, 3)
    assert 0 < (moved.face >= 0).sum() != (drawn.face >= 0).sum()


def test_outlines_hardly_count(rasteriser, painted, videos):
    mesh = atlas_mesh(painted.levels[0], painted.joint_positions)
    video = videos.video("body")
    frame = next(posed_frames(mesh, video, videos.head_from_canonical))
    drawn = drawn_finer(rasteriser, mesh, frame, 2)
    ones = np.ones(len(mesh.positions))
    whole = frame_reads(mesh, frame, drawn, video.images[0], video.masks[0], Belief(ones, ones, 0))
    cut = video.masks[0].copy()
    cut[:, SIZE[0] // 2 :] = False
    half = frame_reads(mesh, frame, drawn, video.images[0], cut, Belief(ones, ones, 0))
    assert 0.3 < len(half.weight) / len(whole.weight) < 0.7
    assert (half.weight < 0.06).sum() > 10 and (whole.weight > 0.9).sum() > 100


def test_a_person_who_leaves_the_picture_counts_less_and_less_there(rasteriser, painted, videos):
    """The same frame whole, and cut at its middle row."""
    mesh = atlas_mesh(painted.levels[0], painted.joint_positions)
    video, ones = videos.video("body"), np.ones(len(mesh.positions))
    frame, high = next(posed_frames(mesh, video, videos.head_from_canonical)), SIZE[1] // 2
    cut = frame._replace(camera=replace(frame.camera, size=(SIZE[0], high)))
    weight = []
    for one, rows in ((frame, SIZE[1]), (cut, high)):
        drawn = drawn_finer(rasteriser, mesh, one, 1)
        own = frame_reads(mesh, one, drawn, video.images[0][:rows], video.masks[0][:rows], Belief(ones, ones, 0))
        weight.append(np.bincount(own.index, own.weight, SIZE[0] * SIZE[1])[: SIZE[0] * high].reshape(high, -1))
    share = weight[1].sum(1) / np.maximum(weight[0].sum(1), 1e-9)
    wide = FADE * high
    assert share[-1] < 0.3 < 0.4 < share[-1 - int(wide / 2)] < 0.7 and (np.diff(share[-int(wide) :]) < 0).all()
    np.testing.assert_allclose(share[high // 2 : -int(wide) - 1], 1, atol=0.05)


def test_what_lies_beside_something_in_front_does_not_count_where_poses_were_estimated(rasteriser, painted, videos):
    mesh = atlas_mesh(painted.levels[0], painted.joint_positions)
    video, ones, middle = videos.video("body"), np.ones(len(mesh.positions)), SIZE[0] // 2
    frame = next(posed_frames(mesh, video, videos.head_from_canonical))
    drawn = drawn_finer(rasteriser, mesh, frame, 1)
    nearer = drawn._replace(depth=drawn.depth - 0.2 * (np.arange(SIZE[0]) < middle).astype(np.float32))
    before, after = (
        frame_reads(mesh, frame, one, video.images[0], video.masks[0], Belief(ones, ones, 0, 0.05)).index
        for one in (drawn, nearer)
    )
    lost = np.setdiff1d(before, after) % SIZE[0]
    lost = lost[lost >= middle]
    pixel = np.median(drawn.depth[drawn.face >= 0]) / frame.camera.K[0, 0]
    assert lost.min() == middle and (lost.max() + 1 - middle) * pixel == pytest.approx(0.05, abs=pixel)


@pytest.mark.parametrize("still", ["camera", "world"])
def test_the_light_of_a_frame_is_divided_out(rasteriser, painted, videos, still):
    """A plain person under a lamp is as plain as without it, as the light of the base color shows it."""
    mesh = atlas_mesh(painted.levels[0], painted.joint_positions)
    mesh = mesh._replace(light=np.tile([1.1, 0.02], (len(mesh.positions), 1)))
    light = CaptureLight(0.5, (Lamp((0.6, 0.0, 0.8 if still == "world" else -0.8), 0.6),), 0.1, gamma=2.2, frame=still)
    video = videos.video("body")
    frame = list(posed_frames(mesh, video, videos.head_from_canonical))[1]
    drawn = drawn_finer(rasteriser, mesh, frame, 1)
    lit = frame_light(mesh, frame, light)
    assert lit is not None
    hit = drawn.face >= 0
    corners, weight = mesh.faces[drawn.face[hit]], drawn.barycentric[hit].astype(float)
    shading, highlight = (weight[..., None] * lit.frame[corners]).sum(1).T
    albedo = np.array([0.5, 0.4, 0.3])
    image = np.zeros((*hit.shape, 3), np.uint8)
    image[hit] = np.round(255 * light.shown(np.tile(albedo, (len(corners), 1)), shading, highlight))
    assert np.ptp(image[hit][:, 0].astype(int)) > 40
    ones = np.ones(len(mesh.positions))
    reads = frame_reads(mesh, frame, drawn, image, hit, Belief(ones, ones, 2), lit)
    expected = light.shown(albedo[None], np.array([1.1]), np.array([0.02]))[0]
    np.testing.assert_allclose(reads.color, np.tile(expected, (len(reads.color), 1)), atol=4 / 255)
    # without lights in the level nothing is divided
    assert frame_light(mesh._replace(light=None), frame, light) is None


def test_least_squares_finds_what_pixels_wider_than_texels_tell():
    """Means over four of twelve texels, at every offset, give back the texels but for the mean's null space."""
    texels = line(12)
    rows = [np.roll(np.r_[np.full(4, 0.25), np.zeros(8)], shift) for shift in range(9)]
    truth = np.random.default_rng(1).normal(size=(12, 1)).astype(np.float32)
    matrix = csr_matrix(np.array(rows, np.float32))
    nothing = Prior(np.full(12, 1e-5), np.full(12, 1e-6))
    found = solve_change([Equations(matrix, matrix @ truth)], nothing, neighbour_pairs(texels), rounds=60)
    np.testing.assert_allclose(matrix @ found, matrix @ truth, atol=2e-3)
    # a texel that no pixel reads keeps its color, and its neighbours pull it only as far as mu says
    alone = csr_matrix(np.eye(1, 12, dtype=np.float32))
    one = solve_change(
        [Equations(alone, np.ones((1, 1), np.float32))], Prior(np.full(12, 1.0), np.zeros(12)), neighbour_pairs(texels)
    )
    np.testing.assert_allclose(one[:, 0], np.r_[0.5, np.zeros(11)], atol=1e-6)


def wide_pixels(count, width):
    """Of each pixel its shares of a line of texels: the mean of `width` of them."""
    rows = np.zeros((count - width, count), np.float32)
    for row in range(len(rows)):
        rows[row, row : row + width] = 1 / width
    return csr_matrix(rows)


def test_texels_on_chart_edges_leave_a_color_that_is_far_off():
    """Pixels of 18 texels say little of each, and that the two sides of 40 edges look alike says much."""
    count, width, truth = 600, 18, 0.4
    sides = np.random.default_rng(0).permutation(count)[:80].reshape(40, 2)
    edges = np.zeros((40, count), np.float32)
    edges[np.arange(40), sides[:, 0]], edges[np.arange(40), sides[:, 1]] = 1, -1
    pixels, seams = wide_pixels(count, width), Equations(csr_matrix(edges), np.zeros((40, 1), np.float32))
    told = [Equations(pixels, pixels @ np.full((count, 1), truth, np.float32))]
    prior = Prior(np.full(count, 1e-4), np.full(count, 4e-3))
    found = solve_change(told, prior, neighbour_pairs(line(count)), stiff=seams)[:, 0]
    assert np.abs(found[sides] - truth).max() < 0.1 * truth


def test_pixels_much_wider_than_texels_are_smoothed_where_poses_were_estimated():
    none, texel = np.zeros(3), np.full(3, 0.001)
    found = ReadVideos([], [], [], none, none, np.array([0.001, 0.003, 0.006]), texel, np.arange(3))
    np.testing.assert_allclose(found.smoothing(True), [1, 4, 16])
    np.testing.assert_allclose(found.smoothing(False), 1)


def test_the_chin_of_estimated_people_is_found_with_their_videos(filmed, tmp_path):
    folder, facts = filmed
    found = run_videos(folder / "run", facts, None)
    assert found.estimated and found.chin == read_capture(folder / "capture").chin is not None
    write_capture(tmp_path / "capture", size=16, frames=1)
    at = tmp_path / "capture" / "capture.json"
    at.write_text(json.dumps(json.loads(at.read_text()) | {"pose_noise_deg": 0}))
    (tmp_path / "run").mkdir()
    made = facts | {"capture_at": capture_place(tmp_path / "capture", tmp_path / "run")}
    assert run_videos(tmp_path / "run", made, None).chin is None


@pytest.mark.slow
def test_what_one_frame_shows_alone_is_doubted_and_still_counts_in_what_is_said(painted, videos, grey, monkeypatch):
    """Of estimated people: a patch of magenta in one frame of the body, as of somebody's hand that passes."""
    body = videos.video("body")
    images = body.images.copy()
    images[0, 40:60, 40:56] = [255, 0, 255]
    spoilt = {**videos.found, "body": replace(body, images=images)}
    # these pixels are four texels wide: smoothed as far as that, little of the patch is left to doubt
    monkeypatch.setattr(video_texture, "WIDER", 4.0)

    def solved(found, doubt):
        monkeypatch.setattr(video_texture, "DOUBTED", doubt)
        filmed = replace(videos, estimated=True, found=found)
        return solve_texture(level_of_file(grey), painted.joint_positions, filmed, lambda line: None)

    clean, doubted_one, believed = solved(videos.found, 1e3), solved(spoilt, 0.15), solved(spoilt, 1e3)
    off = [np.square(one.image - clean.image).sum() for one in (doubted_one, believed)]
    # two or three frames show a place: the patch is doubted as far as the others outvote it
    assert off[0] < 0.9 * off[1]
    assert doubted_one.facts["body"]["rms_after"] > believed.facts["body"]["rms_after"]


@pytest.mark.slow
def test_frames_beside_each_other_are_sharper_moved_again(painted, videos, grey, monkeypatch):
    """Every other frame of the body a pixel to the left, the rest a pixel to the right."""
    body = videos.video("body")
    beside = [(-1) ** frame for frame in range(len(body.images))]
    images, masks = (np.stack([np.roll(one, by, 1) for one, by in zip(all_of, beside, strict=True)])
                     for all_of in (body.images, body.masks))  # fmt: skip
    found = {**videos.found, "body": replace(body, images=images, masks=masks)}
    filmed = replace(videos, estimated=True, found=found)
    left = {}
    for moves in (1, 2):
        monkeypatch.setattr(video_texture, "WINDOWS", moves * (0.025,))
        solved = solve_texture(level_of_file(grey), painted.joint_positions, filmed, lambda line: None)
        left[moves] = solved.facts["body"]["rms_after"]
    assert left[2] < 0.97 * left[1]


def test_a_pixel_that_shows_something_else_counts_less():
    shown = np.float32([[0.3], [0.3], [0.3], [0.9]]) * np.ones((1, 3), np.float32)
    one = csr_matrix(np.ones((4, 1), np.float32))
    equations = Equations(one, shown.copy())
    sure = doubted(equations, np.full((1, 3), 0.3, np.float32))
    weight = np.square(equations.matrix.toarray().ravel())
    np.testing.assert_allclose(weight[:3], 1, atol=1e-5)
    assert weight[3] < 0.01
    np.testing.assert_allclose(sure, np.sqrt(weight), rtol=1e-5)
    np.testing.assert_allclose(equations.wanted[3], 0.9 * np.sqrt(weight[3]), rtol=1e-5)


def test_a_solved_texture_is_kept_within_what_pixels_show(painted, videos, monkeypatch):
    """From a color so far off that the solution swings over: what is kept of it is what the atlas gets."""
    level = painted.levels[0]
    far = replace(level, base_color=np.full_like(level.base_color, 250))
    held: list[float] = []

    def watched(color, given, points, ranges):
        kept = within_shown(color, given, points, ranges)
        held.append(float(np.abs(kept - color).max()))
        return np.zeros_like(kept)

    monkeypatch.setattr(video_texture, "within_shown", watched)
    solved = solve_texture(level_of_file(far), painted.joint_positions, videos, lambda line: None)
    assert held[0] > 0.01
    assert solved.image.max() < 1e-6


def test_a_solution_stays_within_what_pixels_show_there():
    """A dark collar that the field has three texels too far to the left, under pixels of eight texels: the skin beside
    it glows in the solution, not in what is kept of it."""
    texels, width = line(64), 8
    skin, cloth = 0.8, 0.2
    truth = np.where(np.arange(64) < 32, cloth, skin)[:, None].astype(np.float32)
    given = np.where(np.arange(64) < 29, cloth, skin)[:, None].astype(np.float32)
    matrix = wide_pixels(64, width)
    prior = Prior(np.full(64, 0.02), np.full(64, 0.08))
    change = solve_change([Equations(matrix, matrix @ (truth - given))], prior, neighbour_pairs(texels))
    points = np.stack([0.001 * np.arange(64), np.zeros(64), np.zeros(64)], 1)
    shown = shown_range(points[width // 2 : -width // 2], np.repeat(matrix @ truth, 3, 1), 0.008)
    kept = within_shown(*(np.repeat(one, 3, 1) for one in (given + change, given)), points, [shown])
    overshoot = lambda color: max(float(color.max()) - skin, cloth - float(color.min()))
    assert overshoot(given + change) > 0.08 and overshoot(kept) < 0.061
    assert np.abs(kept[:, :1] - truth).mean() < np.abs(given + change - truth).mean()
    # where no pixel is near, the field's color is all there is
    alone = within_shown(np.full((1, 3), 0.9), np.full((1, 3), 0.5), np.array([[5.0, 0, 0]]), [shown])
    np.testing.assert_allclose(alone, 0.5)


def test_frames_finer_than_texels_are_averaged(videos):
    assert averaging(0.002, 0.001) == 1 and averaging(0.0006, 0.0009) == 1 and averaging(0.0002, 0.0009) == 5
    video = videos.video("body")
    small = averaged(video, 3)
    assert small.images.shape == (8, 32, 32, 3) and small.cameras[0].size == (32, 32)
    assert small.masks.sum() * 9 <= video.masks.sum()
    np.testing.assert_allclose(small.images[0, 10, 10], video.images[0, 30:33, 30:33].mean((0, 1)), atol=0.5)
    np.testing.assert_allclose(small.cameras[0].K[:2], video.cameras[0].K[:2] / 3)


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """A run folder beside the capture that it says it was trained on."""
    folder = tmp_path_factory.mktemp("filmed")
    write_capture(folder / "capture", size=16, frames=1)
    (folder / "run").mkdir()
    facts = {"capture_at": capture_place(folder / "capture", folder / "run")}
    return folder, facts | {"head_from_canonical": np.diag([2.0, 2, 2, 1]).tolist()}


def test_the_videos_of_a_run_are_found_again(filmed, tmp_path):
    folder, facts = filmed
    assert facts["capture_at"]["folder"] == "../capture"
    found = run_videos(folder / "run", facts, None)
    assert found.video("body").images.shape == (1, 16, 16, 3) and found.refined == folder / "run"
    # another capture of the same person: its own poses, the run's head
    write_capture(tmp_path / "large", size=24, frames=1)
    other = run_videos(folder / "run", facts, tmp_path / "large")
    assert other.refined is None and other.video("head").images.shape == (1, 24, 24, 3)


def test_a_light_of_the_world_falls_on_a_head_held_as_in_the_bodys_video(filmed, tmp_path):
    folder, facts = filmed
    write_capture(tmp_path / "turning", size=16, frames=3)
    light = CaptureLight(0.4, (Lamp((0.6, 0.0, 0.8), 0.5),), frame="world")
    facts = facts | {"light": dict.fromkeys(PARTS, settings_json(light))}
    found = run_videos(folder / "run", facts, tmp_path / "turning")
    joints = read_capture(folder / "capture").subject.joints
    body = found.video("body")
    turn = skin_transforms(body.axis_angle[1], joints, body.root[1])[JOINTS.index("head"), :3, :3]
    normals = fibonacci_sphere(50)
    np.testing.assert_allclose(found.lights["head"].shading(normals), light.shading(normals @ turn.T), atol=1e-6)
    assert found.lights["body"] == light


@pytest.mark.parametrize(
    "change, words",
    [
        ({"capture_at": None}, "capture_at should say"),
        ({"capture_at": {"folder": "../gone", "digest": "x"}}, "expected the capture folder"),
        ({"capture_at": {"folder": "../capture", "digest": "x"}}, "found another"),
    ],
)
def test_videos_that_are_nowhere_are_one_line_with_two_ways_out(filmed, change, words):
    folder, facts = filmed
    with pytest.raises(AssetError, match=words) as raised:
        run_videos(folder / "run", facts | change, None)
    assert "--capture FOLDER" in str(raised.value) and "--texture-from field" in str(raised.value)


def test_videos_whose_head_lies_elsewhere_are_refused(filmed, tmp_path):
    folder, facts = filmed
    write_capture(tmp_path / "other", size=24, frames=1)
    marks = tmp_path / "other" / "head" / "landmarks.json"
    content = json.loads(marks.read_text())
    content["points"] = {name: [x + 0.5, y, z] for name, (x, y, z) in content["points"].items()}
    marks.write_text(json.dumps(content))
    with pytest.raises(AssetError, match="head frame is not the run's"):
        run_videos(folder / "run", facts, tmp_path / "other")
