"""The panel of time: play, step, scrub, speed, loop, the range A to B."""

from typing import TYPE_CHECKING

from imgui_bundle import imgui

from player.window.timeline import LOOPS, SPEEDS

if TYPE_CHECKING:
    from player.window.window import Window

MARK = imgui.IM_COL32(255, 204, 51, 255)
RANGE = imgui.IM_COL32(255, 204, 51, 60)


def timeline_panel(window: "Window") -> None:
    """One row of buttons and one long slider."""
    line, panels = window.timeline, window.panels
    assert panels is not None
    for name, text, act in (
        ("start", "|<", lambda: line.seek(0)), ("back", "<", lambda: line.step(-1)),
        ("play", "Pause" if line.playing else "Play", line.toggle), ("on", ">", lambda: line.step(1)),
        ("end", ">|", lambda: line.seek(line.frames - 1)),
    ):  # fmt: skip
        width = 4.2 * imgui.get_font_size() if name == "play" else 0
        if imgui.button(f"{text}##{name}", imgui.ImVec2(width, 0)):
            act()
        panels.mark(name)
        imgui.same_line()
    imgui.set_next_item_width(5.5 * imgui.get_font_size())
    speeds = sorted({*SPEEDS, line.speed})
    changed, chosen = imgui.combo("##speed", speeds.index(line.speed), [f"x {speed:g}" for speed in speeds])
    panels.mark("speed")
    if changed:
        line.speed = speeds[chosen]
    imgui.same_line()
    imgui.set_next_item_width(7.0 * imgui.get_font_size())
    changed, chosen = imgui.combo("##loop", LOOPS.index(line.loop), list(LOOPS))
    panels.mark("loop")
    if changed:
        line.loop, line.backwards = LOOPS[chosen], False
    for name, act in (
        ("A", lambda: line.set_a(line.frame)), ("B", lambda: line.set_b(line.frame)),
        ("A-B off", lambda: (line.set_a(None), line.set_b(None))),
    ):  # fmt: skip
        imgui.same_line()
        if imgui.button(name):
            act()
        panels.mark(name)
    imgui.same_line()
    if line.frames == 1 and window.pose_session is None:
        imgui.text("live" if window.playback.live else "one pose")
        return
    imgui.text(f"frame {line.frame} of {line.frames}   {line.seconds:.2f} s of {line.duration:.2f} s")
    _scrubber(window)


def _scrubber(window: "Window") -> None:
    line, panels = window.timeline, window.panels
    assert panels is not None
    imgui.set_next_item_width(-1)
    changed, frame = imgui.slider_int("##scrub", line.frame, 0, max(line.frames - 1, 1), "")
    panels.mark("scrub")
    if changed:
        line.seek(frame)
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    draw = imgui.get_window_draw_list()

    def across(frame: float | int) -> float:
        return low.x + (high.x - low.x) * (frame + 0.5) / line.frames

    if line.a is not None or line.b is not None:
        last = line.frames - 1 if line.b is None else line.b
        draw.add_rect_filled(imgui.ImVec2(across(line.a or 0), low.y), imgui.ImVec2(across(last), high.y), RANGE)
    session = window.pose_session
    if session is not None:
        y = 0.5 * (low.y + high.y)
        for frame, _ in session.keys:  # a diamond each
            draw.add_ngon_filled(imgui.ImVec2(across(frame * line.rate / session.rate), y), 5.0, MARK, 4)
    for seconds, _ in window.cameras.keys:
        x = across(seconds * line.rate - 0.5)
        draw.add_triangle_filled(
            imgui.ImVec2(x - 4, low.y - 1), imgui.ImVec2(x + 4, low.y - 1), imgui.ImVec2(x, low.y + 6), MARK
        )
