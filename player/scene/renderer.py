"""Draws posed avatars: makes the objects of a plan on a context, then executes its passes frame by frame."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import moderngl
import numpy as np
from jaxtyping import UInt8

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from command.errors import AssetError
from files.input_file import JsonObject
from player.draw.drawing import Drawing, FrameInputs, GivenPose, Look, Pose, Warming
from player.draw.face import moves_face
from player.draw.plan import Canvas, Decision, Kept, Pass, Plan, close_all
from player.draw.posing import PosedBones, Poser, ScreenBounds, screen_bounds
from player.draw.raster import clip_planes
from player.draw.resources import PlanResources
from player.effects.background import Background
from player.gl.context import Context
from player.scene.effects import PLAIN, Effects, resolve

MAX_PIXELS = 1 << 27  # pixels of one image, whose sides may be anything that the device can hold
# dual quaternions leave the hull of the bones' spheres: by less than half of what the bones disagree
BULGE = 1.5


class PassOutcome(NamedTuple):
    item: Pass
    decision: Decision


class Renderer:
    """Draws avatars on one size of image. What is asked for is made here, once; drawing makes nothing.

    size None makes no image of its own: only `draw_into` a window works, and what depends on its size is made with
    its first frame. `effects` and `background` say what is asked for; level picks a level of detail (the coarsest
    if there are fewer). view is short for Effects(view=view), an RGBA tuple (premultiplied, [0,1]) for a Background
    of one colour.

    Raises:
        ValueError: the view mode is not in an avatar, a texture or the image exceeds the device.
        AssetError: the background's file cannot be read.
    """

    def __init__(
        self, context: Context, avatars: Sequence[Avatar], size: tuple[int, int] | None, *, effects: Effects = PLAIN,
        background: Background | Sequence[float | int] = (0.0, 0.0, 0.0, 0.0), level: int = 0, view: str | None = None,
    ):  # fmt: skip
        self.context, self.avatars = context, tuple(avatars)
        self.level = level
        # share of the view dependence that is drawn: 0 is the paper, 1 all of it
        self.view_amount = 1.0
        self.effects = effects if view is None else replace(effects, view=view)
        self.background = _as_background(background)
        self.size, self.own_image = size, size is not None
        context.make_current()
        self.resources = PlanResources(context)
        self.drawn: list[PassOutcome] = []
        self.last: FrameInputs | None = None
        self.posers: list[Poser] = []
        # avatars whose face has moved: a face costs nothing before
        self.faces: frozenset[int] = frozenset()
        self.plan = self._resolved({})
        self._apply(self.plan)
        self._measure()

    @property
    def target(self) -> moderngl.Framebuffer | None:
        """The renderer's own image; None when it draws into a window."""
        return self.resources[self.plan.image.framebuffer] if self.own_image and self.plan.image is not None else None

    @property
    def detail(self) -> list[int]:
        """The number of each avatar's level of detail."""
        return [min(self.level, len(avatar.levels) - 1) for avatar in self.avatars]

    @property
    def views(self) -> list[str]:
        """The view mode of each avatar, as the plan resolved it."""
        return [self.plan.views.get(index, "off") for index in range(len(self.avatars))]

    @property
    def has_view(self) -> bool:
        """Whether any avatar is drawn with view dependence."""
        return bool(self.plan.views)

    def change(
        self, *, size: tuple[int, int] | None = None, effects: Effects | None = None,
        background: Background | Sequence[float | int] | None = None, level: int | None = None,
    ) -> None:  # fmt: skip
        """Another size, other effects, another background or level of detail. Only what is new is made or compiled;
        what is no longer asked for is freed.

        Raises:
            ValueError, AssetError: as when it was made; the renderer then stays as it was.
        """
        before = self.size, self.effects, self.background, self.level
        self.size = size or self.size
        self.effects = effects or self.effects
        self.background = self.background if background is None else _as_background(background)
        self.level = self.level if level is None else level
        try:
            plan = self._resolved(self.plan.kept)
        except (ValueError, AssetError):
            self.size, self.effects, self.background, self.level = before
            raise
        self._apply(plan)
        if self.level != before[3]:
            self._measure()

    def resize(self, size: tuple[int, int]) -> None:
        """Another number of pixels: images are made anew, programs and meshes stay."""
        if size != self.size:
            self.change(size=size)

    def move(self, poses: Sequence[GivenPose], seconds: float) -> None:
        """Let loose parts go on to these poses at a moment, where the scene asks for secondary motion: what is drawn
        from then on has them there. The first moment, one before the last and one long after it set them where they
        are skinned to.

        Raises:
            ValueError: not one pose per avatar, or a pose with a number that is not finite.
        """
        if not self.moves:
            return
        if len(poses) != len(self.avatars):
            raise ValueError(f"{len(self.avatars)} avatars need as many poses, found {len(poses)}")
        if not all(np.isfinite(part).all() for pose in poses for part in pose[:2]):
            raise ValueError("the pose holds a number that is not finite")
        for item in self.plan.passes:
            item.move(_poses(poses), seconds)

    @property
    def moves(self) -> bool:
        return bool(self.plan.moved)

    def draw(
        self, poses: Sequence[GivenPose], camera: Camera, out: UInt8[np.ndarray, "height width 4"] | None = None, *,
        seconds: float = 0.0,
    ) -> UInt8[np.ndarray, "height width 4"]:  # fmt: skip
        """The image, row 0 on top, premultiplied alpha, sRGB. One pose per avatar; the camera is fitted to size.

        `out` is an array to read into, so that a film needs no new memory for each frame; `seconds` is the time in
        a background that moves.

        Raises:
            ValueError: not one pose per avatar, or a pose with a number that is not finite.
        """
        return self.expose([(poses, camera)], out, seconds=seconds)

    def expose(
        self, views: Sequence[tuple[Sequence[GivenPose], Camera]],
        out: UInt8[np.ndarray, "height width 4"] | None = None, *, seconds: float = 0.0,
    ) -> UInt8[np.ndarray, "height width 4"]:  # fmt: skip
        """The mean of several frames, as a shutter and a lens make it (player/film/exposure.py); of one, the frame.

        Raises:
            ValueError: as `draw`.
        """
        target = self.target
        assert target is not None, "made without an image: use draw_into"
        self.context.make_current()
        width, height = target.size
        image = np.empty((height, width, 4), np.uint8) if out is None else out
        # at most 256 bytes: whole numbers below 65536
        total = np.zeros((height, width, 4), np.uint16) if len(views) > 1 else None
        for poses, camera in views:
            if camera.size != (width, height):
                camera = camera.resized((width, height))
            self._frame(FrameInputs(target, _poses(poses), camera, True, seconds, len(views)))
            target.read_into(image, components=4)
            if total is not None:
                total += image
        if total is not None:
            image[:] = (total + len(views) // 2) // len(views)
        return image

    def draw_into(
        self, framebuffer: moderngl.Framebuffer, poses: Sequence[GivenPose], camera: Camera, *, seconds: float = 0.0
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
        elif self.size != camera.size and (self.plan.background is not None or self.plan.filters):
            raise ValueError(f"made for {self.size} pixels, drawn into {camera.size}: call resize")
        self._frame(FrameInputs(framebuffer, _poses(poses), camera, framebuffer is self.target, seconds))

    def explain(self, repeats: int = 5) -> list[JsonObject]:
        """Every pass: whether it ran in the last frame, why, what it costs in ms (median), its bytes.

        A pass that did not run costs nothing and says 0. Times of avatars include their share of posing; all end
        when the device is done; no readback.
        """
        if self.last is None:
            raise ValueError("nothing was drawn yet: there is no frame to explain")
        out, inputs, milliseconds = [], self.last, self.context.milliseconds
        frame = lambda: float(np.median([milliseconds(lambda: self._frame(inputs)) for _ in range(3)]))
        for item, decision in list(self.drawn):
            times = []
            for _ in range(repeats if decision.runs else 0):
                if item in self.plan.filters:
                    # it filters a whole picture
                    self._frame(inputs)
                times.append(milliseconds(lambda: self._frame(inputs, only=item)))
            ms = round(item.cost(float(np.median(times)), inputs, frame), 3) if times else 0.0
            out.append(
                {"name": item.name, "runs": decision.runs, "state": str(decision.state), "why": decision.why, "ms": ms,
                 "bytes": sum(handle.bytes for handle in item.uses)}
            )  # fmt: skip
        return out

    def release(self) -> None:
        self.context.make_current()
        self.resources.release()
        close_all(self.plan.kept.values())

    # -- one frame

    def _frame(self, inputs: FrameInputs, *, only: Pass | None = None) -> None:
        """Execute the plan, or one pass of it (explain)."""
        camera = inputs.camera
        if len(inputs.poses) != len(self.avatars):
            raise ValueError(f"{len(self.avatars)} avatars need as many poses, found {len(inputs.poses)}")
        bones = [poser.posed(*pose[:2], camera) for poser, pose in zip(self.posers, inputs.poses, strict=True)]
        inputs = replace(inputs, poses=self._seen_faces(inputs, bones))
        if self._plan_faces(inputs.poses):
            self._frame(inputs, only=only)
            return
        reaches, bounds = self._bounds(inputs.poses, bones, camera)
        visible = [one.shows(camera) for one in bounds]
        depths = np.array([one.depth for one, seen in zip(bounds, visible, strict=True) if seen]).reshape(-1, 2)
        planes = clip_planes(depths.ravel(), float(depths[:, 1].min(initial=np.inf)))
        look = self.look._replace(view_amount=self.view_amount)
        drawing = Drawing(inputs, self.resources, look, bones, bounds, visible, planes, reaches)
        # a filter works on what is there
        if only is None or only not in self.plan.filters:
            inputs.framebuffer.viewport = (0, 0, *camera.size)
            inputs.framebuffer.use()
            inputs.framebuffer.clear(color=self.look.color)
        drawn: list[PassOutcome] = []
        for item in self.plan.passes:
            decision = item.decide(drawing)
            drawn.append(PassOutcome(item, decision))
            if item is only or (only is None and decision.runs):
                item.draw(drawing)
        self.drawn, self.last = drawn, inputs

    def _bounds(
        self, poses: Sequence[Pose], bones: Sequence[PosedBones], camera: Camera
    ) -> tuple[list[float], list[ScreenBounds]]:
        """How far each avatar's loose parts are from where they are skinned to, at most, metres; where they all are."""
        reaches = [max(item.reach(k, pose) for item in self.plan.passes) for k, pose in enumerate(poses)]
        return reaches, [screen_bounds(self._bulging(*one), camera) for one in zip(bones, reaches, strict=True)]

    def _seen_faces(self, inputs: FrameInputs, bones: Sequence[PosedBones]) -> tuple[Pose, ...]:
        """The poses, without faces that cannot be seen: the picture is the same whether or not one was shown before."""
        still, camera = tuple(pose._replace(face=None) for pose in inputs.poses), inputs.camera
        moved = [moves_face(pose, one, camera) for pose, one in zip(inputs.poses, bones, strict=True)]
        if not any(moved):
            return still
        _, bounds = self._bounds(still, bones, camera)
        return tuple(
            pose if moves and one.shows(camera) else rest
            for pose, rest, moves, one in zip(inputs.poses, still, moved, bounds, strict=True)
        )

    def _plan_faces(self, poses: Sequence[Pose]) -> bool:
        """Bring faces that move for the first time into the plan; whether there are any."""
        moved = {
            number for number, (avatar, pose) in enumerate(zip(self.avatars, poses, strict=True))
            if number not in self.faces and avatar.eyes is not None and pose.face is not None
        }  # fmt: skip
        if moved:
            self.faces |= moved
            self._apply(self._resolved(self.plan.kept))
        return bool(moved)

    def _bulging(self, bones: PosedBones, reach: float) -> PosedBones:
        """The bones with spheres that hold what they move, in the skinning asked for; reach: of loose parts, metres."""
        if self.effects.skinning != "lbs":
            # -1, a bone that moves nothing, stays negative
            bones = bones._replace(radii=BULGE * bones.radii)
        if reach:
            bones = bones._replace(radii=np.where(bones.radii < 0, bones.radii, bones.radii + reach))
        return bones

    # -- when the plan changes

    def _resolved(self, kept: Kept) -> Plan:
        """The plan of what is asked for now; nothing has changed yet."""
        info = self.context.gl.info
        levels = [avatar.level(number) for avatar, number in zip(self.avatars, self.detail, strict=True)]
        largest = max(*(self.size or (1, 1)), *(max(level.base_color.shape) for level in levels))
        if largest > info["GL_MAX_TEXTURE_SIZE"]:
            limit = f"{self.context.renderer} holds at most {info['GL_MAX_TEXTURE_SIZE']}"
            raise ValueError(f"{largest} pixels across; {limit}")
        if self.size is not None and self.size[0] * self.size[1] > MAX_PIXELS:
            raise ValueError(f"size: expected at most {MAX_PIXELS} pixels, found {self.size[0]} x {self.size[1]}")
        canvas = Canvas(self.size, self.own_image, self.context.software, self.context.gl.max_samples)
        return resolve(self.avatars, canvas, self.effects, self.background, self.detail, kept, self.faces)

    def _apply(self, plan: Plan) -> None:
        """Make what the plan adds, free what it lacks, and draw once with what is new."""
        self.context.make_current()
        new = self.resources.apply(plan.handles)
        close_all([one for key, one in self.plan.kept.items() if key not in plan.kept])
        self.plan = plan
        self.look = Look(self.background.color, self.view_amount, plan.margin, plan.background, plan.frame)
        window = self.context.screen() if self.context.kind == "window" else None
        warming = Warming(self.resources, self.look, self.target or window)
        for item in plan.passes if self.context.warms else ():
            if any(handle in new for handle in item.uses if handle.kind is moderngl.VertexArray):
                item.warm(warming)

    def _measure(self) -> None:
        """Bounds of each avatar's surface at its level of detail."""
        made = {id(avatar): Poser(avatar, avatar.level(self.level)) for avatar in self.avatars}
        self.posers = [made[id(avatar)] for avatar in self.avatars]


def _poses(given: Sequence[GivenPose]) -> tuple[Pose, ...]:
    return tuple(pose if isinstance(pose, Pose) else Pose(*pose) for pose in given)


def _as_background(background: Background | Sequence[float | int]) -> Background:
    if isinstance(background, Background):
        return background
    red, green, blue, alpha = map(float, background)
    return Background("color", (red, green, blue, alpha))
