"""Hard cases: effects at the limits of cameras, sizes and skinning."""

from dataclasses import replace

import numpy as np
import pytest
from dual_quaternions import dual_quaternion_from_transform, skin_points_dual_quaternion, transform_from_dual_quaternion
from glsl_probe import probe
from loose_avatar import SETTINGS, dance, dressed, gently, moved

from avatar.camera import Camera, look_at, orbit_camera, pinhole
from avatar.rotation import matrix_from_axis_angle, quaternion_from_matrix
from avatar.skeleton import BIG_POSE
from avatar.skinning import SkinWeights
from player.draw.posing import Poser, dual_parts
from player.effects.loose_motion import LONGEST, REACH, LooseMotion
from player.effects.loose_parts import loose_parts
from player.scene.effects import Effects
from player.scene.mannequin import mannequin

POSE = (np.array(BIG_POSE), np.zeros(3))
POINT = "vec4(skinned(point, joints, weights), 0.0)"


@pytest.mark.parametrize("antialiasing", ["none", "fxaa", "msaa"])
def test_cameras_inside_the_body_and_of_extreme_fields_of_view(context, render, backgrounds, antialiasing):
    skinning = "lbs" if antialiasing == "none" else "dual_quaternion"
    effects = Effects("vertex", skinning, antialiasing)
    renderer = render(mannequin(), (96, 96), effects=effects, background=backgrounds["hdr"])
    for eye in ((0, 0, 0), (0, 0.2, 0.05), (0.0, 0.45, 0.0), (0.3, 0.45, 0.0)):
        for fov in (1.0, 60.0, 170.0):
            target = (eye[0] + 0.3, eye[1] + 0.1, eye[2] + 1.0)
            camera = Camera(pinhole((96, 96), np.radians(fov)), look_at(eye, target), (96, 96))
            image = renderer.draw([POSE], camera)
            assert (image[..., 3] == 255).all() and context.gl.error == "GL_NO_ERROR"


@pytest.mark.parametrize(
    "size", [(1, 1), (1, 50), (8192, 3), (3, 8192), pytest.param((2048, 2048), marks=pytest.mark.slow)]
)
def test_targets_of_extreme_sizes(render, backgrounds, size):
    """Antialiasing changes edges, not what is seen: a sample of four may fall into the next check of the paint."""
    camera, away = orbit_camera((0, 0, 0), 0.4, 0.0, 0.0, (64, 64)), (POSE[0], np.array([0, 0, 1e3]))
    images = []
    for kind in ("none", "fxaa", "msaa"):
        effects = Effects("off", antialiasing=kind)
        renderer = render(mannequin(), size, effects=effects, background=backgrounds["hdr"])
        image, empty = (renderer.draw([pose], camera).astype(int) for pose in (POSE, away))
        images.append(image)
        assert image.shape == (size[1], size[0], 4) and (image[..., 3] == 255).all() and (image != empty).any()
        assert np.abs(images[0] - image).mean() < 8


def test_a_renderer_resized_many_times_holds_no_more_than_one(context, render, backgrounds):
    """A window dragged larger and smaller, through one pixel."""
    effects = Effects("off", antialiasing="fxaa")
    renderer = render(mannequin(), (9, 9), effects=effects, background=backgrounds["hdr"])
    programs = set(context.counts.live["program"])
    for step in range(150):
        renderer.resize((1 + step * 7 % 60, 1 + step * 13 % 50))
    image = renderer.draw([POSE], orbit_camera((0, 0, 0), 3.0, 0.0, 0.0, (64, 64)))
    assert image.shape == (renderer.size[1], renderer.size[0], 4)
    assert context.counts.objects() == renderer.plan.objects() and context.counts.live["program"] == programs
    for too_large in (lambda: renderer.resize((99999, 4)), lambda: render(mannequin(), (99999, 4))):
        with pytest.raises(ValueError, match="99999 pixels across"):
            too_large()
    assert context.counts.objects() == renderer.plan.objects() and renderer.size != (99999, 4)


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
    blocks = {"Turns": duals[:, 0].astype(np.float32), "Duals": duals[:, 1].astype(np.float32)}
    weights = np.sort(rng.dirichlet(np.ones(4), 500), 1)[:, ::-1]
    joints = np.tile([0, 1, 2, 3], (500, 1))
    joints[250:] = [2, 3, 1, 0]
    points = rng.normal(size=(500, 3))
    values = {"point": points, "joints": joints, "weights": weights}
    out = probe(context, ["skinning_dual.glsl"], POINT, values, blocks=blocks, ints=("joints",), stage="vertex")[:, :3]
    expected = skin_points_dual_quaternion(points, SkinWeights(joints, weights.astype(np.float32)), transforms)
    away = np.abs(out - expected).max(1)
    assert np.isfinite(out).all()
    # a bone on the rim of the half sphere about the heaviest: float32 and float64 may take different sides
    q = quaternion_from_matrix(transforms[:, :3, :3])
    rim = np.abs(np.einsum("nsc,nc->ns", q[joints], q[joints[:, 0]])).min(1) < 1e-6
    within(away[~rim].max(), 2e-5, "m")


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
def test_ten_kilometres_away_a_slow_walk_does_not_tremble(skinning, within):
    """Vertices follow a root moved by tenths of a millimetre: the large numbers of camera and body cancel before
    anything is rounded."""
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
            M = bones.view_from_canonical[0].astype(np.float32).astype(float)
            if skinning == "dual_quaternion":
                real = quaternion_from_matrix(bones.view_from_canonical[:, :3, :3])
                rounded = np.stack([real, dual_parts(bones, real)], 1).astype(np.float32)[:1].astype(float)
                M = transform_from_dual_quaternion(rounded)[0]
            view = points @ M[:3, :3].T + M[:3, 3]
            pixels.append(camera.K[0, 0] * view[:, :2] / view[:, 2:])
        worst = max(worst, float(np.abs(pixels[0] - pixels[1]).max()))
    within(worst, 0.1, "pixel")


