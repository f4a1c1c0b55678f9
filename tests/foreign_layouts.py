"""A small capture written in the layouts that others use, with their traps: the authors' folders, EasyMocap, COLMAP.

And whether what was imported of them is that capture: pictures, masks, cameras, poses, and every projected vertex.
"""

import json
import struct
from pathlib import Path

import numpy as np
from PIL import Image
from smplh_model import J0

from avatar.camera import project
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle, quaternion_from_matrix
from avatar.similarity import similarity_from_landmarks
from avatar.skeleton import PARENTS, PARTS, skin_transforms
from avatar.skinning import dense_weights, skin_points
from capture.folder import Capture, PartVideo, read_capture
from capture.read.colmap import MODELS

HALF = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # pixel centres lie on whole numbers out there
METRES, PIXELS = 1e-6, 1e-4  # that an import may be off
FIRST = {"body": 500, "head": 0, "hand_left": 480, "hand_right": 7}  # number of the first frame


# the authors' folder


def object_array(path: Path, value) -> None:
    """np.save of a dict or a list of dicts, as the authors saved theirs."""
    path.parent.mkdir(parents=True, exist_ok=True)
    array = np.empty(len(value) if isinstance(value, list) else (), object)
    array[...] = value
    np.save(path, array, allow_pickle=True)


def numbers(path: Path, value) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, value)


def write_authors(capture: Capture, root: Path) -> Path:
    """One subject as released: body T in millimetres, face masks 0/1, a leading axis in face cameras, ..."""
    for part, folder in {"body": root, "hand_left": root / "hand/handl", "hand_right": root / "hand/handr"}.items():
        _write_authors_body(capture, capture.videos[part], part, folder)
    video, face = capture.videos["head"], root / "face"
    for kind in ("images", "masks"):
        (face / kind).mkdir(parents=True)
    cameras = []
    # the authors' face frame is the canonical one in metres; ours has another unit: landmarks tell which
    head_from_canonical = _head_from_canonical(capture)
    for i, camera in enumerate(video.cameras):
        stem = f"{FIRST['head'] + i:04d}"
        Image.fromarray(video.images[i]).save(face / f"images/{stem}.png")
        Image.fromarray(video.masks[i].astype(np.uint8)).save(face / f"masks/{stem}.png")  # 0 and 1
        pose = camera.camera_from_world @ head_from_canonical  # (s R | t): a scale s on the rotation
        scale = np.cbrt(np.linalg.det(pose[:3, :3]))
        R, t = pose[:3, :3] / scale, pose[:3, 3] / scale  # the same picture in metres
        K = np.zeros((1, 4, 4))
        K[0, :3, :3] = camera.K - HALF
        cameras.append({"K": K, "R": R[None], "T": (t - R @ J0)[None, :, None]})
    object_array(face / "new_cameras.npy", cameras)
    subject = capture.subject
    numbers(face / "tvertices_face.npy", subject.vertices[subject.part == 1][::2] + J0)
    return root


def _head_from_canonical(capture: Capture) -> np.ndarray:
    video = capture.videos["head"]
    return similarity_from_landmarks(capture.subject.vertices[video.landmark_vertices], video.landmarks).transform


