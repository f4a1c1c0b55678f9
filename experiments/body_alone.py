"""The body alone, of pictures with masks and keypoints of any tools: no close-ups, and no video.

The first step of `capture.fit.scan.fit_scan` by itself. Hands keep the rest pose, head and hands are as fine as
pictures of a body show them, and the focal length has one witness. For looking at what the fit makes of pictures; an
avatar is trained on four videos.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from avatar.motion.clip import spread_frames
from capture.fit.body import fit_body, sides_restored
from capture.fit.footage import Estimate, Footage
from capture.fit.person import person_of
from capture.fit.refusals import check_fit, check_footage, check_upright
from capture.fit.scan import footage_in, phone_of, posed_video, template_of
from capture.keypoints.read import read_keypoints
from capture.raw.scan import FittedVideo, RawVideo
from capture.read.folder import pictures_in, read_mask
from capture.read.template import TemplateMesh
from command.errors import AssetError
from files.picture import picture_size


class BodyAlone(NamedTuple):
    """The person in pose 0, and poses and the camera of every picture; `estimate` and `footage` are the fit's own."""

    template: TemplateMesh
    video: FittedVideo
    estimate: Estimate
    footage: Footage


def pictures_of_body(
    pictures: Path, masks: Path, keypoints: Path, *, focal: float | None = None, most: int = 60
) -> RawVideo:
    """At most `most` pictures of a folder, evenly spread, with their masks and points.

    Masks (a folder; 0 and 1, or 0 and 255) and keypoints (`read_keypoints`) are in the order of the pictures. `focal`:
    focal length in pixels, where known.

    Raises:
        AssetError: a folder that is empty or has another number of files, pictures or masks of several sizes, or what
            the keypoints' reader refuses.
    """
    files, drawn = pictures_in(pictures), pictures_in(masks)
    size = picture_size(files[0])
    points = read_keypoints(keypoints, size=size)
    for path, what, count in ((masks, "masks", len(drawn)), (keypoints, "frames of keypoints", len(points.pixels))):
        if count != len(files):
            raise AssetError(f"{path}: expected {len(files)} {what}, one for each picture in {pictures}, found {count}")
    if points.size is not None and points.size != size:
        raise AssetError(f"{keypoints}: expected points in pictures of {size} pixels, found {points.size}")
    chosen = spread_frames(len(files), most)
    held = np.stack([255 * read_mask(drawn[i], size, any_value=False).astype(np.uint8) for i in chosen])
    return RawVideo("body", size, 30.0, chosen, tuple(files[i] for i in chosen), held, points.of_frames(chosen), focal)


def fit_body_alone(
    video: RawVideo, *, sex: str = "male", stature: float | None = None, report: Callable[[str], None] = lambda _: None
) -> BodyAlone:
    """The person of a body's video or pictures. `sex` and `stature` as for `fit_scan`; `report` follows each step.

    Raises:
        AssetError: too few points, points that are not of the masks' person, or a fit that explains too little.
    """
    footage = footage_in(video, phone_of([video]))
    check_footage("body", footage)
    check_upright(footage)
    estimate = fit_body(person_of(sex, stature), footage, report)
    usable = check_fit("body", estimate, sides_restored(estimate, footage))
    return BodyAlone(template_of(estimate), posed_video(estimate, footage, usable, level=True), estimate, footage)
