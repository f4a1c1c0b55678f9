"""Reconstruction against truth in every test pose: which samples count to which region, and their distances."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from avatar.skinning import SkinWeights
from bench import geometry
from bench.field_view import PosableSurface
from bench.held_out import TrueMesh
from bench.picture_scores import REGION_PART

SAMPLES = {"total": 6000, "head": 3000, "left_hand": 2000, "right_hand": 2000}


@dataclass(frozen=True)
class GeometryCase:
    """What stays the same in every pose: samples on both surfaces, and which count to which region."""

    truth: TrueMesh
    truth_faces: Int[np.ndarray, "f 3"]  # visible
    surface: PosableSurface
    faces: Int[np.ndarray, "g 3"]  # visible faces of the reconstruction
    on_truth: dict[str, geometry.SurfaceSamples]  # into truth_faces
    on_surface: dict[str, geometry.SurfaceSamples]  # into faces


def geometry_case(
    truth: TrueMesh, surface: PosableSurface, visible: Bool[np.ndarray, "g"], *, seed: int = 0
) -> GeometryCase:
    """Sample both surfaces. A face of the reconstruction belongs to the region of the true surface nearest to it in
    the canonical pose; the reconstruction's own labels are not trusted."""
    geometry.check_mesh(truth.vertices, truth.faces, "truth")
    geometry.check_mesh(surface.vertices, surface.faces, "reconstruction")
    geometry.check_same_unit(truth.vertices, surface.vertices)
    truth_faces, faces = truth.faces[truth.visible], surface.faces[visible]
    canonical = truth.canonical()
    index = geometry.triangle_index(canonical, truth_faces)
    nearest = index.tree.query(surface.vertices[faces].mean(1))[1]
    truth_part = truth.part[truth_faces[:, 0]]
    part = truth_part[nearest]

    on_truth, on_surface = {}, {}
    for number, (region, count) in enumerate(SAMPLES.items()):
        keep_truth = None if region == "total" else truth_part == REGION_PART[region]
        keep = None if region == "total" else part == REGION_PART[region]
        on_truth[region] = geometry.sample_surface(
            truth.vertices, truth_faces, count, seed=seed + 2 * number, keep=keep_truth
        )
        if keep is None or keep.any():
            on_surface[region] = geometry.sample_surface(
                surface.vertices, faces, count, seed=seed + 2 * number + 1, keep=keep
            )
    return GeometryCase(truth, truth_faces, surface, faces, on_truth, on_surface)


@dataclass
class Distances:
    """Distances in metres of one region, gathered over poses."""

    to_truth: list[np.ndarray] = field(default_factory=list)
    to_surface: list[np.ndarray] = field(default_factory=list)
    hair_to_truth: list[np.ndarray] = field(default_factory=list)  # is the nearest true surface hair
    hair_to_surface: list[np.ndarray] = field(default_factory=list)

    def merged(self, other: "Distances") -> "Distances":
        return Distances(
            self.to_truth + other.to_truth,
            self.to_surface + other.to_surface,
            self.hair_to_truth + other.hair_to_truth,
            self.hair_to_surface + other.hair_to_surface,
        )

    def scores(self, hair: bool | None = None) -> geometry.SurfaceDistance:
        """All surface, or only what is hair (True) or is not (False)."""
        if not self.to_truth or not self.to_surface:
            return geometry.SurfaceDistance(None, None, None)
        to_truth, to_surface = np.concatenate(self.to_truth), np.concatenate(self.to_surface)
        if hair is not None:
            to_truth = to_truth[np.concatenate(self.hair_to_truth) == hair]
            to_surface = to_surface[np.concatenate(self.hair_to_surface) == hair]
        return geometry.surface_distance(to_truth, to_surface)


def measure_pose(
    case: GeometryCase,
    truth_posed: Float[np.ndarray, "v 3"],
    posed: Float[np.ndarray, "w 3"],
    into: dict[str, Distances],
) -> None:
    """Add the distances of one pose, every region."""
    truth_index = geometry.triangle_index(truth_posed, case.truth_faces)
    index = geometry.triangle_index(posed, case.faces)
    hair = case.truth.hair[case.truth_faces].sum(1) >= 2
    for region, samples in case.on_truth.items():
        if region not in case.on_surface:
            continue
        there = geometry.closest_points(case.on_surface[region].on(posed, case.faces), truth_index)
        back = geometry.closest_points(samples.on(truth_posed, case.truth_faces), index)
        into[region].to_truth.append(there.distance)
        into[region].hair_to_truth.append(hair[there.face])
        into[region].to_surface.append(back.distance)
        into[region].hair_to_surface.append(hair[samples.face])


def aligned_total(
    case: GeometryCase, truth_posed: Float[np.ndarray, "v 3"], posed: Float[np.ndarray, "w 3"]
) -> Float[np.ndarray, "w 3"]:
    """The posed reconstruction after rigid ICP of the whole onto the truth (what the paper's code does)."""
    samples = case.on_surface["total"]
    few = geometry.SurfaceSamples(samples.face[::8], samples.barycentric[::8])
    index = geometry.triangle_index(truth_posed, case.truth_faces)
    truth_from_posed = geometry.rigid_alignment(few.on(posed, case.faces), index, rounds=15)
    return posed @ truth_from_posed[:3, :3].T + truth_from_posed[:3, 3]


def own_weights_surface(truth: TrueMesh, surface: PosableSurface) -> PosableSurface:
    """The reconstruction skinned by the subject's own rig weights, looked up at the nearest true surface point."""
    canonical = truth.canonical()
    faces = truth.faces[truth.visible]
    index = geometry.triangle_index(canonical, faces)
    corners = faces[index.tree.query(surface.vertices)[1]]
    gap = np.linalg.norm(canonical[corners] - surface.vertices[:, None], axis=-1)
    nearest = corners[np.arange(len(corners)), gap.argmin(1)]
    skin = SkinWeights(truth.skin.joints[nearest], truth.skin.weights[nearest])
    return PosableSurface(surface.vertices, surface.faces, skin, truth.joints, surface.canonical_pose)
