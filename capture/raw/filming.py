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
from jaxtyping import UInt8
from numpy import ndarray as Array
from PIL import Image, ImageDraw, ImageFont

from avatar.skeleton import PARTS
from capture.raw.four_videos import ENDINGS, NAMES
from capture.raw.judge import CALLED
from capture.raw.outline import COLOR, outline
from capture.raw.webcam import Shot, Webcam, WebcamFilm
from command.interrupt import Stopped, deferred_stop
from files.whole import whole_file

# of the picture that is shown and of what is written above and below it, pixels
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


def film_parts(folder: Path, camera: Webcam, show: Show) -> None:
    """Film what is not in the folder yet; the person may leave out all but the body.

    Raises:
        AssetError: the camera stopped, or a film cannot be written.
        Stopped: the window was closed, or a signal came; films that are there are kept.
    """
    studio = _Studio(camera, show)
    for part in PARTS:
        names = NAMES[part]
        there = any((folder / (name + ending)).exists() for name in names for ending in ENDINGS)
        while not there and studio.ready(part):
            with suppress(_Cancelled):
                studio.film(part, folder / f"{names[-1]}.mp4")
                there = True


class _Guide(NamedTuple):
    """What is drawn over the camera's picture."""

    part: str
    words: str
    keys: str
    recording: bool = False
    # seconds until the next step
    left: float | None = None
    # share of a turn
    turned: float | None = None


class _Studio:
    """The camera with its window."""

    def __init__(self, camera: Webcam, show: Show):
        self.show, self.size, self.shots = show, camera.size, camera.shots()

    def ready(self, part: str) -> bool:
        """Wait for the space key; False: the person leaves this film out."""
        optional = part != "body"
        guide = _Guide(part, READY[part], "Space: begin" + "     N: leave this film out" * optional)
        while True:
            pressed = self._show(next(self.shots), guide)
            if "space" in pressed or (optional and "n" in pressed):
                return "space" in pressed

    def film(self, part: str, path: Path) -> None:
        """Count down, then write the film."""
        self._run(part, (COUNTDOWN,), None)
        with whole_file(path) as file, WebcamFilm(file, self.size) as film:
            self._run(part, STEPS[part], film)

    def _run(self, part: str, steps: Sequence[Step], film: WebcamFilm | None) -> None:
        """Go through the steps, filming."""
        ends, begin = np.cumsum([step.seconds for step in steps]).tolist(), None
        for shot in self.shots:
            begin = shot.time if begin is None else begin
            now = shot.time - begin
            number = bisect(ends, now)
            if number == len(steps):
                return
            step, left = steps[number], ends[number] - now
            if film is not None:
                film.add(shot.frame, now)
            turned = 1 - left / step.seconds if step.turn else None
            guide = _Guide(part, step.words, "Escape: from the beginning", film is not None, left, turned)
            if "escape" in self._show(shot, guide):
                raise _Cancelled

    def _show(self, shot: Shot, guide: _Guide) -> Sequence[str]:
        picture = Image.fromarray(shot.frame.to_ndarray(format="rgb24")).transpose(Image.Transpose.FLIP_LEFT_RIGHT)
        with deferred_stop(patience=0) as stop:
            pressed = self.show(np.asarray(_drawn(picture, guide)))
        stop.check()
        if "close" in pressed:
            raise Stopped
        return pressed


def _drawn(picture: Image.Image, guide: _Guide) -> Image.Image:
    """The mirrored picture with the guide over it, and words above and below, where they hide nobody's feet."""
    wide, high = size = round(HEIGHT * picture.width / picture.height), HEIGHT
    out, line = Image.new("RGB", (wide, ABOVE + high + BELOW), DARK), outline(guide.part, size)
    out.paste(picture.resize(size), (0, ABOVE))
    out.paste(line, (0, ABOVE), line)
    draw = ImageDraw.Draw(out, "RGBA")

    def write(text: str, x: float | int, y: float | int, letter: float | int, anchor: str = "mm") -> None:
        draw.text((x, y), text, WHITE, ImageFont.load_default(letter), anchor)

    write(f"Film {PARTS.index(guide.part) + 1} of {len(PARTS)}: {CALLED[guide.part]}", 20, ABOVE / 2, 26, "lm")
    write(guide.words, wide / 2, ABOVE + high + 42, min(48, 2 * wide / len(guide.words)))
    write(guide.keys, wide / 2, ABOVE + high + 92, 24)
    if guide.recording:
        write("filming", wide - 20, ABOVE / 2, 26, "rm")
        draw.ellipse((wide - 140, ABOVE / 2 - 9, wide - 122, ABOVE / 2 + 9), RED)
    x, y, radius = wide - 110, ABOVE + 100, 70
    if guide.turned is not None:
        ring, angle = (x - radius, y - radius, x + radius, y + radius), 90 + 360 * guide.turned
        draw.ellipse(ring, (*DARK, 150), (*WHITE, 90), 12)
        # seen from above, the camera below
        draw.arc(ring, 90, angle, COLOR, 12)
        across, down = (radius - 6) * math.cos(math.radians(angle)), (radius - 6) * math.sin(math.radians(angle))
        draw.circle((x + across, y + down), 14, WHITE)
        write(f"{guide.turned:.0%}", x, y, 34)
    elif guide.left is not None:
        draw.circle((x, y), radius, (*DARK, 150))
        write(str(math.ceil(guide.left)), x, y, 90)
    return out
