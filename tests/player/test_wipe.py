"""A capture in the window: its cameras, its video behind the avatar and on one side of the line."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import glfw
import numpy as np
import pytest
from PIL import Image
from refusals import refused

from avatar.camera import Camera, look_at, orbit_camera, pinhole, pixel_rays, project, write_cameras
from avatar.gltf.avatar_file import write_avatar
from avatar.motion.amass import read_video_poses, write_amass
from avatar.motion.clip import Clip
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import joint_transforms
from command.command_line import parse
from command.errors import AssetError
from player.draw.posing import posed_vertices
from player.film.stage import Stage
from player.play_command import PLAY, PlayCommand, scene_of
from player.scene.capture_view import open_capture
from player.scene.opened import opened_avatars
from player.scene.renderer import Renderer
from player.scene.scene import Scene, SceneAvatar, SceneCamera
from player.window.picture import PictureLayer
from player.window.show import opened_show
from player.window.window import Window

SIZE = (96, 128)
FRAMES = 3


@pytest.fixture(scope="module")
def capture(avatar, tmp_path_factory):
    """Three pictures of the avatar, each frame from another side, on green; and a head video in a frame of its own."""
    from player.gl.context import open_context

    path = tmp_path_factory.mktemp("capture")
    (path / "body" / "images").mkdir(parents=True)
    rng = np.random.default_rng(0)
    axis_angle = 0.1 * rng.normal(size=(FRAMES, 52, 3))
    root = np.array([[0.2, 0.9, -0.3]] * FRAMES)
    cameras = [orbit_camera((0.2, 0.9, -0.3), 3.6, side, 0.1, SIZE) for side in (0.0, 1.0, 2.5)]
    context = open_context()
    renderer = Renderer(context, [avatar], SIZE, background=(0.0, 1.0, 0.0, 1.0))
    for n in range(FRAMES):
        image = renderer.draw([(axis_angle[n], root[n])], cameras[n])[..., :3]
        Image.fromarray(np.ascontiguousarray(image)).save(path / "body" / "images" / f"{n:06d}.png")
    context.release()
    write_cameras(path / "body" / "cameras.npz", cameras)
    write_amass(path / "body" / "poses.npz", Clip(axis_angle, root, 10.0), up="y")
    (path / "capture.json").write_text(json.dumps({"format": "selfscan-capture", "version": 1}))

    level = avatar.levels[0]
    still = (np.zeros((52, 3)), np.zeros(3))
    template = posed_vertices(avatar, level, still)
    np.savez(path / "subject.npz", v_template=template)
    scale, R, t = 2.5, matrix_from_axis_angle(np.array([0.3, -1.2, 0.5])), np.array([4.0, 5.0, 6.0])
    high = np.argsort(template[:, 1])[-400::50]
    points = {f"p{v}": (scale * R @ template[v] + t).tolist() for v in high}
    (path / "head" / "images").mkdir(parents=True)
    names = {"points": points, "vertices": {f"p{v}": int(v) for v in high}}
    (path / "head" / "landmarks.json").write_text(json.dumps(names))
    world = Camera(pinhole(SIZE, 0.4), look_at((0.3, 0.6, 1.2), (0, 0.55, 0)), SIZE)
    # the same camera where the head's frame has it: x_head = s R x + t
    pose = np.eye(4)
    pose[:3, :3] = world.camera_from_world[:3, :3] @ R.T
    pose[:3, 3] = scale * world.camera_from_world[:3, 3] - pose[:3, :3] @ t
    write_cameras(path / "head" / "cameras.npz", [Camera(world.K, pose, SIZE)])
    Image.new("RGB", SIZE, (9, 9, 9)).save(path / "head" / "images" / "000000.png")
    return path, world


@pytest.fixture
def window(osmesa, avatar, capture, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_avatar(tmp_path / "a.glb", avatar)
    scene = scene_of(parse(PlayCommand, ["a.glb", "--capture", str(capture[0])], PLAY))
    window = Window(opened_show(scene, opened_avatars(scene)), size=(192, 256), null=True)
    try:
        window.run(["space", "home", "wait"])
        yield window
        assert window.screen.context.gl.error == "GL_NO_ERROR"
    finally:
        window.close()


def run(window, script):
    window.run(script.split(), keep=True)
    return window.parts.state.last.image[:230, :, :3].astype(int)  # without the line of text


def source(capture, frame):
    with Image.open(capture[0] / "body" / "images" / f"{frame:06d}.png") as image:
        return np.asarray(image.resize((192, 256), Image.Resampling.BILINEAR)).astype(int)[:230]


def test_the_avatar_lies_on_the_video_that_it_was_filmed_in(window, capture):
    """Each frame: the same silhouette within a pixel of the small picture, the video's green around."""
    for frame in range(FRAMES):
        window.parts.state.timeline.seek(frame)
        avatar = run(window, "wait")
        line = round(window.parts.wipe.line)
        assert abs(line - 96) <= 1
        video = source(capture, frame)
        right = np.abs(avatar - video)[:, line + 2 :]
        assert np.median(right) <= 3 and (right.max(-1) > 60).mean() < 0.03
        window.parts.wipe.behind = False
        plain = run(window, "wait")
        window.parts.wipe.behind = True
        green = (video == [0, 255, 0]).all(-1)
        inner = green[:, line + 6 :] & ~(np.abs(plain - [43, 45, 51]).max(-1) > 2)[:, line + 6 :]
        assert inner.sum() > 0.98 * green[:, line + 6 :].sum()  # the background where the video is hidden


