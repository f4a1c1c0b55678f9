"""Films and pictures from drawn frames, written in a thread of their own while the next frame is drawn.

Frames come as (height, width, 4) uint8, row 0 on top, premultiplied alpha, sRGB. Kinds by ending: .mp4 (H.264),
.webm (VP9, with alpha), .mov (ProRes 4444, with alpha), .gif, .webp, .png (one picture), anything without an
ending: a folder of PNG frames. Video is tagged BT.709; an odd size is padded by one row or column, never scaled.
"""

import os
import queue
import shutil
import threading
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import chain, islice
from pathlib import Path
from typing import IO

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from command.errors import AssetError
from files.picture import read_picture
from files.whole import whole_file, whole_folder

Frame = UInt8[np.ndarray, "height width 4"]
WAITING = 8  # frames that may wait for the encoder before drawing waits for it
VIDEO = (".mp4", ".webm", ".mov")
ALPHA = (".webm", ".mov")  # videos that hold it
PICTURE_SEQUENCES = {".gif": "GIF", ".webp": "WEBP"}


def film_kind(path: Path | str) -> str:
    """The ending that decides how a film is written; "" is a folder of frames.

    Raises:
        ValueError: no such kind.
    """
    suffix = Path(path).suffix.lower()
    known = {"", ".png", *VIDEO, *PICTURE_SEQUENCES}
    if suffix not in known:
        raise ValueError(f"{path}: should end in {', '.join(sorted(known - {''}))} or be a folder; ends in {suffix}")
    return suffix


class Film:
    """A film being written: `with Film(path, rate) as film: film.add(image)`. Appears whole or not at all.

    quality is draft, good or best. `pieces` are files and the number of frames of each, to be written one after the
    other instead of one file at `path`.
    """

    def __init__(
        self,
        path: Path | str,
        rate: float,
        *,
        transparent: bool = False,
        quality: str = "good",
        pieces: Sequence[tuple[Path, int]] = (),
    ):
        self.path, self.kind, self.rate, self.transparent = Path(path), film_kind(path), rate, transparent
        self.quality, self.pieces = quality, pieces
        self.frames = 0
        self.notes: list[str] = []
        self._queue: queue.Queue[Frame | None] = queue.Queue(WAITING)
        # arrays of our own, read into again and again
        self._kept: list[Frame] = []
        self._free: queue.SimpleQueue[Frame] = queue.SimpleQueue()
        self._error: BaseException | None = None
        # the drawing side has said that no more frames come
        self._ended = False
        self._thread = threading.Thread(target=self._work, name="film", daemon=True)

    def __enter__(self) -> "Film":
        self._thread.start()
        return self

    def canvas(self, size: tuple[int, int]) -> Frame:
        """An array to draw the next frame of `size` pixels into; it is used again once it is written."""
        try:
            return self._free.get_nowait()
        except queue.Empty:
            image = np.empty((size[1], size[0], 4), np.uint8)
            self._kept.append(image)
            return image

    def add(self, image: Frame) -> None:
        """Hand over the next frame. The array must not be changed afterwards."""
        if self._error is None:
            self._queue.put(np.ascontiguousarray(image))
            self.frames += 1
        if self._error is not None:
            raise self._error

    def __exit__(self, kind: object, error: BaseException | None, _trace: object) -> None:
        if error is not None:
            # the writer stops at the next frame and removes what it began
            self._error = self._error or error
        self._queue.put(None)
        self._thread.join()
        failed, self._error = self._error, None
        try:
            if error is None and failed is not None:
                raise failed
        finally:
            # an error that is kept keeps its frames, and with them all files they have open
            del failed

    def _work(self) -> None:
        try:
            frames = self._frames_in_order()
            for path, count in self.pieces:
                self._write(path, islice(frames, count))
            if not self.pieces:
                self._write(self.path, frames)
            for _ in frames:
                raise AssetError(f"{self.path}: more frames than its pieces hold")
        except BaseException as error:  # carried over to the drawing thread, which raises it
            self._error = self._error or self._located_error(error)
        # so that `add` is never left waiting
        while not self._ended:
            self._ended = self._queue.get() is None

    def _located_error(self, error: BaseException) -> BaseException:
        """Errors of disk and encoder as one line that names the file; all others as they are."""
        if isinstance(error, OSError) or type(error).__module__.startswith("av."):
            return AssetError(f"{self.path}: cannot be written as {self.kind or 'frames'}: {error}")
        return error

    def _frames_in_order(self) -> Iterator[Frame]:
        """The frames, each free to be drawn over when the next is asked for."""
        while not self._ended:
            image = self._queue.get()
            self._ended = image is None
            if self._error is not None:
                raise self._error
            if image is None:
                return
            yield image
            if any(image is mine for mine in self._kept):
                self._free.put(image)

    def _write(self, path: Path, frames: Iterator[Frame]) -> None:
        kind = film_kind(path)
        if kind == "":
            with whole_folder(path) as folder:
                self._pictures(folder, frames)
            return
        first = next(frames, None)
        if first is None:
            raise AssetError(f"{path}: no frames to write")
        with whole_file(path) as file:
            if kind == ".png":
                self._picture(first).save(file, "PNG", compress_level=1)
                for _ in frames:
                    raise AssetError(f"{path}: a .png holds one frame; give a folder or a film")
            elif kind in PICTURE_SEQUENCES:
                save_sequence(file, kind, (self._picture(image) for image in chain([first], frames)), self.rate)
            else:
                self._video(file, kind, first, frames)

    def _pictures(self, folder: Path, frames: Iterator[Frame]) -> None:
        """PNG frames, packed on all cores: packing one takes longer than drawing it."""
        packing: deque[Future[None]] = deque()
        with ThreadPoolExecutor(min(WAITING, os.cpu_count() or 1), "png") as pool:
            for number, image in enumerate(frames):
                picture = self._picture(image)
                packing.append(pool.submit(picture.save, folder / f"{number:06d}.png", compress_level=1))
                if len(packing) >= WAITING:
                    packing.popleft().result()
            for each in packing:
                each.result()

    def _picture(self, image: Frame) -> Image.Image:
        height, width = image.shape[:2]
        if self.transparent:
            return Image.frombytes("RGBA", (width, height), straight(image).tobytes())
        return Image.frombytes("RGB", (width, height), image, "raw", "RGBX")

    def _video(self, file: IO[bytes], kind: str, first: Frame, frames: Iterable[Frame]) -> None:
        # only a film needs it
        from player.film.encoder import ENCODERS, encode, padded_size

        alpha = self.transparent and kind in ALPHA
        size = (first.shape[1], first.shape[0])
        if self.transparent and not alpha:
            self.note(f"{kind} holds no transparency: the background is black")
        if padded_size(size) != size:
            self.note(f"{size[0]}x{size[1]} padded to even numbers, as video needs")
        encoder = ENCODERS[kind, alpha]
        self.note(f"encoded by {encoder.name}")
        images = chain([first], frames)
        encode(file, kind, encoder, map(straight, images) if alpha else images, size, self.rate, self.quality)

    def note(self, line: str) -> None:
        """Add a note for the user, printed once when the film is done."""
        if line not in self.notes:
            self.notes.append(line)


