"""What a preset fixes: everything that a training run does not take from the capture."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Literal, get_args

from avatar.skeleton import PARTS
from command.settings import Kinds, Rows
from train.command import PRESET_NAMES, TrainOptions
from train.networks.hash import HashNetworks
from train.networks.paper import PaperNetworks
from train.networks.seen import SeenNetworks
from train.networks.triplane import TriPlaneNetworks
from train.rays import Band

# all kinds
Networks = TriPlaneNetworks | HashNetworks | PaperNetworks | SeenNetworks
KIND = Kinds({sizes.kind: sizes for sizes in get_args(Networks)})


@dataclass(frozen=True, kw_only=True)
class PartPreset:
    """Settings of one part."""

    iterations: int  # optimiser steps
    cell: float  # template distance grid, metres
    spacing: float  # template samples on this part, metres
    # where surfaces are looked for
    band: Band
    # width of the surface in rendering, first and last, metres; only NeuS has it
    beta: tuple[float, float]
    displacement_reach: float  # |T_nr| at most, metres
    # lambda_2, per metre of T_nr (supplement: .01, hands .001)
    displacement_weight: float
    networks: Annotated[Networks, KIND]
    # share of the cached pixels that may lie beside the person, at most
    background: float = 1.0


@dataclass(frozen=True, kw_only=True)
class UnionPreset:
    """Settings of stage 2, which trains only the body."""

    iterations: int = 200
    rate: float = 0.1  # first learning rates, of stage 1's
    last_rate: float = 0.2  # share of these that the last rates are, reached exponentially
    warm_up: int = 20  # steps
    consistency: float = 3.0  # weight of L_g's first term, per metre
    surface: float = 3.0  # weight of L_g's second term, per metre


@dataclass(frozen=True, kw_only=True)
class HairPreset:
    """What is done for heads with hair before and after training; the paper does none of it."""

    # the head's place by its own video before anything is carved or learned (head_consistency.py), after Eq. 6
    consistency: bool = False
    # hollows between hair and neck carved by colors (capture/template/hollows.py)
    hollows: bool = False
    # where hair hangs below the rigid head, hair is a surface of its own, with its own skin weights (layers.py)
    layers: bool = False
    # metres under the lowest skin of the head: so much lower the head's field ends, whose video holds neck and collar
    # as still as the head and shows them several times finer than the body's
    reach: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Preset:
    name: str
    # in the order of avatar.skeleton.PARTS; one alone: a person of one network (experiments/rivals/single.py)
    parts: Annotated[tuple[PartPreset, ...], Rows("parts", 1, len(PARTS))]
    density: Literal["neus", "volsdf"] = "neus"  # train/render.py; VolSDF's width is learned
    # L_rgb: mean |difference|, or Eq. 11 as printed
    color_loss: Literal["absolute", "norm"] = "absolute"
    # L_mask: of what is drawn, or Eq. 11 as printed
    mask_loss: Literal["opacity", "lowest"] = "opacity"
    rays: int = 1024  # per step
    # all rays of a step from one frame, or from any
    one_frame: bool = False
    # rays cached of each frame; a texture between the pixels of fewer is never learned
    rays_per_frame: int = 8000
    sections: int = 12  # per ray
    # sections with the largest weights get normal and color
    shaded: int = 3
    # T_nr is evaluated at every n-th section end and linear between
    displaced_every: int = 4
    # learning rate of planes or hash tables
    grid_rate: float = 4e-3
    # that of the networks and codes
    network_rate: float = 2e-3
    # that of T_nr and its codes: geometry settles first
    displacement_rate: float = 3e-4
    # that of poses, where they are refined: pixels that a point a metre from its joint moves
    pose_rate: float = 0.1
    # share of the steps before poses move: first the field must show a person
    pose_begin: float = 0.15
    pose_weight: float = 0.1  # weight of the poses' prior
    # round the opening between the lids the surface is the template's, with its eyeballs (train/eye_grid.py)
    open_eyes: bool = True
    warm_up: int = 100  # steps
    # share of the first rates that the last ones are, reached exponentially
    last_rate: float = 0.05
    beta_until: float = 0.8  # share of the steps over which beta shrinks
    clip: float = 1.0  # gradient norm
    mask_weight: float = 0.1
    eikonal_weight: float = 0.1  # lambda_1 (supplement)
    # its two betas and epsilon
    adam: tuple[float, float, float] = (0.9, 0.99, 1e-15)
    # steps that fit F_s to the template before training, where it does not begin there
    prefit: int = 0
    surface_cells: tuple[float, float, float] = (0.006, 0.0035, 0.0025)  # metres: body, head, hands
    # clothes beyond the body's band are carved from the masks and joined to the template (capture/template/clothes.py)
    clothes: bool = True
    # the capture's light is fitted first and F_c learns albedo (capture/light, train/light.py)
    light: bool = False
    hair: HairPreset = HairPreset()
    union: UnionPreset = UnionPreset()
    appearance_steps: int = 200  # Eq. 8, per part
    appearance_rate: float = 1e-2  # its learning rate
    # share of the first rate that the last one is, reached exponentially
    appearance_last_rate: float = 1.0

    def __post_init__(self):
        if len(self.parts) not in (1, len(PARTS)):
            raise ValueError(f"parts should be {len(PARTS)}, or 1 for a person of one network, are {len(self.parts)}")

    @property
    def names(self) -> tuple[str, ...]:
        """What the parts are called; each is a file of the run folder."""
        return PARTS if len(self.parts) == len(PARTS) else ("single",)

    @property
    def learned(self) -> tuple[int, ...]:
        """The parts that are trained, by number; the others are the template in the colors that the videos show."""
        return tuple(index for index, part in enumerate(self.parts) if part.iterations)

    @property
    def meets(self) -> bool:
        """Whether the body learns how it meets the parts (stage 2, Eq. 7, 8 and 13)."""
        return len(self.parts) > 1 and 0 in self.learned


_DEMO_BODY = PartPreset(
    iterations=450,
    cell=0.01,
    spacing=0.01,
    band=Band(outside=0.03, inside=0.02, step=0.006),
    beta=(0.008, 0.0015),
    displacement_reach=0.03,
    displacement_weight=0.01,
    networks=TriPlaneNetworks(),
)
_DEMO_HEAD = replace(
    _DEMO_BODY,
    iterations=900,
    cell=0.003,
    spacing=0.003,
    band=Band(outside=0.035, inside=0.02, step=0.006),
    beta=(0.008, 0.001),
    networks=TriPlaneNetworks(color_size=320),
)
# rays between fingers may follow the wrong one: few of them lie beside the person, or they carve the fingers' sides
_DEMO_HAND = PartPreset(
    iterations=200,
    cell=0.002,
    spacing=0.002,
    band=Band(outside=0.012, inside=0.008, step=0.0025),
    beta=(0.004, 0.0007),
    displacement_reach=0.005,
    displacement_weight=0.001,
    networks=TriPlaneNetworks(),
    background=0.2,
)

_HAIR = HairPreset(consistency=True, hollows=True, layers=True, reach=0.06)

DEMO = Preset(name="demo", parts=(_DEMO_BODY, _DEMO_HEAD, _DEMO_HAND, _DEMO_HAND), hair=_HAIR, light=True)

# For one GPU: a hash grid instead of planes, more rays, finer in the end; bands and grids are the demo's
FAST = Preset(
    name="fast",
    parts=tuple(
        replace(part, iterations=3000, cell=cell, beta=beta, networks=HashNetworks(cell=finest))
        for part, cell, beta, finest in zip(
            DEMO.parts,
            (0.01, 0.004, 0.002, 0.002),
            ((0.01, 0.001), (0.01, 0.001), (0.004, 0.0005), (0.004, 0.0005)),
            (0.002, 0.0007, 0.0007, 0.0007),
        )
    ),
    light=True,
    rays=4096,
    rays_per_frame=20000,
    sections=16,
    shaded=8,
    grid_rate=1e-2,
    surface_cells=(0.005, 0.0025, 0.002),
    hair=_HAIR,
    union=UnionPreset(iterations=500),
    appearance_steps=500,
)

# The supplement's numbers; where it is silent, the authors' code's (bands, |T_nr| at most, rays of one frame)
_PAPER_BODY = PartPreset(
    iterations=100_000,
    cell=0.01,
    spacing=0.01,
    band=Band(outside=0.1, inside=0.1, step=0.01),
    beta=(0.1, 0.1),
    displacement_reach=0.05,
    displacement_weight=0.01,
    networks=PaperNetworks(),
    background=0.3,
)
_PAPER_HEAD = replace(_PAPER_BODY, cell=0.003, spacing=0.003, band=Band(outside=0.04, inside=0.04, step=0.005))
_PAPER_HAND = replace(_PAPER_BODY, cell=0.002, spacing=0.002, displacement_reach=0.005, displacement_weight=0.001)

PAPER = Preset(
    name="paper",
    parts=(_PAPER_BODY, _PAPER_HEAD, _PAPER_HAND, _PAPER_HAND),
    density="volsdf",
    color_loss="norm",
    mask_loss="lowest",
    one_frame=True,
    rays_per_frame=6000,
    sections=64,
    shaded=64,
    displaced_every=1,
    network_rate=5e-4,
    displacement_rate=5e-4,
    warm_up=0,
    last_rate=0.1,
    clip=40.0,
    mask_weight=1.0,
    adam=(0.9, 0.999, 1e-8),
    prefit=2000,
    clothes=False,
    open_eyes=False,
    union=UnionPreset(iterations=100_000, rate=1.0, last_rate=0.1, warm_up=0, consistency=1.0, surface=1.0),
    appearance_steps=15_000,
    appearance_rate=5e-4,
    appearance_last_rate=0.1,
)

# A first avatar: the demo's template, light and hair, in seen colors; nothing is learned
PREVIEW = replace(
    DEMO,
    name="preview",
    parts=tuple(
        replace(part, iterations=0, networks=SeenNetworks(cell=cell))
        for part, cell in zip(DEMO.parts, (0.012, 0.004, 0.0025, 0.0025), strict=True)
    ),
    union=UnionPreset(iterations=0),
    appearance_steps=0,
    # baking extracts the template anew: this surface holds what the videos saw of it
    surface_cells=(0.009, 0.0035, 0.0035),
)

# The preview with a head that is learned, hair and all: from films of a phone, fields gain most there
HEAD = replace(PREVIEW, name="head", parts=(PREVIEW.parts[0], replace(_DEMO_HEAD, iterations=300), *PREVIEW.parts[2:]))

PRESETS: dict[str, Preset] = dict(zip(PRESET_NAMES, (DEMO, FAST, PAPER, PREVIEW, HEAD), strict=True))


def shortened(preset: Preset, iterations: int) -> Preset:
    """The preset with `iterations` steps per part that learns; fitting to the template, stage 2 and Eq. 8 get no
    more steps."""
    return replace(
        preset,
        parts=tuple(replace(part, iterations=iterations if part.iterations else 0) for part in preset.parts),
        prefit=min(preset.prefit, max(iterations, 100)),
        union=replace(preset.union, iterations=min(preset.union.iterations, iterations)),
        appearance_steps=min(preset.appearance_steps, iterations),
    )


# what the presets add to the paper and a training can do without, by name: what it costs stands in docs/measured.md
ITEMS: dict[str, Callable[[Preset], Preset]] = {
    "light": lambda preset: replace(preset, light=False),
    "hair": lambda preset: replace(preset, hair=HairPreset()),
    "clothes": lambda preset: replace(preset, clothes=False),
    "eyes": lambda preset: replace(preset, open_eyes=False),
}


def without(preset: Preset, items: Iterable[str]) -> Preset:
    """The preset less some of its items; those that it has not change nothing."""
    for item in items:
        preset = ITEMS[item](preset)
    return preset


def chosen_preset(options: TrainOptions) -> Preset:
    preset = PRESETS[options.preset]
    if options.iterations is not None:
        preset = shortened(preset, options.iterations)
    return without(preset, options.without)
