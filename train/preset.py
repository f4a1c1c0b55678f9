"""What a preset fixes: everything that a training run does not take from the capture."""

from dataclasses import dataclass

from train.networks.triplane import TriPlaneNetworks
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
    networks: TriPlaneNetworks


@dataclass(frozen=True)
class UnionPreset:
    """Settings of stage 2, which trains the body alone."""

    iterations: int = 200
    rate: float = 0.1  # first learning rates, of stage 1's
    last_rate: float = 0.2  # of these, reached exponentially
    warm_up: int = 20  # steps
    consistency: float = 3.0  # weight of L_g's first term, per metre
    surface: float = 3.0  # of its second


@dataclass(frozen=True)
class Preset:
    """Settings of a training run."""

    name: str
    parts: tuple[PartPreset, ...]  # in the order of capture.PARTS
    rays: int = 1024  # per step
    rays_per_frame: int = 4000  # cached of each frame
    background: float = 0.2  # share of cached rays that pass the person
    sections: int = 12  # per ray
    shaded: int = 3  # sections with the largest weights get normal and colour
    displaced_every: int = 4  # T_nr is evaluated at every n-th section end and linear between
    grid_rate: float = 4e-3  # learning rate of planes or hash tables
    network_rate: float = 2e-3  # of the networks and codes
    displacement_rate: float = 3e-4  # of T_nr and its codes: geometry settles first
    warm_up: int = 100  # steps
    last_rate: float = 0.05  # of the first, reached exponentially
    beta_until: float = 0.8  # share of the steps over which beta shrinks
    clip: float = 1.0  # gradient norm
    mask_weight: float = 0.1
    eikonal_weight: float = 0.1  # lambda_1 (supplement)
    surface_cells: tuple[float, float, float] = (0.006, 0.0035, 0.0025)  # metres: body, head, hands
    union: UnionPreset = UnionPreset()
    appearance_steps: int = 200  # Eq. 8, per part


_HAND = PartPreset(1000, 0.002, 0.002, Band(0.012, 0.008, 0.0025), (0.004, 0.0007), 0.005, 0.001, TriPlaneNetworks())

DEMO = Preset(
    "demo",
    (
        PartPreset(900, 0.01, 0.01, Band(0.03, 0.02, 0.006), (0.008, 0.0015), 0.03, 0.01, TriPlaneNetworks()),
        PartPreset(1500, 0.003, 0.003, Band(0.035, 0.02, 0.006), (0.008, 0.001), 0.03, 0.01, TriPlaneNetworks()),
        _HAND,
        _HAND,
    ),
)

PRESETS = {preset.name: preset for preset in (DEMO,)}
