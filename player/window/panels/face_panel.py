"""The panel of a face that is posed by hand: a slider for each of its shapes, by region, and where the eyes look."""

import re
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from imgui_bundle import imgui

from avatar.face import PARTNERS, SHAPES
from avatar.gaze import DOWN, UP, YAW
from player.window.panels.widgets import Widgets
from player.window.posing import PoseEdit

# the regions and how the names of their shapes begin
REGIONS = {
    "Eyes": ("eye",), "Brows": ("brow",), "Jaw and tongue": ("jaw", "tongue"), "Mouth": ("mouth",),
    "Cheeks and nose": ("cheek", "nose"),
}  # fmt: skip


class FacePanel:
    """Sliders whose whole drags are one step of undo each."""

    def __init__(self, ui: Widgets):
        self.ui = ui
        # the sliders of the left side move the right side too
        self.both_sides = True

    def draw(self, edit: PoseEdit) -> None:
        """Gaze and shapes as sliders, by region."""
        ui, session, gaze = self.ui, edit.session, edit.session.pose.gaze
        if ui.button("Reset face", "The whole face at rest.", name="reset face"):
            session.set_face(np.zeros(len(SHAPES)), np.zeros((2, 2)))
        tip = "On: a slider moves both sides. Off: each side has its own."
        self.both_sides = ui.checkbox("both sides", self.both_sides, tip, beside=True)
        for k, (name, span, tip) in enumerate((
            ("look aside", (-YAW, YAW), "Where both eyes look: to the person's left, or right below 0."),
            ("look up", (-DOWN, UP), "Where both eyes look: up, or down below 0."),
        )):  # fmt: skip
            degrees = tuple(float(np.degrees(end)) for end in span)
            value = float(np.degrees(gaze[:, k].mean()))

            def look(value: float, k: int = k, name: str = name) -> None:
                turned = gaze.copy()
                turned[:, k] = np.radians(value)
                session.set_face(session.pose.weights, turned, drag=name)

            self._slider(edit, f"{name}: %.0f deg", value, (degrees[0], degrees[1]), tip, look, name)
        for region, begins in REGIONS.items():
            shapes = [number for number, name in enumerate(SHAPES) if name.startswith(begins)]
            if self.both_sides:
                # each pair once, by its left one
                shapes = [number for number in shapes if not (SHAPES[number].endswith("Right") and paired(number))]
            tip = f"What the person's {region.lower()} do: {len(shapes)} sliders."
            ui.fold(region, tip, partial(self._region, edit, shapes))

    def _region(self, edit: PoseEdit, shapes: Sequence[int]) -> None:
        for shape in shapes:
            self._shape(edit, shape)

    def _shape(self, edit: PoseEdit, shape: int) -> None:
        session, name = edit.session, words(SHAPES[shape])
        both = self.both_sides and paired(shape)
        moved = [shape, PARTNERS[shape]] if both else [shape]

        def change(value: float) -> None:
            weights = session.pose.weights.copy()
            weights[moved] = value
            session.set_face(weights, session.pose.gaze, drag=SHAPES[shape])

        shown = name.removesuffix(" left") if both else name
        tip = f"{shown[0].upper()}{shown[1:]}: 0 at rest, 1 all of it. ARKit calls it {SHAPES[shape]}."
        self._slider(edit, f"{shown}: %.2f", float(session.pose.weights[shape]), (0.0, 1.0), tip, change, SHAPES[shape])

    def _slider(
        self, edit: PoseEdit, form: str, value: float, span: tuple[float, float], tip: str,
        change: Callable[[float], None], name: str,
    ) -> None:  # fmt: skip
        imgui.set_next_item_width(-1)
        new = self.ui.slider("", value, span, tip, name=name, form=form)
        if new is not None:
            change(new)
        if imgui.is_item_deactivated():
            edit.session.history.end_drag()


def paired(shape: int) -> bool:
    """Whether both sides have the shape; the jaw and the mouth as a whole go to either side with one of their own."""
    return PARTNERS[shape] != shape and SHAPES[shape] not in ("jawLeft", "jawRight", "mouthLeft", "mouthRight")


def words(shape: str) -> str:
    """A shape's name as words: "eyeBlinkLeft" is "eye blink left"."""
    return re.sub("(?=[A-Z])", " ", shape).lower()