@pytest.fixture(scope="module")
def parts():
    avatar = dressed()
    return loose_parts(avatar, avatar.levels[0])


@pytest.mark.parametrize("pose_at", [gently, dance], ids=["gently", "wildly"])
def test_hair_and_skirt_at_any_rate_of_frames(parts, pose_at, within):
    often = moved(parts, 240, 4, pose_at)[1]
    for rate in (30, 60):
        seldom = moved(parts, rate, 4, pose_at)[1]
        within(100 * np.abs(seldom - often).max() / np.abs(often).max(), 2.0, "% of the amplitude")
    # those that do not divide the rate of substeps neither
    odd = LooseMotion(parts, SETTINGS)
    for frame in range(4 * 50 + 1):
        odd.move(pose_at(frame / 50), frame / 50)
    within(100 * np.abs(odd.offsets - often[-1]).max() / np.abs(often).max(), 2.0, "% of the amplitude")


def turned(pose, angle):
    axis_angle = pose[0].copy()
    axis_angle[0, 1] += angle
    return axis_angle, pose[1]


LOOSE_BODIES = {
    "a body that teleports": lambda t, pose: (pose[0], pose[1] + (t >= 1) * np.array([1e3, 0, 50])),
    "a body that turns by 180 degrees in a frame": lambda t, pose: turned(pose, np.pi * (t >= 1)),
    "a body 10 km away": lambda t, pose: (pose[0], pose[1] + [1e4, 0, 1e4]),
    "a film of 3 frames a second": lambda t, pose: gently(np.floor(3 * min(t, 1.5)) / 3),
    "arms thrown up in a frame": lambda t, pose: (pose[0] + (t >= 1) * np.eye(52)[16][:, None] * [0, 0, 2.0], pose[1]),
}


@pytest.mark.rows
@pytest.mark.parametrize("name", LOOSE_BODIES)
@pytest.mark.parametrize("settings", [SETTINGS, replace(SETTINGS, gravity=0.0)], ids=["gravity", "none"])
def test_hair_and_skirt_stay_with(parts, name, settings, within):
    """And come to rest within three seconds of the body's."""
    motion, worst = LooseMotion(parts, settings), 0.0
    for frame in range(int(4.5 * 60) + 1):
        t = frame / 60
        motion.move(LOOSE_BODIES[name](t, gently(min(t, 1.5))), t)
        worst = max(worst, motion.reach)
        assert np.isfinite(motion.offsets).all()
    assert motion.asleep
    within(worst, REACH + 0.02, "m off the skinned pose")


@pytest.mark.parametrize("dt", [0.0, 1e-6, LONGEST, 10.0, -3.0])
def test_hair_and_skirt_endure_frames_of_any_length(parts, dt):
    motion, t = LooseMotion(parts, SETTINGS), 0.0
    for frame in range(60):
        t += 1 / 60
        motion.move(dance(frame / 60), t)
    before = motion.offsets
    for frame in range(60, 70):
        t += dt
        motion.move(dance(frame / 60), t)
        assert np.isfinite(motion.offsets).all() and motion.reach <= REACH + 0.02
    if dt in (10.0, -3.0):
        # begun anew: as skinned, but for the capsules
        assert motion.reach < 0.05 < np.abs(before).max()
    last = dance(69 / 60)
    for _ in range(180):
        t += 1 / 60
        motion.move(last, t)
    assert motion.asleep


def test_hair_and_skirt_move_ten_kilometres_away_as_at_home(parts):
    here = moved(parts, 60, 2, dance)[1]
    far = moved(parts, 60, 2, lambda t: (dance(t)[0], dance(t)[1] + [1e4, 0, -1e4]))[1]
    assert np.abs(here - far).max() < 1e-6


def test_hair_and_skirt_of_a_rig_of_a_hundredth_move_as_those_of_a_grown_one():
    """At .01 of its size, with a root that moves so much less."""
    runs = []
    for scale in (1.0, 0.01):
        avatar = dressed(scale=scale)
        found = loose_parts(avatar, avatar.levels[0])
        run = moved(found, 60, 2, lambda t, scale=scale: (gently(t)[0], scale * gently(t)[1]))[1]
        assert np.isfinite(run).all()
        # rounding chooses other vertices as particles: on average they swing alike
        runs.append(np.linalg.norm(run / scale, axis=2).mean(1))
    assert np.abs(runs[0] - runs[1]).max() < 0.03 * runs[0].max()
