"""Every effect of a scene: wanted, it is what its plan names; hidden, small or still, the frame that never asked."""

from collections import Counter
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from loose_avatar import dance, danced

from avatar.camera import Camera, orbit_camera
from avatar.gltf.avatar_file import write_avatar
from command.settings import settings_of
from player.effects import avatar, contact, ground_plane, outline, secondary_motion, shadow
from player.effects.background import Background
from player.effects.contact import Contact
from player.effects.foot_lock import FootLock
from player.effects.grid import Grid
from player.effects.ground import Ground
from player.effects.lens import DepthOfField, MotionBlur
from player.effects.light import Light
from player.effects.outline import Outline
from player.effects.secondary_motion import SecondaryMotion
from player.film import parts
from player.film import render as filming
from player.film.command import render_main
from player.film.shot import Shot, ShotRenderer
from player.film.stage import Stage
from player.scene.effects import PLAIN, Effects
from player.scene.scene import Scene, SceneAvatar

SIZE = (150, 170)
OFF = replace(PLAIN, view="off")
WHITE = (1.0, 1.0, 1.0, 1.0)
CAMERA = orbit_camera((0, 0.8, 0), 3.4, 0.6, 0.35, SIZE)
AWAY = orbit_camera((0, 1.0, 10), 2.0, np.pi, 0.1, SIZE)
UP = orbit_camera((0, 9.0, 0), 3.0, 0.3, -0.9, SIZE)
FAR = orbit_camera((0, 0.8, 0), 200.0, 0.3, 0.3, SIZE)
EVERYTHING = replace(OFF, outline=Outline(), ground=Ground(), contact=Contact())


class Unseen(NamedTuple):
    """An effect where it cannot show: what --explain says of its rows, and what the frame has beside it."""

    wish: object
    camera: Camera
    rows: dict
    beside: Effects = OFF
    # the dance is over and the body stands as it was filmed
    rests: bool = False


# the GL objects that settings of each effect add to a bare frame
ADDS = {
    "light": (Light("lamps"), {"buffer": 3}),
    "ground": (Ground(), {"program": 4, "vertex_array": 4, "texture": 2, "framebuffer": 2}),
    "contact": (Contact(1.0), {"program": 3, "vertex_array": 3, "buffer": 4, "texture": 1, "framebuffer": 1}),
    "grid": (Grid(), {"program": 1, "vertex_array": 1}),
    "outline": (Outline(), {"program": 1, "buffer": 1, "vertex_array": 1}),
    "secondary_motion": (SecondaryMotion(), {"program": 1, "buffer": 2, "vertex_array": 1}),
    # what these do is done to poses and frames of films: test_ik.py, test_film.py
    "foot_lock": (FootLock(), {}),
    "motion_blur": (MotionBlur(), {}),
    "depth_of_field": (DepthOfField(), {}),
}
OF_FILMS = ("foot_lock", "motion_blur", "depth_of_field")
FLOOR, SHADOW = "ground: floor", ("ground: shadow", "ground: mask")
SWINGS = "avatar: secondary motion"
UNSEEN = {
    "ground hidden": Unseen(Ground("shadow"), AWAY, dict.fromkeys(SHADOW, shadow.SHADOW_AWAY)),
    "ground above": Unseen(
        Ground("checker"), UP, dict.fromkeys(SHADOW, shadow.SHADOW_AWAY) | {FLOOR: ground_plane.AWAY}
    ),
    "ground small": Unseen(Ground("shadow"), FAR, dict.fromkeys(SHADOW, shadow.SMALL)),
    "contact hidden": Unseen(Contact(), AWAY, {"contact: avatar on the ground": contact.AWAY}),
    "contact small": Unseen(Contact(), FAR, {"contact: avatar on the ground": contact.SMALL}),
    "grid hidden": Unseen(Grid(), UP, {"grid": ground_plane.AWAY}),
    "outline hidden": Unseen(Outline(), AWAY, {"outline": outline.NONE_IN_VIEW}),
    "view small": Unseen("network", FAR, {"avatar: view network": avatar.TOO_SMALL}),
    "swing hidden": Unseen(SecondaryMotion(), AWAY, {SWINGS: secondary_motion.OUT_OF_VIEW}, EVERYTHING),
    "swing small": Unseen(SecondaryMotion(), FAR, {SWINGS: secondary_motion.SMALL}, EVERYTHING),
    "swing still": Unseen(SecondaryMotion(), CAMERA, {SWINGS: secondary_motion.AT_REST}, EVERYTHING, rests=True),
}  # fmt: skip


def field_of(wish) -> str:
    return next((setting.name for setting in settings_of(Effects) if setting.table is type(wish)), "view")


def test_every_effect_has_its_rows_here():
    every = {setting.name for setting in settings_of(Effects) if setting.table is not None}
    assert {field_of(wish) for wish, _ in ADDS.values()} == every
    # light has tests of its own, of what changes nothing
    assert {field_of(case.wish) for case in UNSEEN.values()} == (every | {"view"}) - {*OF_FILMS, "light"}


