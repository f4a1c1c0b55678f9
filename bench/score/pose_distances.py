"""Distances of a set of held-out poses: as they stand, aligned, and of the template that training began with.

A skeleton that was given is posed as the truth is, and all regions are measured in that pose. An estimated skeleton has
a fit for each picture (fitted_poses.py): head and hands are measured where their close-ups have them, the rest
where the body's view has it; aligned, each region by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from bench.field.posed_field import PosableSurface
from bench.score.picture_scores import VIEW_REGION
from bench.score.posed_geometry import SAMPLES, Distances, GeometryCase, PosedPair, alignment, measure_pose, posed_pair
from bench.score.region_scores import gather
from bench.score.true_mesh import TrueMesh
from capture.held_out import HeldOutView
from command.progress import progress
from geometry.closest import triangle_index

# rows beside the main ones take each 4th sample, in every pose
BESIDE = 4


class Placement(NamedTuple):
    """One pose of the truth, and the poses of ours in which regions are measured."""

    truth: HeldOutView
    ours: dict[tuple[str, ...], HeldOutView]


def nothing() -> dict[str, Distances]:
    return {region: Distances() for region in SAMPLES}


@dataclass
class PoseDistances:
    """What was measured over a set, by region."""

    ours: dict[str, Distances] = field(default_factory=nothing)
    few: dict[str, Distances] = field(default_factory=nothing)  # the few poses alone
    aligned: dict[str, Distances] = field(default_factory=nothing)
    # under the rig's own weights
    own: dict[str, Distances] = field(default_factory=nothing)
    template: dict[str, Distances] = field(default_factory=nothing)
    template_aligned: dict[str, Distances] = field(default_factory=nothing)


def distinct_poses(views: Sequence[HeldOutView]) -> list[HeldOutView]:
    """One view of each pose; turning the whole person is no other pose to a distance between surfaces."""
    found: dict[bytes, HeldOutView] = {}
    for view in views:
        found.setdefault(view.axis_angle[1:].round(9).tobytes(), view)
    return list(found.values())


def same_poses(views: Sequence[HeldOutView]) -> list[Placement]:
    """Ours posed as the truth is."""
    return [Placement(view, {tuple(SAMPLES): view}) for view in distinct_poses(views)]


def fitted_poses(views: Sequence[HeldOutView], ours: Sequence[HeldOutView]) -> list[Placement]:
    """Ours posed as fitted to each picture."""
    found: dict[int, Placement] = {}
    for view, own in zip(views, ours, strict=True):
        region = VIEW_REGION[view.view]
        regions = ("total", "skin_beside_hair") if region == "total" else (region,)
        found.setdefault(view.pose_index, Placement(view, {})).ours[regions] = own
    return list(found.values())


@dataclass(frozen=True)
class JudgedSurfaces:
    """Two surfaces beside the truth, and what is measured beside them."""

    case: GeometryCase
    # the template before training; None: not at hand
    template: GeometryCase | None = None
    # our surface under the rig's weights; None: another skeleton
    own: PosableSurface | None = None
    # regions are aligned by themselves
    apart: bool = False

    @property
    def truth(self) -> TrueMesh:
        return self.case.truth


def measure_poses(what: JudgedSurfaces, placements: list[Placement], few: frozenset[int], label: str, *, beside: bool
                  ) -> PoseDistances:  # fmt: skip
    """Every distance of a set; `beside`: also what stands beside the main rows."""
    out = PoseDistances()
    for placement in progress(placements, label):
        view, here = placement.truth, nothing()
        truth = what.truth.posed(view.axis_angle, view.root)
        pair: PosedPair | None = None
        for regions, ours in placement.ours.items():
            pose = ours.axis_angle, ours.root
            pair = _moved(what.case, pair, truth, what.case.surface.posed(*pose))
            measure_pose(what.case, pair, {region: here[region] for region in regions if region in here})
            if not beside:
                continue
            _measure_aligned(what, what.case, pair, regions, out.aligned)
            if what.own is not None:
                measure_pose(what.case, _moved(what.case, pair, truth, what.own.posed(*pose)), out.own, every=BESIDE)
            if what.template is not None:
                posed = what.template.surface.posed(*pose)
                bare = PosedPair(truth, posed, pair.truth_index, triangle_index(posed, what.template.faces))
                into = {region: out.template[region] for region in regions if region in out.template}
                measure_pose(what.template, bare, into, every=BESIDE)
                _measure_aligned(what, what.template, bare, regions, out.template_aligned)
        gather(here, out.ours)
        if view.pose_index in few:
            gather(here, out.few)
    return out


def _moved(case: GeometryCase, pair: PosedPair | None, truth: np.ndarray, posed: np.ndarray) -> PosedPair:
    """The same truth beside another pose of ours."""
    if pair is None:
        return posed_pair(case, truth, posed)
    return pair._replace(surface=posed, index=triangle_index(posed, case.faces))


def _measure_aligned(
    what: JudgedSurfaces, case: GeometryCase, pair: PosedPair, regions: tuple[str, ...], into: dict[str, Distances]
) -> None:
    wanted = [region for region in regions if region in into and region in case.on_surface]
    groups = [[region] for region in wanted if region != "skin_beside_hair"] if what.apart else [wanted]
    for group in filter(None, groups):
        T = alignment(case, pair, group[0] if what.apart else "total")
        measure_pose(case, pair, {region: into[region] for region in group}, every=BESIDE, truth_from_surface=T)
