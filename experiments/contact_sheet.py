"""Contact sheets: truth | field | baked of one person in novel poses with close-ups.

python -m experiments.contact_sheet RUN AVATAR CAPTURE -o contact.png
"""

import argparse
from pathlib import Path

import numpy as np

from avatar.texture import bytes_of
from bench.field.drawer import Drawer
from bench.ladder.rung_pictures import spread_poses
from bench.report.sheet import save_sheet, sheet
from bench.score.metrics import rectangle
from capture.folder import read_capture_facts
from capture.held_out import HeldOutView, read_held_out
from experiments.program import end_with

VIEW_TITLE = {"body": "", "head": "face", "hand_left": "left hand", "hand_right": "right hand"}
# pictures of field and avatar take 2 x 2 samples a pixel: the truth is smoothed as well
SAMPLES = 2


def contact_sheet(run: Path | None, avatar: Path | None, capture: Path, out: Path) -> None:
    """Write the sheet of one person: rows of two poses, each truth | field | baked; bodies, face, both hands."""
    sources = {"field": Drawer(run) if run else None, "baked": Drawer(avatar) if avatar else None}
    drawers = {name: drawer for name, drawer in sources.items() if drawer is not None}
    try:
        facts = read_capture_facts(capture)
        views = read_held_out(capture, "novel_pose")
        rows, titles = [], []
        for kind, count in (("body", 4), ("head", 4), ("hand_left", 2), ("hand_right", 2)):
            for view in spread_poses(views, kind, count):
                tiles = [view.image()]
                tiles += [d.draw(view.axis_angle, view.root, view.camera, SAMPLES).color for d in drawers.values()]
                where = square_about(view)
                rows.append([bytes_of(tile[where]) for tile in tiles])
                names = ["truth", *drawers]
                titles.append([f"{VIEW_TITLE[kind]} {name}, pose {view.pose_index}".strip() for name in names])
        heading = f"{facts.get('subject', capture.name)}, {facts.get('light', '?')} light, novel poses"
        save_sheet(out, sheet(rows, titles, heading, columns=2))
    finally:
        for drawer in drawers.values():
            drawer.release()


def square_about(view: HeldOutView) -> tuple[slice, slice]:
    """The whole close-up; of a body view the square round the person, a little wider."""
    width, height = view.camera.size
    where = rectangle(view.mask()) if view.view == "body" else None
    if where is None:
        return slice(0, height), slice(0, width)
    (top, bottom), (left, right) = ((side.start, side.stop - 1) for side in where)
    side = min(int(1.06 * max(bottom - top, right - left)) + 4, height, width)
    top = int(np.clip((top + bottom - side) // 2, 0, height - side))
    left = int(np.clip((left + right - side) // 2, 0, width - side))
    return slice(top, top + side), slice(left, left + side)


def main(argv: list[str]) -> None:
    parser = argparse.ArgumentParser("python -m experiments.contact_sheet", description="Contact sheet of a person.")
    parser.add_argument("run", type=Path)
    parser.add_argument("avatar", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("-o", dest="out", type=Path, required=True, metavar="SHEET.png")
    options = parser.parse_args(argv)
    contact_sheet(options.run, options.avatar, options.capture, options.out)


if __name__ == "__main__":
    end_with(main)
