"""The released folders of TotalSelfScan's authors, one subject: `selfscan import totalselfscan SRC OUT`.

    SRC/              annots.npy  images  mask_cihp | mask  params/STEM.npy  vertices/STEM.npy  lbs/
    SRC/hand/handl/   the same; SRC/hand/handr/ too
    SRC/face/         images  masks  new_cameras.npy  tvertices_face.npy

What differs from our capture folder, and is undone here:

- cameras of the body video have T in millimetres, those of hands and face in metres; the face's arrays have a
  leading axis of 1; pixel centres lie on whole numbers, ours at .5;
- the body turns about the origin, X = R(Rh) X_pose + Th: pelvis = Th + R J0, with J0 = joints[0] of that folder;
- the template is stored in the big pose with its pelvis at J0; a hand's folder holds a subset of its vertices,
  all 52 joints;
- masks are body-part labels or 0 and 255 (anything but 0 is the person), the face's 0 and 1;
- a frame's name is the stem of its image, zeros kept; `frame_remove.json` lists half-open ranges of indices;
- the face frame is the canonical one, pelvis at J0: head_from_canonical is known, and is written as landmarks.

.npy files of objects are pickles; they are rebuilt by the restricted unpickler, and nothing in them is run.
"""

from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.body import Body
from avatar.camera import Camera
from avatar.motion.clip import spread_frames
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import PARTS, skin_transforms
from avatar.skinning import skin_points
from capture.read.authors_files import field, numbers, record
from capture.read.authors_template import AuthorsSkeleton, authors_template, read_skeleton
from capture.read.folder import MOST_FRAMES, SourceVideo, anchored, mask_of, pictures_in, write_capture
from capture.read.opencv_yaml import opencv_camera
from capture.read.places import landmark_vertices
from capture.read.template import TemplateMesh
from command.errors import AssetError
from files.input_file import read_json_object
from files.npz import read_npy
from files.picture import picture_size

FOLDERS = {"body": ".", "head": "face", "hand_left": "hand/handl", "hand_right": "hand/handr"}
# start, step, number: what the released configurations train on
AUTHORS_FRAMES = {
    "body": (500, 10, 90), "head": (0, 5, 100), "hand_left": (500, 16, 125), "hand_right": (400, 16, 125),
}  # fmt: skip
# metres between what two files of the folder say of one surface, median
AGREE = 0.03


def import_totalselfscan(
    source: Path, out: Path, *, body: Body | None = None, most: int | None = None
) -> list[str]:
    """Write the capture folder of a subject; returns what was assumed, line by line.

    `body`: the SMPL+H model of the fit, whose skin weights are exact; else they come from lbs/bigpose_bw.npy.

    Raises:
        AssetError: a video, file or field is absent, misshapen or implausible. File and field are named.
    """
    source = Path(source)
    absent = [f"{part} ({FOLDERS[part]})" for part in PARTS if not (source / FOLDERS[part]).is_dir()]
    if absent:
        raise AssetError(f"{source}: expected four videos, found no {', '.join(absent)}")
    notes: list[str] = []
    skeletons = {part: read_skeleton(source / FOLDERS[part] / "lbs") for part in PARTS if part != "head"}
    template = authors_template(source / "lbs", skeletons["body"], body, notes)
    videos: dict[str, SourceVideo] = {}
    for part in PARTS:
        taken = source / FOLDERS[part], most, notes
        videos[part] = _head_video(*taken) if part == "head" else _body_video(*taken, part, skeletons[part], template)
    landmarks = _landmarks(source / "face" / "tvertices_face.npy", template, skeletons["body"].origin, notes)
    facts = {"subject": source.resolve().name, "source": "totalselfscan", "light": "as filmed",
             "body_licence": template.licence, "notes": notes}  # fmt: skip
    write_capture(out, template, videos, landmarks, facts)
    return notes


def _frames_of(count: int, part: str, most: int | None, notes: list[str]) -> Array:
    """The frames to take: the authors' where the video is as long as the authors', else some; `most`, evenly spread."""
    start, step, number = AUTHORS_FRAMES[part]
    whole = start + step * (number - 1) < count
    frames = start + step * np.arange(number) if whole else np.arange(count)
    if most is not None or not whole:
        frames = frames[spread_frames(len(frames), most or MOST_FRAMES)]
    notes.append(f"{part}: {len(frames)} of {count} frames, {frames[0]} to {frames[-1]}")
    return frames


