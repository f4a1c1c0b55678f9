"""The table of keys: what each does, in words and in code. From it come the keys (player/window/keyboard.py), the
help over the picture and in `selfscan play --help` (here, at the end), the tooltips of buttons, and the tables of
docs/play.md and docs/posing.md (experiments/key_docs.py).

An `Action` is one thing that keys do; a button that does the same is made from it. Actions are grouped by when their
keys hold; those of posing go before the others.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import TYPE_CHECKING, NamedTuple

from avatar.skeleton import JOINTS
from player.window.saved_scene import save_scene

if TYPE_CHECKING:
    from player.window.parts import WindowParts
    from player.window.posing import PoseEdit
    from player.window.timeline import Timeline

When = Callable[["WindowParts"], bool]
# columns of a terminal
WIDTH = 112


def _always(_parts: "WindowParts") -> bool:
    return True


@dataclass(frozen=True)
class Action:
    """What keys do: `means` says it in the imperative, small letters. Keys are named as in player/window/keyboard.py,
    with ctrl+ and shift+ before them."""

    means: str
    keys: tuple[str, ...]
    do: Callable[["WindowParts"], object]
    when: When = _always

    @property
    def shown_keys(self) -> tuple[str, ...]:
        """The keys as people write them: Ctrl+Z, space."""
        return tuple(shown_key(key) for key in self.keys)


class KeyGroup(NamedTuple):
    """Actions under one heading; `when` says in which state of the window their keys hold."""

    title: str
    actions: tuple[Action, ...]
    when: When = _always

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Keys, and what they do."""
        return [(", ".join(action.shown_keys), action.means) for action in self.actions]


def shown_key(key: str) -> str:
    """A key's name as people write it."""
    *modifiers, name = key.split("+")
    name = name.upper() if modifiers and len(name) == 1 else ARROWS.get(name, name)
    return "+".join([*(word.capitalize() for word in modifiers), name])


ARROWS = {"left": "left arrow", "right": "right arrow", "escape": "Escape", "delete": "Delete"}
ARROWS |= {key: key.upper() for key in ("f1", "f11")}


def timed(act: Callable[["Timeline"], object]) -> Callable[["WindowParts"], object]:
    """What is done to the timeline."""
    return lambda parts: act(parts.state.timeline)


def toggle_follow(parts: "WindowParts") -> None:
    parts.viewpoint.follow = not parts.viewpoint.follow


def toggle_panels(parts: "WindowParts") -> None:
    parts.state.layout.panels_on = not parts.state.layout.panels_on


def toggle_help(parts: "WindowParts") -> None:
    parts.state.layout.help_on = not parts.state.layout.help_on


def ask_for_t_pose(parts: "WindowParts") -> None:
    for live, _ in parts.state.playback.live:
        live.ask_for_t_pose()


def show_part(joint: str, middle: str) -> Callable[["WindowParts"], None]:
    return lambda parts: parts.viewpoint.show_part(JOINTS.index(joint), JOINTS.index(middle))


def move_wipe(part: float) -> Callable[["WindowParts"], None]:
    def move(parts: "WindowParts") -> None:
        if parts.wipe is not None:
            parts.wipe.move(parts.wipe.part + part)

    return move


def posed(act: Callable[["PoseEdit"], object]) -> Callable[["WindowParts"], None]:
    """What is done to the avatar that is posed by hand; where it is refused, that is said."""

    def do(parts: "WindowParts") -> None:
        edit = parts.posing.edit
        if edit is not None:
            edit.tried(lambda: act(edit))

    return do


PLAY = Action("play or pause", ("space",), timed(lambda line: line.toggle()))
STEP_BACK = Action("pause and go one frame back", (",",), timed(lambda line: line.step(-1)))
STEP_ON = Action("pause and go one frame on", (".",), timed(lambda line: line.step(1)))
SECOND_BACK = Action("go one second back", ("left",), timed(lambda line: line.seek(line.frame - round(line.rate))))
SECOND_ON = Action("go one second on", ("right",), timed(lambda line: line.seek(line.frame + round(line.rate))))
FIRST_FRAME = Action("go to the first frame", ("home",), timed(lambda line: line.seek(0)))
LAST_FRAME = Action("go to the last frame", ("end",), timed(lambda line: line.seek(line.frames - 1)))
SLOWER = Action("play slower (down to 0.1 times)", ("[",), timed(lambda line: line.faster(-1)))
FASTER = Action("play faster (up to 4 times)", ("]",), timed(lambda line: line.faster(1)))

NEXT_CAMERA = Action("next camera", ("c",), lambda parts: parts.viewpoint.cameras.next())
RESET_CAMERA = Action("reset the orbit: everyone, whole", ("r", "1"), lambda parts: parts.viewpoint.reset())
FACE = Action("look at the face", ("2",), show_part("head", "head"))
LEFT_HAND = Action("look at the left hand", ("3",), show_part("left_wrist", "left_middle1"))
RIGHT_HAND = Action("look at the right hand", ("4",), show_part("right_wrist", "right_middle1"))
FOLLOW = Action("let the orbit follow the avatar, or stop", ("f",), toggle_follow)
ADD_CAMERA_KEY = Action("add this view, at this moment, to a path", ("k",), lambda parts: parts.viewpoint.add_key())
SAVE_CAMERA_PATH = Action("save the camera path", ("j",), lambda parts: parts.viewpoint.save_path())

WIPE_LEFT = Action("show less of the video", ("-",), move_wipe(-0.05))
WIPE_RIGHT = Action("show more of the video", ("=",), move_wipe(0.05))

