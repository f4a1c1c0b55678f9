"""A plan as GL objects: makes what the plan holds, and when the plan changes, only what is new."""

from collections.abc import Callable, Sequence
from typing import Any

import moderngl
import numpy as np
from jaxtyping import Float32

from avatar.baked_avatar import Avatar, Level
from player.blocks import BINDING, BONES, DUALS, TURNS, bind_block
from player.constants import avatar_constants
from player.context import Context
from player.mesh import draw_order, interleaved, view_interleaved
from player.plan import Pass, Plan, Resource, Variant
from player.shader import compile_program, uniform
from player.texture import image_texture, read_finer_mip

BASE = ("3f4 2f4 4u1 4f1", "position", "uv", "joints", "weights")
VIEW = ("3f4 3f4 3f4 1f4", "view_mean", "view_q0", "view_q1", "view_seen")
TILES = ("4u2 /i", "tile")
# texture units by sampler; 7 is the text line's
UNITS = {"base_color": 0, "features": 1, "more_features": 2, "panorama": 3, "picture": 4, "depth": 5}


class Realised:
    """The GL objects of a plan. `become` moves from one plan to the next; programs and meshes stay."""

    def __init__(self, context: Context, avatars: Sequence[Avatar], level: int):
        self.context, self.avatars, self.level = context, tuple(avatars), level
        self.plan = Plan((), {}, ())
        self.buffers: dict[str, moderngl.Buffer] = {}
        self.textures: dict[str, moderngl.Texture] = {}
        self.renderbuffers: dict[str, moderngl.Renderbuffer] = {}
        self.framebuffers: dict[str, moderngl.Framebuffer] = {}
        self.programs: dict[Variant, moderngl.Program] = {}
        # by name of the pass
        self.arrays: dict[str, moderngl.VertexArray] = {}
        # what each vertex array was made of
        self._made_of: dict[str, tuple[Any, ...]] = {}
        self._orders: dict[int, tuple[np.ndarray, np.ndarray]] = {}  # draw_order of an avatar, while it is made

    def become(self, plan: Plan, panorama: Float32[np.ndarray, "height width 3"] | None = None) -> list[Pass]:
        """Release what the plan lacks, make what it adds. Returns the passes that were never drawn: warm them.

        panorama is asked for only when the plan makes one.
        """
        gone = [name for name, old in self.plan.resources.items() if plan.resources.get(name) != old]
        asked = {item.name: item.variant for item in plan.passes if item.variant is not None}
        for name in list(self.arrays):
            if name not in asked or self._made_of[name][0] != asked[name]:
                self.arrays.pop(name).release()
        # none of ours is freed while bound
        self.context.leave_framebuffer()
        for things in (self.framebuffers, self.textures, self.renderbuffers, self.buffers):
            for name in gone:
                if name in things:
                    things.pop(name).release()
        for variant in [variant for variant in self.programs if variant not in plan.variants]:
            self.programs.pop(variant).release()
        new = [resource for resource in plan.resources.values() if self.plan.resources.get(resource.name) != resource]
        for resource in sorted(new, key=lambda resource: resource.kind == "framebuffer"):  # attachments first
            self._make(resource, panorama)
        self._orders.clear()
        for variant in plan.variants:
            if variant not in self.programs:
                self.programs[variant] = self._program(variant)
        self.plan = plan
        return [item for item in plan.passes if item.variant is not None and self._array(item, item.variant)]

    def release(self) -> None:
        """Free everything."""
        self.become(Plan((), {}, ()))

    def tag(self, avatar: int) -> str:
        """How resources of an avatar begin."""
        return f"avatar {avatar}" if len(self.avatars) > 1 else "avatar"

    def level_of(self, avatar: Avatar) -> Level:
        return avatar.levels[min(self.level, len(avatar.levels) - 1)]

    # -- one object each

    def _make(self, resource: Resource, panorama: Float32[np.ndarray, "height width 3"] | None) -> None:
        gl, name, shape = self.context.gl, resource.name, resource.shape
        if resource.kind == "framebuffer":
            color = self.textures.get(f"{name} color") or self.renderbuffers[f"{name} color"]
            depth = self.textures.get(f"{name} depth") or self.renderbuffers.get(f"{name} depth")
            self.framebuffers[name] = gl.framebuffer([color], depth)
        elif resource.kind == "renderbuffer":
            width, height, samples = shape
            make = gl.depth_renderbuffer if name.endswith(" depth") else gl.renderbuffer
            self.renderbuffers[name] = make((width, height), samples=samples)
        elif name == "panorama":
            assert panorama is not None
            self.textures[name] = self._panorama(panorama)
        elif resource.kind == "texture" and len(shape) > 1:  # an image of ours
            if name.endswith(" depth"):
                texture = gl.depth_texture((shape[0], shape[1]))
                texture.compare_func = ""  # read as a number
                texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            else:
                texture = gl.texture((shape[0], shape[1]), 4)
            texture.repeat_x = texture.repeat_y = False
            self.textures[name] = texture
        elif name in ("frame", "fxaa tiles"):
            self.buffers[name] = gl.buffer(reserve=resource.bytes, dynamic=True)
        else:
            self._make_of_avatar(name, resource.kind)

    def _make_of_avatar(self, name: str, kind: str) -> None:
        index = next(i for i in range(len(self.avatars)) if name.startswith(self.tag(i) + " "))
        level, what = self.level_of(self.avatars[index]), name.removeprefix(self.tag(index) + " ")
        if kind == "texture":
            image = level.base_color
            if what != "base color":
                assert level.features is not None
                image = level.features[..., :4] if what == "features" else level.features[..., 4:]
            self.textures[name] = image_texture(self.context, image, coarse=what != "base color")
            if what == "base color" and self.context.software:
                read_finer_mip(self.context, self.textures[name])
            return
        gl = self.context.gl
        content: dict[str, Callable[[], Any]] = {
            "vertices": lambda: interleaved(level)[self._order(index)[0]],
            "view vertices": lambda: view_interleaved(level)[self._order(index)[0]],
            "faces": lambda: self._order(index)[1],
        }
        blocks = {"bones": BONES, "turns": TURNS, "duals": DUALS}
        if what in blocks:
            self.buffers[name] = gl.buffer(reserve=blocks[what].itemsize, dynamic=True)
        else:
            self.buffers[name] = gl.buffer(content[what]().tobytes())

    def _order(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        if index not in self._orders:
            level = self.level_of(self.avatars[index])
            self._orders[index] = draw_order(level.positions, level.faces)
        return self._orders[index]

    def _program(self, variant: Variant) -> moderngl.Program:
        generated = avatar_constants(self.avatars[variant.avatar]) if variant.avatar is not None else {}
        defines = dict(variant.defines)
        program = compile_program(self.context.gl, variant.vertex, variant.fragment, defines, generated)
        for block in BINDING:
            bind_block(program, block)
        for sampler, unit in UNITS.items():
            if sampler in program:
                uniform(program, sampler).value = unit
        return program

    def _array(self, item: Pass, variant: Variant) -> bool:
        """Make the pass's vertex array; False if the one it had still fits."""
        content: list[tuple[Any, ...]] = []
        faces = None
        if item.avatar >= 0:
            tag = self.tag(item.avatar)
            content, faces = [(self.buffers[f"{tag} vertices"], *BASE)], self.buffers[f"{tag} faces"]
            if f"{tag} view vertices" in item.reads:
                content.append((self.buffers[f"{tag} view vertices"], *VIEW))
        elif "fxaa tiles" in item.reads:
            content = [(self.buffers["fxaa tiles"], *TILES)]
        made_of = (variant, self.programs[variant], *(part[0] for part in content))
        if item.name in self.arrays:
            if all(a is b for a, b in zip(self._made_of[item.name][1:], made_of[1:], strict=True)):
                return False
            self.arrays.pop(item.name).release()
        self.arrays[item.name] = self.context.gl.vertex_array(self.programs[variant], content, faces)
        self._made_of[item.name] = made_of
        return True

    def _panorama(self, light: Float32[np.ndarray, "height width 3"]) -> moderngl.Texture:
        """Half floats: the sun of most panoramas stays below 65504; what is brighter would become infinite."""
        height, width = light.shape[:2]
        texels = np.zeros((height, width, 4), np.float16)
        texels[..., :3] = np.minimum(light, 65504.0)
        texture = self.context.gl.texture((width, height), 4, texels.tobytes(), dtype="f2")
        texture.build_mipmaps()
        texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        texture.repeat_x, texture.repeat_y = True, False
        return texture
