"""Light in a room, what is open to the sky or can be seen of a mesh, and raw videos as a phone writes them."""

import json

import av
import numpy as np
import pytest
from capsules import icosphere
from PIL import Image

from avatar.camera import Camera, project
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINTS, PARTS, joint_transforms
from avatar.texture import linear_from_srgb, srgb_from_linear
from capture.keypoints.read import read_keypoints
from geometry.mesh import TriangleMesh, concatenated
from synth.command import SynthConfig, load_subject, synth_raw
from synth.light import light_of, shade
from synth.options import RawConfig
from synth.raw.backdrop import backdrop
from synth.raw.film import FILES
from synth.raw.phone import phone_of
from synth.room import (
    ROOM,
    LightSource,
    ReceivedLight,
    Room,
    RoomLighting,
    ambient,
    openness,
    shade_in_room,
    sunlit_share,
    turn_between,
)
from synth.visibility import visible_faces

UP = np.array([0.0, 1, 0])


def plane(side: float, cells: int):
    """A level square about the origin, facing up."""
    at = np.linspace(-side / 2, side / 2, cells + 1)
    x, z = np.meshgrid(at, at, indexing="ij")
    vertices = np.stack([x, np.zeros_like(x), z], -1).reshape(-1, 3)
    a = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1)
    quads = np.stack([a, a + 1, a + cells + 2, a + cells + 1], 1)
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def ball(radius: float, middle):
    """A sphere's vertices, faces and normals."""
    vertices, faces = icosphere(radius, middle, subdivisions=5)
    return vertices, faces, (vertices - middle) / radius


def ball_over_plane(radius: float = 0.1):
    """A ball, its middle 30 cm over a square of 1.6 m; the plane's vertices come first."""
    ground, ball = TriangleMesh(*plane(1.6, 80)), TriangleMesh(*icosphere(radius, [0, 0.3, 0], subdivisions=5))
    return *concatenated([ground, ball]), len(ground.vertices)


@pytest.mark.parametrize("direction", [(0, 1, 0), (0.6, 0.8, 0), (-0.36, 0.8, 0.48)])
def test_a_ball_shadows_the_ellipse_that_it_should(rasteriser, direction):
    """A point of the plane is dark where its line to the light passes nearer than the radius to the middle."""
    vertices, faces, count = ball_over_plane()
    towards = np.array(direction, float)
    ground = vertices[:count]
    lit = sunlit_share(rasteriser, vertices, faces, ground, np.tile(UP, (count, 1)), towards)
    off = np.linalg.norm(np.cross(np.array([0, 0.3, 0]) - ground, towards), axis=1)
    # 4 to 5 mm a pixel, a point compared with the four round it
    assert (lit[off < 0.094] == 0).all() and (lit[off > 0.112] == 1).all()
    assert 30 < (off < 0.094).sum() < 400


def test_a_ball_is_lit_on_one_half_and_light_stands_still_while_the_body_turns(rasteriser):
    points, faces, normals = ball(0.5, [0, 0, 0])
    towards = np.array([0.48, 0.6, 0.64])
    lit = sunlit_share(rasteriser, points, faces, points, normals, towards)
    cosine = normals @ towards
    assert (lit[cosine > 0.1] == 1).all() and (lit[cosine <= 0] == 0).all()
    lit = RoomLighting(rasteriser, faces, np.arange(len(points))).on(points, ROOM)
    window = np.array(ROOM.sources[0].direction) / np.linalg.norm(ROOM.sources[0].direction)
    brightest = normals[lit.irradiance[0].argmax()]
    turn = matrix_from_axis_angle(np.array([0.0, 2.0, 0.0]))
    turned = RoomLighting(rasteriser, faces, np.arange(len(points))).on(points @ turn.T, ROOM)
    assert np.linalg.norm(brightest - turn @ normals[turned.irradiance[0].argmax()]) < 0.25
    assert brightest @ window > 0.5


