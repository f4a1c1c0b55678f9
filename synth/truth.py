"""What a capture is measured against: the subject's own mesh, and pictures in poses and from views never filmed."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image

from avatar.camera import Camera, direction
from avatar.motion.read import builtin_motion
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, LEFT_HAND, PARTS, RIGHT_HAND
from files.whole import whole_file
from player.draw.drawing import BarePose
from synth.face_places import face_places
from synth.film import FINEST_PIXEL, frame_points, rotation
from synth.light import FilmLight
from synth.photo import Photo, Studio
from synth.raw.detector import Detector, Mistakes
from synth.subject import SynthSubject

SIZE = 512  # pixels
# camera directions tried for a close-up; the one that sees most of the part is kept
CANDIDATES = 8

# degrees about x, y, z of the parent's frame; "left" only: the other side mirrors it unless it is named itself.
# The left arm runs along +x: shoulder z < 0 lowers it, y < 0 brings it forward; elbow y < 0 bends it forward.
_STANCES: dict[str, dict[str, tuple[int, int, int]]] = {
    "sitting": {
        "left_hip": (-85, 0, 6), "left_knee": (85, 0, 0), "spine2": (8, 0, 0),
        "left_shoulder": (0, -25, -62), "left_elbow": (0, -45, 0),
    },
    "arms up": {"left_shoulder": (0, -8, 62), "left_collar": (0, 0, 12), "left_elbow": (0, -15, 0)},
    "walking": {
        "left_hip": (-28, 0, 0), "right_hip": (20, 0, 0), "left_knee": (18, 0, 0), "right_knee": (32, 0, 0),
        "left_shoulder": (0, 22, -70), "right_shoulder": (0, 28, 68), "left_elbow": (0, -18, 0),
        "right_elbow": (0, 30, 0),
    },
    "squatting": {
        "left_hip": (-95, 0, 14), "left_knee": (110, 0, 0), "left_ankle": (-22, 0, 0), "spine1": (22, 0, 0),
        "left_shoulder": (0, -75, -8),
    },
    "hands on hips": {"left_shoulder": (0, 15, -48), "left_elbow": (0, -95, -25), "left_wrist": (0, 0, -20)},
    "waving": {
        "left_shoulder": (0, -10, 18), "left_elbow": (0, 0, 85), "right_shoulder": (0, 10, 70), "head": (0, 15, 6),
    },
    "reaching": {
        "left_shoulder": (0, -72, -5), "right_shoulder": (0, 60, 35), "spine3": (6, 12, 0), "left_elbow": (0, -10, 0),
        "right_elbow": (0, 50, 0),
    },
    "bowing": {"spine1": (22, 0, 0), "spine2": (18, 0, 0), "left_hip": (-25, 0, 0), "left_shoulder": (0, -20, -68)},
    "kicking": {
        "left_hip": (-62, 0, 8), "left_knee": (12, 0, 0), "right_hip": (8, 0, 0), "left_shoulder": (0, 30, -45),
        "right_shoulder": (0, 45, 35), "right_elbow": (0, 40, 0),
    },
    "twisting": {
        "spine1": (0, 14, 0), "spine2": (0, 16, 0), "spine3": (0, 12, 0), "neck": (0, 10, 0),
        "left_shoulder": (0, -30, -25), "left_elbow": (0, -60, 0),
    },
    "boxing": {"left_shoulder": (0, -45, -40), "left_elbow": (0, -105, 0), "neck": (8, 0, 0)},
    "one leg": {
        "left_hip": (-60, 0, 35), "left_knee": (95, 0, 0), "left_shoulder": (0, 0, 25), "right_shoulder": (0, 0, -15),
    },
}  # fmt: skip


def novel_poses(seed: int) -> list[BarePose]:
    """Twenty poses that were not filmed: eight of our two motions, twelve stances with seeded hands and heading."""
    stands: list[BarePose] = []
    for name, count in (("counting", 4), ("walking", 4)):
        motion = builtin_motion(name)
        for frame in np.linspace(0.1, 0.95, count) * (motion.frames - 1):
            clip = motion.read(int(frame), int(frame) + 1)
            stands.append((clip.axis_angle[0], np.zeros(3)))
    for i, stance in enumerate(_STANCES.values()):
        rng = np.random.default_rng([seed, 21, i])
        pose = _stance(stance) + _hands(rng)
        pose[JOINTS.index("head")] += np.radians(rng.uniform(-15, 15, 3))
        pose[0] = axis_angle_from_matrix(rotation(y=rng.uniform(-60, 60)))
        stands.append((pose, np.zeros(3)))
    return stands


def novel_views(seed: int) -> list[BarePose]:
    """The T-pose, ten times, at seeded headings all round."""
    rng = np.random.default_rng([seed, 22])
    headings = (np.arange(10) + rng.uniform(0.1, 0.9, 10)) * 36
    poses = np.zeros((len(headings), len(JOINTS), 3))
    poses[:, 0] = [axis_angle_from_matrix(rotation(y=heading)) for heading in headings]
    return [(pose, np.zeros(3)) for pose in poses]


def _stance(angles: dict[str, tuple[int, int, int]]) -> Float[np.ndarray, "52 3"]:
    pose = np.zeros((len(JOINTS), 3))
    for joint, degrees in angles.items():
        pose[JOINTS.index(joint)] = _euler(degrees)
        mirrored = joint.replace("left_", "right_")
        if mirrored not in angles:
            pose[JOINTS.index(mirrored)] = _euler((degrees[0], -degrees[1], -degrees[2]))
    return pose


def _euler(degrees: tuple[int, int, int]) -> Float[np.ndarray, "3"]:
    return axis_angle_from_matrix(rotation(*map(float, degrees)))


def _hands(rng: np.random.Generator) -> Float[np.ndarray, "52 3"]:
    """Seeded finger bends, each finger its own: 0 is flat, 1 is closed."""
    pose = np.zeros((len(JOINTS), 3))
    for sign, hand in ((1, LEFT_HAND), (-1, RIGHT_HAND)):
        for finger in range(5):
            closed = rng.uniform(0, 1) ** 1.5
            first = hand.start + 3 * finger
            # the thumb bends across the palm
            if finger == 4:
                for k, degrees in enumerate((10, 25, 30)):
                    pose[first + k, 1] = sign * np.radians(closed * degrees)
            else:
                pose[first, 1] = -sign * np.radians((6, 1, -11, -5)[finger] * rng.uniform(0, 1))
                for k, degrees in enumerate((65, 85, 50)):
                    pose[first + k, 2] = -sign * np.radians(closed * degrees)
    return pose


def view_cameras(
    studio: Studio, vertices: Float[np.ndarray, "vertices 3"], seed: int, turn: Float[np.ndarray, "3 3"]
) -> dict[str, Camera]:
    """One camera on the whole person and one close to the head and each hand, from seeded directions.

    A close-up tries CANDIDATES directions and keeps the one that sees most of its part; the head is looked at
    from where its face turns (`turn`: world_from_head), never straight from behind.
    """
    rng = np.random.default_rng(seed)
    subject = studio.subject
    cameras = {}
    middle = (vertices.min(0) + vertices.max(0)) / 2
    towards = direction(*np.radians([rng.uniform(-35, 35), rng.uniform(-12, 30)]))
    cameras["body"] = frame_points(middle + 3.4 * towards, middle, vertices[::5], SIZE)
    for part in PARTS[1:]:
        members = subject.part == PARTS.index(part)
        if part == "head":
            members &= subject.vertices[:, 1] > subject.joints[JOINTS.index("neck"), 1] - 0.02
        points = vertices[members]
        middle = (points.min(0) + points.max(0)) / 2
        best, most = None, -1.0
        for _ in range(CANDIDATES):
            if part == "head":
                away = 1.1 * turn @ direction(*np.radians([rng.uniform(-75, 75), rng.uniform(-15, 35)]))
            else:
                away = rng.standard_normal(3)
                away *= 0.85 / np.linalg.norm(away)
            camera = frame_points(middle + away, middle, points, SIZE, FINEST_PIXEL)
            small = studio.rasteriser.draw(vertices, subject.faces, camera.resized((64, 64)))
            drawn = small.face[small.face >= 0]
            share = float((studio.face_part[drawn] == PARTS.index(part)).sum())
            # any direction that sees at least most of what the best one sees will do: do not favour one side
            if share > 1.25 * most:
                best, most = camera, share
        assert best is not None
        cameras[part] = best
    return cameras


class DetectorOf(NamedTuple):
    """The detector that looked at a person's videos."""

    mistakes: Mistakes
    seed: int  # seed of the person's bias


