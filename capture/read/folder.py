"""The capture folder, written whole from videos, cameras and poses of other formats (docs/formats.md)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from PIL import Image

from avatar.camera import Camera, project, write_cameras
from avatar.skeleton import JOINTS, PARTS, joint_transforms
from capture.folder import read_capture
from capture.frame_files import sized_picture
from capture.own_face import OWN_FACE, OwnFace
from capture.read.template import TemplateMesh, write_template
from command.errors import AssetError
from command.progress import Progress
from files.input_file import name_order
from files.picture import read_picture
from files.whole import whole_file, whole_folder, write_json

PICTURES = (".png", ".jpg", ".jpeg")
NEAREST, FARTHEST = 0.1, 30.0  # metres between a camera and what it films
# taken from a video
MOST_FRAMES = 100
# frames per second that poses.npz claims: the sources do not say, and nothing here depends on it
RATE = 30.0
# the joint each video keeps in its place
ANCHORS = {"body": 0, "hand_left": 20, "hand_right": 21}


@dataclass(frozen=True)
class SourceVideo:
    images: tuple[Path, ...]
    masks: tuple[Path, ...]
    # a mask's every value but 0 is the person (labels); else 0 and 1, or 0 and 255
    any_value: bool
    cameras: tuple[Camera, ...]  # one a frame
    axis_angle: Float[Array, "frames 52 3"] | None = None  # head: none
    root: Float[Array, "frames 3"] | None = None  # pelvis joint in the world
    # file and field that the cameras' translations were read from
    place: str = ""
    # masks hold shares of the pixel, kept as they are
    soft: bool = False
    # head, where it is known: joint angles of the person who goes with it
    trunk: Float[Array, "frames 52 3"] | None = None


def write_capture(
    out: Path, template: TemplateMesh, videos: dict[str, SourceVideo], landmarks: dict, facts: dict,
    own: OwnFace | None = None,
) -> None:  # fmt: skip
    """Write the capture folder, with what a film of a face said, read it back, and only then let it appear at `out`.

    Raises:
        AssetError: a picture cannot be read or has another size than its camera; a mask is absent or shows no
            one; the person is not at a plausible distance; or what `read_capture` refuses.
    """
    for part, video in videos.items():
        check_distance(part, video, template.joints)
    report, done = Progress("import", sum(len(video.images) for video in videos.values())), 0
    with whole_folder(out) as folder:
        write_template(folder / "subject.npz", template)
        if own is not None:
            write_json(folder / OWN_FACE, own.json())
        for part in PARTS:
            video = videos[part]
            for kind in ("images", "masks"):
                (folder / part / kind).mkdir(parents=True)
            for i, (image, mask, camera) in enumerate(zip(video.images, video.masks, video.cameras)):
                name = f"{i:06d}.png"
                picture = sized_picture(image, camera.size, "as its camera and the first frame")
                Image.fromarray(picture).save(folder / part / "images" / name, compress_level=1)
                if video.soft:
                    share = read_picture(mask, "L")
                else:
                    person = read_mask(mask, camera.size, any_value=video.any_value)
                    share = np.where(person, 255, 0).astype(np.uint8)
                Image.fromarray(share).save(folder / part / "masks" / name)
                done += 1
                report.update(done, part)
            write_cameras(folder / part / "cameras.npz", video.cameras)
            if video.axis_angle is None or video.root is None:
                write_json(folder / part / "landmarks.json", landmarks)
                if video.trunk is not None:
                    np.savez(folder / part / "trunk.npz", axis_angle=video.trunk)
                continue
            write_poses(folder / part / "poses.npz", video.axis_angle, video.root, RATE)
        content = {
            "format": "selfscan-capture", "version": 1, "subject": facts["subject"], "units": "metres",
            "parts": list(PARTS), "frames": {part: len(videos[part].images) for part in PARTS},
            "size": {part: list(videos[part].cameras[0].size) for part in PARTS}, **facts,
        }  # fmt: skip
        write_json(folder / "capture.json", content)
        try:
            read_capture(folder)
        except AssetError as error:
            raise AssetError(str(error).replace(str(folder), str(out))) from None


def write_poses(
    path: Path, axis_angle: Float[Array, "frames 52 3"], root: Float[Array, "frames 3"], rate: float
) -> None:
    """A video's poses.npz, as AMASS has it; y is up."""
    with whole_file(path) as file:
        np.savez(
            file, poses=axis_angle.reshape(-1, 156), trans=root, betas=np.zeros(16), gender=np.array("neutral"),
            mocap_framerate=np.array(rate), up_axis=np.array("y"),
        )  # fmt: skip


