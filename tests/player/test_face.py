"""A face that moves: what shapes, gaze and lids do to vertices, and that it costs nothing where it cannot be seen."""

from dataclasses import replace

import numpy as np
import pytest
from faced_avatar import doing, faced

from avatar.camera import orbit_camera
from avatar.face import SHAPES, FaceFrame
from player.draw.drawing import Pose
from player.draw.face import AT_REST, OUT_OF_VIEW, SMALL, FaceBlend, FaceMotion
from player.effects.ground import Ground
from player.effects.lens import MotionBlur
from player.effects.light import Light
from player.effects.outline import Outline
from player.film.exposure import exposures
from player.scene.effects import PLAIN, Effects
from player.scene.mannequin import mannequin

SIZE = (160, 160)
HEAD = faced().eyes[0].center * [0, 1, 1]
NEAR, FAR = (orbit_camera(tuple(HEAD), distance, 0.3, 0.05, SIZE) for distance in (0.6, 9.0))
AWAY = orbit_camera((0, 1.0, 10), 2.0, np.pi, 0.1, SIZE)
TALK = doing((0.3, -0.2), jawOpen=0.6, eyeBlinkLeft=1.0)


def standing(face=None):
    return Pose(np.zeros((52, 3)), np.zeros(3), face)


def moved_level(level, frame):
    """The level with the face of a frame in its positions."""
    blend = FaceBlend(level, faced().eyes)
    by = blend.offsets(frame)[blend.slots]
    turned = level.normals + by[:, 3:] * by[:, :3]
    return replace(level, positions=level.positions + by[:, :3], normals=turned, face=None)


def test_shapes_add_up_and_eyes_turn_about_their_centers_to_the_persons_left_and_up():
    level, (left, _) = faced().levels[0], faced().eyes
    moved = moved_level(level, doing((0.5, 0.3), jawOpen=0.5, eyeBlinkRight=0.25))
    first, count = level.face.balls[0]
    ball = slice(first, first + count)
    ahead = int(first + level.normals[ball, 2].argmax())
    looks = (moved.positions[ahead] - left.center) / left.radius
    assert looks[0] > 0.4 and looks[1] > 0.25, "towards the person's left, and up"
    assert np.allclose(np.linalg.norm(moved.positions[ball] - left.center, axis=1), left.radius, atol=1e-6)
    assert np.allclose(moved.normals[ball], (moved.positions[ball] - left.center) / left.radius, atol=1e-4)
    jaw, blink = (level.face.offsets[SHAPES.index(name)] for name in ("jawOpen", "eyeBlinkRight"))
    chin = level.face.vertices[jaw.any(1) & ~blink.any(1)]
    assert np.allclose((moved.positions - level.positions)[chin], [0, -0.015, -0.0025], atol=1e-6)


def test_weights_and_gaze_are_clamped():
    motion = FaceMotion(faced().levels[0], faced().eyes)
    wild = motion.wanted(FaceFrame(np.linspace(3, -3, 52), np.array([[2.0, 2.0], [-2.0, -2.0]])))
    assert wild.weights.min() == 0 and wild.weights.max() == 1 and not wild.weights[1:7].any(), "closed is closed"
    assert np.allclose(np.degrees(wild.gaze), [[35, 25], [-35, -30]])


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
@pytest.mark.parametrize("asked", [{}, {"outline": Outline()}, {"light": Light("lamps")}], ids=str)
def test_the_picture_is_that_of_a_surface_moved_so(render, asked, skinning):
    avatar, effects = faced(), replace(PLAIN, view="off", skinning=skinning, **asked)
    still = replace(avatar, levels=(moved_level(avatar.levels[0], TALK),), eyes=None)
    image, expected = (render(one, SIZE, effects=effects).draw([standing(TALK)], NEAR) for one in (avatar, still))
    rest = render(avatar, SIZE, effects=effects).draw([standing()], NEAR)
    assert (np.abs(image.astype(int) - expected).max(-1) > 2).sum() <= 4
    assert (image != rest).any(-1).sum() > 200


