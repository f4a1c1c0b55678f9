"""Video encoders: which one a film of each kind uses, and frames into one closed part of a video file.

A part begins with a fresh encoder, so it starts with a key frame, refers to nothing outside and comes out the same
whether the frames before it were encoded just now, yesterday or on another machine. A film is its parts, joined
without encoding again.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import IO

import av
import numpy as np
from av.video.reformatter import ColorPrimaries, ColorRange, Colorspace, ColorTrc, Interpolation, VideoReformatter
from jaxtyping import UInt8

from command.errors import AssetError
from command.interrupt import StopRequest, deferred_stop
from files.input_file import open_film
from player.scene.arguments import QUALITIES

Frame = UInt8[np.ndarray, "height width 4"]
# the number of threads shapes what x264 and VP9 write: the same on every machine, whatever its cores
THREADS = 4
BT709 = {
    "dst_colorspace": Colorspace.ITU709,
    "dst_color_range": ColorRange.MPEG,
    "dst_color_primaries": ColorPrimaries.BT709,
    "dst_color_trc": ColorTrc.BT709,
}


@dataclass(frozen=True)
class Encoder:
    name: str
    pixel_format: str
    options: tuple[tuple[str, str], ...] = ()
    # the option that sets quality; its value for each of QUALITIES
    dial: tuple[str, int, int, int] | None = None

    def at(self, quality: str) -> dict[str, str]:
        options = dict(self.options)
        if self.dial is not None:
            options[self.dial[0]] = str(self.dial[1 + QUALITIES.index(quality)])
        return options


# without macroblock trees: x264 165 sums them with AVX-512 so that one film, encoded twice, differs (seen at 64x64 to
# 320x240); on other processors they would differ by rounding. At the same PSNR the file is 8 % larger
X264 = Encoder("libx264", "yuv420p", (("preset", "veryfast"), ("mbtree", "0")), ("crf", 29, 20, 14))
VP9 = (("b", "0"), ("deadline", "realtime"), ("cpu-used", "6"), ("auto-alt-ref", "0"))
PRORES = (("profile", "4444"),)
# by ending and whether it holds alpha
ENCODERS = {
    (".mp4", False): X264,
    (".webm", False): Encoder("libvpx-vp9", "yuv420p", VP9, ("crf", 36, 24, 14)),
    (".webm", True): Encoder("libvpx-vp9", "yuva420p", VP9, ("crf", 36, 24, 14)),
    (".mov", False): Encoder("prores_ks", "yuv444p10le", PRORES),
    (".mov", True): Encoder("prores_ks", "yuva444p10le", PRORES),
}


def padded_size(size: tuple[int, int]) -> tuple[int, int]:
    """Even numbers, as 4:2:0 video needs: a row or column more, never another scale."""
    return size[0] + size[0] % 2, size[1] + size[1] % 2


def exact_rate(rate: float) -> Fraction:
    """Frames per second as containers hold it; 1001 keeps 29.97 and 23.976 exact."""
    return Fraction(rate).limit_denominator(1001)


def encode(
    file: IO[bytes] | str, kind: str, encoder: Encoder, frames: Iterable[Frame], size: tuple[int, int], rate: float,
    quality: str = "good",
) -> int:  # fmt: skip
    """Write frames as one closed part, a whole video file of its own, and say how many there were.

    Frames are read where they lie: no copy, no drop of a channel. A frame may be changed as soon as the next is
    asked for.
    """
    width, height = padded_size(size)
    padded = np.empty((height, width, 4), np.uint8) if (width, height) != size else None
    each = exact_rate(rate)
    reformatter, number = VideoReformatter(), 0
    with av.open(file, "w", format=kind[1:]) as container:
        stream = container.add_stream(encoder.name, rate=each, options=encoder.at(quality))
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = width, height, encoder.pixel_format
        context = stream.codec_context
        context.colorspace, context.color_range = Colorspace.ITU709, ColorRange.MPEG
        context.color_primaries, context.color_trc = ColorPrimaries.BT709, ColorTrc.BT709
        context.thread_count = THREADS
        for image in frames:
            if padded is not None:
                padded[: size[1], : size[0]] = image
                padded[size[1] :], padded[:, size[0] :] = padded[size[1] - 1], padded[:, size[0] - 1 : size[0]]
                image = padded
            picture = reformatter.reformat(
                av.VideoFrame.from_numpy_buffer(image, "rgba"), format=encoder.pixel_format,
                interpolation=Interpolation.BICUBIC, threads=1, **BT709,
            )  # fmt: skip
            picture.pts, picture.time_base = number, 1 / each
            container.mux(stream.encode(picture))
            number += 1
        container.mux(stream.encode(None))
    return number


def join(parts: Sequence[tuple[Path, int]], file: IO[bytes] | str, kind: str, rate: float) -> None:
    """Parts of a video and their numbers of frames, joined in one file; packets are copied, not encoded again.

    Raises:
        AssetError: a part is not a video, lacks frames, or was encoded otherwise than the first.
        Stopped: a signal came. PyAV drops what is raised while it writes, and with it what it was writing.
    """
    with deferred_stop(patience=math.inf) as stop:
        _join(parts, file, kind, exact_rate(rate), stop)
        stop.check()


def _join(
    parts: Sequence[tuple[Path, int]], file: IO[bytes] | str, kind: str, each: Fraction, stop: StopRequest
) -> None:
    with av.open(file, "w", format=kind[1:]) as container:
        stream, made_with, start = None, None, 0
        for part, count in parts:
            stop.check()
            with open_film(part, "a part of a film") as source:
                video = source.streams.video[0]
                context = video.codec_context
                made = (context.name, context.width, context.height, context.pix_fmt, context.extradata)
                if stream is None:
                    stream, made_with = container.add_stream_from_template(video), made
                    stream.time_base = 1 / each
                    # PyAV drops it, and with it that a .mov is ProRes 4444 (it would say 422 HQ)
                    stream.codec_context.codec_tag = context.codec_tag
                elif made != made_with:
                    raise AssetError(f"{part}: encoded otherwise than {parts[0][0]}; draw it again")
                found = 0
                for packet in source.demux(video):
                    if packet.size == 0:
                        continue
                    assert packet.pts is not None and packet.dts is not None and packet.time_base is not None
                    # whole frames: a .webm rounds to milliseconds, and roundings must not add up
                    scale = packet.time_base * each
                    packet.pts = round(packet.pts * scale) + start
                    packet.dts = round(packet.dts * scale) + start
                    packet.duration, packet.time_base, packet.stream = 1, 1 / each, stream
                    container.mux(packet)
                    found += 1
                if found != count:
                    raise AssetError(f"{part}: expected {count} frames, found {found}; draw it again")
            start += count
