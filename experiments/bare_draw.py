"""The least that a textured draw of a mesh can cost here: the yardstick of experiments/speed.py.

One program, one vertex buffer, one texture, one draw, one read-back of RGBA; a palette of bone matrices written
each frame when skinned, nothing when static. No posing, no plan, no view dependence: what a player must do besides
is what the ratio to this shows. Mesh, order of faces, texture, filter, culling and target are the player's own.
"""

from collections.abc import Sequence

import moderngl
import numpy as np
from jaxtyping import Float, UInt8

from avatar.baked_avatar import Avatar
from avatar.camera import Camera, clip_from_view
from avatar.skeleton import skin_transforms
from avatar.skinning import skin_normals, skin_points
from avatar.texture import mip_levels
from player.draw.drawing import BarePose
from player.draw.mesh import draw_order, interleaved
from player.draw.posing import Poser, screen_bounds
from player.draw.raster import clip_planes
from player.gl.context import Context
from player.gl.texture import read_finer_mip

FRAGMENT = """#version 330
uniform sampler2D base_color;
in vec2 place;
out vec4 color;
void main() { color = vec4(texture(base_color, place).rgb, 1.0); }
"""
SKINNED = """#version 330
layout(std140, row_major) uniform Bones { mat4x3 view_from_canonical[52]; };
uniform mat4 clip_from_view;
in vec3 position;
in vec2 uv;
in uvec4 joints;
in vec4 weights;
out vec2 place;
void main() {
    mat4x3 blended = weights.x * view_from_canonical[joints.x] + weights.y * view_from_canonical[joints.y]
                   + weights.z * view_from_canonical[joints.z] + weights.w * view_from_canonical[joints.w];
    gl_Position = clip_from_view * vec4(blended * vec4(position, 1.0), 1.0);
    place = uv;
}
"""
STATIC = """#version 330
uniform mat4 clip_from_view;
in vec3 position;
in vec2 uv;
out vec2 place;
void main() {
    gl_Position = clip_from_view * vec4(position, 1.0);
    place = uv;
}
"""


class BareDraw:
    """Draws an avatar's finest mesh in poses whose bone matrices are known beforehand.

    static: the first pose for all frames, skinned once here; its vertices are in view space already.
    sharp: with the finer mip that the player reads on software, for the same picture; else as GL samples by itself.
    """

    def __init__(
        self,
        context: Context,
        avatar: Avatar,
        poses: Sequence[BarePose],
        camera: Camera,
        *,
        static: bool = False,
        sharp: bool = True,
    ):
        context.make_current()
        gl, level = context.gl, avatar.levels[0]
        poser = Poser(avatar, level)
        bones = [poser.posed(*pose, camera) for pose in poses]
        self.palettes = [np.ascontiguousarray(b.view_from_canonical[:, :3], np.float32) for b in bones]
        planes = clip_planes(np.array([screen_bounds(b, camera).depth for b in bones]).ravel())
        assert planes is not None, "the camera sees nothing of the avatar"
        order, faces = draw_order(level.positions, level.faces)
        vertices = interleaved(level)[order]
        if static:
            blended = np.einsum(
                "vk,vkij->vij", vertices["weights"] / np.float32(255), self.palettes[0][vertices["joints"]]
            )
            vertices["position"] = np.einsum("vij,vj->vi", blended[..., :3], vertices["position"]) + blended[..., 3]
        self.gl, self.static = gl, static
        self.program = gl.program(vertex_shader=STATIC if static else SKINNED, fragment_shader=FRAGMENT)
        clip = clip_from_view(camera, *planes)
        clip[1] = -clip[1]  # row 0 of the picture on top
        projection = self.program["clip_from_view"]
        assert isinstance(projection, moderngl.Uniform)
        projection.write(np.ascontiguousarray(clip.T, np.float32).tobytes())
        self.vertices, self.faces = gl.buffer(vertices.tobytes()), gl.buffer(faces.tobytes())
        layout = ("3f4 2f4 8x1", "position", "uv") if static else (
            "3f4 2f4 4u1 4f1", "position", "uv", "joints", "weights")  # fmt: skip
        self.array = gl.vertex_array(self.program, [(self.vertices, *layout)], self.faces)
        self.bones = gl.buffer(self.palettes[0].tobytes(), dynamic=True)
        self.texture = self._texture(level.base_color, context.software)
        if context.software and sharp:
            read_finer_mip(context, self.texture)
        self.target = gl.framebuffer([gl.renderbuffer(camera.size, 4)], gl.depth_renderbuffer(camera.size))
        self.image = np.empty((camera.size[1], camera.size[0], 4), np.uint8)

    def _texture(self, image: UInt8[np.ndarray, "height width 3"], software: bool) -> moderngl.Texture:
        height, width = image.shape[:2]
        rgba = np.dstack([image, np.full((height, width), 255, np.uint8)])
        texture = self.gl.texture((width, height), 4, rgba.tobytes())
        texture.build_mipmaps(0, mip_levels(image.shape) - 1)
        minify = moderngl.LINEAR_MIPMAP_NEAREST if software else moderngl.LINEAR_MIPMAP_LINEAR
        texture.filter = (minify, moderngl.LINEAR)
        if not software:
            texture.anisotropy = 8.0
        return texture

    def draw(self, number: int) -> UInt8[np.ndarray, "height width 4"]:
        """Frame `number`, in the same array each time."""
        self.target.use()
        self.target.clear()
        self.gl.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self.gl.front_face = "cw"
        if not self.static:
            self.bones.write(self.palettes[number % len(self.palettes)])
            self.bones.bind_to_uniform_block(0)
        self.texture.use(0)
        self.array.render()
        self.target.read_into(self.image, components=4)
        return self.image

    def release(self) -> None:
        attachments = [*self.target.color_attachments, self.target.depth_attachment]
        for thing in (self.array, self.program, self.vertices, self.faces, self.bones, self.texture, self.target,
                      *attachments):  # fmt: skip
            thing.release()


def coverage(image: UInt8[np.ndarray, "height width 4"]) -> float:
    """Share of the picture that anything was drawn on."""
    return float((image[..., 3] > 0).mean())


def posed_vertices(
    avatar: Avatar, pose: BarePose
) -> tuple[Float[np.ndarray, "vertices 3"], Float[np.ndarray, "vertices 3"]]:
    """World positions and normals of the finest mesh, skinned here: what peers that cannot skin are given."""
    level = avatar.levels[0]
    joints = avatar.joint_positions.astype(np.float64)
    bones = skin_transforms(pose[0], joints, root=pose[1], rest=avatar.canonical_pose.astype(np.float64))
    points = skin_points(level.positions.astype(np.float64), level.skin, bones)
    return points, skin_normals(level.normals.astype(np.float64), level.skin, bones)
