"""Close-ups that were not filmed: head and hands cut from the body's video, as large as that shows them."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from avatar.camera import project
from avatar.skeleton import JOINTS, PARTS
from capture.frame_files import write_picture
from capture.raw.scan import FittedScan, FittedVideo, RawVideo
from capture.read.close_up import PartMasks
from command.errors import AssetError
from geometry.rasterise import rasterise

# metres beside the part that are cut out with it: hair, fingers that are bent otherwise
BESIDE = {"head": 0.15, "hand_left": 0.06, "hand_right": 0.06}
FOREARMS = {"head": (), "hand_left": (JOINTS.index("left_elbow"),), "hand_right": (JOINTS.index("right_elbow"),)}
# share of a hand's box that may show other parts of the person
COVERED = 0.15
LEAST = 4  # frames


def cut_close_up(part: str, body: RawVideo, fitted: FittedScan, work: Path) -> tuple[RawVideo, FittedVideo]:
    """One part in every frame of the body's video that shows it alone, cut out into the folder `work`.

    Raises:
        AssetError: these are too few.
    """
    fit, template = fitted.videos[part], fitted.template
    place = PartMasks(template, part, fitted.landmarks)
    own = np.flatnonzero(template.part == PARTS.index(part))
    # faces of what neither is the part nor the forearm before it
    near = (template.part == PARTS.index(part)) | np.isin(template.skin.heaviest, FOREARMS[part])
    other = ~near[template.faces].all(1)
    frames, boxes = [], []
    for i in np.flatnonzero(fit.usable & fitted.videos["body"].usable).tolist():
        posed, camera = place.placed(fit, i), fit.cameras[i]
        # the pixels round the part, and some beside it: left and top, right and bottom
        pixels, depth = project(camera, posed[own])
        room = np.ceil(BESIDE[part] * place.unit * camera.K[0, 0] / np.median(depth))
        box = np.stack([np.floor(pixels.min(0)) - room, np.ceil(pixels.max(0)) + room]).astype(int)
        if part != "head":
            # hands are as the body's video holds them: the whole person is posed
            (left, top), (width, height) = box[0].tolist(), (box[1] - box[0]).tolist()
            face = rasterise(posed, template.faces, camera.cropped(left, top, (width, height))).face
            if (other[face] & (face >= 0)).mean() >= COVERED:
                continue
        frames.append(i)
        boxes.append(box)
    if len(frames) < LEAST:
        raise AssetError(f"body video: shows the {part} alone in {len(frames)} frames, expected {LEAST}: film it too")
    # windows of one size that hold the boxes, inside of the picture
    box = np.array(boxes)
    width, height = (int(n) for n in np.minimum((box[:, 1] - box[:, 0]).max(0), body.size))
    size = width, height
    low = np.clip((box.sum(1) - size) // 2, 0, np.array(body.size) - size)
    for name in ("images", "masks"):
        (work / name).mkdir(parents=True, exist_ok=True)
    cameras, masks, paths = [], [], []
    for n, i in enumerate(frames):
        left, top = low[n].tolist()
        window = np.s_[top : top + height, left : left + width]
        masks.append(body.masks[i][window])
        paths.append(work / "images" / f"{n:06d}.png")
        write_picture(paths[-1], body.picture(i)[window])
        write_picture(work / "masks" / f"{n:06d}.png", masks[-1])
        cameras.append(fit.cameras[i].cropped(left, top, size))
    points = body.keypoints.of_frames(np.array(frames))
    points = replace(points, pixels=points.pixels - low[:, None], size=size)
    raw = RawVideo(part, size, body.rate, body.frames[frames], tuple(paths), np.stack(masks), points, None)
    angles, root = (None if values is None else values[frames] for values in (fit.axis_angle, fit.root))
    return raw, FittedVideo(tuple(cameras), angles, root, np.ones(len(frames), bool))
