"""What each mistake of a detector costs the fitted body: capture/fit against the truth of raw videos.

`python -m experiments.fitting OUT` poses subjects as `synth --raw` films the body's video, makes a detector's keypoints
with one kind of mistake at a time, and fits the free body to them: to keypoints alone, with --outlines to exact masks
as well. Stature is told. Each fit is kept in OUT/rows.json as soon as it is done, and not done again; OUT/fitting.md is
the table, OUT/fitting.png the figure. With --pictures each fit is also drawn over its video, stage by stage:
OUT/SUBJECT_seed_SOURCE.png.
"""

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int, UInt8
from scipy.ndimage import distance_transform_edt

from avatar.body import builtin_body
from avatar.skeleton import PARTS
from bench.ladder.machine import commit
from bench.report.writer import markdown_table
from capture.fit import body
from capture.fit.focal import Focal, focal_of_videos
from capture.fit.footage import Estimate, Footage, footage_of
from capture.fit.person import person_of
from capture.fit.scan import FOCAL, FOUND, GIVEN, GUESSED, names_and_joints
from capture.keypoints.openpose import NAMES
from capture.keypoints.record import Keypoints, keypoints_of
from capture.read.video import TRACK
from experiments.filmed_masks import Faults, filmed_masks
from experiments.fitting_pictures import write_pictures
from experiments.fitting_scores import Truth, scores
from experiments.program import end_with
from files.input_file import read_json_object
from files.whole import whole_file, write_json, write_text
from player.draw.raster import Rasteriser
from player.gl.context import open_context
from synth.command import load_subject
from synth.cutout import cut_out
from synth.photo import Studio
from synth.raw.detector import KEPT, Detector, Mistakes
from synth.raw.film import RATE
from synth.raw.movement import EMPTY, ENTERING, RawShots, plan_raw_video
from synth.visibility import visible_faces

Array = np.ndarray

# of the turn
SECONDS = 20.0
# of the table: key of a score, heading
COLUMNS = {
    "joints": "limb joints, aligned, cm", "joints_in_place": "in place", "depth": "too near", "p2s": "P2S, aligned",
    "p2s_in_place": "in place", "degrees": "poses, degrees", "focal": "focal length over the true one",
}  # fmt: skip


@dataclass(frozen=True)
class Source:
    """One kind of mistake."""

    name: str
    says: str
    mistakes: Mistakes
    sway: float = 0.0
    told: bool = True  # the focal length
    wrong_stature: float = 0.0  # metres
    # masks too large (or, negative, too small) by so many pixels of 1080; keypoints alone do not see it
    rim: float = 0.0
    # masks as they are made of a film with these faults
    film: Faults | None = None


CLEAN, ALL = Mistakes(0.0, 0.0, clumsy=False), Mistakes(4.0, 0.01)
SOURCES = (
    Source("exact", "nothing", CLEAN),
    Source("noise", "4 px of 1080", Mistakes(4.0, 0.0, clumsy=False)),
    Source("bias", "1 cm a point", Mistakes(0.0, 0.01, clumsy=False)),
    Source("clumsy", "outliers, exchanged sides", Mistakes(0.0, 0.0)),
    Source("sway", "the person sways", CLEAN, sway=1.0),
    Source("all", "all of these", ALL, sway=1.0),
    Source("stature", "all, stature 1 cm too large", ALL, sway=1.0, wrong_stature=0.01),
    Source("focal", "all, focal length from all four videos", ALL, sway=1.0, told=False),
    Source("wide_masks", "masks 2 px of 1080 too large", CLEAN, rim=2.0),
    Source("narrow_masks", "masks 2 px of 1080 too small", CLEAN, rim=-2.0),
    Source("own_masks", "masks made of a faultless film", CLEAN, film=Faults()),
    Source("exposure", "the same, exposure rolls", CLEAN, film=Faults(exposure=1.0)),
    Source("sensor", "the same, sensor noise", CLEAN, film=Faults(noise=1.0)),
    Source("phone_file", "the same, H.264 as a phone writes (crf 20)", CLEAN, film=Faults(crf=20)),
    Source("sent_on", "the same, H.264 as messengers send (crf 32)", CLEAN, film=Faults(crf=32)),
)
NAMED = {source.name: source for source in SOURCES}


class Seen(NamedTuple):
    """A body's video, and what is true of it."""

    footage: Footage
    truth: Truth
    stature: float


