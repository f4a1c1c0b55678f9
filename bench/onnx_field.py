"""The trained field without torch: RUN/fields.onnx (train/field_onnx.py) asked through ONNX Runtime, and drawn."""

from pathlib import Path

import numpy as np
import onnxruntime
from jaxtyping import Float

from avatar.camera import Camera
from avatar.errors import AssetError
from avatar.npz import read_npz
from avatar.skeleton import BIG_POSE
from avatar.skinning import SkinWeights
from bake.cone import view_cone
from bake.measure import FieldImage, FieldSurface, ScoredView, draw_field
from bench.posed_field import PosableSurface, PosedField
from geometry.isosurface import project_to_zero
from geometry.mesh import TriangleMesh
from player.context import open_context
from player.raster import Rasteriser

INPUTS = {"points": ["n", 3], "directions": ["n", 3]}
OUTPUTS = {"distance": ["n"], "normal": ["n", 3], "color": ["n", 3]}
# points at once, so that memory stays bounded
PIECE = 1 << 15


class OnnxField:
    """The fused field of a run, canonical frame, metres; as train.fused.FusedField, in NumPy.

    Raises:
        AssetError: the file is absent or not such a field.
    """

    def __init__(self, path: Path | str, *, threads: int = 1):
        self.path = Path(path)
        if not self.path.is_file():
            raise AssetError(f"{path}: no such file; `selfscan bake` writes it into the run folder")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        # what it has to say is in the exception
        options.log_severity_level = 4
        try:
            self.session = onnxruntime.InferenceSession(
                self.path.read_bytes(), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # ONNX Runtime's exceptions have no common base
            found = str(error).splitlines()[0][:200]
            raise AssetError(f"{path}: expected the field of a run (ONNX), found: {found}") from None
        for what, asked, given in (
            ("inputs", INPUTS, self.session.get_inputs()),
            ("outputs", OUTPUTS, self.session.get_outputs()),
        ):
            found = {value.name: value.shape for value in given}
            if found != asked:
                raise AssetError(f"{path}: {what} should be {asked}, are {found}")

    def distance(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Signed distance, metres, negative inside."""
        # no direction: no more than the distance
        return self.ask("distance", points, np.zeros_like(points))

    def normal(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Unit gradient of the distance."""
        return self.ask("normal", points, np.tile([0.0, 0.0, 1.0], (len(points), 1)))

    def color(self, points: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """sRGB in [0, 1] of points seen along unit directions, from the camera to the point."""
        return self.ask("color", points, directions)

    def ask(self, output: str, points: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]) -> np.ndarray:
        pieces = []
        for start in range(0, max(len(points), 1), PIECE):
            asked = {
                name: np.ascontiguousarray(values[start : start + PIECE], np.float32)
                for name, values in (("points", points), ("directions", directions))
            }
            pieces.append(self.session.run([output], asked)[0])
        return np.concatenate(pieces).astype(np.float64)


def field_surface(run: Path | str) -> FieldSurface:
    """A run's surface with its skin and view statistics, over the field of its fields.onnx.

    Raises:
        AssetError: a file of the run is absent or misshapen.
    """
    run = Path(run)
    field = OnnxField(run / "fields.onnx")
    shapes = {"vertices": 3, "normals": 3, "faces": 3, "skin_joints": 4, "skin_weights": 4, "view_mean": 3,
              "view_covariance": 6}  # fmt: skip
    surface = read_npz(run / "surface.npz", "the surface of a run", (*shapes, "view_count"))
    count = len(surface["vertices"])
    for name, width in shapes.items():
        rows = len(surface["faces"]) if name == "faces" else count
        if surface[name].shape != (rows, width):
            raise AssetError(f"{run / 'surface.npz'}: {name} should be ({rows}, {width}), is {surface[name].shape}")
    if surface["view_count"].shape != (count,) or surface["faces"].max(initial=0) >= count:
        raise AssetError(f"{run / 'surface.npz'}: view_count and faces should fit {count} vertices")
    joints = read_npz(run / "subject.npz", "the template of a run", ("joints",))["joints"].astype(np.float64)
    if joints.shape != (52, 3):
        raise AssetError(f"{run / 'subject.npz'}: joints should be (52, 3), is {joints.shape}")
    double = {name: values.astype(np.float64) for name, values in surface.items()}
    mesh = TriangleMesh(double["vertices"], surface["faces"].astype(np.int64))
    cone = view_cone(
        double["view_count"], double["view_mean"], double["view_covariance"], double["normals"], mesh.faces
    )
    skin = SkinWeights(surface["skin_joints"].astype(np.int64), surface["skin_weights"])
    return FieldSurface(mesh, double["normals"], skin, cone, joints, field.distance, field.color)


def posed_field(surface: FieldSurface) -> PosedField:
    """The same made ready for drawing: its vertices moved onto the zero set once, along their normals."""
    vertices, _ = project_to_zero(
        surface.distance, surface.distance, surface.mesh.vertices, reach=0.003, steps=2, directions=surface.normals
    )
    posable = PosableSurface(vertices, surface.mesh.faces, surface.skin, surface.joints, BIG_POSE)
    return PosedField(posable, surface.cone, surface.distance, surface.color)


def drawn_field(surface: FieldSurface, views: list[ScoredView]) -> list[FieldImage]:
    """Pictures of the field: as the paper shows it, and inside the cone of directions that training saw."""
    context = open_context()
    raster = Rasteriser(context)
    try:

        def draw(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
            fragments = raster.draw(vertices, faces, camera)
            return fragments.face, fragments.barycentric

        return [draw_field(surface, view, draw, with_cone=True) for view in views]
    finally:
        raster.release()
        context.release()