def _body_video(
    folder: Path, most: int | None, notes: list[str], part: str, skeleton: AuthorsSkeleton, template: TemplateMesh
) -> SourceVideo:
    path = folder / "annots.npy"
    annots = record(path, "cameras and frames")
    relative = _image_names(path, annots)
    frames = _frames_of(len(relative), part, most, notes)
    removed = _removed(folder / "frame_remove.json")
    kept = frames[[not any(start <= k < stop for start, stop in removed) for k in frames]]
    if len(kept) < len(frames):
        notes.append(f"{part}: {len(frames) - len(kept)} frames left out by frame_remove.json")
    if not len(kept):
        raise AssetError(f"{folder / 'frame_remove.json'}: bad_frame leaves no frame of the chosen ones")
    names = [relative[k] for k in kept]
    images = tuple(folder / name for name in names)
    camera = _camera(path, annots, part, picture_size(images[0]))
    poses = [_pose(folder / "params" / f"{PurePosixPath(name).stem}.npy", skeleton) for name in names]
    axis_angle, pelvis = np.stack([p[0] for p in poses]), np.stack([p[1] for p in poses])
    root = anchored(axis_angle, pelvis, skeleton.joints, template.joints, part)
    _check_surface(folder, PurePosixPath(names[0]).stem, axis_angle[0], root[0], template, skeleton)
    unit = "millimetres" if part == "body" else "metres"
    masks = tuple(_mask(folder, name) for name in names)
    return SourceVideo(images, masks, True, (camera,) * len(images), axis_angle, root, f"{path}: cams.T, in {unit},")


def _image_names(path: Path, annots: dict[str, Any]) -> list[str]:
    """The first camera's image of every frame, relative to the folder."""
    frames = annots.get("ims")
    if not isinstance(frames, list) or not frames:
        raise AssetError(f"{path}: ims should be a list of frames, is {str(frames)[:40]}")
    names = []
    for k, frame in enumerate(frames):
        views = frame.get("ims") if isinstance(frame, dict) else None
        views = views.tolist() if isinstance(views, np.ndarray) else views
        if not isinstance(views, (list, tuple)) or not views or not isinstance(views[0], str):
            raise AssetError(f"{path}: ims[{k}] should be {{'ims': [path, ...]}}, is {str(frame)[:60]}")
        name = PurePosixPath(str(views[0]).replace("\\", "/"))
        if name.is_absolute() or ".." in name.parts:
            raise AssetError(f"{path}: ims[{k}] should be a path within the folder, is {str(name)[:80]!r}")
        names.append(str(name))
    return names


def _removed(path: Path) -> list[tuple[int, int]]:
    """Half-open ranges of frame indices that are to be left out."""
    if not path.exists():
        return []
    content = read_json_object(path, "frames to leave out")
    try:
        return [(int(start), int(stop)) for start, stop in content["bad_frame"]]
    except (ValueError, TypeError, KeyError, OverflowError):
        raise AssetError(f"{path}: expected {{'bad_frame': [[start, stop], ...]}}") from None


def _camera(path: Path, annots: dict[str, Any], part: str, size: tuple[int, int]) -> Camera:
    """The first camera; the body's T is in millimetres."""
    cams = annots.get("cams")
    if not isinstance(cams, dict):
        raise AssetError(f"{path}: cams should be a dict of K, D, R and T, is {type(cams).__name__}")
    first: dict[str, Any] = {}
    for name in ("K", "D", "R", "T"):
        values = cams.get(name)
        if not isinstance(values, (list, tuple, np.ndarray)) or not len(values):
            raise AssetError(f"{path}: cams.{name} should hold a camera, is {str(values)[:40]}")
        first[name] = values[0]
    K, R, T, D = (field(path, first, name, shape) for name, shape in zip("KRTD", ((3, 3), (3, 3), (3,), (5,))))
    return opencv_camera(f"{path}, cams", K, R, T / (1000 if part == "body" else 1), size, D)


def _pose(path: Path, skeleton: AuthorsSkeleton) -> tuple[Float[Array, "52 3"], Float[Array, "3"]]:
    """Axis-angle vectors with the world's rotation in the root, and the pelvis joint in the world."""
    params = record(path, "pose parameters")
    poses = field(path, params, "poses", (156,)).reshape(52, 3).copy()
    Rh, Th = field(path, params, "Rh", (3,)), field(path, params, "Th", (3,))
    R = matrix_from_axis_angle(Rh)
    poses[0] = axis_angle_from_matrix(R @ matrix_from_axis_angle(poses[0])) if poses[0].any() else Rh
    return poses, Th + R @ skeleton.origin


def _mask(folder: Path, name: str) -> Path:
    stem = str(PurePosixPath(name).with_suffix(""))
    other = stem.replace("images", "mask", 1)
    candidates = [folder / "mask_cihp" / f"{stem}.png", folder / f"{other}.png", folder / f"{other}.jpg"]
    for path in candidates:
        if path.is_file():
            return path
    raise AssetError(f"{folder / name}: no mask; expected one of {', '.join(str(p) for p in candidates)}")


