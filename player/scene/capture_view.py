"""One video of a capture as the window shows it: its pictures, its cameras, and the poses the person had.

Body and hands have cameras in the world and a pose each frame. The head was filmed in a frame of its own; the
landmarks that both frames know place its cameras about the avatar in T-pose:

    min |s R p_world + t - p_head|^2,    camera_from_world = [Rc R | (Rc t + tc) / s]

which shows the same picture, since a pinhole does not see scale.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from avatar.camera import Camera, read_cameras
from avatar.head_landmarks import read_head_landmarks
from avatar.motion.amass import read_video_poses
from avatar.motion.clip import Clip
from avatar.similarity import similarity_from_landmarks
from avatar.skeleton import PARTS
from command.errors import AssetError
from files.input_file import one_line, read_json_object
from files.npz import field, read_npz
from files.picture import read_picture
from player.scene.cameras import FrameCameras

HEAD_RATE = 10.0  # frames a second; the head's video has no poses that would show it


@dataclass(frozen=True)
class CaptureView:
    """A video of a capture, frame by frame."""

    part: str
    images: tuple[Path, ...]
    # one per frame, in the world the avatar stands in
    cameras: tuple[Camera, ...]
    # the poses the person had; not scaled, they were measured on this body
    poses: Clip

    @property
    def frame_cameras(self) -> FrameCameras:
        return FrameCameras(self.cameras, self.poses.rate)

    def image(self, frame: int) -> UInt8[np.ndarray, "height width 3"]:
        """The picture of a frame.

        Raises:
            AssetError: it cannot be read, or has another size than its camera says.
        """
        path, camera = self.images[frame], self.cameras[frame]
        pixels = read_picture(path)
        if pixels.shape[:2] != (camera.size[1], camera.size[0]):
            found = f"{pixels.shape[1]}x{pixels.shape[0]}"
            raise AssetError(f"{path}: should be {camera.size[0]}x{camera.size[1]} as its camera, is {found}")
        return pixels


def open_capture(path: Path | str, part: str = "body") -> CaptureView:
    """Open one video of a capture folder; pictures are read when they are shown.

    Raises:
        AssetError: not a capture, no such part of one, or the video's pictures, cameras and poses do not agree.
    """
    path = Path(path)
    facts = read_json_object(path / "capture.json", "a capture")
    if facts.get("format") != "selfscan-capture":
        raise AssetError(f"{path}: expected a capture folder, found format {one_line(repr(facts.get('format')))}")
    if part not in PARTS:
        raise AssetError(f"{path}: part should be one of {', '.join(PARTS)}, is {part!r}")
    folder = path / part
    images = tuple(sorted(p for p in (folder / "images").glob("*") if p.suffix.lower() in (".png", ".jpg", ".jpeg")))
    if not images:
        raise AssetError(f"{folder / 'images'}: expected pictures, found none")
    cameras = read_cameras(folder / "cameras.npz", len(images))
    if part != "head":
        return CaptureView(part, images, tuple(cameras), read_video_poses(folder / "poses.npz", len(images)))
    transform = head_from_world(path)
    still = np.zeros((len(images), 52, 3))
    cameras = tuple(from_world(camera, transform) for camera in cameras)
    return CaptureView(part, images, cameras, Clip(still, still[:, 0], HEAD_RATE))


def head_from_world(path: Path) -> Float[np.ndarray, "4 4"]:
    """The similarity from the avatar's T-pose to the head video's frame, by its landmarks."""
    place = path / "head" / "landmarks.json"
    subject = path / "subject.npz"
    template = field(subject, read_npz(subject, "a subject", ("v_template",)), "v_template", (None, 3))
    head, vertices = read_head_landmarks(place, len(template))
    try:
        return similarity_from_landmarks(template[vertices].astype(np.float64), head).transform
    except ValueError as error:
        raise AssetError(f"{place}: {error}") from None


def from_world(camera: Camera, transform: Float[np.ndarray, "4 4"]) -> Camera:
    """A camera of the head's frame as one of the world."""
    pose = camera.camera_from_world @ transform
    pose[:3] /= np.cbrt(np.linalg.det(pose[:3, :3]))
    return replace(camera, camera_from_world=pose)
