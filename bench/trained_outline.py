"""Poses in held-out pictures, moved until the outline of what was trained lies on the mask's.

Before, a pose was fitted with the template, whose outline is the person's but for a thickness in each of five regions
(capture/fit/picture.py). Training has found the rest of it. What is drawn is compared with the mask, both blurred, in
ever finer steps, and Gauss-Newton steps of image alignment (capture/repair/pixels.py) turn the joints and move the
person; the pose that was fitted holds all that outlines do not see.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from avatar.camera import Camera
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, joint_transforms
from bench.posed_field import PosableSurface, faces_in_picture
from capture.fit.body import MOVING
from capture.fit.hand import hand_joints
from capture.held_out import HeldOutView
from capture.repair.increments import DESCENDS, increments_moved, joints_moved, project_derivative
from capture.repair.pixels import compare_pixels
from player.raster import Rasteriser

Array = np.ndarray

# pixels of a picture 512 high: blur of each step
BLURS = (4.0, 4.0, 3.0, 2.0, 2.0, 1.5, 1.5, 1.0, 1.0, 1.0)
# residuals of blurred coverage: beyond OUTLIER something else is wrong; neighbours err together, so more than the noise
OUTLIER, PIXEL = 0.2, 0.3
# every other pixel is looked at, as far from what is drawn, at 512
STRIDE, FAR = 2, 12.0
# degrees and metres: how sure the pose was; of the whole person's turn
TURN, WHOLE, ROOT = 6.0, 10.0, 0.03
# metres: how sure each joint's depth was, of which an outline says next to nothing
DEPTH = 0.005
# of a close-up, whose outline counts: what hangs from this joint
TOPS = {"head": "head", "hand_left": "left_wrist", "hand_right": "right_wrist"}


class _Drawn(NamedTuple):
    """What a pose looks like."""

    hit: Bool[Array, "height width"]
    # of each pixel that is hit: the surface vertex nearest to it
    vertex: Int[Array, "height width"]
    posed: Float[Array, "vertices 3"]


class TrainedOutline:
    """A trained surface whose outlines are laid on masks."""

    def __init__(self, surface: PosableSurface, raster: Rasteriser):
        self.surface, self.raster = surface, raster
        self.heaviest = surface.skin.joints[np.arange(len(surface.vertices)), surface.skin.weights.argmax(1)]

    def refined(self, view: HeldOutView) -> HeldOutView:
        """The view, which holds a fitted pose, in the pose whose outline is the mask's."""
        scale = view.camera.size[1] / 512
        mask = view.pixels("masks", "L").astype(np.float64) / 255
        moving, own = self._moving(view.view)
        sigma = np.r_[np.full(3 * len(moving), np.radians(TURN)), np.full(3, ROOT)]
        sigma[:3] = np.radians(WHOLE)
        fitted = matrix_from_axis_angle(view.axis_angle)
        R, root = fitted.copy(), view.root.copy()
        forwards = np.broadcast_to(view.camera.camera_from_world[2, :3], (52, 3))
        depth = (forwards * joint_transforms(view.axis_angle, self.surface.joints, root)[:, :3, 3]).sum(1)
        for blur in BLURS:
            axis_angle = axis_angle_from_matrix(R)
            H, b = self._step(axis_angle, root, view.camera, mask, blur * scale, moving, own)
            G = joint_transforms(axis_angle, self.surface.joints, root)
            J = joints_moved(G, forwards, moving)
            H += J.T @ J / DEPTH**2
            b += J.T @ (depth - (forwards * G[:, :3, 3]).sum(1)) / DEPTH**2
            turned = axis_angle_from_matrix(np.swapaxes(fitted, -1, -2) @ R)[moving]
            away = np.r_[turned.ravel(), root - view.root]
            step = np.linalg.solve(H + np.diag(1 / sigma**2), b - away / sigma**2)
            R = R.copy()
            R[moving] = R[moving] @ matrix_from_axis_angle(step[:-3].reshape(-1, 3))
            root = root + step[-3:]
        return replace(view, axis_angle=axis_angle_from_matrix(R), root=root)

    def _moving(self, part: str) -> tuple[Int[Array, "m"], Bool[Array, "vertices"]]:
        """Joints that turn, the whole person's first, and whose vertices' outline counts."""
        if part == "body":
            return np.asarray(MOVING), np.ones(len(self.heaviest), bool)
        turning = np.zeros(0, np.int64) if part == "head" else hand_joints(part.removeprefix("hand_"))
        return np.unique(np.r_[0, turning]), DESCENDS[self.heaviest, JOINTS.index(TOPS[part])]

    def _draw(self, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"], camera: Camera) -> _Drawn:
        posed = self.surface.posed(axis_angle, root)
        faces = faces_in_picture(posed, self.surface.faces, camera)
        drawn = self.raster.draw(posed, faces, camera, camera.size)
        hit = drawn.face >= 0
        vertex = np.zeros(hit.shape, np.int64)
        vertex[hit] = np.take_along_axis(faces[drawn.face[hit]], drawn.barycentric[hit].argmax(1)[:, None], 1)[:, 0]
        return _Drawn(hit, vertex, posed)

    def _step(
        self, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"], camera: Camera,
        mask: Float[Array, "height width"], blur: float, moving: Int[Array, "m"], own: Bool[Array, "vertices"],
    ) -> tuple[Float[Array, "p p"], Float[Array, "p"]]:  # fmt: skip
        """Normal equations of the increments, of all pixels near the outlines."""
        count = 3 * len(moving) + 3
        drawn = self._draw(axis_angle, root, camera)
        if not drawn.hit.any():
            return np.zeros((count, count)), np.zeros(count)
        near = ndimage.binary_dilation(drawn.hit | (mask > 0.5), iterations=max(2, round(3 * blur)))
        rows, columns = (a[::STRIDE] for a in np.nonzero(near))
        nearest = ndimage.distance_transform_edt(~drawn.hit, return_distances=False, return_indices=True)
        assert isinstance(nearest, np.ndarray)
        hit = nearest[:, rows, columns]
        vertex = drawn.vertex[hit[0], hit[1]]
        close = np.hypot(hit[0] - rows, hit[1] - columns) < FAR * camera.size[1] / 512
        keep = close & own[vertex]
        rows, columns, vertex = rows[keep], columns[keep], vertex[keep]
        blurred = [ndimage.gaussian_filter(a.astype(np.float64), blur) for a in (drawn.hit, mask)]
        found = compare_pixels(blurred[0], blurred[1], (rows, columns), OUTLIER)
        g = np.einsum("ni,nij->nj", found.slope, project_derivative(camera, drawn.posed[vertex]))
        surface = self.surface
        J = increments_moved(surface.vertices[vertex], surface.skin.of(vertex),
                             joint_transforms(axis_angle, surface.joints, root),
                             surface.transforms(axis_angle, root), g, moving)  # fmt: skip
        weight = STRIDE * found.weight / (PIXEL**2 * (1 + blur**2))
        return (J * weight[:, None]).T @ J, (J * weight[:, None]).T @ found.residual
