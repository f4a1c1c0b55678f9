"""The panel of a face that is posed by hand: a slider for each of its shapes, by region, and where the eyes look."""

import re
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

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
    """Gaze and shapes, by region; `slider` draws one, as other panels do (pose_panel.py)."""

    def __init__(self, ui: Widgets, slider: Callable[..., None]):
        self.ui, self._slider = ui, slider
        # the sliders of the left side move the right side too
        self.both_sides = True

    def draw(self, edit: PoseEdit) -> None:
        """Sliders of gaze and shapes, by region."""
        ui, session, gaze = self.ui, edit.session, edit.session.pose.gaze
        if ui.button("Reset face", "The whole face at rest.", name="reset face"):
            session.set_face(np.zeros(len(SHAPES)), np.zeros((2, 2)))
        tip = "On: a slider moves both sides. Off: each side has its own."
        self.both_sides = ui.checkbox("both sides", self.both_sides, tip, beside=True)
        for k, (name, span, tip) in enumerate((
            ("look aside", (-YAW, YAW), "Where both eyes look: to the person's left, or right below 0."),
            ("look up", (-DOWN, UP), "Where both eyes look: up, or down below 0."),
        )):  # fmt: skip
            low, high, value = (float(np.degrees(angle)) for angle in (*span, gaze[:, k].mean()))

            def look(value: float, mark: object, k: int = k) -> None:
                turned = gaze.copy()
                turned[:, k] = np.radians(value)
                session.set_face(session.pose.weights, turned, drag=mark)

            self._slider(edit, f"{name}: %.0f deg", value, (low, high), tip, look, name=name)
        for region, begins in REGIONS.items():
            shapes = [number for number, name in enumerate(SHAPES) if name.startswith(begins)]
            if self.both_sides:
                # each pair once, by its left one
                shapes = [number for number in shapes if not (SHAPES[number].endswith("Right") and paired(number))]
            tip = f"What the person's {region.lower()} do: {len(shapes)} sliders."
            ui.fold(region, tip, partial(self._region, edit, shapes))

    def _region(self, edit: PoseEdit, shapes: Sequence[int]) -> None:
        session = edit.session
        for shape in shapes:
            both, name = self.both_sides and paired(shape), SHAPES[shape]
            moved = [shape, PARTNERS[shape]] if both else [shape]

            def change(value: float, mark: object, moved: Sequence[int] = moved) -> None:
                weights = session.pose.weights.copy()
                weights[moved] = value
                session.set_face(weights, session.pose.gaze, drag=mark)

            shown = words(name).removesuffix(" left") if both else words(name)
            tip = f"{shown[0].upper()}{shown[1:]}: 0 at rest, 1 all of it. ARKit calls it {name}."
            value = float(session.pose.weights[shape])
            self._slider(edit, f"{shown}: %.2f", value, (0.0, 1.0), tip, change, name=name)


def paired(shape: int) -> bool:
    """Whether both sides have the shape; the jaw and the mouth as a whole go to either side with one of their own."""
    return PARTNERS[shape] != shape and SHAPES[shape] not in ("jawLeft", "jawRight", "mouthLeft", "mouthRight")


def words(shape: str) -> str:
    """A shape's name as words: "eyeBlinkLeft" is "eye blink left"."""
    return re.sub("(?=[A-Z])", " ", shape).lower()
