"""The ground truth of a synthetic capture: the subject's own mesh; capture/held_out.py reads the pictures.

truth/rest.npz                 the subject's mesh in pose 0 with its own rig weights, parts, hair, visible faces
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from avatar.skeleton import BIG_POSE, skin_transforms
from avatar.skinning import SkinWeights, skin_points
from capture.held_out import read_arrays

# shape, a letter for a length that must be the same everywhere, and kind of numbers
FIELDS = {
    "vertices": (("v", 3), np.float64), "faces": (("f", 3), np.int64), "joints": ((52, 3), np.float64),
    "skin_joints": (("v", 4), np.int64), "skin_weights": (("v", 4), np.float32), "part": (("v",), np.int64),
    "hair": (("v",), bool), "visible": (("f",), bool),
}  # fmt: skip
OPTIONAL = {"eye": (("v",), bool), "face": ((68, 3), np.float64)}


@dataclass(frozen=True)
class TrueMesh:
    """The subject itself, pose 0, pelvis joint at the origin, metres."""

    vertices: Float[Array, "vertices 3"]
    faces: Int[Array, "faces 3"]
    skin: SkinWeights
    joints: Float[Array, "52 3"]
    part: Int[Array, "vertices"]  # index into PARTS
    hair: Bool[Array, "vertices"]
    # seen from outside in pose 0
    visible: Bool[Array, "faces"]
    # vertices of the eyeballs; None: the capture does not say
    eye: Bool[Array, "vertices"] | None = None
    # iBUG's 68 points of the face; None: the capture does not say
    face: Float[Array, "68 3"] | None = None

    def posed(self, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"]) -> Float[Array, "vertices 3"]:
        transforms = skin_transforms(axis_angle, self.joints, root, rest=np.zeros((52, 3)))
        return skin_points(self.vertices, self.skin, transforms)

    def canonical(self) -> Float[Array, "vertices 3"]:
        """Vertices in the big pose, by the subject's own weights."""
        return self.posed(BIG_POSE, self.joints[0])


def read_true_mesh(capture: Path) -> TrueMesh:
    """Read truth/rest.npz.

    Raises:
        AssetError: the capture has no ground truth, or a field is absent, misshapen or not finite.
    """
    path = Path(capture) / "truth" / "rest.npz"
    required, optional = ({name: shape for name, (shape, _) in table.items()} for table in (FIELDS, OPTIONAL))
    kinds = {name: kind for name, (_, kind) in (FIELDS | OPTIONAL).items()}
    fields = {name: array.astype(kinds[name]) for name, array in read_arrays(path, required, optional).items()}
    skin = SkinWeights(fields.pop("skin_joints"), fields.pop("skin_weights"))
    return TrueMesh(skin=skin, **fields)
