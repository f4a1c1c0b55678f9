"""The panels in the whole window program, on glfw's null platform with OSMesa; scripts press widgets by name."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from command.settings import OneOf, rule_of, settings_of
from experiments.scene_docs import DOCS

pytest.importorskip("imgui_bundle", reason="the extra gui is not installed")

import glfw  # before imgui_bundle
from imgui_bundle import imgui

from player.draw.drawing import Pose
from player.effects.background import Background
from player.effects.foot_lock import FootLock
from player.effects.lens import DepthOfField, MotionBlur
from player.effects.light import Light
from player.effects.outline import Outline
from player.live.inbox import Inbox
from player.live.json_pose import build_pose
from player.live.playback import LivePlayback
from player.scene.address import Address
from player.scene.effects import PLAIN, STUDIO, Effects
from player.window import recorder, viewpoint
from player.window.budgeted import NO_LIGHT, NOT_LOOSE
from player.window.looks import BOARDS, LOOKS, SPOTLIGHT
from player.window.panels.draw import DrawLists
from player.window.panels.effects_panel import IN_FILMS
from player.window.panels.widgets import Widgets
from tests.window_script import picture, run

SIZE = (900, 640)


def choose(window, name, number):
    """One of the words of a list."""
    run(window, f"press:{name} wait")
    x, y = window.panels.places[name.replace("_", " ")]
    return run(window, f"click:{x}:{y + 26 + 19 * number} wait wait")


def test_panels_stand_around_the_picture_and_g_hides_them(window):
    with_panels = run(window, "wait")
    left, top, width, height = window.parts.state.layout.area
    assert left > 200 and width > 400 and height > 400
    assert {"play", "scrub", "avatar 0", "camera", "studio", "screenshot"} <= window.panels.places.keys()
    assert "T-pose" not in window.panels.places  # nothing live
    column = with_panels[: top + height, : left - 2]
    assert len(np.unique(column.reshape(-1, 3), axis=0)) > 50  # letters and widgets
    figure = (picture(window, with_panels) != picture(window, with_panels)[2, 2]).any(-1)
    rows, columns = figure[40:].nonzero()
    assert columns.min() > 5 and columns.max() < width - 5  # the avatar is in the free part
    without = run(window, "g wait")
    assert window.parts.state.layout.area == (0, 0, *SIZE)
    assert (without[: SIZE[1] - 40, :200] == without[0, 0]).all()
    assert np.array_equal(picture(window, run(window, "g wait"))[40:], picture(window, with_panels)[40:])


def test_tab_selects_an_avatar_and_a_widget_not_shown_is_named(window):
    run(window, "tab wait wait wait")
    assert window.parts.state.layout.panels_drawn
    with pytest.raises(ValueError, match=r"no widget 'fly' is shown; there are .*play"):
        run(window, "press:fly")
    # g is still a key of the window, no letter in a text field
    run(window, "g wait")
    assert not window.parts.state.layout.panels_drawn


def test_the_long_slider_scrubs_and_lists_open_over_the_picture(window):
    x, y = window.panels.places["scrub"]
    run(window, f"drag:{x - 200}:{y}:{x}:{y}")
    middle = window.parts.state.timeline.frame
    assert abs(middle - window.parts.state.timeline.frames / 2) < 5
    run(window, f"drag:{x}:{y}:{x + 5000}:{y}")
    assert window.parts.state.timeline.frame == window.parts.state.timeline.frames - 1
    orbit = window.parts.viewpoint.cameras.orbit
    assert orbit.azimuth == orbit.home[2]  # the camera did not turn along
    run(window, "press:speed wait")
    x, y = window.panels.places["speed"]
    run(window, f"click:{x}:{y - 30} wait")
    assert window.parts.state.timeline.speed != 1
    run(window, "press:camera wait")
    x, y = window.panels.places["camera"]
    run(window, f"click:{x}:{y + 46} wait")
    assert window.parts.viewpoint.cameras.kind == "turntable"


def test_a_place_is_typed_and_the_avatar_goes_there(window):
    before = picture(window, run(window, "press:place_and_start wait"))
    x, y = window.panels.places["turn"]
    run(window, f"drag:{x}:{y}:{x + 40}:{y}")
    assert 20 < np.degrees(window.parts.state.playback.tracks[0].turn) < 180
    # control and click turn a slider into a field; letters there are no keys
    left, y = x - 60, window.panels.places["place"][1]
    window.on_key(glfw.KEY_LEFT_CONTROL, True)
    run(window, f"click:{left}:{y}")
    window.on_key(glfw.KEY_LEFT_CONTROL, False)
    run(window, "wait type:1.5 q wait enter wait")
    assert np.isclose(window.parts.state.playback.tracks[0].at[0], 1.5) and not window.parts.closing
    assert not np.array_equal(picture(window, run(window, "wait")), before)
    # control and v paste; the view stays on
    glfw.set_clipboard_string(None, "-2.25")
    window.on_key(glfw.KEY_LEFT_CONTROL, True)
    run(window, f"click:{left}:{y} wait v wait")
    window.on_key(glfw.KEY_LEFT_CONTROL, False)
    run(window, "enter wait")
    assert np.isclose(window.parts.state.playback.tracks[0].at[0], -2.25)
    assert window.parts.look.renderer.view_amount == 1


def test_clicking_the_avatar_marks_the_joint(window):
    left, top, width, height = window.parts.state.layout.area
    image = picture(window, run(window, "wait"))[60:]
    rows, columns = (image != image[0, 0]).any(-1).nonzero()
    x, y = left + columns[rows < rows.min() + 20].mean(), 60 + rows.min() + 20
    marked = picture(window, run(window, f"click:{x}:{y} wait"))
    assert window.parts.state.selection.name == "someone: head"
    yellow = (np.abs(marked - [255, 204, 51]).max(-1) < 12).nonzero()
    assert len(yellow[0]) > 30 and abs(yellow[0].mean() - y) < 40
    # a drag picks nothing, a click beside lets go
    run(window, f"drag:{left + 20}:{top + 80}:{left + 30}:{top + 80} wait")
    assert window.parts.state.selection.name == "someone: head"
    run(window, f"click:{left + 20}:{top + 80} wait")
    assert window.parts.state.selection.name == "someone"


def test_effects_change_what_is_drawn_and_what_cannot_be_is_said(window, capsys):
    smooth = picture(window, run(window, "wait"))[60:]
    plain = picture(window, choose(window, "antialiasing", 1))[60:]
    assert window.parts.look.effects.antialiasing == window.parts.look.renderer.effects.antialiasing == "none"
    changed = (plain != smooth).any(-1)
    assert 20 < changed.sum() < 0.2 * (plain != plain[0, 0]).any(-1).sum()  # contours and edges of the paint
    before = window.parts.look.renderer
    window.parts.look.change(background=Background("image", path="absent.png"))
    assert "absent.png" in capsys.readouterr().out and window.parts.look.renderer is before
    assert np.array_equal(picture(window, run(window, "wait"))[60:], plain)


def test_an_effect_is_chosen_by_a_word_and_its_numbers_unfold(window):
    def drawn():
        return [item.item.name for item in window.parts.look.renderer.drawn if item.decision.runs]

    run(window, "wait")
    assert "outline" not in drawn() and "outline width" not in window.panels.places
    assert "outline numbers" not in window.panels.places
    choose(window, "outline", 2)
    assert window.parts.look.effects.outline == Outline() and "outline" in drawn()
    run(window, "press:outline_numbers wait")
    assert {"outline color", "outline width"} <= set(window.panels.places)
    choose(window, "outline", 0)
    assert window.parts.look.effects.outline is None and "outline" not in drawn()


def test_a_look_sets_light_floor_edges_and_background_and_is_marked(window):
    pictures = [picture(window, run(window, f"press:{name.lower()} wait"))[60:] for name in LOOKS]
    for image, look in zip(pictures, LOOKS.values(), strict=True):
        assert np.abs(image[0, 0] / 255 - look.background.color[:3]).max() < 0.01
    effects = window.parts.look.effects
    assert (effects.light, effects.ground) == (SPOTLIGHT, BOARDS) and effects.contact is not None
    window.parts.look.change(background=Background("hdr", path=str(DOCS / "scenes" / "sky.hdr")))
    run(window, "press:outdoors wait")
    assert window.parts.look.background.kind == "hdr" and window.parts.look.effects.light == Light(by="panorama")
    run(window, "press:studio wait")
    assert window.parts.look.background == STUDIO and window.parts.look.effects.light is None


def test_what_each_effect_costs_stands_beside_it_until_something_changes(window):
    wanted = replace(PLAIN, antialiasing="fxaa", outline=Outline(), motion_blur=MotionBlur())
    window.parts.look.change(effects=wanted)
    prices, before = window.parts.prices, run(window, "g wait")
    run(window, "g press:Avatars press:More wait press:prices wait wait wait wait wait wait")
    told = {name: prices.words(name, wanted) for name in ("outline", "antialiasing", "motion_blur", "contact")}
    # the window draws each moment once; what is not asked for has its price before it is ticked
    assert all(words.endswith(" ms") and float(words[:-3]) >= 0 for words in told.values())
    assert prices.words("secondary_motion", wanted) == ""
    assert np.array_equal(run(window, "g wait")[:-30], before[:-30])
    window.parts.look.change(effects=replace(wanted, outline=None))
    assert prices.words("antialiasing", window.parts.look.effects) == ""


@pytest.mark.parametrize("setting", [s for s in settings_of(Effects) if s.table is not None], ids=lambda s: s.name)
def test_each_effect_has_a_row_for_each_of_its_settings(window, setting):
    window.parts.look.change(effects=replace(PLAIN, **{setting.name: setting.table()}))
    run(window, "press:Avatars press:Camera press:More wait wait")
    window.on_pointer(*window.panels.places[f"{setting.name} numbers"])
    window.on_button(0, True)
    run(window, "wait")
    window.on_button(0, False)
    run(window, "wait wait")
    texts = {inner.name for inner in settings_of(setting.table) if inner.type is str and not rule_of(inner, OneOf)}
    rows = {f"{setting.name} {inner.name}" for inner in settings_of(setting.table) if inner.name not in texts}
    assert rows <= set(window.panels.places)
    # with its label each ends before the panel does
    left = window.parts.state.layout.area[0]
    boxes = window.panels.ui.boxes
    assert max(boxes[name][2] for name in boxes if boxes[name][0] < left and boxes[name][1] < 500) < left - 8


def test_a_film_has_the_picture_without_panels(window, tmp_path):
    import av

    run(window, "press:film wait wait press:film wait")
    with av.open(str(tmp_path / "selfscan-000.mp4")) as film:
        frame = next(film.decode(video=0)).to_ndarray(format="rgb24")
    _, _, width, height = window.parts.state.layout.area
    assert frame.shape[:2] == (height + height % 2, width + width % 2)
    assert np.abs(frame[:30, -200:].astype(int) - frame[2, 2]).max() < 8  # no frame rate in the corner


@pytest.mark.parametrize("keys", ["s wait", "o wait wait", "k j wait"])
def test_what_cannot_be_written_is_said_and_the_window_stays(window, monkeypatch, keys):
    for module in (recorder, viewpoint):
        monkeypatch.setattr(module, "free_name", lambda stem, suffix: Path("absent", stem + suffix))
    run(window, keys)
    for _ in range(100):
        # its thread may find out some frames later
        if window.parts.recorder.film is not None:
            run(window, "wait")
    assert "there is no folder" in window.parts.state.messages.last
    assert not window.parts.recorder.wants_picture and not window.parts.closing


def test_small_windows_have_no_panels_but_the_line_of_text(window):
    image = run(window, "size:300:200 wait wait")
    assert image.shape == (200, 300, 3) and window.parts.state.layout.area == (0, 0, 300, 200)
    assert (image[185:, :40] != image[0, 0]).any()
    assert picture(window, run(window, f"size:{SIZE[0]}:{SIZE[1]} wait wait")).shape[1] < SIZE[0]


# -- drawing alone


@pytest.fixture
def imgui_context():
    context = imgui.create_context()
    imgui.set_current_context(context)
    io = imgui.get_io()
    io.set_ini_filename("")
    io.backend_flags |= imgui.BackendFlags_.renderer_has_textures
    yield io
    imgui.set_current_context(context)
    imgui.destroy_context(context)


def drawn_lists(context, io, lists, scale, show, frames=3):
    size = (200 * scale, 120 * scale)
    target = context.gl.framebuffer([context.gl.renderbuffer(size, 4)])
    io.display_size = imgui.ImVec2(200, 120)
    io.display_framebuffer_scale = imgui.ImVec2(scale, scale)
    for _ in range(frames):
        io.delta_time = 1 / 60
        imgui.new_frame()
        show()
        imgui.render()
        target.clear(0.2, 0.4, 0.6, 1.0)
        lists.draw(imgui.get_draw_data(), target, size)
    image = np.frombuffer(target.read(components=4), np.uint8).reshape(size[1], size[0], 4)[::-1].astype(int)
    attachments = target.color_attachments
    target.release()
    for attachment in attachments:
        attachment.release()
    return image


def test_colours_clips_and_places_are_exact(context, imgui_context):
    """A rectangle of one colour, half of it clipped away; alpha blends; the target stays opaque."""

    def show():
        draw = imgui.get_background_draw_list()
        draw.push_clip_rect(imgui.ImVec2(0, 0), imgui.ImVec2(60, 120))
        draw.add_rect_filled(imgui.ImVec2(20, 10), imgui.ImVec2(100, 50), imgui.IM_COL32(255, 128, 0, 255))
        draw.pop_clip_rect()
        draw.add_rect_filled(imgui.ImVec2(120, 10), imgui.ImVec2(140, 50), imgui.IM_COL32(255, 255, 255, 51))

    lists = DrawLists(context)
    for scale in (1, 2):  # a screen of double density has the same picture in twice the pixels
        image = drawn_lists(context, imgui_context, lists, scale, show)[::scale, ::scale]
        expected = np.tile([51, 102, 153, 255], (120, 200, 1))
        expected[10:50, 20:60, :3] = [255, 128, 0]
        expected[10:50, 120:140, :3] = [92, 133, 173]
        assert np.abs(image - expected).max() <= 1
    lists.release()


def test_letters_are_added_to_the_texture_when_they_are_first_shown(context, imgui_context):
    lists = DrawLists(context)
    images, uploaded = [], []
    for text in ("abc", "WXYZ"):
        images.append(drawn_lists(context, imgui_context, lists, 1, lambda: imgui.get_background_draw_list().add_text(
            imgui.ImVec2(10, 10), imgui.IM_COL32(255, 255, 255, 255), text)))  # fmt: skip
        uploaded.append(context.counts.uploaded)
        assert ((images[-1][..., 0] > 200).sum() > 10) and (images[-1][40:] == images[-1][0, 0]).all()
    assert uploaded[1] > uploaded[0] and not np.array_equal(*images)
    assert len(lists.textures) == 1
    lists.release()
    assert lists.textures == {}


def test_thousands_of_triangles_make_the_buffers_grow(context, imgui_context):
    def show():
        draw = imgui.get_background_draw_list()
        for n in range(9000):  # past 65536 vertices the indices need 32 bits
            x, y = n % 200, (n // 200) % 120
            draw.add_rect_filled(imgui.ImVec2(x, y), imgui.ImVec2(x + 1, y + 1), imgui.IM_COL32(n % 256, 0, 0, 255))
            draw.add_rect_filled(imgui.ImVec2(x, y), imgui.ImVec2(x + 1, y + 1), imgui.IM_COL32(n % 256, 7, 0, 255))

    lists = DrawLists(context)
    image = drawn_lists(context, imgui_context, lists, 1, show, frames=1)
    n = np.arange(9000)
    assert np.array_equal(image[n // 200, n % 200, 0], n % 256) and (image[:45, :, 1] == 7).all()
    lists.release()


# -- screens of high density, live poses


@pytest.mark.parametrize("system", ["units", "pixels"])
def test_on_a_screen_of_double_density_everything_is_twice_as_large_in_pixels(open_window, system, monkeypatch):
    """macOS counts windows in units of two pixels; X11 and Windows in pixels, and say that text is twice as large."""
    real = glfw.get_window_size
    monkeypatch.setattr(glfw, "get_window_content_scale", lambda handle: (2.0, 2.0))
    if system == "units":
        monkeypatch.setattr(glfw, "get_window_size", lambda handle: tuple(n // 2 for n in real(handle)))
    window = open_window(size=(2 * SIZE[0], 2 * SIZE[1]))
    image = run(window, "space home wait")
    area, marks = window.parts.state.layout.area, dict(window.panels.places)
    monkeypatch.undo()
    plain = open_window()
    small = run(plain, "space home wait")
    assert np.abs(np.array(area) - 2 * np.array(plain.parts.state.layout.area)).max() <= 1
    left, _, width, height = plain.parts.state.layout.area
    for name, (x, y) in plain.panels.places.items():
        factor = 1 if system == "units" else 2
        a, b = marks[name]
        assert abs(a / factor - x) < 4 and abs(b / factor - y) < 8, name
    half = image.reshape(SIZE[1], 2, SIZE[0], 2, 3).mean((1, 3))
    # the avatar is at the same place of the screen
    assert (np.abs(half - small)[40:height, left:].max(-1) > 40).mean() < 0.02


def test_a_click_on_a_dense_screen_picks_what_is_under_it(open_window, monkeypatch):
    real, window = glfw.get_window_size, open_window()
    image = picture(window, run(window, "space home g wait"))
    rows, columns = (image != image[0, 0]).any(-1).nonzero()
    x, y = columns[rows < rows.min() + 20].mean(), rows.min() + 20
    monkeypatch.setattr(glfw, "get_window_size", lambda handle: tuple(n // 2 for n in real(handle)))
    run(window, f"click:{x / 2}:{y / 2} wait")
    assert window.parts.state.selection.name == "someone: head"


def test_the_live_panel_tells_rate_loss_and_latency(open_window, avatar):
    now, inbox = [100.0], Inbox("udp")
    live = LivePlayback(inbox, Address("udp", "127.0.0.1", 1), [avatar], clock=lambda: now[0])
    window = open_window(live=[(live, [0])])
    waiting = run(window, "wait wait")
    assert "T-pose" in window.panels.places and "scrub" not in window.panels.places
    bent = np.zeros((52, 3))
    bent[16, 2] = -1.2
    for n in range(10):
        inbox.feed(build_pose(Pose(bent, np.array([0, 0.9, 0])), time=n / 60, sequence=2 * n), 100 + n / 60)
        now[0] = 100.01 + n / 60
        posed = run(window, "wait")
    assert (picture(window, posed) != picture(window, waiting)).any(-1).mean() > 0.01
    left, y = window.parts.state.layout.area[0], int(window.panels.places["T-pose"][1])
    # letters of the latency table
    assert len(np.unique(posed[y - 110 : y - 10, 5 : left - 5].reshape(-1, 3), axis=0)) > 20
    run(window, "press:T-pose")
    assert live.countdown is not None
    run(window, "press:play wait")
    assert not live.playing


def test_an_effect_that_does_not_show_says_so_where_it_is_switched_on(window, monkeypatch):
    said = []
    monkeypatch.setattr(Widgets, "caption", lambda self, text: said.append(text))
    wanted = replace(
        PLAIN, light=Light(), motion_blur=MotionBlur(), depth_of_field=DepthOfField(), foot_lock=FootLock()
    )
    window.parts.look.change(effects=wanted)
    run(window, "press:Avatars press:More wait")
    del said[:]
    run(window, "wait")
    reasons = [text for text in said if text]
    assert reasons[0] == f"{NO_LIGHT} (even light leaves none)"
    assert reasons.count(IN_FILMS) == 2 and NOT_LOOSE in reasons and len(reasons) == 4
    window.parts.look.change(effects=PLAIN)
    run(window, "wait wait")
    del said[:]
    run(window, "wait")
    assert [text for text in said if text] == [NOT_LOOSE]


def test_a_paused_window_sleeps_until_something_happens(window, monkeypatch):
    slept = []

    def sleep(seconds):
        slept.append(seconds)
        window.parts.closing = len(slept) == 2

    monkeypatch.setattr(glfw, "wait_events_timeout", sleep)
    window.run()
    assert len(slept) == 2
