"""Files and folders that are written whole or not at all.

What is being written lies under a hidden name beside its place, `.selfscan-XXXXXXXX.tmp`, locked by the process that
writes it. Such a name without its lock is what a killed process left; the next command that writes there removes it.

Nothing is removed that was not written here, and nothing before the new is in place. A folder above the output must
be there: only the output itself is made.
"""

import contextlib
import ctypes
import errno
import json
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from command.errors import AssetError

try:
    import fcntl
except ModuleNotFoundError:  # Windows: unfinished files are not locked, and what is left of them stays
    fcntl = None

# in a folder that was written whole: the list of its files, so that files added later by others are recognised
MARK = ".selfscan"
_UNFINISHED = re.compile(r"\.selfscan-[0-9a-z_]{8}\.tmp")
# what a write raises when the disk cannot take it
_DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
# flags of renameat2: names count from the current folder; the two change places
_HERE, _EXCHANGE = -100, 2
# bytes; a disk with less free is full
_FULL = 1 << 16


@contextmanager
def whole_file(path: Path | str, mode: str = "wb") -> Iterator[IO[Any]]:
    """A file that appears at `path` only when the block ends without an error.

    The bytes go to a hidden file in the same folder, are flushed to the disk, and replace `path` in one step, so that a
    reader sees the old file or the new one and never a part of either. A link is followed; the mode of an old file is
    kept. What is no UTF-8, as names of files may be, is written by its codes.

    Raises:
        AssetError: the file cannot be written (`check_file`), or the disk is full.
    """
    check_file(path)
    target, errors = _real(path), None if "b" in mode else "backslashreplace"
    with _refusing(path), _unfinished_in(target.parent, folder=False) as name:
        with open(name, mode, encoding=errors and "utf-8", errors=errors) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, stat.S_IMODE(target.stat().st_mode) if target.exists() else 0o666 & ~_umask())
        os.replace(name, target)


def write_text(path: Path | str, text: str) -> None:
    with whole_file(path, "w") as file:
        file.write(text)


def write_json(path: Path | str, content: object) -> None:
    write_text(path, json.dumps(content, indent=1))


@contextmanager
def whole_folder(path: Path | str) -> Iterator[Path]:
    """A folder that appears at `path` only when the block ends without an error.

    The block fills a hidden folder beside it. A folder that is there already is replaced if it is empty, or holds only
    what this function wrote before, unchanged; it is removed after the new one has taken its place. Where someone has
    put a file into it meanwhile, the new one is kept beside it as PATH.new.

    Raises:
        AssetError: the folder cannot be made (`check_folder`), or the disk is full.
    """
    check_folder(path)
    target = _real(path)
    with _refusing(path), _unfinished_in(target.parent, folder=True) as unfinished:
        try:
            yield unfinished
        except AssetError as error:
            # the message names a file in it: it is given the name that it would have had
            raise AssetError(str(error).replace(str(unfinished), str(path))) from None
        content = {name: _state(file) for name, file in _content(unfinished)}
        mark = {"format": "selfscan-folder", "content": content}
        (unfinished / MARK).write_text(json.dumps(mark, indent=0), "utf-8")
        os.chmod(unfinished, 0o777 & ~_umask())
        _put_in_place(unfinished, target)


def check_file(path: Path | str) -> None:
    """Refuse a place where no file can be written; commands ask before their work begins.

    Raises:
        AssetError: the folder is absent or cannot be written to, or there is a folder, a device, a FIFO, a socket or a
            write-protected file.
    """
    mode = _mode(path)
    if mode is None:
        pass
    elif stat.S_ISDIR(mode):
        raise AssetError(f"{path}: expected a file or nothing, found a folder")
    elif not stat.S_ISREG(mode):
        raise AssetError(f"{path}: is a device, a pipe or a socket, not a file; name a file")
    elif not mode & 0o222:
        raise AssetError(f"{path}: is write-protected; choose another name, or make it writable")
    _check_parent(path)


