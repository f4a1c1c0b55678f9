"""A user's own four videos: EasyMocap's fits, COLMAP's head cameras, masks: `selfscan import easymocap`.

    SRC/body|hand_left|hand_right/   images/ (or images/CAMERA/)   intri.yml  extri.yml   smpl/000000.json ...
    SRC/head/                        images/
    MASKS/body|head|hand_left|hand_right/   one picture a frame, of the same stem

The JSON of a frame has the number that its image is named by. EasyMocap's world is turned to y-up, cameras with it.
The template is the body model in the mean shape of the body video's fits. A hand's fit has a shape of its own, so
there the wrist stays where the fit has it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.body import Body, shaped
from avatar.camera import Camera
from avatar.motion.clip import spread_frames
from avatar.motion.easymocap import RESULT_FOLDERS, EasyMocapFit, frame_numbers, read_fit
from avatar.motion.pose_vector import TURNS, up_axis, upright_of
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle, matrix_from_quaternion
from avatar.similarity import similarity_from_landmarks
from avatar.skeleton import PARTS
from capture.read.colmap import read_colmap
from capture.read.folder import PICTURES, SourceVideo, anchored, mask_of, pictures_in, write_capture
from capture.read.landmarks import LEAST, read_pixels, triangulated
from capture.read.opencv_yaml import read_easymocap_camera
from capture.read.places import SPOTS, landmark_vertices
from capture.read.template import TemplateMesh, body_template, check_height
from command.errors import AssetError
from files.picture import picture_size

LEAST_HEAD_FRAMES = 3
# |beta|; people lie within 3
LARGEST_SHAPE = 10.0
# metres, landmarks against the template; training refuses more
WORST_FIT = 0.02


def import_easymocap(
    source: Path, out: Path, *, body: Body, head: Path, landmarks: Path, masks: Path, most: int
) -> list[str]:
    """Write the capture folder of a user's videos; returns what was assumed, line by line.

    `body`: the SMPL+H model of the fits. `head`: COLMAP's model of the head video. `landmarks`: its named pixels.
    `most`: frames of a video.

    Raises:
        AssetError: a video, file or field is absent, misshapen or implausible. File and field are named.
    """
    source, masks = Path(source), Path(masks)
    for place in (source, masks):
        absent = [part for part in PARTS if not (place / part).is_dir()]
        if absent:
            raise AssetError(f"{place}: expected folders {', '.join(PARTS)}, found no {', '.join(absent)}")
    notes: list[str] = []
    files = {part: _frame_files(source / part, part, most, notes) for part in PARTS if part != "head"}
    fits = {part: read_fit([json for _, json in files[part]], body=body) for part in files}
    for part, fit in fits.items():
        _check_shapes(files[part], fit.shapes, body)
        notes += [f"{part}: {note}" for note in fit.notes]
    mean = fits["body"].shapes.mean(0)
    person = shaped(body, mean)
    notes.append(f"template: {body.name} in the mean shape of {len(fits['body'].shapes)} frames, {len(mean)} betas")
    template = body_template(person)
    check_height(f"{source / 'body'}: shapes: the shaped body", template.vertices)
    videos: dict[str, SourceVideo] = {}
    videos["head"], points, own_vertices, error = _head_video(
        source / "head", head, masks / "head", most, landmarks, notes
    )
    for part in fits:
        videos[part] = _fitted_video(source / part, masks / part, files[part], fits[part], body, template, notes)
    content = _landmarks(landmarks, template, points, own_vertices, error, notes)
    facts = {"subject": source.resolve().name, "source": "easymocap", "light": "as filmed", "body": body.name,
             "body_licence": template.licence, "betas": [round(float(v), 6) for v in mean], "notes": notes}  # fmt: skip
    write_capture(out, template, videos, content, facts)
    return notes


def _fitted_video(
    folder: Path, masks: Path, files: Sequence[tuple[Path, Path]], fit: EasyMocapFit, body: Body,
    template: TemplateMesh, notes: list[str],
) -> SourceVideo:  # fmt: skip
    """A video of body or hand: its poses about the template's joints, the world turned so that +y is up."""
    images = tuple(image for image, _ in files)
    name = images[0].parent.name if images[0].parent.name != "images" else None
    camera = read_easymocap_camera(folder, name, picture_size(images[0]))
    video_notes: list[str] = []
    turn = matrix_from_quaternion(np.array(TURNS[up_axis(upright_of(fit.Rh), video_notes)]))
    notes += [f"{folder.name}: {note}" for note in video_notes]
    own = np.stack([body.joints + body.joint_directions[..., : len(s)] @ s for s in fit.shapes])
    R = matrix_from_axis_angle(fit.Rh)
    pelvis = fit.Th + (R @ (own[:, 0] + body.origin)[..., None])[..., 0]
    axis_angle = fit.axis_angle.copy()
    axis_angle[:, 0] = axis_angle_from_matrix(turn @ matrix_from_axis_angle(axis_angle[:, 0]))
    root = anchored(axis_angle, pelvis @ turn.T, own - own[:, :1], template.joints, folder.name)
    pose = camera.camera_from_world.copy()
    pose[:3, :3] = pose[:3, :3] @ turn.T
    turned = Camera(camera.K, pose, camera.size, camera.distortion)
    masked = tuple(mask_of(masks, image) for image in images)
    place = f"{folder / 'extri.yml'}: T and Th of {files[0][1].parent}"
    return SourceVideo(images, masked, False, (turned,) * len(images), axis_angle, root, place)


