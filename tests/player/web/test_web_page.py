"""The page of `selfscan web` in a headless browser: the same picture as `selfscan render`, and nobody is asked."""

import math
from dataclasses import replace

import numpy as np
import pytest
from browser_page import browser_page
from chromium import chromium
from faced_avatar import doing, faced
from interchange.test_export import decibels, painted

from avatar.camera import orbit_camera, project
from avatar.motion.clip import Motion
from experiments.glsl_rewrites import REWRITES, Plan, rewriting
from player.budget.rung import Rung
from player.draw.drawing import Pose
from player.draw.posing import posed_vertices
from player.gl.context import open_context
from player.scene.effects import STUDIO
from player.scene.renderer import Renderer
from player.web.page import MOST_BYTES
from player.web_command import write_page

pytestmark = pytest.mark.slow

SIZE = (640, 640)
PLACE = np.array([0.0, -0.1, 0.0])
FROM = {"distance": 2.6, "azimuth": 0.3, "elevation": 0.1}
VIEWS = ["off", "vertex", "linear", "network"]


def two_poses(bent):
    """T-pose, then bent."""
    poses = [(np.zeros((52, 3)), np.zeros(3)), bent]

    def block(start, stop):
        return np.stack([p for p, _ in poses[start:stop]]), np.stack([r for _, r in poses[start:stop]])

    return poses, Motion("two poses", 2, 2.0, (), block)


@pytest.fixture(scope="module")
def page(tmp_path_factory, pose):
    """A page of the built-in body in soft stripes with a random network, and a browser."""
    chromium()
    folder = tmp_path_factory.mktemp("web")
    avatar, (poses, motion) = painted(), two_poses(pose)
    write_page(folder / "me.html", avatar, motion, 0, 2, "A & B </script>")
    (folder / "profile").mkdir()
    with browser_page(folder / "profile") as tab:
        yield tab, folder / "me.html", avatar, poses


def settings(**more):
    words = FROM | dict(zip("xyz", PLACE, strict=True)) | {"size": "640x640", "play": 0, "edges": 0} | more
    return "&".join(f"{name}={value}" for name, value in words.items())


def rendered(avatar, pose, view, place=PLACE, distance=FROM["distance"]):
    camera = orbit_camera(place, *(FROM | {"distance": distance}).values(), SIZE, np.radians(35.0))
    context = open_context()
    try:
        renderer = Renderer(context, [avatar], SIZE, view=view, background=STUDIO.color)
        picture = renderer.draw([pose], camera)[..., :3].copy()
        renderer.release()
        return picture
    finally:
        context.release()


def test_the_page_draws_the_frames_of_render_in_every_view_mode(page):
    tab, path, avatar, poses = page
    drawn = {}
    for frame, view in [(1, view) for view in VIEWS] + [(0, "network")]:
        tab.open(path, settings(view=view, frame=frame))
        theirs, ours = tab.frame(), rendered(avatar, poses[frame], view)
        everywhere = np.ones(SIZE, bool)
        # what is left are outlines: this browser's rasteriser knows sixteenths of a pixel, ours 256ths
        assert decibels(ours, theirs, everywhere) >= 45
        assert (np.abs(ours.astype(int) - theirs).max(-1) > 2).mean() < 1e-3
        drawn[frame, view] = theirs
    # the measure tells modes apart, and poses
    for view in ("off", "linear"):
        assert decibels(drawn[1, "network"], drawn[1, view], everywhere) < 35
    assert decibels(drawn[1, "network"], drawn[0, "network"], everywhere) < 20
    assert tab.problems == []


def test_rewritten_shaders_draw_the_same_page(page, tmp_path):
    tab, path, avatar, poses = page
    with rewriting(Plan(tuple(REWRITES), seed=4)) as plan:
        write_page(tmp_path / "rewritten.html", avatar, two_poses(poses[1])[1], 0, 2, "Rewritten")
    assert plan.sites
    for view in VIEWS:
        pictures = []
        for one in (path, tmp_path / "rewritten.html"):
            tab.open(one, settings(view=view, frame=1))
            pictures.append(tab.frame().astype(int))
        assert np.abs(pictures[0] - pictures[1]).max() <= 1
    assert tab.problems == []


