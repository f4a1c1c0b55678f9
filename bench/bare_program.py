"""A program that draws an avatar and has never heard of effects: the yardstick of what asking for none of them costs.

Posing, mesh, texture, shaders (with nothing switched on) and image are the player's; a frame is written down straight,
without a plan, passes and their decisions. `selfscan bench --effects` times the bare scene beside it.
"""

import moderngl
import numpy as np
from jaxtyping import UInt8

from avatar.baked_avatar import Avatar
from avatar.camera import Camera, clip_from_view
from avatar.skeleton import JOINTS
from player.blocks import BINDING, FRAME, bind_block, block_bytes
from player.context import Context
from player.drawing import Pose
from player.mesh import attributes_read, draw_order, interleaved
from player.posed_mesh import BASE
from player.posing import Poser, screen_bounds
from player.raster import clip_planes
from player.rung import MOST_JOINTS
from player.shader import compile_program
from player.texture import image_texture, read_finer_mip

# every switch of the avatar's shaders, off
PLAIN_SHADER = {"SKINNING": 0, "LIT": 0, "CONTACT": 0, "LOOSE": 0, "VIEW_STAGE": 0}
Color = tuple[float, float, float, float]


class BareProgram:
    """Draws one avatar, linearly blended, in the paper's colors, on an image of its own."""

    def __init__(self, context: Context, avatar: Avatar, size: tuple[int, int], color: Color):
        context.make_current()
        gl, level = context.gl, avatar.levels[0]
        counted = {}
        if level.influences < MOST_JOINTS:
            counted["influence_count.glsl"] = f"const int INFLUENCES = {level.influences};\n"
        if level.bones != len(JOINTS):
            counted["bone_count.glsl"] = f"const int BONE_COUNT = {level.bones};\n"
        self.gl, self.color, self.poser = gl, color, Poser(avatar, level)
        self.program = compile_program(gl, "avatar.vert", "avatar.frag", PLAIN_SHADER, counted)
        for block in BINDING:
            bind_block(self.program, block, level.bones)
        sampler = self.program["base_color"]
        assert isinstance(sampler, moderngl.Uniform)
        sampler.value = 0
        order, faces = draw_order(level.positions, level.faces)
        self.vertices, self.faces = gl.buffer(interleaved(level)[order].tobytes()), gl.buffer(faces.tobytes())
        self.array = gl.vertex_array(self.program, [(self.vertices, *attributes_read(self.program, *BASE))], self.faces)
        self.frame = gl.buffer(reserve=FRAME.itemsize)
        self.bones = gl.buffer(reserve=block_bytes("Bones", level.bones))
        self.texture = image_texture(context, level.base_color)
        if context.software:
            read_finer_mip(context, self.texture)
        self.target = gl.framebuffer([gl.renderbuffer(size, 4)], gl.depth_renderbuffer(size))

    def draw(self, pose: Pose, camera: Camera) -> None:
        """One frame, row 0 on top."""
        gl, target = self.gl, self.target
        bones = self.poser.posed(*pose, camera)
        planes = clip_planes(np.array([screen_bounds(bones, camera).depth]).ravel())
        assert planes is not None, "the avatar is in view"
        target.viewport = (0, 0, *camera.size)
        target.use()
        target.clear(color=self.color)
        gl.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        clip = clip_from_view(camera, *planes)
        clip[1] = -clip[1]
        gl.front_face = "cw"
        frame = np.zeros((), FRAME)
        frame["clip_from_view"] = clip.T
        self.frame.write(frame.tobytes())
        self.frame.bind_to_uniform_block(BINDING["Frame"][1])
        self.bones.write(np.ascontiguousarray(bones.view_from_canonical[:, :3], np.float32))
        self.bones.bind_to_uniform_block(BINDING["Bones"][1])
        self.texture.use(0)
        self.array.render()

    def picture(self) -> UInt8[np.ndarray, "height width 4"]:
        """What was drawn last."""
        width, height = self.target.size
        return np.frombuffer(self.target.read(components=4), np.uint8).reshape(height, width, 4)

    def release(self) -> None:
        attachments = [*self.target.color_attachments, self.target.depth_attachment]
        for thing in (self.array, self.program, self.vertices, self.faces, self.frame, self.bones, self.texture,
                      self.target, *attachments):  # fmt: skip
            thing.release()
