"""Filming the four raw videos, side by side, each frame after frame in constant memory."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from PIL import Image

from avatar.camera import project
from avatar.skeleton import PARTS
from command.progress import ProgressBoard, Reporter
from command.workers import run_jobs
from files.whole import write_json
from player.draw.raster import Rasteriser
from player.film.encoder import X264, encode
from player.gl.context import open_context
from synth.film import write_frames
from synth.light import FilmLight
from synth.options import RawConfig
from synth.photo import Studio
from synth.raw.acting import FaceActs, acting
from synth.raw.backdrop import Backdrop, backdrop
from synth.raw.detector import Detector, Mistakes
from synth.raw.movement import RawShots, plan_face_film, plan_raw_video
from synth.raw.phone import phone_of
from synth.room import Room, VertexLight
from synth.subject import SynthSubject

# what the files are called
FILES = {"body": "body.mp4", "head": "head.mp4", "hand_left": "left.mp4", "hand_right": "right.mp4"}
FACE_FILE = "face.mp4"
RATE = 30.0
# seconds between poses for which light in a room is found; between them it is interpolated
LIGHT_STEP = 0.5
# frames between masks of the truth
MASK_STEP = 10


def mistakes_of(config: RawConfig) -> Mistakes:
    return Mistakes(config.keypoint_noise, config.keypoint_bias / 100)


class RawFilm(NamedTuple):
    """One of the raw videos, for a worker process."""

    folder: Path
    file: str
    subject: SynthSubject
    supersample: int
    sheen: float
    shots: RawShots
    light: FilmLight
    config: RawConfig
    seed: list[int]
    acts: FaceActs | None = None


def film_raw(
    folder: Path, studio: Studio, lights: dict[str, FilmLight], size: int, config: RawConfig, seed: int
) -> dict[str, RawShots]:
    """Write the four videos, their keypoints and, in truth/, what is hidden from other stages; returns the shots."""
    wide = 2 * round(size * 16 / 9 / 2), 2 * round(size / 2)
    plan = {part: plan_raw_video(studio, part, wide, config.seconds, RATE, config.sway, seed) for part in PARTS}
    films = {
        part: RawFilm(folder, FILES[part], studio.subject, studio.supersample, studio.sheen, shots, lights[part],
                      config, [seed, number])
        for number, (part, shots) in enumerate(plan.items())
    }  # fmt: skip
    if config.face_film:
        shots = plan["face"] = plan_face_film(studio, wide, config.seconds, RATE, config.sway, seed)
        acts = acting(studio.subject, len(shots.root), seed)
        films["face"] = films["head"]._replace(
            file=FACE_FILE, subject=acts.subject, shots=shots, seed=[seed, len(PARTS)], acts=acts
        )
    workers = min(os.cpu_count() or 1, len(films))
    board = ProgressBoard({name: len(film.shots.root) for name, film in films.items()}, workers)
    run_jobs(films, _filmed, board, workers)
    return plan


def _filmed(film: RawFilm, report: Reporter) -> None:
    """Write one video, and what belongs to it."""
    shots = film.shots
    truth = film.folder / "truth" / shots.part
    (truth / "masks").mkdir(parents=True)

    def counted(frames: Iterator[UInt8[Array, "height width 4"]]) -> Iterator[UInt8[Array, "height width 4"]]:
        for number, frame in enumerate(frames, 1):
            yield frame
            report.step(number, "")

    with open_context() as context:
        studio = Studio(Rasteriser(context), film.subject, film.supersample, film.sheen)
        frames = _frames(film.folder, studio, shots, film.light, film.config, film.seed, film.acts)
        encode(str(film.folder / film.file), ".mp4", X264, counted(frames), shots.camera.size, RATE)
    write_frames(truth / "video.npz", shots.axis_angle, shots.root, shots.camera, shots.present)
    if film.acts is not None:
        write_json(truth / "face.json", film.acts.truth)


def _frames(
    folder: Path, studio: Studio, shots: RawShots, light: FilmLight, config: RawConfig, seed: list[int],
    acts: FaceActs | None = None,
) -> Iterator[UInt8[Array, "height width 4"]]:  # fmt: skip
    """One video, RGBA; keypoints and masks are written by the way."""
    count, part = len(shots.root), shots.part
    behind = backdrop(shots.camera, shots.floor, part != "body", seed[0])
    phone = phone_of(np.arange(count) / RATE, config.camera_noise, config.camera_noise, seed)
    detector = Detector(studio.subject, studio.rasteriser, shots.camera, mistakes_of(config), seed)
    points = folder / "keypoints" / part
    if config.keypoints:
        points.mkdir(parents=True)
    lighting = _Lighting(studio, shots, light, acts)
    frame = np.full((*shots.camera.size[::-1], 4), 255, np.uint8)
    for i in range(count):
        picture, coverage, found = behind.picture, None, None
        if shots.present[i]:
            vertices = studio.posed(shots.axis_angle[i], shots.root[i], acts and acts.vertices(i))
            picture, coverage = taken(studio, shots, behind, vertices, i, light, lighting.at(i))
            if config.keypoints:
                found = detector.look(shots.axis_angle[i], shots.root[i], vertices, acts and acts.named(i))
        if config.keypoints:
            detector.write(points / f"{part}_{i:012d}_keypoints.json", found)
        if i % MASK_STEP == 0:
            mask = np.zeros(frame.shape[:2], np.uint8) if coverage is None else coverage
            Image.fromarray(mask).save(folder / "truth" / part / "masks" / f"{i:06d}.png")
        frame[..., :3] = phone.shoot(i, picture)
        yield frame


def taken(
    studio: Studio,
    shots: RawShots,
    behind: Backdrop,
    vertices: Float[Array, "vertices 3"],
    i: int,
    light: FilmLight,
    lit: VertexLight | None,
) -> tuple[Float[Array, "height width 3"], UInt8[Array, "height width"]]:
    """The person in the room, and the person's mask (0 to 255)."""
    size = shots.camera.size
    picture = behind.with_shadow(shots.root[i, 0], shots.root[i, 2])
    coverage = np.zeros(size[::-1], np.uint8)
    pixels, depth = project(shots.camera, vertices)
    pixels = pixels[depth > 0]
    # the pixels that hold the person; what comes close to the lens is somewhere far off the picture
    low = np.clip(np.floor(pixels.min(0, initial=np.inf)) - 1, 0, size).astype(int)
    high = np.clip(np.ceil(pixels.max(0, initial=-np.inf)) + 1, 0, size).astype(int)
    (left, top), (width, height) = low.tolist(), (high - low).tolist()
    if min(width, height) > 0:
        color, share = studio.expose(vertices, shots.camera.cropped(left, top, (width, height)), light, lit)
        window = np.s_[top : top + height, left : left + width]
        picture[window] = color + (1 - share[..., None]) * picture[window]
        coverage[window] = np.round(255 * share)
    return picture, coverage


