"""A first look at every frame of a video: small grey pictures, sharpness, and what the keypoints say of the person."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array
from scipy import ndimage

from capture.keypoints.record import Keypoints
from capture.raw.video_file import VideoFile, read_frames
from command.errors import AssetError
from command.progress import Progress

# pixels: height of the pictures kept, and of those that sharpness is measured on
SMALL, FINE = 160, 480
# confidence from which a point counts as found
SURE = 0.3
# points that make a person
FEWEST = 3
# below this a video cannot hold a turn
FEWEST_FRAMES = 20


@dataclass(frozen=True)
class Glance:
    """All frames of one video, small, with keypoints. Row i of all fields is a frame."""

    video: VideoFile
    part: str
    times: Float[Array, "frames"]  # seconds
    small: UInt8[Array, "frames height width"]
    sharpness: Float[Array, "frames"]  # mean strength of fine detail on the person, grey levels
    keypoints: Keypoints

    @property
    def scale(self) -> float:
        """Pixels of the video in one of the small pictures."""
        return self.video.size[1] / self.small.shape[1]

    @property
    def found(self) -> Bool[Array, "frames"]:
        """Whether a person was found in a frame."""
        return (self.keypoints.confidence > SURE).sum(1) >= FEWEST

    @property
    def boxes(self) -> Float[Array, "frames 4"]:
        """Left, top, right, bottom of the sure points, pixels; NaN where no person was found."""
        sure = (self.keypoints.confidence > SURE)[..., None]
        out = np.full((len(self.times), 4), np.nan)
        rows = self.found
        pixels = self.keypoints.pixels[rows]
        out[rows, :2] = np.where(sure[rows], pixels, np.inf).min(1)
        out[rows, 2:] = np.where(sure[rows], pixels, -np.inf).max(1)
        return out


def glance(video: VideoFile, part: str, keypoints: Keypoints, report: Progress, done: int = 0) -> Glance:
    """Look at every frame of a video.

    Raises:
        AssetError: another number of frames than the keypoints have, or too few.
    """
    count = len(keypoints.pixels)
    height, width = SMALL, max(2, round(video.size[0] * SMALL / video.size[1]))
    small = np.zeros((count, height, width), np.uint8)
    sharpness, times = np.zeros(count), np.zeros(count)
    number = -1
    at = Glance(video, part, times, small, sharpness, keypoints)
    boxes = at.boxes * FINE / video.size[1]
    for number, time, picture in read_frames(video, FINE, grey=True):
        if number >= count:
            continue
        rows = ndimage.uniform_filter(picture, FINE // SMALL)
        small[number] = rows[_picks(FINE, SMALL)][:, _picks(picture.shape[1], width)]
        times[number] = time
        sharpness[number] = _detail(picture, boxes[number])
        report.update(done + number + 1, part)
    if number + 1 != count:
        raise AssetError(
            f"{video.path}: the video has {number + 1} frames, its keypoints {count}; are they of this video?"
        )
    if count < FEWEST_FRAMES:
        raise AssetError(f"{video.path}: expected a turn of some 20 s, found {count} frames")
    return at


def _picks(length: int, wanted: int) -> Int[Array, "wanted"]:
    """Middles of `wanted` equal stretches."""
    return ((np.arange(wanted) + 0.5) * length / wanted).astype(int)


def _detail(picture: UInt8[Array, "height width"], box: Float[Array, "4"]) -> float:
    """Mean absolute Laplacian inside the box; 0 where there is none."""
    if not np.isfinite(box).all():
        return 0.0
    height, width = picture.shape
    left, top = np.clip(np.floor(box[:2]), 0, (width - 3, height - 3)).astype(int)
    right, bottom = np.clip(np.ceil(box[2:]), (left + 3, top + 3), (width, height)).astype(int)
    return float(np.abs(ndimage.laplace(picture[top:bottom, left:right].astype(np.float32))).mean())
