"""Twelve people drawn from seeds, each from four sides and the face close by: docs/pictures/people.png.

python -m experiments.people_sheet docs/pictures/people.png [SEED ...]
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from avatar.rotation import axis_angle_from_matrix
from avatar.skeleton import JOINTS, PARTS
from files.whole import whole_file
from player.draw.raster import Rasteriser
from player.gl.context import open_context
from synth.film import frame_points, rotation
from synth.light import STILL
from synth.people.person import person
from synth.photo import Studio

SIDES = (0, 90, 180, 270)  # degrees that the person has turned
GROUND = 232
COLORS = 256


def tiles(studio: Studio, side: int) -> list[UInt8[np.ndarray, "side _ 3"]]:
    """The person from four sides with lowered arms, then the head from the left and from before."""
    subject, shots = studio.subject, []
    for turn in (*SIDES, 35, 0):
        pose = np.zeros((len(JOINTS), 3))
        pose[0] = axis_angle_from_matrix(rotation(y=turn))
        shoulders = [JOINTS.index("left_shoulder"), JOINTS.index("right_shoulder")]
        pose[shoulders, 2] = -1.15, 1.15
        vertices = studio.posed(pose, np.zeros(3))
        seen = vertices
        if len(shots) >= len(SIDES):
            face = vertices[(subject.part == PARTS.index("head")) & ~subject.hair]
            seen = np.concatenate([face + [0, 0.06, 0], face - [0, 0.10, 0]])
        middle = (seen.min(0) + seen.max(0)) / 2
        camera = frame_points(middle + [0, 0.2, 3.4], middle, seen, side)
        photo = studio.take(vertices, camera, STILL["fixed"])
        picture = np.where(photo.mask[..., None] > 0, photo.image, np.uint8(GROUND))
        # people are narrow
        cut = side // 5 if len(shots) < len(SIDES) else side // 8
        shots.append(picture[:, cut : side - cut])
    return shots


def main(argv: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.people_sheet", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("seeds", type=int, nargs="*", default=list(range(1, 13)))
    parser.add_argument("--side", type=int, default=512, help="pixels of a picture")
    parser.add_argument("--width", type=int, default=1400, help="pixels of the sheet")
    options = parser.parse_args(argv)
    rows = []
    with open_context() as context:
        rasteriser = Rasteriser(context)
        for seed in options.seeds:
            subject = person(seed)
            print(f"{subject.name}: {len(subject.vertices)} vertices, {len(subject.faces)} faces")
            rows.append(np.concatenate(tiles(Studio(rasteriser, subject, 2), options.side), 1))
    rows += [np.full_like(rows[0], GROUND)] * (len(rows) % 2)
    page = Image.fromarray(np.concatenate([np.concatenate(rows[i : i + 2], 1) for i in range(0, len(rows), 2)]))
    page = page.resize((options.width, page.height * options.width // page.width), Image.Resampling.LANCZOS)
    with whole_file(options.out) as file:
        page.quantize(COLORS).save(file, "PNG", optimize=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
