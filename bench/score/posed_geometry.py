"""Reconstruction against truth in every test pose: which samples count to which region, and their distances."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from avatar.skeleton import JOINTS, PARTS
from avatar.skinning import SkinWeights
from bench.field.posed_field import PosableSurface
from bench.score.picture_scores import REGION_PART
from bench.score.surface_distance import SurfaceDistance, check_same_unit, surface_distance
from bench.score.true_mesh import TrueMesh
from geometry.closest import TriangleIndex, closest_points, triangle_index
from geometry.icp import rigid_icp
from geometry.mesh import check_mesh
from geometry.sample import SurfaceSamples, stratified_samples

# in every pose; a person without hair has no skin beside it
SAMPLES = {"total": 4000, "head": 1500, "left_hand": 1000, "right_hand": 1000, "skin_beside_hair": 1000}
# metres from hair: hair that is one sheet with the neck shows there
BESIDE = 0.04


@dataclass(frozen=True)
class GeometryCase:
    """What stays the same in every pose: samples on both surfaces, and which count to which region."""

    truth: TrueMesh
    truth_faces: Int[np.ndarray, "faces 3"]  # visible
    surface: PosableSurface
    faces: Int[np.ndarray, "g 3"]  # visible faces of the reconstruction
    on_truth: dict[str, SurfaceSamples]  # into truth_faces
    on_surface: dict[str, SurfaceSamples]  # into faces


def geometry_case(truth: TrueMesh, surface: PosableSurface, visible: Bool[np.ndarray, "g"]) -> GeometryCase:
    """Sample both surfaces. A face of the reconstruction belongs to the region of the true surface nearest to it in
    the canonical pose; the reconstruction's own labels are not trusted."""
    check_mesh(truth.vertices, truth.faces, "truth")
    check_mesh(surface.vertices, surface.faces, "reconstruction")
    check_same_unit(truth.vertices, surface.vertices)
    truth_faces, faces = truth.faces[truth.visible], surface.faces[visible]
    canonical = truth.canonical()
    middles = canonical[truth_faces].mean(1)
    nearest = KDTree(middles).query(surface.vertices[faces].mean(1))[1]
    part = truth.part[truth_faces[:, 0]]
    members = {"total": np.ones(len(part), bool), "skin_beside_hair": skin_beside_hair(truth)[truth.visible]}
    members |= {region: part == number for region, number in REGION_PART.items()}
    on_truth, on_surface = {}, {}
    for number, (region, count) in enumerate(SAMPLES.items()):
        own, ours = members[region], members[region][nearest]
        if own.any():
            on_truth[region] = stratified_samples(truth.vertices, truth_faces, count, seed=2 * number, weight=own)
        if ours.any():
            on_surface[region] = stratified_samples(surface.vertices, faces, count, seed=2 * number + 1, weight=ours)
    return GeometryCase(truth, truth_faces, surface, faces, on_truth, on_surface)


def hair_faces(truth: TrueMesh) -> Bool[np.ndarray, "faces"]:
    """True faces that are hair: at least two of their corners are."""
    return truth.hair[truth.faces].sum(1) >= 2


def skin_beside_hair(truth: TrueMesh) -> Bool[np.ndarray, "faces"]:
    """True visible faces of head and neck within BESIDE of visible hair, hair apart; canonical pose."""
    middle = truth.canonical()[truth.faces].mean(1)
    hair = hair_faces(truth)
    head_and_neck = np.isin(truth.skin.heaviest, [JOINTS.index("neck"), JOINTS.index("head")])
    head_and_neck |= truth.part == PARTS.index("head")
    chosen = truth.visible & ~hair & head_and_neck[truth.faces].any(1)
    if not (hair & truth.visible).any() or not chosen.any():
        return np.zeros(len(truth.faces), bool)
    away = KDTree(middle[hair & truth.visible]).query(middle[chosen])[0]
    chosen[chosen] = away < BESIDE
    return chosen


class PoseDistances(NamedTuple):
    """Distances in metres of one region in one pose, and which of the true surface there is hair."""

    to_truth: Float[np.ndarray, "n"]
    hair_to_truth: Bool[np.ndarray, "n"]
    to_surface: Float[np.ndarray, "m"]
    hair_to_surface: Bool[np.ndarray, "m"]