def _frame_files(folder: Path, part: str, most: int, notes: list[str]) -> list[tuple[Path, Path]]:
    """Chosen images with the JSON of the same number."""
    images = pictures_in(_image_folder(folder))
    results = _result_folder(folder)
    poses = frame_numbers(results)
    if len(poses) < len(images):
        missing = next((image for image in images if image.stem.isdecimal() and int(image.stem) not in poses), None)
        first = f"; the first without is {missing.name}" if missing else ""
        raise AssetError(
            f"{results}: expected poses of each of {len(images)} images, found {len(poses)}{first}: remove images that "
            "EasyMocap could not fit"
        )
    frames = spread_frames(len(images), most)
    pairs = []
    for k in frames:
        stem = images[k].stem
        if not stem.isdecimal() or int(stem) not in poses:
            raise AssetError(f"{images[k]}: expected poses {results / (stem + '.json')}, found none")
        pairs.append((images[k], poses[int(stem)]))
    notes.append(f"{part}: {len(frames)} of {len(images)} frames, {pairs[0][0].stem} to {pairs[-1][0].stem}")
    return pairs


def _image_folder(folder: Path) -> Path:
    """images/, or its only subfolder, which EasyMocap names by the camera."""
    images = folder / "images"
    try:
        inside = sorted(path for path in images.iterdir() if path.is_dir())
        plain = any(path.suffix.lower() in PICTURES for path in images.iterdir())
    except OSError:
        raise AssetError(f"{images}: no such folder; expected the frames of a video") from None
    if plain or not inside:
        return images
    if len(inside) > 1:
        raise AssetError(f"{images}: expected the frames of one camera, found folders {[p.name for p in inside][:6]}")
    return inside[0]


def _result_folder(folder: Path) -> Path:
    """The one folder of EasyMocap's results: smpl/ and its like, here, in output/ or in a folder of output/."""
    places = [path for base in ("*", "output/*", "output/*/*") for path in folder.glob(base)]
    found = [path for path in places if path.name in RESULT_FOLDERS and any(path.glob("[0-9]*.json"))]
    if len(found) != 1:
        names = ", ".join(f"{name}/" for name in RESULT_FOLDERS)
        raise AssetError(
            f"{folder}: expected EasyMocap's results in one of {names}, found "
            f"{sorted(str(path.relative_to(folder)) for path in found) or 'none'}"
        )
    return found[0]


def _check_shapes(files: list[tuple[Path, Path]], shapes: Float[Array, "frames n"], body: Body) -> None:
    if shapes.shape[1] > body.shape_directions.shape[2]:
        raise AssetError(
            f"{files[0][1]}: shapes should be at most the {body.shape_directions.shape[2]} of {body.name}, are "
            f"{shapes.shape[1]}"
        )
    if shapes.size and np.abs(shapes).max() > LARGEST_SHAPE:
        frame = int(np.abs(shapes).max(1).argmax())
        raise AssetError(
            f"{files[frame][1]}: shapes should lie within {LARGEST_SHAPE:g}, hold {np.abs(shapes).max():.3g}: the "
            "fit failed"
        )


