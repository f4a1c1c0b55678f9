"""One avatar drawn in given poses, without a window: a pose array in, an RGB array out."""

from types import TracebackType

import numpy as np
from jaxtyping import Float, UInt8

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from avatar.face import FaceFrame
from avatar.motion.clip import Clip
from player.draw.drawing import Pose
from player.gl.context import open_context
from player.scene.effects import STUDIO, USUAL, Background, Effects
from player.scene.framing import extent, facing, fitted_camera
from player.scene.renderer import Renderer


class OffscreenRenderer:
    """Draws one avatar on an OpenGL context of its own; needs neither GPU nor display.

        with OffscreenRenderer(avatar, size=(640, 640)) as renderer:
            rgb = renderer.draw(axis_angle, root)

    camera: any `avatar.Camera`; without one, the avatar is seen from the front, fitted to the first pose that is drawn.
    effects, background: as scenes have them; what is not asked for is not made.

    Raises:
        AssetError: no OpenGL context can be had (`selfscan doctor` says what is missing), or the background's file
            cannot be read.
        ValueError: the avatar's file does not hold the view mode asked for, or the image is too large for the device.
    """

    def __init__(
        self, avatar: Avatar, size: tuple[int, int] = (640, 640), *, camera: Camera | None = None,
        effects: Effects = USUAL, background: Background = STUDIO, level: int = 0, context: str = "auto",
    ):  # fmt: skip
        self.avatar, self.size, self.camera = avatar, size, camera
        self._context = open_context(context, None)
        try:
            self._renderer = Renderer(
                self._context, [avatar], size, effects=effects, background=background, level=level
            )
        except BaseException:
            self._context.release()
            raise

    def draw(
        self, axis_angle: Float[np.ndarray, "52 3"], root: Float[np.ndarray, "3"], camera: Camera | None = None,
        face: FaceFrame | None = None,
    ) -> UInt8[np.ndarray, "height width 3"]:  # fmt: skip
        """The picture of one pose, sRGB, row 0 on top.

        axis_angle: SMPL+H, radians; root: the pelvis joint in the world, metres. camera: for this picture only.
        face: what the avatar's face does, where its file has one; None: it rests.

        Raises:
            ValueError: a pose of another shape, or with a number that is not finite.
        """
        return self.draw_rgba(axis_angle, root, camera, face)[..., :3].copy()

    def draw_rgba(
        self, axis_angle: Float[np.ndarray, "52 3"], root: Float[np.ndarray, "3"], camera: Camera | None = None,
        face: FaceFrame | None = None,
    ) -> UInt8[np.ndarray, "height width 4"]:  # fmt: skip
        """As `draw`, with premultiplied alpha: for a transparent background."""
        axis_angle, root = np.asarray(axis_angle, np.float64), np.asarray(root, np.float64)
        if axis_angle.shape != (52, 3) or root.shape != (3,):
            raise ValueError(f"a pose is (52, 3) and a root (3,), found {axis_angle.shape} and {root.shape}")
        if camera is None:
            if self.camera is None:
                self.camera = self.front_camera(axis_angle, root)
            camera = self.camera
        return self._renderer.draw([Pose(axis_angle, root, face)], camera)

    def front_camera(self, axis_angle: Float[np.ndarray, "52 3"], root: Float[np.ndarray, "3"]) -> Camera:
        """The camera in front of the avatar in this pose, as near as it may be."""
        points = extent(self.avatar, Clip(axis_angle[None], root[None], 1.0))
        return fitted_camera(points, facing(axis_angle, self.avatar.joint_positions.astype(np.float64)), self.size)

    def release(self) -> None:
        """Free everything; again does nothing."""
        self._renderer.release()
        self._context.release()

    def __enter__(self) -> "OffscreenRenderer":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()