# by region, those of each pose
Distances = dict[str, list[PoseDistances]]


def nothing() -> Distances:
    return {region: [] for region in SAMPLES}


def pooled_distance(poses: list[PoseDistances], hair: bool | None = None) -> SurfaceDistance:
    """Over all poses, of all surface, or only of what is hair (True) or is not (False)."""
    if not poses:
        return SurfaceDistance(None)
    to_truth, hair_to_truth, to_surface, hair_to_surface = (np.concatenate(part) for part in zip(*poses))
    if hair is not None:
        to_truth, to_surface = to_truth[hair_to_truth == hair], to_surface[hair_to_surface == hair]
    return surface_distance(to_truth, to_surface)


class PosedPair(NamedTuple):
    """Truth and reconstruction in one pose, metres, each with the search structure of what can be seen of it."""

    truth: Float[np.ndarray, "vertices 3"]
    surface: Float[np.ndarray, "w 3"]
    truth_index: TriangleIndex
    index: TriangleIndex


def posed_pair(
    case: GeometryCase,
    truth: Float[np.ndarray, "vertices 3"],
    posed: Float[np.ndarray, "w 3"],
    truth_index: TriangleIndex | None = None,
) -> PosedPair:
    """Both surfaces posed; `truth_index`: where it was made for another pose of ours."""
    index = triangle_index(truth, case.truth_faces) if truth_index is None else truth_index
    return PosedPair(truth, posed, index, triangle_index(posed, case.faces))


def measure_pose(
    case: GeometryCase,
    pair: PosedPair,
    into: Distances,
    only: Collection[str] = SAMPLES,
    *,
    every: int = 1,
    truth_from_surface: Float[np.ndarray, "4 4"] | None = None,
) -> None:
    """Add the distances of one pose to those regions of `into` that are among `only`. `every` takes only each n-th
    sample; `truth_from_surface` moves the reconstruction rigidly first."""
    hair = hair_faces(case.truth)[case.truth.visible]
    for region in case.on_truth.keys() & case.on_surface.keys() & into.keys() & set(only):
        true = thinned(case.on_truth[region], every)
        there = thinned(case.on_surface[region], every).on(pair.surface, case.faces)
        back = true.on(pair.truth, case.truth_faces)
        if truth_from_surface is not None:
            R, t = truth_from_surface[:3, :3], truth_from_surface[:3, 3]
            there, back = there @ R.T + t, (back - t) @ R
        found = closest_points(there, pair.truth_index)
        returning = closest_points(back, pair.index).distance
        into[region].append(PoseDistances(found.distance, hair[found.face], returning, hair[true.face]))


def thinned(samples: SurfaceSamples, every: int) -> SurfaceSamples:
    """Each n-th sample: still even over the surface, because samples are drawn along it."""
    return SurfaceSamples(samples.face[::every], samples.barycentric[::every])


def alignment(case: GeometryCase, pair: PosedPair, region: str = "total") -> Float[np.ndarray, "4 4"]:
    """truth_from_surface by rigid ICP onto the truth, of the whole reconstruction as the paper's code, or a region."""
    few = thinned(case.on_surface[region], 16 if region == "total" else 4)
    return rigid_icp(few.on(pair.surface, case.faces), pair.truth_index, rounds=15)


def own_weights_surface(truth: TrueMesh, surface: PosableSurface) -> PosableSurface:
    """The reconstruction skinned by the subject's own rig weights, looked up at the nearest true surface point."""
    canonical = truth.canonical()
    faces = truth.faces[truth.visible]
    corners = faces[KDTree(canonical[faces].mean(1)).query(surface.vertices)[1]]
    gap = np.linalg.norm(canonical[corners] - surface.vertices[:, None], axis=-1)
    nearest = corners[np.arange(len(corners)), gap.argmin(1)]
    skin = SkinWeights(truth.skin.joints[nearest], truth.skin.weights[nearest])
    return PosableSurface(surface.vertices, surface.faces, skin, truth.joints, surface.canonical_pose)