def test_a_face_moves_as_render_moves_it_and_a_level_without_one_stays_still(page, tmp_path):
    tab, *_ = page
    level = replace(faced().levels[0], base_color=painted().levels[0].base_color)
    avatar = replace(faced(), levels=(level, replace(painted().levels[0], features=None)))
    faces = [doing(), doing((0.3, -0.2), jawOpen=0.7, eyeBlinkLeft=0.9, eyeWideLeft=1.0)]
    motion = replace(two_poses((np.zeros((52, 3)), np.zeros(3)))[1], faces=lambda start, stop: (
        np.stack([face.weights for face in faces[start:stop]]), np.stack([face.gaze for face in faces[start:stop]])
    ))  # fmt: skip
    write_page(tmp_path / "face.html", avatar, motion, 0, 2, "Face")
    place, everywhere, drawn = avatar.eyes[0].center * [0, 1, 1], np.ones(SIZE, bool), []
    for frame, face in enumerate(faces):
        words = settings(view="vertex", frame=frame, distance=0.7, **dict(zip("xyz", place, strict=True)))
        tab.open(tmp_path / "face.html", words)
        drawn.append(tab.frame())
        ours = rendered(avatar, Pose(np.zeros((52, 3)), np.zeros(3), face), "vertex", place, 0.7)
        assert decibels(ours, drawn[-1], everywhere) >= 45
    # the measure tells a moving face from one at rest
    assert decibels(drawn[0], drawn[1], everywhere) < 35
    tab.open(tmp_path / "face.html", words + "&level=1")
    still = replace(avatar, levels=avatar.levels[1:], eyes=None)
    ours = rendered(still, Pose(np.zeros((52, 3)), np.zeros(3)), "off", place, 0.7)
    assert decibels(ours, tab.frame(), everywhere) >= 45
    assert tab.problems == []


def test_the_page_draws_fewer_joints_and_smaller_textures_as_render_draws_such_a_rung(page):
    tab, path, avatar, poses = page
    whole = rendered(avatar, poses[1], "network")
    everywhere = np.ones(SIZE, bool)
    for changed in ({"joints": 2}, {"joints": 1}, {"halvings": 2}, {"joints": 1, "halvings": 2}):
        tab.open(path, settings(view="network", frame=1, **changed))
        theirs = tab.frame()
        (prepared,) = Rung("", "network", **changed).prepared([avatar])
        assert decibels(rendered(prepared, poses[1], "network"), theirs, everywhere) >= 45, changed
        # the measure tells the rung from the best one
        assert decibels(whole, theirs, everywhere) < 40, changed
    assert tab.problems == []


def test_nothing_is_asked_of_anyone(page):
    tab, path, *_ = page
    tab.open(path)
    tab.wait("selfscan.settings.frame > 0")
    assert tab.requests == [path.as_uri()]
    # and nothing can be: the page's own policy forbids it
    assert tab.ask("fetch('http://127.0.0.1:9/').then(() => 'asked', () => 'refused')") == "refused"
    assert any("Content Security Policy" in problem for problem in tab.problems)
    tab.problems.clear()


def test_it_plays_and_the_url_holds_what_is_shown(page):
    tab, path, *_ = page
    tab.open(path)
    assert tab.ask("selfscan.settings.play") is True
    tab.wait("selfscan.settings.frame > 0.2")
    tab.ask("selfscan.set({ play: false, frame: 1, view: 'linear', edges: false })")
    tab.ask("selfscan.orbit.turn(40, 10)")
    tab.wait("location.hash.includes('view=linear') && location.hash.includes('azimuth')")
    shown, link = tab.frame(), tab.ask("location.hash.slice(1)")
    tab.open(path, link)
    assert decibels(shown, tab.frame(), np.ones(shown.shape[:2], bool)) >= 50
    assert tab.ask("[selfscan.settings.view, selfscan.settings.frame, selfscan.settings.play]") == ["linear", 1, False]