def read_mask(path: Path, size: tuple[int, int], *, any_value: bool) -> Bool[Array, "height width"]:
    """Where the person is. The first channel counts; labels of body parts are values too (`any_value`).

    A mask without a value above 1 holds 0 and 1; otherwise, and in JPEG files always, which ring round edges, more
    than half of the largest value is the person.
    """
    pixels = sized_picture(path, size, "as its picture", None)
    pixels = pixels if pixels.ndim == 2 else pixels[..., 0]
    most = int(pixels.max(initial=0))
    if most <= 1 or (any_value and path.suffix.lower() == ".png"):
        return pixels > 0
    return pixels > max(most, 2) // 2


def pictures_in(folder: Path) -> list[Path]:
    """The pictures of a folder in the order of their names (`name_order`); AssetError where there are none."""
    try:
        found = [path for path in folder.iterdir() if path.suffix.lower() in PICTURES]
    except FileNotFoundError:
        raise AssetError(f"{folder}: no such folder; expected the frames of a video") from None
    except OSError as error:
        raise AssetError(f"{folder}: cannot be read: {error.strerror}") from None
    if not found:
        raise AssetError(f"{folder}: expected frames ({', '.join(PICTURES)}), found none")
    return sorted(found, key=lambda path: name_order(path.name))


def mask_of(folder: Path, image: Path) -> Path:
    """The mask of a picture: a file of the same stem; AssetError where there is none."""
    for suffix in PICTURES:
        if (folder / f"{image.stem}{suffix}").is_file():
            return folder / f"{image.stem}{suffix}"
    raise AssetError(f"{folder / (image.stem + '.png')}: no such mask, expected one for {image.name}")


def anchored(
    axis_angle: Float[Array, "frames 52 3"],
    root: Float[Array, "frames 3"],
    own: Float[Array, "*frames 52 3"],
    template: Float[Array, "52 3"],
    part: str,
) -> Float[Array, "frames 3"]:
    """Root with which the template's skeleton has the part's joint where the fit's own skeleton has it.

    A close-up of a hand is fitted with a shape of its own; there the wrist has to stay, not the pelvis. Pelvis
    joints of both skeletons are at the origin in pose 0.
    """
    joint = ANCHORS[part]
    own = np.broadcast_to(own, (len(root), 52, 3))
    wanted = np.stack([joint_transforms(a, j, r)[joint, :3, 3] for a, j, r in zip(axis_angle, own, root)])
    return root + wanted - joint_transforms(axis_angle, template, root)[:, joint, :3, 3]


def check_distance(part: str, video: SourceVideo, joints: Float[Array, "52 3"]) -> None:
    """Refuse cameras that are implausibly far from what they film: millimetres for metres, or another world."""
    if video.root is None or video.axis_angle is None:
        return
    places = joint_transforms(video.axis_angle, joints, video.root)[:, ANCHORS[part], :3, 3]
    depth = np.array([project(camera, place[None])[1][0] for camera, place in zip(video.cameras, places)])
    middle = float(np.median(depth))
    if not NEAREST <= middle <= FARTHEST:
        raise AssetError(
            f"{video.place} should place the camera {NEAREST} to {FARTHEST} m from the person's "
            f"{JOINTS[ANCHORS[part]]} ({part} video), places it at {middle:.4g} m: check millimetres and metres"
        )
