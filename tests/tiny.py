"""The one preset of small networks and few steps, and a training by it in this process."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from train.command import main
from train.networks.triplane import TriPlaneNetworks
from train.preset import DEMO, PRESETS, Preset

PLANES = TriPlaneNetworks(plane_size=16, color_size=16)


def tiny(preset: Preset, networks=PLANES, iterations: int = 6, **changes) -> Preset:
    """The preset with coarse cells, few rays and steps, and `networks` in every part; `changes` are its own fields."""
    parts = (
        replace(p, iterations=iterations, networks=networks, cell=max(p.cell, 0.006), spacing=max(p.spacing, 0.006))
        for p in preset.parts
    )
    small = {
        "rays": 64, "rays_per_frame": 300, "warm_up": 5, "appearance_steps": 5, "surface_cells": (0.03, 0.015, 0.008),
        # few steps teach the head nothing of shoulders, to which it would reach; the union's steps are as much larger
        "hair": replace(preset.hair, reach=0.0),
        "union": replace(preset.union, iterations=40, rate=0.3, consistency=30.0, surface=30.0),
    }  # fmt: skip
    return replace(preset, parts=tuple(parts), **(small | changes))


TINY = tiny(DEMO)


def tiny_training(
    capture: Path, out: Path, *options: str, preset: Preset = TINY, command: Callable[[list[str]], int] = main
) -> Path:
    """What `selfscan train` with these options leaves at `out`, parts trained one after the other in this process."""
    threads = torch.get_num_threads()
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(PRESETS, preset.name, preset)
            patch.setattr("os.cpu_count", lambda: 1)
            assert command([str(capture), "-o", str(out), "--preset", preset.name, *options]) == 0
            assert not out.with_name(out.name + ".partial").exists()
    finally:
        torch.set_num_threads(threads)
    return out