class _Lighting:
    """Light in a room for each frame: found for steady poses some way apart, so that the body's own openness serves
    every heading, and interpolated."""

    def __init__(self, studio: Studio, shots: RawShots, light: FilmLight, acts: FaceActs | None = None):
        self.studio, self.shots, self.light, self.acts = studio, shots, light, acts
        self.step = round(LIGHT_STEP * RATE)
        self.known: dict[int, VertexLight] = {}

    def at(self, i: int) -> VertexLight | None:
        """The room's light in frame i, linear between steps of LIGHT_STEP; None where the light is no room's."""
        if not isinstance(self.light, Room):
            return None
        first = i // self.step
        share = np.float32(i / self.step - first)
        a, b = self._found(first), self._found(first + 1)
        self.known = {first: a, first + 1: b}
        mix = lambda x, y: (1 - share) * x + share * y
        return VertexLight(mix(a.irradiance, b.irradiance), mix(a.seen, b.seen))

    def _found(self, number: int) -> VertexLight:
        if number not in self.known:
            assert isinstance(self.light, Room)
            i = min(number * self.step, len(self.shots.root) - 1)
            # where it stands says nothing: lights are far off
            moved = self.acts and self.acts.vertices(i)
            self.known[number] = self.studio.lighting.on(
                self.studio.posed(self.shots.steady[i], np.zeros(3), moved), self.light
            )
        return self.known[number]
