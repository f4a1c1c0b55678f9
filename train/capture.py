"""The capture folder: four part videos with masks, cameras and poses, and the subject's registered template."""

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from PIL import Image, UnidentifiedImageError

from avatar.camera import Camera, read_cameras
from avatar.errors import AssetError
from avatar.skeleton import BIG_POSE, skin_transforms
from avatar.skinning import SkinWeights, skin_points

Array = np.ndarray

PARTS = ("body", "head", "hand_left", "hand_right")  # the index is the part id everywhere


@dataclass(frozen=True)
class Subject:
    """The template of one person: a body registered to its surface, with its own joints."""

    name: str
    rest: Float[Array, "vertices 3"]  # pose 0, pelvis at the origin, metres
    vertices: Float[Array, "vertices 3"]  # the same in the canonical (big) pose
    faces: Int[Array, "faces 3"]
    skin: SkinWeights
    joints: Float[Array, "52 3"]  # pose 0
    part: Int[Array, "vertices"]  # index into PARTS
    hair: Bool[Array, "vertices"]


@dataclass(frozen=True)
class PartVideo:
    """One self-rotation video. Body and hands: cameras in the world, with poses. Head: cameras in the head frame."""

    part: str
    images: UInt8[Array, "frames height width 3"]  # sRGB
    masks: Bool[Array, "frames height width"]  # the whole person
    cameras: tuple[Camera, ...]  # one per frame
    axis_angle: Float[Array, "frames 52 3"] | None
    root: Float[Array, "frames 3"] | None  # pelvis joint in the world
    landmarks: Float[Array, "points 3"] | None  # head frame, its own unit
    landmark_vertices: Int[Array, "points"] | None  # template vertices of the same places


@dataclass(frozen=True)
class Capture:
    """What `selfscan synth` or `selfscan import` wrote."""

    path: Path
    facts: dict
    subject: Subject
    videos: dict[str, PartVideo]


def read_capture(path: Path | str) -> Capture:
    """Read and check a capture folder.

    Raises:
        AssetError: something is absent, misshapen, not finite, or disagrees with its neighbour.
    """
    path = Path(path)
    facts = _read_json(path / "capture.json")
    if facts.get("format") != "selfscan-capture" or facts.get("version") != 1:
        found = f"{facts.get('format')!r} version {facts.get('version')!r}"
        raise AssetError(
            f"{path / 'capture.json'}: expected format 'selfscan-capture' version 1, found {found}"
        )
    missing = [part for part in PARTS if part not in facts.get("parts", [])]
    if missing:
        raise AssetError(f"{path / 'capture.json'}: parts should hold {list(PARTS)}, lacks {missing}")
    subject = read_subject(path / "subject.npz", name=str(facts.get("subject", path.name)))
    videos = {part: _read_video(path / part, part, len(subject.rest)) for part in PARTS}
    return Capture(path, facts, subject, videos)


def read_subject(path: Path, name: str = "") -> Subject:
    """Read the template, `subject.npz`.

    Raises:
        AssetError: a field is absent, misshapen or not finite; file and field are named.
    """
    fields = _read_npz(path)
    rest = _field(path, fields, "v_template", (None, 3)).astype(np.float64)
    count = len(rest)
    faces = _field(path, fields, "faces", (None, 3)).astype(np.int64)
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= count:
        raise AssetError(f"{path}: faces should index {count} vertices")
    joints = _field(path, fields, "joints", (52, 3)).astype(np.float64)
    bones = _field(path, fields, "skin_joints", (count, 4)).astype(np.int64)
    weights = _field(path, fields, "skin_weights", (count, 4)).astype(np.float32)
    if bones.min() < 0 or bones.max() > 51:
        raise AssetError(f"{path}: skin_joints should be 0..51, holds {int(bones.min())}..{int(bones.max())}")
    total = weights.sum(1)
    if weights.min() < 0 or np.abs(total - 1).max() > 1e-3:
        row = int(np.abs(total - 1).argmax())
        raise AssetError(
            f"{path}: skin_weights should be positive and sum to 1; row {row} sums to {total[row]:.4f}"
        )
    part = _field(path, fields, "part", (count,)).astype(np.int64)
    absent = [PARTS[i] for i in range(4) if not (part == i).any()]
    if absent or part.max() > 3:
        raise AssetError(f"{path}: part should hold each of 0..3, lacks {absent}, largest {int(part.max())}")
    hair = _field(path, fields, "hair", (count,)).astype(bool)
    skin = SkinWeights(bones, weights)
    canonical = skin_points(rest, skin, skin_transforms(BIG_POSE, joints, rest=np.zeros((52, 3))))
    return Subject(name, rest, canonical, faces, skin, joints, part, hair)


