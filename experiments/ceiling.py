"""The ceiling of an evaluation: the subject's own mesh and textures, posed by the skin weights that learning uses.

    python -m experiments.ceiling CAPTURE [--poses N] [--json FILE]

What it loses against the truth no learner can win back: a T-pose video does not show the rig's weights. Under
"ceiling" in the "beside" of a file of `selfscan eval --json`, experiments/quality_page.py shows it.
"""

import argparse
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from avatar.camera import Camera
from avatar.skeleton import BIG_POSE
from bench.field.posed_field import MaskedPicture, PosableSurface
from bench.report.writer import Json, markdown_table
from bench.score.metrics import METRICS
from bench.score.picture_scores import PictureJudge, is_t_pose, score_images
from bench.score.pose_distances import JudgedSurfaces, measure_poses, same_poses
from bench.score.posed_geometry import geometry_case
from bench.score.quality_table import cells
from bench.score.region_scores import regions_of
from bench.score.true_mesh import TrueMesh, read_true_mesh
from capture.folder import read_subject
from capture.held_out import read_held_out, read_truth_facts, some_poses
from files.npz import read_npz
from files.picture import read_picture
from files.whole import write_json
from geometry.mesh import vertex_normals
from player.draw.raster import Rasteriser
from player.gl.context import open_context
from synth.light import light_of
from synth.photo import Studio
from synth.subject import SynthSubject
from train.skin import CanonicalSkin


def ceiling_surface(capture: Path, truth: TrueMesh) -> PosableSurface:
    """The true mesh with weights looked up on the capture's template, as training looks them up."""
    canonical = truth.canonical()
    template = read_subject(Path(capture) / "subject.npz")
    skin = CanonicalSkin(template).of_mesh(canonical, truth.faces, vertex_normals(canonical, truth.faces))
    return PosableSurface(canonical, truth.faces, skin, np.asarray(template.joints, np.float64), BIG_POSE)


class CeilingDrawer:
    """Pictures of the ceiling in the light of the capture."""

    def __init__(self, raster: Rasteriser, capture: Path, facts: Json, truth: TrueMesh):
        self.surface = ceiling_surface(capture, truth)
        self.studio = Studio(raster, true_subject(capture, truth), 1, float(facts.get("sheen", 0.0)))
        self.light = light_of(facts["light"], "body", int(facts["seed"]))

    def draw(
        self,
        axis_angle: Float[np.ndarray, "52 3"],
        root: Float[np.ndarray, "3"],
        camera: Camera,
        samples: int,
        where: Bool[np.ndarray, "height width"] | None = None,
    ) -> MaskedPicture:
        """One picture on black; all of it, whatever `where` says: drawing the mesh costs the same."""
        self.studio.supersample = samples
        photo = self.studio.take(self.surface.posed(axis_angle, root), camera, self.light)
        return MaskedPicture((photo.image / np.float32(255)).astype(np.float32), photo.mask > 127)


def true_subject(capture: Path, truth: TrueMesh) -> SynthSubject:
    """The filmed person from the capture's truth folder.

    Raises:
        AssetError: a texture is missing or the materials name one that is.
    """
    folder = Path(capture) / "truth"
    fields = read_npz(folder / "rest.npz", "ground truth", {"uv", "material"})
    count = int(fields["material"].max()) + 1
    return SynthSubject(
        name="truth",
        vertices=truth.vertices.astype(np.float32),
        faces=truth.faces,
        uv=fields["uv"],
        material=fields["material"].astype(np.int64),
        textures=tuple(read_picture(folder / f"texture_{i}.png") for i in range(count)),
        alpha=(None,) * count,
        skin=truth.skin,
        joints=truth.joints,
        part=truth.part.astype(np.uint8),
        hair=truth.hair,
        licence="",
        eye=truth.eye,
    )


def measured_ceiling(capture: Path, poses: int | None) -> Json:
    """Novel poses of the true mesh under our weights, by region: pictures and distances."""
    facts, truth = read_truth_facts(capture), read_true_mesh(capture)
    views = [view for view in some_poses(read_held_out(capture, "novel_pose"), poses) if not is_t_pose(view)]
    with open_context() as context:
        raster = Rasteriser(context)
        best = CeilingDrawer(raster, capture, facts, truth)
        judge = PictureJudge(truth, best.draw, None, raster)
        images = score_images(judge, views, "ceiling pictures")
    surfaces = JudgedSurfaces(geometry_case(truth, best.surface, truth.visible))
    return regions_of(measure_poses(surfaces, same_poses(views), "ceiling surfaces")["ours"], images)


def main(argv: list[str] | None = None) -> int:
    """Print the table of a capture's ceiling."""
    parser = argparse.ArgumentParser(prog="python -m experiments.ceiling", description="The best to be had.")
    parser.add_argument("capture", metavar="CAPTURE", type=Path)
    parser.add_argument("--poses", type=int, metavar="N", help="novel poses (default: all)")
    parser.add_argument("--json", metavar="FILE", type=Path)
    options = parser.parse_args(argv)
    found = measured_ceiling(options.capture, options.poses)
    rows = [[region, *cells(scores)] for region, scores in found.items()]
    print("\n".join(markdown_table(["region", *(metric.title for metric in METRICS)], rows)))
    if options.json:
        write_json(options.json, found)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