def test_a_capture_is_filmed_with_its_poses_as_the_window_shows_it(capture):
    scene = Scene((SceneAvatar("mannequin", start=0.1),), (SceneCamera("capture", str(capture[0])),))
    stage, show = Stage(scene, 1), opened_show(scene, opened_avatars(scene))
    poses = read_video_poses(capture[0] / "body" / "poses.npz", FRAMES)
    assert stage.frames == show.playback.timeline.frames == FRAMES - 1
    for pose in (stage.poses(1)[0], show.playback.tracks[0].pose(0.1)):
        assert np.array_equal(pose.axis_angle, poses.axis_angle[2])


def test_the_wipe_parts_video_and_avatar_at_its_line(window, capture):
    window.parts.state.timeline.seek(1)
    window.parts.wipe.behind = False
    for part in (0.0, 0.25, 1.0):
        window.parts.wipe.move(part)
        image = run(window, "wait")
        line = round(part * 192)
        green = np.abs(image - [0, 255, 0]).max(-1) < 3
        assert not green[:, line + 1 :].any()
        if part:
            filmed = np.abs(source(capture, 1) - [0, 255, 0]).max(-1) < 3
            assert (green == filmed)[:, : line - 1].mean() > 0.97
    assert not (np.abs(image - [255, 204, 51]).max(-1) < 3).any()  # at either end there is no line


def test_beside_the_video_is_nothing_but_the_background(window):
    """A wide window: where the camera saw nothing, the avatar is not shown either."""
    glfw.set_window_size(window.screen.handle, 400, 256)
    window.parts.wipe.move(0.0)
    cameras = window.parts.viewpoint.cameras
    # near enough to fill more than the video
    nearer = [replace(one, K=one.K @ np.diag([4.0, 4.0, 1.0])) for one in cameras.capture.cameras]
    cameras.capture = replace(cameras.capture, cameras=nearer)
    window.run(["wait", "wait"], keep=True)
    image = window.parts.state.last.image[:230, :, :3].astype(int)
    left = round((400 - 192) / 2)
    assert (image[:, : left - 1] == [43, 45, 51]).all() and (image[:, left + 193 :] == [43, 45, 51]).all()
    assert (image[:, left + 2 : left + 190] != [43, 45, 51]).any()


