"""Screenshots and films of what the window shows, without its panels and text."""

import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from command.errors import AssetError
from command.progress import plural
from files.whole import whole_file
from player.film.film import Film
from player.window.state import WindowState

FASTEST = 60.0  # frames a second of a film
# frames of a live film that a late picture stands for
MOST_AT_ONCE = 10


class WindowFilm:
    """A film being written from the window.

    A motion from a file is filmed frame after frame, however long each takes to draw. Live poses are filmed by the
    clock: a late picture stands for all frames it is late by.
    """

    def __init__(self, path: Path, rate: float, *, live: bool):
        self.path, self.live = path, live
        self.rate = rate / max(1, math.ceil(rate / FASTEST))
        self.film = Film(path, self.rate)
        self.film.__enter__()
        self.size: tuple[int, int] | None = None
        self.began: float | None = None
        self.frames = 0

    def add(self, image: UInt8[np.ndarray, "height width 4"], now: float) -> bool:
        """The picture of now; False when it has another size than the film.

        Raises:
            AssetError: the film cannot be written.
        """
        size = (image.shape[1], image.shape[0])
        self.size, self.began = self.size or size, now if self.began is None else self.began
        if size != self.size:
            return False
        count = 1
        if self.live:
            count = min(max(int((now - self.began) * self.rate) + 1 - self.frames, 0), MOST_AT_ONCE)
        for _ in range(count):
            self.film.add(image)
            self.frames += 1
        return True

    def close(self) -> str:
        """Write the film; what was done, in one line.

        Raises:
            AssetError: it could not be written.
        """
        if not self.frames:
            self.film.__exit__(ValueError, ValueError("no frames"), None)
            return f"{self.path}: no frame was drawn, no film written"
        self.film.__exit__(None, None, None)
        return f"{self.path} written: {plural(self.frames, 'frame')}, {self.rate:g} a second"


class Recorder:
    """Takes screenshots and films, each when it is asked for."""

    def __init__(self, state: WindowState, clock: Callable[[], float]):
        self._state, self._clock = state, clock
        self.film: WindowFilm | None = None
        self._shoot = False

    @property
    def wants_picture(self) -> bool:
        return self._shoot or self.film is not None

    @property
    def step(self) -> float | None:
        """Seconds that pass from frame to frame while a motion is filmed; None: by the clock."""
        return None if self.film is None or self.film.live else 1 / self.film.rate

    def shoot(self, *, on: bool = True) -> None:
        self._shoot = on

    def toggle_film(self) -> None:
        """Start a film, or write the one that runs; that it cannot be written is said."""
        if self.film is not None:
            with self._state.messages.saying_errors():
                self.close()
            return
        live = bool(self._state.playback.live)
        rate = 30.0 if live else self._state.timeline.rate
        self.film = WindowFilm(free_name("selfscan", ".mp4"), rate, live=live)
        self._state.messages.say(f"filming {self.film.path}; o ends it")

    def take(self, image: UInt8[np.ndarray, "height width 4"]) -> None:
        """The picture of now, for the screenshot and the film. What cannot be written is said, and ends the film."""
        messages = self._state.messages
        if self.film is not None:
            try:
                if not self.film.add(image, self._clock()):
                    self.toggle_film()
                    messages.say("the picture has another size now: the film ends here")
            except AssetError:
                # as it ends, it says why
                self.toggle_film()
        if self._shoot:
            self._shoot = False
            with messages.saying_errors():
                name = free_name("selfscan", ".png")
                save_picture(name, image)
                messages.say(f"{name} written")

    def close(self) -> None:
        """Write the film that runs.

        Raises:
            AssetError: it cannot be written.
        """
        film, self.film = self.film, None
        if film is not None:
            self._state.messages.say(film.close())


def save_picture(path: Path, image: UInt8[np.ndarray, "height width channels"]) -> None:
    """Write a PNG, whole or not at all."""
    with whole_file(path) as file:
        Image.fromarray(image[..., :3]).save(file, "PNG", compress_level=1)


def free_name(stem: str, suffix: str) -> Path:
    """The first of stem-000, stem-001 ... that is not there yet, in this folder."""
    return next(path for n in range(100_000) if not os.path.lexists(path := Path(f"{stem}-{n:03d}{suffix}")))
