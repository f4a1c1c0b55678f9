"""Hard cases: effects at the limits of cameras, sizes and skinning."""

import numpy as np
import pytest
from glsl_probe import probe
from loose_avatar import dressed
from loose_paths import dance
from radiance_writer import radiance_bytes, sky

from avatar.camera import Camera, look_at, orbit_camera, pinhole
from avatar.rotation import matrix_from_axis_angle, quaternion_from_matrix
from avatar.skeleton import BIG_POSE
from avatar.skinning import (
    SkinWeights,
    dual_quaternion_from_transform,
    skin_points_dual_quaternion,
    transform_from_dual_quaternion,
)
from player.draw.posing import Poser, dual_parts
from player.effects.background import Background
from player.effects.loose_motion import LooseMotion
from player.effects.loose_parts import loose_parts
from player.effects.loose_sheets import REACH
from player.effects.secondary_motion import SecondaryMotion
from player.gl.context import open_context
from player.scene.effects import Effects
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer

POSE = (np.array(BIG_POSE), np.zeros(3))
SMOOTH = ("fxaa", "msaa")
POINT = "vec4(skinned(point, joints, weights), 0.0)"


@pytest.fixture(scope="module")
def context():
    context = open_context()
    yield context
    assert context.gl.error == "GL_NO_ERROR"
    assert context.counts.objects() == {}
    context.release()


@pytest.fixture(scope="module")
def surroundings(tmp_path_factory):
    path = tmp_path_factory.mktemp("sky") / "sky.hdr"
    path.write_bytes(radiance_bytes(sky(64)))
    return Background("hdr", path=str(path))


@pytest.mark.parametrize("antialiasing", SMOOTH)
def test_cameras_inside_the_body_and_of_extreme_fields_of_view(context, surroundings, antialiasing):
    effects = Effects("off", "dual_quaternion", antialiasing)
    renderer = Renderer(context, [mannequin()], (96, 96), effects=effects, background=surroundings)
    for eye in ((0, 0, 0), (0, 0.2, 0.05), (0.3, 0.45, 0.0)):
        for fov in (1.0, 60.0, 170.0):
            target = (eye[0] + 0.3, eye[1] + 0.1, eye[2] + 1.0)
            camera = Camera(pinhole((96, 96), np.radians(fov)), look_at(eye, target), (96, 96))
            image = renderer.draw([POSE], camera)
            assert (image[..., 3] == 255).all() and context.gl.error == "GL_NO_ERROR"
    renderer.release()


@pytest.mark.parametrize("antialiasing", SMOOTH)
@pytest.mark.parametrize("size", [(1, 1), (1, 50), (8192, 3), (3, 8192)])
def test_targets_of_extreme_sizes(context, surroundings, size, antialiasing):
    """Antialiasing changes edges, not what is seen: a sample of four may fall into the next check of the paint."""
    camera = orbit_camera((0, 0, 0), 0.4, 0.0, 0.0, (64, 64))
    images = []
    for kind in ("none", antialiasing):
        effects = Effects("off", antialiasing=kind)
        renderer = Renderer(context, [mannequin()], size, effects=effects, background=surroundings)
        images.append(renderer.draw([POSE], camera).astype(float))
        renderer.release()
    assert images[1].shape == (size[1], size[0], 4) and (images[1][..., 3] == 255).all()
    assert np.abs(images[0] - images[1]).mean() < 8


def test_a_renderer_resized_many_times_holds_no_more_than_one(context, surroundings):
    """A window dragged larger and smaller, through one pixel."""
    effects = Effects("off", antialiasing="fxaa")
    renderer = Renderer(context, [mannequin()], (9, 9), effects=effects, background=surroundings)
    programs = set(context.counts.live["program"])
    for step in range(150):
        renderer.resize((1 + step * 7 % 60, 1 + step * 13 % 50))
    image = renderer.draw([POSE], orbit_camera((0, 0, 0), 3.0, 0.0, 0.0, (64, 64)))
    assert image.shape == (renderer.size[1], renderer.size[0], 4)
    assert context.counts.objects() == renderer.plan.objects() and context.counts.live["program"] == programs
    with pytest.raises(ValueError, match="99999 pixels across"):
        renderer.resize((99999, 4))
    assert context.counts.objects() == renderer.plan.objects() and renderer.size != (99999, 4)
    renderer.release()


