"""Filming the four raw videos, frame after frame, in constant memory."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from avatar.camera import Camera, project
from avatar.progress import Progress
from avatar.settings import AtLeast, AtMost, Option, check
from player.filming.encoder import X264, encode
from synth.light import Light
from synth.photo import Studio
from synth.raw.backdrop import Backdrop, backdrop
from synth.raw.detector import Detector, Mistakes
from synth.raw.movement import RawShots, plan_raw_videos
from synth.raw.phone import phone_of
from synth.room import Room, VertexLight

Array = np.ndarray

# what the files are called
FILES = {"body": "body.mp4", "head": "head.mp4", "hand_left": "left.mp4", "hand_right": "right.mp4"}
RATE = 30.0
# seconds between poses for which light in a room is found; between them it is interpolated
LIGHT_STEP = 0.5
# frames between masks of the truth
MASK_STEP = 10


@dataclass(frozen=True)
class RawConfig:
    """How a phone films it."""

    raw: Annotated[bool, "four videos as a phone writes them, and nothing else; the truth apart in OUT/truth"] = False
    keypoints: Annotated[bool, "with --raw: OpenPose's keypoints of every frame, with a detector's mistakes"] = False
    seconds: Annotated[
        float, AtLeast(1), AtMost(600), Option(metavar="S"), "with --raw: of the turn in each video; 2.4 s come before"
    ] = 20.0
    keypoint_noise: Annotated[
        float, AtLeast(0), AtMost(100), Option(metavar="PX"), "deviation of a keypoint, pixels of 1080"
    ] = 4.0
    keypoint_bias: Annotated[
        float, AtLeast(0), AtMost(10), Option(metavar="CM"), "how far off its joint a body's keypoint stays"
    ] = 1.0
    sway: Annotated[float, AtLeast(0), AtMost(3), Option(metavar="0..3"), "how much the person sways; 0: stiff"] = 1.0
    camera_noise: Annotated[
        float, AtLeast(0), AtMost(5), Option(metavar="0..5"), "noise and rolling exposure of the phone; 0: none"
    ] = 1.0

    def __post_init__(self):
        check(self)


def mistakes_of(config: RawConfig) -> Mistakes:
    """How wrong the detector is."""
    return Mistakes(config.keypoint_noise, config.keypoint_bias / 100)


def film_raw(folder: Path, studio: Studio, lights: dict[str, Light | Room], size: int, config: RawConfig, seed: int):
    """Write the four videos, their keypoints and, in truth/, what nobody else may read; returns the planned shots."""
    wide = 2 * round(size * 16 / 9 / 2), 2 * round(size / 2)
    plan = plan_raw_videos(studio, wide, config.seconds, RATE, config.sway, seed)
    report = Progress("filming", sum(len(shots.root) for shots in plan.values()))
    truth = folder / "truth"
    done = 0
    for number, (part, shots) in enumerate(plan.items()):
        (truth / part / "masks").mkdir(parents=True)
        frames = _frames(folder, studio, shots, lights[part], config, [seed, number])

        def counted(frames: Iterator[Array] = frames, part: str = part) -> Iterator[Array]:
            nonlocal done
            for frame in frames:
                yield frame
                done += 1
                report.update(done, part)

        encode(str(folder / FILES[part]), ".mp4", X264, counted(), wide, RATE)
        np.savez_compressed(
            truth / part / "video.npz", poses=shots.axis_angle, root=shots.root, present=shots.present,
            K=shots.camera.K, camera_from_world=shots.camera.camera_from_world, size=np.array(wide),
        )  # fmt: skip
    return plan


def _frames(
    folder: Path, studio: Studio, shots: RawShots, light: Light | Room, config: RawConfig, seed: list[int]
) -> Iterator[UInt8[Array, "height width 4"]]:
    """One video, RGBA; keypoints and masks are written by the way."""
    count, part = len(shots.root), shots.part
    behind = backdrop(shots.camera, shots.floor, part != "body", seed[0])
    phone = phone_of(np.arange(count) / RATE, config.camera_noise, config.camera_noise, seed)
    detector = Detector(studio.subject, studio.rasteriser, shots.camera, mistakes_of(config), seed)
    points = folder / "keypoints" / part
    if config.keypoints:
        points.mkdir(parents=True)
    lighting = _Lighting(studio, shots, light)
    frame = np.full((*shots.camera.size[::-1], 4), 255, np.uint8)
    for i in range(count):
        picture, coverage, found = behind.picture, None, None
        if shots.present[i]:
            vertices = studio.posed(shots.axis_angle[i], shots.root[i])
            picture, coverage = taken(studio, shots, behind, vertices, i, light, lighting.at(i))
            if config.keypoints:
                found = detector.look(shots.axis_angle[i], shots.root[i], vertices)
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
    light: Light | Room,
    lit: VertexLight | None,
) -> tuple[Float[Array, "height width 3"], UInt8[Array, "height width"]]:
    """The person in the room, and the person's mask (0 to 255)."""
    root = shots.root[i]
    picture = behind.with_shadow(root[0], root[2])
    width, height = shots.camera.size
    coverage = np.zeros((height, width), np.uint8)
    box = _window(shots.camera, vertices)
    if box is None:
        return picture, coverage
    x0, y0, x1, y1 = box
    K = shots.camera.K.copy()
    K[:2, 2] -= x0, y0
    camera = Camera(K, shots.camera.camera_from_world, (x1 - x0, y1 - y0))
    exposed = studio.expose(vertices, camera, light, 0.0, lit)
    share = exposed.coverage[..., None]
    picture[y0:y1, x0:x1] = exposed.color + (1 - share) * picture[y0:y1, x0:x1]
    coverage[y0:y1, x0:x1] = np.round(255 * exposed.coverage)
    return picture, coverage


def _window(camera: Camera, vertices: Float[Array, "vertices 3"]) -> tuple[int, int, int, int] | None:
    """The pixels that hold the person: left, top, right, bottom; None: none."""
    pixels, depth = project(camera, vertices)
    if not (depth > 0).any():
        return None
    pixels = pixels[depth > 0]
    # what comes close to the lens is somewhere far off the picture
    low = np.clip(np.floor(pixels.min(0)) - 1, 0, camera.size).astype(int)
    high = np.clip(np.ceil(pixels.max(0)) + 1, 0, camera.size).astype(int)
    return None if (high <= low).any() else (int(low[0]), int(low[1]), int(high[0]), int(high[1]))


class _Lighting:
    """Light in a room for each frame: found for steady poses some way apart, so that the body's own openness serves
    every heading, and interpolated."""

    def __init__(self, studio: Studio, shots: RawShots, light: Light | Room):
        self.studio, self.shots, self.light = studio, shots, light
        self.step = round(LIGHT_STEP * RATE)
        self.known: dict[int, VertexLight] = {}

    def at(self, i: int) -> VertexLight | None:
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
            self.known[number] = self.studio.lighting.on(
                self.studio.posed(self.shots.steady[i], np.zeros(3)), self.light
            )
        return self.known[number]


def write_truth(folder: Path, plan: dict[str, RawShots], facts: dict) -> None:
    """truth/raw.json: what was filmed, and how."""
    content = {"format": "selfscan-raw-truth", "rate": RATE, "mask_step": MASK_STEP, **facts}
    content["frames"] = {part: len(shots.root) for part, shots in plan.items()}
    (folder / "truth" / "raw.json").write_text(json.dumps(content, indent=1))