def save_sequence(file: IO[bytes], kind: str, pictures: Iterator[Image.Image], rate: float) -> None:
    """Pictures as a .gif or .webp that runs in a loop."""
    extra = {"quality": 85, "duration": 1000 / rate} if kind == ".webp" else {"disposal": 2}
    if kind == ".gif":
        pictures = _timed(pictures, rate)
    next(pictures).save(file, PICTURE_SEQUENCES[kind], save_all=True, append_images=pictures, loop=0, **extra)


def _timed(pictures: Iterator[Image.Image], rate: float) -> Iterator[Image.Image]:
    """Pictures of a .gif with how long each is shown: whole hundredths of a second, in all the film's own length.

    Viewers show what is to be shown for less than two hundredths ten times as long: such pictures are left out.
    """
    held, began, number = next(pictures), 0, 0
    for number, picture in enumerate(pictures, 1):
        now = round(100 * number / rate)
        if now - began >= 2:
            held.info["duration"] = 10 * (now - began)
            yield held
            held, began = picture, now
    held.info["duration"] = 10 * max(round(100 * (number + 1) / rate) - began, 2)
    yield held


def join_pieces(pieces: Sequence[tuple[Path, int]], path: Path | str, rate: float) -> None:
    """Make the film of its pieces, in their order: nothing is drawn or encoded again, and the pieces stay.

    Pieces of a folder, a .gif or a .webp are folders of PNG frames.

    Raises:
        AssetError: a piece is missing, is no video, holds another number of frames or was encoded otherwise.
    """
    kind = film_kind(path)
    if kind in VIDEO:
        from player.film.encoder import join

        with whole_file(path) as file:
            join(pieces, file, kind, rate)
        return
    names = []
    for piece, count in pieces:
        found = sorted(piece.glob("*.png"))
        if len(found) != count:
            raise AssetError(f"{piece}: expected {count} frames, found {len(found)}; draw it again")
        names += found
    if kind == "":
        with whole_folder(path) as folder:
            for number, name in enumerate(names):
                _linked(name, folder / f"{number:06d}.png")
        return
    with whole_file(path) as file:
        save_sequence(file, kind, (Image.fromarray(read_picture(name, None)) for name in names), rate)


def straight(image: Frame) -> Frame:
    """Colours divided by their alpha, as PNG and VP9 store them; 0 where nothing was drawn."""
    alpha = image[..., 3]
    partly = (alpha != 255) & (alpha != 0)
    if not partly.any():  # without antialiasing every pixel is there or not
        return image
    out = image.copy()
    some = image[partly].astype(np.uint16)
    out[partly, :3] = np.minimum((some[:, :3] * 255 + some[:, 3:] // 2) // some[:, 3:], 255)
    return out


def _linked(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # a file system without hard links
        shutil.copyfile(source, target)
