"""Avatar files that are replaced while they are shown: `selfscan make` writes a better one over the first."""

from pathlib import Path

from command.errors import AssetError
from player.scene.scene import BUILTIN_AVATARS
from player.window.opening import Opening, put_avatar
from player.window.parts import WindowParts

Stamp = tuple[int, int]


class Renewal:
    """The files of what is shown, looked at again and again; camera, time, place and hand-made poses stay."""

    def __init__(self, opening: Opening):
        self._opening = opening
        # what each file was when it was shown
        self._shown: dict[str, Stamp | None] = {}
        self.due()

    def due(self) -> list[int]:
        """The avatars whose file is another one than was shown last."""
        entries = [(k, entry.path) for k, entry in enumerate(self._opening.scene.avatars)]
        files = [(k, path, stamp_of(Path(path))) for k, path in entries if path not in BUILTIN_AVATARS]
        return [k for k, path, stamp in files if stamp not in (None, self._shown.setdefault(path, stamp))]

    def take(self, parts: WindowParts) -> None:
        """Show what is due; a file that cannot be read is named, and the avatar stays as it is."""
        for k in self.due():
            entry = self._opening.scene.avatars[k]
            self._shown[entry.path] = stamp_of(Path(entry.path))
            try:
                if put_avatar(parts, k, entry):
                    parts.state.messages.say(f"{entry.path}: a new one is shown")
            except AssetError as error:
                parts.state.messages.say(str(error))


def stamp_of(file: Path) -> Stamp | None:
    """What differs when a file is replaced; None where there is none."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_ino
