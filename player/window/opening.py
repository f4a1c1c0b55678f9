"""Files that are opened while the window runs: dropped on it, or chosen from its list.

An avatar takes the place of the selected one, a motion moves it, films, pictures and panoramas go behind everyone. A
scene replaces all that is shown (player/window/window.py). A file that cannot be read is named in one line, and what
was shown stays. With --follow, an avatar's file that was replaced is shown anew (`selfscan make` writes better ones).
"""

import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from avatar.gltf.avatar_write import EXTENSION
from avatar.gltf.document import read_gltf
from avatar.motion.read import BUILTIN_MOTIONS, READERS
from command.errors import AssetError
from player.effects.background import Background
from player.effects.background_source import PICTURES, folder_names, pictures_in
from player.effects.light import Light
from player.scene.opened import opened_avatar, opened_track
from player.scene.scene import BUILTIN_AVATARS, Scene, SceneAvatar
from player.window.recent import read_recent
from player.window.show import Show, stamp_of

if TYPE_CHECKING:
    from player.window.parts import WindowParts

GLTF = (".glb", ".gltf", ".vrm", ".vrma")
FILMS = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi")
# what a background is called in scenes
BACKGROUNDS = {"panorama": "hdr", "picture": "image", "film": "video"}
KINDS = dict.fromkeys([suffix for reader in READERS for suffix in reader.suffixes if suffix[0] == "."], "motion")
KINDS |= {".toml": "scene", ".hdr": "panorama", ".glb": "avatar"}
KINDS |= dict.fromkeys(PICTURES, "picture") | dict.fromkeys(FILMS, "film")


class Opening:
    def __init__(self, show: Show):
        self.show, self.scene = show, show.scene
        # files to be opened before the next frame
        self.asked: list[str] = []
        self.folder = Path.cwd()
        # whether the list is shown, and what is on it
        self.listed = False
        self.recent: list[str] = []
        self.files: list[tuple[Path, str]] = []
        # what each avatar's file was before it was read, where files are followed
        self.stamps = show.stamps

    def due(self) -> list[int]:
        """The avatars whose file is another one than was shown last, where files are followed."""
        if self.stamps is None:
            return []
        paths = [(k, entry.path) for k, entry in enumerate(self.scene.avatars) if entry.path not in BUILTIN_AVATARS]
        return [k for k, path in paths if stamp_of(Path(path)) not in (None, self.stamps.get(path))]

    def toggle(self) -> None:
        self.listed = not self.listed
        if self.listed:
            self.go(self.folder)

    def go(self, folder: Path) -> None:
        """List another folder: its folders, then what can be opened."""
        self.folder, self.recent, names = folder, read_recent(), list[str]()
        # one that may not be looked into shows nothing
        with suppress(AssetError):
            names = folder_names(folder)
        paths = [folder / name for name in names]
        found = [(path, "folder" if os.path.isdir(path) else KINDS.get(path.suffix.lower(), "")) for path in paths]
        found.sort(key=lambda one: one[1] != "folder")
        self.files = [(path, kind) for path, kind in found if kind]

    def ask(self, path: str) -> None:
        """Open a file before the next frame, and hide the list."""
        self.asked.append(path)
        self.listed = False

    def with_avatar(self, index: int, entry: SceneAvatar) -> Scene:
        """The scene with another avatar, or one that moves otherwise."""
        before = self.scene.avatars
        return replace(self.scene, avatars=(*before[:index], entry, *before[index + 1 :]))


def kind_of(path: str) -> str:
    """What a file or folder is to the window: avatar, motion, scene, panorama, picture or film.

    Raises:
        AssetError: it is not there, or nothing that can be opened.
    """
    if path in BUILTIN_AVATARS:
        return "avatar"
    if path in BUILTIN_MOTIONS:
        return "motion"
    place = Path(path)
    if os.path.isdir(place):
        return "film" if pictures_in(place) else "motion"
    suffix = place.suffix.lower()
    if suffix in GLTF and os.path.exists(place):
        gltf = read_gltf(place)
        own = EXTENSION in gltf.extensions(gltf.json, "glTF")
        return "avatar" if own or not gltf.json.get("animations") else "motion"
    if suffix not in KINDS:
        expected = "an avatar, a motion, a scene, a panorama, a picture or a film"
        raise AssetError(f"{path}: expected {expected}, found {suffix or 'a file without an ending'}")
    return KINDS[suffix]


