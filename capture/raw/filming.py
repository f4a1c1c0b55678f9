"""Filming oneself with a webcam: an outline to stand in, what to do now, a countdown, and what is still to be shown.

For each film the person presses space, leaves the picture for the empty room that masks are made from, steps in and
turns. A film is written whole or not at all; one that is there is not filmed again.
"""

import math
from bisect import bisect
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
from av.video.frame import VideoFrame
from jaxtyping import UInt8
from numpy import ndarray as Array
from PIL import Image, ImageDraw, ImageFont

from avatar.skeleton import PARTS
from capture.raw.four_videos import NAMES, films_in, named_parts
from capture.raw.judge import CALLED
from capture.raw.outline import COLOR, outline
from capture.raw.webcam import Webcam, WebcamFilm
from command.interrupt import Stopped, deferred_stop
from files.whole import whole_file

# the picture as shown, and what is written above and below it, pixels
HEIGHT, ABOVE, BELOW = 720, 46, 116
WHITE, RED, DARK = (255, 255, 255), (230, 60, 50), (20, 22, 26)


class Step(NamedTuple):
    """A stretch of a film: its seconds, what the person does meanwhile, and whether that is a turn."""

    seconds: float
    words: str
    turn: bool = False


# before a film begins
COUNTDOWN = Step(5.0, "Leave the picture: the empty room comes first")
HAND = (Step(4.0, "Hold the hand in the outline, fingers apart and stiff"),
        Step(15.0, "Turn the forearm slowly: palm, edge, back, other edge", turn=True))  # fmt: skip
ROOM = Step(2.0, "The empty room: stay out of the picture")
STEPS = {
    "body": (ROOM, Step(6.0, "Step into the outline: arms level, fingers apart, palms down"),
             Step(25.0, "Turn round once, in small steps, as the mark does", turn=True)),
    "head": (ROOM, Step(5.0, "Sit down in the outline, face and neck stiff"),
             Step(20.0, "Turn the chair round once, as the mark does", turn=True),
             Step(20.0, "Once more, nodding a little", turn=True)),
    "hand_left": (ROOM, *HAND), "hand_right": (ROOM, *HAND),
}  # fmt: skip
READY = {
    "body": "Stand so far away that the outline holds you",
    "head": "Sit on a chair that turns, head and shoulders in the outline",
    "hand_left": "Hold your left hand so near that it fills the outline, palm to the camera",
    "hand_right": "Hold your right hand so near that it fills the outline, palm to the camera",
}


# a window: takes a picture to show and gives the names of the keys pressed since the last one, and "close" once it was
# closed
Show = Callable[[UInt8[Array, "height width 3"]], Sequence[str]]


class _Cancelled(Exception):
    """Escape was pressed: what was filmed is dropped."""


def unfilmed(folder: Path) -> list[str]:
    """The parts of which no film is in a folder."""
    filmed = named_parts(films_in(folder)) if folder.is_dir() else {}
    return [part for part in PARTS if part not in filmed]


def film_parts(folder: Path, camera: Webcam, show: Show) -> None:
    """Film what is not in the folder yet; the person may leave out all but the body.

    Raises:
        AssetError: the camera stopped, or a film cannot be written.
        Stopped: the window was closed, or a signal came; films that are there are kept.
    """
    studio = _Studio(camera, show)
    for part in unfilmed(folder):
        done = False
        while not done and studio.ready(part):
            with suppress(_Cancelled):
                studio.film(part, folder / f"{NAMES[part][-1]}.mp4")
                done = True


class _Studio:
    """The camera with its window."""

    def __init__(self, camera: Webcam, show: Show):
        self.show, self.size, self.frames = show, camera.size, camera.frames()

    def ready(self, part: str) -> bool:
        """Wait for the space key; False: the person leaves this film out."""
        step = Step(math.inf, READY[part])
        while True:
            pressed = self._show(next(self.frames), part, step, math.inf)
            if "space" in pressed or ("n" in pressed and part != "body"):
                return "space" in pressed

    def film(self, part: str, path: Path) -> None:
        """Count down, then film, step after step."""
        steps = (COUNTDOWN, *STEPS[part])
        ends, begin = np.cumsum([step.seconds for step in steps]).tolist(), None
        with whole_file(path) as file, WebcamFilm(file, self.size) as film:
            for frame in self.frames:
                assert frame.time is not None, "cameras stamp their pictures"
                begin = frame.time if begin is None else begin
                now = frame.time - begin
                number = bisect(ends, now)
                if number == len(steps):
                    break
                if number:
                    film.add(frame, now - ends[0])
                if "escape" in self._show(frame, part, steps[number], ends[number] - now):
                    raise _Cancelled

    def _show(self, frame: VideoFrame, part: str, step: Step, left: float) -> Sequence[str]:
        picture = Image.fromarray(frame.to_ndarray(format="rgb24")).transpose(Image.Transpose.FLIP_LEFT_RIGHT)
        with deferred_stop(patience=0) as stop:
            pressed = self.show(np.asarray(_drawn(picture, part, step, left)))
        stop.check()
        if "close" in pressed:
            raise Stopped
        return pressed


def _drawn(picture: Image.Image, part: str, step: Step, left: float) -> Image.Image:
    """The mirrored picture with its outline, words above and below it, where they hide nobody's feet, and the seconds
    left of the step; infinite: it waits for a key."""
    wide, high = size = round(HEIGHT * picture.width / picture.height), HEIGHT
    out, line = Image.new("RGB", (wide, ABOVE + high + BELOW), DARK), outline(part, size)
    out.paste(picture.resize(size), (0, ABOVE))
    out.paste(line, (0, ABOVE), line)
    draw, waits = ImageDraw.Draw(out, "RGBA"), math.isinf(left)

    def write(text: str, x: float | int, y: float | int, letter: float | int, anchor: str = "mm") -> None:
        draw.text((x, y), text, WHITE, ImageFont.load_default(letter), anchor)

    write(f"Film {PARTS.index(part) + 1} of {len(PARTS)}: {CALLED[part]}", 20, ABOVE / 2, 26, "lm")
    write(step.words, wide / 2, ABOVE + high + 42, min(48, 2 * wide / len(step.words)))
    keys = "Space: begin" + "     N: leave this film out" * (part != "body") if waits else "Escape: from the beginning"
    write(keys, wide / 2, ABOVE + high + 92, 24)
    if not waits and step is not COUNTDOWN:
        write("filming", wide - 20, ABOVE / 2, 26, "rm")
        draw.circle((wide - 131, ABOVE / 2), 9, RED)
    x, y, radius = wide - 110, ABOVE + 100, 70
    if step.turn:
        share = 1 - left / step.seconds
        ring, angle = (x - radius, y - radius, x + radius, y + radius), 90 + 360 * share
        draw.ellipse(ring, (*DARK, 150), (*WHITE, 90), 12)
        # seen from above, the camera below
        draw.arc(ring, 90, angle, COLOR, 12)
        across, down = (radius - 6) * math.cos(math.radians(angle)), (radius - 6) * math.sin(math.radians(angle))
        draw.circle((x + across, y + down), 14, WHITE)
        write(f"{share:.0%}", x, y, 34)
    elif not waits:
        draw.circle((x, y), radius, (*DARK, 150))
        write(str(math.ceil(left)), x, y, 90)
    return out