def _write_authors_body(capture: Capture, video: PartVideo, part: str, folder: Path) -> None:
    subject = capture.subject
    own = subject.part == PARTS.index(part)
    members = np.arange(len(own)) if part == "body" else np.flatnonzero(own)
    names = []
    for i in range(len(video.images)):
        stem = f"{FIRST[part] + i:06d}"  # a string: zeros count
        name = f"images/00/{stem}.png"
        names.append(name)
        (folder / "images/00").mkdir(parents=True, exist_ok=True)
        Image.fromarray(video.images[i]).save(folder / name)
        mask = folder / (f"mask_cihp/{name}" if part == "body" else f"mask/00/{stem}.png")
        mask.parent.mkdir(parents=True, exist_ok=True)
        # labels of body parts, any value but 0 is the person; hands: three channels, the first counts
        labels = np.where(video.masks[i], 1 + i % 19, 0).astype(np.uint8)
        Image.fromarray(labels if part == "body" else np.stack([labels, 0 * labels, 0 * labels], -1)).save(mask)
        R, Rh = matrix_from_axis_angle(video.axis_angle[i, 0]), video.axis_angle[i, 0]
        Th = video.root[i] - R @ J0  # about the origin
        poses = video.axis_angle[i].copy()
        poses[0] = 0
        object_array(folder / f"params/{stem}.npy", {"poses": poses.reshape(1, 156), "Rh": Rh[None], "Th": Th[None],
                                                     "shapes": np.zeros((1, 16))})  # fmt: skip
        numbers(folder / f"vertices/{stem}.npy", posed(capture, part, i)[members].astype("f4"))
    camera = video.cameras[0]
    T = camera.camera_from_world[:3, 3:] * (1000 if part == "body" else 1)
    R = camera.camera_from_world[:3, :3]
    cams = {"K": [camera.K - HALF], "D": [camera.distortion[:, None]], "R": [R], "T": [T]}
    object_array(folder / "annots.npy", {"cams": cams, "ims": [{"ims": [name]} for name in names]})
    lbs = folder / "lbs"
    numbers(lbs / "joints.npy", subject.joints + J0)
    numbers(lbs / "parents.npy", PARENTS)
    numbers(lbs / "faces.npy", subject.faces.astype("i4"))
    numbers(lbs / "bigpose_vertices.npy", subject.vertices[members] + J0)


def write_weight_grid(capture: Capture, path: Path) -> None:
    """lbs/bigpose_bw.npy: nearest vertex's weights on a 25 mm grid, 50 mm round the vertices."""
    from scipy.spatial import KDTree

    points = capture.subject.vertices + J0
    axes = [np.arange(lo - 0.05, hi + 0.05 + 0.025, 0.025) for lo, hi in zip(points.min(0), points.max(0))]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    away, nearest = KDTree(points).query(grid)
    weights = dense_weights(capture.subject.skin).astype("f4")[nearest]
    numbers(path, np.concatenate([weights, away[..., None].astype("f4")], -1))


# EasyMocap and COLMAP


def opencv_matrix(name: str, values: np.ndarray) -> str:
    values = np.atleast_2d(values)
    data = ", ".join(f"{v:.17g}" if v != int(v) else f"{int(v)}." for v in values.ravel())
    rows, columns = values.shape
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {data} ]\n"


def write_cameras_yaml(folder: Path, name: str, K, distortion, R, T) -> None:
    head = f'%YAML:1.0\n---\nnames:\n   - "{name}"\n'
    (folder / "intri.yml").write_text(head + opencv_matrix(f"K_{name}", K) + opencv_matrix(f"dist_{name}", distortion))
    place = {"R": axis_angle_from_matrix(R)[:, None], "Rot": R, "T": T[:, None]}
    matrices = (opencv_matrix(f"{key}_{name}", value) for key, value in place.items())
    (folder / "extri.yml").write_text(head + "".join(matrices))


