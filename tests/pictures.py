"""Pictures that were written, read again."""

from pathlib import Path

import numpy as np
from PIL import Image


def pixels(path: Path) -> np.ndarray:
    """A picture's values as they are stored, int."""
    with Image.open(path) as image:
        return np.asarray(image).astype(int)


def pictures_in(folder: Path) -> list[np.ndarray]:
    """The pictures of a folder, in order."""
    return [pixels(file) for file in sorted(folder.glob("*.png"))]