def test_dual_quaternions_of_opposite_hemispheres_blend_as_the_reference(context, within):
    """Four bones, two of them half a turn from the heaviest, each stored with either sign."""
    rng = np.random.default_rng(6)
    transforms = np.tile(np.eye(4), (52, 1, 1))
    transforms[:, :3, :3] = matrix_from_axis_angle(rng.normal(size=(52, 3)))
    for bone, heaviest in ((1, 0), (3, 2)):
        transforms[bone, :3, :3] = transforms[heaviest, :3, :3] @ matrix_from_axis_angle(np.array([np.pi - 1e-3, 0, 0]))
    transforms[:, :3, 3] = rng.normal(size=(52, 3))
    duals = dual_quaternion_from_transform(transforms) * rng.choice([-1.0, 1.0], (52, 1, 1))
    assert np.abs(transform_from_dual_quaternion(duals) - transforms).max() < 1e-12, "signs change no bone"
    buffers = [context.gl.buffer(duals[:, part].astype(np.float32).tobytes()) for part in (0, 1)]
    buffers[0].bind_to_uniform_block(2)
    buffers[1].bind_to_uniform_block(3)
    weights = np.sort(rng.dirichlet(np.ones(4), 500), 1)[:, ::-1]
    joints = np.tile([0, 1, 2, 3], (500, 1))
    joints[250:] = [2, 3, 1, 0]
    points = rng.normal(size=(500, 3))
    values = {"point": points, "joints": joints, "weights": weights}
    out = probe(context, ["skinning_dual.glsl"], POINT, values, ints=("joints",), stage="vertex")[:, :3]
    expected = skin_points_dual_quaternion(points, SkinWeights(joints, weights.astype(np.float32)), transforms)
    for buffer in buffers:
        buffer.release()
    away = np.abs(out - expected).max(1)
    assert np.isfinite(out).all()
    # a bone on the rim of the half sphere about the heaviest: float32 and float64 may take different sides
    q = quaternion_from_matrix(transforms[:, :3, :3])
    rim = np.abs(np.einsum("nsc,nc->ns", q[joints], q[joints[:, 0]])).min(1) < 1e-6
    within(away[~rim].max(), 2e-5, "m")


def test_ten_kilometres_away_dual_quaternions_do_not_tremble(within):
    """As linear blending: the camera's and the body's large numbers cancel before anything is rounded."""
    avatar = mannequin()
    poser = Poser(avatar, avatar.levels[0])
    size, shift = (1280, 720), np.array([10_000.0, 0.0, 0.0])
    camera = orbit_camera((0, 0, 0), 2.5, 0.4, 0.1, size)
    moved = camera.camera_from_world.copy()
    moved[:3, 3] -= moved[:3, :3] @ shift
    points, worst = avatar.levels[0].positions[::50].astype(float), 0.0
    for step in range(20):
        root, pixels = np.array([1e-4 * step, 0, 0]), []
        for place, seen_by in ((root, camera), (root + shift, Camera(camera.K, moved, size))):
            bones = poser.posed(POSE[0], place, seen_by)
            real = quaternion_from_matrix(bones.view_from_canonical[:, :3, :3])
            rounded = np.stack([real, dual_parts(bones, real)], 1).astype(np.float32)[:1].astype(float)
            M = transform_from_dual_quaternion(rounded)[0]
            view = points @ M[:3, :3].T + M[:3, 3]
            pixels.append(camera.K[0, 0] * view[:, :2] / view[:, 2:])
        worst = max(worst, float(np.abs(pixels[0] - pixels[1]).max()))
    within(worst, 0.1, "pixel")


@pytest.mark.parametrize("seconds", [-1.0, 0.0, 1e-9, 30 * 86400.0])
def test_a_film_behind_at_any_time(context, tmp_path, seconds):
    """Also before its start, and 30 days after its end."""
    from PIL import Image

    for number in range(3):
        Image.fromarray(np.full((4, 4, 3), 80 * number, np.uint8)).save(tmp_path / f"{number}.png")
    background = Background("video", path=str(tmp_path))
    renderer = Renderer(context, [mannequin()], (8, 8), effects=Effects("off"), background=background)
    away = orbit_camera((0, 0, 10), 2.0, np.pi, 0, (8, 8))
    image = renderer.draw([POSE], away, seconds=seconds)
    renderer.release()
    assert (image[..., 0] == (160 if seconds > 1 else 0)).all()


LOOSE_BODIES = {
    "a body that teleports": lambda t: (0.3 * dance(t)[0], dance(t)[1] + (t >= 1) * np.array([1e3, 0, 0])),
    "a body that turns by 180 degrees in a frame": lambda t: (
        0.3 * dance(t)[0] + np.eye(52)[0][:, None] * [0, np.pi * (t >= 1), 0], dance(t)[1],
    ),
    "a body 10 km away": lambda t: (0.3 * dance(t)[0], dance(t)[1] + [1e4, 0, 1e4]),
    "a film of 3 frames a second": lambda t: (dance(np.floor(3 * t) / 3)),
}  # fmt: skip


@pytest.mark.parametrize("name", LOOSE_BODIES)
def test_hair_and_skirt_stay_with(name, within):
    """And come to rest within three seconds of the body's."""
    avatar = dressed()
    motion = LooseMotion(loose_parts(avatar, avatar.levels[0]), SecondaryMotion())
    worst = 0.0
    for frame in range(60 * 5):
        t = frame / 60
        motion.move(LOOSE_BODIES[name](min(t, 1.5)), t)
        worst = max(worst, motion.reach)
        assert np.isfinite(motion.offsets).all()
    assert motion.asleep
    within(worst, REACH + 0.02, "m off the skinned pose")


def test_hair_and_skirt_at_any_rate_of_frames(within):
    avatar = dressed()
    parts, ends = loose_parts(avatar, avatar.levels[0]), []
    for rate in (30, 240):
        motion, path = LooseMotion(parts, SecondaryMotion()), []
        for frame in range(2 * rate + 1):
            axis_angle, root = dance(frame / rate)
            motion.move((0.3 * axis_angle, root), frame / rate)
            if frame % (rate // 30) == 0:
                path.append(motion.offsets)
        ends.append(np.array(path))
    within(100 * np.abs(ends[0] - ends[1]).max() / np.abs(ends[1]).max(), 2.0, "% of the amplitude")
