"""Draws posed avatars: realises a plan on a context, then executes it frame by frame."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import moderngl
import numpy as np
from jaxtyping import Float, UInt8

from avatar.baked_avatar import Avatar
from avatar.camera import Camera, clip_from_view
from player.backdrop import Backdrop
from player.blit import Box, blit_of
from player.blocks import FRAME
from player.context import Context
from player.plan import MIN_HEIGHT, Canvas, Pass, Plan, resolve
from player.posing import PosedBones, Poser, Reach, dual_parts, quaternions, reach
from player.raster import clip_planes
from player.realise import UNITS, Realised
from player.scenes.effects import PLAIN, Background, Effects
from player.shader import uniform
from player.tiles import Patches, covered, rectangles

Pose = tuple[Float[np.ndarray, "52 3"], Float[np.ndarray, "3"]]  # axis-angle, pelvis joint in world

# pixels round an avatar that antialiasing can change
MARGIN = 2
BULGE = (
    # dual quaternions leave the hull of the bones' spheres: by less than half of what the bones disagree
    1.5
)


@dataclass
class Drawn:
    """What became of a pass in the last frame."""

    item: Pass
    runs: bool
    why: str

    @property
    def state(self) -> str:
        """runs, kept (its last result still holds), skipped (cannot show in this frame), or not asked for."""
        if not self.item.asked:
            return "not asked for"
        return "runs" if self.runs else "kept" if self.why.startswith("kept") else "skipped"


@dataclass
class Moment:
    """A frame that was drawn: what explaining it draws again."""

    framebuffer: moderngl.Framebuffer
    poses: list[Pose]
    camera: Camera
    flipped: bool
    seconds: float


class Renderer:
    """Draws avatars on one size of image. What is asked for is made here, once; drawing makes nothing.

    size None makes no image of its own: only `draw_into` a window works, and what depends on its size is made with
    its first frame. `effects` and `background` say what is asked for; level picks a level of detail (the coarsest
    if there are fewer); view_amount is u_view, 0 for the paper's colours. view is short for Effects(view=view), an
    RGBA tuple (premultiplied, [0,1]) for a Background of one colour.

    Raises:
        ValueError: the view mode is not in an avatar, a texture or the image exceeds the device.
        AssetError: the background's file cannot be read.
    """

    def __init__(
        self,
        context: Context,
        avatars: Sequence[Avatar],
        size: tuple[int, int] | None,
        *,
        effects: Effects = PLAIN,
        background: Background | Sequence[float | int] = (0.0, 0.0, 0.0, 0.0),
        level: int = 0,
        view_amount: float = 1.0,
        view: str | None = None,
    ):
        self.context, self.avatars = context, tuple(avatars)
        self.level, self.view_amount = level, view_amount
        self.effects = effects if view is None else replace(effects, view=view)
        self.background = _as_background(background)
        self.size, self.own_image = size, size is not None
        context.make_current()
        self.backdrop = Backdrop(self.background)
        self.made = Realised(context, self.avatars, level)
        self.blit = blit_of(context)
        self.posers: list[Poser] = []
        self.patches: list[Patches] | None = None
        self.drawn: list[Drawn] = []
        self.last: Moment | None = None
        self._become()
        self._measure()

    @property
    def plan(self) -> Plan:
        return self.made.plan

    @property
    def target(self) -> moderngl.Framebuffer | None:
        """The renderer's own image; None when it draws into a window."""
        return self.made.framebuffers.get("image") if self.own_image else None

    @property
    def transparent(self) -> bool:
        """Whether pictures may have pixels that are not opaque."""
        return self.backdrop.transparent

    @property
    def has_view(self) -> bool:
        """Whether any avatar is drawn with view dependence."""
        return any(item.kind == "view" and item.asked for item in self.plan.passes)

    def change(
        self,
        *,
        size: tuple[int, int] | None = None,
        effects: Effects | None = None,
        background: Background | Sequence[float | int] | None = None,
        level: int | None = None,
    ) -> None:
        """Another size, other effects, another background or level of detail. Only what is new is made or compiled;
        what is no longer asked for is freed.

        Raises:
            ValueError, AssetError: as when it was made; the renderer then stays as it was.
        """
        before = self.size, self.effects, self.background, self.backdrop, self.level
        if background is not None and _as_background(background) != self.background:
            self.backdrop = Backdrop(_as_background(background))
            self.background = self.backdrop.background
        self.size = size or self.size
        self.effects = effects or self.effects
        self.level = self.made.level = self.level if level is None else level
        try:
            self._become()
        except ValueError:
            self.size, self.effects, self.background, self.backdrop, self.level = before
            self.made.level = self.level
            raise
        if self.level != before[4]:
            self._measure()
        if self.backdrop is not before[3]:
            before[3].close()

    def resize(self, size: tuple[int, int]) -> None:
        """Another number of pixels: images are made anew, programs and meshes stay."""
        if size != self.size:
            self.change(size=size)

    def draw(
        self,
        poses: Sequence[Pose],
        camera: Camera,
        out: UInt8[np.ndarray, "height width 4"] | None = None,
        *,
        seconds: float = 0.0,
    ) -> UInt8[np.ndarray, "height width 4"]:
        """The image, row 0 on top, premultiplied alpha, sRGB. One pose per avatar; the camera is fitted to size.

        `out` is an array to read into, so that a film needs no new memory for each frame; `seconds` is the time in
        a background that moves.

        Raises:
            ValueError: not one pose per avatar, or a pose with a number that is not finite.
        """
        target = self.target
        assert target is not None, "made without an image: use draw_into"
        self.context.make_current()
        width, height = target.size
        if camera.size != (width, height):
            camera = camera.resized((width, height))
        self._frame(Moment(target, list(poses), camera, True, seconds))
        image = np.empty((height, width, 4), np.uint8) if out is None else out
        target.read_into(image, components=4)
        return image

    def draw_into(
        self,
        framebuffer: moderngl.Framebuffer,
        poses: Sequence[Pose],
        camera: Camera,
        *,
        seconds: float = 0.0,
    ) -> None:
        """The same into another framebuffer, whose rows count from the bottom; nothing is read back. The renderer's
        own image keeps its top row first, as `draw` has it.

        A window (which has no size of its own that GL knows) is drawn on the camera's pixels. When its size
        changes, what depends on it is made anew, as by `resize`.
        """
        self.context.make_current()
        if framebuffer.glo != 0 and camera.size != framebuffer.size:
            camera = camera.resized(framebuffer.size)
        if not self.own_image:
            self.resize(camera.size)
        elif self.size != camera.size and (self.backdrop.sized or self.effects.antialiasing != "none"):
            raise ValueError(f"made for {self.size} pixels, drawn into {camera.size}: call resize")
        self._frame(Moment(framebuffer, list(poses), camera, framebuffer is self.target, seconds))

    def explain(self, repeats: int = 5) -> list[dict[str, Any]]:
        """Every pass: whether it ran in the last frame, why, what it costs in ms (median), its bytes.

        A pass that did not run costs nothing and says 0. Times of avatars include their share of posing; all end
        when the device is done; no readback.
        """
        if self.last is None:
            raise ValueError("nothing was drawn yet: there is no frame to explain")
        out = []
        for drawn in list(self.drawn):
            times = []
            for _ in range(repeats if drawn.runs else 0):
                if drawn.item.kind == "antialiasing":
                    # it filters a whole picture
                    self._frame(self.last)
                self.context.gl.finish()
                start = time.perf_counter()
                self._frame(self.last, only=drawn.item)
                self.context.gl.finish()
                times.append(1e3 * (time.perf_counter() - start))
            out.append(
                {
                    "name": drawn.item.name,
                    "runs": drawn.runs,
                    "state": drawn.state,
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
        self.made.release()
        self.backdrop.close()

    # -- one frame

    def _frame(self, moment: Moment, *, only: Pass | None = None) -> None:
        """Execute the plan, or one pass of it (explain)."""
        poses, camera = moment.poses, moment.camera
        if len(poses) != len(self.avatars):
            raise ValueError(f"{len(self.avatars)} avatars need as many poses, found {len(poses)}")
        bones = [poser.posed(*pose, camera) for poser, pose in zip(self.posers, poses, strict=True)]
        reaches = [reach(self._bulging(one), camera) for one in bones]
        shown = [r.shows(camera) for r in reaches]
        tall = [bool(r.box[3] - r.box[1] >= MIN_HEIGHT) for r in reaches]
        planes = clip_planes(np.array([r.depth for r, seen in zip(reaches, shown, strict=True) if seen]).ravel())
        # that one filters what is there
        if only is None or only.kind != "antialiasing":
            moment.framebuffer.viewport = (0, 0, *camera.size)
            moment.framebuffer.use()
            moment.framebuffer.clear(color=self.background.color)
        drawn: list[Drawn] = []
        posed: set[int] = set()
        for item in self.plan.passes:
            runs, why = self._decision(item, moment, shown, tall)
            drawn.append(Drawn(item, runs, why))
            if (only is None and not runs) or (only is not None and item is not only):
                continue
            if item.kind == "background":
                self._draw_background(item, moment)
            elif item.kind == "antialiasing":
                self._antialias(item, moment, bones, reaches, shown)
            else:
                if not posed:
                    assert planes is not None
                    self._begin_avatars(moment, planes, reaches, shown)
                if item.avatar not in posed:
                    self._write_bones(item.avatar, bones[item.avatar], self._viewed(item.avatar, tall))
                    posed.add(item.avatar)
                self._bind_textures(item)
                self.made.arrays[item.name].render()
        self.drawn, self.last = drawn, moment

    def _bulging(self, bones: PosedBones) -> PosedBones:
        """The bones with spheres that hold what they move, in the skinning asked for."""
        if self.effects.skinning == "lbs":
            return bones
        # -1, a bone that moves nothing, stays negative
        return bones._replace(radii=BULGE * bones.radii)

    def _decision(self, item: Pass, moment: Moment, shown: list[bool], tall: list[bool]) -> tuple[bool, str]:
        """Whether a pass runs in this frame, and why or why not."""
        if not item.asked:
            return False, item.why
        if item.kind == "background":
            if item.name == "background":
                return True, item.why
            content = self.backdrop.content(self.made, moment.camera, moment.seconds)
            still = "the camera has not turned" if self.background.kind == "hdr" else "the same frame"
            return (False, f"kept: {still}") if self.backdrop.fresh(content) else (True, item.why)
        if item.kind == "antialiasing":
            return (True, item.why) if any(shown) else (False, "no avatar in view")
        if not shown[item.avatar]:
            return False, "out of view"
        if item.kind == "view":
            small = f"the avatar is less than {MIN_HEIGHT} pixels tall"
            return (True, item.why) if tall[item.avatar] else (False, small)
        if self._viewed(item.avatar, tall):
            return False, "the view pass draws this avatar"
        return True, item.why

    def _viewed(self, avatar: int, tall: list[bool]) -> bool:
        return f"{self.made.tag(avatar)} view vertices" in self.made.buffers and tall[avatar]

    def _draw_background(self, item: Pass, moment: Moment) -> None:
        """Bring its texture up to date, or copy it into the picture."""
        here = self.made, moment.camera, moment.seconds
        if item.name != "background" or not self.backdrop.fresh(self.backdrop.content(*here)):
            self.backdrop.fill(*here)
        if item.name == "background":
            width, height = moment.camera.size
            turned = None if moment.flipped else height
            background = self.made.framebuffers["background"]
            self.blit(background, moment.framebuffer, (0, 0, width, height), turned=turned)
        moment.framebuffer.use()

    def _begin_avatars(
        self, moment: Moment, planes: tuple[float, float], reaches: list[Reach], shown: list[bool]
    ) -> None:
        """What all avatars share. With antialiasing they are drawn on an image of their own: with MSAA over the same
        background, for FXAA over nothing, so that it smooths avatars and leaves the background alone."""
        samples, layer = self.made.framebuffers.get("samples"), self.made.framebuffers.get("layer")
        on = samples or layer
        if on is not None:
            on.viewport = (0, 0, *moment.camera.size)
            on.use()
            on.clear(color=self.background.color if samples else (0.0, 0.0, 0.0, 0.0))
        if samples is not None and self.backdrop.sized:
            self.blit(self.made.framebuffers["background"], samples, _box(reaches, shown, moment.camera))
            samples.use()
        self.context.gl.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        # a pixel's samples lie differently upside down: for a window the finished picture is turned instead
        self._write_frame(moment.camera, planes, moment.flipped or samples is not None)

    def _antialias(
        self, item: Pass, moment: Moment, bones: list[PosedBones], reaches: list[Reach], shown: list[bool]
    ) -> None:
        made, target = self.made, moment.framebuffer
        # MSAA: the mean of the samples, where avatars are
        if item.variant is None:
            image, box = made.framebuffers["image"], _box(reaches, shown, moment.camera)
            self.blit(made.framebuffers["samples"], image, box)
            # a window may have another format, which only a plain copy allows
            if target is not image:
                self.blit(image, target, box, turned=None if moment.flipped else moment.camera.size[1])
            target.use()
            return
        if self.patches is None:
            self.patches = [Patches(self.made.level_of(avatar)) for avatar in self.avatars]
        dual = self.effects.skinning == "dual_quaternion"
        boxes = [
            patches.boxes(one.view_from_canonical, moment.camera, dual=dual)
            for patches, one, seen in zip(self.patches, bones, shown, strict=True)
            if seen
        ]
        size = moment.camera.size
        tiles = rectangles(covered(np.concatenate(boxes), size, MARGIN), size, flipped=moment.flipped)
        target.use()
        if len(tiles):
            gl = self.context.gl
            gl.enable_only(moderngl.BLEND)
            gl.blend_func = (moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA)
            made.buffers["fxaa tiles"].write(np.ascontiguousarray(tiles))
            made.textures["layer color"].use(UNITS["picture"])
            made.textures["layer depth"].use(UNITS["depth"])
            made.arrays[item.name].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=len(tiles))

    def _write_frame(self, camera: Camera, planes: tuple[float, float], flipped: bool) -> None:
        clip = clip_from_view(camera, *planes)
        # row 0 of the image is the top: draw upside down instead of turning every image round
        if flipped:
            clip[1] = -clip[1]
        self.context.gl.front_face = "cw" if flipped else "ccw"
        frame = np.zeros((), FRAME)
        frame["clip_from_view"] = clip.T
        frame["view_amount"] = self.view_amount
        self.made.buffers["frame"].write(frame.tobytes())
        self.made.buffers["frame"].bind_to_uniform_block(0)

    def _write_bones(self, avatar: int, bones: PosedBones, viewed: bool) -> None:
        tag, buffers = self.made.tag(avatar), self.made.buffers
        dual = self.effects.skinning == "dual_quaternion"
        if dual or viewed:
            turns = quaternions(bones)
            buffers[f"{tag} turns"].write(np.ascontiguousarray(turns, np.float32))
            buffers[f"{tag} turns"].bind_to_uniform_block(2)
            if dual:
                buffers[f"{tag} duals"].write(dual_parts(bones, turns).astype(np.float32))
                buffers[f"{tag} duals"].bind_to_uniform_block(3)
        if not dual:
            palette = np.ascontiguousarray(bones.view_from_canonical[:, :3], np.float32)
            buffers[f"{tag} bones"].write(palette)
            buffers[f"{tag} bones"].bind_to_uniform_block(1)

    def _bind_textures(self, item: Pass) -> None:
        tag, textures = self.made.tag(item.avatar), self.made.textures
        textures[f"{tag} base color"].use(UNITS["base_color"])
        if item.kind == "view":
            textures[f"{tag} features"].use(UNITS["features"])
            if f"{tag} more features" in textures:
                textures[f"{tag} more features"].use(UNITS["more_features"])

    # -- when the plan changes

    def _become(self) -> None:
        info = self.context.gl.info
        largest = max(*(self.size or (1, 1)), *(max(self.made.level_of(a).base_color.shape) for a in self.avatars))
        if largest > info["GL_MAX_TEXTURE_SIZE"]:
            raise ValueError(
                f"{largest} pixels across; {self.context.renderer} holds at most {info['GL_MAX_TEXTURE_SIZE']}"
            )
        canvas = Canvas(self.size, self.own_image, self.context.software, self.context.gl.max_samples,
                      self.backdrop.panorama_size)  # fmt: skip
        plan = resolve(self.avatars, canvas, self.effects, self.background, self.level)
        self.context.make_current()
        new = self.made.become(plan, self.backdrop.panorama)
        if plan.resources.get("panorama") is not None:
            self.backdrop.panorama = None  # the texture holds it
        for item in new:
            if item.kind == "antialiasing":
                assert item.variant is not None and self.size is not None
                uniform(self.made.programs[item.variant], "image_size").value = self.size
            self._warm(item)

    def _measure(self) -> None:
        """Bounds of each avatar's surface at its level of detail."""
        self.posers = [Poser(avatar, self.made.level_of(avatar)) for avatar in self.avatars]
        self.patches = None

    def _warm(self, item: Pass) -> None:
        """Draw one triangle with the real state: drivers compile at the first draw, some 90 ms in software."""
        made, gl = self.made, self.context.gl
        images = made.framebuffers
        on = images.get("samples") or images.get("layer") or images.get("image")
        if item.kind == "background":
            on = images["background"]
        elif item.kind == "antialiasing":
            on = images.get("image")
        if on is not None:
            on.use()
        elif self.context.kind == "window":
            self.context.leave_framebuffer()
        else:
            return  # nothing to draw on before the first frame
        if item.kind in ("avatar", "view"):
            gl.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
            self._write_frame(_ANY_CAMERA, (1.0, 2.0), flipped=True)
            for name, binding in (("bones", 1), ("turns", 2), ("duals", 3)):
                buffer = made.buffers.get(f"{made.tag(item.avatar)} {name}")
                if buffer is not None:
                    buffer.write(bytes(buffer.size))
                    buffer.bind_to_uniform_block(binding)
            self._bind_textures(item)
            made.arrays[item.name].render(vertices=3)
            return
        gl.enable_only(moderngl.BLEND if item.kind == "antialiasing" else moderngl.NOTHING)
        if item.kind == "background":
            made.textures["panorama"].use(UNITS["panorama"])
            made.arrays[item.name].render(vertices=3)
        else:
            made.buffers["frame"].bind_to_uniform_block(0)
            made.buffers["fxaa tiles"].write(np.array([0, 0, 1, 1], np.uint16))
            made.textures["layer color"].use(UNITS["picture"])
            made.textures["layer depth"].use(UNITS["depth"])
            made.arrays[item.name].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=1)


def _as_background(background: Background | Sequence[float | int]) -> Background:
    if isinstance(background, Background):
        return background
    red, green, blue, alpha = background
    return Background("color", (float(red), float(green), float(blue), float(alpha)))


def _box(reaches: Sequence[Reach], shown: Sequence[bool], camera: Camera) -> Box:
    """The box that holds all avatars in view, rows from the top."""
    boxes = np.array([r.box for r, seen in zip(reaches, shown, strict=True) if seen])
    left, top = np.clip(boxes[:, :2].min(0) - MARGIN, 0, camera.size).astype(int).tolist()
    right, bottom = np.ceil(np.clip(boxes[:, 2:].max(0) + MARGIN, 0, camera.size)).astype(int).tolist()
    return left, top, right, bottom


_ANY_CAMERA = Camera(np.eye(3), np.eye(4), (1, 1))
