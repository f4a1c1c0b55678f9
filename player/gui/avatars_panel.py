"""The panel of avatars: which there are, where each stands, what moves it."""

from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import imgui

from avatar.skeleton import JOINTS
from player.window.pose_tool import toggle_posing

if TYPE_CHECKING:
    from player.window.window import Window


def avatars_panel(window: "Window") -> None:
    """A row an avatar; below, the place and the start of the one that is selected."""
    panels = window.panels
    assert panels is not None
    for index, name in enumerate(window.show.names):
        if imgui.selectable(f"{name}##{index}", index == window.selection.avatar)[0]:
            window.select(index)
        panels.mark(f"avatar {index}")
    index, joint = window.selection
    track = window.playback.tracks[index]
    imgui.text_disabled(f"moved by {track.name or 'its motion'}")
    changed, at = imgui.drag_float3("place, m", [float(v) for v in track.at], 0.01, -100.0, 100.0, "%.2f")
    panels.mark("place")
    if changed:
        track.at = np.array(at, np.float64)
    changed, turn = imgui.slider_float("turn", float(np.degrees(track.turn)), -180.0, 180.0, "%.0f deg")
    panels.mark("turn")
    if changed:
        track.turn = float(np.radians(turn))
    if track.frames > 1:
        changed, start = imgui.slider_float("start, s", track.start, 0.0, track.frames / track.rate, "%.2f")
        panels.mark("start at")
        if changed:
            track.start = start
    posing = window.pose_session is not None
    if imgui.button("Stop posing" if posing else "Pose by hand"):
        toggle_posing(window)
    panels.mark("pose")
    imgui.text(f"joint: {JOINTS[joint]}" if joint is not None else "click the avatar to pick a joint")