def test_a_wide_source_makes_the_soft_shadow_that_its_width_says(rasteriser):
    """The share seen is the share of its directions whose lines pass the ball; the middle of the umbra is dark, as the
    ball covers more of the sky than the source does."""
    vertices, faces, count = ball_over_plane()
    source = LightSource((0.0, 1.0, 0.0), width=30.0, height=30.0, irradiance=1.0, samples=64, gloss=20.0)
    room = Room((source,), ceiling=0.0, floor=0.0, exposure=1.0)
    lighting = RoomLighting(rasteriser, faces, np.arange(len(vertices)))
    seen = lighting.on(vertices, room).seen[0, 0, :count]
    ground = vertices[:count]
    passes = []
    for towards in source.directions():
        passes.append(np.linalg.norm(np.cross(np.array([0, 0.3, 0]) - ground, towards), axis=1) > 0.1)
    # a pixel of 4 mm decides late or early at edges of some of the 64 shadows
    np.testing.assert_allclose(seen, np.mean(passes, 0), atol=0.09)
    radius = np.linalg.norm(ground, axis=1)
    assert seen[radius < 0.015].max() < 0.01 and seen[radius > 0.25].min() == 1
    assert 0.3 < seen[(radius > 0.09) & (radius < 0.11)].mean() < 0.7


def test_what_is_all_round_is_seen_and_less_of_it_under_a_ball(rasteriser):
    """Energy: a convex body in an even room of radiance 1 receives 1 everywhere; under a sky, a + 2/3 b n.y."""
    points, faces, normals = ball(0.5, [0, 0, 0])
    open_to = openness(rasteriser, points, faces, points, normals)
    even = Room((), ceiling=1.0, floor=1.0, exposure=1.0)
    # grazing directions are a pixel's work: a few hundredths of their small share are lost
    np.testing.assert_allclose(ambient(even, normals, open_to, UP), 1.0, atol=0.02)
    sky = Room((), ceiling=0.8, floor=0.2, exposure=1.0)
    np.testing.assert_allclose(ambient(sky, normals, open_to, UP), 0.5 + 0.2 * normals[:, 1], atol=0.02)
    # A ball at distance h over a level surface hides (r / h)^2 of its light from an even sky.
    vertices, faces, count = ball_over_plane(0.2)
    ground, up = vertices[:count], np.tile(UP, (count, 1))
    lit = ambient(Room((), 1.0, 1.0, 1.0), up, openness(rasteriser, vertices, faces, ground, up), UP)
    radius = np.linalg.norm(ground, axis=1)
    # 24 directions of the whole sphere, 12 above
    assert abs(lit[radius < 0.015].mean() - (1 - (0.2 / 0.3) ** 2)) < 0.12
    assert lit[radius > 0.75].min() > 0.9


def test_a_turned_body_is_lit_as_if_it_were_drawn_anew(rasteriser):
    """What is kept of a body is good for any heading; another pose is found out."""
    vertices, faces, _ = ball_over_plane()
    lighting = RoomLighting(rasteriser, faces, np.arange(len(vertices)))
    lighting.on(vertices, ROOM)
    kept = lighting.body
    turn = matrix_from_axis_angle(np.array([0.2, 1.1, -0.3]))
    turned = vertices @ turn.T + [0.3, -1.0, 2.0]
    np.testing.assert_allclose(turn_between(vertices, turned), turn, atol=1e-12)
    again = lighting.on(turned, ROOM)
    assert lighting.body is kept
    fresh = RoomLighting(rasteriser, faces, np.arange(len(vertices))).on(turned, ROOM)
    # but for a few vertices that one of them takes for buried
    assert (again.seen != fresh.seen).mean() < 0.001
    # directions over the sphere stand otherwise to the turned plane: a few hundredths of an ambient of .2
    np.testing.assert_allclose(again.irradiance, fresh.irradiance, atol=0.06)
    moved = turned.copy()
    moved[-1] += 0.01
    assert turn_between(vertices, moved) is None
    lighting.on(moved, ROOM)
    assert lighting.body is not kept