def open_file(parts: "WindowParts", path: str) -> bool:
    """Open what is no scene; whether it is shown.

    Raises:
        AssetError: it cannot be read, or cannot be shown now.
    """
    kind = kind_of(path)
    if kind in BACKGROUNDS:
        return _put_behind(parts, kind, path)
    # a pose made by hand would be lost
    if not parts.posing.may_leave():
        return False
    index = parts.state.selection.avatar
    entry = parts.opening.scene.avatars[index]
    done = put_avatar(parts, index, replace(entry, path=path)) if kind == "avatar" else _put_motion(parts, index, path)
    if done:
        parts.posing.edit = None
        parts.opening.show.fit_orbit(parts.state.layout.area[2:])
    return done


def put_avatar(parts: "WindowParts", index: int, entry: SceneAvatar) -> bool:
    """An avatar in the place of another one; camera, time, place and motion stay. Whether it can be drawn.

    Raises:
        AssetError: its file or its motion cannot be read.
    """
    state, scene = parts.state, parts.opening.with_avatar(index, entry)
    if parts.opening.stamps is not None:
        parts.opening.stamps[entry.path] = stamp_of(Path(entry.path))
    avatar = opened_avatar(entry.path)
    track = opened_track(scene, index, avatar, parts.viewpoint.capture)
    before = state.avatars[index], state.playback.tracks[index]
    track.start, track.at, track.turn = before[1].start, before[1].at, before[1].turn
    state.avatars[index], state.playback.tracks[index] = avatar, track
    if not parts.look.change(anew=True):
        state.avatars[index], state.playback.tracks[index] = before
        return False
    for live, posed in state.playback.live:
        if index in posed:
            live.fit(posed.index(index), avatar)
    state.selection.names[index] = Path(entry.path).stem
    parts.opening.scene = scene
    return True


def _put_motion(parts: "WindowParts", index: int, path: str) -> bool:
    """Another motion for an avatar, from its beginning."""
    state, opening = parts.state, parts.opening
    if any(index in posed for _, posed in state.playback.live):
        raise AssetError(f"{path}: {state.selection.names[index]} is posed live, not by a motion")
    scene = opening.with_avatar(index, replace(opening.scene.avatars[index], motion=path, start=0.0))
    track = opened_track(scene, index, state.avatars[index], None)
    # a motion whose poses cannot be read is said before it is shown
    track.pose(0.0)
    state.playback.change(index, track)
    opening.scene = scene
    parts.viewpoint.begin()
    for note in track.motion.notes:
        print(note)
    return True


def _put_behind(parts: "WindowParts", kind: str, path: str) -> bool:
    """A background. A floor would hide half of it, its shadow does not; a panorama lights people too."""
    if parts.wipe is not None:
        raise AssetError(f"{path}: the video of the capture is behind the avatar")
    effects = parts.look.effects
    if effects.ground is not None:
        effects = replace(effects, ground=replace(effects.ground, kind="shadow"))
    if kind == "panorama":
        effects = replace(effects, light=Light(by="panorama"))
    return parts.look.change(effects=effects, background=Background(BACKGROUNDS[kind], path=path))


def renew(parts: "WindowParts") -> None:
    """Show avatars whose files were replaced; camera, time, place and hand-made poses stay. A file that cannot be read
    is named, and its avatar stays as it is."""
    for k in parts.opening.due():
        entry = parts.opening.scene.avatars[k]
        with parts.state.messages.saying_errors():
            if put_avatar(parts, k, entry):
                parts.state.messages.say(f"{entry.path}: a new one is shown")
