"""What fitting begins and ends with: videos as filmed, with masks and keypoints; a person and cameras.

    RawScan --capture.fit.fit_scan--> FittedScan --capture.read.video--> capture folder

Memory: pictures stay files until asked for, masks may be memory maps. 100 frames of 1080p in four videos are .8 GB of
masks and 6 MB for a picture in hand.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from avatar.camera import Camera
from avatar.skeleton import PARTS
from capture.frame_files import sized_picture
from capture.keypoints.record import Keypoints
from capture.read.template import TemplateMesh


@dataclass(frozen=True)
class RawVideo:
    """The frames kept of one video. Row i of all fields is one frame."""

    part: str  # one of PARTS
    size: tuple[int, int]  # width, height in pixels
    rate: float  # frames per second of the video; those kept are fewer
    frames: Int[Array, "frames"]  # their numbers in the video, rising
    pictures: tuple[Path, ...]
    # share of the pixel that is the person, 0 to 255: between them only at the rim
    masks: UInt8[Array, "frames height width"]
    keypoints: Keypoints
    focal: float | None  # pixels, where the user gives it
    # pixels, by what the phone wrote into the file
    focal_written: float | None = None
    # points of more frames than those kept; None: no more
    track: Keypoints | None = None

    def __post_init__(self):
        if self.part not in PARTS:
            raise ValueError(f"part should be one of {PARTS}, is {self.part!r}")
        count = len(self.frames)
        counts = (len(self.pictures), len(self.masks), len(self.keypoints.pixels))
        if counts != (count,) * 3:
            raise ValueError(f"pictures, masks and keypoints should be {count} as frames, are {counts}")
        if self.masks.shape[:0:-1] != self.size:
            raise ValueError(f"masks should be {self.size} pixels as the video, are {self.masks.shape[:0:-1]}")

    def picture(self, i: int) -> UInt8[Array, "height width 3"]:
        """Frame i of those kept, sRGB; AssetError where its file cannot be read or has another size."""
        return sized_picture(self.pictures[i], self.size, "as the video")


@dataclass(frozen=True)
class RawScan:
    """The videos of one person, by part: the body's, and of head and hands those that were filmed."""

    videos: Mapping[str, RawVideo]

    def __post_init__(self):
        if "body" not in self.videos or not set(self.videos) <= set(PARTS):
            raise ValueError(f"videos should be of {PARTS}, the body's among them, are {tuple(self.videos)}")


@dataclass(frozen=True)
class FittedVideo:
    """Cameras and poses of the kept frames of one video.

    Body and hands: one world, +y up, metres, in which the camera of a phone on a tripod stands still. Head: the cameras
    go round the head, in a frame fixed to it, of free scale (Eq. 6 finds it by the landmarks).
    """

    cameras: tuple[Camera, ...]  # one a frame
    axis_angle: Float[Array, "frames 52 3"] | None  # head: none
    root: Float[Array, "frames 3"] | None  # pelvis joint in the world; head: none
    # frames that may be trained on; the others did not fit, and notes say so
    usable: Bool[Array, "frames"]
    # head: joint angles of the person who goes with the head's bone; None: unknown
    trunk: Float[Array, "frames 52 3"] | None = None


@dataclass(frozen=True)
class FittedScan:
    """The person of a RawScan: a template and where it stands in every frame; all parts, those not filmed as the body's
    video shows them."""

    template: TemplateMesh
    videos: Mapping[str, FittedVideo]
    # places of the head, at least 6: in the frame of the head's cameras, and the template's vertices at them
    landmarks: Mapping[str, tuple[Float[Array, "3"], int]]
    # what was assumed or left out, one line each
    notes: tuple[str, ...] = ()

    @property
    def focal(self) -> float:
        """The phone's focal length, in shorter sides of its pictures."""
        camera = self.videos["body"].cameras[0]
        return float(camera.K[0, 0]) / min(camera.size)
