"""Pixels behind the avatars: a picture, a film or a panorama, made ready at the size of the image.

Arrays are sRGB, premultiplied, row 0 on top. Nothing here touches OpenGL.
"""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image

from command.errors import AssetError
from files.input_file import name_order, one_line, open_film
from files.picture import MAX_PIXELS, WITH_WEBP, read_picture
from player.effects.radiance import read_radiance

RGBA = tuple[float, float, float, float]
Pixels = UInt8[np.ndarray, "_ _ 4"]  # rows, columns
PICTURES = (".png", ".jpg", ".jpeg", ".webp")
PANORAMA_WIDTH = 4096  # texels at most: a view of 60 degrees then still has 680 of them across
FAR = 2.0  # seconds; to go further ahead in a film, seek instead of decoding what lies between


class Placing(NamedTuple):
    """How pictures of any size fill the image."""

    # cover, contain or stretch: see `placed`
    fit: str = "cover"
    color: RGBA = (0.0, 0.0, 0.0, 0.0)  # premultiplied, where the picture does not reach


def placed(size: tuple[int, int], into: tuple[int, int], fit: str) -> tuple[int, int, int, int]:
    """Where a picture of `size` lies in an image `into`: left, top, width, height, pixels; may stick out.

    cover fills the image, contain shows the whole picture, stretch does both and distorts.
    """
    (w, h), (W, H) = size, into
    if fit == "stretch":
        return 0, 0, W, H
    scale = (max if fit == "cover" else min)(W / w, H / h)
    width, height = max(1, round(w * scale)), max(1, round(h * scale))
    return (W - width) // 2, (H - height) // 2, width, height


def fitted(picture: Pixels, into: tuple[int, int], fit: str, color: RGBA) -> Pixels:
    """A picture (straight alpha) scaled and laid over a colour; what sticks out is not made."""
    across, down = picture.shape[1], picture.shape[0]
    left, top, width, height = placed((across, down), into, fit)
    if (width, height) == (across, down):
        return laid(picture, left, top, into, color)
    filter = Image.Resampling.LANCZOS if width < across else Image.Resampling.BICUBIC
    x, y = np.clip((left, left + width), 0, into[0]), np.clip((top, top + height), 0, into[1])
    (x0, x1), (y0, y1) = (x - left) * across / width, (y - top) * down / height
    size = (int(x[1] - x[0]), int(y[1] - y[0]))
    scaled = Image.fromarray(picture).resize(size, filter, box=(float(x0), float(y0), float(x1), float(y1)))
    return laid(np.asarray(scaled), int(x[0]), int(y[0]), into, color)


def laid(picture: Pixels, left: int, top: int, into: tuple[int, int], color: RGBA) -> Pixels:
    """A picture (straight alpha) at its place on an image of one colour; what sticks out is cut off."""
    width, height = into
    out = np.empty((height, width, 4), np.uint8)
    out[:] = np.round(255 * np.array(color))
    x, y = max(left, 0), max(top, 0)
    part = picture[y - top : height - top, x - left : width - left]
    window = out[y : y + part.shape[0], x : x + part.shape[1]]
    if part[..., 3].min(initial=255) == 255:
        window[:] = part
    else:
        alpha = part[..., 3:].astype(np.float32) / 255
        straight = part.astype(np.float32)
        straight[..., 3] = 255
        window[:] = np.round(straight * alpha + window * (1 - alpha))
    return out


def folder_names(folder: Path) -> list[str]:
    """What is in a folder, in the order of the names, hidden files left out; AssetError: it may not be looked into."""
    try:
        return sorted((name for name in os.listdir(folder) if not name.startswith(".")), key=name_order)
    except OSError as error:
        raise AssetError(f"{folder}: cannot be read: {error.strerror}") from None


def pictures_in(folder: Path) -> list[Path]:
    """The pictures in a folder; AssetError as in `folder_names`."""
    return [folder / name for name in folder_names(folder) if name.lower().endswith(PICTURES)]


def _picture(path: Path | str) -> Pixels:
    """A picture file as sRGB with straight alpha, turned as its camera was held."""
    return read_picture(path, "RGBA", formats=WITH_WEBP, upright=True)