@pytest.mark.parametrize("bare", [OFF, Effects("network", "dual_quaternion", "fxaa")], ids=["bare", "network"])
@pytest.mark.parametrize("name", ADDS)
def test_wanted_it_is_what_its_plan_names_and_off_frees_all(context, render, dressed_avatar, name, bare):
    wish, adds = ADDS[name]
    renderer = render(dressed_avatar, SIZE, effects=bare)
    pose = dance(0.7)
    before, objects, kept = renderer.draw([pose], CAMERA), context.counts.objects(), set(renderer.plan.kept)
    renderer.change(effects=replace(bare, **{field_of(wish): wish}))
    assert bare is not OFF or Counter(context.counts.objects()) - Counter(objects) == adds
    assert context.counts.objects() == renderer.plan.objects()
    assert context.counts.live_bytes == renderer.plan.bytes
    made = context.counts.calls["create"]
    danced(renderer)
    assert (renderer.draw([pose], CAMERA) != before).any() == (name not in OF_FILMS)
    assert context.counts.calls["create"] == made
    renderer.change(effects=bare)
    assert context.counts.objects() == objects and np.array_equal(renderer.draw([pose], CAMERA), before)
    assert set(renderer.plan.kept) == kept


@pytest.mark.parametrize("antialiasing", ["none", "fxaa", "msaa"])
@pytest.mark.parametrize("name", UNSEEN)
def test_where_it_cannot_show_it_is_the_frame_that_never_asked(context, render, dressed_avatar, name, antialiasing):
    case = UNSEEN[name]
    bare = replace(case.beside, antialiasing=antialiasing)
    images, calls = [], []
    for effects in (bare, replace(bare, **{field_of(case.wish): case.wish})):
        renderer = render(dressed_avatar, SIZE, effects=effects, background=WHITE)
        pose = (np.zeros((52, 3)), np.array([0, 0.95, 0])) if case.rests else danced(renderer)
        renderer.move([pose], 1.0)
        renderer.draw([pose], case.camera)
        before = context.counts.calls.copy()
        images.append(renderer.draw([pose], case.camera))
        calls.append(context.counts.calls - before)
    rows = {one.item.name: one.decision for one in renderer.drawn}
    assert {name: rows[name] for name in case.rows} == case.rows
    assert np.array_equal(*images)
    assert calls[0] == calls[1], "draws, copies, clears, uniforms and reads"


@pytest.mark.parametrize("name", [*ADDS, "view"])
def test_ten_kilometres_away_it_is_the_same_picture(render, dressed_avatar, name):
    wish = {"view": "vertex"} if name == "view" else {field_of(ADDS[name][0]): ADDS[name][0]}
    # whole steps of every size of texels that a shadow has
    shift = np.array([10_080.0, 0.0, -3360.0])
    moved = CAMERA.camera_from_world.copy()
    moved[:3, 3] -= moved[:3, :3] @ shift
    renderer = render(dressed_avatar, SIZE, effects=replace(OFF, **wish), background=WHITE)
    axis_angle, root = dance(0.7)
    here = renderer.draw([(axis_angle, root)], CAMERA).astype(int)
    there = renderer.draw([(axis_angle, root + shift)], Camera(CAMERA.K, moved, SIZE))
    change = np.abs(here - there).max(-1)
    assert (change > 1).sum() <= 3


REFUSED = [
    (Ground, {"direction": (1.0, 0.1, 0.0)}, "expected a lamp 15 degrees or more above the horizon"),
    (Ground, {"direction": (0.0, 0.0, 0.0)}, "expected a lamp 15 degrees"),
    (Ground, {"color": (0.2, 0.2, 0.2, 0.5)}, "color: expected an opaque color"),
    (Light, {"by": "lamps", "direction": (0.0, 0.0, 0.0)}, "direction: expected a direction"),
    (Light, {"by": "lamps", "ambient": 0.0, "strength": 0.0}, "ambient: expected some light"),
    (Light, {"by": "lamps", "path": "sky.hdr"}, "path: of panorama, not of lamps"),
    (Background, {"kind": "image"}, "background image needs a path"),
    (Background, {"kind": "color", "path": "x"}, "background color takes no path"),
]


@pytest.mark.parametrize(("effect", "settings", "message"), REFUSED)
def test_settings_that_cannot_be_are_refused(effect, settings, message):
    with pytest.raises(ValueError, match=message):
        effect(**settings)


def test_a_frame_follows_from_its_number_and_parts_of_a_film_are_the_film(tmp_path, monkeypatch, dressed_avatar):
    for module in (parts, filming):
        monkeypatch.setattr(module, "LENGTH", 2)
    path = str(tmp_path / "dressed.glb")
    write_avatar(path, dressed_avatar)
    # a lens takes time, and remembers nothing
    names = {field_of(wish) for wish, _ in ADDS.values()} - {"depth_of_field"}
    every = [word for name in sorted(names) for word in ("--effect", name)]
    base = [path, "--motion", "walking", "--frames", "20:24", "--size", "60x60", "--camera", "orbit", *every]
    render_main([*base, "-o", str(tmp_path / "whole")])
    render_main([*base, "--resume", "-o", str(tmp_path / "parts")])
    files = sorted((tmp_path / "whole").glob("*.png"))
    assert len(files) == 4
    for file in files:
        assert file.read_bytes() == (tmp_path / "parts" / file.name).read_bytes()
    # backwards, and with a shutter: the simulation goes on frame by frame, whatever is drawn of each
    for blur in (None, MotionBlur(samples=2)):
        effects = replace(OFF, secondary_motion=SecondaryMotion(), motion_blur=blur)
        shot = Shot(Scene((SceneAvatar(path, "walking"),), effects=effects), 0, 40, (60, 60), 30.0, None)
        drawn = ShotRenderer(replace(shot, fit=Stage(shot.scene, 1).fit(0, 40)))
        forwards = [drawn.draw(frame).copy() for frame in (24, 25, 30)]
        backwards = [drawn.draw(frame).copy() for frame in (30, 25, 24)][::-1]
        drawn.release()
        assert np.array_equal(forwards, backwards)