def write_easymocap(
    capture: Capture, root: Path, body, *, hands: str = "apart", turn: np.ndarray | None = None
) -> Path:
    """body, hand_left, hand_right as EasyMocap leaves them; head as images only; masks in root/masks.

    `hands`: "apart" (63 + 45 + 45 offsets from the mean), "pca" (63 + 12 + 12 coefficients), "old" (78 numbers, 6 + 6),
    "full" (156, mean inside). `turn`: easymocap_from_ours, a rotation of the world.
    """
    turn = np.eye(3) if turn is None else turn
    for part, video in capture.videos.items():
        folder = root / part
        (folder / "images").mkdir(parents=True)
        (root / "masks" / part).mkdir(parents=True)
        place = folder / "images" / "01" if part == "body" else folder / "images"
        place.mkdir(exist_ok=True)
        for i, (image, mask) in enumerate(zip(video.images, video.masks)):
            stem = f"{FIRST[part] + i:06d}"
            Image.fromarray(image).save(place / f"{stem}.png")
            Image.fromarray((mask * 255).astype(np.uint8)).save(root / "masks" / part / f"{stem}.png")
        if part == "head":
            continue
        camera = video.cameras[0]
        R = camera.camera_from_world[:3, :3] @ turn.T
        write_cameras_yaml(folder, "01", camera.K - HALF, camera.distortion[None], R, camera.camera_from_world[:3, 3])
        (folder / "smpl").mkdir()
        for i, (pose, place_) in enumerate(zip(video.axis_angle, video.root)):
            rotation = turn @ matrix_from_axis_angle(pose[0])
            Th = turn @ place_ - rotation @ J0
            person = {"id": 0, "Rh": [axis_angle_from_matrix(rotation).tolist()], "Th": [Th.tolist()],
                      "shapes": [[0.0] * 2]} | _hand_numbers(pose, body, hands)  # fmt: skip
            (folder / f"smpl/{FIRST[part] + i:06d}.json").write_text(json.dumps([person]))
    return root


def _hand_numbers(pose: np.ndarray, body, hands: str) -> dict:
    left, right = pose[22:37].ravel(), pose[37:].ravel()
    if hands == "full":
        return {"poses": [pose[1:].ravel().tolist()]}
    offsets = [left - body.hands.mean[0], right - body.hands.mean[1]]
    if hands == "apart":
        return {"poses": [pose[1:22].ravel().tolist()], "handl": [offsets[0].tolist()], "handr": [offsets[1].tolist()]}
    n = 6 if hands == "old" else 12
    found = [np.linalg.lstsq(body.hands.components[k, :n].T, offsets[k], rcond=None)[0] for k in (0, 1)]
    if hands == "old":
        return {"poses": [np.concatenate([np.zeros(3), pose[1:22].ravel(), *found]).tolist()]}
    return {"poses": [pose[1:22].ravel().tolist()], "handl": [found[0].tolist()], "handr": [found[1].tolist()]}


def write_colmap(capture: Capture, folder: Path, *, model: str = "PINHOLE") -> Path:
    camera = capture.videos["head"].cameras[0]
    K, d = camera.K, camera.distortion
    parameters = {
        "SIMPLE_PINHOLE": [K[0, 0], K[0, 2], K[1, 2]],
        "PINHOLE": [K[0, 0], K[1, 1], K[0, 2], K[1, 2]],
        "SIMPLE_RADIAL": [K[0, 0], K[0, 2], K[1, 2], d[0]],
        "RADIAL": [K[0, 0], K[0, 2], K[1, 2], d[0], d[1]],
        "OPENCV": [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *d[:4]],
    }[model]
    # id, qw qx qy qz, t, name
    rows = []
    for i, one in enumerate(capture.videos["head"].cameras):
        q = np.roll(quaternion_from_matrix(one.camera_from_world[:3, :3]), 1)
        rows.append((i + 1, q, one.camera_from_world[:3, 3], f"{FIRST['head'] + i:06d}.png"))
    return colmap_files(folder, [(3, model, *camera.size, *parameters)], rows)


def colmap_files(folder: Path, cameras: list[tuple], images: list[tuple]) -> Path:
    """COLMAP's files of cameras (number, model, width, height, parameters), images (number, wxyz, t, name, camera)."""
    folder.mkdir(parents=True, exist_ok=True)
    numbers = {name: number for number, (name, _) in enumerate(MODELS)}
    data = struct.pack("<Q", len(cameras))
    for number, model, width, height, *parameters in cameras:
        data += struct.pack(f"<IiQQ{len(parameters)}d", number, numbers[model], width, height, *parameters)
    (folder / "cameras.bin").write_bytes(data)
    data = struct.pack("<Q", len(images))
    for number, q, t, name, *camera in images:
        data += struct.pack("<I4d3dI", number, *q, *t, *(camera or [3])) + name.encode() + b"\0"
        data += struct.pack("<Q", number) + struct.pack("<2dQ", 1.5, 2.5, 7) * number
    (folder / "images.bin").write_bytes(data)
    return folder