def _read_video(path: Path, part: str, vertex_count: int) -> PartVideo:
    images = _read_frames(path / "images", "RGB")
    masks = _read_frames(path / "masks", "L") > 127
    if masks.shape != images.shape[:3]:
        raise AssetError(
            f"{path / 'masks'}: should be like the images, {images.shape[:3]}, are {masks.shape}"
        )
    frames, height, width = masks.shape
    cameras = read_cameras(path / "cameras.npz")
    if len(cameras) not in (1, frames):
        raise AssetError(f"{path / 'cameras.npz'}: should hold 1 or {frames} cameras, holds {len(cameras)}")
    if cameras[0].size != (width, height):
        raise AssetError(
            f"{path / 'cameras.npz'}: size should be {(width, height)} as the images, is {cameras[0].size}"
        )
    cameras = tuple(cameras * frames if len(cameras) == 1 else cameras)
    if not masks.any():
        raise AssetError(f"{path / 'masks'}: no pixel of any frame shows the person")

    if part == "head":
        points, vertices = _read_landmarks(path / "landmarks.json", vertex_count)
        return PartVideo(part, images, masks, cameras, None, None, points, vertices)
    fields = _read_npz(path / "poses.npz")
    poses = _field(path / "poses.npz", fields, "poses", (frames, 156)).astype(np.float64)
    trans = _field(path / "poses.npz", fields, "trans", (frames, 3)).astype(np.float64)
    return PartVideo(part, images, masks, cameras, poses.reshape(frames, 52, 3), trans, None, None)


def _read_landmarks(path: Path, vertex_count: int) -> tuple[Array, Array]:
    content = _read_json(path)
    points, vertices = content.get("points"), content.get("vertices")
    if not isinstance(points, dict) or not isinstance(vertices, dict) or set(points) != set(vertices):
        raise AssetError(f"{path}: expected 'points' and 'vertices' with the same names")
    if len(points) < 6:
        raise AssetError(f"{path}: expected at least 6 landmarks, found {len(points)}")
    for name in points:
        index = vertices[name]
        if not isinstance(index, int) or not 0 <= index < vertex_count:
            raise AssetError(f"{path}: vertices.{name} should be an index below {vertex_count}, is {index!r}")
    names = sorted(points)
    try:
        positions = np.array([points[name] for name in names], np.float64)
    except (TypeError, ValueError):
        raise AssetError(f"{path}: points should be three numbers each") from None
    if positions.shape != (len(names), 3) or not np.isfinite(positions).all():
        raise AssetError(f"{path}: points should be three finite numbers each")
    return positions, np.array([vertices[name] for name in names])


def _read_frames(folder: Path, mode: str) -> Array:
    paths = sorted(folder.glob("*.png"))
    if not paths:
        raise AssetError(f"{folder}: expected frames 000000.png ..., found none")
    frames = []
    for path in paths:
        try:
            with Image.open(path) as image:
                frames.append(np.asarray(image.convert(mode)))
        except (OSError, UnidentifiedImageError, SyntaxError) as error:
            raise AssetError(f"{path}: expected a PNG image, found: {error}") from None
        if frames[-1].shape != frames[0].shape:
            size, first = frames[-1].shape[1::-1], frames[0].shape[1::-1]
            raise AssetError(f"{path}: should be {first} pixels as the first frame, is {size}")
    return np.stack(frames)


def _read_json(path: Path) -> dict:
    try:
        content = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        raise AssetError(
            f"{path}: no such file; expected a capture folder made by `selfscan synth`"
        ) from None
    except (OSError, ValueError) as error:
        raise AssetError(f"{path}: expected JSON, found: {error}") from None
    if not isinstance(content, dict):
        raise AssetError(f"{path}: expected a JSON object, found {type(content).__name__}")
    return content


def _read_npz(path: Path) -> dict[str, Array]:
    try:
        with np.load(path, allow_pickle=False) as data:
            return {name: data[name] for name in data.files}
    except FileNotFoundError:
        raise AssetError(f"{path}: no such file") from None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise AssetError(f"{path}: expected arrays (.npz), found: {error}") from None


def _field(path: Path, fields: dict[str, Array], name: str, shape: tuple[int | None, ...]) -> Array:
    if name not in fields:
        raise AssetError(f"{path}: no {name}; the file has {sorted(fields)}")
    array = fields[name]
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape)):
        expected = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise AssetError(f"{path}: {name} should be {expected}, is {array.shape}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        first = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise AssetError(f"{path}: {name} is not finite, first at {first}")
    return array
