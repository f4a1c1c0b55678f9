"""What a preset fixes. Each number of `demo` was measured on two CPU cores (docs/decisions.md)."""

from dataclasses import dataclass

from train.rays import Band


@dataclass(frozen=True)
class PartPreset:
    """Settings of one part."""

    iterations: int  # optimiser steps
    cell: float  # template distance grid, metres
    spacing: float  # template samples on this part, metres
    band: Band  # where surfaces are looked for
    beta: tuple[float, float]  # width of the surface in rendering, first and last, metres
    displacement_reach: float  # |T_nr| at most, metres
    displacement_weight: float  # lambda_2, per metre of T_nr (supplement: .01, hands .001)
    plane_size: int  # texels of a geometry plane's side
    color_size: int  # texels of a colour plane's side


@dataclass(frozen=True)
class Preset:
    """Settings of a training run."""

    name: str
    parts: tuple[PartPreset, ...]  # in the order of capture.PARTS
    rays: int = 1024  # per step
    rays_per_frame: int = 4000  # cached of each frame
    background: float = 0.2  # share of cached rays that pass the person
    sections: int = 16  # per ray
    shaded: int = 4  # sections with the largest weights get normal and colour
    displaced_every: int = 4  # T_nr is evaluated at every n-th section end and linear between
    plane_rate: float = 4e-3  # learning rate of the planes
    network_rate: float = 2e-3  # of the networks and codes
    warm_up: int = 100  # steps
    last_rate: float = 0.05  # of the first, reached exponentially
    beta_until: float = 0.8  # share of the steps over which beta shrinks
    clip: float = 1.0  # gradient norm
    mask_weight: float = 0.1
    eikonal_weight: float = 0.1  # lambda_1 (supplement)
    appearance_steps: int = 200  # Eq. 8, per part


_WIDE = Band(outside=0.04, inside=0.03, step=0.007)
_HAND = PartPreset(1400, 0.002, 0.002, Band(0.015, 0.008, 0.0025), (0.004, 0.0007), 0.005, 0.001, 160, 256)

DEMO = Preset(
    "demo",
    (
        PartPreset(1200, 0.01, 0.01, _WIDE, (0.010, 0.0015), 0.03, 0.01, 160, 256),
        PartPreset(1600, 0.004, 0.004, _WIDE, (0.010, 0.0015), 0.03, 0.01, 160, 256),
        _HAND,
        _HAND,
    ),
)

PRESETS = {preset.name: preset for preset in (DEMO,)}