class Filming:
    """Makes the footage of one subject."""

    def __init__(self, name: str, rasteriser: Rasteriser):
        self.rasteriser = rasteriser
        self.studio = Studio(rasteriser, cut_out(load_subject(name)))
        subject = self.studio.subject
        self.visible = visible_faces(rasteriser, subject.vertices, subject.faces)
        self.sex = "female" if name.endswith(":female") else "male"
        # scalps that hair hides are hair: what is left of the two stored people is some 3 cm short
        stored = name.removesuffix(f":{self.sex}") == "builtin"
        bare = builtin_body(self.sex).vertices if stored else subject.vertices[~subject.hair]
        self.stature = float(np.ptp(bare[:, 1]))

    def seen(self, source: Source, seed: int, frames: int, size: int, *, outlines: bool) -> Seen:
        """The body's video with one source of mistakes."""
        wide = 2 * round(size * 16 / 9 / 2), 2 * round(size / 2)
        shots, chosen, keypoints = self._looked(source, "body", seed, frames, wide)
        masks = np.zeros((frames, wide[1], wide[0]), np.uint8)
        if outlines and source.film is not None:
            masks = filmed_masks(self.studio, shots, chosen, keypoints, source.film, [seed, 0])
        elif outlines:
            for mask, f in zip(masks, chosen):
                vertices = self.studio.posed(shots.axis_angle[f], shots.root[f])
                mask[:] = self._mask(shots, vertices, source.rim * size / 1080)
        focal, doubt = float(shots.camera.K[0, 0]), GIVEN
        if not source.told:
            focal, doubt = self._focal(source, seed, wide).shorter_sides * min(wide), FOUND
        footage = footage_of(keypoints, masks, body.body_names(), body.MOVING, focal=focal, focal_sigma=doubt)
        truth = Truth(self.studio.subject, self.visible, shots, chosen)
        return Seen(footage, truth, self.stature + source.wrong_stature)

    def _looked(
        self, source: Source, part: str, seed: int, frames: int, size: tuple[int, int]
    ) -> tuple[RawShots, Int[Array, "frames"], Keypoints]:
        """What a detector finds in frames of one video, spread over the turn."""
        shots = plan_raw_video(self.studio, part, size, SECONDS, RATE, source.sway, seed)
        chosen = np.linspace(round((EMPTY + ENTERING) * RATE), len(shots.root) - 1, frames).astype(int)
        detector = Detector(self.studio.subject, self.rasteriser, shots.camera, source.mistakes,
                            [seed, PARTS.index(part)])  # fmt: skip
        rows = np.zeros((frames, len(NAMES), 3))
        for i, f in enumerate(chosen):
            if i:
                _pass_over(detector, int(f - chosen[i - 1] - 1))
            pose = shots.axis_angle[f], shots.root[f]
            found = detector.look(*pose, self.studio.posed(*pose))
            if found is not None:
                rows[i] = found
        return shots, chosen, keypoints_of(NAMES, rows, size)

    def _focal(self, source: Source, seed: int, size: tuple[int, int]) -> Focal:
        """What `import video` finds from the points of all four videos."""
        footages = {}
        for part in PARTS:
            _, _, keypoints = self._looked(source, part, seed, TRACK, size)
            masks = np.broadcast_to(np.uint8(0), (TRACK, size[1], size[0]))
            footages[part] = footage_of(keypoints, masks, *names_and_joints(part), focal=FOCAL * min(size),
                                        focal_sigma=GUESSED)  # fmt: skip
        person = person_of(self.sex, self.stature + source.wrong_stature)
        return focal_of_videos(person, footages, lambda note: None)

    def _mask(self, shots: RawShots, vertices: Array, rim: float) -> UInt8[Array, "height width"]:
        """The person's share of each pixel, the outline moved outwards by `rim` pixels."""
        width, height = shots.camera.size
        twice = shots.camera.resized((2 * width, 2 * height))
        drawn = self.rasteriser.draw(vertices, self.studio.subject.faces, twice).face >= 0
        if rim:
            # to the nearest pixel's middle on the other side: the outline is half a pixel nearer
            inside, outside = np.asarray(distance_transform_edt(drawn)), np.asarray(distance_transform_edt(~drawn))
            drawn = np.where(drawn, 0.5 - inside, outside - 0.5) < 2 * rim
        return np.round(255 * drawn.reshape(height, 2, width, 2).mean((1, 3))).astype(np.uint8)