def test_light_multiplies_linear_values_on_the_standard_curve_and_is_clipped():
    np.testing.assert_allclose(
        linear_from_srgb(np.array([0, 0.04045, 0.5, 1])), [0, 0.0031308, 0.2140411, 1], atol=1e-6
    )
    shown = np.linspace(0, 1, 256)
    np.testing.assert_allclose(srgb_from_linear(linear_from_srgb(shown)), shown, atol=1e-6)
    base = np.array([[200.0, 100.0, 30.0], [200.0, 100.0, 30.0]])
    away = np.tile([0, -1.0, 0], (2, 1))
    room = Room((), ceiling=0.0, floor=0.0, exposure=2.0)
    shown = shade_in_room(base, away, -away, ReceivedLight(np.array([0.5, 4.0]), np.zeros((0, 2))), room)
    np.testing.assert_allclose(shown[0], base[0], atol=1e-9)
    expected = 255 * srgb_from_linear(np.minimum(8 * linear_from_srgb(base[1] / 255), 1))
    np.testing.assert_allclose(shown[1], expected)
    assert round(shown[1, 0]) == 255 > shown[1, 2]


def test_a_highlight_goes_where_the_source_is_not_seen():
    source = LightSource((0.0, 1.0, 0.0), width=10.0, height=10.0, irradiance=1.0, samples=4, gloss=60.0)
    room = Room((source,), ceiling=0.0, floor=0.0, exposure=1.0)
    up = np.tile(UP, (2, 1))
    shown = shade_in_room(np.zeros((2, 3)), up, up, ReceivedLight(np.zeros(2), np.array([[1.0, 0.0]])), room)
    np.testing.assert_allclose(shown[0], 255 * srgb_from_linear(np.full(3, 0.04 * 68 / 8)))
    assert (shown[1] == 0).all()


def test_a_triangle_that_dips_into_the_body_is_not_darkened_by_its_hidden_corner(rasteriser):
    """A strip that runs into a closed ball: its last visible vertices keep their light to the rim."""
    strip, strip_faces = plane(2.0, 20)
    strip = strip * [1, 1, 0.2] + [1.0, 0.1, 0]
    vertices, faces = concatenated([TriangleMesh(*icosphere(0.3, subdivisions=5)), TriangleMesh(strip, strip_faces)])
    lighting = RoomLighting(rasteriser, faces, np.arange(len(vertices)))
    room = Room((), ceiling=1.0, floor=1.0, exposure=1.0)
    lit = lighting.on(vertices, room).irradiance[0, -len(strip) :]
    inside = np.linalg.norm(strip, axis=1)
    first = (inside < 0.27) & (np.abs(strip[:, 0] - 0.2) < 0.01)
    assert lit[first].min() > 0.15  # of .5 beside a wall; buried, they would have 0
    assert lit[np.abs(strip[:, 0]) < 0.01].max() == 0


def test_the_room_is_the_same_for_all_varied_light_repeats_with_its_seed():
    assert all(light_of("room", video, seed) is ROOM for video in ("body", "head", "hand_left") for seed in (0, 7))
    lights = {video: light_of("varied", video, 5) for video in ("body", "head", "hand_left", "hand_right")}
    assert len(set(lights.values())) == 4
    assert lights["head"] == light_of("varied", "head", 5) != light_of("varied", "head", 6)


RNG = np.random.default_rng(0)


