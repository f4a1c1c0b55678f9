"""A second opinion on the head's cameras: COLMAP's, from the pictures alone (Schoenberger and Frahm 2016).

The fit places the head by a detector's points and its outline; structure from motion by what is painted on it. They err
independently, so a frame about which they differ is a frame to look at. The focal length is ours: one head leaves it
open by 10 %. pycolmap is an optional extra.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from avatar.camera import Camera
from avatar.errors import AssetError
from avatar.rotation import axis_angle_from_matrix, nearest_rotation
from capture.check.verdict import Finding
from capture.folder import PartVideo
from capture.imports.colmap import read_colmap

Array = np.ndarray

# frames under which nothing is said, of all and their share
FEWEST, SHARE = 6, 0.3
# degrees: a frame's turn worth a look, and the median worth a word
FRAME, MEDIAN = 10.0, 4.0
# pixels taken off the mask: its rim shows the room
RIM = 2
# of features: pictures are small, and skin has little on it
LEAST_PEAK = 0.002


@dataclass(frozen=True)
class SecondOpinion:
    """How COLMAP's cameras of the head lie beside ours."""

    frames: int  # of the video
    registered: tuple[int, ...]  # of them, by COLMAP
    # of the registered ones, after one common turn
    degrees: tuple[float, ...]

    def line(self) -> str:
        """What was measured, for reading."""
        if self.says_nothing:
            return f"head: COLMAP registered {len(self.registered)} of {self.frames} frames, too few to say anything"
        worst = int(np.argmax(self.degrees))
        return (
            f"head: COLMAP registered {len(self.registered)} of {self.frames} frames; turns differ by "
            f"{np.median(self.degrees):.1f} degrees (median; {self.degrees[worst]:.1f} in frame "
            f"{self.registered[worst]})"
        )

    @property
    def says_nothing(self) -> bool:
        return len(self.registered) < max(FEWEST, SHARE * self.frames)

    def findings(self) -> list[Finding]:
        """What there is to act on."""
        if self.says_nothing:
            return []
        median = float(np.median(self.degrees))
        if median > MEDIAN:
            return [Finding("head", False, f"COLMAP turns the head by {median:.0f} degrees otherwise (median)",
                            "look at overlays.png; where they lie well, ours are right")]  # fmt: skip
        off = [str(f) for f, degrees in zip(self.registered, self.degrees) if degrees > FRAME]
        if not off:
            return []
        frames = f"frame{'s' * (len(off) > 1)} {', '.join(off[:8])}"
        return [Finding("head", False, f"COLMAP turns the head otherwise in {frames}",
                        "look at them in the head's video; frames that are wrong can be left out")]  # fmt: skip


def ask_colmap(video: PartVideo) -> SecondOpinion:
    """Let COLMAP find the cameras of the head's video from its pictures inside the masks.

    Raises:
        AssetError: pycolmap is not installed.
    """
    with tempfile.TemporaryDirectory(prefix="selfscan-colmap-") as folder:
        found = _by_colmap(video, Path(folder))
    return compared(video, {int(Path(name).stem): camera for name, camera in found.items()})


def compared(video: PartVideo, found: dict[int, Camera]) -> SecondOpinion:
    """COLMAP's cameras by frame, whose frame and unit are their own, beside those of the video."""
    frames = tuple(sorted(found))
    if not frames:
        return SecondOpinion(len(video.cameras), (), ())
    theirs = np.stack([found[f].camera_from_world[:3, :3] for f in frames])
    own = np.stack([video.cameras[f].camera_from_world[:3, :3] for f in frames])
    common = nearest_rotation(np.einsum("fji,fjk->ik", theirs, own))
    away = axis_angle_from_matrix(np.swapaxes(own, 1, 2) @ theirs @ common)
    degrees = np.degrees(np.linalg.norm(away, axis=-1))
    return SecondOpinion(len(video.cameras), frames, tuple(float(d) for d in degrees))


def _by_colmap(video: PartVideo, folder: Path) -> dict[str, Camera]:
    """Cameras of the registered frames by the name of their picture, the largest model; none: nothing was found."""
    try:
        import pycolmap
    except ImportError:
        raise AssetError("--colmap needs pycolmap: pip install pycolmap") from None
    from scipy.ndimage import binary_erosion

    (folder / "images").mkdir()
    (folder / "masks").mkdir()
    for f, (image, mask) in enumerate(zip(video.images, video.masks)):
        _save(folder / "images" / f"{f:06d}.png", np.asarray(image))
        inside = np.asarray(binary_erosion(np.asarray(mask) > 0, iterations=RIM))
        _save(folder / "masks" / f"{f:06d}.png.png", (255 * inside).astype(np.uint8))
    pycolmap.logging.minloglevel = 3
    pycolmap.set_random_seed(0)
    first = video.cameras[0]
    reading = pycolmap.ImageReaderOptions()
    reading.mask_path = str(folder / "masks")
    reading.camera_model = "SIMPLE_PINHOLE"
    reading.camera_params = f"{first.K[0, 0]},{first.K[0, 2]},{first.K[1, 2]}"
    features = pycolmap.FeatureExtractionOptions()
    features.sift.peak_threshold = LEAST_PEAK
    database = folder / "database.db"
    pycolmap.extract_features(database, folder / "images", camera_mode=pycolmap.CameraMode.SINGLE,
                              reader_options=reading, extraction_options=features)  # fmt: skip
    pycolmap.match_exhaustive(database)
    mapping = pycolmap.IncrementalPipelineOptions()
    mapping.ba_refine_focal_length = False
    pycolmap.incremental_mapping(database, folder / "images", folder, mapping)
    models = [read_colmap(place) for place in sorted(folder.iterdir()) if (place / "images.bin").exists()]
    return max(models, key=len, default={})


def _save(path: Path, pixels: UInt8[Array, "..."]) -> None:
    Image.fromarray(pixels).save(path)
