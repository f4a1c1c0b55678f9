"""A small film in the container that its name's ending says."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np


def greys(levels=range(0, 250, 50)) -> list[np.ndarray]:
    return [np.full((48, 64, 3), level, np.uint8) for level in levels]


def film(path: Path, pictures: Sequence[np.ndarray] = greys(), metadata: Mapping[str, str] = {}) -> None:
    """Pictures of 64 x 48 pixels at 25 a second, and what a phone writes beside them."""
    import av

    kind, settings = ("mpeg4", {}) if path.suffix == ".avi" else ("libx264", {"crf": "4", "bf": "2"})
    with av.open(str(path), "w", options={"movflags": "use_metadata_tags"} if metadata else {}) as container:
        container.metadata.update(metadata)
        stream = container.add_stream(kind, rate=25, options=settings)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, "rgb24")))
        container.mux(stream.encode(None))