def test_a_shadow_that_is_kept_follows_the_face(render):
    effects = replace(PLAIN, view="off", ground=Ground("shadow", height=-0.95))
    renderer, states = render(faced(), (300, 300), effects=effects), []
    camera = orbit_camera((0, -0.3, 0), 1.6, 0.4, 0.4, (300, 300))
    for face in (None, TALK, TALK, None, None):
        renderer.draw([standing(face)], camera)
        states += [one.decision.state for one in renderer.drawn if one.item.name == "ground: mask"]
    assert states == ["runs", "runs", "kept", "runs", "kept"]


@pytest.mark.parametrize("face, camera", [(None, NEAR), (doing(), NEAR), (TALK, FAR), (TALK, AWAY)])
def test_at_rest_far_away_or_out_of_view_it_is_the_frame_and_the_objects_of_no_face(context, render, face, camera):
    still = replace(faced(), levels=(replace(faced().levels[0], face=None),), eyes=None)
    images, calls, objects = [], [], []
    for avatar in (still, faced()):
        renderer = render(avatar, SIZE, effects=Effects())
        before = context.counts.calls.copy()
        images.append(renderer.draw([standing(face)], camera))
        calls.append(context.counts.calls - before)
        objects.append((renderer.plan.objects(), renderer.plan.bytes, renderer.drawn and len(renderer.drawn)))
        renderer.release()
    assert np.array_equal(*images) and calls[0] == calls[1] and objects[0] == objects[1]


def test_a_face_too_small_to_be_seen_leaves_the_shadow_as_it_is_whatever_was_shown_before(render):
    fresh, other = (render(faced(), SIZE, effects=replace(PLAIN, ground=Ground())) for _ in range(2))
    other.draw([standing(TALK)], NEAR)
    assert np.array_equal(fresh.draw([standing(TALK)], FAR), other.draw([standing(TALK)], FAR))


def test_a_blink_is_blurred_where_it_is_seen_and_the_avatar_has_a_face(context, render):
    effects = replace(PLAIN, view="off", motion_blur=MotionBlur(0.5, 8))
    blink = lambda share: standing(doing(eyeBlinkLeft=0.5 + share))
    for avatar, camera, views in ((faced(), NEAR, 8), (faced(), FAR, 1), (mannequin(), NEAR, 1)):
        posers = render(avatar, SIZE, effects=effects).posers
        assert len(exposures(effects, lambda share: ([blink(share)], camera), posers)) == views


def test_once_moved_it_uploads_what_changes_and_nothing_at_rest(context, render, monkeypatch):
    renderer = render(faced(), SIZE, effects=Effects())
    bare = renderer.draw([standing()], NEAR)
    talking = renderer.draw([standing(TALK)], NEAR)
    assert context.counts.objects() == renderer.plan.objects() and context.counts.live_bytes == renderer.plan.bytes

    blend = renderer.plan.kept["face", 0, 0].blend
    monkeypatch.setattr(blend, "offsets", lambda frame, blended=blend.offsets: uploads.append(1) or blended(frame))
    uploads = []

    def shown(face, camera=NEAR):
        image = renderer.draw([standing(face)], camera)
        rows = {one.item.name: one.decision for one in renderer.drawn}
        return image, len(uploads), rows["avatar: face"]

    assert np.array_equal(shown(TALK)[0], talking) and not uploads
    rest, one, decision = shown(None)
    assert np.array_equal(rest, bare) and decision == AT_REST and one == 1
    assert shown(None)[1] == 1 and shown(TALK, FAR)[1:] == (1, SMALL) and shown(TALK, AWAY)[2] == OUT_OF_VIEW
    assert shown(doing(jawOpen=0.2))[2].why == "1 of 52 shapes"
