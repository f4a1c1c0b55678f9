"""One frame while it is drawn: what passes decide by, and what they share."""

from collections.abc import Callable, Hashable
from ctypes import c_int, c_uint
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

import moderngl
import numpy as np
from jaxtyping import Float

from avatar.camera import Camera, clip_from_view
from avatar.face import FaceFrame
from player.draw.posing import PosedBones, ScreenBounds
from player.draw.resources import Handle, Image, PlanResources
from player.gl.blocks import BINDING, FRAME

T = TypeVar("T")
# metres a second of the root, and radians from one frame to the next: beyond them a motion jumps
FASTEST, TURNED = 15.0, np.radians(60.0)
Box = tuple[int, int, int, int]  # left, first row, right, end row, in rows as GL counts them
READ_FRAMEBUFFER, DRAW_FRAMEBUFFER, COLOR_BUFFER_BIT, NEAREST = 0x8CA8, 0x8CA9, 0x4000, 0x2600


class Pose(NamedTuple):
    axis_angle: Float[np.ndarray, "52 3"]
    root: Float[np.ndarray, "3"]  # pelvis joint in world, metres
    # None: the face at rest
    face: FaceFrame | None = None


# axis-angle and root of a pose whose face rests
BarePose = tuple[Float[np.ndarray, "52 3"], Float[np.ndarray, "3"]]
GivenPose = Pose | BarePose


@dataclass(frozen=True)
class FrameInputs:
    framebuffer: moderngl.Framebuffer
    poses: tuple[Pose, ...]
    camera: Camera
    # row 0 of the framebuffer is the top
    flipped: bool
    seconds: float
    exposures: int = 1  # frames whose mean the picture is


class Look(NamedTuple):
    """What is the same in every frame, until the renderer is changed."""

    color: tuple[float, float, float, float]  # premultiplied sRGB, before anything is drawn
    # 0: the paper's colors, 1: with all of the view dependence
    view_amount: float
    margin: int  # pixels round an avatar that something can draw on
    # the background at the size of the picture; None: it is one color
    background: Handle[moderngl.Framebuffer] | None
    # the block of constants, shaders/frame.glsl
    frame: Handle[moderngl.Buffer]


@dataclass(frozen=True)
class Layer:
    """Where avatars are drawn, and what stands among them: straight into the picture, or on an image of its own."""

    image: Image | None = None
    # brings the image into its first state of a frame
    begin: Callable[["Drawing"], None] | None = None
    # row 0 is the top even where the picture's is not
    always_flipped: bool = False
    # it begins with what is behind the avatars, and covers the picture
    begins_with_picture: bool = False


