"""The background as a texture at the size of the image, filled when its content changes and copied in each frame.

Its first row is the top of the picture, as in the renderer's own image; a window takes the copy upside down.
"""

import numpy as np
from jaxtyping import Float

from avatar.camera import Camera
from player.realise import UNITS, Realised
from player.scenes.background import opened_source, read_panorama
from player.scenes.effects import Background
from player.shader import uniform


class Backdrop:
    """What one background shows, and what of it is in the texture now."""

    def __init__(self, background: Background):
        self.background = background
        self.source = opened_source(background)
        self.panorama = None
        self.panorama_size: tuple[int, int] | None = None
        if background.kind == "hdr":
            assert background.path is not None
            self.panorama = read_panorama(background.path)
            self.panorama_size = self.panorama.shape[1], self.panorama.shape[0]
        self._holds: tuple | None = None  # content of the texture

    @property
    def sized(self) -> bool:
        """Whether there is a texture, as large as the image."""
        return self.background.kind not in ("color", "transparent")

    def content(self, made: Realised, camera: Camera, seconds: float) -> tuple:
        """What the texture should hold in this frame: equal while nothing changes."""
        texture = made.textures["background color"]
        if self.source is not None:
            return texture.mglo, self.source.number(seconds)
        # rounding is no turn; 0 and -0 are one
        turned = np.round(camera.camera_from_world[:3, :3], 9) + 0.0
        return texture.mglo, camera.K.tobytes(), turned.tobytes()

    def fresh(self, content: tuple) -> bool:
        """Whether the texture holds this already."""
        return self._holds == content

    def fill(self, made: Realised, camera: Camera, seconds: float) -> None:
        """Write or draw the background of this frame into its texture."""
        texture = made.textures["background color"]
        if self.source is not None:
            pixels = self.source.pixels(seconds, texture.size)
            texture.write(np.ascontiguousarray(pixels).tobytes())
        else:
            self._look_round(made, camera)
        self._holds = self.content(made, camera, seconds)

    def _look_round(self, made: Realised, camera: Camera) -> None:
        item = next(item for item in made.plan.passes if item.name == "background: hdr")
        assert item.variant is not None and self.panorama_size is not None
        program = made.programs[item.variant]
        direction = direction_from_pixel(camera, np.radians(self.background.turn_deg))
        texels_a_radian = self.panorama_size[0] / (2 * np.pi)
        uniform(program, "direction_from_pixel").write(direction.T.astype("f4").tobytes())
        uniform(program, "exposure").value = 2.0**self.background.exposure
        uniform(program, "mip").value = max(float(np.log2(texels_a_radian / camera.K[1, 1])), 0.0)
        framebuffer = made.framebuffers["background"]
        framebuffer.viewport = (0, 0, *framebuffer.size)
        framebuffer.use()
        made.context.gl.enable_only(0)
        made.textures["panorama"].use(UNITS["panorama"])
        made.arrays[item.name].render(vertices=3)

    @property
    def transparent(self) -> bool:
        """Whether any of it is not opaque."""
        if self.background.kind in ("color", "transparent"):
            return self.background.transparent
        opaque = self.source is None or self.source.opaque
        return not opaque and self.background.color[3] < 1

    def close(self) -> None:
        if self.source is not None:
            self.source.close()


def direction_from_pixel(camera: Camera, turn: float) -> Float[np.ndarray, "3 3"]:
    """World directions of pixels (x, y, 1), y down, turned back about the vertical by `turn`, radians."""
    c, s = np.cos(turn), np.sin(turn)
    turned = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    return turned @ camera.camera_from_world[:3, :3].T @ np.linalg.inv(camera.K)