def read_panorama(path: Path | str) -> Float32[np.ndarray, "height width 3"]:
    """Linear light from all directions (equirectangular), halved until it is at most PANORAMA_WIDTH wide.

    Raises:
        AssetError: no Radiance picture, or not twice as wide as high.
    """
    image = read_radiance(path)
    height, width = image.shape[:2]
    if width != 2 * height:
        raise AssetError(f"{path}: a panorama should be twice as wide as high, is {width}x{height}")
    while image.shape[1] > PANORAMA_WIDTH:
        if image.shape[0] % 2:
            image = image[:-1, :-2]
        image = image.reshape(image.shape[0] // 2, 2, -1, 2, 3).mean((1, 3))
    return image


class PictureSequence:
    """PictureSequence that follow one another at a rate; the last one stays, and a single one is the same at all times.

    Raises:
        AssetError: the first cannot be read.
    """

    def __init__(self, files: Sequence[Path], placing: Placing, rate: float = 1.0):
        self.files, self.placing, self.rate = files, placing, rate
        # the number of the one that is in memory
        self._held = 0, _picture(files[0])

    def number(self, seconds: float) -> int:
        return min(max(int(seconds * self.rate + 1e-6), 0), len(self.files) - 1)

    def pixels(self, seconds: float, size: tuple[int, int]) -> Pixels:
        number = self.number(seconds)
        if self._held[0] != number:
            self._held = number, _picture(self.files[number])
        return fitted(self._held[1], size, *self.placing)

    def close(self) -> None:
        """Nothing is open."""


class Video:
    """A film, one decoded frame in memory. The last frame stays. Only opening it imports the decoder."""

    def __init__(self, path: Path, placing: Placing):
        self.path, self.placing = path, placing
        self.container = open_film(path)
        self.stream = self.container.streams.video[0]
        self._check_size(self.stream.width, self.stream.height)
        self.stream.thread_type = "AUTO"
        try:
            self._start()
        except AssetError:
            self.close()
            raise

    def _check_size(self, width: int, height: int) -> None:
        if width * height > MAX_PIXELS:
            limit = f"a film of at most {MAX_PIXELS} pixels a frame"
            raise AssetError(f"{self.path}: expected {limit}, found {width} x {height}")

    def _start(self, seconds: float = 0.0) -> None:
        import av.error

        tick, origin = self.stream.time_base, self.stream.start_time or 0
        if not tick:
            raise AssetError(f"{self.path}: the film has no time base")
        try:
            self.container.seek(origin + max(int(seconds / tick), 0), stream=self.stream)
        except (OSError, OverflowError, av.error.FFmpegError) as error:
            raise AssetError(f"{self.path}: cannot be read as a film: {one_line(error)}") from None
        self.frames: Iterator = self._decoded()
        self.shown, self.coming = None, next(self.frames, None)
        # beyond the end: from the start, to the last frame
        if self.coming is None and seconds > 0:
            self._start()
        if self.coming is None:
            raise AssetError(f"{self.path}: holds no frame")

    def _decoded(self) -> Iterator:
        import av.error

        try:
            for frame in self.container.decode(self.stream):
                self._check_size(frame.width, frame.height)
                if frame.pts is None:
                    raise AssetError(f"{self.path}: a frame of the film has no time")
                yield frame
        except (OSError, ValueError, av.error.FFmpegError) as error:
            raise AssetError(f"{self.path}: a frame of the film cannot be read: {one_line(error)}") from None

    def _time(self, frame) -> float:
        return float((frame.pts - (self.stream.start_time or 0)) * self.stream.time_base)

    def _seek(self, seconds: float) -> None:
        """Decode until the frame that is shown at this time; a tick early is soon enough."""
        seconds = max(seconds, 0.0) + 1e-4
        if self.shown is not None and not (self._time(self.shown) <= seconds):
            self._start(seconds)
        elif self.coming is not None and self._time(self.coming) + FAR < seconds:
            self._start(seconds)
            if self.shown is None and self.coming is not None and self._time(self.coming) > seconds:
                self._start()
        while self.shown is None or (self.coming is not None and self._time(self.coming) <= seconds):
            self.shown, self.coming = self.coming, next(self.frames, None)

    def number(self, seconds: float) -> int:
        self._seek(seconds)
        assert self.shown is not None
        return self.shown.pts

    def pixels(self, seconds: float, size: tuple[int, int]) -> Pixels:
        """The frame that is shown at this time, turned as the camera was held."""
        self._seek(seconds)
        assert self.shown is not None
        turned = self.shown.rotation % 180 != 0
        source = (self.shown.width, self.shown.height)
        left, top, width, height = placed(source[::-1] if turned else source, size, self.placing.fit)
        across, down = (height, width) if turned else (width, height)
        image = self.shown.reformat(width=across, height=down, format="rgba").to_ndarray()
        image = np.rot90(image, self.shown.rotation // 90 % 4)
        return laid(image, left, top, size, self.placing.color)

    def close(self) -> None:
        self.container.close()


Source = PictureSequence | Video
