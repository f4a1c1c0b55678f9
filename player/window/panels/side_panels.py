"""The panels on the left: avatars, live sources, the camera, and how it is drawn (effects: effects_panel.py)."""

import numpy as np
from imgui_bundle import imgui

from command.progress import plural
from player.budget.rung import Rung
from player.live.latency import SPANS
from player.live.playback import LivePlayback
from player.scene.track import Track
from player.window import actions
from player.window.panels.effects_panel import background_panel, effects_panel, looks_panel
from player.window.panels.widgets import Widgets, tip_of
from player.window.parts import WindowParts
from player.window.state import joint_name
from player.window.viewpoint import Viewpoint
from player.window.wipe import Wipe


def avatars_panel(ui: Widgets, parts: WindowParts) -> None:
    """A row an avatar; below, the place and the start of the one that is selected."""
    selection, posing = parts.state.selection, parts.posing
    for index, name in enumerate(selection.names):
        tip = f"{name}\nSelect this avatar. Key: tab selects the next."
        if ui.row(name, tip, name=f"avatar {index}", selected=index == selection.avatar):
            selection.choose(index)
    track = parts.state.playback.tracks[selection.avatar]
    ui.path("motion: ", track.name or "its own")
    ui.fold("place and start", "Its place, its turn, and where its motion begins.", lambda: _place(ui, track))
    ui.action("Pose by hand" if posing.edit is None else "Stop posing", actions.POSE, parts, name="pose")
    joint = selection.joint
    imgui.text_disabled(f"joint: {joint_name(joint)}" if joint is not None else "click the avatar to pick a joint")


def _place(ui: Widgets, track: Track) -> None:
    tip = "Where the avatar stands, metres: x, y (up) and z. Drag, or Ctrl+click to type."
    at = ui.numbers("place, m", track.at.tolist(), tip, name="place")
    if at is not None:
        track.at = np.array(at, np.float64)
    turn = ui.slider("turn", float(np.degrees(track.turn)), (-180.0, 180.0), "Turn the avatar about the vertical.")
    if turn is not None:
        track.turn = float(np.radians(turn))
    if track.motion.frames > 1:
        tip = "The second of its motion at which this avatar begins."
        span = (0.0, track.motion.frames / track.motion.rate)
        start = ui.slider("start, s", track.start, span, tip, name="start at", form="%.2f")
        track.start = track.start if start is None else start


def live_panel(ui: Widgets, parts: WindowParts) -> None:
    """A block for each source."""
    for number, (live, _) in enumerate(parts.state.playback.live):
        imgui.push_id(number)
        _source(live)
        asked = live.countdown is not None
        text = f"T-pose in {live.countdown:.0f} s" if asked else "Take the T-pose in 3 s"
        if ui.button(text, tip_of(actions.T_POSE), name="T-pose"):
            live.ask_for_t_pose()
        imgui.pop_id()


def _source(live: LivePlayback) -> None:
    facts = live.inbox.facts(live.clock())
    imgui.text(str(live.address))
    if facts.age is None:
        imgui.text_disabled("waiting for poses")
    else:
        imgui.text(f"{facts.rate:.0f} poses/s, the newest {1000 * facts.age:.0f} ms old")
        if not facts.tracking:
            imgui.text_colored((1.0, 0.6, 0.3, 1.0), "the sender lost its tracking")
    counts = {name: n for name, n in vars(facts.counters).items() if n or name in ("frames", "lost")}
    imgui.text_disabled(", ".join(f"{name} {n}" for name, n in counts.items()))
    spans = live.latency.percentiles()
    if spans and imgui.begin_table("latency", 4, imgui.TableFlags_.sizing_stretch_prop):
        for text in ("ms", "p50", "p95", "p99"):
            imgui.table_next_column()
            imgui.text_disabled(text)
        for name in SPANS:
            imgui.table_next_column()
            imgui.text(name)
            for value in spans.get(name, ("-", "-", "-")):
                imgui.table_next_column()
                imgui.text(value if isinstance(value, str) else f"{value:.1f}")
        imgui.end_table()


