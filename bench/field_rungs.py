"""The field an avatar was baked from, as rungs of accuracy against time: slow, and what the rest is measured by."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from jaxtyping import Float
from skimage.transform import resize

from avatar.camera import Camera
from avatar.progress import progress
from bench.field_view import Directions, FieldView
from bench.field_volume import draw_volume
from player.context import Context
from player.raster import Rasteriser
from player.renderer import Pose
from train.run import read_run

FIELD_ROUNDS = 3


class FieldRung(NamedTuple):
    """A way to draw the field: sections of a ray, 0 for its first surface crossing; pixels as a share of full
    resolution; the direction it is asked at."""

    name: str
    sections: int = 0
    share: float = 1.0
    directions: Directions = "cone"


# cheapest first; the last is the truth of the model
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


class PosedFrame(Protocol):
    """A pose under a camera."""

    @property
    def pose(self) -> Pose: ...
    @property
    def camera(self) -> Camera: ...


def field_rungs(
    context: Context, run: Path, frames: Sequence[PosedFrame], rungs: Sequence[FieldRung] = FIELD_RUNGS
) -> list[tuple[str, Float[np.ndarray, "rounds"], int, list[Float[np.ndarray, "height width 3"]]]]:
    """The field drawn in each way: name, milliseconds, bytes of its tensors, the frames. At least FIELD_ROUNDS frames
    are timed, of a volume each of the frames once."""
    trained = read_run(run)
    view, beta = FieldView(trained), trained.preset.parts[0].beta[1]
    raster, drawn_rungs = Rasteriser(context), []
    size = sum(tensor.numel() * tensor.element_size() for tensor in tensors_of(view.field))
    try:
        for rung in rungs:
            ms, drawn = [], []
            rounds = len(frames) if rung.sections else max(FIELD_ROUNDS, len(frames))
            for number in progress(range(rounds), rung.name):
                frame = frames[number % len(frames)]
                start = time.perf_counter()
                picture = draw_rung(view, raster, rung, frame, beta)
                ms.append(1e3 * (time.perf_counter() - start))
                if number < len(frames):
                    drawn.append(picture)
            drawn_rungs.append((rung.name, np.array(ms), size, drawn))
    finally:
        raster.release()
    return drawn_rungs


def draw_rung(
    view: FieldView, raster: Rasteriser, rung: FieldRung, frame: PosedFrame, beta: float
) -> Float[np.ndarray, "height width 3"]:
    """The frame at full resolution."""
    full = frame.camera.size
    size = max(1, round(full[0] * rung.share)), max(1, round(full[1] * rung.share))
    camera = frame.camera.resized(size)
    if rung.sections:
        picture = draw_volume(view, raster, *frame.pose, camera, beta=beta, sections=rung.sections)
    else:
        picture = view.draw(raster, *frame.pose, camera, directions=rung.directions)
    if size == full:
        return picture.color
    return np.clip(resize(picture.color, (full[1], full[0], 3), order=1, anti_aliasing=False), 0, 1).astype(np.float32)


def tensors_of(field: Any) -> list:
    """Every tensor a field holds, wherever it keeps its networks."""
    found: dict[int, torch.Tensor] = {}
    waiting, visited = [field], set()
    while waiting:
        thing = waiting.pop()
        if id(thing) in visited:
            continue
        visited.add(id(thing))
        if isinstance(thing, torch.Tensor):
            found[thing.data_ptr()] = thing
        elif isinstance(thing, torch.nn.Module):
            waiting += [*thing.parameters(), *thing.buffers()]
        elif isinstance(thing, dict):
            waiting += list(thing.values())
        elif isinstance(thing, (list, tuple)):
            waiting += list(thing)
        elif hasattr(thing, "__dict__") and type(thing).__module__.split(".")[0] == "train":
            waiting += list(vars(thing).values())
    return list(found.values())
