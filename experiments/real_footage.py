"""Films judged without truth: `python -m experiments.real_footage ME [--sex male] [--stature 1.78] [-o OUT]`.

ME holds body.mp4, those of head and hands that there are, and keypoints/, as for `selfscan import video`. The frames of
every film are split into even and odd ones, and a person is fitted to each half alone. What the two say of each other
needs no truth:

- the surfaces' distance in pose 0, mm: what the frames leave open of the shape;
- outlines (intersection over union) and keypoints (pixels of a picture 1080 high) of one half's frames, by the *other*
  half's person in the poses found there: frames left out, as far as shape goes; beside them those of the half's own.

Of a film by `synth --raw --keypoints` the same numbers stand beside the true errors of the poses, with their rank
correlation over frames (Spearman 1904): whether a number that needs no truth tells which frames are wrong.
Writes OUT/real_footage.json and prints the table. No avatar is made, so no pictures are compared.
"""

import argparse
import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation
from scipy.stats import rankdata

from avatar.camera import project
from avatar.skeleton import PARTS, joint_transforms, skin_transforms
from avatar.skinning import skin_points
from capture.fit.points import body_points
from capture.fit.scan import fit_scan
from capture.raw.four_videos import find_videos
from capture.raw.scan import FittedScan, FittedVideo, RawScan, RawVideo
from capture.read.template import TemplateMesh
from capture.read.video import VideoImport, import_video
from command.errors import AssetError
from geometry.rasterise import rasterise

HALVES = ("even", "odd")
# joints whose place is compared with the true one: fingers follow the wrists
LIMBS = list(range(22))
# confidence from which on a keypoint is compared
SURE = 0.5


class Half(NamedTuple):
    """A person fitted to every second frame."""

    raw: RawScan
    fit: FittedScan


class _Fitted(Exception):
    """All that is wanted of an import is there."""


def fitted_halves(folder: Path, work: Path, sex: str, stature: float | None) -> list[Half]:
    """Both halves' fits; frames and masks stay in WORK.partial, so that a second run has them.

    Raises:
        AssetError: a film or its keypoints cannot be used.
    """
    halves: list[Half] = []

    def fit(scan: RawScan) -> FittedScan:
        for k in range(2):
            raw = RawScan({part: every_second(video, k) for part, video in scan.videos.items()})
            halves.append(Half(raw, fit_scan(raw, sex=sex, stature=stature)))
        raise _Fitted

    with suppress(_Fitted):
        import_video(VideoImport(find_videos([folder]), folder / "keypoints"), work, fit)
    return halves


def every_second(video: RawVideo, first: int) -> RawVideo:
    """The frames first, first + 2, ... of those kept, and of the points that are tracked."""
    rows = np.arange(first, len(video.frames), 2)
    track = None if video.track is None else video.track.of_frames(np.arange(first, len(video.track.pixels), 2))
    return replace(
        video, frames=video.frames[rows], pictures=tuple(video.pictures[i] for i in rows), masks=video.masks[rows],
        keypoints=video.keypoints.of_frames(rows), track=track,
    )  # fmt: skip


def off_rigidly(a: Float[Array, "n 3"], b: Float[Array, "n 3"]) -> Float[Array, "n"]:
    """What is left between corresponding points when `a` was moved onto `b` as a rigid body (Kabsch 1976), metres."""
    a, b = a - a.mean(0), b - b.mean(0)
    turn = Rotation.align_vectors(b, a)[0]
    return np.linalg.norm(turn.apply(a) - b, axis=1)


def apart(a: TemplateMesh, b: TemplateMesh) -> dict[str, dict[str, float]]:
    """Distance of the same vertices in pose 0 by part, rigidly aligned: mean and 95 %, mm."""
    out = {}
    for number, part in enumerate(PARTS):
        own = a.part == number
        away = 1e3 * off_rigidly(b.vertices[own], a.vertices[own])
        out[part] = {"mean_mm": round(float(away.mean()), 2), "p95_mm": round(float(np.quantile(away, 0.95)), 2)}
    return out


def outlines(template: TemplateMesh, raw: RawVideo, fit: FittedVideo) -> Float[Array, "frames"]:
    """Intersection over union of each frame's mask and a person in the poses of `fit`; NaN: the frame was left out."""
    assert fit.axis_angle is not None and fit.root is not None
    out = np.full(len(raw.frames), np.nan)
    for i in np.flatnonzero(fit.usable):
        moved = skin_transforms(fit.axis_angle[i], template.joints, fit.root[i], rest=np.zeros((52, 3)))
        vertices = skin_points(template.vertices, template.skin, moved)
        ours, true = rasterise(vertices, template.faces, fit.cameras[i]).face >= 0, raw.masks[i] > 127
        out[i] = (ours & true).sum() / max((ours | true).sum(), 1)
    return out


def keypoints_off(template: TemplateMesh, raw: RawVideo, fit: FittedVideo) -> Float[Array, "frames"]:
    """Median distance of sure keypoints from a person in the poses of `fit`, pixels of a picture 1080 high."""
    assert fit.axis_angle is not None and fit.root is not None
    table, out = body_points(), np.full(len(raw.frames), np.nan)
    named = [k for k, name in enumerate(raw.keypoints.names) if name in table]
    points = [table[raw.keypoints.names[k]] for k in named]
    places = np.stack([point.place(template.vertices, template.joints) for point in points])
    bones = [point.joint for point in points]
    for i in np.flatnonzero(fit.usable):
        moved = skin_transforms(fit.axis_angle[i], template.joints, fit.root[i], rest=np.zeros((52, 3)))[bones]
        at = np.einsum("nij,nj->ni", moved[:, :3, :3], places) + moved[:, :3, 3]
        sure = raw.keypoints.confidence[i, named] > SURE
        off = np.linalg.norm(project(fit.cameras[i], at)[0] - raw.keypoints.pixels[i, named], axis=1)[sure]
        out[i] = np.median(off) * 1080 / min(raw.size) if sure.any() else np.nan
    return out


