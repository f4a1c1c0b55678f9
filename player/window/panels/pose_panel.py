"""The panels of posing: the whole pose and its file, a joint's angles, hands, reach, the library."""

from collections.abc import Callable
from functools import partial
from math import radians

import numpy as np
from imgui_bundle import imgui

from avatar.limits import joint_angles, limits
from avatar.motion.fingers import FINGERS
from player.pose.fingers import CURL_RANGE, PRESETS, SPREAD_RANGE, Side, finger_name, hand_shape
from player.pose.ik import LIMBS
from player.pose.library import BUILTIN
from player.pose.mirror import PARTNER, hand_joints, limb_of
from player.window import actions
from player.window.panels.face_panel import FacePanel
from player.window.panels.widgets import Widgets
from player.window.parts import WindowParts
from player.window.posing import PoseEdit
from player.window.state import joint_name

SIDES: tuple[Side, Side] = ("left", "right")
# the list of joints shows fingers last
ORDER = sorted(range(52), key=lambda joint: (joint >= 22, joint))
# fingers from the thumb on
FROM_THUMB = (4, 0, 1, 3, 2)
DEGREES = (-180.0, 180.0)
Change = Callable[[float, object], object]


class PosePanels:
    """The panels on the right while an avatar is posed by hand."""

    def __init__(self, ui: Widgets, parts: WindowParts):
        self.ui, self.parts, self.face = ui, parts, FacePanel(ui, self._slider)

    def draw(self, edit: PoseEdit) -> None:
        """All panels, each under its heading."""
        for title, tip, panel in (
            ("Pose", "The whole pose, and its file.", self._pose),
            ("Joint", "The selected joint and its angles.", self._joint),
            ("Hands", "Hand shapes by name, and each finger.", self._hands),
            ("Reach", "How hands and feet are pulled, and which stay where they are.", self._reach),
            *([("Face", "What the face does, and where the eyes look.", self.face.draw)] if edit.avatar.eyes else []),
            ("Library", "Poses to take, and your own to keep.", self._library),
        ):
            if self.ui.section(title, tip):
                panel(edit)

    def _button(self, edit: PoseEdit, text: str, tip: str, act: Callable[[], object], *, name="", beside=False) -> None:
        """A button that does what may be refused."""
        if self.ui.button(text, tip, name=name, beside=beside):
            edit.tried(act)

    def _slider(
        self, edit: PoseEdit, form: str, value: float, span: tuple[float, float], tip: str, change: Change, *, name: str
    ) -> None:
        """A slider whose whole drag is one step of undo: the session gets the same mark until it is let go. Its name
        is inside (`form`), where the longest has room."""
        imgui.set_next_item_width(-1)
        new = self.ui.slider("", value, span, tip, name=name, form=form)
        if new is not None:
            edit.tried(lambda: change(new, name))
        if imgui.is_item_deactivated():
            edit.session.history.end_drag()

    def _pose(self, edit: PoseEdit) -> None:
        """Undo and redo, the file, limits, axes; what is done to the whole pose."""
        ui, parts, session = self.ui, self.parts, edit.session
        ui.action("Undo", actions.UNDO, parts)
        ui.action("Redo", actions.REDO, parts, beside=True)
        ui.action("Mirror", actions.MIRROR, parts, beside=True)
        ui.action("To ground", actions.TO_GROUND, parts, name="ground", beside=True)
        tip = "Keep joints within the range of healthy adults."
        session.limited = ui.checkbox("limits", session.limited, tip)
        tip = "On: the rings turn about x, y and z of the world. Off: about the bone's own axes."
        world = ui.checkbox("world axes", edit.tool.frame == "world", tip, beside=True)
        edit.tool.frame = "world" if world else "local"
        tip = "The .npz file (AMASS) to save or load; empty saves to a new one, selfscan-pose-000.npz."
        edit.file = ui.field("file", edit.file, tip, hint="name.npz")
        self._button(edit, "Save pose", "Write the pose to the file.", edit.save, name="save")
        self._button(edit, "Load", "Take the pose of the file, of a motion its first.", edit.load, beside=True)
        if session.history.dirty:
            imgui.same_line()
            imgui.text_disabled("not saved")

    def _joint(self, edit: PoseEdit) -> None:
        """The selected joint: a list to choose from and its three angles."""
        ui, parts, session, joint, table = self.ui, self.parts, edit.session, edit.tool.joint, limits()

        def joints() -> None:
            for other in ORDER:
                name = joint_name(other)
                if ui.row(name, f"Select {name}.", name=name, selected=other == joint):
                    parts.state.selection.choose(edit.index, other)

        preview = "click a joint, or choose" if joint is None else joint_name(joint)
        ui.long_choice(
            "joint", preview, "The joint that rings and sliders turn. Click one in the picture, too.", joints
        )
        if joint is None:
            return
        angles = joint_angles(session.pose.axis_angle)[joint]
        low, high = np.degrees(table.low[joint]), np.degrees(table.high[joint])
        for k, text in enumerate(table.names[joint]):
            span = (float(low[k]), float(high[k])) if session.limited else DEGREES
            tip = f"{text} of the {joint_name(joint)}; people reach {low[k]:.0f} to {high[k]:.0f} degrees."
            self._slider(edit, f"{text}: %.0f deg", shown_degrees(angles[k]), span, tip,
                         lambda value, mark: session.set_angle(joint, k, radians(value), drag=mark),
                         name=f"angle {k}")  # fmt: skip
        self._button(edit, "Reset joint", "This joint as in the T-pose.", lambda: session.reset([joint]))
        if joint:
            self._button(edit, "Reset limb", "The joint's whole limb as in the T-pose.",
                         lambda: session.reset(limb_of(joint)), beside=True)  # fmt: skip
        if PARTNER[joint] != joint:
            self._button(edit, "Other side too", "The other side's limb does the same, mirrored.",
                         lambda: session.to_other_side(limb_of(joint)), name="other side", beside=True)  # fmt: skip

    def _hands(self, edit: PoseEdit) -> None:
        """Hand shapes by name for either hand, then each finger."""
        for side in SIDES:
            imgui.text(f"{side} hand")
            for number, name in enumerate(PRESETS):
                self._button(
                    edit, name, f"The {side} hand: {name}.",
                    lambda side=side, name=name: edit.session.set_hand(side, PRESETS[name]),
                    name=f"{side} {name}", beside=number > 0,
                )  # fmt: skip
            self.ui.fold(
                f"{side} fingers",
                f"Curl and spread of each finger of the {side} hand.",
                lambda side=side: self._fingers(edit, side),
            )

    def _fingers(self, edit: PoseEdit, side: Side) -> None:
        session = edit.session
        shape = hand_shape(session.pose.axis_angle, side)
        low, high = np.degrees(SPREAD_RANGE)
        for finger in FROM_THUMB:
            change, name = partial(session.set_finger, side, finger), finger_name(finger)
            self._slider(
                edit, f"{name}: %.2f", shape.curl[finger], CURL_RANGE, f"Curl of the {name}: 0 straight, 1 a fist.",
                lambda value, mark: change(curl=value, drag=mark), name=f"{side} curl {FINGERS[finger]}",
            )  # fmt: skip
            self._slider(
                edit, f"{name} spread: %.0f deg", shown_degrees(shape.spread[finger]), (float(low), float(high)),
                f"Spread of the {name} sideways.", lambda value, mark: change(spread=radians(value), drag=mark),
                name=f"{side} spread {FINGERS[finger]}",
            )  # fmt: skip
        self._button(edit, "Other hand too", "The other hand does the same, mirrored.",
                     lambda: session.to_other_side(hand_joints(side)), name=f"{side} other")  # fmt: skip

    def _reach(self, edit: PoseEdit) -> None:
        """How hands and feet are pulled, and which are held in place while the body moves."""
        ui = self.ui
        imgui.text_wrapped("Drag squares: hands and feet. Diamond: the body. Rings: elbows and knees.")
        tip = "On: hands and feet turn with forearm and shin. Off: they stay turned as they are in the room."
        edit.tool.follow = ui.checkbox("hands and feet turn along", edit.tool.follow, tip, name="turn along")
        for number, limb in enumerate(LIMBS):
            name = limb.replace("_", " ")
            tip = f"The {name} stays where it is while the body moves."
            on = ui.checkbox(f"pin {name}", limb in edit.session.pinned, tip, beside=bool(number % 2))
            if on != (limb in edit.session.pinned):
                edit.session.pin(limb, on)

    def _library(self, edit: PoseEdit) -> None:
        """Poses to take; the present pose to keep under a name."""
        ui, library = self.ui, edit.library

        def poses() -> None:
            for name in library.names():
                if ui.row(name, f"Take the pose {name}, set on the ground.", name=f"take {name}"):
                    edit.tried(lambda name=name: edit.take(name))
                    edit.name = "" if name in BUILTIN else name

        ui.long_choice("library", "take a pose", "Built-in poses and your own.", poses)
        edit.name = ui.field("name", edit.name, "The name under which the pose is kept.")
        self._button(edit, "Keep", f"Keep the pose in {library.folder}.", lambda: edit.keep(edit.name))
        if edit.name and edit.name not in BUILTIN and (library.folder / f"{edit.name}.npz").is_file():
            self._button(edit, "Delete", "Delete this pose from the library.", lambda: library.delete(edit.name),
                         name="delete pose", beside=True)  # fmt: skip


def shown_degrees(angle: float) -> float:
    """Radians as degrees that are shown without decimals, never as -0."""
    degrees = float(np.degrees(angle))
    return 0.0 if abs(degrees) < 0.5 else degrees