def take_set(
    studio: Studio,
    stands: list[BarePose],
    folder: Path,
    light: FilmLight,
    seed: int,
    looks: DetectorOf | None = None,
) -> Iterator[str]:
    """Write one set of held-out pictures (images, masks, parts, views.npz); yields the name of each picture.

    `looks`: the detector whose keypoints are written as well; None: none are.
    """
    for kind in ("images", "masks", "parts", *(() if looks is None else ("keypoints",))):
        (folder / kind).mkdir(parents=True)
    rows: list[tuple[int, str, Camera]] = []
    for i, (axis_angle, root) in enumerate(stands):
        vertices = studio.posed(axis_angle, root)
        turn = matrix_from_axis_angle(axis_angle)
        head = turn[0] @ turn[JOINTS.index("spine1")] @ turn[JOINTS.index("spine2")] @ turn[JOINTS.index("spine3")]
        head = head @ turn[JOINTS.index("neck")] @ turn[JOINTS.index("head")]
        for view, camera in view_cameras(studio, vertices, seed + 1000 * (i + 1), head).items():
            photo = studio.take(vertices, camera, light)
            name = f"{i:06d}_{view}"
            write_photo(folder, name, photo)
            if looks is not None:
                seeds = [looks.seed, seed, len(rows)]
                detector = Detector(studio.subject, studio.rasteriser, camera, looks.mistakes, seeds)
                found = detector.look(axis_angle, root, vertices)
                detector.write(folder / "keypoints" / f"{name}.json", found)
            rows.append((i, view, camera))
            yield name
    number, view, cameras = zip(*rows)
    with whole_file(folder / "views.npz") as file:
        np.savez(
            file, pose=np.array(number), view=np.array(view), K=np.stack([camera.K for camera in cameras]),
            camera_from_world=np.stack([camera.camera_from_world for camera in cameras]), size=np.array([SIZE, SIZE]),
            poses=np.stack([pose for pose, _ in stands]), root=np.stack([root for _, root in stands]),
        )  # fmt: skip


