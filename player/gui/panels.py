"""The panels around the picture: Dear ImGui's context, its input, and where each panel stands.

On the left what is shown and how, at the bottom time, on the right what was opened (posing); the picture keeps the
middle. A panel is a function of the window, in its own file; it calls `window.panels.mark` after a widget that
scripts should find by name.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import glfw
import imgui_bundle
import moderngl
from imgui_bundle import imgui

from player.context import Context
from player.gui.avatars_panel import avatars_panel
from player.gui.camera_panel import camera_panel
from player.gui.draw import DrawLists
from player.gui.hud_panel import hud_panel, joint_mark
from player.gui.live_panel import live_panel
from player.gui.pose_overlay import pose_overlay
from player.gui.pose_panel import POSE_PANELS
from player.gui.timeline_panel import timeline_panel
from player.gui.view_panel import view_panel

if TYPE_CHECKING:
    from player.window.window import Area, Window

Panel = Callable[["Window"], None]

LEFT: Sequence[tuple[str, Panel, Callable[["Window"], bool]]] = (
    ("Avatars", avatars_panel, lambda window: True),
    ("Live", live_panel, lambda window: bool(window.playback.live)),
    ("Camera", camera_panel, lambda window: True),
    ("View", view_panel, lambda window: True),
)
# shown at the right while `window.pose_session` is there; overlays are drawn over the picture, under the panels
RIGHT: Sequence[tuple[str, Panel]] = POSE_PANELS
OVERLAYS: Sequence[Panel] = (joint_mark, pose_overlay, hud_panel)

FONT = 15.0  # window units
# width and height of the panels, in letters' heights
SIDE, BOTTOM = 19.0, 4.5
# letters' heights that the picture must keep, else there are no panels
LEAST = 12.0
FIXED = (
    imgui.WindowFlags_.no_move | imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_collapse
    | imgui.WindowFlags_.no_bring_to_front_on_focus | imgui.WindowFlags_.no_saved_settings
)  # fmt: skip
SPECIAL = {
    glfw.KEY_TAB: imgui.Key.tab, glfw.KEY_BACKSPACE: imgui.Key.backspace, glfw.KEY_ENTER: imgui.Key.enter,
    glfw.KEY_KP_ENTER: imgui.Key.keypad_enter, glfw.KEY_ESCAPE: imgui.Key.escape, glfw.KEY_DELETE: imgui.Key.delete,
    glfw.KEY_LEFT: imgui.Key.left_arrow, glfw.KEY_RIGHT: imgui.Key.right_arrow, glfw.KEY_UP: imgui.Key.up_arrow,
    glfw.KEY_DOWN: imgui.Key.down_arrow, glfw.KEY_HOME: imgui.Key.home, glfw.KEY_END: imgui.Key.end,
    glfw.KEY_LEFT_CONTROL: imgui.Key.left_ctrl, glfw.KEY_RIGHT_CONTROL: imgui.Key.right_ctrl,
    glfw.KEY_LEFT_SHIFT: imgui.Key.left_shift, glfw.KEY_RIGHT_SHIFT: imgui.Key.right_shift,
    glfw.KEY_LEFT_ALT: imgui.Key.left_alt, glfw.KEY_RIGHT_ALT: imgui.Key.right_alt,
    glfw.KEY_LEFT_SUPER: imgui.Key.left_super, glfw.KEY_RIGHT_SUPER: imgui.Key.right_super,
    glfw.KEY_SPACE: imgui.Key.space,
}  # fmt: skip
MODIFIERS = {
    imgui.Key.left_ctrl: imgui.Key.mod_ctrl, imgui.Key.right_ctrl: imgui.Key.mod_ctrl,
    imgui.Key.left_shift: imgui.Key.mod_shift, imgui.Key.right_shift: imgui.Key.mod_shift,
    imgui.Key.left_alt: imgui.Key.mod_alt, imgui.Key.right_alt: imgui.Key.mod_alt,
    imgui.Key.left_super: imgui.Key.mod_super, imgui.Key.right_super: imgui.Key.mod_super,
}  # fmt: skip
LETTERS = {ord(letter.upper()): getattr(imgui.Key, letter) for letter in "acvxyz"}  # those of text fields' shortcuts


class Panels:
    """Everything of Dear ImGui that one window has."""

    def __init__(self, context: Context, handle: Any):
        self.handle = handle
        self.imgui = imgui.create_context()
        imgui.set_current_context(self.imgui)
        self.visible = True  # switched on
        self.drawn = False  # in the last frame
        self.places: dict[str, tuple[float, float]] = {}  # middle of each marked widget of the last frame, window units
        self._marking: dict[str, tuple[float, float]] = {}
        io = imgui.get_io()
        io.set_ini_filename("")  # nothing is written beside the user's files
        io.set_log_filename("")
        io.backend_flags |= imgui.BackendFlags_.renderer_has_textures
        imgui.get_platform_io().renderer_texture_max_width = context.gl.info["GL_MAX_TEXTURE_SIZE"]
        imgui.get_platform_io().renderer_texture_max_height = context.gl.info["GL_MAX_TEXTURE_SIZE"]
        self._use_clipboard()
        font = Path(imgui_bundle.__file__).parent / "assets" / "fonts" / "DroidSans.ttf"
        if font.is_file():
            io.fonts.add_font_from_file_ttf(str(font), FONT)
        self.scale = density(handle)
        style = imgui.get_style()
        style.font_size_base, style.font_scale_dpi = FONT, self.scale
        style.scale_all_sizes(self.scale)
        style.window_rounding = style.frame_rounding = 3 * self.scale
        style.set_color_(imgui.Col_.window_bg, imgui.ImVec4(0.11, 0.12, 0.14, 0.97))
        style.set_color_(imgui.Col_.popup_bg, imgui.ImVec4(0.11, 0.12, 0.14, 1.0))
        style.set_color_(imgui.Col_.frame_bg, imgui.ImVec4(0.2, 0.22, 0.26, 1.0))
        self.lists = DrawLists(context)

    def _use_clipboard(self) -> None:
        """Text fields copy to and paste from the system's clipboard."""
        # glfw's clipboard belongs to none since 3.4, its types do not know
        no_window: Any = None

        def copied(_context: Any) -> str:
            found: Any = glfw.get_clipboard_string(no_window)
            return (found or b"").decode("utf-8", "replace")

        def copy(_context: Any, text: str) -> None:
            glfw.set_clipboard_string(no_window, text)

        imgui.get_platform_io().platform_get_clipboard_text_fn = copied
        imgui.get_platform_io().platform_set_clipboard_text_fn = copy

    # -- input; each answers whether a panel took it

    def _io(self) -> imgui.IO:
        imgui.set_current_context(self.imgui)
        return imgui.get_io()

    def on_pointer(self, x: float | int, y: float | int) -> None:
        self._io().add_mouse_pos_event(x, y)

    def on_button(self, button: int, down: bool, over_picture: bool) -> bool:
        if button < 5:
            self._io().add_mouse_button_event(button, down)
        return self.takes_pointer(over_picture)

    def on_wheel(self, clicks: float | int, over_picture: bool) -> bool:
        self._io().add_mouse_wheel_event(0.0, clicks)
        return self.takes_pointer(over_picture)

    def takes_pointer(self, over_picture: bool) -> bool:
        """The panels' places are known at once;
        what lies over the picture (a list that opened) since the last frame.
        """
        return self.drawn and (self._io().want_capture_mouse or not over_picture)

    def on_key(self, key: int, down: bool) -> bool:
        io = self._io()
        found = SPECIAL.get(key) or LETTERS.get(key)
        if found is not None:
            io.add_key_event(found, down)
            if found in MODIFIERS:
                io.add_key_event(MODIFIERS[found], down)
        return self.drawn and io.want_text_input

    def on_text(self, letter: int) -> None:
        self._io().add_input_character(letter)

    # -- places

    def mark(self, name: str) -> None:
        """Remember where the last widget is, so that a script can press it by name."""
        low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        self._marking[name] = (0.5 * (low.x + high.x), 0.5 * (low.y + high.y))

    def area(self, window: "Window", size: tuple[int, int]) -> "Area":
        """What the panels leave of a framebuffer of `size` pixels; all of it where they are hidden."""
        left, right, bottom = self._borders(window, size)
        return left, 0, size[0] - left - right, size[1] - bottom

    def shown(self, window: "Window") -> bool:
        """Whether there are panels: not when switched off, nor when they would leave too little of the picture."""
        return self._borders(window, glfw.get_framebuffer_size(self.handle)) != (0, 0, 0)

    def _borders(self, window: "Window", size: tuple[int, int]) -> tuple[int, int, int]:
        """Left, right and lower border, pixels."""
        letter = FONT * self.scale * size[0] / max(window.size_in_units()[0], 1)
        left = round(SIDE * letter)
        right, bottom = left if shows_right(window) else 0, round(BOTTOM * letter)
        fits = min(size[0] - left - right, size[1] - bottom) >= LEAST * letter
        return (left, right, bottom) if self.visible and fits else (0, 0, 0)

    # -- one frame

    def draw(self, window: "Window", screen: moderngl.Framebuffer, size: tuple[int, int]) -> None:
        """Ask the panels what they show, and draw it."""
        imgui.set_current_context(self.imgui)
        io = imgui.get_io()
        wide, high = window.size_in_units()
        io.display_size = imgui.ImVec2(wide, high)
        io.display_framebuffer_scale = imgui.ImVec2(size[0] / max(wide, 1), size[1] / max(high, 1))
        io.delta_time = min(max(window.frame_times[-1] if window.frame_times else 1 / 60, 1e-4), 0.25)
        imgui.new_frame()
        self._marking = {}
        self.drawn = self.shown(window)
        if self.drawn:
            self._show(window, wide, high)
        self.places = self._marking
        imgui.render()
        self.lists.draw(imgui.get_draw_data(), screen, size)

    def _show(self, window: "Window", wide: int, high: int) -> None:
        letter = FONT * self.scale
        side, bottom = SIDE * letter, BOTTOM * letter
        for overlay in OVERLAYS:
            overlay(window)
        self._place(0, 0, side, high - bottom)
        if imgui.begin("##left", None, FIXED | imgui.WindowFlags_.no_title_bar)[0]:
            imgui.push_item_width(-7.0 * letter)
            for title, panel, wanted in LEFT:
                if wanted(window) and imgui.collapsing_header(title, imgui.TreeNodeFlags_.default_open):
                    panel(window)
            imgui.pop_item_width()
        imgui.end()
        self._place(0, high - bottom, wide, bottom)
        if imgui.begin("##time", None, FIXED | imgui.WindowFlags_.no_title_bar)[0]:
            timeline_panel(window)
        imgui.end()
        if shows_right(window):
            self._place(wide - side, 0, side, high - bottom)
            if imgui.begin("##right", None, FIXED | imgui.WindowFlags_.no_title_bar)[0]:
                imgui.push_item_width(-7.0 * letter)
                for title, panel in RIGHT:
                    if imgui.collapsing_header(title, imgui.TreeNodeFlags_.default_open):
                        panel(window)
                imgui.pop_item_width()
            imgui.end()

    def _place(self, left: float | int, top: float | int, width: float | int, height: float | int) -> None:
        imgui.set_next_window_pos(imgui.ImVec2(left, top))
        imgui.set_next_window_size(imgui.ImVec2(width, max(height, 1.0)))

    def release(self) -> None:
        imgui.set_current_context(self.imgui)
        self.lists.release()
        imgui.destroy_context(self.imgui)


def shows_right(window: "Window") -> bool:
    return bool(RIGHT) and window.pose_session is not None


def density(handle: Any) -> float:
    """How many window units a usual screen's pixel is: where units are pixels, what the system scales text by."""
    scale = glfw.get_window_content_scale(handle)[0]
    units, pixels = glfw.get_window_size(handle)[0], glfw.get_framebuffer_size(handle)[0]
    return min(max(scale * units / max(pixels, 1), 0.5), 4.0) if scale > 0 and units else 1.0
