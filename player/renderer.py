"""Draws posed avatars: realises a plan on a context, then executes it frame by frame."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import moderngl
import numpy as np
from jaxtyping import Float, UInt8

from avatar.baked_avatar import Avatar, Level
from avatar.camera import Camera, clip_from_view
from player.blocks import BONES, FRAME, TURNS, bind_block
from player.constants import avatar_constants
from player.context import Context
from player.effects import PLAIN, Background, Effects
from player.mesh import draw_order, interleaved, view_interleaved
from player.plan import MIN_HEIGHT, Pass, Plan, Variant, mip_levels, resolve
from player.posing import PosedBones, Poser, quaternions, reach
from player.raster import clip_planes
from player.shader import compile_program, uniform

Pose = tuple[Float[np.ndarray, "52 3"], Float[np.ndarray, "3"]]  # axis-angle, pelvis joint in world

BASE = ("3f4 2f4 4u1 4f1", "position", "uv", "joints", "weights")
VIEW = ("3f4 3f4 3f4 1f4", "view_mean", "view_q0", "view_q1", "view_seen")
UNITS = {"base_color": 0, "features": 1, "more_features": 2}


@dataclass
class Drawn:
    """What became of a pass in the last frame."""

    item: Pass
    runs: bool
    why: str


class Renderer:
    """Draws avatars on one size of image. What is asked for is made here, once; drawing makes nothing.

    size None makes no image of its own: only `draw_into` a window works. view is "auto", "off", "vertex", "linear" or "network"; level picks a level of detail (the coarsest if there
    are fewer); background is premultiplied RGBA in [0,1]; view_amount is u_view, 0 for the paper's colours.

    Raises:
        ValueError: the view mode is unknown or not in an avatar, a texture or the image exceeds the device.
    """

    def __init__(
        self,
        context: Context,
        avatars: Sequence[Avatar],
        size: tuple[int, int] | None,
        *,
        effects: Effects = PLAIN,
        background: Background | Sequence[float] = (0.0, 0.0, 0.0, 0.0),
        level: int = 0,
        view_amount: float = 1.0,
        view: str | None = None,
    ):
        self.context, self.avatars = context, tuple(avatars)
        effects = effects if view is None else replace(effects, view=view)
        background = background.color if isinstance(background, Background) else background
        self.effects, view = effects, effects.view
        self.view, self.level, self.view_amount = view, level, view_amount
        red, green, blue, alpha = background
        self.background = (float(red), float(green), float(blue), float(alpha))
        self.plan: Plan = resolve(self.avatars, size, view, context.software, level)
        limit = context.gl.info["GL_MAX_TEXTURE_SIZE"]
        largest = max(*(size or (1, 1)), *(max(self._level(a).base_color.shape) for a in self.avatars))
        if largest > limit:
            raise ValueError(f"{largest} pixels across; {context.renderer} holds at most {limit}")
        context.make_current()
        self.buffers: dict[str, moderngl.Buffer] = {}
        self.textures: dict[str, moderngl.Texture] = {}
        self.programs: dict[Variant, moderngl.Program] = {}
        self.arrays: dict[str, moderngl.VertexArray] = {}
        self.posers = [Poser(avatar, self._level(avatar)) for avatar in self.avatars]
        self.target = self._new_target(size) if size else None
        self._realise()
        self.drawn: list[Drawn] = []
        self.last: tuple[moderngl.Framebuffer, list[Pose], Camera, bool] | None = None

    def draw(
        self,
        poses: Sequence[Pose],
        camera: Camera,
        out: UInt8[np.ndarray, "height width 4"] | None = None,
    ) -> UInt8[np.ndarray, "height width 4"]:
        """The image, row 0 on top, premultiplied alpha, sRGB. One pose per avatar; the camera is fitted to size.

        `out` is an array to read into, so that a film needs no new memory for each frame.

        Raises:
            ValueError: not one pose per avatar, or a pose with a number that is not finite.
        """
        assert self.target is not None, "made without an image: use draw_into"
        self.context.make_current()
        width, height = self.target.size
        if camera.size != (width, height):
            camera = camera.resized((width, height))
        self._frame(self.target, poses, camera, flipped=True)
        image = np.empty((height, width, 4), np.uint8) if out is None else out
        self.target.read_into(image, components=4)
        return image

    def draw_into(self, framebuffer: moderngl.Framebuffer, poses: Sequence[Pose], camera: Camera) -> None:
        """The same into another framebuffer, whose rows count from the bottom; nothing is read back.

        A window (which has no size of its own that GL knows) is drawn on the camera's pixels.
        """
        self.context.make_current()
        if framebuffer.glo != 0 and camera.size != framebuffer.size:
            camera = camera.resized(framebuffer.size)
        self._frame(framebuffer, poses, camera, flipped=False)

    def explain(self, repeats: int = 5) -> list[dict[str, Any]]:
        """Every pass of the plan: whether it ran in the last frame, why, what it costs in ms (median), its bytes.

        A pass that did not run costs nothing and says 0. Times include its share of posing and end when the
        device is done; no readback.
        """
        if self.last is None:
            raise ValueError("nothing was drawn yet: there is no frame to explain")
        framebuffer, poses, camera, flipped = self.last
        out = []
        for drawn in list(self.drawn):
            times = []
            for _ in range(repeats if drawn.runs else 0):
                self.context.gl.finish()
                start = time.perf_counter()
                self._frame(framebuffer, poses, camera, flipped=flipped, only=drawn.item)
                self.context.gl.finish()
                times.append(1e3 * (time.perf_counter() - start))
            out.append(
                {
                    "name": drawn.item.name,
                    "runs": drawn.runs,
                    "why": drawn.why,
                    "ms": round(float(np.median(times)), 3) if times else 0.0,
                    "bytes": self.plan.bytes(drawn.item),
                }
            )
        return out

    def release(self) -> None:
        """Free everything this renderer made."""
        self.context.make_current()
        self.context.leave_framebuffer()
        things = [
            *self.arrays.values(),
            *self.programs.values(),
            *self.buffers.values(),
            *self.textures.values(),
        ]
        for thing in things:
            thing.release()
        self.arrays, self.programs, self.buffers, self.textures = {}, {}, {}, {}
        if self.target is not None:
            attachments = [*self.target.color_attachments, self.target.depth_attachment]
            self.target.release()  # leaves its attachments alive
            for attachment in attachments:
                attachment.release()
            self.target = None

    # -- one frame

    def _frame(
        self,
        framebuffer: moderngl.Framebuffer,
        poses: Sequence[Pose],
        camera: Camera,
        *,
        flipped: bool,
        only: Pass | None = None,
    ) -> None:
        if len(poses) != len(self.avatars):
            raise ValueError(f"{len(self.avatars)} avatars need as many poses, found {len(poses)}")
        width, height = camera.size
        bones = [poser.posed(*pose, camera) for poser, pose in zip(self.posers, poses, strict=True)]
        reaches = [reach(one, camera) for one in bones]
        shown = [r.shows(camera) for r in reaches]
        planes = clip_planes(
            np.array([r.depth for r, seen in zip(reaches, shown, strict=True) if seen]).ravel()
        )

        gl = self.context.gl
        framebuffer.viewport = (0, 0, width, height)
        framebuffer.use()
        framebuffer.clear(color=self.background)
        gl.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        if planes is not None:
            self._write_frame(camera, planes, flipped)
        tall = [bool(r.box[3] - r.box[1] >= MIN_HEIGHT) for r in reaches]
        posed: set[int] = set()
        drawn = []
        for item in self.plan.passes:
            runs, why = self._decision(item, shown, tall)
            drawn.append(Drawn(item, runs, why))
            if runs and (only is None or item is only):
                if item.avatar not in posed:
                    self._write_bones(item.avatar, bones[item.avatar], self._viewed(item.avatar, tall))
                    posed.add(item.avatar)
                self._bind_textures(item.avatar, item.variant)
                self.arrays[item.name].render()
        self.drawn, self.last = drawn, (framebuffer, list(poses), camera, flipped)

    def _viewed(self, avatar: int, tall: list[bool]) -> bool:
        return f"{self._tag(avatar)} turns" in self.buffers and bool(tall[avatar])

    def _decision(self, item: Pass, shown: list[bool], tall: list[bool]) -> tuple[bool, str]:
        if item.variant is None:
            return False, item.why
        if not shown[item.avatar]:
            return False, "out of view"
        is_view = dict(item.variant.defines)["VIEW_STAGE"] != 0
        if is_view:
            small = f"the avatar is less than {MIN_HEIGHT} pixels tall"
            return (True, item.why) if tall[item.avatar] else (False, small)
        if self._viewed(item.avatar, tall):
            return False, "the view pass draws this avatar"
        return True, item.why

    def _write_frame(self, camera: Camera, planes: tuple[float, float], flipped: bool) -> None:
        clip = clip_from_view(camera, *planes)
        if flipped:  # row 0 of the image is the top: draw upside down instead of turning every image round
            clip[1] = -clip[1]
        self.context.gl.front_face = "cw" if flipped else "ccw"
        frame = np.zeros((), FRAME)
        frame["clip_from_view"] = clip.T
        frame["view_amount"] = self.view_amount
        self.buffers["frame"].write(frame.tobytes())
        self.buffers["frame"].bind_to_uniform_block(0)

    def _write_bones(self, avatar: int, bones: PosedBones, viewed: bool) -> None:
        tag = self._tag(avatar)
        palette = np.ascontiguousarray(bones.view_from_canonical[:, :3], np.float32)
        self.buffers[f"{tag} bones"].write(palette)
        self.buffers[f"{tag} bones"].bind_to_uniform_block(1)
        if viewed:
            self.buffers[f"{tag} turns"].write(np.ascontiguousarray(quaternions(bones), np.float32))
            self.buffers[f"{tag} turns"].bind_to_uniform_block(2)

    def _bind_textures(self, avatar: int, variant: Variant | None) -> None:
        tag = self._tag(avatar)
        self.textures[f"{tag} base color"].use(UNITS["base_color"])
        if variant is not None and variant.avatar is not None:
            self.textures[f"{tag} features"].use(UNITS["features"])
            if f"{tag} more features" in self.textures:
                self.textures[f"{tag} more features"].use(UNITS["more_features"])

    # -- making what the plan holds

    def _realise(self) -> None:
        gl = self.context.gl
        self.buffers["frame"] = gl.buffer(reserve=FRAME.itemsize, dynamic=True)
        for index, avatar in enumerate(self.avatars):
            tag, level = self._tag(index), self._level(avatar)
            order, faces = draw_order(level.positions, level.faces)
            self.buffers[f"{tag} vertices"] = gl.buffer(interleaved(level)[order].tobytes())
            self.buffers[f"{tag} faces"] = gl.buffer(faces.tobytes())
            self.buffers[f"{tag} bones"] = gl.buffer(reserve=BONES.itemsize, dynamic=True)
            self.textures[f"{tag} base color"] = self._texture(level.base_color)
            if f"{tag} turns" in self.plan.resources:
                assert level.features is not None
                self.buffers[f"{tag} view vertices"] = gl.buffer(view_interleaved(level)[order].tobytes())
                self.buffers[f"{tag} turns"] = gl.buffer(reserve=TURNS.itemsize, dynamic=True)
                self.textures[f"{tag} features"] = self._texture(level.features[..., :4])
                if f"{tag} more features" in self.plan.resources:
                    self.textures[f"{tag} more features"] = self._texture(level.features[..., 4:])
        for variant in self.plan.variants:
            self.programs[variant] = self._program(variant)
        for item in self.plan.passes:
            if item.variant is not None:
                self.arrays[item.name] = self._vertex_array(item, item.variant)
                self._warm(item)

    def _program(self, variant: Variant) -> moderngl.Program:
        generated = avatar_constants(self.avatars[variant.avatar]) if variant.avatar is not None else {}
        defines = dict(variant.defines)
        program = compile_program(self.context.gl, variant.vertex, variant.fragment, defines, generated)
        for block in ("Frame", "Bones", "Turns"):
            bind_block(program, block)
        for sampler, unit in UNITS.items():
            if sampler in program:
                uniform(program, sampler).value = unit
        return program

    def _vertex_array(self, item: Pass, variant: Variant) -> moderngl.VertexArray:
        tag, program = self._tag(item.avatar), self.programs[variant]
        content: list[tuple[object, ...]] = [(self.buffers[f"{tag} vertices"], *BASE)]
        if f"{tag} view vertices" in item.reads:
            content.append((self.buffers[f"{tag} view vertices"], *VIEW))
        return self.context.gl.vertex_array(program, content, self.buffers[f"{tag} faces"])

    def _warm(self, item: Pass) -> None:
        """Draw one triangle with the real state: drivers compile at the first draw, some 90 ms in software."""
        if self.target is not None:
            self.target.use()
        else:
            self.context.leave_framebuffer()
        self.context.gl.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self._write_frame(_ANY_CAMERA, (1.0, 2.0), flipped=True)
        tag = self._tag(item.avatar)
        for name, binding in ((f"{tag} bones", 1), (f"{tag} turns", 2)):
            if name in self.buffers:
                self.buffers[name].write(bytes(self.buffers[name].size))
                self.buffers[name].bind_to_uniform_block(binding)
        self._bind_textures(item.avatar, item.variant)
        self.arrays[item.name].render(vertices=3)

    def _texture(self, image: UInt8[np.ndarray, "height width channels"]) -> moderngl.Texture:
        gl = self.context.gl
        height, width, channels = image.shape
        if channels == 3:  # three bytes a texel are slow to fetch everywhere
            image = np.dstack([image, np.full((height, width), 255, np.uint8)])
        texture = gl.texture((width, height), 4, np.ascontiguousarray(image).tobytes())
        texture.build_mipmaps(0, mip_levels(image.shape) - 1)
        # nearest mip on software: trilinear fetches cost 1.3-2.5 times as much there (notes: 9-27 against 7-11 ns)
        minify = moderngl.LINEAR_MIPMAP_NEAREST if self.context.software else moderngl.LINEAR_MIPMAP_LINEAR
        texture.filter = (minify, moderngl.LINEAR)
        if not self.context.software:
            texture.anisotropy = 8.0
        return texture

    def _new_target(self, size: tuple[int, int]) -> moderngl.Framebuffer:
        gl = self.context.gl
        return gl.framebuffer([gl.renderbuffer(size, 4)], gl.depth_renderbuffer(size))

    def _tag(self, avatar: int) -> str:
        return f"avatar {avatar}" if len(self.avatars) > 1 else "avatar"

    def _level(self, avatar: Avatar) -> Level:
        return avatar.levels[min(self.level, len(avatar.levels) - 1)]


_ANY_CAMERA = Camera(np.eye(3), np.eye(4), (1, 1))
