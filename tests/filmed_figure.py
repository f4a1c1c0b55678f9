"""Small videos of a painted figure that turns before a wall, with the keypoints that a detector would find.

Discs along the limbs, each limb its own colour, so that the truth of every pixel is known; a second of empty wall comes
first unless `empty` is false. MMPose's JSON, since it is one file a video.
"""

import json
import shutil

import av
import numpy as np
from scipy import ndimage

from capture.keypoints.orders import COCO_WHOLEBODY as NAMES
from capture.keypoints.record import hand_points

SIZE = (240, 180)
FRAMES, ABSENT, RATE = 90, 24, 30
# of the body: x to the person's left and y down, in pixels from the middle of the trunk
BODY = {
    "nose": (0, -48), "left_eye": (3, -51), "right_eye": (-3, -51), "left_ear": (7, -49), "right_ear": (-7, -49),
    "left_shoulder": (14, -32), "right_shoulder": (-14, -32), "left_elbow": (34, -32), "right_elbow": (-34, -32),
    "left_wrist": (56, -32), "right_wrist": (-56, -32), "left_hip": (8, 8), "right_hip": (-8, 8),
    "left_knee": (10, 36), "right_knee": (-10, 36), "left_ankle": (11, 64), "right_ankle": (-11, 64),
    "left_heel": (11, 68), "right_heel": (-11, 68), "left_big_toe": (13, 70), "right_big_toe": (-13, 70),
    "left_small_toe": (15, 70), "right_small_toe": (-15, 70),
}  # fmt: skip
LINES = [
    ("left_shoulder", "right_shoulder", 9), ("left_shoulder", "left_wrist", 5), ("right_shoulder", "right_wrist", 5),
    ("left_shoulder", "left_hip", 9), ("right_shoulder", "right_hip", 9), ("left_hip", "left_ankle", 6),
    ("right_hip", "right_ankle", 6), ("nose", "nose", 12), ("left_hip", "right_hip", 8),
]  # fmt: skip
COLORS = np.array([[200, 60, 50], [40, 60, 150], [190, 140, 110], [60, 130, 70], [230, 220, 90]])


def wall(seed=0):
    """Structured in both directions, noisy where the camera looks."""
    rng = np.random.default_rng(seed)
    out = (150, 145, 135) + 25 * ndimage.gaussian_filter(rng.standard_normal((SIZE[1], SIZE[0], 1)), (2, 2, 0)) / 0.15
    out[20:50, 20:70] = (90, 110, 140)
    out[110:150, 180:220] = (120, 90, 70)
    return np.clip(out, 30, 230)


def points_of(part, turn):
    """Names to pixels from the middle of the picture, at a heading in turns."""
    c = np.cos(2 * np.pi * turn)
    if part == "body":
        return {name: (x * (0.35 + 0.65 * abs(c)) * np.sign(c if c else 1), y + 0.0) for name, (x, y) in BODY.items()}
    if part == "head":
        names = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
        face = {name: (2.5 * BODY[name][0] * (0.5 + 0.5 * c), 2.5 * (BODY[name][1] + 48)) for name in names}
        return face | {"left_shoulder": (50, 75), "right_shoulder": (-50, 75)}
    side = part.removeprefix("hand_")
    out = {}
    for k, name in enumerate(hand_points(side)):
        finger, joint = divmod(k - 1, 4)
        angle = np.radians(-60 + 30 * finger)
        reach = 0 if k == 0 else 24 + 12 * joint
        out[name] = (reach * np.sin(angle) * (0.4 + 0.6 * abs(c)), 30 - reach * np.cos(angle))
    return out | {f"{side}_wrist": (0, 32), f"{side}_elbow": (5, 100)}


def lines_of(part):
    if part == "body":
        return LINES
    if part == "head":
        return [("nose", "nose", 34), ("left_shoulder", "right_shoulder", 22)]
    side = part.removeprefix("hand_")
    fingers = [(f"{side}_hand", f"{side}_{finger}_tip", 6) for finger in ("thumb", "index", "middle", "ring", "pinky")]
    return [*fingers, (f"{side}_wrist", f"{side}_elbow", 11)]


def painted(part, turn, picture, shift=(0, 0)):
    """The figure before a picture of the room, its mask, and names to pixels."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    pixels, mask = np.stack([x, y], -1), np.zeros(SIZE[::-1], bool)
    middle = np.array(SIZE) / 2 + shift
    at = {name: middle + place for name, place in points_of(part, turn).items()}
    for n, (a, b, radius) in enumerate(lines_of(part)):
        along = at[b] - at[a]
        t = np.clip((pixels - at[a]) @ along / max(along @ along, 1e-9), 0, 1)
        limb = np.linalg.norm(pixels - at[a] - t[..., None] * along, axis=-1) < radius
        picture = np.where(limb[..., None], COLORS[n % 5] + 20 * np.sin(x / 2 + n)[..., None], picture)
        mask |= limb
    return picture, mask, at


def film(folder, part, name, *, empty=True, shift=(0, 0), still=True, second=False, upside_down=False, blurred=()):
    """Write NAME.mp4 and keypoints/PART.json; returns the true masks."""
    rng = np.random.default_rng(len(part))
    room, masks, instances = wall(), [], []
    (folder / "keypoints").mkdir(exist_ok=True)
    path = folder / f"{name}.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=RATE, options={"crf": "16", "g": "30"})
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for i in range(FRAMES):
            picture = room * (1 + 0.02 * np.sin(i / 9))
            if not still:
                picture = np.roll(picture, round(6 * i / FRAMES), axis=1)
            mask = np.zeros(SIZE[::-1], bool)
            people = []
            if i >= ABSENT or not empty:
                picture, mask, at = painted(part, max(0, i - ABSENT) / (FRAMES - ABSENT), picture, shift)
                people.append(at)
                if second:
                    people.append({k: (0.5 * px, 0.8 * py + 20) for k, (px, py) in at.items()})
            if i in blurred:
                picture = ndimage.gaussian_filter(picture, (3, 3, 0))
            picture = np.clip(picture + rng.normal(0, 1.5, picture.shape), 0, 255).astype(np.uint8)
            instances.append({"frame_id": i, "instances": [_person(p, rng, upside_down) for p in people]})
            picture = picture[::-1, ::-1] if upside_down else picture
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")))
            masks.append(mask)
        container.mux(stream.encode(None))
    (folder / "keypoints" / f"{part}.json").write_text(json.dumps({"instance_info": instances}))
    return np.array(masks)


def _person(at, rng, upside_down):
    rows = np.zeros((len(NAMES), 2))
    for k in [k for k, name in enumerate(NAMES) if name in at]:
        # MMPose counts pixels from the middle of the first one
        place = np.array(at[NAMES[k]]) - 0.5 + 0.4 * rng.standard_normal(2)
        rows[k] = np.array(SIZE) - 1 - place if upside_down else place
    return {"keypoints": rows.tolist(), "keypoint_scores": [0.9 * (name in at) for name in NAMES]}


NAMES_OF_FILES = {"body": "body", "head": "head", "hand_left": "left", "hand_right": "right"}


def film_all(folder):
    """Four videos; returns the true masks by part."""
    return {part: film(folder, part, name) for part, name in NAMES_OF_FILES.items()}


def film_anew(filmed_four, folder, part, **changed):
    """The four videos of `filmed_four` in `folder`, one of them filmed otherwise; returns that one's true masks."""
    shutil.copytree(filmed_four, folder, dirs_exist_ok=True)
    return film(folder, part, NAMES_OF_FILES[part], **changed)
