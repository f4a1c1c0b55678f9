"""Held-out pictures of a synthetic capture, with their poses and cameras: none of them was seen in training.

truth/novel_pose/, novel_view/ images/, masks/, parts/ NAME.png and views.npz; of raw scans also keypoints/NAME.json
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, UInt8

from avatar.camera import Camera
from avatar.skeleton import PARTS
from capture.folder import read_capture_facts
from capture.frame_files import sized_picture
from capture.keypoints.read import read_keypoints
from capture.keypoints.record import Keypoints
from command.errors import AssetError
from files.input_file import read_json_object
from files.npz import read_npz

SETS = ("novel_pose", "novel_view")


@dataclass(frozen=True)
class HeldOutView:
    """One held-out picture; pixels are read when asked for."""

    folder: Path
    name: str
    view: str  # one of PARTS
    pose_index: int
    axis_angle: Float[np.ndarray, "52 3"]
    root: Float[np.ndarray, "3"]
    camera: Camera

    def image(self) -> Float[np.ndarray, "height width 3"]:
        pixels = self.pixels("images", "RGB").astype(np.float32) / 255
        return np.where(self.mask()[..., None], pixels, 0.0).astype(np.float32)  # black ground

    def mask(self) -> Bool[np.ndarray, "height width"]:
        return self.pixels("masks", "L") > 127

    def parts(self) -> UInt8[np.ndarray, "height width"]:
        """Part id + 1 of each pixel, 0 where there is no person."""
        return self.pixels("parts", "L")

    def keypoints(self) -> Keypoints:
        """What a detector finds in the picture; AssetError where the truth holds no keypoints."""
        path = self.folder / "keypoints" / f"{self.name}.json"
        if not path.exists():
            raise AssetError(
                f"{path}: expected keypoints of the held-out picture, found none: an estimated skeleton is fitted to "
                "pictures, it never reads the truth's poses; film by `selfscan synth --raw --keypoints --held-out`"
            )
        return read_keypoints(path, size=self.camera.size)

    def pixels(self, kind: str, mode: str) -> np.ndarray:
        path = self.folder / kind / f"{self.name}.png"
        return sized_picture(path, self.camera.size, "as in views.npz", mode, ("PNG",))


def read_truth_facts(capture: Path) -> dict:
    """What a capture with truth, or the folder of a raw scan (`synth --raw`), says of the person and the light.

    Raises:
        AssetError: it is neither.
    """
    path = Path(capture) / "truth" / "raw.json"
    if (Path(capture) / "capture.json").exists() or not path.exists():
        return read_capture_facts(capture)
    facts = read_json_object(path, "the facts of a raw scan's truth")
    if facts.get("format") != "selfscan-raw-truth":
        raise AssetError(f"{path}: format should be 'selfscan-raw-truth', is {facts.get('format')!r}")
    return facts


def read_held_out(capture: Path, name: str) -> list[HeldOutView]:
    """The held-out pictures of one set ("novel_pose" or "novel_view"), in the order of views.npz.

    Raises:
        AssetError: views.npz is absent or misshapen.
    """
    folder = Path(capture) / "truth" / name
    path = folder / "views.npz"
    if not path.exists() and (folder.parent / "raw.json").exists():
        raise AssetError(f"{path}: no such file: `selfscan synth --raw` films held-out pictures with --held-out")
    shapes = {"pose": ("n",), "view": ("n",), "poses": ("p", 52, 3), "root": ("p", 3), "K": ("n", 3, 3)}
    fields = read_arrays(path, shapes | {"camera_from_world": ("n", 4, 4), "size": (2,)})
    size = (int(fields["size"][0]), int(fields["size"][1]))
    views = []
    for i, (pose, label) in enumerate(zip(fields["pose"].astype(int), map(str, fields["view"]), strict=True)):
        if label not in PARTS or not 0 <= pose < len(fields["poses"]):
            raise AssetError(f"{path}: row {i} is view {label!r} of pose {pose}; views are {PARTS}")
        camera = Camera(fields["K"][i], fields["camera_from_world"][i], size)
        axis_angle, root = fields["poses"][pose].astype(np.float64), fields["root"][pose].astype(np.float64)
        views.append(HeldOutView(folder, f"{pose:06d}_{label}", label, int(pose), axis_angle, root, camera))
    return views


def read_arrays(
    path: Path, shapes: dict[str, tuple], optional: dict[str, tuple] | None = None
) -> dict[str, np.ndarray]:
    """Arrays of an .npz whose shapes agree: a letter stands for a length that must be the same everywhere."""
    optional = optional or {}
    fields = read_npz(path, "ground truth", shapes, optional)
    lengths: dict[str, int] = {}
    for name, shape in {**shapes, **optional}.items():
        if name not in fields:
            continue
        array = fields[name]
        found = array.shape
        expected = tuple(lengths.setdefault(s, n) if isinstance(s, str) else s for s, n in zip(shape, found))
        if len(found) != len(shape) or found != expected:
            raise AssetError(f"{path}: {name} should be {shape} with {lengths}, is {found}")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise AssetError(f"{path}: {name} is not finite, first at {tuple(np.argwhere(~np.isfinite(array))[0])}")
    return fields


def some_poses(views: list[HeldOutView], count: int | None) -> list[HeldOutView]:
    """The views of `count` poses spread evenly over the set; all of them for None."""
    numbers = sorted({int(view.pose_index) for view in views})
    if count is None or count >= len(numbers):
        return views
    kept = {numbers[i] for i in np.linspace(0, len(numbers) - 1, count).round().astype(int)}
    return [view for view in views if view.pose_index in kept]