def test_the_line_is_dragged_and_the_camera_is_the_film_s(window):
    before = window.parts.state.last.camera.camera_from_world
    run(window, "drag:96:100:150:120 wait")
    assert abs(window.parts.wipe.part - 150 / 192) < 0.01
    run(window, "drag:20:100:60:100 - - wait")
    assert abs(window.parts.wipe.part - 150 / 192 + 0.1) < 0.01
    assert np.array_equal(window.parts.state.last.camera.camera_from_world, before)
    moved = run(window, "c wait")  # another camera: no video
    assert window.parts.viewpoint.cameras.kind == "orbit" and not (np.abs(moved - [0, 255, 0]).max(-1) < 3).any()


def test_the_head_stands_before_the_t_pose_and_no_picture_is_named_when_shown(avatar, capture, copy):
    path, world = capture
    view = open_capture(path, "head")
    assert np.allclose(view.cameras[0].camera_from_world, world.camera_from_world, atol=1e-6)
    pose, root = view.poses.axis_angle[0], view.poses.root[0]
    head = joint_transforms(pose, avatar.joint_positions.astype(float), root)[15, :3, 3]
    assert np.allclose(project(view.cameras[0], head[None])[0], project(world, head[None])[0], atol=1e-3)
    (copy / "body/images/000000.png").write_bytes(b"nothing")
    Image.new("RGB", (5, 5)).save(copy / "body/images/000001.png")
    view = open_capture(copy)
    refused(AssetError, r"000000.png: expected a picture", view.image, 0)
    refused(AssetError, "should be 96x128 as its camera, is 5x5", view.image, 1)
    refused(AssetError, "part should be one of", open_capture, copy, "foot")


@pytest.fixture
def copy(capture, tmp_path):
    """The capture's folder, to be spoilt."""
    return Path(shutil.copytree(capture[0], tmp_path / "copy"))


def poses(poses):
    return lambda p: np.savez(p / "body/poses.npz", poses=poses, trans=np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: (p / "capture.json").write_text("[]"), "a JSON object"),
        (lambda p: (p / "capture.json").write_text('{"format": "x"}'), "expected a capture folder"),
        (lambda p: [f.unlink() for f in (p / "body/images").iterdir()], "expected pictures, found none"),
        (lambda p: (p / "body/images/000001.png").unlink(), "should hold 1 or 2 cameras, holds 3"),
        (poses(np.zeros((3, 72))), "should be .3, 156."),
        (poses(np.full((3, 156), np.nan)), "frame 0, joint 0"),
    ],
)
def test_captures_that_do_not_agree_are_refused(copy, spoil, message):
    spoil(copy)
    refused(AssetError, message, open_capture, copy)


def test_lens_distortion_is_undone_as_the_camera_says(context):
    """A picture whose pixels tell their own place, seen through a bent lens: each lands where `project` says."""
    size = (64, 48)
    columns, rows = np.meshgrid(np.arange(64), np.arange(48))
    image = np.dstack([4 * columns, 5 * rows, np.zeros_like(rows)]).astype(np.uint8)
    K = np.array([[60.0, 1.5, 30.0], [0, 58.0, 25.0], [0, 0, 1]])
    distortion = np.array([-0.25, 0.06, 0.004, -0.003, 0.01])
    camera = Camera(K, np.eye(4), size, distortion)
    picture = PictureLayer(context)
    picture.show(image, camera)
    target = context.gl.framebuffer([context.gl.renderbuffer(size, 4)])
    target.use()
    picture.draw((0.0, 0.0, 64.0, 48.0), size)
    shown = np.frombuffer(target.read(components=3), np.uint8).reshape(48, 64, 3)[::-1].astype(float)
    straight = Camera(K, np.eye(4), size)
    _, rays = pixel_rays(straight)
    places, _ = project(camera, rays)
    inside = ((places > 1) & (places < np.array(size) - 1)).all(1)
    expected = (places - 0.5) * [4, 5]
    worst = np.abs(shown.reshape(-1, 3)[inside, :2] - expected[inside]).max()
    assert inside.sum() > 2500 and worst < 1.5
    outside = ((places < -1) | (places > np.array(size) + 1)).any(1)
    assert (shown.reshape(-1, 3)[outside] == 0).all()
    attachment = target.color_attachments[0]
    target.release()
    attachment.release()
    picture.release()
