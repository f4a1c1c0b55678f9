"""Dear ImGui's widgets as the panels use them: each has a tooltip, and a name by which scripts find it.

A widget answers with its new value, or None (a button: False) where nothing happened. A button that does what a key
does is made from the table of keys and shows the key.
"""

from collections.abc import Callable, Sequence
from pathlib import PurePath
from typing import TypeVar

from imgui_bundle import imgui

from command.errors import unicode_text
from player.window.actions import Action
from player.window.parts import WindowParts

Span = tuple[float, float]
Box = tuple[float, float, float, float]
Value = TypeVar("Value")
# letters' heights at which a tooltip's line ends
TIP_WIDTH = 22.0


class Widgets:
    """The widgets of one window, and where those of the last frame were."""

    def __init__(self):
        # triangles that show what is under them
        self._unfolded: set[str] = set()
        self.begin()

    def begin(self) -> None:
        """A new frame."""
        # left, top, right and bottom of each widget of the frame with its label, window units, and its tooltip
        self.boxes: dict[str, Box] = {}
        self.tips: dict[str, str] = {}

    def _done(self, name: str, tip: str) -> None:
        """The last widget is `name`; `tip` is shown while the pointer rests on it."""
        low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        self.boxes[name] = (low.x, low.y, high.x, high.y)
        self.tips[name] = tip
        if tip and imgui.begin_item_tooltip():
            imgui.push_text_wrap_pos(TIP_WIDTH * imgui.get_font_size())
            imgui.text_unformatted(unicode_text(tip))
            imgui.pop_text_wrap_pos()
            imgui.end_tooltip()

    def _changed(self, found: tuple[bool, Value], name: str, tip: str) -> Value | None:
        """The new value of the last widget, from Dear ImGui's answer."""
        self._done(name, tip)
        return found[1] if found[0] else None

    # -- buttons

    def button(
        self, text: str, tip: str, *, name: str = "", beside: bool = False, width: float = 0.0, on: bool = False
    ) -> bool:
        """Whether it was pressed. `beside` keeps it on the line, where it fits; `on` is what is chosen now."""
        if beside:
            _stay_on_line(text, width)
        color = imgui.Col_.button_active if on else imgui.Col_.button
        imgui.push_style_color(imgui.Col_.button, imgui.get_style().color_(color))
        pressed = imgui.button(f"{text}##{name}", (width, 0))
        imgui.pop_style_color()
        self._done(name or text.lower(), tip)
        return pressed

    def action(
        self, text: str, action: Action, parts: WindowParts, *, name: str = "", beside: bool = False, width: float = 0.0
    ) -> None:
        """A button that does what a key does."""
        if self.button(text, tip_of(action), name=name, beside=beside, width=width):
            action.do(parts)

    # -- values

    def checkbox(self, text: str, on: bool, tip: str, *, name: str = "", beside: bool = False) -> bool:
        """Whether it is on now."""
        if beside:
            _stay_on_line(text, imgui.get_frame_height())
        on = imgui.checkbox(text, on)[1]
        self._done(name or text, tip)
        return on

    def choice(
        self, label: str, chosen: int, known: Sequence[str], tip: str, *, name: str = "", width: float | None = None
    ) -> int | None:
        """One of a short list."""
        if width is not None:
            imgui.set_next_item_width(width)
        return self._changed(imgui.combo(f"{label}##{name}", chosen, list(known)), name or label, tip)

    def slider(
        self, label: str, value: float, span: Span, tip: str, *, name: str = "", form: str = "%.0f deg"
    ) -> float | None:
        return self._changed(imgui.slider_float(f"{label}##{name}", value, *span, form), name or label, tip)

    def scrubber(self, frame: int, last: int, tip: str) -> int | None:
        """The long slider of the timeline."""
        imgui.set_next_item_width(-1)
        return self._changed(imgui.slider_int("##scrub", frame, 0, last, ""), "scrub", tip)

    def numbers(self, label: str, values: Sequence[float], tip: str, *, name: str) -> list[float] | None:
        """Three numbers that are dragged or typed."""
        numbers = [float(value) for value in values]
        return self._changed(imgui.drag_float3(f"{label}##{name}", numbers, 0.01, -100.0, 100.0, "%.2f"), name, tip)

    def number(self, label: str, value: float, tip: str, *, name: str) -> float | None:
        """A number to type, or to step by one or by five."""
        return self._changed(imgui.input_float(f"{label}##{name}", value, 1.0, 5.0, "%.2f"), name, tip)

    def color(self, label: str, color: Sequence[float], tip: str, *, name: str) -> list[float] | None:
        return self._changed(imgui.color_edit3(f"{label}##{name}", list(color)), name, tip)

    def field(self, label: str, text: str, tip: str, *, hint: str = "") -> str:
        """A field of text; what is in it now."""
        text = imgui.input_text_with_hint(label, hint, text)[1]
        self._done(label, tip)
        return text

    # -- lists and folds

    def row(self, text: str, tip: str, *, name: str, selected: bool = False) -> bool:
        """A line to choose; whether it was."""
        chosen = imgui.selectable(unicode_text(f"{elided(text)}##{name}"), selected)[0]
        self._done(name, tip)
        return chosen

    def long_choice(self, name: str, preview: str, tip: str, rows: Callable[[], None]) -> None:
        """A list that opens; `rows` are drawn while it is open."""
        imgui.set_next_item_width(-1)
        opened = imgui.begin_combo(f"##{name}", preview, imgui.ComboFlags_.height_large)
        if opened:
            rows()
            imgui.end_combo()
        self._done(name, tip)

    def section(self, title: str, tip: str, *, opened: bool = True) -> bool:
        """A heading that folds what is under it, at first `opened`; whether that is to be drawn."""
        opened = imgui.collapsing_header(title, imgui.TreeNodeFlags_.default_open if opened else 0)
        self._done(title, tip)
        return opened

    def triangle(self, name: str, tip: str) -> bool:
        """Before the next widget of the line: shows or hides what is under it; whether that is to be drawn."""
        imgui.push_style_color(imgui.Col_.button, (0, 0, 0, 0))
        if imgui.arrow_button(f"##{name}", imgui.Dir.down if name in self._unfolded else imgui.Dir.right):
            self._unfolded ^= {name}
        imgui.pop_style_color()
        self._done(name, tip)
        imgui.same_line(0, imgui.get_style().item_inner_spacing.x)
        return name in self._unfolded

    def no_triangle(self) -> None:
        """The room of one, so that lists without numbers stand below those with them."""
        imgui.dummy((imgui.get_frame_height(), imgui.get_frame_height()))
        imgui.same_line(0, imgui.get_style().item_inner_spacing.x)

    def fold(self, title: str, tip: str, rows: Callable[[], None]) -> None:
        """What is drawn only when it is unfolded."""
        opened = imgui.tree_node(title)
        self._done(title, tip)
        if opened:
            rows()
            imgui.tree_pop()

    # -- text

    def caption(self, text: str) -> None:
        """A few words under the last widget, as many lines as they need; none where there are no words."""
        if text:
            imgui.push_style_color(imgui.Col_.text, imgui.get_style().color_(imgui.Col_.text_disabled))
            imgui.indent(imgui.get_frame_height())
            imgui.text_wrapped(text)
            imgui.unindent(imgui.get_frame_height())
            imgui.pop_style_color()

    def path(self, label: str, path: str) -> None:
        """A file of which as much is shown as fits, its name first; the whole in the tooltip."""
        room = imgui.get_content_region_avail().x - imgui.calc_text_size(label).x
        imgui.text_disabled(label + elided(path, room))
        self._done(f"path {label.strip(' :')}", path)


