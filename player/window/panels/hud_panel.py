"""What lies over the picture: frame rate and time of each frame, messages, the joint that was picked, and the list
of keys; where there are no panels, one line of text."""

from collections.abc import Sequence

import numpy as np
from imgui_bundle import imgui

from avatar.camera import project
from command.progress import plural
from player.live.latency import DRAWN
from player.window.actions import GROUPS, mouse_rows
from player.window.panels.widgets import shortened
from player.window.parts import WindowParts

INK = imgui.IM_COL32(255, 255, 255, 230)
PLATE = imgui.IM_COL32(0, 0, 0, 120)
MARK = imgui.IM_COL32(255, 204, 51, 255)
KEY, TITLE = (1.0, 0.8, 0.2, 1.0), (0.6, 0.75, 0.95, 1.0)
# a heading, keys and what they do
Block = tuple[str, Sequence[tuple[str, str]]]


def hud_panel(parts: WindowParts) -> None:
    """Frames a second with the last frames' milliseconds, in the picture's corner; below, what was said."""
    state, film = parts.state, parts.recorder.film
    left, top, width = (length / state.layout.screen.scale for length in state.layout.area[:3])
    draw, letter = imgui.get_background_draw_list(), imgui.get_font_size()
    times = 1000 * np.array(state.last.times)
    lines = []
    if len(times):
        lines.append(f"{state.last.rate:.0f} fps   {np.median(times):.1f} ms, p95 {np.percentile(times, 95):.1f}")
    if parts.budget is not None:
        lines.append(parts.budget.words)
    for live, _ in state.playback.live:
        drawn = live.latency.percentiles().get(DRAWN)
        if drawn is not None:
            lines.append(f"pose to picture {drawn.p50:.1f} ms, p95 {drawn.p95:.1f}")
    if film is not None:
        lines.append(f"filming: {plural(film.frames, 'frame')}")
    if state.messages.shown:
        lines.append(state.messages.shown)
    y, wrap = top + 0.5 * letter, width - 2 * letter
    for text in lines:
        size = imgui.calc_text_size(text, wrap_width=wrap)
        x = left + width - size.x - letter
        draw.add_rect_filled((x - 4, y - 2), (x + size.x + 4, y + size.y + 2), PLATE, 3.0)
        # calc_text_size rounds up to whole units: a line that just fits is not broken
        draw.add_text(imgui.get_font(), letter, (x, y), INK, text, wrap_width=max(size.x + 1, 1.0))
        y += size.y + 0.4 * letter


def joint_mark(parts: WindowParts) -> None:
    """A ring and a name at the picked joint."""
    state = parts.state
    index, joint, camera = state.selection.avatar, state.selection.joint, state.last.camera
    if joint is None or camera is None:
        return
    pixel, depth = project(camera, parts.viewpoint.joints(index)[[joint], :3, 3])
    if not depth[0] > 0:
        return
    x, y = (float(v) / state.layout.screen.scale for v in pixel[0])
    draw, letter = imgui.get_background_draw_list(), imgui.get_font_size()
    draw.add_circle((x, y), 0.5 * letter, MARK, 0, 2.0)
    draw.add_text((x + 0.8 * letter, y - 0.5 * letter), MARK, state.selection.name)


def status(parts: WindowParts) -> str:
    """The line of text: a message, or frames per second, where the playback is, view and selection."""
    state = parts.state
    if state.messages.shown:
        return state.messages.shown
    words = [f"{state.last.rate:.0f} fps", state.playback.status(), parts.look.status]
    if parts.budget is not None:
        words.append(parts.budget.words)
    if parts.viewpoint.cameras.kind != "orbit":
        words.append(parts.viewpoint.cameras.kind)
    if parts.recorder.film is not None:
        words.append(f"filming {parts.recorder.film.frames}")
    # something else than the first avatar as a whole
    if state.selection.avatar != 0 or state.selection.joint is not None:
        words.append(state.selection.name)
    return "    ".join([*words, "h: keys"])


def status_line(parts: WindowParts) -> None:
    """The line of text on a dark plate in the lower left corner; what is wider than the window loses its middle."""
    (wide, high), pad = imgui.get_io().display_size, 0.25 * imgui.get_font_size()
    text = shortened(status(parts), lambda cut: imgui.calc_text_size(cut).x <= wide - 2 * pad)
    size, draw = imgui.calc_text_size(text), imgui.get_background_draw_list()
    top = high - size.y - 2 * pad
    draw.add_rect_filled((0, top), (size.x + 2 * pad, high), PLATE)
    draw.add_text((pad, top + pad), INK, text)


def key_list(parts: WindowParts) -> None:
    """The keys that hold now, in as many columns as the window has room for; the wheel scrolls what is too high."""
    groups = [group for group in GROUPS if group.when(parts)]
    blocks: list[Block] = [*((group.title, group.rows) for group in groups), ("Mouse", mouse_rows(groups))]
    cells = [cell for _, lines in blocks for cell in lines]
    letter, (wide, high) = imgui.get_font_size(), imgui.get_io().display_size
    across = max(imgui.calc_text_size(keys).x for keys, _ in cells) + letter
    column = across + max(imgui.calc_text_size(means).x for _, means in cells) + 2 * letter
    imgui.set_next_window_pos((0.5 * wide, 0.5 * high), 0, (0.5, 0.5))
    imgui.set_next_window_size_constraints((0, 0), (0.96 * wide, 0.96 * high))
    flags = imgui.WindowFlags_.no_decoration & ~imgui.WindowFlags_.no_scrollbar | imgui.WindowFlags_.always_auto_resize
    if imgui.begin("##key list", None, flags | imgui.WindowFlags_.no_saved_settings)[0]:
        for number, blocks_below in enumerate(in_columns(blocks, max(int(0.96 * wide / column), 1))):
            if number:
                imgui.same_line(0, 2 * letter)
            imgui.begin_group()
            for title, lines in blocks_below:
                imgui.text_colored(TITLE, title)
                for keys, means in lines:
                    imgui.text_colored(KEY, keys)
                    imgui.same_line(across)
                    imgui.text(means)
                imgui.text("")
            imgui.end_group()
    imgui.end()


def in_columns(blocks: Sequence[Block], count: int) -> list[list[Block]]:
    """Blocks in at most so many columns, in order and as even as can be without breaking one."""
    heights = [len(lines) + 2 for _, lines in blocks]
    high = max(heights)
    while True:
        columns, free = [], 0
        for block, lines in zip(blocks, heights, strict=True):
            if lines > free:
                columns.append([])
                free = high
            columns[-1].append(block)
            free -= lines
        if len(columns) <= count:
            return columns
        high += 1
