"""What the window shows as a scene file, for `selfscan render --scene` and for the window itself."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from player.scene.motions import ground_for
from player.scene.scene import Scene, SceneAvatar, SceneCamera
from player.scene.scene_file import write_scene
from player.window.recent import keep_recent
from player.window.recorder import free_name

if TYPE_CHECKING:
    from player.window.parts import WindowParts


def save_scene(parts: "WindowParts") -> None:
    """Write the scene of now, and beside it what it refers to and no file holds yet: a camera path that was recorded,
    a pose that was made by hand. Where it cannot be written, that is said."""
    path, messages = free_name("selfscan-scene", ".toml"), parts.state.messages
    with messages.saying_errors():
        write_scene(path, scene_of_now(parts, path))
        messages.say(f"{path} written")
        keep_recent(str(path))


def scene_of_now(parts: "WindowParts", path: Path) -> Scene:
    """What is shown; `path` is the file's own, after which those beside it are named."""
    scene, look, (*_, width, height) = parts.opening.scene, parts.look, parts.state.layout.area
    effects = look.effects if look.renderer.view_amount else replace(look.effects, view="off")
    avatars = tuple(_avatar(parts, index, path) for index in range(len(scene.avatars)))
    return Scene(avatars, _cameras(parts, path), look.background, effects, (width, height), scene.rate)


def _avatar(parts: "WindowParts", index: int, path: Path) -> SceneAvatar:
    entry, track = parts.opening.scene.avatars[index], parts.state.playback.tracks[index]
    edit = parts.posing.edit
    if edit is not None and edit.index == index:
        pose = path.with_name(f"{path.stem}-pose.npz")
        edit.session.save(pose)
        # where it is, with its hands, on this body: all are part of the pose
        return SceneAvatar(entry.path, str(pose), ground="keep", life=entry.life, speech=entry.speech)
    # the camera decides about the ground no more
    ground = ground_for(entry.ground, parts.opening.scene.cameras)
    place, turn = tuple(np.round(track.at, 6).tolist()), round(float(np.degrees(track.turn)), 6)
    return replace(entry, at=place, turn_deg=turn, start=round(track.start, 6), ground=ground)


def _cameras(parts: "WindowParts", path: Path) -> tuple[SceneCamera, ...]:
    """First what is looked through now, then the others of the scene that was opened, and a path that was recorded."""
    cameras, kept = parts.viewpoint.cameras, [one for one in parts.opening.scene.cameras if one.path is not None]
    if cameras.keys and cameras.path is not None:
        keys = path.with_name(f"{path.stem}-path.json")
        cameras.path.write(keys)
        kept = [SceneCamera("path", str(keys)), *(one for one in kept if one.kind != "path")]
    if cameras.kind in ("orbit", "turntable"):
        return parts.viewpoint.scene_camera(), *kept
    now = [one for one in kept if cameras.kind in (one.kind, one.name, Path(one.path or "").stem)][:1]
    return (*now, *(one for one in kept if one not in now))
