"""The eye region of a picture: the truth's visible eyeballs, grown by 3 mm."""

import numpy as np
from jaxtyping import Bool, Float

from avatar.camera import Camera, project
from bench.true_mesh import TrueMesh
from capture.eyes import GROWN
from geometry.cells import distance_to
from player.raster import Rasteriser

NO_EYES = "the capture's truth/rest.npz does not say which surface is eye; `selfscan synth` of today writes it"


def eye_region(
    raster: Rasteriser, truth: TrueMesh, posed: Float[np.ndarray, "vertices 3"], camera: Camera
) -> Bool[np.ndarray, "height width"]:
    """Pixels within GROWN of those that show an eyeball of the posed truth; none where no eye is seen."""
    width, height = camera.size
    if truth.eye is None:
        return np.zeros((height, width), bool)
    drawn = raster.draw(posed, truth.faces, camera).face
    shown = (drawn >= 0) & truth.eye[truth.faces[drawn]].all(-1)
    if not shown.any():
        return shown
    _, depth = project(camera, posed[truth.faces[np.unique(drawn[shown])].ravel()])
    return distance_to(shown) <= GROWN * camera.K[0, 0] / float(np.median(depth))
