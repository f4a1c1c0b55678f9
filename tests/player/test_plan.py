"""What no scene asks for is not compiled, allocated or run: counted where every GL call passes."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pictures import radiance_bytes, sky

from avatar.camera import orbit_camera
from command.errors import AssetError
from command.settings import settings_of
from player.draw import plan as plans
from player.effects.avatar import VIEWS
from player.effects.background import BACKGROUNDS, Background
from player.scene.effects import ANTIALIASINGS, PLAIN, SKINNINGS, Effects, resolve
from player.scene.renderer import Renderer

SIZE = (96, 80)
CAMERA = orbit_camera((0.1, 0, -0.2), 2.9, 0.5, 0.1, SIZE)
AWAY = orbit_camera((0, 0, 10), 2.0, np.pi, 0, SIZE)  # looks at nothing
EVERYTHING = Effects("network", "dual_quaternion", "fxaa")


def plan_is_what_lives(context, renderer, **others):
    """The one statement that all of this rests on. `others` are objects of the test itself."""
    live = Counter(context.counts.objects()) - Counter(others)
    assert live == renderer.plan.objects()
    bytes_of_others = 8 * renderer.size[0] * renderer.size[1] if others else 0
    planned = renderer.plan.bytes
    assert context.counts.live_bytes - bytes_of_others == planned


def test_a_panorama_is_evaluated_only_when_the_camera_turns(context, render, avatar, pose, backgrounds):
    renderer = render(avatar, SIZE, effects=Effects("off", antialiasing="none"), background=backgrounds["hdr"])

    def draws(camera):
        before = context.counts.calls["draw"]
        renderer.draw([pose], camera)
        return context.counts.calls["draw"] - before

    nearer = orbit_camera((0.1, 0, -0.2), 2.5, 0.5, 0.1, SIZE)  # same direction: the surroundings are far away
    turned = orbit_camera((0.1, 0, -0.2), 2.9, 0.6, 0.1, SIZE)
    assert [draws(camera) for camera in (CAMERA, CAMERA, nearer, turned, turned)] == [2, 1, 1, 2, 1]
    assert renderer.drawn[0].decision == plans.Decision(plans.PassState.KEPT, "the camera has not turned")


def test_another_panorama_of_the_same_size_is_another_texture(render, avatar, pose, backgrounds, tmp_path):
    (tmp_path / "night.hdr").write_bytes(radiance_bytes(0.05 * sky(64)))
    night = Background("hdr", path=str(tmp_path / "night.hdr"))
    renderer = render(avatar, SIZE, effects=Effects("off"), background=backgrounds["hdr"])
    day = renderer.draw([pose], AWAY)
    renderer.change(background=night)
    fresh = render(avatar, SIZE, effects=Effects("off"), background=night)
    assert np.array_equal(renderer.draw([pose], AWAY), fresh.draw([pose], AWAY))
    assert renderer.draw([pose], AWAY).mean() < day.mean() - 20


def test_a_background_that_cannot_be_read_and_a_view_that_the_avatar_lacks_change_nothing(
    context, render, avatar, pose, backgrounds, tmp_path
):
    (tmp_path / "broken.hdr").write_bytes(b"no panorama")
    broken = {"background": Background("hdr", path=str(tmp_path / "broken.hdr"))}
    lacking = {"effects": Effects("linear", antialiasing="none"), "background": backgrounds["hdr"]}
    for who, effects, change, error, said in (
        (avatar, Effects("off"), broken, AssetError, r"broken\.hdr"),
        (replace(avatar, linear=None), EVERYTHING, lacking, ValueError, "view linear is not in avatar"),
    ):
        renderer = render(who, SIZE, effects=effects, background=backgrounds["image"])
        before = renderer.draw([pose], CAMERA)
        with pytest.raises(error, match=said):
            renderer.change(**change)
        plan_is_what_lives(context, renderer)
        assert np.array_equal(renderer.draw([pose], CAMERA), before)
        renderer.release()


def test_a_film_stays_open_while_asked_for_and_is_uploaded_when_its_frame_changes(
    render, avatar, pose, backgrounds, monkeypatch, context
):
    renderer = render(avatar, SIZE, effects=PLAIN, background=backgrounds["video"])
    (behind,) = renderer.plan.kept.values()
    renderer.change(effects=EVERYTHING, size=(50, 40))
    assert behind in renderer.plan.kept.values()
    closed = []
    monkeypatch.setattr(behind, "close", lambda: closed.append(1))
    renderer.change(background=backgrounds["color"])
    assert closed == [1] and behind not in renderer.plan.kept.values()
    renderer = render(avatar, SIZE, effects=Effects("off", antialiasing="none"), background=backgrounds["video"])
    sent = []
    for seconds in (0.0, 0.02, 0.034, 0.05, 9.0, 0.0):
        before = context.counts.uploaded
        corner = renderer.draw([pose], CAMERA, seconds=seconds)[0, 0].tolist()
        sent.append((context.counts.uploaded - before > 4 * SIZE[0] * SIZE[1], corner[0]))
    assert sent == [(True, 40), (False, 40), (True, 200), (False, 200), (False, 200), (True, 40)]


@pytest.mark.parametrize("wish", [PLAIN, EVERYTHING, Effects("off", antialiasing="msaa")])
def test_another_size_compiles_nothing_and_is_as_if_made_so(context, render, avatar, pose, backgrounds, wish):
    renderer = render(avatar, SIZE, effects=wish, background=backgrounds["hdr"])
    renderer.draw([pose], CAMERA)
    programs, uploaded = set(context.counts.live["program"]), context.counts.uploaded
    renderer.resize((130, 111))
    plan_is_what_lives(context, renderer)
    assert context.counts.live["program"] == programs
    assert context.counts.uploaded - uploaded < 200_000, "meshes and textures stay where they are"
    image = renderer.draw([pose], CAMERA)
    fresh = render(avatar, (130, 111), effects=wish, background=backgrounds["hdr"])
    assert np.array_equal(image, fresh.draw([pose], CAMERA))


def test_the_level_of_detail_changes_in_place(render, pose, context, avatar):
    fine = avatar.levels[0]
    coarse = replace(fine, faces=fine.faces[::-1].copy(), base_color=fine.base_color[::2, ::2].copy())
    who = replace(avatar, levels=(fine, coarse))
    renderer = render(who, SIZE, effects=EVERYTHING)
    renderer.draw([pose], CAMERA)
    renderer.change(level=1)
    plan_is_what_lives(context, renderer)
    image = renderer.draw([pose], CAMERA)
    renderer.change(level=0)
    plan_is_what_lives(context, renderer)
    renderer.release()
    fresh = render(who, SIZE, effects=EVERYTHING, level=1)
    assert np.array_equal(image, fresh.draw([pose], CAMERA))


@pytest.mark.parametrize("antialiasing", ANTIALIASINGS)
def test_a_window_of_changing_size_shows_the_same_picture(context, render, avatar, pose, backgrounds, antialiasing):
    """A framebuffer that is not ours stands in for the window: rows count from below, its size may change."""
    wish = Effects("off", antialiasing=antialiasing)
    window = render(avatar, None, effects=wish, background=backgrounds["hdr"])
    for size in ((60, 50), SIZE):
        color, depth = context.gl.renderbuffer(size), context.gl.depth_renderbuffer(size)
        framebuffer = context.gl.framebuffer([color], depth)
        window.draw_into(framebuffer, [pose], CAMERA)  # fitted to the framebuffer
        plan_is_what_lives(context, window, framebuffer=1, renderbuffer=2)
        raw = np.frombuffer(framebuffer.read(components=4, alignment=1), np.uint8).reshape(*size[::-1], 4)[::-1]
        for thing in (framebuffer, color, depth):
            thing.release()
        own = render(avatar, size, effects=wish, background=backgrounds["hdr"])
        assert np.abs(raw.astype(int) - own.draw([pose], CAMERA.resized(size))).max() <= 1
        own.release()


def test_edges_are_smooth_unless_said_otherwise_or_without_samples(avatar):
    """auto: MSAA on a GPU; FXAA on a software rasteriser, and where samples are too few."""

    def runs(effects, *, software, samples=4):
        plan = resolve([avatar], plans.Canvas(SIZE, software=software, max_samples=samples), effects)
        return {item.name for item in plan.filters}

    assert runs(Effects(), software=True) == {"antialiasing: fxaa"}
    assert runs(Effects(), software=False) == {"antialiasing: msaa"}
    assert runs(Effects(), software=False, samples=1) == {"antialiasing: fxaa"}
    assert runs(PLAIN, software=False) == runs(Effects(antialiasing="none"), software=True) == set()
    canvas = plans.Canvas(SIZE, max_samples=1)
    asked = resolve([avatar], canvas, Effects("off", antialiasing="msaa"))
    plain = resolve([avatar], canvas, Effects("off", antialiasing="none"))
    assert set(asked.handles) == set(plain.handles)
    assert plans.Absent("antialiasing", "the device has 1 samples a pixel, 4 are needed") in asked.passes


EVERY = {setting.name: setting.table for setting in settings_of(Effects) if setting.table is not None}


@settings(max_examples=12, derandomize=True, deadline=None, database=None)
@given(
    asked=st.sets(st.sampled_from(sorted(EVERY))),
    view=st.sampled_from(VIEWS),
    skinning=st.sampled_from(SKINNINGS),
    antialiasing=st.sampled_from(ANTIALIASINGS),
    kind=st.sampled_from(BACKGROUNDS),
)
@example(set(EVERY), "network", "dual_quaternion", "fxaa", "color")
@example(set(EVERY), "linear", "lbs", "msaa", "hdr")
@example(set(), "vertex", "lbs", "auto", "image")
@example(set(), "off", "dual_quaternion", "none", "video")
@example(set(), "auto", "lbs", "fxaa", "transparent")
def test_any_subset_of_effects_is_its_plan_and_nothing_where_it_cannot_show(
    context, avatar, pose, backgrounds, asked, view, skinning, antialiasing, kind
):
    """Objects alive are what the plan names, a frame makes none; looking away is the bare frame with its calls; off
    frees all."""
    bare = Effects("off", skinning, "none")
    wish = replace(bare, view=view, antialiasing=antialiasing, **{name: EVERY[name]() for name in asked})
    renderer = Renderer(context, [avatar], (48, 40), effects=bare, background=backgrounds[kind])
    try:
        objects, plain = context.counts.objects(), renderer.draw([pose], CAMERA)
        renderer.draw([pose], AWAY)
        before = context.counts.calls.copy()
        nothing = renderer.draw([pose], AWAY)
        calls = context.counts.calls - before
        renderer.change(effects=wish)
        plan_is_what_lives(context, renderer)
        made = context.counts.calls["create"]
        renderer.draw([pose], CAMERA)
        renderer.draw([pose], AWAY)
        before = context.counts.calls.copy()
        assert np.array_equal(renderer.draw([pose], AWAY), nothing)
        assert context.counts.calls - before == calls and context.counts.calls["create"] == made
        assert kind != "color" or calls["draw"] == 0
        rows = {one.item.name: one.decision for one in renderer.drawn}
        assert not [name for name, decision in rows.items() if decision.runs and name != "background"]
        assert rows["avatar: paper"].why == "out of view"
        assert antialiasing in ("none", "auto") or rows[f"antialiasing: {antialiasing}"].why == "no avatar in view"
        renderer.change(effects=bare)
        assert context.counts.objects() == objects and np.array_equal(renderer.draw([pose], CAMERA), plain)
    finally:
        renderer.release()
    assert context.counts.objects() == {} and context.gl.error == "GL_NO_ERROR"
