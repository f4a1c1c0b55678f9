"""Masks of raw videos beside the true ones: `python -m experiments.own_masks ME...`.

ME is a folder of `synth --raw --keypoints`; its true masks, one in some frames, are in ME/truth. For the films of body
and head: intersection over union, pixels too many and pixels missing as shares of the person, and how many of them lie
farther than two pixels from the true outline, where no softness of an edge explains them. Prints a line for each film
and the mean of each kind.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array
from scipy.ndimage import binary_dilation, binary_erosion

from capture.raw.four_videos import examine_videos
from capture.raw.judge import Judged
from capture.raw.masks import soft_mask
from capture.raw.plate import plate_of_empty
from capture.raw.video_file import read_frames
from files.picture import read_picture

FILMS = ("body", "head")
BESIDE = 2  # pixels


class Off(NamedTuple):
    """How far masks are off, percent of the person's pixels but for the first."""

    iou: float
    extra: float
    missing: float
    extra_far: float
    missing_far: float


def compared(found: Bool[Array, "frames height width"], true: Bool[Array, "frames height width"]) -> Off:
    """All frames of a film as one."""
    near = np.ones((1, 3, 3), bool)
    outside = ~np.asarray(binary_dilation(true, near, iterations=BESIDE), bool)
    inside = binary_erosion(true, near, iterations=BESIDE)
    share = 100 / true.sum()
    counts = [(found & ~true).sum(), (true & ~found).sum(), (found & outside).sum(), (~found & inside).sum()]
    return Off(float((found & true).sum() / (found | true).sum()), *(float(share * count) for count in counts))


def film_off(judged: Judged, truth: Path) -> Off:
    """The masks of one film against those in the folder `truth`."""
    at = judged.glance
    true = {int(path.stem): read_picture(path, "L") > 127 for path in sorted(truth.glob("*.png"))}
    true = {number: mask for number, mask in true.items() if mask.any()}
    plate = plate_of_empty(at.video, np.flatnonzero(judged.empty))
    found = [
        soft_mask(frame.picture, plate, at.keypoints, frame.number) > 127
        for frame in read_frames(at.video, only=frozenset(true))
    ]
    return compared(np.stack(found), np.stack(list(true.values())))


def line(name: str, off: Off) -> str:
    """One row of the table."""
    return (f"{name:32s} IoU {off.iou:.3f}, too many {off.extra:.1f} %, missing {off.missing:.1f} %; farther than "
            f"{BESIDE} px: {off.extra_far:.2f} and {off.missing_far:.2f} %")  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("films", nargs="+", type=Path, metavar="ME", help="folder of `synth --raw --keypoints`")
    rows: dict[str, list[Off]] = {film: [] for film in FILMS}
    for folder in parser.parse_args(argv).films:
        seen = examine_videos([folder], None)
        for film in FILMS:
            rows[film].append(film_off(seen[film], folder / "truth" / film / "masks"))
            print(line(f"{folder.name} {film}", rows[film][-1]), flush=True)
    for film, found in rows.items():
        print(line(f"mean {film}", Off(*np.mean(found, 0))))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
