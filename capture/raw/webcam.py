"""A webcam: its pictures one after the other, and films written of them as they come."""

import errno
import sys
from collections.abc import Iterator
from fractions import Fraction
from typing import IO

import av
from av.container import InputContainer
from av.error import FFmpegError
from av.video.frame import VideoFrame

from command.errors import AssetError

# FFmpeg's name of a system's cameras, and what asks one for compressed pictures: others come at 10 a second
SYSTEMS = {
    "linux": ("video4linux2", {"input_format": "mjpeg"}), "darwin": ("avfoundation", {}),
    "win32": ("dshow", {"vcodec": "mjpeg"}),
}  # fmt: skip
# what is asked of a camera, first of all; larger pictures are not encoded in time on two cores
WANTED = {"video_size": "1280x720", "framerate": "30"}
# parts of a second that films count in, since webcams keep no rate
TICKS = 90_000


class Webcam:
    """An open camera. `size` is width and height."""

    def __init__(self, container: InputContainer):
        self._container = container
        context = container.streams.video[0].codec_context
        self.size = context.width, context.height

    def frames(self) -> Iterator[VideoFrame]:
        """Its pictures as they come, each with its `time` in seconds; AssetError when the camera is pulled out."""
        said = "it ended"
        try:
            yield from self._container.decode(video=0)
        except (FFmpegError, OSError) as error:
            said = error.strerror
        raise AssetError(f"the camera stopped: {said}")

    def close(self) -> None:
        self._container.close()


def open_camera(name: str) -> Webcam:
    """The camera that is called so or has that number in the system's list; the first one where the name is empty.

    Raises:
        AssetError: there is none, or another program has it.
    """
    system, compressed = SYSTEMS.get(sys.platform, SYSTEMS["linux"])
    try:
        devices = [device for device in av.enumerate_input_devices(system) if "video" in device.media_types]
    except FFmpegError:
        devices = []
    chosen = [device for number, device in enumerate(devices)
              if name in ("", str(number), device.name) or name.lower() in device.description.lower()]  # fmt: skip
    if not chosen:
        there = ", ".join(f"{number} {device.description}" for number, device in enumerate(devices))
        raise AssetError(f"no camera{f' {name}' if name else ''} found; there are {there or 'none'}")
    place = f"video={chosen[0].name}" if system == "dshow" else chosen[0].name
    said = ""
    for options in (WANTED | compressed, WANTED, {}):
        try:
            return Webcam(av.open(place, format=system, options=options))
        except (FFmpegError, OSError) as error:
            busy = error.errno == errno.EBUSY
            said = "another program has it: close that" if busy else str(error.strerror)
    raise AssetError(f"the camera {chosen[0].description} cannot be opened: {said}")


class WebcamFilm:
    """An .mp4 of pictures as they come, each at its time."""

    def __init__(self, file: IO[bytes], size: tuple[int, int]):
        self._container = av.open(file, "w", format="mp4")
        # fast enough to film by, good enough to be measured in
        options = {"preset": "superfast", "crf": "18"}
        self._stream = self._container.add_stream("libx264", rate=30, options=options)
        # 4:2:0 halves both sides
        self._stream.width, self._stream.height = (side - side % 2 for side in size)
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.time_base = Fraction(1, TICKS)

    def add(self, frame: VideoFrame, seconds: float) -> None:
        """A picture `seconds` from the beginning, later than the one before."""
        picture = frame.reformat(self._stream.width, self._stream.height, "yuv420p")
        picture.pts, picture.time_base = round(seconds * TICKS), Fraction(1, TICKS)
        self._container.mux(self._stream.encode(picture))

    def __enter__(self) -> "WebcamFilm":
        return self

    def __exit__(self, kind: object, *_rest: object) -> None:
        if kind is None:
            self._container.mux(self._stream.encode(None))
        self._container.close()