def write_landmark_pixels(capture: Capture, path: Path, vertices: dict[str, int], *, named: bool) -> Path:
    """The named vertices as seen by all head cameras."""
    video = capture.videos["head"]
    subject = capture.subject
    head = _head_from_canonical(capture)
    pixels = {}
    for name, vertex in vertices.items():
        point = head[:3, :3] @ subject.vertices[vertex] + head[:3, 3]
        pixels[name] = {f"{FIRST['head'] + i:06d}.png": project(camera, point[None])[0][0].tolist()
                        for i, camera in enumerate(video.cameras)}  # fmt: skip
    path.write_text(json.dumps({"pixels": pixels} | ({} if named else {"vertices": vertices})))
    return path


# what an import made of them


def posed(capture: Capture, part: str, frame: int) -> np.ndarray:
    subject, video = capture.subject, capture.videos[part]
    B = skin_transforms(video.axis_angle[frame], subject.joints, video.root[frame], np.zeros((52, 3)))
    return skin_points(subject.rest, subject.skin, B)


def assert_same_capture(out, source: Capture, *, raw: bool = True) -> Capture:
    found = read_capture(out)
    np.testing.assert_allclose(found.subject.rest, source.subject.rest, atol=METRES)
    np.testing.assert_allclose(found.subject.joints, source.subject.joints, atol=METRES)
    np.testing.assert_array_equal(found.subject.faces, source.subject.faces)
    np.testing.assert_array_equal(found.subject.part, source.subject.part)
    for part in ("body", "hand_left", "hand_right"):
        a, b = found.videos[part], source.videos[part]
        np.testing.assert_array_equal(a.images, b.images)
        np.testing.assert_array_equal(a.masks, b.masks)
        if raw:
            np.testing.assert_allclose(a.root, b.root, atol=METRES)
            np.testing.assert_allclose(a.axis_angle[:, 1:], b.axis_angle[:, 1:], atol=1e-9)
        for frame, (mine, theirs) in enumerate(zip(a.cameras, b.cameras)):
            assert mine.size == theirs.size
            here, there = posed(found, part, frame), posed(source, part, frame)
            if raw:
                np.testing.assert_allclose(mine.camera_from_world, theirs.camera_from_world, atol=1e-9)
                np.testing.assert_allclose(here, there, atol=METRES)
            seen, depth = project(mine, here)
            expected, expected_depth = project(theirs, there)
            np.testing.assert_allclose(depth, expected_depth, atol=METRES)
            inside = (depth > 0) & (np.abs(expected) < 3 * mine.size[0]).all(1)  # the lens bends no farther
            assert inside.sum() > 500
            np.testing.assert_allclose(seen[inside], expected[inside], atol=PIXELS)
    return found


def assert_same_head(found: Capture, source: Capture) -> None:
    """Pictures and masks are the same, and the template's head as each frame's camera sees it through the landmarks."""
    a, b = found.videos["head"], source.videos["head"]
    np.testing.assert_array_equal(a.images, b.images)
    np.testing.assert_array_equal(a.masks, b.masks)
    heads = []
    for capture in (found, source):
        subject, head = capture.subject, _head_from_canonical(capture)
        points = subject.vertices[subject.part == 1] @ head[:3, :3].T + head[:3, 3]
        heads.append([project(camera, points)[0] for camera in capture.videos["head"].cameras])
    np.testing.assert_allclose(*heads, atol=PIXELS)
