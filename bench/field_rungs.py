"""The field an avatar was baked from, as rungs of accuracy against time: slow, and what the rest is measured by.

Where the run has a fields.onnx, which the bake writes, ONNX Runtime answers and torch is not imported; else torch does.
"""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from avatar.camera import Camera
from avatar.errors import AssetError
from avatar.input_file import read_json_object
from avatar.progress import Progress, progress
from bench.field_boxes import PosedVolume, enlarged, progressive
from bench.field_volume import draw_volume
from bench.onnx_field import field_surface, posed_field
from bench.posed_field import Directions, PosedField
from player.context import Context
from player.raster import Rasteriser
from player.renderer import Pose

FIELD_ROUNDS = 3


class FieldRung(NamedTuple):
    """A way to draw the field: sections of a ray, 0 for its first surface crossing; pixels as a share of full
    resolution; the direction it is asked at."""

    name: str
    sections: int = 0
    share: float = 1.0
    directions: Directions = "cone"


# cheapest first; the last is the truth of the model near its extracted surface
FIELD_RUNGS = (
    FieldRung("field, paper mode, quarter resolution", share=0.25, directions="global"),
    FieldRung("field, surface, half resolution", share=0.5),
    FieldRung("field, paper mode", directions="global"),
    FieldRung("field, surface", directions="cone"),
    FieldRung("field, surface, raw directions", directions="own"),
    FieldRung("field, volume of 3", 3),
    FieldRung("field, volume of 12, half resolution", 12, 0.5),
    FieldRung("field, volume of 12", 12),
    FieldRung("field, volume of 64, half resolution", 64, 0.5),
    FieldRung("field, volume of 64", 64),
)


# sections of a ray through boxes (bench/field_boxes.py), and the stages of its refinement
SECTIONS = 64
REFINED = (
    "field, boxes of 64, quarter resolution",
    "field, boxes of 64, half resolution",
    "field, boxes of 64",
)


def refined_names(samples: int) -> tuple[str, ...]:
    """The stages of a picture through boxes that is refined up to so many samples a pixel."""
    return (*REFINED, *(f"{REFINED[-1]}, {n} samples a pixel" for n in range(2, samples + 1)))


class PosedFrame(Protocol):
    """A pose under a camera."""

    @property
    def pose(self) -> Pose: ...
    @property
    def camera(self) -> Camera: ...


class DrawnRung(NamedTuple):
    """One rung's frames: milliseconds of each, bytes of the field, pictures."""

    name: str
    ms: Float[np.ndarray, "rounds"]
    bytes: int
    pictures: list[Float[np.ndarray, "height width 3"]]


class AskedField(NamedTuple):
    """A run's field, ready for drawing, and what is to be known of it."""

    field: PosedField
    # width of its surface after training, metres
    beta: float
    bytes: int


def field_rungs(
    context: Context,
    run: Path,
    frames: Sequence[PosedFrame],
    rungs: Sequence[FieldRung] = FIELD_RUNGS,
    *,
    samples: int = 1,
) -> list[DrawnRung]:
    """The field as it refines through boxes up to so many samples a pixel, then drawn in each way; the last is what the
    others are compared with. At least FIELD_ROUNDS frames are timed, of a volume each of the frames once."""
    asked = with_onnx(run) if (run / "fields.onnx").is_file() else with_torch(run)
    raster, drawn_rungs = Rasteriser(context), []
    try:
        for rung in rungs:
            ms, drawn = [], []
            rounds = len(frames) if rung.sections else max(FIELD_ROUNDS, len(frames))
            for number in progress(range(rounds), rung.name):
                frame = frames[number % len(frames)]
                start = time.perf_counter()
                picture = draw_rung(asked, raster, rung, frame)
                ms.append(1e3 * (time.perf_counter() - start))
                if number < len(frames):
                    drawn.append(picture)
            drawn_rungs.append(DrawnRung(rung.name, np.array(ms), asked.bytes, drawn))
    finally:
        raster.release()
    return refined_rungs(asked, frames, samples) + drawn_rungs


def refined_rungs(asked: AskedField, frames: Sequence[PosedFrame], samples: int) -> list[DrawnRung]:
    """The field by volume rendering through boxes as it refines: each stage's time holds those before it."""
    names = refined_names(samples)
    ms, pictures = [[] for _ in names], [[] for _ in names]
    report = Progress("field through boxes", len(names) * len(frames))
    for number, frame in enumerate(frames):
        start = time.perf_counter()
        volume = PosedVolume(asked.field, *frame.pose)
        refining = progressive(volume, frame.camera, beta=asked.beta, sections=SECTIONS, samples=samples)
        for stage, picture in enumerate(refining):
            ms[stage].append(1e3 * (time.perf_counter() - start))
            pictures[stage].append(picture)
            report.update(number * len(names) + stage + 1)
    return [
        DrawnRung(name, np.array(times), asked.bytes, drawn)
        for name, times, drawn in zip(names, ms, pictures, strict=True)
    ]


def with_onnx(run: Path) -> AskedField:
    """The field of a run without torch.

    Raises:
        AssetError: a file of the run is absent or misshapen.
    """
    facts = read_json_object(run / "run.json", "the facts of a run folder made by `selfscan train`")
    try:
        beta = float(facts["settings"]["parts"][0]["beta"][1])
    except (KeyError, IndexError, TypeError, ValueError):
        raise AssetError(f"{run / 'run.json'}: settings should name the last beta of the first part") from None
    return AskedField(posed_field(field_surface(run)), beta, (run / "fields.onnx").stat().st_size)


def with_torch(run: Path) -> AskedField:
    """The field of a run whose networks have no fields.onnx."""
    from bench.field_tensors import tensors_of
    from bench.field_view import field_view
    from train.run import read_run

    trained = read_run(run)
    size = sum(tensor.numel() * tensor.element_size() for tensor in tensors_of(trained.field))
    return AskedField(field_view(trained), trained.preset.parts[0].beta[1], size)


def draw_rung(
    asked: AskedField, raster: Rasteriser, rung: FieldRung, frame: PosedFrame
) -> Float[np.ndarray, "height width 3"]:
    """The frame at full resolution."""
    full = frame.camera.size
    size = max(1, round(full[0] * rung.share)), max(1, round(full[1] * rung.share))
    camera = frame.camera.resized(size)
    if rung.sections:
        picture = draw_volume(asked.field, raster, *frame.pose, camera, beta=asked.beta, sections=rung.sections)
    else:
        picture = asked.field.draw(raster, *frame.pose, camera, directions=rung.directions)
    return picture.color if size == full else enlarged(picture.color, full)