def check_folder(path: Path | str, *read: Path | None) -> None:
    """Refuse a place where no folder can be made or replaced; commands ask before their work begins. `read`: what they
    read, which has to stay.

    Raises:
        AssetError: the folder above is absent or cannot be written to; `path` is a file, a mount point, the folder that
            this program runs in or one above it; or it holds something that was not written here, or is read.
    """
    check_apart(path, *read)
    mode = _mode(path)
    if mode is None:
        _check_parent(path)
        return
    if not stat.S_ISDIR(mode):
        raise AssetError(f"{path}: expected a folder or nothing, found a file")
    target = _real(path)
    if target == Path.cwd() or target in Path.cwd().parents:
        raise AssetError(f"{path}: the current folder, or one that holds it, cannot be replaced; name a folder in it")
    if os.path.ismount(target):
        raise AssetError(f"{path}: is a mount point, which cannot be replaced; name a folder in it")
    foreign = _foreign(target)
    if foreign is not None:
        raise AssetError(
            f"{path}: expected an empty or absent folder, or one written by selfscan; {foreign}; choose another place"
        )
    _check_parent(path)


def check_apart(path: Path | str, *read: Path | None) -> None:
    """Refuse an output that is a folder which is read, or holds what is read: `AssetError`."""
    target = _real(path)
    for source in read:
        if source is not None and target in (_real(source), *_real(source).parents):
            raise AssetError(f"{path}: holds {source}, which is read and would be replaced; choose another place")


@contextmanager
def exclusive_lock(out: Path) -> Iterator[None]:
    """A lock on an output: two processes that make it would overwrite what the other keeps beside it.

    The lock goes with the process, however it ends.

    Raises:
        AssetError: another process is at it, or the folder cannot be written to.
    """
    path = out.with_name(f".{out.name}.lock")
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise AssetError(f"{path}: cannot be written: {error.strerror}") from None
    try:
        held = locked(file)
        if held is None:  # no locks here
            yield
            return
        if not held:
            who = os.read(file, 20).decode("ascii", "replace").strip() or "unknown"
            raise AssetError(f"{out}: process {who} is making it; wait for it, or choose another -o")
        os.ftruncate(file, 0)
        os.write(file, f"{os.getpid()}\n".encode())
        try:
            yield
        finally:
            path.unlink(missing_ok=True)
    finally:
        os.close(file)


def is_free(folder: Path) -> bool:
    """Whether nothing is at a place, or an empty folder. What a killed process of ours left unfinished in it goes."""
    if not os.path.lexists(folder):
        return True
    if not folder.is_dir():
        return False
    _remove_leftovers(folder)
    return not os.listdir(folder)


def _mode(path: Path | str) -> int | None:
    """What is at a place, links followed; None: nothing."""
    try:
        return os.stat(Path(path)).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise AssetError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}") from None


def _real(path: Path | str) -> Path:
    """The place itself, links followed."""
    return Path(os.path.realpath(Path(path)))


def _check_parent(path: Path | str) -> None:
    parent = _real(path).parent
    if not parent.is_dir():
        raise AssetError(f"{path}: there is no folder {parent}; make it first, or choose another place")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise AssetError(f"{path}: cannot be written: the folder {parent} is not writable")


@contextmanager
def _refusing(path: Path | str) -> Iterator[None]:
    """Turns what a full or broken disk raises into one AssetError that names the output."""
    try:
        yield
    except AssetError:
        raise
    except OSError as error:
        if error.errno in _DISK_ERRORS or (error.filename and ".selfscan-" in str(error.filename)):
            raise AssetError(f"{path}: cannot be written: {error.strerror or error}") from None
        raise
    except Exception as error:
        # libraries that write for us have errors of their own for it
        parent = _real(path).parent
        if shutil.disk_usage(parent).free < _FULL:
            raise AssetError(f"{path}: cannot be written: {os.strerror(errno.ENOSPC)} ({error})") from None
        raise


