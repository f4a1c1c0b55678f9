"""The film of a face, read: what its keypoints say of the person's shapes, and its pictures of the mouth's colors."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.body import builtin_body
from avatar.motion.clip import spread_frames
from capture.fit.face_film import FaceFit, fit_face, gains_of
from capture.fit.mouth_color import mouth_colors
from capture.keypoints.record import Keypoints
from capture.own_face import FITTED, OwnFace, believed
from capture.raw.four_videos import FACE_FILM, part_keypoints
from capture.raw.video_file import VideoFile, open_video, read_frames

# pictures of an open mouth that colors are taken from; a phone's focal length where nothing is known, shorter sides
PICTURES, FOCAL = 12, 1.5


class FaceFilm(NamedTuple):
    video: VideoFile
    keypoints: Keypoints
    of_anybody: FaceFit  # as if it were the built-in person's


def open_face_film(path: Path, keypoints: Path, like: str) -> FaceFilm:
    """A film that shows a face, with its keypoints out of the folder of all films'.

    Raises:
        AssetError: `open_video`, `part_keypoints`, or too few frames show the face.
    """
    video = open_video(path)
    points = part_keypoints(keypoints, FACE_FILM, video, like)
    vertices, focal = builtin_body("male").vertices, FOCAL * min(video.size)
    return FaceFilm(video, points, fit_face(vertices, points, video.size, focal, video.name))


def own_face(film: FaceFilm, vertices: Float[Array, "vertices 3"], focal: float) -> tuple[OwnFace, list[str]]:
    """What a film says of the person whose template, of the free body, is given, and that in words; `focal` in shorter
    sides of the picture.

    Raises:
        AssetError: too few frames show the face, or the film breaks off.
    """
    video, focal = film.video, focal * min(film.video.size)
    fit = fit_face(vertices, film.keypoints, video.size, focal, video.name)
    found, ah = gains_of(fit, video.rate), FITTED.index("jawOpen")
    rows = np.flatnonzero(found.shown[:, ah] & (not found.why[ah]))
    rows = rows[spread_frames(len(rows), PICTURES)] if len(rows) else rows
    pixels = focal * fit.places[rows, :, :2] / fit.places[rows, :, 2:] + 0.5 * np.array(video.size)
    at = dict(zip(np.flatnonzero(fit.frames)[rows].tolist(), pixels))
    frames = read_frames(video, only=frozenset(at)) if at else ()
    teeth, red = mouth_colors((frame.picture, at[frame.number]) for frame in frames)
    gains = ", ".join(f"{name} {gain:.2f}" for name, gain, why in zip(FITTED, found.gains, found.why) if not why)
    said = [f"{video.name}: this face goes as far as the built-in one, times: {gains or 'none is shown'}"]
    said += [f"{video.name}: {name} stays as built in: {why}" for name, why in zip(FITTED, found.why) if why]
    own = believed(found.gains, found.offsets, teeth, red)
    if own.teeth is None:
        said.append(f"{video.name}: no open mouth shows teeth: they stay as built in")
    return own, said


def shown_line(film: FaceFilm) -> str:
    """What a film shows, in words, before the person is known."""
    video, fit = film.video, film.of_anybody
    lacking = ", ".join(name for name, why in zip(FITTED, gains_of(fit, video.rate).why) if why)
    shows = f"not shown: {lacking}: film it again, or they stay as built in" if lacking else "all shapes are shown"
    (width, height), seconds = video.size, len(fit.frames) / video.rate
    return (
        f"{video.name:<10} {width} x {height}, {video.rate:.0f} frames/s, {seconds:.1f} s; the face in "
        f"{int(fit.frames.sum())} frames; {shows}"
    )