NEXT_AVATAR = Action(
    "select the next avatar", ("tab",), lambda parts: parts.state.selection.choose(parts.state.selection.avatar + 1)
)
VIEW = Action("view dependence on or off", ("v",), lambda parts: parts.look.toggle_view())
POSE = Action("pose the selected avatar by hand, or stop", ("p",), lambda parts: parts.posing.toggle())
T_POSE = Action("take the T-pose of the sender in 3 seconds", ("t",), ask_for_t_pose)

OPEN = Action("open a file", ("ctrl+o",), lambda parts: parts.opening.toggle())
CLOSE_LIST = Action("close the list of files", ("escape",), OPEN.do, when=lambda parts: parts.opening.listed)
SAVE_SCENE = Action("save the scene, for render --scene too", ("ctrl+s",), save_scene)
FULL_SCREEN = Action("full screen, or back", ("f11",), lambda parts: parts.state.layout.screen.toggle_full())
LEAVE_FULL = Action(
    "leave the full screen", ("escape",), FULL_SCREEN.do, when=lambda parts: parts.state.layout.screen.full
)
SCREENSHOT = Action("save a screenshot, without panels", ("s",), lambda parts: parts.recorder.shoot())
FILM = Action("start or end a film, without panels", ("o",), lambda parts: parts.recorder.toggle_film())
PANELS = Action("show or hide the panels", ("g",), toggle_panels)
HELP = Action("show or hide this list of keys", ("h", "f1"), toggle_help)
QUIT = Action("quit", ("q", "escape"), lambda parts: parts.close())

UNDO = Action("undo (500 steps)", ("ctrl+z",), posed(lambda edit: edit.undo()))
REDO = Action("redo", ("ctrl+shift+z", "ctrl+y"), posed(lambda edit: edit.redo()))
MIRROR = Action("mirror the pose; place and heading stay", ("m",), posed(lambda edit: edit.session.mirror()))
TO_GROUND = Action("set the body on the ground", ("n",), posed(lambda edit: edit.to_ground()))
GIVE_UP = Action(
    "give up the drag", ("escape",), posed(lambda edit: edit.tool.cancel()),
    when=lambda parts: parts.posing.edit is not None and parts.posing.edit.tool.held is not None,
)  # fmt: skip
CLOSE_HELP = Action("close the list of keys", ("escape",), toggle_help, when=lambda parts: parts.state.layout.help_on)

VIDEO = KeyGroup("Source video", (WIPE_LEFT, WIPE_RIGHT), lambda parts: parts.wipe is not None)
POSING = KeyGroup(
    "Posing by hand", (UNDO, REDO, MIRROR, TO_GROUND, GIVE_UP), lambda parts: parts.posing.edit is not None
)
GROUPS = (
    KeyGroup("Time", (PLAY, STEP_BACK, STEP_ON, SECOND_BACK, SECOND_ON, FIRST_FRAME, LAST_FRAME, SLOWER, FASTER)),
    KeyGroup(
        "Camera", (RESET_CAMERA, FACE, LEFT_HAND, RIGHT_HAND, NEXT_CAMERA, FOLLOW, ADD_CAMERA_KEY, SAVE_CAMERA_PATH)
    ),
    KeyGroup("Avatars", (NEXT_AVATAR, VIEW, POSE)),
    KeyGroup("Files", (OPEN, CLOSE_LIST, SAVE_SCENE, SCREENSHOT, FILM)),
    KeyGroup("Window", (FULL_SCREEN, PANELS, HELP, CLOSE_HELP, LEAVE_FULL, QUIT)),
    VIDEO,
    KeyGroup("Live", (T_POSE,), lambda parts: bool(parts.state.playback.live)),
    POSING,
)

# what the mouse does, and what it does with a source video
MOUSE = (
    ("drag", "turn the camera"),
    ("right or middle drag", "shift the camera"),
    ("wheel", "come nearer to what is there, go farther"),
    ("drop a file", "open it"),
    ("click", "select the avatar and the joint there"),
)
MOUSE_ON_VIDEO = (("drag the yellow line", "move the wipe between video and avatar"),)


def found(key: str, parts: "WindowParts") -> Action | None:
    """What a key (with its modifiers) does now; None: nothing."""
    groups = [group for group in (POSING, *GROUPS) if group.when(parts)]
    actions = [action for group in groups for action in group.actions if key in action.keys and action.when(parts)]
    return actions[0] if actions else None


def mouse_rows(groups: Sequence[KeyGroup]) -> list[tuple[str, str]]:
    return [*MOUSE, *(MOUSE_ON_VIDEO if VIDEO in groups else ())]


def command_line_help() -> str:
    """Keys and mouse for `selfscan play --help`, at most WIDTH columns wide."""
    lines = ["keys"]
    for group in GROUPS:
        lines += [f"  {group.title.lower()}", *_two_columns(group.rows)]
    return "\n".join([*lines, "mouse", *_two_columns(mouse_rows(GROUPS))])


def _two_columns(cells: list[tuple[str, str]]) -> list[str]:
    """Lines with two cells each where they fit, else with one."""
    wide = max(len(left) for left, _ in cells) + 2
    texts = [f"{left:<{wide}s}{right}" for left, right in cells]
    half = -(-len(texts) // 2)
    wide = max(map(len, texts[:half])) + 3
    lines = [f"    {a:<{wide}s}{b}".rstrip() for a, b in zip_longest(texts[:half], texts[half:], fillvalue="")]
    return lines if max(map(len, lines)) <= WIDTH else [f"    {text}" for text in texts]
