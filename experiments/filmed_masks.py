"""Masks of a raw video as `selfscan import video` makes them, of a film with one fault of a phone at a time."""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Integer, UInt8

from capture.keypoints.record import Keypoints
from capture.raw.masks import soft_mask
from capture.raw.plate import plate_of_empty
from capture.raw.video_file import open_video, read_frames
from player.film.encoder import X264, encode
from synth.light import StudioLight, light_of
from synth.photo import Studio
from synth.raw.backdrop import backdrop
from synth.raw.film import RATE, taken
from synth.raw.movement import RawShots
from synth.raw.phone import phone_of

# frames of the empty room
EMPTY_FRAMES = 9
# x264's constant rate factor that loses next to nothing
FINEST = 4


@dataclass(frozen=True)
class Faults:
    """What a phone does to a film: 1 is what phones do with exposure locked; crf is x264's constant rate factor (about
    20: a phone's file; 32: one that a messenger sent on)."""

    exposure: float = 0.0
    noise: float = 0.0
    crf: int = FINEST


def filmed_masks(
    studio: Studio, shots: RawShots, chosen: Integer[np.ndarray, "frames"], keypoints: Keypoints, faults: Faults,
    seed: list[int],
) -> UInt8[np.ndarray, "frames height width"]:  # fmt: skip
    """Soft masks of the chosen frames, from the film itself."""
    empty = np.flatnonzero(~shots.present)[:EMPTY_FRAMES]
    assert len(empty), "the film begins with an empty room"
    light = light_of("even", shots.part, 0)
    assert isinstance(light, StudioLight)
    behind = backdrop(shots.camera, shots.floor, False, seed[0])
    phone = phone_of(np.arange(len(shots.root)) / RATE, faults.exposure, faults.noise, seed)
    frame = np.full((*shots.camera.size[::-1], 4), 255, np.uint8)

    def filmed() -> Iterator[np.ndarray]:
        for i in [*empty.tolist(), *chosen.tolist()]:
            picture = behind.picture
            if shots.present[i]:
                vertices = studio.posed(shots.axis_angle[i], shots.root[i])
                picture, _ = taken(studio, shots, behind, vertices, i, light, None)
            frame[..., :3] = phone.shoot(i, picture)
            yield frame

    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "body.mp4"
        quality = replace(X264, dial=("crf", faults.crf, faults.crf, faults.crf))
        encode(str(film), ".mp4", quality, filmed(), shots.camera.size, RATE)
        video = open_video(film)
        plate = plate_of_empty(video, np.arange(len(empty)))
        pictures = [one.picture for one in read_frames(video)][len(empty) :]
    return np.stack([soft_mask(picture, plate, keypoints, i) for i, picture in enumerate(pictures)])
