"""Pictures of a video that stay files until they are asked for: 100 frames of 1080p are .6 GB."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np
from jaxtyping import Int, UInt8
from PIL import Image

from command.errors import AssetError
from files.picture import PHOTOS, read_picture
from files.whole import whole_file

Array = np.ndarray


def sized_picture(
    path: Path, size: tuple[int, int], like: str, mode: str | None = "RGB", formats: tuple[str, ...] = PHOTOS
) -> Array:
    """The pixels of a picture (files/picture.py) that should be so wide and high.

    Raises:
        AssetError: it cannot be read, or has another size than the one that `like` names.
    """
    pixels = read_picture(path, mode, formats=formats)
    if pixels.shape[1::-1] != size:
        raise AssetError(f"{path}: should be {size} pixels {like}, is {pixels.shape[1::-1]}")
    return pixels


def write_picture(path: Path, pixels: UInt8[Array, "height width *c"]) -> None:
    """Write a frame or its mask as PNG, whole or not at all."""
    with whole_file(path) as file:
        Image.fromarray(pixels).save(file, format="PNG", compress_level=1)


@dataclass(frozen=True)
class FrameFiles:
    """PNG files of one size, sRGB: `files[i]` reads frame i, `files[rows]` are some of them."""

    paths: tuple[Path, ...]
    size: tuple[int, int]  # height, width
    dtype = np.dtype(np.uint8)
    # in memory
    nbytes = 0

    @property
    def shape(self) -> tuple[int, int, int, int]:
        return len(self.paths), *self.size, 3

    def __len__(self) -> int:
        return len(self.paths)

    @overload
    def __getitem__(self, which: "int | np.integer") -> UInt8[Array, "height width 3"]: ...
    @overload
    def __getitem__(self, which: Int[Array, "k"]) -> "FrameFiles": ...
    def __getitem__(self, which: "int | np.integer | Int[Array, 'k']") -> "UInt8[Array, 'height width 3'] | FrameFiles":
        if isinstance(which, np.ndarray):
            return FrameFiles(tuple(self.paths[i] for i in which), self.size)
        return self._read(self.paths[which])

    def __iter__(self) -> Iterator[UInt8[Array, "height width 3"]]:
        return map(self._read, self.paths)

    def _read(self, path: Path) -> UInt8[Array, "height width 3"]:
        return sized_picture(path, (self.size[1], self.size[0]), "as before", formats=("PNG",))


# pictures of a video. To a type checker an array: who asks for files looks at whole frames, and at rows of them
Frames = Array if TYPE_CHECKING else Array | FrameFiles
