"""Avatar files that are replaced while they are shown: `selfscan make` writes a better one over the first."""

from pathlib import Path

from command.errors import AssetError
from player.scene.opened import opened_avatar, opened_track
from player.scene.scene import MANNEQUINS, Scene
from player.window.parts import WindowParts

Stamp = tuple[int, int]


class Renewal:
    """The files of a scene's avatars, looked at again and again; camera, time, place and hand-made poses stay."""

    def __init__(self, scene: Scene):
        self._scene = scene
        files = {k: Path(entry.path) for k, entry in enumerate(scene.avatars) if entry.path not in MANNEQUINS}
        self._files = {k: (file, stamp_of(file)) for k, file in files.items()}

    def due(self) -> list[int]:
        """The avatars whose file is another one than was shown last."""
        return [k for k, (file, shown) in self._files.items() if stamp_of(file) not in (None, shown)]

    def take(self, parts: WindowParts) -> None:
        """Show what is due; a file that cannot be read is named, and the avatar stays as it is."""
        due = self.due()
        for k in due:
            file, entry = self._files[k][0], self._scene.avatars[k]
            self._files[k] = file, stamp_of(file)
            try:
                avatar = opened_avatar(entry.path)
                track = opened_track(self._scene, k, avatar, parts.viewpoint.capture)
            except AssetError as error:
                parts.state.messages.say(str(error))
                continue
            before = parts.state.playback.tracks[k]
            track.start, track.at, track.turn = before.start, before.at, before.turn
            parts.state.avatars[k], parts.state.playback.tracks[k] = avatar, track
            parts.state.messages.say(f"{file}: a new one is shown")
        if due:
            parts.look.renew()


def stamp_of(file: Path) -> Stamp | None:
    """What differs when a file is replaced; None where there is none."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_ino