def fitted_stages(seen: Seen, sex: str, *, outlines: bool) -> tuple[dict[str, Estimate], float]:
    """The estimate after each stage of the fit, and the processor time of all."""
    clock = time.process_time()
    person = person_of(sex, seen.stature)
    stages = {"first guess": body.first_guess(person, seen.footage)[0]}
    stages["keypoints"], restored = body.fit_keypoints(person, seen.footage, lambda note: None)
    if outlines:
        stages["outlines"] = body.fit_outlines(stages["keypoints"], restored, lambda note: None)
    return stages, time.process_time() - clock


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table: one line for each source and kind of input, mean over subjects and seeds, largest in brackets."""
    table = []
    for source, witness, group in _groups(rows):
        cells = []
        for key in COLUMNS:
            values = [row["scores"][key] for row in group]
            digits = 3 if key == "focal" else 2
            cells.append(f"{np.mean(values):.{digits}f} ({max(values, key=abs):.{digits}f})")
        table.append([source.says, witness, str(len(group)), *cells])
    lines = markdown_table(["mistakes", "input", "fits", *COLUMNS.values()], table)
    commits = sorted({str(row["commit"]) for row in rows})
    subjects = sorted({f"{row['subject']} seed {row['seed']}" for row in rows})
    frames = sorted({f"{row['frames']} frames of {row['size']} px" for row in rows})
    lines += ["", f"Mean (largest) of {', '.join(subjects)}; {', '.join(frames)}; commit {', '.join(commits)}."]
    return "\n".join(lines) + "\n"


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Limb joints of each source: a bar for the mean, a dot for each fit."""
    from matplotlib.figure import Figure

    groups = _groups(rows)
    figure = Figure(figsize=(8, 1.0 + 0.34 * len(groups)), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for ax, key, title in ((left, "joints", "limb joints, aligned, cm"), (right, "joints_in_place", "in place, cm")):
        for i, (_, witness, group) in enumerate(groups):
            values = [row["scores"][key] for row in group]
            ax.barh(i, np.mean(values), color="tab:blue" if witness == "keypoints" else "tab:orange", alpha=0.6)
            ax.plot(values, [i] * len(values), ".", color="0.2")
        ax.set_xlabel(title, fontsize=8)
        ax.tick_params(labelsize=7)
    left.set_yticks(range(len(groups)), [f"{source.says}; {witness}" for source, witness, _ in groups])
    left.invert_yaxis()
    with whole_file(path) as file:
        figure.savefig(file, format="png")


def _groups(rows: list[dict[str, Any]]) -> list[tuple[Source, str, list[dict[str, Any]]]]:
    """Rows of each source and kind of input, in the order of SOURCES."""
    found = []
    for source in SOURCES:
        for witness in ("keypoints", "keypoints, outlines"):
            group = [row for row in rows if (row["source"], row["input"]) == (source.name, witness)]
            if group:
                found.append((source, witness, group))
    return found


def _pass_over(detector: Detector, frames: int) -> None:
    """Frames that the detector does not look at."""
    kept = KEPT**frames
    fresh = detector.rng.standard_normal(detector.lasting.shape)
    detector.lasting = kept * detector.lasting + np.sqrt(1 - kept**2) * fresh
    detector.exchanged_for = max(0, detector.exchanged_for - frames)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m experiments.fitting", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("out", type=Path, help="folder for the results")
    parser.add_argument(
        "--subjects", nargs="+", default=["builtin", "builtin:female"], help="built-in people or rigged humanoid files"
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1])
    parser.add_argument("--sources", nargs="+", choices=list(NAMED), default=list(NAMED), help="mistakes to make")
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--size", type=int, default=540, help="pixels of the pictures' shorter side")
    parser.add_argument("--outlines", action="store_true", help="go on with exact masks: outlines, then offsets")
    parser.add_argument("--pictures", action="store_true", help="draw each fit over frames of its video, by stages")
    given = parser.parse_args(argv)
    given.out.mkdir(parents=True, exist_ok=True)
    path, witness = given.out / "rows.json", "keypoints, outlines" if given.outlines else "keypoints"
    rows = read_json_object(path, "rows of fits")["rows"] if path.exists() else []
    version = commit()
    identity = lambda row: tuple(row[key] for key in ("subject", "seed", "source", "input", "frames", "size"))
    for name in given.subjects:
        with open_context() as context:
            rasteriser, filming = Rasteriser(context), None
            for seed in given.seeds:
                for source in given.sources:
                    if (NAMED[source].rim or NAMED[source].film) and not given.outlines:
                        continue
                    row = {"subject": name, "seed": seed, "source": source, "input": witness, "frames": given.frames,
                           "size": given.size, "commit": version}  # fmt: skip
                    pictures = given.out / f"{Path(name).stem.replace(':', '_')}_{seed}_{source}.png"
                    known = identity(row) in map(identity, rows)
                    if known and not (given.pictures and not pictures.exists()):
                        continue
                    filming = filming or Filming(name, rasteriser)
                    seen = filming.seen(NAMED[source], seed, given.frames, given.size, outlines=given.outlines)
                    stages, spent = fitted_stages(seen, filming.sex, outlines=given.outlines)
                    row["scores"] = scores(list(stages.values())[-1], seen.footage, seen.truth)
                    row["scores"] |= {"cpu_s": round(spent, 1)}
                    heading = f"{name} seed {seed}, {NAMED[source].says}"
                    print(f"{heading}: {json.dumps(row['scores'])}", flush=True)
                    if given.pictures:
                        write_pictures(pictures, filming.studio, seen.truth, seen.footage, stages, heading)
                    if known:
                        continue
                    rows.append(row)
                    write_json(path, {"rows": rows})
    write_text(given.out / "fitting.md", markdown(rows))
    plot(rows, given.out / "fitting.png")
    print(markdown(rows))
    return 0


if __name__ == "__main__":
    end_with(main)
