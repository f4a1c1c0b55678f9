"""The surroundings from a panorama, looked up along each pixel's ray when the camera turns (shaders/panorama.frag)."""

from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path

import moderngl
import numpy as np
from jaxtyping import Float

from avatar.camera import Camera
from player.draw.drawing import Drawing, Warming
from player.draw.plan import Decision, Draft, Pass, PassState
from player.draw.resources import Handle, Image, PlanResources
from player.effects.background_source import read_panorama
from player.gl.shader import set_uniforms

TURNED = Decision(PassState.RUNS, "the camera turned")
STILL = Decision(PassState.KEPT, "the camera has not turned")


class Panorama:
    """Light from all directions.

    Raises:
        AssetError: the file is absent or no panorama.
    """

    def __init__(self, path: Path | str, exposure: float, turn_deg: float):
        self.exposure, self.turn = exposure, float(np.radians(turn_deg))
        light = read_panorama(path)
        self.size = light.shape[1], light.shape[0]
        # until the texture holds it
        self.light: Float[np.ndarray, "height width 3"] | None = light

    def texture(self, resources: PlanResources) -> moderngl.Texture:
        """Half floats: the sun of most panoramas stays below 65504; what is brighter would become infinite."""
        assert self.light is not None
        texels = np.zeros((self.size[1], self.size[0], 4), np.float16)
        texels[..., :3] = np.minimum(self.light, 65504.0)
        self.light = None
        texture = resources.context.gl.texture(self.size, 4, texels.tobytes(), dtype="f2")
        texture.build_mipmaps()
        texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        texture.repeat_x, texture.repeat_y = True, False
        return texture


@dataclass(frozen=True)
class PanoramaPass(Pass):
    """The view of the panorama, into an image that frames copy."""

    image: Image
    content: Panorama
    light: Handle[moderngl.Texture]
    array: Handle[moderngl.VertexArray]

    def decide(self, drawing: Drawing) -> Decision:
        return STILL if drawing.resources.holds.get(self.image.color) == self._wanted(drawing) else TURNED

    def draw(self, drawing: Drawing) -> None:
        """The view of this camera, kept until it turns."""
        camera, resources = drawing.inputs.camera, drawing.resources
        texels_a_radian = self.content.size[0] / (2 * np.pi)
        set_uniforms(
            resources[self.array].program, direction_from_pixel=direction_from_pixel(camera, self.content.turn).T,
            exposure=2.0**self.content.exposure, mip=max(float(np.log2(texels_a_radian / camera.K[1, 1])), 0.0),
        )  # fmt: skip
        framebuffer = resources[self.image.framebuffer]
        framebuffer.viewport = (0, 0, *framebuffer.size)
        self._render(resources)
        resources.holds[self.image.color] = self._wanted(drawing)

    def warm(self, warming: Warming) -> None:
        self._render(warming.resources)

    def _render(self, resources: PlanResources) -> None:
        resources[self.image.framebuffer].use()
        resources.context.gl.enable_only(moderngl.NOTHING)
        resources[self.light].use(0)
        resources[self.array].render(vertices=3)

    def _wanted(self, drawing: Drawing) -> tuple[Hashable, ...]:
        """Equal while the camera does not turn."""
        camera = drawing.inputs.camera
        # rounding is no turn; 0 and -0 are one
        turned = np.round(camera.camera_from_world[:3, :3], 9) + 0.0
        return self.content, camera.K.tobytes(), turned.tobytes()


def panorama_pass(draft: Draft, image: Image, content: Panorama) -> PanoramaPass:
    """The pass of an open panorama that fills an image."""
    width, height = content.size
    levels = max(width, height).bit_length()
    texels = sum(max(width >> i, 1) * max(height >> i, 1) for i in range(levels))
    # the file is part of what it depends on: another panorama of this size is another texture
    light = draft.texture("panorama", 8 * texels, content, make=content.texture)
    array = draft.array(draft.program("screen.vert", "panorama.frag", samplers=("panorama",)))
    return PanoramaPass("background: hdr", (*image.handles, light, array), image, content, light, array)


def direction_from_pixel(camera: Camera, turn: float) -> Float[np.ndarray, "3 3"]:
    """World directions of pixels (x, y, 1), y down, turned back about the vertical by `turn`, radians."""
    c, s = np.cos(turn), np.sin(turn)
    turned = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    return turned @ camera.camera_from_world[:3, :3].T @ np.linalg.inv(camera.K)
