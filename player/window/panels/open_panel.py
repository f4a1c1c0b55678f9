"""The list of files to open, over the picture: those that were opened before, and those of a folder."""

from pathlib import Path

from imgui_bundle import imgui

from avatar.motion.read import BUILTIN_MOTIONS
from player.scene.scene import BUILTIN_AVATARS
from player.window import actions
from player.window.opening import KINDS
from player.window.panels.widgets import Widgets
from player.window.parts import WindowParts

# letters' heights, and share of the window at most
SIZE, SHARE = (56.0, 32.0), 0.92
# a narrower picture leaves it the whole window
NARROW = 28.0
# width of the column that says what a file is
KIND = 5.0
TITLE = (0.6, 0.75, 0.95, 1.0)
FLAGS = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_saved_settings | imgui.WindowFlags_.no_move


def open_panel(ui: Widgets, parts: WindowParts) -> None:
    """Two columns: on the left what was opened before and what travels with the program, on the right a folder."""
    letter, layout = imgui.get_font_size(), parts.state.layout
    left, top, wide, high = (length / layout.screen.scale for length in layout.area)
    if wide < NARROW * letter:
        left, wide = 0.0, imgui.get_io().display_size.x
    size = (min(SIZE[0] * letter, SHARE * wide), min(SIZE[1] * letter, SHARE * high))
    imgui.set_next_window_pos((left + 0.5 * wide, top + 0.5 * high), 0, (0.5, 0.5))
    imgui.set_next_window_size(size)
    imgui.set_next_window_bg_alpha(1.0)
    if imgui.begin("##open", None, FLAGS)[0]:
        room = imgui.get_content_region_avail()
        for name, across, draw in (("before", 0.4 * room.x, _before), ("folder", 0.0, _folder)):
            imgui.begin_child(f"##{name}", (across, room.y - 2 * letter))
            draw(ui, parts)
            imgui.end_child()
            imgui.same_line()
        imgui.new_line()
        ui.action("Close", actions.OPEN, parts, name="close list")
        imgui.same_line()
        imgui.text_disabled("or drop a file on the window")
    imgui.end()


def _before(ui: Widgets, parts: WindowParts) -> None:
    opening = parts.opening
    imgui.text_colored(TITLE, "Opened before")
    for number, path in enumerate(opening.recent):
        kind = KINDS.get(Path(path).suffix.lower(), "")
        if _row(ui, Path(path).name, kind, f"Open {path}", f"recent {number}"):
            opening.ask(path)
    if not opening.recent:
        imgui.text_disabled("nothing yet")
    imgui.text("")
    imgui.text_colored(TITLE, "Comes with the program")
    for name in BUILTIN_AVATARS + BUILTIN_MOTIONS:
        kind = "motion" if name in BUILTIN_MOTIONS else "avatar"
        if _row(ui, name, kind, f"Open the {kind} {name}.", f"own {name}"):
            opening.ask(name)


def _folder(ui: Widgets, parts: WindowParts) -> None:
    opening = parts.opening
    imgui.text_colored(TITLE, "In the folder")
    imgui.same_line()
    ui.path("", str(opening.folder))
    if _row(ui, "..", "folder", "The folder around this one.", "folder around"):
        opening.go(opening.folder.parent)
        return
    for path, kind in opening.files:
        if _row(ui, path.name, kind, f"Open {path}", f"file {path.name}"):
            opening.go(path) if kind == "folder" else opening.ask(str(path))
            return


def _row(ui: Widgets, text: str, kind: str, tip: str, name: str) -> bool:
    """What a file is, and its name to choose."""
    imgui.text_disabled(kind)
    imgui.same_line(KIND * imgui.get_font_size())
    return ui.row(text, tip, name=name)
