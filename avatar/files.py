"""Files and folders that are written whole or not at all."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from avatar.errors import AssetError


@contextmanager
def whole_file(path: Path | str, mode: str = "wb") -> Iterator[IO[Any]]:
    """A file that appears at `path` only when the block ends without an error.

    The bytes go to a temporary file in the same folder, are flushed to the disk, and replace `path` in one
    step (`os.replace`), so that a reader sees the old file or the new one and never a part of either.

    Raises:
        AssetError: the folder cannot be made or written to.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise AssetError(f"{path}: cannot be written: {error.strerror}") from None
    try:
        encoding = None if "b" in mode else "utf-8"
        with os.fdopen(handle, mode, encoding=encoding) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


@contextmanager
def whole_folder(path: Path | str) -> Iterator[Path]:
    """A folder that appears at `path` only when the block ends without an error.

    The block fills a temporary folder beside it. An existing folder is replaced only if it is empty or was
    made by this function before (it holds the mark `.selfscan`), so that no one's files are ever swept away.

    Raises:
        AssetError: `path` exists and holds something else, or cannot be written.
    """
    path = Path(path)
    mark = ".selfscan"
    if path.exists() and not path.is_dir():
        raise AssetError(f"{path}: expected a folder or nothing, found a file")
    if path.is_dir() and any(path.iterdir()) and not (path / mark).exists():
        raise AssetError(f"{path}: expected an empty or absent folder, found other files; choose another place")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        raise AssetError(f"{path}: cannot be written: {error.strerror}") from None
    try:
        (temporary / mark).write_text("made by selfscan; replaced whole when made again\n")
        yield temporary
        os.chmod(temporary, 0o777 & ~_umask())
        if path.exists():
            shutil.rmtree(path)
        os.replace(temporary, path)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
