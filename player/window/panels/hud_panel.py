"""What lies over the picture: frame rate and time of each frame, messages, and the joint that was picked."""

import numpy as np
from imgui_bundle import imgui

from avatar.camera import project
from avatar.skeleton import joint_transforms
from command.progress import plural
from player.window.parts import WindowParts
from player.window.state import WindowState

INK = imgui.IM_COL32(255, 255, 255, 230)
PLATE = imgui.IM_COL32(0, 0, 0, 120)
MARK = imgui.IM_COL32(255, 204, 51, 255)


def hud_panel(parts: WindowParts) -> None:
    """Frames a second with the last frames' milliseconds, in the picture's corner; below, what was said."""
    state, film = parts.state, parts.recorder.film
    left, top, width, _ = _area_in_units(state)
    draw, letter = imgui.get_background_draw_list(), imgui.get_font_size()
    times = 1000 * np.array(state.last.times)
    lines = []
    if len(times):
        lines.append(f"{state.last.rate:.0f} fps   {np.median(times):.1f} ms, p95 {np.percentile(times, 95):.1f}")
    if parts.budget is not None:
        lines.append(parts.budget.words)
    for live, _ in state.playback.live:
        spans = live.latency.percentiles()
        if spans:
            lines.append(f"pose to picture {spans.p50:.1f} ms, p95 {spans.p95:.1f}")
    if film is not None:
        lines.append(f"filming: {plural(film.frames, 'frame')}")
    if state.messages.shown:
        lines.append(state.messages.shown)
    y, wrap = top + 0.5 * letter, width - 2 * letter
    for text in lines:
        size = imgui.calc_text_size(text, wrap_width=wrap)
        x = left + width - size.x - letter
        draw.add_rect_filled(imgui.ImVec2(x - 4, y - 2), imgui.ImVec2(x + size.x + 4, y + size.y + 2), PLATE, 3.0)
        # calc_text_size rounds up to whole units: a line that just fits is not broken
        draw.add_text(imgui.get_font(), letter, imgui.ImVec2(x, y), INK, text, wrap_width=max(size.x + 1, 1.0))
        y += size.y + 0.4 * letter


def joint_mark(state: WindowState) -> None:
    """A ring and a name at the picked joint."""
    index, joint, camera = state.selection.avatar, state.selection.joint, state.last.camera
    if joint is None or camera is None:
        return
    pose, avatar = state.last.poses[index], state.avatars[index]
    place = joint_transforms(pose[0], avatar.joint_positions.astype(np.float64), pose[1])[joint, :3, 3]
    pixel, depth = project(camera, place[None])
    if not depth[0] > 0:
        return
    x, y = (float(v) / state.layout.screen.scale for v in pixel[0])
    draw, letter = imgui.get_background_draw_list(), imgui.get_font_size()
    draw.add_circle(imgui.ImVec2(x, y), 0.5 * letter, MARK, 0, 2.0)
    draw.add_text(imgui.ImVec2(x + 0.8 * letter, y - 0.5 * letter), MARK, state.selection.name)


def _area_in_units(state: WindowState) -> tuple[float, float, float, float]:
    left, top, width, height = state.layout.area
    scale = state.layout.screen.scale
    return left / scale, top / scale, width / scale, height / scale