def write_photo(folder: Path, name: str, photo: Photo) -> None:
    """images/NAME.png, masks/NAME.png and, where the folder has one, parts/NAME.png."""
    write_png(folder / "images" / f"{name}.png", photo.image)
    write_png(folder / "masks" / f"{name}.png", photo.mask)
    if (folder / "parts").is_dir():
        write_png(folder / "parts" / f"{name}.png", photo.parts)


def write_png(path: Path, pixels: UInt8[np.ndarray, "..."]) -> None:
    """A picture file; the folder it is in is written whole, so the file need not be."""
    Image.fromarray(pixels).save(path, compress_level=3)


def write_rest(folder: Path, subject: SynthSubject, visible: Bool[np.ndarray, "faces"]) -> None:
    """rest.npz and a picture per material: the subject's own mesh in pose 0."""
    folder.mkdir(exist_ok=True)
    kept = ("vertices", "faces", "uv", "material", "joints", "part", "hair")
    fields: dict[str, Any] = {name: vars(subject)[name] for name in kept}
    if subject.eye is not None:
        fields["eye"] = subject.eye
    places = face_places(subject)
    fields["face"] = np.stack([places[f"face_{number:02d}"] for number in range(68)])
    fields["skin_joints"] = subject.skin.joints.astype(np.uint8)
    fields["skin_weights"] = subject.skin.weights.astype(np.float32)
    with whole_file(folder / "rest.npz") as file:
        np.savez_compressed(file, visible=visible, **fields)
    for i, texture in enumerate(subject.textures):
        write_png(folder / f"texture_{i}.png", texture)
