"""The panel of time: play, step, scrub, speed."""

from imgui_bundle import imgui

from player.window import actions
from player.window.panels.widgets import Widgets
from player.window.parts import WindowParts
from player.window.timeline import SPEEDS

MARK = imgui.IM_COL32(255, 204, 51, 255)


def timeline_panel(ui: Widgets, parts: WindowParts) -> None:
    """One row of buttons and one long slider."""
    line, letter = parts.state.timeline, imgui.get_font_size()
    ui.action("|<", actions.FIRST_FRAME, parts, name="start")
    ui.action("<", actions.STEP_BACK, parts, name="back", beside=True)
    ui.action("Pause" if line.playing else "Play", actions.PLAY, parts, name="play", beside=True, width=4.2 * letter)
    ui.action(">", actions.STEP_ON, parts, name="on", beside=True)
    ui.action(">|", actions.LAST_FRAME, parts, name="end", beside=True)
    imgui.same_line()
    speeds = sorted({*SPEEDS, line.speed})
    chosen = ui.choice("##speed", speeds.index(line.speed), [f"x {speed:g}" for speed in speeds],
                       "How fast it plays. Keys: [ and ]", name="speed", width=5.5 * letter)  # fmt: skip
    line.speed = line.speed if chosen is None else speeds[chosen]
    ui.action("Keys", actions.HELP, parts, name="keys", beside=True)
    imgui.same_line()
    if line.frames == 1 and parts.posing.edit is None:
        imgui.text("live" if parts.state.playback.live else "one pose")
        return
    short = f"{line.seconds:.2f} s"
    text = f"frame {line.frame} of {line.frames}   {short} of {line.duration:.2f} s"
    imgui.text(text if imgui.calc_text_size(text).x < imgui.get_content_region_avail().x else short)
    _scrubber(ui, parts)


def _scrubber(ui: Widgets, parts: WindowParts) -> None:
    line = parts.state.timeline
    tip = "Drag to any moment. Triangles: camera keys."
    frame = ui.scrubber(line.frame, max(line.frames - 1, 1), tip)
    if frame is not None:
        line.seek(frame)
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    draw = imgui.get_window_draw_list()
    for seconds, _ in parts.viewpoint.cameras.keys:
        x = low.x + (high.x - low.x) * seconds / line.duration
        draw.add_triangle_filled((x - 4, low.y - 1), (x + 4, low.y - 1), (x, low.y + 6), MARK)