def tip_of(action: Action) -> str:
    return f"{action.means[0].upper()}{action.means[1:]}.\nKey: {' or '.join(action.shown_keys)}"


def elided(text: str, room: float | None = None) -> str:
    """A path or name that fits the room in window units (None: what is left of the line). First the folders go, from
    the left, then the middle of the name."""
    width = imgui.get_content_region_avail().x if room is None else room

    text = unicode_text(text)

    def fits(cut: str) -> bool:
        return imgui.calc_text_size(cut).x <= width

    if fits(text):
        return text
    parts = PurePath(text).parts
    for first in range(1, len(parts)):
        cut = ".../" + "/".join(parts[first:])
        if fits(cut):
            return cut
    return shortened(parts[-1] if parts else text, fits)


def shortened(text: str, fits: Callable[[str], bool]) -> str:
    """A text, or as much of its beginning and, twice as much, of its end as fits, with dots for its middle."""
    cut = text
    for kept in range(len(text) - 1, 1, -1):
        if fits(cut):
            break
        start = kept // 3
        cut = f"{text[:start]}...{text[len(text) - (kept - start) :]}"
    return cut


def _stay_on_line(text: str, more: float) -> None:
    """The next widget beside the last one, where the panel is wide enough for it."""
    style = imgui.get_style()
    width = imgui.calc_text_size(text).x + more + 3 * style.frame_padding.x
    right = imgui.get_cursor_screen_pos().x + imgui.get_content_region_avail().x
    if imgui.get_item_rect_max().x + style.item_spacing.x + width <= right:
        imgui.same_line()
