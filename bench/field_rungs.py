"""The field an avatar was baked from, as rungs of accuracy against time: slow, and what the rest is measured by."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from jaxtyping import Float

from avatar.camera import Camera
from avatar.progress import progress
from bench.field_view import Directions, FieldView
from player.context import Context
from player.raster import Rasteriser
from player.renderer import Pose
from train.run import read_run

FIELD_ROUNDS = 3


class PosedFrame(Protocol):
    """A pose under a camera."""

    @property
    def pose(self) -> Pose: ...
    @property
    def camera(self) -> Camera: ...


def field_rungs(
    context: Context, run: Path, frames: Sequence[PosedFrame]
) -> list[tuple[str, Float[np.ndarray, "rounds"], int, list[Float[np.ndarray, "height width 3"]]]]:
    """The field drawn as its first surface crossing: paper mode, then inside the cone that was seen."""
    view = FieldView(read_run(run))
    raster = Rasteriser(context)
    rungs = []
    try:
        modes: tuple[tuple[str, Directions], ...] = (
            ("field, paper mode", "global"),
            ("field, seen cone", "cone"),
        )
        for name, directions in modes:
            ms, drawn = [], []
            for number in progress(range(max(FIELD_ROUNDS, len(frames))), name):
                frame = frames[number % len(frames)]
                start = time.perf_counter()
                picture = view.draw(raster, *frame.pose, frame.camera, directions=directions)
                ms.append(1e3 * (time.perf_counter() - start))
                if number < len(frames):
                    drawn.append(picture.color)
            size = sum(tensor.numel() * tensor.element_size() for tensor in tensors_of(view.field))
            rungs.append((name, np.array(ms), size, drawn))
    finally:
        raster.release()
    return rungs


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
