"""The source video of a capture in the window: behind the avatar, and over it on one side of a movable line."""

import numpy as np

from player.scene.cameras import inner_box
from player.scene.capture_view import CaptureView
from player.window.picture import Box, PictureLayer
from player.window.state import WindowLayout

LINE = (1.0, 0.8, 0.2)
# window units beside the line where it can be grabbed
REACH = 6.0


class Wipe:
    """The video, where it lies, and how much of it covers the avatar."""

    def __init__(self, capture: CaptureView, layout: WindowLayout):
        self.capture, self.layout, self.picture = capture, layout, PictureLayer(layout.screen.context)
        # the share of the video's width that shows the video alone
        self.part = 0.5
        # the video is behind the avatar too; else the plain background is
        self.behind = True
        self.shown = -1  # frame whose picture is uploaded

    def move(self, part: float | int) -> None:
        self.part = float(np.clip(part, 0.0, 1.0))

    @property
    def box(self) -> Box:
        """Where the video lies in the free area of the window, pixels."""
        left, top, width, height = self.layout.area
        x, y, wide, high = inner_box(self.capture.cameras[0].size, (max(width, 1), max(height, 1)))
        return left + x, top + y, wide, high

    @property
    def line(self) -> float:
        """Where the line is, pixels from the left."""
        left, _, width, _ = self.box
        return left + self.part * width

    def near(self, x: float | int) -> bool:
        """Whether pixel x is so near the line that it can be grabbed there."""
        return abs(x - self.line) < REACH * self.layout.screen.scale

    def move_to(self, x: float | int) -> None:
        left, _, width, _ = self.box
        self.move((x - left) / width)

    def draw(self, frame: int | None, around: tuple[float, float, float]) -> None:
        """Draw a frame of the video, None where another camera is looked through, into the framebuffer in use, after
        the avatars were drawn on nothing (alpha 0). `around` is the colour under all that is left, and beside the
        video, where its camera saw nothing and the avatar is hidden too."""
        size = self.layout.screen.size
        if frame is not None:
            self._draw_video(frame, size, around)
        self.picture.fill(around, (0, 0, *size), size, under=True)

    def _draw_video(self, frame: int, size: tuple[int, int], around: tuple[float, float, float]) -> None:
        if frame != self.shown:
            self.picture.show(self.capture.image(frame), self.capture.cameras[frame])
            self.shown = frame
        left, top, width, height = box = self.box
        if self.behind:
            self.picture.draw(box, size, under=True)
        if self.part > 0:
            self.picture.draw(box, size, part=(left, top, round(self.line) - left, height))
        if 0 < self.part < 1:
            self.picture.fill(LINE, (round(self.line) - 1, top, 2, height), size)
        right, bottom = left + width, top + height
        for band in (
            (0, 0, left, size[1]), (right, 0, size[0] - right, size[1]),
            (left, 0, width, top), (left, bottom, width, size[1] - bottom),
        ):  # fmt: skip
            if band[2] > 0 and band[3] > 0:
                self.picture.fill(around, band, size)

    def release(self) -> None:
        self.picture.release()
