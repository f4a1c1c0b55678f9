"""Poses in held-out pictures, moved until the outline of what was trained lies on the mask's.

Before, a pose was fitted with the template, whose outline is the person's but for a thickness in each of five regions
(capture/fit/picture.py). Training has found the rest of it. What is drawn is compared with the mask, both blurred, in
ever finer steps, and Gauss-Newton steps of image alignment (capture/fit/pixels.py) turn the joints and move the
person; the pose that was fitted holds all that outlines do not see.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage

from avatar.camera import Camera
from avatar.kinematics import (
    DESCENDS,
    Posed,
    SkinnedPoints,
    increment_rows,
    pixel_rows,
    pose_rows,
    posed_canonical,
    turned,
)
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS
from avatar.skinning import skin_points
from bench.field.posed_field import PosableSurface, faces_in_picture
from capture.fit.body import MOVING
from capture.fit.hand import hand_joints
from capture.fit.pixels import compare_pixels
from capture.held_out import HeldOutView
from geometry.cells import nearest_marked
from geometry.least_squares import NormalEquations
from player.draw.raster import Rasteriser

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
# in a close-up the outline counts of what hangs from this joint
TOPS = {"head": "head", "hand_left": "left_wrist", "hand_right": "right_wrist"}


class TrainedOutline:
    def __init__(self, surface: PosableSurface, raster: Rasteriser):
        self.surface, self.raster = surface, raster

    def refined(self, view: HeldOutView) -> HeldOutView:
        """The view, which holds a fitted pose, in the pose whose outline is the mask's."""
        scale = view.camera.size[1] / 512
        mask = view.pixels("masks", "L").astype(np.float64) / 255
        moving, own = self._moving(view.view)
        sigma = np.r_[np.full(3, ROOT), np.full(3 * len(moving), np.radians(TURN))]
        sigma[3:6] = np.radians(WHOLE)
        fitted = matrix_from_axis_angle(view.axis_angle)
        R, root = fitted.copy(), view.root.copy()
        forwards = np.broadcast_to(view.camera.camera_from_world[2, :3], (52, 3))
        depth = (forwards * self._posed(R, root).place).sum(1)
        for blur in BLURS:
            frame = self._posed(R, root)
            equations = NormalEquations(1, len(sigma))
            self._add_outline(equations, frame, view.camera, mask, blur * scale, moving, own)
            joints = SkinnedPoints(frame.skeleton.joints, frame.shift, np.arange(52)[:, None], np.ones((52, 1)))
            rows = pose_rows(frame, joints, forwards, moving)
            equations.add(0, rows, depth - (forwards * frame.place).sum(1), np.full(52, 1 / DEPTH**2))
            away = axis_angle_from_matrix(np.swapaxes(fitted, -1, -2) @ R)[moving]
            equations.hold(np.arange(len(sigma)), np.r_[root - view.root, away.ravel()][None], 1 / sigma**2)
            step = equations.solve()[0][0]
            R = R.copy()
            R[moving] = turned(R[moving], step[3:].reshape(-1, 3))
            root = root + step[:3]
        return replace(view, axis_angle=axis_angle_from_matrix(R), root=root)

    def _posed(self, R: Float[Array, "52 3 3"], root: Float[Array, "3"]) -> Posed:
        return posed_canonical(axis_angle_from_matrix(R), self.surface.joints, root, self.surface.canonical_pose)

    def _moving(self, part: str) -> tuple[Int[Array, "m"], Bool[Array, "vertices"]]:
        """Joints that turn, the whole person's first, and whose vertices' outline counts."""
        if part == "body":
            return np.asarray(MOVING), np.ones(len(self.surface.vertices), bool)
        turning = np.zeros(0, np.int64) if part == "head" else hand_joints(part.removeprefix("hand_"))
        return np.unique(np.r_[0, turning]), DESCENDS[self.surface.skin.heaviest, JOINTS.index(TOPS[part])]

    def _add_outline(
        self, equations: NormalEquations, frame: Posed, camera: Camera, mask: Float[Array, "height width"], blur: float,
        moving: Int[Array, "m"], own: Bool[Array, "vertices"],
    ) -> None:  # fmt: skip
        posed = skin_points(self.surface.vertices, self.surface.skin, frame.transforms)
        faces = faces_in_picture(posed, self.surface.faces, camera)
        drawn = self.raster.draw(posed, faces, camera)
        hit = drawn.face >= 0
        if not hit.any():
            return
        near = ndimage.binary_dilation(hit | (mask > 0.5), iterations=max(2, round(3 * blur)))
        rows, columns = (a[::STRIDE] for a in np.nonzero(near))
        at = tuple(axis[rows, columns] for axis in nearest_marked(hit))
        # the surface vertex nearest to the nearest pixel that is hit
        vertex = np.take_along_axis(faces[drawn.face[at]], drawn.barycentric[at].argmax(1)[:, None], 1)[:, 0]
        keep = (np.hypot(at[0] - rows, at[1] - columns) < FAR * camera.size[1] / 512) & own[vertex]
        rows, columns, vertex = rows[keep], columns[keep], vertex[keep]
        blurred = [ndimage.gaussian_filter(a.astype(np.float64), blur) for a in (hit, mask)]
        found = compare_pixels(blurred[0], blurred[1], (rows, columns), OUTLIER)
        g = np.einsum("ni,nij->nj", found.slope, pixel_rows(camera, posed[vertex])[1])
        rows = increment_rows(frame, self.surface.vertices[vertex], self.surface.skin.of(vertex), g, moving)
        equations.add(0, rows, found.residual, STRIDE * found.weight / (PIXEL**2 * (1 + blur**2)))
