"""The capture folder: four part videos with masks, cameras and poses, and the subject's registered template."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as dataclass_field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from avatar.body import builtin_body
from avatar.camera import Camera, project, read_cameras
from avatar.head_landmarks import read_head_landmarks
from avatar.motion.amass import read_video_poses
from avatar.skeleton import BIG_POSE, JOINTS, PARTS, skin_transforms
from avatar.skinning import SkinWeights, skin_points
from capture.frame_files import FrameFiles, Frames, sized_picture
from capture.own_face import OWN_FACE, OwnFace, read_own_face
from capture.videos import Videos
from command.errors import AssetError
from command.workers import on_all_cores
from files.input_file import one_line, read_json_object
from files.npz import field, indices, read_npz
from files.picture import read_picture
from files.whole import whole_file

SUBJECT = ("v_template", "faces", "joints", "skin_joints", "skin_weights", "part", "hair")
# metres: from an infant to the tallest man measured
HEIGHT = (0.4, 2.7)
# metres between camera and person; beyond it the unit is uncertain
FARTHEST = 60.0
# given: template registered to the true mesh, its joints, exact poses and cameras; shape only: a free body's shape
# coefficients, estimated joints, no hair label; from pixels: raw videos and a detector's keypoints
INPUTS = ("given", "shape only", "from pixels")
# values of a mask between which a pixel shows the person and what lies behind: neither color is learned there
MIXED = (12, 243)


@dataclass(frozen=True)
class CaptureSubject:
    """The template of one person: a body registered to its surface, with its own joints."""

    name: str
    rest: Float[Array, "vertices 3"]  # pose 0, pelvis at the origin, metres
    vertices: Float[Array, "vertices 3"]  # the same in the canonical (big) pose
    faces: Int[Array, "faces 3"]
    skin: SkinWeights
    joints: Float[Array, "52 3"]  # pose 0
    part: Int[Array, "vertices"]  # index into PARTS
    hair: Bool[Array, "vertices"]
    # centre and radius of the eyeballs, left then right, in pose 0, metres; None: not stated (capture/template/eyes.py)
    eyes: Float[Array, "2 4"] | None = None
    # skin that carved hair covers (capture/template/hull.py): no outer surface, but what lies under the hair
    under_hair: Int[Array, "k 3"] = dataclass_field(default_factory=lambda: np.zeros((0, 3), np.int64))
    # carved vertices of hair: the first, and the one after the last
    carved: tuple[int, int] = (0, 0)
    # metres under the lowest skin of the head that the head's field takes from the body's (train/fused.py)
    head_reach: float = 0.0
    # vertices that carved clothes hide from every side (clothes.py): their inside, and the body there; None: none
    behind_cloth: Bool[Array, "vertices"] | None = None

    @cached_property
    def on_free_body(self) -> bool:
        """Whether its first vertices are those of the free body in their order. Hair or clothes that were carved are
        joined to them, and have taken triangles away."""
        faces, count = builtin_body("male").faces.astype(np.int64), len(builtin_body("male").vertices)
        own = self.faces[(self.faces < count).all(1)]
        numbered = lambda of: (of[:, 0] * count + of[:, 1]) * count + of[:, 2]
        return len(self.vertices) >= count and len(own) > 0 and bool(np.isin(numbered(own), numbered(faces)).all())

    def joined(
        self, kept: Int[Array, "k 3"], mesh: tuple[Array, Array], rest: Float[Array, "n 3"], skin: SkinWeights,
        part: Int[Array, "n"], *, hair: bool,
    ) -> "CaptureSubject":  # fmt: skip
        """The subject with the `kept` of its own faces and a mesh, canonical, behind them; `rest` is it in pose 0."""
        weights = (np.concatenate(both) for both in zip(self.skin, skin))
        return replace(
            self,
            rest=np.concatenate([self.rest, rest]),
            vertices=np.concatenate([self.vertices, mesh[0]]),
            faces=np.concatenate([kept, mesh[1] + len(self.vertices)]),
            skin=SkinWeights(*weights),
            part=np.concatenate([self.part, part]),
            hair=np.concatenate([self.hair, np.full(len(rest), hair)]),
        )


@dataclass(frozen=True)
class PartVideo:
    """One self-rotation video. Body and hands: cameras in the world, with poses. Head: cameras in the head frame."""

    part: str
    # sRGB; files where a reader said so (`frames_on_demand`)
    images: UInt8[Frames, "frames height width 3"]
    masks: Bool[Array, "frames height width"]  # the whole person
    cameras: tuple[Camera, ...]  # one per frame
    axis_angle: Float[Array, "frames 52 3"] | None
    root: Float[Array, "frames 3"] | None  # pelvis joint in the world
    landmarks: Float[Array, "points 3"] | None  # head frame, its own unit
    landmark_vertices: Int[Array, "points"] | None  # template vertices of the same places
    unsure: Bool[Array, "frames height width"] | None = None  # pixels whose mask is not to be believed
    # head: joint angles of the person who goes with the head's bone; None: unknown, the head alone is believed
    trunk: Float[Array, "frames 52 3"] | None = None


@dataclass(frozen=True)
class Capture:
    """What `selfscan synth` or `selfscan import` wrote."""

    path: Path
    facts: dict
    subject: CaptureSubject
    # by part, those that were read; from a folder one at a time (capture/videos.py)
    videos: Mapping[str, PartVideo]
    own_face: OwnFace | None = None  # what a film of the face said

    @property
    def chin(self) -> float | None:
        """Canonical height, metres, of the lowest landmark of the head; None where no video of the head has any."""
        marked = self.videos["head"].landmark_vertices if "head" in self.videos else None
        return None if marked is None else float(self.subject.vertices[marked, 1].min())

    @property
    def fitted_here(self) -> bool:
        """Whether `import video` fitted poses and template to these videos, by keypoints and outlines."""
        return self.facts.get("source") == "video"


def read_capture(path: Path | str, *, parts: Sequence[str] = PARTS, frames_on_demand: bool = False) -> Capture:
    """Read and check a capture folder; of its videos only those of `parts` are read, and large ones again when they are
    asked for. `frames_on_demand`: pictures stay files, for those who look at each of them once.

    Raises:
        AssetError: something is absent, misshapen, not finite, or disagrees with its neighbour.
    """
    path = Path(path)
    facts = read_capture_facts(path)
    named = facts.get("parts")
    missing = [part for part in parts if not isinstance(named, list) or part not in named]
    if missing:
        raise AssetError(f"{path / 'capture.json'}: parts should hold {list(parts)}, lacks {missing}")
    absent = [part for part in parts if not (path / part).is_dir()]
    if absent:
        raise AssetError(f"{path}: no folder {', '.join(absent)}; all four videos are needed: {', '.join(PARTS)}")
    subject = read_subject(path / "subject.npz", name=str(facts.get("subject", path.name)))
    videos = Videos(
        {part: partial(_read_video, path / part, part, len(subject.rest), frames_on_demand) for part in parts}
    )
    # all of them are checked, though they may not all be kept
    for part in parts:
        _check_distance(path / part, videos[part])
    own = path / OWN_FACE
    return Capture(path, facts, subject, videos, read_own_face(own) if own.exists() else None)


def read_capture_facts(capture: Path) -> dict:
    """capture.json; AssetError where there is none."""
    path = Path(capture) / "capture.json"
    facts = read_json_object(path, "a capture, as `selfscan import` and `selfscan synth` make it")
    if facts.get("format") != "selfscan-capture" or facts.get("version") != 1:
        found = one_line(f"{facts.get('format')!r} version {facts.get('version')!r}")
        raise AssetError(f"{path}: expected format 'selfscan-capture' version 1, found {found}")
    return facts


def capture_files(path: Path) -> list[Path]:
    """The files of a capture folder that `read_capture` reads, sorted: others may lie beside them."""
    names = ("cameras.npz", "poses.npz", "landmarks.json", "trunk.npz", "images/*.png", "masks/*.png")
    read = ["capture.json", "subject.npz", OWN_FACE, *(f"{part}/{name}" for part in PARTS for name in names)]
    return sorted(file for name in read for file in path.glob(name) if file.is_file())


def read_subject(path: Path, name: str = "") -> CaptureSubject:
    """Read the template, `subject.npz`.

    Raises:
        AssetError: a field is absent, misshapen or not finite; file and field are named.
    """
    fields = read_npz(path, "a subject", SUBJECT, ("eyes", "under_hair", "carved", "head_reach", "behind_cloth"))
    rest = field(path, fields, "v_template", (None, 3)).astype(np.float64)
    count = len(rest)
    height = float(np.ptp(rest[:, 1])) if count else 0.0
    if not HEIGHT[0] <= height <= HEIGHT[1]:
        raise AssetError(
            f"{path}: v_template should be a standing person in metres, {HEIGHT[0]} to {HEIGHT[1]} m along y; "
            f"is {height:.4g}{other_unit(height)}"
        )
    faces = read_faces(path, fields, count)
    joints = field(path, fields, "joints", (52, 3)).astype(np.float64)
    astray = np.flatnonzero((joints < rest.min(0) - 0.1).any(1) | (joints > rest.max(0) + 0.1).any(1))
    if len(astray):
        row = int(astray[0])
        raise AssetError(
            f"{path}: joints should lie in the template, in metres; joint {row} is at "
            f"{np.round(joints[row], 2).tolist()}"
        )
    skin = read_skin(path, fields, count)
    part = indices(path, fields, "part", (count,), len(PARTS), "parts")
    absent = [PARTS[i] for i in range(4) if not (part == i).any()]
    if absent:
        raise AssetError(f"{path}: part should hold each of 0..3, lacks {absent}")
    hair = field(path, fields, "hair", (count,)).astype(bool)
    eyes = _read_eyes(path, fields, rest)
    under_hair = np.zeros((0, 3), np.int64)
    if "under_hair" in fields:
        under_hair = indices(path, fields, "under_hair", (None, 3), count, "vertices")
    carved = indices(path, fields, "carved", (2,), count + 1, "vertices") if "carved" in fields else (0, 0)
    first, last = (int(i) for i in carved)
    if first > last:
        raise AssetError(f"{path}: carved should be a range of {count} vertices, is {first} to {last}")
    reach = float(field(path, fields, "head_reach", ())) if "head_reach" in fields else 0.0
    if not 0 <= reach <= 0.3:
        raise AssetError(f"{path}: head_reach should be 0 to 0.3 metres, is {reach:g}")
    canonical = skin_points(rest, skin, skin_transforms(BIG_POSE, joints, rest=np.zeros((52, 3))))
    behind = field(path, fields, "behind_cloth", (count,)).astype(bool) if "behind_cloth" in fields else None
    return CaptureSubject(
        name, rest, canonical, faces, skin, joints, part, hair, eyes, under_hair, (first, last), reach, behind
    )


def read_faces(path: Path, fields: dict[str, Array], count: int) -> Int[Array, "faces 3"]:
    """The triangles of a mesh of `count` vertices: the field `faces`, one at least."""
    faces = indices(path, fields, "faces", (None, 3), count, "vertices")
    if not len(faces):
        raise AssetError(f"{path}: faces should be triangles, one at least, are none")
    return faces


def read_skin(path: Path, fields: dict[str, Array], count: int) -> SkinWeights:
    """The skin of a mesh of `count` vertices: the fields `skin_joints` and `skin_weights`."""
    bones = indices(path, fields, "skin_joints", (count, 4), len(JOINTS), "joints")
    weights = field(path, fields, "skin_weights", (count, 4)).astype(np.float32)
    astray = np.abs(weights.sum(1) - 1)
    if (weights < 0).any() or (astray > 1e-3).any():
        row = int(np.maximum(astray, -weights.min(1)).argmax())
        raise AssetError(
            f"{path}: skin_weights should be positive and sum to 1; row {row} sums to {weights[row].sum():.4f}"
        )
    return SkinWeights(bones, weights)


def _read_eyes(path: Path, fields: dict[str, Array], rest: Float[Array, "vertices 3"]) -> Float[Array, "2 4"] | None:
    """Centres and radii of the eyeballs, where the file states them."""
    if "eyes" not in fields:
        return None
    eyes = field(path, fields, "eyes", (2, 4)).astype(np.float64)
    low, high = rest.min(0), rest.max(0)
    for name, (*centre, radius) in zip(("left", "right"), eyes):
        if not ((low < centre) & (centre < high)).all() or not 0 < radius < 0.05:
            raise AssetError(
                f"{path}: eyes should hold a centre within the template and a radius below 0.05 m; the {name} one is "
                f"{np.round([*centre, radius], 4).tolist()}"
            )
    return eyes


def write_subject(path: Path, subject: CaptureSubject) -> None:
    """Write the template so that `read_subject` gives it back."""
    fields: dict[str, Any] = {
        "v_template": subject.rest, "faces": subject.faces, "joints": subject.joints,
        "skin_joints": subject.skin.joints.astype(np.uint8), "skin_weights": subject.skin.weights,
        "part": subject.part.astype(np.uint8), "hair": subject.hair,
    }  # fmt: skip
    if subject.eyes is not None:
        fields["eyes"] = subject.eyes
    # a run's own template has more
    if subject.carved[1]:
        fields |= {"under_hair": subject.under_hair, "carved": np.array(subject.carved)}
    if subject.head_reach:
        fields["head_reach"] = np.float64(subject.head_reach)
    if subject.behind_cloth is not None:
        fields["behind_cloth"] = subject.behind_cloth
    with whole_file(path) as file:
        np.savez(file, **fields)


def _read_video(path: Path, part: str, vertex_count: int, on_demand: bool) -> PartVideo:
    image_names, images = _read_frames(path / "images", "RGB", on_demand=on_demand)
    # the person, and mixtures of it and what lies behind
    mask_names, kinds = _read_frames(
        path / "masks", "L", lambda grey: (grey > 127) + 2 * ((grey > MIXED[0]) & (grey < MIXED[1])).astype(np.uint8)
    )
    masks, mixed = (kinds & 1).astype(bool), kinds > 1
    if image_names != mask_names:
        name = sorted(set(image_names) ^ set(mask_names))[0]
        place = "images" if name in image_names else "masks"
        raise AssetError(
            f"{path / 'masks'}: every image should have a mask of the same name, as {len(image_names)} images and "
            f"{len(mask_names)} masks do not; {name} is in {place} alone"
        )
    if masks.shape != images.shape[:3]:
        size, expected = masks.shape[2:0:-1], images.shape[2:0:-1]
        raise AssetError(f"{path / 'masks'}: should be {expected} pixels as the images, are {size}")
    frames, height, width = masks.shape
    cameras = tuple(read_cameras(path / "cameras.npz", frames))
    if cameras[0].size != (width, height):
        raise AssetError(
            f"{path / 'cameras.npz'}: size should be {(width, height)} as the images, is {cameras[0].size}"
        )
    if not masks.any():
        raise AssetError(f"{path / 'masks'}: no pixel of any frame shows the person")

    unsure = mixed if mixed.any() else None
    if part == "head":
        points, vertices = read_head_landmarks(path / "landmarks.json", vertex_count)
        trunk = None
        if (path / "trunk.npz").exists():
            fields = read_npz(path / "trunk.npz", "the trunk's poses", ("axis_angle",))
            trunk = field(path / "trunk.npz", fields, "axis_angle", (frames, 52, 3)).astype(np.float64)
        return PartVideo(part, images, masks, cameras, None, None, points, vertices, unsure, trunk)
    poses = read_video_poses(path / "poses.npz", frames)
    return PartVideo(part, images, masks, cameras, poses.axis_angle, poses.root, None, None, unsure)


def _check_distance(path: Path, video: PartVideo) -> None:
    """Refuse a video whose cameras never have the person in front of them at a plausible distance.

    The head's unit is free; its landmarks need only be before some camera.
    """
    if video.root is None:
        assert video.landmarks is not None
        before = [(project(camera, video.landmarks)[1] > 0).all() for camera in video.cameras]
        if not any(before):
            raise AssetError(
                f"{path / 'landmarks.json'}: points should be in the frame of head/cameras.npz; they lie behind "
                f"every camera"
            )
        return
    depth = np.array([project(c, r[None])[1][0] for c, r in zip(video.cameras, video.root)])
    away = float(np.median(np.abs(depth)))
    if away > FARTHEST:
        raise AssetError(
            f"{path}: cameras.npz and poses.npz should be in metres of one world; the person is {away:.4g} m from "
            f"the camera{other_unit(away / 2)}"
        )
    if (depth <= 0).all() and video.part == "body":
        raise AssetError(
            f"{path / 'cameras.npz'}: the person should be in front of the camera, is behind it in all frames"
        )


def other_unit(metres: float) -> str:
    """What a length of a person that should be in metres seems to be in."""
    for unit, scale in (("millimetres", 1000), ("centimetres", 100)):
        if HEIGHT[0] * scale <= metres <= HEIGHT[1] * scale:
            return f": {unit}?"
    return ""


def _read_frames(
    folder: Path, mode: str, kept: Callable[[Array], Array] = lambda pixels: pixels, *, on_demand: bool = False
) -> tuple[list[str], Frames]:
    """Names and frames, each as `kept` has it; never all of them twice in memory. `on_demand`: as files."""
    paths = sorted(folder.glob("*.png"))
    if not paths:
        raise AssetError(f"{folder}: expected frames 000000.png ..., found none")
    first = kept(read_picture(paths[0], mode, formats=("PNG",)))
    if on_demand:
        # their sizes are those of the first, or reading them says so
        return [path.name for path in paths], cast(Frames, FrameFiles(tuple(paths), first.shape[:2]))
    frames = np.empty((len(paths), *first.shape), first.dtype)
    frames[0], size = first, (first.shape[1], first.shape[0])
    read = lambda path: kept(sized_picture(path, size, "as the first frame", mode, ("PNG",)))
    for i, pixels in enumerate(on_all_cores(read, paths[1:]), 1):
        frames[i] = pixels
    return [path.name for path in paths], frames


def input_kind(facts: dict[str, Any], place: str = "capture.json") -> str:
    """The kind of a capture, by its capture.json (synthetic ones that say nothing: *given*), or AssetError."""
    kind = str(facts.get("input", "from pixels" if "source" in facts else "given")).replace("_", " ")
    if kind not in INPUTS:
        raise AssetError(f"{place}: input should be one of {', '.join(INPUTS)}, is {one_line(repr(facts['input']))}")
    return kind
