"""A script in an open window, and the picture that it ends with."""

import numpy as np
from jaxtyping import Int

from player.window.window import Window


def run(window: Window, script: str) -> Int[np.ndarray, "height width 3"]:
    """The whole window after the script's last frame."""
    window.run(script.split(), keep=True)
    image = window.parts.state.last.image
    assert image is not None
    return image[..., :3].astype(int)


def picture(window: Window, image: np.ndarray) -> np.ndarray:
    """The part of what a window shows that panels leave free."""
    left, top, width, height = window.parts.state.layout.area
    return image[top : top + height, left : left + width]
