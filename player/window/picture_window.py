"""A window that shows pictures made elsewhere, and says which keys were pressed."""

import glfw
import numpy as np
from jaxtyping import UInt8

from avatar.camera import Camera, pinhole
from player.scene.cameras import inner_box
from player.window.picture import PictureLayer
from player.window.screen import Screen

NAMES = {glfw.KEY_SPACE: "space", glfw.KEY_N: "n", glfw.KEY_ESCAPE: "escape"}


class PictureWindow:
    """Pictures of any size, as large as they fit; beside them it is black. AssetError: there is no display."""

    def __init__(self, size: tuple[int, int], *, null: bool = False):
        self.screen = Screen(size, null=null)
        self.layer = PictureLayer(self.screen.context)
        self._pressed: list[str] = []
        # pictures come at a pace of their own
        glfw.swap_interval(0)
        glfw.set_key_callback(self.screen.handle, lambda _w, key, _s, action, _m: self.on_key(key, action))

    def on_key(self, key: int, action: int) -> None:
        """A key went down, up, or repeats."""
        if action == glfw.PRESS and key in NAMES:
            self._pressed.append(NAMES[key])

    def show(self, picture: UInt8[np.ndarray, "height width 3"]) -> list[str]:
        """Show a picture; the keys pressed since the last one, by NAMES, and "close" once the window was closed."""
        size = self.screen.size
        # a minimised window has no pixels
        if 0 not in size:
            self.screen.begin().use()
            self.screen.context.gl.clear()
            shape = picture.shape[1], picture.shape[0]
            self.layer.show(picture, Camera(pinhole(shape, 1.0), np.eye(4), shape))
            self.layer.draw(inner_box(shape, size), size)
            glfw.swap_buffers(self.screen.handle)
        glfw.poll_events()
        pressed, self._pressed = self._pressed, []
        return pressed + ["close"] * bool(glfw.window_should_close(self.screen.handle))

    def close(self) -> None:
        self.layer.release()
        self.screen.close()
