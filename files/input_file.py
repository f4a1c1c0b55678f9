"""Files from outside, opened as what they should be: regular files of bounded size, text, JSON, films."""

import io
import json
import math
import os
import re
import reprlib
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from command.errors import AssetError

if TYPE_CHECKING:
    from av.container import InputContainer

# a parsed value of JSON, and an object
Json = Any
JsonObject = dict[str, Json]

MAX_BYTES = 1 << 28
MAX_JSON_BYTES = 1 << 26
# a parsed value costs Python some 60-200 bytes
MAX_JSON_VALUES = 2_000_000
# digits of a whole number that every float can hold
MAX_DIGITS = 300
MAX_FILM_BYTES = 1 << 36
# How a film begins, and FFmpeg's name of such a container: ISO/IEC 14496-12 (.mp4, .mov), Matroska (.mkv, .webm), AVI
FILM_FORMATS = (
    (re.compile(rb".{4}(ftyp|moov|mdat|wide|free|skip|pnot)", re.DOTALL), "mov"),
    (re.compile(rb"\x1a\x45\xdf\xa3"), "matroska"),
    (re.compile(rb"RIFF.{4}AVI ", re.DOTALL), "avi"),
)


def one_line(error: object) -> str:
    """What went wrong, short enough for one line of a message."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 120 else f"{text[:117]}..."


def short(value: object, most: int = 80) -> str:
    """A value that was found, as text for one line of a message."""
    text = reprlib.repr(value)
    return text if len(text) <= most else f"{text[: most - 3]}..."


@contextmanager
def unusable(message: str) -> Iterator[None]:
    """Whatever a broken file raises in the block becomes one line that begins with `message`.

    Decoders of hostile bytes raise what their parts raise, a dozen kinds each.
    """
    try:
        yield
    except AssetError:
        raise
    except Exception as error:
        raise AssetError(f"{message}: {one_line(error)}") from None


def open_input(path: Path | str, what: str, *, most: int = MAX_BYTES) -> io.BufferedReader:
    """A regular file of at most `most` bytes, opened to be read.

    `what` names the expected content in messages, for example "a camera file". Devices, pipes and sockets, and the
    system's own files, which claim to be empty, are refused before a byte is read: reading them may never end.

    Raises:
        AssetError: absent, not a regular file, empty, too large, or not to be read.
    """
    try:
        _check_regular(path, what, os.stat(path))
        # should a pipe have come into its place meanwhile, opening it must not wait for a writer
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        try:
            found = os.fstat(handle)
            _check_regular(path, what, found)
        except AssetError:
            os.close(handle)
            raise
    except FileNotFoundError:
        raise AssetError(f"{path}: no such file; expected {what}") from None
    except OSError as error:
        raise AssetError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:  # a NUL in a name that a file gave
        raise AssetError(f"{str(path)!r}: cannot be read: {error}") from None
    if not 0 < found.st_size <= most:
        os.close(handle)
        size = f"{found.st_size} bytes" if found.st_size else "an empty file"
        raise AssetError(f"{path}: expected {what} of at most {most} bytes, found {size}")
    return os.fdopen(handle, "rb")


def _check_regular(path: Path | str, what: str, found: os.stat_result) -> None:
    if not stat.S_ISREG(found.st_mode):
        kind = "a folder" if stat.S_ISDIR(found.st_mode) else "a device, pipe or socket"
        raise AssetError(f"{path}: expected {what}, which should be a file; is {kind}")


def read_bytes(path: Path | str, what: str, *, most: int = MAX_BYTES) -> bytes:
    """The content of a file; AssetError as in `open_input`."""
    try:
        with open_input(path, what, most=most) as file:
            # as much memory is taken as is asked for, so no more is asked for than is there
            data = file.read(os.fstat(file.fileno()).st_size + 1)
    except OSError as error:
        raise AssetError(f"{path}: cannot be read: {error.strerror}") from None
    if len(data) > most:
        raise AssetError(f"{path}: expected {what} of at most {most} bytes")
    return data


def read_text(path: Path | str, what: str, *, most: int = MAX_BYTES) -> str:
    """The content of a UTF-8 file; AssetError as in `open_input`, or where it is no text."""
    try:
        return read_bytes(path, what, most=most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise AssetError(f"{path}: expected {what}, UTF-8 text; byte {error.start} is none") from None


def open_film(path: Path | str, what: str = "a film") -> "InputContainer":
    """A film in one of FILM_FORMATS, opened by PyAV; no other file is opened through it.

    FFmpeg guesses a format from content and name, and some formats are lists that name other files and addresses. Here
    the first bytes say which of three it is, and the protocol `file` is the only one. Only this imports the decoder.

    Raises:
        AssetError: absent, not a regular file, of another format, damaged, without pictures, or in an unknown code.
    """
    import av
    from av.error import FFmpegError

    with open_input(path, what, most=MAX_FILM_BYTES) as file:
        head = file.read(16)
    format = next((name for begins, name in FILM_FORMATS if begins.match(head)), None)
    expected = f"{path}: expected {what}, .mp4, .mov, .mkv, .webm or .avi"
    if format is None:
        raise AssetError(f"{expected}, found a file that begins with {head[:12]!r}")
    try:
        container = av.open(
            f"file:{path}", format=format, metadata_errors="ignore",
            options={"format_whitelist": format, "protocol_whitelist": "file", "enable_drefs": "0"},
        )  # fmt: skip
    except (FFmpegError, ValueError, OSError) as error:
        raise AssetError(f"{expected}, found: {one_line(getattr(error, 'strerror', None) or error)}") from None
    if not container.streams.video:
        container.close()
        raise AssetError(f"{expected}, found a file without pictures")
    # encrypted, or newer than the decoder
    if container.streams.video[0].codec_context is None:
        container.close()
        raise AssetError(f"{expected}, found a film in a code that is not read here")
    return container


def read_json(path: Path | str, what: str, *, most: int = MAX_JSON_BYTES) -> Json:
    """The content of a JSON file; AssetError as in `open_input` and `parse_json`."""
    return parse_json(read_bytes(path, what, most=most), str(path), what)


def read_json_object(path: Path | str, what: str, *, most: int = MAX_JSON_BYTES) -> JsonObject:
    """The object that a JSON file holds; AssetError as in `read_json`, or where it holds something else."""
    content = read_json(path, what, most=most)
    if not isinstance(content, dict):
        raise AssetError(f"{path}: expected {what}, a JSON object, found a {type(content).__name__}")
    return content


def parse_json(data: bytes, place: str, what: str) -> Json:
    """JSON of bounded depth and number of values, all of whose numbers floats can hold.

    Raises:
        AssetError: it is not; the message begins with `place`.
    """
    if data.count(b",") + data.count(b"[") + data.count(b"{") > MAX_JSON_VALUES:
        raise AssetError(f"{place}: expected {what}, JSON of at most {MAX_JSON_VALUES} values, found more")
    try:
        return json.loads(
            data.decode("utf-8-sig"), parse_constant=_refused, parse_int=_whole_number, parse_float=_finite
        )
    except UnicodeDecodeError:
        raise AssetError(f"{place}: expected {what} (JSON), found bytes that are not text") from None
    except RecursionError:
        raise AssetError(f"{place}: expected {what}, JSON a few levels deep, found thousands") from None
    except ValueError as error:
        raise AssetError(f"{place}: expected {what} (JSON), found: {one_line(error)}") from None


def _refused(name: str) -> NoReturn:
    raise ValueError(f"{name}, which is not a number of JSON")


def _whole_number(digits: str) -> int:
    if len(digits) > MAX_DIGITS:
        raise ValueError(f"a whole number of {len(digits)} digits")
    return int(digits)


def _finite(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError(f"the number {digits[:20]}, which is beyond floats")
    return value


def name_order(name: str) -> tuple[list[tuple[str, int]], str]:
    """What names are sorted by: frame_9 comes before frame_10."""
    parts = re.findall(r"([^0-9]*)([0-9]{0,18})", name)
    return [(text, int(digits) if digits else -1) for text, digits in parts], name
