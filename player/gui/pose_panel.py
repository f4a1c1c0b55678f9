"""The panels of posing: undo and mirror, the joint's angles, hands and fingers, reach, keyframes, library and files."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import imgui

from avatar.motion.builtin import FINGERS
from player.pose.fingers import CURL_RANGE, PRESETS, SPREAD_RANGE, Side, finger_name, hand_shape
from player.pose.ik import LIMBS
from player.pose.library import BUILTIN
from player.pose.limits import joint_angles, limits
from player.pose.mirror import PARTNER
from player.pose.session import hand_joints, limb_of
from player.window.pose_tool import PoseTool, spoken
from player.window.recorder import free_name

if TYPE_CHECKING:
    from player.window.window import Window

SIDES: tuple[Side, Side] = ("left", "right")
# of the list of joints
ORDER = sorted(range(52), key=lambda joint: (joint >= 22, joint))


def _tool(window: "Window") -> PoseTool:
    assert isinstance(window.tool, PoseTool)
    return window.tool


def _button(window: "Window", text: str, act: Callable[[], object], *, name: str = "", beside: bool = False) -> None:
    """A button that does what may be refused, found by scripts under its name."""
    if beside:
        imgui.same_line()
    if imgui.button(f"{text}##{name}"):
        _tool(window).tried(act)
    assert window.panels is not None
    window.panels.mark(name or text.lower())


def _slider(
    window: "Window",
    text: str,
    value: float,
    span: tuple[float, float],
    change: Callable[[float, object], object],
    *,
    name: str = "",
    form: str = "%.0f deg",
) -> None:
    """A slider whose whole drag is one step of undo: the session gets the same mark until it is let go."""
    tool = _tool(window)
    assert window.panels is not None
    changed, new = imgui.slider_float(f"{text}##{name}", value, *span, form)
    window.panels.mark(name or text)
    if changed:
        tool.tried(lambda: change(new, f"{name or text}"))
    if imgui.is_item_deactivated():
        tool.session.end_drag()


def pose_panel(window: "Window") -> None:
    """Undo and redo, limits, axes; what is done to the whole pose."""
    tool = _tool(window)
    session = tool.session
    _button(window, "Undo", tool.undo)
    _button(window, "Redo", tool.redo, beside=True)
    _button(window, "Mirror", session.mirror, beside=True)
    _button(window, "To ground", tool.to_ground, name="ground", beside=True)
    assert window.panels is not None
    session.limited = imgui.checkbox("limits", session.limited)[1]
    window.panels.mark("limits")
    imgui.same_line()
    world = imgui.checkbox("world axes", tool.frame == "world")[1]
    tool.frame = "world" if world else "local"
    window.panels.mark("world axes")
    _button(window, "Copy whole", lambda: tool.copy("whole"), name="copy whole")
    if session.copied is not None:
        _button(window, "Paste", tool.paste, beside=True)
        _button(window, "Paste mirrored", lambda: tool.paste(mirrored=True), name="paste mirrored", beside=True)
    if session.dirty:
        imgui.text_disabled("not saved")


def joint_panel(window: "Window") -> None:
    """The selected joint: a list to choose from and its three angles."""
    tool = _tool(window)
    session, joint, table = tool.session, tool.joint, limits()
    imgui.set_next_item_width(-1)
    if imgui.begin_combo("##joint", "click a joint, or choose" if joint is None else spoken(joint)):
        for other in ORDER:
            if imgui.selectable(spoken(other), other == joint)[0]:
                window.select(tool.index, other)
        imgui.end_combo()
    assert window.panels is not None
    window.panels.mark("joint")
    if joint is None:
        return
    angles = np.round(np.degrees(joint_angles(session.pose.axis_angle)[joint]), 6) + 0.0  # no -0
    low, high = np.degrees(table.low[joint]), np.degrees(table.high[joint])
    if not session.limited:
        low, high = np.full(3, -180.0), np.full(3, 180.0)
    for k, text in enumerate(table.names[joint]):

        def change(value: float, mark: object, k: int = k) -> None:
            session.set_angle(joint, k, float(np.radians(value)), drag=mark)

        _slider(window, text, float(angles[k]), (float(low[k]), float(high[k])), change, name=f"angle {k}")
    _button(window, "Reset joint", lambda: session.reset([joint]), name="reset joint")
    _button(window, "Copy joint", lambda: tool.copy("joint"), name="copy joint", beside=True)
    if joint:
        _button(window, "Copy limb", lambda: tool.copy("limb"), name="copy limb", beside=True)
        _button(window, "Reset limb", lambda: session.reset(limb_of(joint)), name="reset limb")
    if PARTNER[joint] != joint:
        _button(
            window,
            "Other side too",
            lambda: session.to_other_side(limb_of(joint)),
            name="other side",
            beside=True,
        )


def hands_panel(window: "Window") -> None:
    """Hand shapes by name for either hand or both, then each finger."""
    tool = _tool(window)
    session = tool.session
    assert window.panels is not None
    for side in SIDES:
        imgui.text(f"{side} hand")
        for number, name in enumerate(PRESETS):
            _button(
                window, name, partial(session.set_hand, side, PRESETS[name]),
                name=f"{side} {name}", beside=number % 4 != 0,
            )  # fmt: skip
        if not imgui.tree_node(f"{side} fingers"):
            window.panels.mark(f"{side} fingers")
            continue
        window.panels.mark(f"{side} fingers")
        shape = hand_shape(session.pose.axis_angle, side)
        for finger in (4, 0, 1, 3, 2):

            def curl(value: float, mark: object, finger: int = finger, side: Side = side) -> None:
                session.set_curl(side, finger, value, drag=mark)

            def spread(value: float, mark: object, finger: int = finger, side: Side = side) -> None:
                session.set_spread(side, finger, float(np.radians(value)), drag=mark)

            name = finger_name(finger)
            _slider(
                window,
                name,
                shape.curl[finger],
                CURL_RANGE,
                curl,
                name=f"{side} curl {FINGERS[finger]}",
                form="%.2f",
            )
            low, high = np.degrees(SPREAD_RANGE)
            _slider(
                window, "  spread", float(np.degrees(shape.spread[finger])), (float(low), float(high)), spread,
                name=f"{side} spread {FINGERS[finger]}",
            )  # fmt: skip
        _button(
            window,
            "Other hand too",
            partial(session.to_other_side, hand_joints(side)),
            name=f"{side} other",
        )
        imgui.tree_pop()


def reach_panel(window: "Window") -> None:
    """How hands and feet are pulled, and which are held in place while the body moves."""
    tool = _tool(window)
    assert window.panels is not None
    imgui.text_wrapped("Drag squares: hands and feet. Diamond: the body. Rings: elbows and knees.")
    tool.follow = imgui.checkbox("hands and feet turn along", tool.follow)[1]
    window.panels.mark("turn along")
    for number, limb in enumerate(LIMBS):
        if number % 2:
            imgui.same_line()
        changed, on = imgui.checkbox(f"pin {limb.replace('_', ' ')}", limb in tool.session.pinned)
        window.panels.mark(f"pin {limb.replace('_', ' ')}")
        if changed:
            tool.session.pin(limb, on)


def keys_panel(window: "Window") -> None:
    """Keyframes: the pose in hand at the frame that the timeline shows."""
    tool = _tool(window)
    session, line = tool.session, window.timeline
    assert window.panels is not None
    _button(window, "Key here", tool.insert_key, name="key")
    here = session.frame in dict(session.keys)
    if here:
        _button(window, "Delete key", session.delete_key, name="delete key", beside=True)
    smooth = imgui.checkbox("smooth", session.state.easing == "smooth")[1]
    window.panels.mark("smooth")
    session.ease("smooth" if smooth else "linear")
    imgui.same_line()
    session.auto_key = imgui.checkbox("key every change", session.auto_key)[1]
    window.panels.mark("key every change")
    changed, seconds = imgui.input_float("length, s", line.duration, 1.0, 5.0, "%.2f")
    window.panels.mark("length")
    if changed:
        last = session.keys[-1][0] if session.keys else 0
        frames = max(round(min(seconds, 3600.0) * line.rate), round((last + 1) * line.rate / session.rate), 1)
        line.frames = frames
        line.seek(line.frame)
    for number, (frame, _) in enumerate(session.keys):
        if number % 6:
            imgui.same_line()
        text = f"[{frame}]" if frame == session.frame else f"{frame}"
        if imgui.small_button(f"{text}##key{frame}"):
            line.playing = False
            line.seek(int((frame + 0.5) * line.rate / session.rate))
        window.panels.mark(f"key {frame}")
    if session.unkeyed:
        imgui.text_disabled("changed here, and no key yet")


def library_panel(window: "Window") -> None:
    """Poses to take; the pose in hand to keep under a name; files."""
    tool = _tool(window)
    assert window.panels is not None
    typed = tool.typed
    imgui.set_next_item_width(-1)
    if imgui.begin_combo("##library", "take a pose", imgui.ComboFlags_.height_large):
        for name in tool.library.names():
            if imgui.selectable(f"{name}##pose", False)[0]:
                tool.tried(partial(tool.take, name))
                typed["name"] = "" if name in BUILTIN else name
            window.panels.mark(f"take {name}")
        imgui.end_combo()
    window.panels.mark("library")
    typed["name"] = imgui.input_text("name", typed["name"])[1]
    window.panels.mark("name")
    _button(window, "Keep", lambda: tool.keep(typed["name"]))
    if typed["name"] and typed["name"] not in BUILTIN and (tool.library.folder / f"{typed['name']}.npz").is_file():
        _button(window, "Delete", lambda: tool.library.delete(typed["name"]), name="delete pose", beside=True)
    imgui.separator()
    typed["file"] = imgui.input_text_with_hint("file", "name.npz", typed["file"])[1]
    window.panels.mark("file")

    def save() -> None:
        window.say(tool.session.save(typed["file"] or free_name("selfscan-pose", ".npz")) + " written")

    def load() -> None:
        for note in tool.session.load(typed["file"]):
            window.say(note)
        tool.show_frame()

    _button(window, "Save keys" if tool.session.keys else "Save pose", save, name="save")
    _button(window, "Load", load, beside=True)


POSE_PANELS = (
    ("Pose", pose_panel),
    ("Joint", joint_panel),
    ("Hands", hands_panel),
    ("Reach", reach_panel),
    ("Keyframes", keys_panel),
    ("Library and files", library_panel),
)
