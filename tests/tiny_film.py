"""A film of grey levels, in the container that its name's ending says."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np


def film(path: Path, levels: Iterable[int] = range(0, 250, 50)) -> None:
    """A frame of 64 x 48 pixels for each level, at 25 a second."""
    import av

    kind, options = ("mpeg4", {}) if path.suffix == ".avi" else ("libx264", {"crf": "4", "bf": "2"})
    with av.open(str(path), "w") as container:
        stream = container.add_stream(kind, rate=25, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for level in levels:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.full((48, 64, 3), level, np.uint8), "rgb24")))
        container.mux(stream.encode(None))
