"""Files that were opened before, newest first; kept beside the user's poses. Nothing hangs on them: a list that cannot
be read begins anew, one that cannot be written stays as it is."""

import os
from contextlib import suppress
from pathlib import Path

from command.errors import AssetError
from files.input_file import read_json
from files.whole import write_json
from player.pose.library import user_folder
from player.scene.scene import BUILTIN_AVATARS

# files of the list; an older one falls off its end
MOST = 10


def recent_file() -> Path:
    """Where they are listed: $XDG_DATA_HOME/selfscan/recent.json, usually ~/.local/share/selfscan/recent.json. A JSON
    array of whole paths."""
    return user_folder().parent / "recent.json"


def read_recent() -> list[str]:
    """Whole paths of those that are still there."""
    try:
        found = read_json(recent_file(), "recent files")
    except AssetError:
        return []
    names = [name for name in found if isinstance(name, str)] if isinstance(found, list) else []
    # Path.exists would raise where one lies in a folder that may not be looked into
    return [name for name in names if os.path.exists(name)][:MOST]


def keep_recent(path: str) -> None:
    """A file was opened now. What travels with the program is not listed."""
    if path in BUILTIN_AVATARS or not os.path.exists(path):
        return
    whole = str(Path(path).absolute())
    with suppress(AssetError, OSError):
        recent_file().parent.mkdir(parents=True, exist_ok=True)
        write_json(recent_file(), [whole, *(name for name in read_recent() if name != whole)][:MOST])