@dataclass
class Drawing:
    """A frame being drawn: its inputs, where avatars are in it, and what was uploaded so far."""

    inputs: FrameInputs
    resources: PlanResources
    look: Look
    bones: list[PosedBones]
    bounds: list[ScreenBounds]
    visible: list[bool]
    planes: tuple[float, float] | None  # near and far, metres; None: no avatar is in view
    # how far each avatar's loose parts are from where they are skinned to, at most; metres
    reaches: list[float]
    _begun: bool = False
    _found: dict[Hashable, Any] = field(default_factory=dict)

    @property
    def gl(self) -> moderngl.Context:
        return self.resources.context.gl

    def blit(
        self, source: moderngl.Framebuffer, target: moderngl.Framebuffer, box: Box, *, turned: int | None = None
    ) -> None:
        """Copy the colors of a box, to the same place: the cheapest way to move pixels, on software and GPU alike.
        Several samples become one, one becomes several.

        turned: the height of the target, to put the copy there upside down (not with several samples). Neither
        framebuffer is in use afterwards: call `use` on the next one. (moderngl's own copy takes whole framebuffers with
        their depth, which fails into a window whose depth has another format.)
        """
        bind = self.resources.context.function("glBindFramebuffer", c_uint, c_uint)
        bind(READ_FRAMEBUFFER, source.glo)
        bind(DRAW_FRAMEBUFFER, target.glo)
        left, low, right, high = box
        rows = (low, high) if turned is None else (turned - low, turned - high)
        copy = self.resources.context.function("glBlitFramebuffer", *(c_int,) * 8, c_uint, c_uint)
        copy(*box, left, rows[0], right, rows[1], COLOR_BUFFER_BIT, NEAREST)

    def height(self, avatar: int) -> float:
        """Of what the avatar can reach, pixels."""
        _, top, _, bottom = self.bounds[avatar].box
        return float(bottom - top)

    def box(self) -> Box:
        """The box that holds all avatars in view and what is drawn round them, rows from the top."""
        size, margin = self.inputs.camera.size, self.look.margin
        boxes = np.array([bounds.box for bounds, seen in zip(self.bounds, self.visible, strict=True) if seen])
        left, top = np.clip(boxes[:, :2].min(0) - margin, 0, size).astype(int).tolist()
        right, bottom = np.ceil(np.clip(boxes[:, 2:].max(0) + margin, 0, size)).astype(int).tolist()
        return left, top, right, bottom

    def once(self, key: Hashable, find: Callable[[], T]) -> T:
        """What is found once a frame, by the first that asks for it by this key."""
        if key not in self._found:
            self._found[key] = find()
        return self._found[key]

    def bind(self, handle: Handle[moderngl.Buffer], block: str, content: Callable[[], bytes | np.ndarray]) -> None:
        """A uniform block with its content of this frame, written by the first pass that reads it."""
        buffer = self.resources[handle]
        self.once((block, handle), lambda: buffer.write(content()))
        buffer.bind_to_uniform_block(BINDING[block][1])

    def enter(self, layer: Layer) -> None:
        """Draw on the layer of avatars, with depth and culling, in this frame's projection."""
        if self._begun:
            return
        self._begun = True
        if layer.image is not None:
            framebuffer = self.resources[layer.image.framebuffer]
            framebuffer.viewport = (0, 0, *self.inputs.camera.size)
            framebuffer.use()
        if layer.begin is not None:
            layer.begin(self)
        self.gl.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        assert self.planes is not None, "an avatar is in view"
        flipped = self.inputs.flipped or layer.always_flipped
        write_frame(self.resources, self.look, self.inputs.camera, self.planes, flipped=flipped)


def write_frame(
    resources: PlanResources, look: Look, camera: Camera, planes: tuple[float, float], *, flipped: bool
) -> None:
    """The block of a frame's constants."""
    clip = clip_from_view(camera, *planes)
    # row 0 of the image is the top: draw upside down instead of turning every image round
    if flipped:
        clip[1] = -clip[1]
    resources.context.gl.front_face = "cw" if flipped else "ccw"
    frame = np.zeros((), FRAME)
    frame["clip_from_view"] = clip.T
    frame["view_amount"] = look.view_amount
    buffer = resources[look.frame]
    buffer.write(frame.tobytes())
    buffer.bind_to_uniform_block(BINDING["Frame"][1])


class Warming(NamedTuple):
    """A plan that was just applied, whose new programs draw once: drivers compile at the first draw."""

    resources: PlanResources
    look: Look
    # the picture; None: a window that is not there yet
    framebuffer: moderngl.Framebuffer | None

    def enter(self, layer: Layer) -> bool:
        """Draw on the layer, if there is anything to draw on."""
        target = self.framebuffer if layer.image is None else self.resources[layer.image.framebuffer]
        if target is None:
            return False
        target.use()
        self.resources.context.gl.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        write_frame(self.resources, self.look, _ANY_CAMERA, (1.0, 2.0), flipped=True)
        return True

    def enter_picture(self) -> bool:
        """Draw on the picture itself, blended and without depth, if it is there."""
        if self.framebuffer is None:
            return False
        self.framebuffer.use()
        self.resources.context.gl.enable_only(moderngl.BLEND)
        return True


_ANY_CAMERA = Camera(np.eye(3), np.eye(4), (1, 1))
