"""Screenshots of what the window shows, without its panels and text."""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from files.whole import whole_file
from player.window.state import Messages


class Recorder:
    """Takes a screenshot when it is asked for."""

    def __init__(self, messages: Messages):
        self._messages = messages
        self.wants_picture = False

    def shoot(self, *, on: bool = True) -> None:
        """A screenshot of the next frame."""
        self.wants_picture = on

    def take(self, image: UInt8[np.ndarray, "height width 4"]) -> None:
        """The picture of now."""
        self.wants_picture = False
        name = free_name("selfscan", ".png")
        save_picture(name, image)
        self._messages.say(f"{name} written")


def save_picture(path: Path, image: UInt8[np.ndarray, "height width channels"]) -> None:
    """Write a PNG, whole or not at all."""
    with whole_file(path) as file:
        Image.fromarray(image[..., :3]).save(file, "PNG", compress_level=1)


def free_name(stem: str, suffix: str) -> Path:
    """The first of stem-000, stem-001 ... that is not there yet, in this folder."""
    return next(path for n in range(100_000) if not (path := Path(f"{stem}-{n:03d}{suffix}")).exists())