def _head_video(
    folder: Path, model: Path, masks: Path, most: int, landmarks: Path, notes: list[str]
) -> tuple[SourceVideo, dict[str, Array], dict[str, int], float]:
    """The head video with COLMAP's cameras; and its landmarks: points, the file's own vertices, mean error."""
    images = pictures_in(_image_folder(folder))
    cameras = read_colmap(model)
    by_name = {Path(name).name: camera for name, camera in cameras.items()}
    if len(by_name) < len(cameras):
        raise AssetError(f"{model}: expected image names that differ, found the same in several folders")
    registered = [image for image in images if image.name in by_name]
    if len(registered) < LEAST_HEAD_FRAMES:
        raise AssetError(
            f"{model}: expected at least {LEAST_HEAD_FRAMES} images of {folder / 'images'}, found {len(registered)}; "
            f"the model has {sorted(by_name)[:3]}, the folder {[p.name for p in images[:3]]}"
        )
    if len(registered) < len(images):
        left_out = len(images) - len(registered)
        notes.append(f"head: {left_out} of {len(images)} images are not in COLMAP's model, left out")
    frames = spread_frames(len(registered), most)
    chosen = [registered[k] for k in frames]
    notes.append(f"head: {len(chosen)} of {len(registered)} registered frames, {chosen[0].stem} to {chosen[-1].stem}")
    seen, vertices = read_pixels(landmarks)
    points, errors = {}, []
    for name, pixels in seen.items():
        unknown = [picture for picture in pixels if Path(picture).name not in by_name]
        if unknown:
            raise AssetError(f"{landmarks}: pixels.{name}: {unknown[0]} is no image of COLMAP's model")
        views = [by_name[Path(picture).name] for picture in pixels]
        rows = np.array(list(pixels.values())).reshape(-1, 2)
        points[name], error = triangulated(f"{landmarks}: {name}", views, rows)
        errors.append(error)
    masked = tuple(mask_of(masks, image) for image in chosen)
    video = SourceVideo(tuple(chosen), masked, False, tuple(by_name[image.name] for image in chosen))
    return video, points, vertices, float(np.mean(errors)) if errors else 0.0


def _landmarks(
    path: Path, template: TemplateMesh, points: dict[str, Array], own: dict[str, int], error: float, notes: list[str]
) -> dict[str, Any]:
    """landmarks.json: the triangulated points and their vertices; refused where they do not fit the template."""
    known = landmark_vertices(template.vertices, template.part == PARTS.index("head")) | own
    foreign = sorted(set(points) - set(known))
    if foreign:
        places = ", ".join(name for name in SPOTS if name in known)
        raise AssetError(f'{path}: pixels.{foreign[0]}: expected one of {places}, or its vertex under "vertices"')
    if len(points) < LEAST:
        raise AssetError(f"{path}: expected at least {LEAST} landmarks, found {len(points)}: {sorted(points)}")
    names = sorted(points)
    wrong = [name for name in names if known[name] >= len(template.vertices)]
    if wrong:
        raise AssetError(f"{path}: vertices.{wrong[0]} should be below {len(template.vertices)}, is {known[wrong[0]]}")
    source, target = np.stack([points[n] for n in names]), template.vertices[[known[n] for n in names]]
    try:
        fit = similarity_from_landmarks(source, target)
    except ValueError as problem:
        raise AssetError(f"{path}: {problem}") from None
    away = np.linalg.norm(source @ fit.transform[:3, :3].T + fit.transform[:3, 3] - target, axis=1)
    if fit.residual > WORST_FIT:
        raise AssetError(
            f"{path}: landmarks should fit the template's head within {WORST_FIT * 1000:.0f} mm, are "
            f"{fit.residual * 1000:.0f} mm off; worst {names[int(away.argmax())]}, {away.max() * 1000:.0f} mm"
        )
    notes.append(
        f"landmarks: {len(names)}, {error:.2f} pixels from their marks, {fit.residual * 1000:.1f} mm from the template"
    )
    return {"points": {n: points[n].tolist() for n in names}, "vertices": {n: int(known[n]) for n in names}}
