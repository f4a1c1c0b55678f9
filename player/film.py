"""Films and pictures from drawn frames, written in a thread of their own while the next frame is drawn.

Frames come as (height, width, 4) uint8, row 0 on top, premultiplied alpha, sRGB. Kinds by ending: .mp4 (H.264),
.webm (VP9, with alpha), .mov (ProRes 4444, with alpha), .gif, .webp, .png (one picture), anything without an
ending: a folder of PNG frames. Video is tagged BT.709; an odd size is padded by one row or column, never scaled.
"""

import queue
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import IO, Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from avatar.errors import AssetError
from avatar.files import whole_file, whole_folder

Frame = UInt8[np.ndarray, "height width 4"]
WAITING = 8  # frames that may wait for the encoder before drawing waits for it
# ending: (encoder, pixel format, options); the alpha formats are used when the background is transparent
VIDEO = {
    ".mp4": ("libx264", "yuv420p", {"preset": "veryfast", "crf": "18"}),
    ".webm": ("libvpx-vp9", "yuv420p", {"crf": "24", "b": "0", "deadline": "realtime", "cpu-used": "6"}),
    ".mov": ("prores_ks", "yuv444p10le", {"profile": "4444"}),
}
ALPHA_FORMAT = {".webm": "yuva420p", ".mov": "yuva444p10le"}
PICTURE_SEQUENCES = {".gif": "GIF", ".webp": "WEBP"}


def film_kind(path: Path | str) -> str:
    """The ending that decides how a film is written; "" is a folder of frames.

    Raises:
        ValueError: no such kind.
    """
    suffix = Path(path).suffix.lower()
    known = {"", ".png", *VIDEO, *PICTURE_SEQUENCES}
    if suffix not in known:
        raise ValueError(
            f"{path}: should end in {', '.join(sorted(known - {''}))} or be a folder; ends in {suffix}"
        )
    return suffix


class Film:
    """A film being written: `with Film(path, rate) as film: film.add(image)`. Appears whole or not at all."""

    def __init__(self, path: Path | str, rate: float, *, transparent: bool = False):
        if not (np.isfinite(rate) and rate > 0):
            raise ValueError(f"rate should be positive frames per second, is {rate}")
        self.path, self.kind, self.rate, self.transparent = Path(path), film_kind(path), rate, transparent
        self.frames = 0
        self.notes: list[str] = []
        self._queue: queue.Queue[Frame | None] = queue.Queue(WAITING)
        self._error: BaseException | None = None
        self._ended = False  # the drawing side has said that no more frames come
        self._thread = threading.Thread(target=self._work, name="film", daemon=True)

    def __enter__(self) -> "Film":
        self._thread.start()
        return self

    def add(self, image: Frame) -> None:
        """Hand over the next frame. The array must not be changed afterwards."""
        if self._error is None:
            self._queue.put(image)
            self.frames += 1
        if self._error is not None:
            raise self._error

    def __exit__(self, kind: object, error: BaseException | None, _trace: object) -> None:
        if error is not None:
            self._error = self._error or error  # the writer stops at the next frame and removes what it began
        self._queue.put(None)
        self._thread.join()
        if error is None and self._error is not None:
            raise self._error

    def _work(self) -> None:
        try:
            self._write(self._arriving())
        except BaseException as error:  # carried over to the drawing thread, which raises it
            self._error = self._error or self._said(error)
        while not self._ended:  # so that `add` is never left waiting
            self._ended = self._queue.get() is None

    def _said(self, error: BaseException) -> BaseException:
        """Errors of disk and encoder as one line that names the file; all others as they are."""
        if isinstance(error, OSError) or type(error).__module__.startswith("av."):
            return AssetError(f"{self.path}: cannot be written as {self.kind or 'frames'}: {error}")
        return error

    def _arriving(self) -> Iterator[Frame]:
        while True:
            image = self._queue.get()
            self._ended = image is None
            if self._error is not None:
                raise self._error
            if image is None:
                return
            yield image

    def _write(self, frames: Iterator[Frame]) -> None:
        if self.kind == "":
            with whole_folder(self.path) as folder:
                for number, image in enumerate(frames):
                    self._picture(image).save(folder / f"{number:06d}.png", compress_level=1)
            return
        with ExitStack() as stack:
            first = next(frames, None)
            if first is None:
                raise AssetError(f"{self.path}: no frames to write")
            file = stack.enter_context(whole_file(self.path))
            if self.kind == ".png":
                self._picture(first).save(file, "PNG", compress_level=1)
                for _ in frames:
                    raise AssetError(f"{self.path}: a .png holds one frame; give a folder or a film")
            elif self.kind in PICTURE_SEQUENCES:
                rest = (self._picture(image) for image in frames)
                duration = 1000 / self.rate
                self._picture(first).save(
                    file, PICTURE_SEQUENCES[self.kind], save_all=True, append_images=rest, duration=duration,
                    loop=0, **({"quality": 85} if self.kind == ".webp" else {"disposal": 2}),
                )  # fmt: skip
            else:
                self._video(file, first, frames)

    def _picture(self, image: Frame) -> Image.Image:
        return Image.fromarray(straight(image) if self.transparent else image[..., :3])

    def _video(self, file: IO[Any], first: Frame, frames: Iterator[Frame]) -> None:
        import av  # only a film needs it
        from av.video.reformatter import ColorPrimaries, ColorRange, Colorspace, ColorTrc

        encoder, pixel_format, options = VIDEO[self.kind]
        alpha = self.transparent and self.kind in ALPHA_FORMAT
        if alpha:
            pixel_format = ALPHA_FORMAT[self.kind]
        elif self.transparent:
            self.notes.append(f"{self.kind} holds no transparency: the background is black")
        height, width = first.shape[:2]
        if height % 2 or width % 2:
            self.notes.append(f"{width}x{height} padded to even numbers, as video needs")
        # Matroska and QuickTime take any fraction; 1001 keeps 29.97 and 23.976 exact
        rate = Fraction(self.rate).limit_denominator(1001)
        container = av.open(file, "w", format=self.kind[1:])
        try:
            stream = container.add_stream(encoder, rate=rate, options=options)
            assert isinstance(stream, av.VideoStream)
            stream.width, stream.height = width + width % 2, height + height % 2
            stream.pix_fmt = pixel_format
            context = stream.codec_context
            context.colorspace, context.color_range = Colorspace.ITU709, ColorRange.MPEG
            context.color_primaries, context.color_trc = ColorPrimaries.BT709, ColorTrc.BT709
            context.thread_count = 2
            for number, image in enumerate(_chained(first, frames)):
                padded = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), "edge")
                pixels = straight(padded) if alpha else np.ascontiguousarray(padded[..., :3])
                frame = av.VideoFrame.from_ndarray(pixels, "rgba" if alpha else "rgb24")
                frame = frame.reformat(
                    format=pixel_format, dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG,
                    dst_color_primaries=ColorPrimaries.BT709, dst_color_trc=ColorTrc.BT709,
                )  # fmt: skip
                frame.pts, frame.time_base = number, 1 / rate
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))
        finally:
            container.close()


def straight(image: Frame) -> Frame:
    """Colours divided by their alpha, as PNG and VP9 store them; 0 where nothing was drawn."""
    alpha = image[..., 3:].astype(np.uint16)
    colors = (image[..., :3].astype(np.uint16) * 255 + alpha // 2) // np.maximum(alpha, 1)
    return np.concatenate([np.minimum(colors, 255).astype(np.uint8), image[..., 3:]], -1)


def _chained(first: Frame, rest: Iterator[Frame]) -> Iterator[Frame]:
    yield first
    yield from rest