@contextmanager
def _unfinished_in(parent: Path, *, folder: bool) -> Iterator[Path]:
    """A locked hidden file or folder in `parent`, removed at the end if it is still there."""
    _remove_leftovers(parent)
    while True:
        if folder:
            name = Path(tempfile.mkdtemp(prefix=".selfscan-", suffix=".tmp", dir=parent))
            handle = None if fcntl is None else os.open(name, os.O_RDONLY)
        else:
            handle, made = tempfile.mkstemp(prefix=".selfscan-", suffix=".tmp", dir=parent)
            name = Path(made)
            # Windows renames no open file
            if fcntl is None:
                os.close(handle)
                handle = None
        if handle is None or (locked(handle) is not False and name.exists()):
            break
        # another process took it for a leftover in the moment before the lock
        os.close(handle)
    try:
        yield name
    finally:
        if folder:
            shutil.rmtree(name, ignore_errors=True)
        else:
            name.unlink(missing_ok=True)
        if handle is not None:
            os.close(handle)


def locked(handle: int) -> bool | None:
    """Lock an open file; False: another process has it locked; None: there are no locks here."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _remove_leftovers(parent: Path) -> None:
    """Remove unfinished files and folders of ours whose process is gone."""
    try:
        names = [name for name in os.listdir(parent) if _UNFINISHED.fullmatch(name)] if fcntl is not None else []
    except OSError:
        return
    for name in names:
        with contextlib.suppress(OSError):
            handle = os.open(parent / name, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
            try:
                status = os.fstat(handle)
                if status.st_uid == os.geteuid() and locked(handle):
                    if stat.S_ISDIR(status.st_mode):
                        shutil.rmtree(parent / name)
                    elif stat.S_ISREG(status.st_mode):
                        os.unlink(parent / name)
            finally:
                os.close(handle)


def _put_in_place(unfinished: Path, target: Path) -> None:
    """Rename a finished folder to its place; an old one changes places with it, and is removed last.

    Where the system cannot exchange two names in one step, the old one steps aside first.
    """
    if not target.exists():
        os.rename(unfinished, target)
        return
    foreign = _foreign(target)
    if foreign is not None:
        kept = _free(target, ".new")
        os.rename(unfinished, kept)
        raise AssetError(f"{target}: {foreign}, so it is left as it is; the new folder is {kept}")
    if _exchanged(unfinished, target):
        # what stays of it when the process is killed here is a leftover like any other
        shutil.rmtree(unfinished)
        return
    aside = _free(target, ".old")
    os.rename(target, aside)
    try:
        os.rename(unfinished, target)
    except BaseException:
        os.rename(aside, target)
        raise
    shutil.rmtree(aside)


def _exchanged(one: Path, other: Path) -> bool:
    """Let two folders change places in one step (Linux's renameat2); False: that is not to be had here."""
    try:
        exchange = ctypes.CDLL(None).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    return exchange(_HERE, os.fsencode(one), _HERE, os.fsencode(other), _EXCHANGE) == 0


def _free(path: Path, ending: str) -> Path:
    """A name beside `path` that nothing has yet."""
    names = (path.with_name(f"{path.name}{ending}{number or ''}") for number in range(1 << 30))
    return next(name for name in names if not os.path.lexists(name))


def _foreign(folder: Path) -> str | None:
    """What of a folder was not written by `whole_folder`, in words; None: nothing."""
    listed = _listed(folder)
    for name, path in _content(folder):
        if name not in listed:
            return f"{name} in it is not known to be selfscan's"
        if listed[name] != _state(path):
            return f"{name} in it was changed"
    return None


def _listed(folder: Path) -> dict[str, list[int]]:
    """What the mark of a folder lists: names, with `_state`; nothing where it has no such mark."""
    try:
        content = json.loads((folder / MARK).read_text("utf-8"))["content"]
        return content if isinstance(content, dict) else {}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _content(folder: Path) -> Iterator[tuple[str, Path]]:
    """Name (of folders with a / at the end) and path of all that is in a folder and below, but the mark."""
    for inner, folders, files in os.walk(folder):
        for name in (*folders, *files):
            path = Path(inner) / name
            relative = path.relative_to(folder).as_posix()
            if relative != MARK:
                yield relative + ("/" if path.is_dir() and not path.is_symlink() else ""), path


def _state(path: Path) -> list[int]:
    """What changes when a file is written: size and time, nanoseconds. Nothing of a folder."""
    status = path.lstat()
    return [] if stat.S_ISDIR(status.st_mode) else [status.st_size, status.st_mtime_ns]


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