def _unit(n):
    v = RNG.standard_normal((n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_even_light_shows_the_base_colour_and_sheen_depends_on_normal_and_view_alone():
    base = RNG.uniform(0, 255, (50, 3))
    assert np.array_equal(shade(base, _unit(50), _unit(50), light_of("even", "body", 0), 0.0), base)
    normals, views = _unit(200), _unit(200)
    turn = np.linalg.qr(RNG.standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    even = light_of("even", "body", 0)
    base = np.full((200, 3), 90.0)
    np.testing.assert_allclose(
        shade(base, normals, views, even, 0.5), shade(base, normals @ turn.T, views @ turn.T, even, 0.5), atol=1e-9
    )
    assert np.ptp(shade(base, normals, views, even, 0.5)) > 25  # of 255: sheen at .5 is plainly seen


@pytest.mark.parametrize("mode", ["soft", "varied"])
def test_a_point_that_faces_the_key_light_shows_its_base_colour(mode):
    light = light_of(mode, "head", 3)
    towards = np.array([light.direction]) / np.linalg.norm(light.direction)
    aside = np.cross(towards, [[0.0, 1, 0]])
    view = 0.5 * towards + np.sqrt(0.75) * aside / np.linalg.norm(aside)  # half-way vector 30 degrees off
    shown = shade(np.full((1, 3), 100.0), towards, view, light, 0.0)
    np.testing.assert_allclose(shown - 255 * light.specular * np.sqrt(0.75) ** 20, 100.0, atol=1e-9)


@pytest.mark.parametrize(
    "mode, shown",
    [
        ("soft", [94.42985758771519, 93.25811121601309, 100.81467432779634]),
        ("fixed", [88.6181405909465, 60.52270978890758, 94.95123060755891]),
        ("varied", [76.49849580931544, 57.51132791365749, 101.72478555371293]),
    ],
)
def test_lights_of_display_values_are_the_same_bits_as_ever(mode, shown):
    base = np.array([[100.0], [120.0], [80.0]]).repeat(3, 1)
    normals = np.array([[0.6, 0, 0.8], [0.0, -0.6, 0.8], [0.28, 0.96, 0.0]])
    view = np.array([[0.0, 0, 1], [0.0, 0, 1], [0.6, 0.0, 0.8]])
    assert shade(base, normals, view, light_of(mode, "head", 3), 0.5)[:, 0].tolist() == shown


def test_only_the_outer_of_two_spheres_is_seen_and_faces_smaller_than_a_pixel_are(rasteriser):
    outer, faces = icosphere(0.9)
    inner, _ = icosphere(0.88)
    seen = visible_faces(rasteriser, np.concatenate([outer, inner]), np.concatenate([faces, faces + len(outer)]))
    assert seen[: len(faces)].all() and not seen[len(faces) :].any()
    vertices, faces = icosphere(0.004, subdivisions=4)  # 1 mm faces on a bead 1.7 m from another: 5 mm pixels
    far = vertices + [1.7, 0, 0]
    assert visible_faces(rasteriser, np.concatenate([vertices, far]), np.concatenate([faces, faces + len(far)])).all()


SIZE, SECONDS = 96, 1.0
COUNT = 102


@pytest.fixture(scope="module")
def raw(tmp_path_factory):
    out = tmp_path_factory.mktemp("raw") / "me"
    config = SynthConfig(size=SIZE, light="soft", truth=False, seed=5)
    synth_raw("builtin", out, config, RawConfig(raw=True, keypoints=True, seconds=SECONDS))
    return out


def frames_of(path):
    with av.open(str(path)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


def test_videos_are_as_a_phone_writes_them_and_begin_empty(raw):
    for part, name in FILES.items():
        with av.open(str(raw / name)) as container:
            stream = container.streams.video[0]
            assert (stream.codec_context.name, stream.average_rate, stream.frames) == ("h264", 30, COUNT)
            assert (stream.width, stream.height) == (170, 96)
        frames = frames_of(raw / name).astype(float)
        empty = frames[:29]
        masks = [np.asarray(Image.open(raw / "truth" / part / "masks" / f"{i:06d}.png")) for i in (20, 100)]
        assert not masks[0].any() and masks[1].max() == 255
        # noise is there, and smaller than what the person changes
        assert 0.3 < empty.std(0).mean() < 4
        # a striped shirt and a face before a wall
        changed = np.abs(frames[100] - empty.mean(0)).max(-1)
        person = masks[1] > 250
        assert np.median(changed[person]) > 40 > 16 > np.median(changed[masks[1] == 0])


@pytest.mark.slow
def test_who_shines_is_filmed_shining(tmp_path, raw, monkeypatch):
    monkeypatch.setattr("synth.raw.film.PARTS", ("head",))
    config = SynthConfig(size=SIZE, light="soft", truth=False, seed=5, sheen=0.5)
    synth_raw("builtin", tmp_path / "me", config, RawConfig(raw=True, seconds=SECONDS))
    person = np.asarray(Image.open(raw / "truth" / "head" / "masks" / "000100.png")) > 250
    plain, shining = (frames_of(folder / FILES["head"])[100][person].mean() for folder in (raw, tmp_path / "me"))
    assert shining > plain + 5


def test_keypoints_lie_at_the_true_joints_but_for_a_detectors_mistakes(raw):
    subject = load_subject("builtin")
    for part in PARTS:
        found = read_keypoints(raw / "keypoints" / part)
        with np.load(raw / "truth" / part / "video.npz") as truth:
            truth = dict(truth)
        assert len(found.pixels) == COUNT and not found.confidence[:30].any()
        camera = Camera(truth["K"], truth["camera_from_world"], tuple(int(n) for n in truth["size"]))
        names = [name for name in found.names if name in JOINTS]
        off = []
        for i in range(75, COUNT):
            joints = joint_transforms(truth["poses"][i], subject.joints.astype(float), truth["root"][i])[:, :3, 3]
            pixels = project(camera, joints)[0]
            for name in names:
                x, y, confidence = found.seen(name)[i]
                if confidence > 0.6:
                    off.append(np.hypot(*(pixels[JOINTS.index(name)] - (x, y))))
        # 4 px of 1080 are .36 of 96; 1 cm is .5 px in the body video and 3 px before the nearest camera
        assert len(off) > (300 if part == "body" else 20) and 0.2 < np.median(off) < (1.2 if part == "body" else 3)


def test_hidden_points_are_less_sure_and_the_person_turns_once_and_sways(raw):
    # at the start the person looks at the camera; half a turn later the face is turned away
    found = read_keypoints(raw / "keypoints" / "body")
    nose = found.seen("nose")[:, 2]
    assert np.median(nose[73:77]) > 0.7 and np.median(nose[85:90]) < 0.4
    with np.load(raw / "truth" / "body" / "video.npz") as truth:
        poses, root = truth["poses"], truth["root"]
    elbow = poses[73:, JOINTS.index("left_elbow")]
    assert np.degrees(np.abs(elbow).max()) > 4 and np.degrees(elbow.std(0).max()) > 0.1
    assert 0.002 < root[80:, 0].std() < 0.03


def test_without_noise_the_room_stays_and_the_truth_is_one_folder(tmp_path, raw):
    phone = phone_of(np.arange(9) / 30, 0.0, 0.0, [1, 2])
    picture = np.full((4, 6, 3), 99.6, np.float32)
    assert (phone.shoot(8, picture) == 100).all()
    noisy = phone_of(np.arange(9) / 30, 1.0, 1.0, [1, 2])
    assert noisy.shoot(8, picture).std() > 0.5 and np.array_equal(noisy.shoot(8, picture), noisy.shoot(8, picture))
    assert RawConfig().held_out is False
    assert {path.name for path in raw.iterdir() if path.name[0] != "."} == {*FILES.values(), "keypoints", "truth"}
    facts = json.loads((raw / "truth" / "raw.json").read_text())
    assert (facts["subject"], facts["size"], facts["light"], facts["seed"]) == ("builtin:male", SIZE, "soft", 5)


def test_shadow_darkens_the_floor_where_the_person_stands():
    from avatar.camera import look_at, pinhole

    camera = Camera(pinhole((64, 48), 0.9), look_at([0, 0.2, 3.2], [0, 0, 0]), (64, 48))
    room = backdrop(camera, -0.95, False, 0)
    shadow = room.with_shadow(0.0, 0.0) / room.picture
    assert shadow.min() == pytest.approx(0.65, abs=0.02)
    # the wall has none
    assert (shadow[:20] > 0.999).all()
    y, x = np.unravel_index(shadow[..., 0].argmin(), (48, 64))
    expected = project(camera, np.array([[0, -0.95, 0]]))[0][0]
    assert np.hypot(x + 0.5 - expected[0], y + 0.5 - expected[1]) < 1.5
