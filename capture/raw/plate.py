"""The empty room: from frames before the person steps in, else from what each pixel showed beside the person."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array
from scipy import ndimage

from avatar.motion.clip import spread_frames
from capture.keypoints.record import Keypoints
from capture.raw.limbs import hull
from capture.raw.video_file import VideoFile, read_frames

# frames that a plate is made of, and how many must show a pixel free for it to be known
FRAMES, FREE = 15, 3
# grey levels: no sensor is better
LEAST_NOISE = 1.2


@dataclass(frozen=True)
class Plate:
    """The room without anybody."""

    color: Float[Array, "height width 3"]  # float32, sRGB 0 to 255
    known: Bool[Array, "height width"]
    noise: float  # deviation of a pixel, grey levels

    # for every frame the same: found once
    @cached_property
    def smooth(self) -> Float[Array, "height width 3"]:
        """The room as blurred as pictures are before they are compared with it."""
        return smoothed(self.color)

    @cached_property
    def detail(self) -> Float[Array, "height width"]:
        """How far the room departs from itself blurred, grey levels: edges that encoders shift."""
        return np.abs(self.color - ndimage.gaussian_filter(self.color, (1.5, 1.5, 0))).max(-1)


def smoothed(picture: Float[Array, "height width 3"]) -> Float[Array, "height width 3"]:
    """A picture without the noise of single pixels."""
    sigma = 0.8 * max(1.0, min(picture.shape[:2]) / 1080)
    return np.asarray(ndimage.gaussian_filter(picture, (sigma, sigma, 0), truncate=3.0))


def plate_of_empty(video: VideoFile, frames: Int[Array, "empty"]) -> Plate:
    """The median of empty frames."""
    chosen = frames[spread_frames(len(frames), FRAMES)]
    pictures = [frame.picture for frame in read_frames(video, only=frozenset(int(i) for i in chosen))]
    color = np.empty(pictures[0].shape, np.float32)
    # some rows at a time
    for rows in _stripes(len(color)):
        color[rows] = np.median([picture[rows] for picture in pictures], axis=0)
    middle = pictures[len(pictures) // 2].astype(np.float32)
    # exposure rolls: what all pixels share is no noise
    off = middle - color
    off -= np.median(off, axis=(0, 1))
    noise = 1.48 * float(np.median(np.abs(off)))
    return Plate(color, np.ones(color.shape[:2], bool), max(noise, LEAST_NOISE))


def plate_of_free(pictures: Sequence[UInt8[Array, "height width 3"]], keypoints: Keypoints) -> Plate:
    """The median of what frames show well beside the person; pixels that are never free are not known."""
    free = np.stack([~hull(keypoints, i, picture.shape[:2]) for i, picture in enumerate(pictures)])
    color = np.zeros(pictures[0].shape, np.float32)
    known = free.sum(0) >= FREE
    for rows in _stripes(len(color)):
        values = np.stack([picture[rows] for picture in pictures]).astype(np.float32)
        # ordered with what is hidden at the end, the median is in the middle of the rest
        values[~free[:, rows]] = np.inf
        values.sort(axis=0)
        middle = np.maximum(free[:, rows].sum(0) - 1, 0) // 2
        color[rows] = np.take_along_axis(values, middle[None, :, :, None], 0)[0]
    color[~known] = 0
    return Plate(color, known, 2 * LEAST_NOISE)


def _stripes(height: int):
    return (slice(first, first + 64) for first in range(0, height, 64))