def camera_panel(ui: Widgets, parts: WindowParts) -> None:
    """The camera, and what belongs to its kind."""
    viewpoint = parts.viewpoint
    cameras, kinds = viewpoint.cameras, viewpoint.cameras.kinds
    tip = "What the picture is seen through. Key: c takes the next."
    chosen = ui.choice("camera", kinds.index(cameras.kind), kinds, tip)
    if chosen is not None:
        cameras.kind = kinds[chosen]
    ui.action("Whole", actions.RESET_CAMERA, parts, name="reset camera")
    ui.action("Face", actions.FACE, parts, beside=True)
    ui.action("Left hand", actions.LEFT_HAND, parts, beside=True)
    ui.action("Right hand", actions.RIGHT_HAND, parts, beside=True)
    if cameras.kind in ("orbit", "turntable"):
        viewpoint.follow = ui.checkbox("follow", viewpoint.follow, tip_of(actions.FOLLOW))
    if parts.wipe is not None and viewpoint.shows_video:
        _wipe(ui, parts.wipe, viewpoint)
    ui.action("Add camera key", actions.ADD_CAMERA_KEY, parts, name="add key", beside=True)
    if cameras.keys:
        ui.action("Save path", actions.SAVE_CAMERA_PATH, parts, beside=True)
        if ui.button("Clear", "Forget the recorded keys.", name="clear keys", beside=True):
            cameras.clear_keys()
    if cameras.keys:
        imgui.text_disabled(f"{plural(len(cameras.keys), 'camera key')}, the last at {cameras.keys[-1][0]:.2f} s")


def _wipe(ui: Widgets, wipe: Wipe, viewpoint: Viewpoint) -> None:
    tip = "How much of the width shows the video alone. Drag the yellow line in the picture, or press - and =."
    part = ui.slider("wipe", wipe.part, (0.0, 1.0), tip, form="video | avatar")
    if part is not None:
        wipe.move(part)
    tip = "On: the video is behind the avatar too. Off: the plain background is."
    wipe.behind = ui.checkbox("video behind the avatar", wipe.behind, tip, name="behind")
    imgui.text_disabled(f"{wipe.capture.part} video, picture {viewpoint.video_frame}")


def files_panel(ui: Widgets, parts: WindowParts) -> None:
    film = parts.recorder.film
    ui.action("Open", actions.OPEN, parts)
    ui.action("Save scene", actions.SAVE_SCENE, parts, beside=True)
    ui.action("Picture", actions.SCREENSHOT, parts, name="screenshot", beside=True)
    ui.action("Stop film" if film else "Film", actions.FILM, parts, name="film", beside=True)


def look_panel(ui: Widgets, parts: WindowParts) -> None:
    looks_panel(ui, parts)
    effects_panel(ui, parts, first=True)
    background_panel(ui, parts)


def more_panel(ui: Widgets, parts: WindowParts) -> None:
    """The other effects, level of detail, and prices."""
    look, tip = parts.look, "Milliseconds that each effect adds to a frame now, below it; timing them takes a moment."
    if ui.button("Prices of effects", tip, name="prices"):
        parts.prices.ask()
    effects_panel(ui, parts, first=False)
    if look.renderer.has_view:
        tip = "How much of the view dependence is shown. 0 is the paper."
        amount = ui.slider("shine amount", look.renderer.view_amount, (0.0, 1.0), tip, form="%.2f")
        look.renderer.view_amount = look.renderer.view_amount if amount is None else amount
    levels = max(len(avatar.levels) for avatar in parts.state.avatars)
    if levels > 1:
        names = [f"{len(level.faces)} triangles" for level in parts.state.avatars[0].levels]
        names += [f"level {k}" for k in range(len(names), levels)]
        tip = "Level of detail: fewer triangles are faster."
        chosen = ui.choice("detail", min(look.rung.level, levels - 1), names, tip)
        if chosen is not None:
            look.change(rung=Rung("by hand", look.effects.view, chosen))
