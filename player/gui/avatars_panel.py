"""The panel of avatars: which there are, where each stands, what moves it."""

import numpy as np
from imgui_bundle import imgui

from player.gui.widgets import Widgets
from player.window.actions import POSE
from player.window.parts import Parts
from player.window.state import joint_name


def avatars_panel(ui: Widgets, parts: Parts) -> None:
    """A row an avatar; below, the place and the start of the one that is selected."""
    selection, posing = parts.state.selection, parts.posing
    for index, name in enumerate(selection.names):
        tip = f"{name}\nSelect this avatar. Key: tab selects the next."
        if ui.row(name, tip, name=f"avatar {index}", selected=index == selection.avatar):
            selection.choose(index)
    track = parts.state.playback.tracks[selection.avatar]
    ui.path("motion: ", track.name or "its own")
    tip = "Where the avatar stands, metres: x, y (up) and z. Drag, or Ctrl+click to type."
    at = ui.numbers("place, m", track.at.tolist(), tip, name="place")
    if at is not None:
        track.at = np.array(at, np.float64)
    turn = ui.slider("turn", float(np.degrees(track.turn)), (-180.0, 180.0), "Turn the avatar about the vertical.")
    if turn is not None:
        track.turn = float(np.radians(turn))
    if track.frames > 1:
        tip = "The second of its motion at which this avatar begins."
        start = ui.slider("start, s", track.start, (0.0, track.frames / track.rate), tip, name="start at", form="%.2f")
        track.start = track.start if start is None else start
    ui.action("Pose by hand" if posing.edit is None else "Stop posing", POSE, parts, name="pose")
    joint = selection.joint
    imgui.text_disabled(f"joint: {joint_name(joint)}" if joint is not None else "click the avatar to pick a joint")
