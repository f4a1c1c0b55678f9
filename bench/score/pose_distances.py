"""Distances of a set of held-out poses: as they stand, aligned, and of the template that training began with.

A skeleton that was given is posed as the truth is, and all regions are measured in that pose. An estimated skeleton has
a fit for each picture (fitted_poses.py): head and hands are measured where their close-ups have them, the rest
where the body's view has it; aligned, each region by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bench.field.posed_field import PosableSurface
from bench.score.picture_scores import VIEW_REGION
from bench.score.posed_geometry import (
    SAMPLES,
    Distances,
    GeometryCase,
    PosedPair,
    alignment,
    measure_pose,
    nothing,
    posed_pair,
)
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


# what was measured over a set of poses, by the name of its row
Rows = dict[str, Distances]


def same_poses(views: Sequence[HeldOutView]) -> list[Placement]:
    """Ours posed as the truth is, each pose once: turning the whole person is no other pose to a distance between
    surfaces."""
    found: dict[bytes, Placement] = {}
    for view in views:
        found.setdefault(view.axis_angle[1:].round(9).tobytes(), Placement(view, {tuple(SAMPLES): view}))
    return list(found.values())


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


def measure_poses(what: JudgedSurfaces, placements: list[Placement], label: str, *, beside: bool = False) -> Rows:
    """Every distance of a set: the row "ours"; with `beside` also "aligned", and where they are at hand "own_weights",
    under the rig's own weights, "zero_steps", of the template, and "zero_steps_aligned"."""
    out: Rows = {"ours": nothing(), **({"aligned": nothing()} if beside else {})}
    out |= {"own_weights": nothing()} if beside and what.own is not None else {}
    out |= {"zero_steps": nothing(), "zero_steps_aligned": nothing()} if beside and what.template is not None else {}
    case, template = what.case, what.template
    for placement in progress(placements, label):
        truth = what.truth.posed(placement.truth.axis_angle, placement.truth.root)
        index = triangle_index(truth, case.truth_faces)
        for regions, ours in placement.ours.items():
            pose = ours.axis_angle, ours.root
            pair = posed_pair(case, truth, case.surface.posed(*pose), index)
            measure_pose(case, pair, out["ours"], regions)
            if not beside:
                continue
            _measure_aligned(what, case, pair, regions, out["aligned"])
            if what.own is not None:
                own = posed_pair(case, truth, what.own.posed(*pose), index)
                measure_pose(case, own, out["own_weights"], every=BESIDE)
            if template is not None:
                bare = posed_pair(template, truth, template.surface.posed(*pose), index)
                measure_pose(template, bare, out["zero_steps"], regions, every=BESIDE)
                _measure_aligned(what, template, bare, regions, out["zero_steps_aligned"])
    return out


def measure_once(
    case: GeometryCase, axis_angle: Float[np.ndarray, "52 3"], apart: bool
) -> tuple[Distances, PosedPair, Float[np.ndarray, "4 4"] | None]:
    """One pose of both: distances, the two posed, and truth_from_surface by rigid ICP where the skeleton was estimated:
    its pelvis is elsewhere."""
    into, root = nothing(), case.truth.joints[0]
    pair = posed_pair(case, case.truth.posed(axis_angle, root), case.surface.posed(axis_angle, root))
    T = alignment(case, pair) if apart else None
    measure_pose(case, pair, into, every=BESIDE, truth_from_surface=T)
    return into, pair, T


def _measure_aligned(
    what: JudgedSurfaces, case: GeometryCase, pair: PosedPair, regions: tuple[str, ...], into: Distances
) -> None:
    wanted = [region for region in regions if region in into and region in case.on_surface]
    groups = [[region] for region in wanted if region != "skin_beside_hair"] if what.apart else [wanted]
    for group in filter(None, groups):
        T = alignment(case, pair, group[0] if what.apart else "total")
        measure_pose(case, pair, into, group, every=BESIDE, truth_from_surface=T)