def _check_surface(
    folder: Path, stem: str, axis_angle: Array, root: Array, template: TemplateMesh, skeleton: AuthorsSkeleton
) -> None:
    """The template posed by params must lie where vertices/STEM.npy says: units, J0 and the centre of rotation."""
    path = folder / "vertices" / f"{stem}.npy"
    vertices = numbers(path, "posed vertices", (None, 3))
    posed = skin_points(
        template.vertices, template.skin, skin_transforms(axis_angle, template.joints, root, np.zeros((52, 3)))
    )
    away = float(np.median(KDTree(posed).query(vertices)[0]))
    if away > AGREE:
        raise AssetError(
            f"{path}: vertices should lie within {AGREE * 100:.0f} cm of the template posed by params/{stem}.npy "
            f"(metres, X = R(Rh) X_pose + Th), are {away * 100:.3g} cm away"
        )


def _head_video(folder: Path, most: int | None, notes: list[str]) -> SourceVideo:
    images = pictures_in(folder / "images")
    odd = [path.name for path in images if not path.stem.isdecimal()]
    if odd:
        raise AssetError(f"{folder / 'images' / odd[0]}: expected a number for a name, found {odd[0]!r}")
    path = folder / "new_cameras.npy"
    cameras = read_npy(path, "cameras of the face")
    if not isinstance(cameras, list) or len(cameras) != len(images):
        raise AssetError(
            f"{path}: expected a camera for each of {len(images)} images, found "
            f"{len(cameras) if isinstance(cameras, list) else 'an array of numbers'}"
        )
    frames = _frames_of(len(images), "head", most, notes)
    size = picture_size(images[int(frames[0])])
    chosen = []
    for k in frames.tolist():
        if not isinstance(cameras[k], dict):
            raise AssetError(f"{path}: camera {k} should be a dict of K, R and T")
        K = _leading(path, cameras[k], "K", k)
        R, T = _leading(path, cameras[k], "R", k)[:3, :3], _leading(path, cameras[k], "T", k)
        if min(K.shape, default=0) < 3 or K.ndim != 2 or R.shape != (3, 3) or T.size != 3:
            raise AssetError(f"{path}: camera {k} should have K (1, 3, 3), R (1, 3, 3) and T (1, 3, 1), has "
                             f"{K.shape}, {R.shape} and {T.shape} behind the first axis")  # fmt: skip
        chosen.append(opencv_camera(f"{path}, camera {k}", K[:3, :3], R, T.reshape(3), size, np.zeros(5)))
    pictures = tuple(images[k] for k in frames)
    return SourceVideo(pictures, tuple(mask_of(folder / "masks", image) for image in pictures), True, tuple(chosen))


def _leading(path: Path, camera: dict[str, Any], name: str, k: int) -> Array:
    """A field of a face camera behind its leading axis of 1."""
    try:
        array = np.asarray(camera[name], np.float64)
    except KeyError:
        raise AssetError(f"{path}: camera {k} has no {name}, it has {sorted(map(str, camera))[:12]}") from None
    except (TypeError, ValueError):
        raise AssetError(f"{path}: camera {k}: {name} should be numbers") from None
    if array.ndim < 2 or array.shape[0] != 1 or not np.isfinite(array).all():
        raise AssetError(f"{path}: camera {k}: {name} should be finite with a leading axis of 1, is {array.shape}")
    return array[0]


def _landmarks(path: Path, template: TemplateMesh, origin: Float[Array, "3"], notes: list[str]) -> dict[str, Any]:
    """landmarks.json of a face frame that is known: the canonical one with the pelvis at J0.

        x_head = x_canonical + J0      (the big pose moves nothing above the hips)

    The registered FLAME mesh must agree with the template there.
    """
    surface = numbers(path, "registered face", (None, 3))
    head = template.vertices[template.part == PARTS.index("head")] + origin
    away = float(np.median(KDTree(surface).query(head)[0]))
    if away > AGREE:
        raise AssetError(
            f"{path}: the face should lie within {AGREE * 100:.0f} cm of the body's head in the canonical frame "
            f"(metres), is {away * 100:.3g} cm away"
        )
    vertices = landmark_vertices(template.vertices, template.part == PARTS.index("head"))
    if len(vertices) < 6:
        raise AssetError(
            f"{path.parent.parent}: expected at least 6 places on the template's head, found {sorted(vertices)}"
        )
    notes.append(f"head frame: canonical, as the authors registered it ({away * 1000:.0f} mm from the body's head)")
    points = {name: (template.vertices[v] + origin).tolist() for name, v in vertices.items()}
    return {"points": points, "vertices": vertices, "known": "head_from_canonical: the pelvis joint moved to J0"}
