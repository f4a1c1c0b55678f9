"""A program that draws an avatar and knows no effects: the yardstick of what asking for none of them costs.

    python -m experiments.bare_program [AVATAR] [--rounds 240]

Posing, mesh, texture, shaders (with nothing switched on) and image are the player's; a frame is written down straight,
without a plan, passes and their decisions. The bare scene of `selfscan bench --effects` takes turns with it, and may
take 1.03 times as long.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import moderngl
import numpy as np
from jaxtyping import UInt8

from avatar.baked_avatar import Avatar
from avatar.camera import Camera, clip_from_view
from avatar.gltf.avatar_file import read_avatar
from bench.ladder.effects import ABOVE, FRAMES, SIDE, SIZE, Case, Drawn
from bench.ladder.machine import times_of
from bench.ladder.rung_scores import median_interval
from player.draw.drawing import GivenPose
from player.draw.mesh import attributes_read, draw_order, interleaved
from player.draw.posed_mesh import BASE
from player.draw.posing import Poser, screen_bounds
from player.draw.raster import clip_planes
from player.gl.blocks import BINDING, FRAME, bind_block, block_bytes
from player.gl.context import Context, open_context
from player.gl.shader import compile_program
from player.gl.texture import image_texture, read_finer_mip
from player.scene.effects import PLAIN, STUDIO
from player.scene.framing import extent, fitted_camera
from player.scene.mannequin import mannequin
from player.scene.motions import motion_for

# every switch of the avatar's shaders, off
PLAIN_SHADER = {"SKINNING": 0, "LIT": 0, "CONTACT": 0, "LOOSE": 0, "FACE": 0, "VIEW_STAGE": 0}
Color = tuple[float, float, float, float]


class BareProgram:
    """Draws one avatar, linearly blended, in the paper's colors, on an image of its own."""

    def __init__(self, context: Context, avatar: Avatar, size: tuple[int, int], color: Color):
        context.make_current()
        gl, level = context.gl, avatar.levels[0]
        counts = f"const int BONE_COUNT = {level.bones};\nconst int INFLUENCES = {level.influences};\n"
        self.gl, self.color, self.poser = gl, color, Poser(avatar, level)
        self.program = compile_program(gl, "avatar.vert", "avatar.frag", PLAIN_SHADER, {"counts.glsl": counts})
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
        read_finer_mip(context, self.texture)
        self.target = gl.framebuffer([gl.renderbuffer(size, 4)], gl.depth_renderbuffer(size))

    def draw(self, pose: GivenPose, camera: Camera) -> None:
        """One frame, row 0 on top."""
        gl, target = self.gl, self.target
        bones = self.poser.posed(*pose[:2], camera)
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


def bare_share(context: Context, bare: Drawn, avatar: Avatar, rounds: int) -> tuple[list[float], list[float]]:
    """How long a scene that calls for nothing takes, in times of a program that knows no effects, for each pair of
    neighbouring frames: passed, and processor time."""
    program = BareProgram(context, avatar, bare.camera.size, STUDIO.color)
    target, pairs = bare.renderer.target, []
    assert target is not None

    try:
        for number in range(rounds):
            pose = bare.track.pose(FRAMES[number % len(FRAMES)] / bare.track.motion.rate)
            turns = [
                lambda pose=pose: program.draw(pose, bare.camera),
                lambda pose=pose: bare.renderer.draw_into(target, [pose], bare.camera),
            ]
            # the first pays for what the machine did before
            order = (0, 1) if number % 2 else (1, 0)
            # a frame untimed before each: the caches hold its own
            taken = {which: [times_of(context, turns[which]) for _ in range(2)][1] for which in order}
            pairs.append(np.divide(taken[1], taken[0]))
    finally:
        program.release()
    wall, cpu = np.array(pairs).T.tolist()
    return wall, cpu


def main(argv: list[str] | None = None) -> int:
    """Print the ratio of both, with its 95 % interval."""
    parser = argparse.ArgumentParser(
        "python -m experiments.bare_program", description="A bare scene beside a program without effects."
    )
    parser.add_argument("avatar", nargs="?", type=Path, help="avatar file (.glb); none: the built-in body")
    parser.add_argument("--rounds", type=int, default=240, help="pairs of neighbouring frames")
    command = parser.parse_args(argv)
    avatar = mannequin() if command.avatar is None else read_avatar(command.avatar)
    with open_context() as context:
        motion = motion_for(avatar, "walking")
        camera = fitted_camera(extent(avatar, motion.read(FRAMES.start, FRAMES.stop)), SIDE, SIZE, elevation=ABOVE)
        bare = Drawn(context, avatar, motion, Case("bare", replace(PLAIN, view="off")), camera)
        shares = bare_share(context, bare, avatar, command.rounds)
        bare.renderer.release()
    for name, share in zip(("time passed", "processor time"), shares, strict=True):
        low, high = median_interval(np.array(share))
        print(f"{name}: {np.median(share):.3f} ({low:.3f} to {high:.3f}) times the bare program's")
    return 0


if __name__ == "__main__":
    sys.exit(main())
