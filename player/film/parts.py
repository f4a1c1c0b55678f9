"""A long film as parts that are drawn one by one, go on after a stop, and may be drawn by several machines.

Parts begin at the same frame numbers however a film is made: at multiples of 240. While it is being made they lie
in OUT.parts, each written whole or not at all; what they are parts of is in film.json there. When all are there
they are joined to OUT (player.film.film.join_pieces) and the folder goes.
"""

import contextlib
import hashlib
import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

from command.errors import AssetError
from files.input_file import JsonObject, read_json_object
from files.whole import check_folder, is_free, write_json
from player.film.film import VIDEO, film_kind

# frames of a part: eight seconds at 30 a second, and as far apart as key frames may be
LENGTH = 240
MARK = "film.json"
_PIECE = re.compile(r"\d{8,}-\d{8,}(\.[a-z0-9]+)?")


@dataclass(frozen=True)
class Parts:
    """Which parts a film has, and where they are kept.

    identity is everything that decides the film's pixels, as JSON can hold it: parts of another film are never
    joined to this one.
    """

    out: Path
    start: int  # first frame
    stop: int  # one past the last
    identity: JsonObject

    @property
    def folder(self) -> Path:
        return self.out.with_name(self.out.name + ".parts")

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """First frame and end of each part."""
        first = range(self.start - self.start % LENGTH, self.stop, LENGTH)
        return [(max(a, self.start), min(a + LENGTH, self.stop)) for a in first]

    def piece(self, part: tuple[int, int]) -> tuple[Path, int]:
        """Where a part is kept, and its number of frames. What is no video is kept as PNG frames."""
        kind = film_kind(self.out)
        name = f"{part[0]:08d}-{part[1]:08d}" + (kind if kind in VIDEO else "")
        return self.folder / name, part[1] - part[0]

    def missing(self) -> list[tuple[int, int]]:
        return [part for part in self.ranges if not self.piece(part)[0].exists()]

    def begin(self, *, resume: bool) -> None:
        """Make the folder; with `resume` the parts in it stay.

        Raises:
            AssetError: the folder is not ours, or `resume` finds parts of another film.
        """
        mark = self.folder / MARK
        if not is_free(self.folder):
            try:
                held = read_json_object(mark, "the film that parts belong to")["film"]
                if not isinstance(held, dict):
                    raise KeyError("film")
            except (AssetError, KeyError):
                raise AssetError(f"{self.folder}: expected parts of a film with {MARK}; move it away") from None
            if resume:
                differing = sorted(key for key in {*held, *self._film()} if held.get(key) != self._film().get(key))
                if differing:
                    other = f"parts of another film ({', '.join(differing)} differ)"
                    raise AssetError(f"{self.folder}: holds {other}; remove it or leave --resume out")
                return
            self.discard()
        check_folder(self.folder)
        self.folder.mkdir(exist_ok=True)
        write_json(mark, {"format": "selfscan-film-parts", "film": self._film()})

    def discard(self) -> None:
        """Remove the parts, and their folder if nothing else is in it."""
        for path in list(self.folder.glob("*")):
            if path.is_dir() and _PIECE.fullmatch(path.name):
                shutil.rmtree(path, ignore_errors=True)
            elif path.name == MARK or _PIECE.fullmatch(path.name):
                path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self.folder.rmdir()

    def _film(self) -> JsonObject:
        return json.loads(json.dumps({**self.identity, "frames": [self.start, self.stop], "part": LENGTH}))


def fingerprint(path: Path | str) -> str:
    """The identity of a file, or of all files of a folder: SHA-256 of its content.

    Raises:
        AssetError: it cannot be read.
    """
    path, digest = Path(path), hashlib.sha256()
    try:
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if not file.is_dir():
                digest.update(str(file.relative_to(path)).encode())
                with open(file, "rb") as opened:
                    while block := opened.read(1 << 20):
                        digest.update(block)
    except OSError as error:
        raise AssetError(f"{path}: cannot be read: {error.strerror}") from None
    return digest.hexdigest()