def true_errors(truth: Path, template: TemplateMesh, raw: RawVideo, fit: FittedVideo) -> Float[Array, "frames"]:
    """How far the joints of each frame are from the true ones after a rigid motion, mean over limbs, cm."""
    assert fit.axis_angle is not None and fit.root is not None
    with np.load(truth / "body" / "video.npz") as film, np.load(truth / "rest.npz") as rest:
        poses, joints = film["poses"], rest["joints"]
    out = np.full(len(raw.frames), np.nan)
    for i in np.flatnonzero(fit.usable):
        true = joint_transforms(poses[raw.frames[i]], joints)[LIMBS, :3, 3]
        ours = joint_transforms(fit.axis_angle[i], template.joints)[LIMBS, :3, 3]
        out[i] = 100 * off_rigidly(ours, true).mean()
    return out


def rank_correlation(a: Float[Array, "n"], b: Float[Array, "n"]) -> float:
    """Spearman's, over what both have."""
    both = np.isfinite(a) & np.isfinite(b)
    return round(float(np.corrcoef(rankdata(a[both]), rankdata(b[both]))[0, 1]), 3)


def judged(halves: Sequence[Half], truth: Path | None) -> dict:
    """All numbers."""
    facts: dict = {"halves_apart": apart(halves[0].fit.template, halves[1].fit.template), "frames": {}}
    for name, own, other in zip(HALVES, halves, halves[::-1], strict=True):
        raw, fit = own.raw.videos["body"], own.fit.videos["body"]
        measures = {
            "iou_left_out": outlines(other.fit.template, raw, fit), "iou_own": outlines(own.fit.template, raw, fit),
            "px_left_out": keypoints_off(other.fit.template, raw, fit),
            "px_own": keypoints_off(own.fit.template, raw, fit),
        }  # fmt: skip
        if truth is not None:
            measures["true_cm"] = true_errors(truth, own.fit.template, raw, fit)
        facts["frames"][name] = {"numbers": raw.frames.tolist()} | {
            key: [None if np.isnan(x) else round(float(x), 4) for x in values] for key, values in measures.items()
        }
    pooled = {key: np.array(facts["frames"][HALVES[0]][key] + facts["frames"][HALVES[1]][key], float)
              for key in facts["frames"][HALVES[0]] if key != "numbers"}  # fmt: skip
    facts["left_out"] = int(np.isnan(pooled["iou_own"]).sum())
    facts["mean"] = {key: round(float(np.nanmean(values)), 4) for key, values in pooled.items()}
    facts["worst"] = {key: round(float((np.nanmin if "iou" in key else np.nanmax)(values)), 4)
                      for key, values in pooled.items()}  # fmt: skip
    if truth is not None:
        facts["rank_with_truth"] = {
            "1 - iou_left_out": rank_correlation(1 - pooled["iou_left_out"], pooled["true_cm"]),
            "px_left_out": rank_correlation(pooled["px_left_out"], pooled["true_cm"]),
        }
    return facts


def table(facts: dict) -> list[str]:
    """The lines that are printed, Markdown."""
    lines = ["| of frames left out | mean | worst | by the half's own person |", "|-|-|-|-|"]
    for label, key in (("outline IoU", "iou"), ("keypoints, px of 1080", "px")):
        own = facts["mean"][f"{key}_own"]
        lines.append(f"| {label} | {facts['mean'][key + '_left_out']:.3f} | {facts['worst'][key + '_left_out']:.3f} | "
                     f"{own:.3f} |")  # fmt: skip
    for part, each in facts["halves_apart"].items():
        lines.append(f"| two halves apart, {part}, mm: mean, 95 % | {each['mean_mm']} | {each['p95_mm']} | |")
    if "rank_with_truth" in facts:
        lines.append(f"| true error of joints, cm | {facts['mean']['true_cm']} | {facts['worst']['true_cm']} | |")
        lines += [f"| rank correlation with it over frames, {key} | {value} | | |"
                  for key, value in facts["rank_with_truth"].items()]  # fmt: skip
    return lines


def main(argv: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m experiments.real_footage", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)  # fmt: skip
    parser.add_argument("folder", type=Path, metavar="ME", help="folder with the films and keypoints/")
    parser.add_argument("--sex", choices=("male", "female"), default="male", help="the free body that is begun with")
    parser.add_argument("--stature", type=float, metavar="METRES", help="height as filmed")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/real_footage"), help="where the numbers go")
    given = parser.parse_args(argv)
    given.out.mkdir(parents=True, exist_ok=True)
    truth = given.folder / "truth"
    try:
        halves = fitted_halves(given.folder, given.out / "work", given.sex, given.stature)
    except AssetError as error:
        parser.exit(2, f"{error}\n")
    facts = judged(halves, truth if (truth / "body" / "video.npz").exists() else None)
    (given.out / "real_footage.json").write_text(json.dumps(facts, indent=1))
    print("\n".join(table(facts)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
