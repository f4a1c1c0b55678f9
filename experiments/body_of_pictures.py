"""What the fit makes of somebody's pictures: the body alone, drawn over them.

    python -m experiments.body_of_pictures PICTURES MASKS KEYPOINTS -o OUT --stature 1.78

PICTURES and MASKS are folders of the same number of pictures, in the order of their names, of a person who turns before
a camera that stands still; KEYPOINTS is what `selfscan import video` takes (OpenPose, COCO-WholeBody, MediaPipe), for
each of them. OUT gets overlays.png (outline, bones and points), body.ply (pose 0), subject.npz (the template as in a
capture), poses.npz (a motion that `selfscan render` plays) and fit.json (stature, focal length, what was left out).
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import UInt8

from avatar.motion.amass import write_amass
from avatar.motion.clip import Clip
from bench.report.sheet import save_sheet, sheet
from capture.fit.refusals import misfits
from capture.fit.scan import STEPS
from capture.raw.scan import RawVideo
from capture.read.template import write_template
from command.progress import Progress
from experiments.body_alone import BodyAlone, fit_body_alone, pictures_of_body
from experiments.fitting_pictures import overlay, shown_frames
from experiments.program import end_with
from files.whole import check_folder, whole_file, whole_folder, write_json

# of a motion whose pictures have no times
RATE = 30.0
# of the person's larger extent, what is shown
AROUND = 1.15


def write_fit(out: Path, video: RawVideo, found: BodyAlone) -> None:
    """Everything into `out`, whole or not at all."""
    template, estimate, footage = found.template, found.estimate, found.footage
    assert found.video.axis_angle is not None and found.video.root is not None
    with whole_folder(out) as folder:
        write_template(folder / "subject.npz", template)
        write_amass(folder / "poses.npz", Clip(found.video.axis_angle, found.video.root, RATE), up="y")
        with whole_file(folder / "body.ply") as file:
            file.write(trimesh.Trimesh(template.vertices, template.faces, process=False).export(file_type="ply"))
        frames = shown_frames(footage)
        tiles = [round_person(overlay(video.picture(i), estimate, footage, i), video.masks[i]) for i in frames]
        titles = [video.pictures[i].name for i in frames]
        save_sheet(folder / "overlays.png", sheet([tiles], [titles], str(out), columns=1))
        facts = {
            "stature": float(np.ptp(template.vertices[:, 1])),
            "focal": float(estimate.camera(footage).K[0, 0]),
            "distance": float(-estimate.root[:, 2].mean()),
            "keypoints_off_pixels": float(np.nanmedian(misfits(estimate, footage))),
            "left_out": [video.pictures[i].name for i in np.flatnonzero(~found.video.usable)],
        }
        write_json(folder / "fit.json", facts)


def round_person(
    picture: UInt8[np.ndarray, "height width 3"], mask: UInt8[np.ndarray, "height width"]
) -> UInt8[np.ndarray, "side side 3"]:
    """A square round the person; grey where the picture ends."""
    rows, columns = np.nonzero(mask > 127)
    if not len(rows):
        rows, columns = np.indices(mask.shape).reshape(2, -1)
    side = round(AROUND * max(np.ptp(rows), np.ptp(columns)))
    top, left = (int(rows.max() + rows.min()) - side) // 2, (int(columns.max() + columns.min()) - side) // 2
    margin = side + max(mask.shape)
    page = np.pad(picture, ((margin, margin), (margin, margin), (0, 0)), constant_values=128)
    return page[top + margin : top + margin + side, left + margin : left + margin + side]


def main(argv: Sequence[str] | None = None) -> int:
    """The command line; see `python -m experiments.body_of_pictures --help`."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.body_of_pictures",
        description="The body alone, fitted to pictures with masks and keypoints of any tools, and drawn over them.",
        epilog="example: python -m experiments.body_of_pictures images masks openpose -o out/me --stature 1.78",
    )
    parser.add_argument("pictures", type=Path, metavar="PICTURES", help="folder; a person who turns, camera standing")
    parser.add_argument("masks", type=Path, metavar="MASKS", help="folder; one for each picture, 0 and 255")
    parser.add_argument("keypoints", type=Path, metavar="KEYPOINTS", help="OpenPose, COCO-WholeBody or MediaPipe")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="OUT", help="folder to write")
    parser.add_argument("--sex", choices=("male", "female"), default="male", help="of the free body that is begun with")
    parser.add_argument("--stature", type=float, metavar="METRES", help="without it, the free body's")
    parser.add_argument("--focal", type=float, metavar="PX", help="focal length in pixels (default: found)")
    parser.add_argument("--frames", type=int, default=60, metavar="N", help="most pictures that are used (default: 60)")
    given = parser.parse_args(argv)
    if given.frames < 3:
        parser.error(f"--frames should be at least 3, is {given.frames}")
    if given.stature is not None and not 0.5 <= given.stature <= 2.5:
        parser.error(f"--stature should be 0.5 to 2.5 metres, is {given.stature:g}")
    if given.focal is not None and not given.focal > 0:
        parser.error(f"--focal should be above 0, is {given.focal:g}")
    given.out.parent.mkdir(parents=True, exist_ok=True)
    check_folder(given.out)
    video = pictures_of_body(given.pictures, given.masks, given.keypoints, focal=given.focal, most=given.frames)
    progress, done = Progress("fitting", STEPS["body"]), 0

    def report(step: str) -> None:
        nonlocal done
        done += 1
        progress.update(done, step)

    found = fit_body_alone(video, sex=given.sex, stature=given.stature, report=report)
    write_fit(given.out, video, found)
    print(given.out / "overlays.png")
    return 0


if __name__ == "__main__":
    end_with(main)