def test_keys_and_fingers_move_it(page):
    tab, path, *_ = page
    tab.open(path, settings(frame=0))
    for key, code in ((".", "Period"), ("v", "KeyV")):
        for kind in ("keyDown", "keyUp"):
            tab.call("Input.dispatchKeyEvent", type=kind, key=key, code=code)
    assert tab.ask("[selfscan.settings.frame, selfscan.settings.view]") == [1, "off"]
    before = tab.ask("selfscan.camera")
    for kind, points in (
        ("touchStart", [(200, 200), (300, 200)]), ("touchMove", [(150, 200), (350, 200)]), ("touchEnd", []),
    ):  # fmt: skip
        tab.call("Input.dispatchTouchEvent", type=kind,
                 touchPoints=[{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(points)])  # fmt: skip
    tab.wait(f"selfscan.camera.distance < {0.6 * before['distance']}")
    assert tab.ask("selfscan.camera.azimuth") == pytest.approx(before["azimuth"])


def on_a_phone(tab, path, size):
    """The canvas's size, and the camera of each of two frames."""
    tab.call("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=2, mobile=True)
    tab.open(path, "play=0")
    shown = tab.ask("[selfscan.canvas.clientWidth, selfscan.canvas.clientHeight]")
    cameras = [tab.ask(f"selfscan.set({{ frame: {k} }}), selfscan.camera") for k in range(2)]
    tab.call("Emulation.clearDeviceMetricsOverride")
    return shown, cameras


def test_a_phone_held_upright_follows_who_walks(page, pose, tmp_path):
    tab, _, avatar, _ = page
    (_, (_, last)), motion = two_poses((pose[0], pose[1] + [2.0, 0.0, 1.0]))
    write_page(tmp_path / "walk.html", avatar, motion, 0, 2, "walk")
    for size, moved in (((390, 844), [last[0], 0, last[2]]), ((844, 390), [0, 0, 0])):
        first, second = (camera["target"] for camera in on_a_phone(tab, tmp_path / "walk.html", size)[1])
        np.testing.assert_allclose(np.subtract(second, first), moved, atol=1e-3)


@pytest.mark.parametrize("size", [(390, 844), (320, 568), (844, 390)])
def test_on_a_phone_the_whole_person_is_in_sight_in_most_of_the_screen(page, size):
    tab, path, avatar, poses = page
    shown, cameras = on_a_phone(tab, path, size)
    assert shown[0] == size[0] and shown[1] > 0.7 * size[1]
    seen = []
    for camera, pose in zip(cameras, poses, strict=True):
        view = [camera[name] for name in ("target", "distance", "azimuth", "elevation")]
        view = orbit_camera(*view, tuple(shown), camera["fov"])
        seen.append(project(view, posed_vertices(avatar, avatar.levels[0], pose))[0])
    margins = np.concatenate(seen) / shown
    assert margins.min() > 0.04 and margins.max() < 0.96
    # as near as that allows
    assert np.ptp(margins, axis=0).max() > 0.8


def test_a_lost_context_comes_back(page):
    tab, path, *_ = page
    tab.open(path, settings(view="network", frame=1))
    shown = tab.frame()
    tab.ask("(window.lost = selfscan.drawing.gl.getExtension('WEBGL_lose_context')).loseContext()")
    tab.wait("selfscan.drawing.gl.isContextLost()")
    tab.ask("lost.restoreContext()")
    tab.wait("!selfscan.drawing.gl.isContextLost() && !selfscan.dirty && selfscan.drawing.made.size > 3")
    assert np.array_equal(shown, tab.frame())


def test_the_title_holds_and_the_first_picture_is_timed(page):
    tab, path, *_ = page
    tab.open(path)
    assert tab.ask("document.title") == "A & B </script>"
    assert path.stat().st_size < MOST_BYTES
    timing = tab.ask("selfscan.drawing.timing")
    assert 0 < timing["first"] <= timing["whole"]
    # halves go up, as Math.round takes them
    first, whole = (math.floor(timing[key] + 0.5) for key in ("first", "whole"))
    steps = "" if timing["first"] == timing["whole"] else f", whole after {whole} ms"
    told = f"first picture after {first} ms{steps}, drawn by"
    assert told in tab.ask("document.getElementById('facts').textContent")
    tab.wait("document.getElementById('price').textContent.includes('ms a frame here')")
