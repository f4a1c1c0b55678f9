"""Filming the four raw videos, frame after frame, in constant memory."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from PIL import Image

from avatar.camera import project
from avatar.skeleton import PARTS
from command.progress import progress
from files.whole import write_json
from player.film.encoder import X264, encode
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


def film_raw(folder: Path, studio: Studio, lights: dict[str, FilmLight], size: int, config: RawConfig, seed: int):
    """Write the four videos, their keypoints and, in truth/, what is hidden from other stages; returns the shots."""
    wide = 2 * round(size * 16 / 9 / 2), 2 * round(size / 2)
    plan = {part: plan_raw_video(studio, part, wide, config.seconds, RATE, config.sway, seed) for part in PARTS}
    face = plan_face_film(studio, wide, config.seconds, RATE, config.sway, seed) if config.face_film else None
    acts = face and acting(studio.subject, len(face.root), seed)
    for number, (part, shots) in enumerate(plan.items()):
        frames = _frames(folder, studio, shots, lights[part], config, [seed, number])
        _write(folder, FILES[part], shots, frames)
    if face is not None and acts is not None:
        actor = Studio(studio.rasteriser, acts.subject, studio.supersample, studio.sheen)
        frames = _frames(folder, actor, face, lights["head"], config, [seed, len(PARTS)], acts)
        _write(folder, FACE_FILE, face, frames)
        write_json(folder / "truth" / "face" / "face.json", acts.truth)
        plan["face"] = face
    return plan


def _write(folder: Path, name: str, shots: RawShots, frames: Iterator[UInt8[Array, "height width 4"]]) -> None:
    truth = folder / "truth" / shots.part
    (truth / "masks").mkdir(parents=True)
    frames = progress(frames, f"filming {shots.part}", len(shots.root))
    encode(str(folder / name), ".mp4", X264, frames, shots.camera.size, RATE)
    write_frames(truth / "video.npz", shots.axis_angle, shots.root, shots.camera, shots.present)


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
