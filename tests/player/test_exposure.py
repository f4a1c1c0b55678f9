"""What a shutter and a lens make of a film: the exact mean of its moments, and the frame itself where nothing shows."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.camera import orbit_camera
from avatar.motion.clip import Clip
from player.effects.ground import Ground
from player.effects.lens import SHARP, STILL, DepthOfField, MotionBlur
from player.film import exposure
from player.film.exposure import exposures, lens_point, through
from player.film.shot import Shot, ShotRenderer
from player.film.stage import Stage
from player.scene.effects import PLAIN, Effects
from player.scene.scene import Scene, SceneAvatar, SceneCamera
from player.scene.track import Track

SIZE = (96, 96)
OFF = replace(PLAIN, view="off")


@pytest.fixture
def shot_of(request):
    """Makes renderers of shots of the walking built-in body, and frees them."""
    made = []

    def make(effects: Effects, motion: str | None = "walking", kind: str = "front") -> ShotRenderer:
        scene = Scene(
            (SceneAvatar("mannequin", motion),), (SceneCamera(kind, seconds=2.0),), effects=effects, size=SIZE
        )
        stage = Stage(scene, 1)
        shot = Shot(scene, 0, stage.frames, SIZE, stage.rate, stage.fit(0, min(stage.frames, 60)))
        made.append(ShotRenderer(shot, stage))
        return made[-1]

    yield make
    for drawn in made:
        drawn.release()


def test_a_blurred_frame_is_the_mean_of_its_moments(shot_of):
    blurred, plain = shot_of(replace(OFF, motion_blur=MotionBlur(1.0, 6))), shot_of(OFF)
    image, frame = blurred.draw(33), 33
    camera = plain.camera_at(frame, plain.stage.poses(frame)[0][1])
    moments = [
        plain.renderer.draw(plain.stage.poses_beside(frame, (i + 0.5) / 6 - 0.5), camera).astype(float)
        for i in range(6)
    ]
    assert np.abs(image - np.mean(moments, 0)).max() <= 0.5
    assert (image != plain.draw(33)).any()
    (row,) = [row for row in blurred.renderer.explain(1) if row["name"] == "motion blur"]
    assert (row["state"], row["why"], row["bytes"]) == ("runs", "the mean of 6 frames", 0) and row["ms"] > 0


def test_what_is_in_focus_stays_sharp_and_the_rest_spreads(shot_of):
    """The circle of confusion of a point at depth z is f lens |1 / focus - 1 / z| pixels wide."""
    camera, focus, diameter = orbit_camera((0, 0.9, 0), 3.0, 0.3, 0.1, SIZE), 2.7, 0.1
    points = np.array([[0.1, -0.2, z, 1.0] for z in (1.5, focus, 6.0)])
    to_world = np.linalg.inv(camera.camera_from_world)
    spread = []
    for point in points:
        at = []
        for index in range(64):
            seen = through(camera, 0.5 * diameter * lens_point(index, 64), focus)
            pixel = seen.K @ (seen.camera_from_world @ (to_world @ point))[:3]
            at.append(pixel[:2] / pixel[2])
        spread.append(2 * np.linalg.norm(np.array(at) - np.mean(at, 0), axis=1).max())
    expected = camera.K[0, 0] * diameter * np.abs(1 / focus - 1 / points[:, 2])
    np.testing.assert_allclose(spread, expected, rtol=0.03, atol=1e-9)
    deep, plain = shot_of(replace(OFF, depth_of_field=DepthOfField(0.2, samples=12))), shot_of(OFF)
    assert (deep.draw(20) != plain.draw(20)).any()


@pytest.mark.parametrize(
    ("effects", "why"),
    [(replace(OFF, motion_blur=MotionBlur()), STILL), (replace(OFF, depth_of_field=DepthOfField(1e-4)), SHARP)],
)
def test_what_cannot_show_is_the_frame_and_its_calls(shot_of, effects, why):
    images, calls = [], []
    for wish in (effects, OFF):
        drawn = shot_of(wish, motion=None)
        drawn.draw(0)
        counts = drawn.context.counts
        before, objects = counts.calls.copy(), counts.objects()
        images.append(drawn.draw(0))
        calls.append((counts.calls - before, objects))
        rows = {one.item.name: one.decision for one in drawn.renderer.drawn}
        if wish is effects:
            assert [rows[name].why for name in ("motion blur", "depth of field") if rows[name].state == "skipped"] == [
                why
            ]
    assert np.array_equal(*images) and calls[0] == calls[1]


def test_moments_and_places_on_the_lens_each_come_once(shot_of):
    both = replace(OFF, motion_blur=MotionBlur(0.5, 8), depth_of_field=DepthOfField(0.3, 0.0, 24))
    drawn, seen = shot_of(both), []

    def view_at(share):
        seen.append(share)
        poses = drawn.stage.poses_beside(30, share) if share else drawn.stage.poses(30)
        return poses, drawn.camera_at(30, poses[0][1])

    views = exposures(both, view_at, drawn.renderer.posers)
    assert len(views) == 24
    np.testing.assert_allclose(sorted(seen[-24:]), ((np.arange(24) + 0.5) / 24 - 0.5) / 2)
    eyes = np.array([camera.eye for _, camera in views])
    assert len(np.unique(eyes.round(9), axis=0)) == 24
    assert np.linalg.norm(eyes.mean(0) - drawn.camera_at(30, np.zeros(3)).eye) < 0.01
    assert [exposure._stride(count) for count in (1, 2, 4, 24)] == [1, 1, 3, 17]


def moving(root: np.ndarray, rate: float = 30.0) -> Track:
    return Track(Clip(np.zeros((len(root), 52, 3)), root.astype(float), rate))


def test_a_teleport_is_not_smeared():
    root = np.zeros((20, 3))
    root[:, 0] = 0.01 * np.arange(20)
    root[10:, 2] = 5.0
    track = moving(root)
    for frame, z in ((9, 0.0), (10, 5.0)):
        for share in np.linspace(-0.99, 0.99, 7):
            pose = track.pose_beside(frame / 30, share / 30)
            assert pose[1][2] == z
    at = [track.pose_beside(5 / 30, share / 30)[1][0] for share in (-0.5, 0.0, 0.25, 1.0)]
    np.testing.assert_allclose(at, [0.045, 0.05, 0.0525, 0.06], atol=1e-12)
    # a motion faster than the film: several of its frames, and none beyond the jump
    fast = moving(root, 120.0)
    assert {fast.pose_beside(8 / 120, share / 120)[1][2] for share in np.linspace(-2, 4, 30)} == {0.0}
    turned = Track(Clip(half_turn(), np.zeros((4, 3)), 30.0))
    assert np.array_equal(turned.pose_beside(2 / 30, -0.3 / 30)[0], half_turn()[2])
    # before the first and after the last frame
    assert track.pose_beside(0.0, -0.01)[1][0] == 0.0 and track.pose_beside(19 / 30, 0.01)[1][0] == pytest.approx(0.19)


def half_turn() -> np.ndarray:
    """Two frames, a half turn, two frames."""
    out = np.zeros((4, 52, 3))
    out[2:, 0, 1] = np.pi
    return out


def test_a_window_draws_each_moment_once(context, render, avatar, pose):
    window = render(avatar, None, effects=replace(OFF, motion_blur=MotionBlur(), depth_of_field=DepthOfField()))
    why = {item.name: item.why for item in window.plan.passes if item.name in ("motion blur", "depth of field")}
    assert set(why.values()) == {"for films: a window draws each moment once"} and len(why) == 2


def test_a_floor_is_always_out_of_focus_somewhere(shot_of):
    wish = replace(OFF, depth_of_field=DepthOfField(1e-3, samples=4), ground=Ground("checker"))
    drawn = shot_of(wish, motion=None)
    drawn.draw(0)
    assert drawn.renderer.last.exposures == 4
