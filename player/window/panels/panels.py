"""The panels around the picture: Dear ImGui's context, its input, and where each panel stands.

On the left what is shown and how, at the bottom time, on the right posing; the picture keeps the middle. A panel is a
function in its own file, of the widgets (player/window/panels/widgets.py) and of the parts of the window that it shows.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import glfw
import imgui_bundle
import moderngl
from imgui_bundle import imgui

from player.window import keyboard
from player.window.panels.draw import DrawLists
from player.window.panels.hud_panel import hud_panel, joint_mark, key_list, status_line
from player.window.panels.open_panel import open_panel
from player.window.panels.pose_overlay import pose_overlay, rings
from player.window.panels.pose_panel import PosePanels
from player.window.panels.side_panels import (
    avatars_panel,
    camera_panel,
    files_panel,
    live_panel,
    look_panel,
    more_panel,
)
from player.window.panels.timeline_panel import timeline_panel
from player.window.panels.widgets import Widgets
from player.window.parts import WindowParts
from player.window.screen import LETTER, density

# width and height of the panels, in letters' heights
SIDE, BOTTOM = 20.5, 4.5
# letters' heights of a label beside its widget
LABEL = 8.0
# letters' heights that the picture must keep, else there are no panels
LEAST = 12.0
# what stands on the left: headings that fold what is under them, their tooltips and panels
SECTIONS = (
    ("Avatars", "Which avatars there are, and where they stand.", avatars_panel),
    ("Live", "Who sends poses, and how late they are.", live_panel),
    ("Camera", "What the picture is seen through.", camera_panel),
    ("Look", "Light, floor and what is behind.", look_panel),
    ("More", "How it is drawn, and what that costs.", more_panel),
)
FIXED = (
    imgui.WindowFlags_.no_move | imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_collapse
    | imgui.WindowFlags_.no_bring_to_front_on_focus | imgui.WindowFlags_.no_saved_settings
)  # fmt: skip
# text fields have shortcuts with these letters
SAME = ("tab", "backspace", "enter", "escape", "delete", "home", "end", "space", *"acvxyz")
KEYS = {keyboard.KEYS[name]: imgui.Key[name] for name in SAME}
KEYS |= {keyboard.KEYS[name]: imgui.Key[f"{name}_arrow"] for name in ("left", "right", "up", "down")}
KEYS[glfw.KEY_KP_ENTER] = imgui.Key.keypad_enter
# in the order of glfw's codes, those of the left before those of the right
HELD = [(side, name) for side in ("left", "right") for name in ("shift", "ctrl", "alt", "super")]
KEYS |= {glfw.KEY_LEFT_SHIFT + k: imgui.Key["_".join(key)] for k, key in enumerate(HELD)}
MODIFIERS = {imgui.Key["_".join(key)]: imgui.Key[f"mod_{key[1]}"] for key in HELD}


class Panels:
    """Everything of Dear ImGui that one window has."""

    def __init__(self, parts: WindowParts):
        self._parts, self._layout = parts, parts.state.layout
        self._layout.borders = self._borders
        self.ui = Widgets()
        self._posing = PosePanels(self.ui, parts)
        context = self._layout.screen.context
        self._imgui = imgui.create_context()
        imgui.set_current_context(self._imgui)
        io = imgui.get_io()
        # nothing is written beside the user's files
        io.set_ini_filename("")
        io.set_log_filename("")
        io.backend_flags |= imgui.BackendFlags_.renderer_has_textures
        imgui.get_platform_io().renderer_texture_max_width = context.gl.info["GL_MAX_TEXTURE_SIZE"]
        imgui.get_platform_io().renderer_texture_max_height = context.gl.info["GL_MAX_TEXTURE_SIZE"]
        self._use_clipboard()
        self._scale = density(self._layout.screen.handle)
        _set_style(self._scale)
        self._lists = DrawLists(context)
        # seconds of the window's clock at the last frame
        self._drawn = 0.0

    @property
    def places(self) -> dict[str, tuple[float, float]]:
        """Middle of each widget of the last frame, window units, by its name."""
        return {name: (0.5 * (x0 + x1), 0.5 * (y0 + y1)) for name, (x0, y0, x1, y1) in self.ui.boxes.items()}

    def _use_clipboard(self) -> None:
        """Text fields copy to and paste from the system's clipboard."""
        # glfw's clipboard belongs to none since 3.4, its types do not know
        no_window: Any = None

        def copied(_context: object) -> str:
            found: Any = glfw.get_clipboard_string(no_window)
            return (found or b"").decode("utf-8", "replace")

        def copy(_context: object, text: str) -> None:
            glfw.set_clipboard_string(no_window, text)

        imgui.get_platform_io().platform_get_clipboard_text_fn = copied
        imgui.get_platform_io().platform_set_clipboard_text_fn = copy

    # -- input; each answers whether a panel took it

    def _io(self) -> imgui.IO:
        imgui.set_current_context(self._imgui)
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
        """Where panels stand is known at once; what lies over the picture (open lists, rings) since the last frame."""
        edit = self._parts.posing.edit
        on_panel = not over_picture or (edit is not None and edit.tool.on_ring)
        return self._io().want_capture_mouse or (self._layout.panels_drawn and on_panel)

    def on_key(self, key: int, down: bool) -> bool:
        """A key of glfw's went down or up; whether a text field takes it."""
        io = self._io()
        found = KEYS.get(key)
        if found == imgui.Key.tab and down and not io.want_text_input:
            # outside a text field Tab selects an avatar; here it would begin to type in the next field
            found = None
        if found is not None:
            io.add_key_event(found, down)
            if found in MODIFIERS:
                io.add_key_event(MODIFIERS[found], down)
        return self._layout.panels_drawn and io.want_text_input

    def on_text(self, letter: int) -> None:
        self._io().add_input_character(letter)

    # -- places

    def _borders(self) -> tuple[int, int, int]:
        """Left, right and lower border, pixels: none without panels, and where they would leave too little picture."""
        size, letter = self._layout.screen.size, LETTER * self._scale * self._layout.screen.scale
        left = round(SIDE * letter)
        right, bottom = left if self._parts.posing.edit is not None else 0, round(BOTTOM * letter)
        fits = min(size[0] - left - right, size[1] - bottom) >= LEAST * letter
        return (left, right, bottom) if self._layout.panels_on and fits else (0, 0, 0)

    # -- one frame

    @property
    def typing(self) -> bool:
        """Whether a text field takes the letters."""
        return self._io().want_text_input

    def draw(self, screen: moderngl.Framebuffer, now: float) -> None:
        """Ask the panels what they show, and draw it; `now` is seconds of the window's clock."""
        imgui.set_current_context(self._imgui)
        io, size, (wide, high) = imgui.get_io(), self._layout.screen.size, self._layout.screen.units
        io.display_size = imgui.ImVec2(wide, high)
        io.display_framebuffer_scale = imgui.ImVec2(size[0] / max(wide, 1), size[1] / max(high, 1))
        io.delta_time = min(max(now - self._drawn, 1e-4), 0.25)
        self._drawn = now
        imgui.new_frame()
        self.ui.begin()
        self._layout.panels_drawn = self._borders() != (0, 0, 0)
        if self._layout.panels_drawn:
            self._draw_panels(wide, high)
        else:
            status_line(self._parts)
        if self._layout.help_on:
            key_list(self._parts)
        if self._parts.opening.listed:
            open_panel(self.ui, self._parts)
        imgui.render()
        self._lists.draw(imgui.get_draw_data(), screen, size)

    def _draw_panels(self, wide: int, high: int) -> None:
        """What lies over the picture, and the panels around it. Posing shows in its own way what is selected."""
        letter = LETTER * self._scale
        side, bottom = SIDE * letter, BOTTOM * letter
        ui, parts, edit = self.ui, self._parts, self._parts.posing.edit
        if edit is None:
            joint_mark(parts)
        else:
            pose_overlay(edit.tool, parts.state)
            rings(edit, parts.state)
        hud_panel(parts)

        def left() -> None:
            files_panel(ui, parts)
            for title, tip, panel in SECTIONS:
                there = title != "Live" or parts.state.playback.live
                # what few look for is folded at first
                if there and ui.section(title, tip, opened=title != "More"):
                    panel(ui, parts)

        self._panel("left", (0.0, 0.0, side, high - bottom), left)
        self._panel("time", (0.0, high - bottom, float(wide), bottom), lambda: timeline_panel(ui, parts))
        # a button on the left begins and ends it
        edit = parts.posing.edit
        if edit is not None:
            self._panel("right", (wide - side, 0.0, side, high - bottom), partial(self._posing.draw, edit))

    def _panel(self, name: str, place: tuple[float, float, float, float], draw: Callable[[], None]) -> None:
        """A panel at a place: left, top, width, height in window units."""
        left, top, width, height = place
        imgui.set_next_window_pos((left, top))
        imgui.set_next_window_size((width, max(height, 1.0)))
        if imgui.begin(f"##{name}", None, FIXED | imgui.WindowFlags_.no_title_bar)[0]:
            imgui.push_item_width(-LABEL * LETTER * self._scale)
            draw()
            imgui.pop_item_width()
        imgui.end()

    def release(self) -> None:
        imgui.set_current_context(self._imgui)
        self._lists.release()
        imgui.destroy_context(self._imgui)


def _set_style(scale: float) -> None:
    """Letters and colours; `scale` is window units a usual screen's pixel."""
    font = Path(imgui_bundle.__file__).parent / "assets" / "fonts" / "DroidSans.ttf"
    if font.is_file():
        imgui.get_io().fonts.add_font_from_file_ttf(str(font), LETTER)
    style = imgui.get_style()
    style.font_size_base, style.font_scale_dpi = LETTER, scale
    style.scale_all_sizes(scale)
    style.window_rounding = style.frame_rounding = 3 * scale
    style.set_color_(imgui.Col_.window_bg, (0.11, 0.12, 0.14, 0.97))
    style.set_color_(imgui.Col_.popup_bg, (0.11, 0.12, 0.14, 1.0))
    style.set_color_(imgui.Col_.frame_bg, (0.2, 0.22, 0.26, 1.0))
