"""What four raw videos become, in one picture: a frame of each, and below it the avatar, close enough to be recognised.

python -m experiments.from_pixels_picture me avatar.glb -o docs/pictures/from_pixels.png
"""

import argparse
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from avatar import read_avatar
from avatar.camera import orbit_camera
from avatar.skeleton import JOINTS, PARTS, joint_transforms
from capture.check.sheet import contact_sheet
from capture.raw.four_videos import find_videos
from capture.raw.video_file import open_video, read_frames
from experiments.program import end_with
from files.whole import whole_file
from player import OffscreenRenderer, motion_for

Array = np.ndarray

SIDE = 400
# of a video, that is shown: somebody is in it, and seen from the front
SHARE = 0.4
# of the motion `counting`
FRAME = 40
# joint, metres above it, metres from the camera and its turn
VIEWS = {
    "the avatar, in a motion": ("pelvis", -0.08, 3.5, 0.3),
    "its head": ("head", 0.08, 0.62, 0.2),
    "its left hand": ("left_middle1", 0.0, 0.45, 0.4),
    "its right hand": ("right_middle1", 0.0, 0.45, -0.3),
}


def filmed(path: Path) -> UInt8[Array, "height width 3"]:
    """One frame of a video."""
    video = open_video(path)
    return next(read_frames(video, only=frozenset([int(SHARE * video.frames)]))).picture


def posed(path: Path) -> list[tuple[str, UInt8[Array, "height width 3"]]]:
    """The avatar from near and far."""
    avatar = read_avatar(path)
    clip = motion_for(avatar, "counting").read(FRAME, FRAME + 1)
    axis_angle, root = clip.axis_angle[0], clip.root[0]
    place = joint_transforms(axis_angle, np.asarray(avatar.joint_positions), root)[:, :3, 3]
    shown = []
    with OffscreenRenderer(avatar, size=(SIDE, SIDE)) as renderer:
        for caption, (joint, above, away, turn) in VIEWS.items():
            target = place[JOINTS.index(joint)] + [0, above, 0]
            camera = orbit_camera(target, away, turn, 0.05, (SIDE, SIDE))
            shown.append((caption, renderer.draw(axis_angle, root, camera=camera)[..., :3]))
    return shown


def main(argv: Sequence[str] | None = None) -> int:
    """The command line; see `python -m experiments.from_pixels_picture --help`."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.from_pixels_picture", description="Four raw videos and the avatar made of them."
    )
    parser.add_argument("videos", metavar="DIR", type=Path, help="body.mp4, head.mp4, left.mp4, right.mp4")
    parser.add_argument("avatar", metavar="AVATAR", type=Path, help="avatar file (.glb) that was made of them")
    parser.add_argument("-o", "--out", metavar="PNG", type=Path, required=True)
    given = parser.parse_args(argv)
    videos = find_videos([given.videos])
    rows = [[(videos[part].name, filmed(videos[part])) for part in PARTS], posed(given.avatar)]
    picture = io.BytesIO()
    contact_sheet(rows, SIDE).save(picture, format="PNG")
    with whole_file(given.out) as file:
        file.write(picture.getvalue())
    return 0


if __name__ == "__main__":
    end_with(main)
