"""Reading a video file: what it is, and its frames one after the other, upright, in constant memory."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from command.errors import AssetError
from files.input_file import open_film
from files.picture import MAX_PIXELS

if TYPE_CHECKING:
    import av

WHAT = "a video (H.264 or H.265 in .mp4 or .mov, as a phone writes it)"
# an hour at 60 frames a second: as many are counted
MOST_FRAMES = 216_000
# one side over the other; phones have 2.4 at most
LONGEST_SHAPE = 4
# a pixel's width over its height, from 1: coders round
SQUARE = 0.01
# transfer curves of HDR (ITU-T H.273: PQ, HLG); with BT.2020's colors shown as they are, skin is grey and white is not
HDR, BT709 = (16, 18), 1
# a film that does not say how its colors are written has BT.709's from so many lines on, BT.601's below (as players do)
UNTAGGED, HD = 2, 720
EQUIVALENT = "com.apple.quicktime.camera.focal_length.35mm_equivalent"
# millimetres: diagonal of 36 x 24, and lenses that are believed
DIAGONAL_35, LENSES = 43.27, (8.0, 400.0)


@dataclass(frozen=True)
class VideoFile:
    """A video as it is meant to be seen: phones held upright write it lying, with a note to turn it."""

    path: Path
    size: tuple[int, int]  # width, height, upright
    quarter_turns: int  # counterclockwise, that make a stored frame upright
    rate: float  # frames per second, on average
    frames: int  # by the file's header, or by its length; what is decoded counts
    # pixels, by what the phone wrote of its lens; None: it wrote nothing
    focal: float | None = None

    @property
    def name(self) -> str:
        return self.path.name


class VideoFrame(NamedTuple):
    """One frame; `number` counts from 0, `time` is in seconds from the first."""

    number: int
    time: float
    picture: Array


def open_video(path: Path | str) -> VideoFile:
    """What a video file says of itself, and its first frame.

    Raises:
        AssetError: absent, no video, no picture of a phone's size and shape, or no frame in it.
    """
    from av.error import FFmpegError

    path = Path(path)
    try:
        with open_film(path, WHAT) as container:
            stream = container.streams.video[0]
            _check_size(path, stream.codec_context.width, stream.codec_context.height)
            rate = float(stream.average_rate or stream.guessed_rate or 0)
            count = stream.frames or round(rate * float(container.duration or 0) / 1e6)
            aspect = float(stream.sample_aspect_ratio or 1)
            first = next(container.decode(stream), None)
            written = {**container.metadata, **stream.metadata}
    except (FFmpegError, ValueError, OSError) as error:
        raise AssetError(f"{path}: expected {WHAT}: {getattr(error, 'strerror', None) or error}") from None
    if first is None:
        raise AssetError(f"{path}: expected {WHAT}, found no frame")
    _check_size(path, first.width, first.height)
    if abs(aspect - 1) > SQUARE:
        raise AssetError(f"{path}: expected square pixels, found them {aspect:.3g} times as wide as high; write it "
                         "anew (ffmpeg -vf scale=iw*sar:ih,setsar=1), and find its keypoints then")  # fmt: skip
    if _mirrored(first):
        raise AssetError(f"{path}: expected a film as others see the person, found one that is to be shown mirrored; "
                         "write it anew (ffmpeg -vf hflip), and find its keypoints then")  # fmt: skip
    if not 1 <= rate <= 1000:
        raise AssetError(f"{path}: expected 1 to 1000 frames a second, found {rate:g}")
    turns = round(first.rotation / 90) % 4
    size = (first.width, first.height) if turns % 2 == 0 else (first.height, first.width)
    return VideoFile(path, size, turns, rate, max(count, 1), focal_written(written, size))


def _mirrored(frame: "av.VideoFrame") -> bool:
    """Whether a frame is to be shown mirrored, as front cameras write it: by the display matrix (ISO 14496-12)."""
    data = frame.side_data.get("DISPLAYMATRIX")
    if data is None:
        return False
    a, b, _, c, d, *_ = np.frombuffer(bytes(data), np.int32).astype(float).tolist()
    return a * d < b * c


def _check_size(path: Path, width: int, height: int) -> None:
    """Pictures are looked at 480 pixels high: of one 16 high, 8000 wide, each would become 240,000 wide."""
    if not (width * height <= MAX_PIXELS and max(width, height) <= LONGEST_SHAPE * min(width, height)):
        expected = f"frames of at most {MAX_PIXELS} pixels and {LONGEST_SHAPE} times as long as wide"
        raise AssetError(f"{path}: expected {expected}, found {width} x {height}")


def focal_written(metadata: Mapping[str, str], size: tuple[int, int]) -> float | None:
    """Focal length in pixels by the 35 mm equivalent that Apple's phones write; None: none, or no lens of a phone's.

    Equivalent is the angle over the diagonal (CIPA DCG-001): f / diagonal of the picture = f35 / 43.27 mm. It is in
    whole millimetres, and of the whole sensor: what a video's stabiliser cuts off makes it longer.
    """
    try:
        equivalent = float(metadata.get(EQUIVALENT, "nan"))
    except ValueError:
        return None
    if not LENSES[0] <= equivalent <= LENSES[1]:
        return None
    return equivalent / DIAGONAL_35 * float(np.hypot(*size))


def read_frames(
    video: VideoFile, height: int | None = None, *, grey: bool = False, only: frozenset[int] | None = None
) -> Iterator[VideoFrame]:
    """The frames of a video, sRGB or `grey`, `height` pixels high (None: as they are); of `only` these numbers.

    HDR is brought to the colors and the white of other films; `grey` stays as it is stored.

    Raises:
        AssetError: the file breaks off in the middle.
    """
    from av.error import FFmpegError
    from av.video.reformatter import VideoReformatter

    # one for all frames: HDR's table of colors takes a second
    reformat = VideoReformatter().reformat
    scale = 1.0 if height is None else height / video.size[1]
    size = tuple(max(2, round(side * scale)) for side in video.size)
    stored = size if video.quarter_turns % 2 == 0 else size[::-1]
    last = max(only) if only else MOST_FRAMES
    try:
        with open_film(video.path, WHAT) as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            begin = None
            for number, frame in enumerate(container.decode(stream)):
                begin = frame.time if begin is None else begin
                if number > last:
                    break
                if only is not None and number not in only:
                    continue
                shown = BT709 if frame.color_trc in HDR and not grey else None
                written = BT709 if frame.colorspace == UNTAGGED and min(video.size) >= HD else None
                format = "gray" if grey else "rgb24"
                picture = reformat(
                    frame, stored[0], stored[1], format, written, dst_color_trc=shown, dst_color_primaries=shown
                ).to_ndarray()
                time = number / video.rate if frame.time is None or begin is None else frame.time - begin
                yield VideoFrame(number, time, np.ascontiguousarray(np.rot90(picture, video.quarter_turns)))
    except (FFmpegError, ValueError, OSError) as error:
        raise AssetError(f"{video.path}: breaks off: {getattr(error, 'strerror', None) or error}") from None
