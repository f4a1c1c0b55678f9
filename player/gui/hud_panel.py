"""What lies over the picture: frame rate and time of each frame, messages, and the joint that was picked."""

from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import imgui

from avatar.camera import project
from avatar.skeleton import joint_transforms

if TYPE_CHECKING:
    from player.window.window import Window

INK = imgui.IM_COL32(255, 255, 255, 230)
PLATE = imgui.IM_COL32(0, 0, 0, 120)
MARK = imgui.IM_COL32(255, 204, 51, 255)


def hud_panel(window: "Window") -> None:
    """Frames a second with the last frames' milliseconds, in the picture's corner; below, what was said."""
    left, top, width, height = _area_in_units(window)
    draw, letter = imgui.get_background_draw_list(), imgui.get_font_size()
    times = 1000 * np.array(window.frame_times)
    lines = []
    if len(times):
        lines.append(
            f"{window.frames_per_second:.0f} fps   {np.median(times):.1f} ms, p95 {np.percentile(times, 95):.1f}"
        )
    for live, _ in window.playback.live:
        spans = live.latency.percentiles()
        if spans:
            lines.append(f"pose to picture {spans.p50:.1f} ms, p95 {spans.p95:.1f}")
    if window.film is not None:
        lines.append(f"filming: {window.film.frames} frames")
    if window.clock() < window.message_until:
        lines.append(window.message)
    for number, text in enumerate(lines):
        size = imgui.calc_text_size(text)
        x, y = left + width - size.x - letter, top + 0.5 * letter + number * 1.4 * letter
        draw.add_rect_filled(imgui.ImVec2(x - 4, y - 2), imgui.ImVec2(x + size.x + 4, y + size.y + 2), PLATE, 3.0)
        draw.add_text(imgui.ImVec2(x, y), INK, text)


def joint_mark(window: "Window") -> None:
    """A ring and a name at the picked joint."""
    index, joint = window.selection
    if joint is None or window.camera is None or window.tool is not None:
        # a tool shows in its own way what is selected
        return
    pose, avatar = window.poses[index], window.show.avatars[index]
    place = joint_transforms(pose[0], avatar.joint_positions.astype(np.float64), pose[1])[joint, :3, 3]
    pixel, depth = project(window.camera, place[None])
    if not depth[0] > 0:
        return
    wide, high = window.size_in_units()
    x, y = (
        float(pixel[0, 0]) * wide / window.camera.size[0],
        float(pixel[0, 1]) * high / window.camera.size[1],
    )
    draw = imgui.get_background_draw_list()
    draw.add_circle(imgui.ImVec2(x, y), 0.5 * imgui.get_font_size(), MARK, 0, 2.0)
    draw.add_text(
        imgui.ImVec2(x + 0.8 * imgui.get_font_size(), y - 0.5 * imgui.get_font_size()),
        MARK,
        window.selected(),
    )


def _area_in_units(window: "Window") -> tuple[float, float, float, float]:
    left, top, width, height = window.area()
    x, y = window.pixel(1.0, 1.0)
    return left / x, top / y, width / x, height / y
