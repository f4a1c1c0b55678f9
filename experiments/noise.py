"""What noise in a capture costs: pose noise and wrong masks, trained with pose refinement off and on.

`python -m experiments.noise OUT --capture CAP` copies the capture with noise added, trains each copy and scores the run
on the held-out pictures of the capture itself, whose poses are exact. Every step leaves a file in OUT; what is
there already is not done again. OUT/noise.json and OUT/noise.md say how many dB each noise costs, of all rows in OUT.
"""

import argparse
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage

from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import PARTS
from bench.report.writer import markdown_table, number
from command.errors import AssetError
from command.stages import command
from experiments.program import end_with, note
from experiments.short_training import begun
from files.input_file import read_json_object
from files.npz import read_npz
from files.picture import read_picture
from files.whole import whole_folder, write_json, write_text

# dB that a noise may cost with refinement on
ALLOWED = 0.5
REGIONS = ("total", "head", "hands")
CHOICES = ("off", "auto", "on")  # of refinement


@dataclass(frozen=True)
class Noise:
    """One kind of noise."""

    name: str
    says: str
    # standard deviation of each joint about each axis
    degrees: float = 0.0
    # pixels the masks are dilated by; eroded where negative
    grow: int = 0


NOISES = (
    Noise("none", "the capture as it is"),
    Noise("poses", "2 degrees of pose noise", degrees=2.0),
    Noise("eroded", "masks eroded by 2 px", grow=-2),
    Noise("dilated", "masks dilated by 2 px", grow=2),
    Noise("poses_eroded", "2 degrees of pose noise, masks eroded by 2 px", degrees=2.0, grow=-2),
)


def noisy_capture(capture: Path, out: Path, noise: Noise, seed: int) -> None:
    """A copy of a capture without its truth, with noise on the poses and masks that a learner is told.

    Raises:
        AssetError: a file of the capture cannot be read.
    """
    with whole_folder(out) as folder:
        shutil.copytree(capture, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("truth"))
        for number, part in enumerate(PARTS):
            poses = folder / part / "poses.npz"
            if noise.degrees and poses.exists():
                rng = np.random.default_rng([seed, number, 7])
                _disturb(poses, noise.degrees, rng)
            if noise.grow:
                for path in sorted((folder / part / "masks").glob("*.png")):
                    _regrow(path, noise.grow)
        facts = read_json_object(folder / "capture.json", "a capture")
        facts["noise"] = noise.says
        write_json(folder / "capture.json", facts)


def _disturb(path: Path, degrees: float, rng: np.random.Generator) -> None:
    fields = read_npz(path, "poses", ("poses",), ("trans", "betas", "gender", "mocap_framerate", "up_axis"))
    given = fields["poses"].reshape(-1, 52, 3)
    noise = np.radians(degrees) * rng.standard_normal(given.shape)
    noisy = matrix_from_axis_angle(given) @ matrix_from_axis_angle(noise)
    fields["poses"] = axis_angle_from_matrix(noisy).reshape(len(given), -1)
    np.savez(path, allow_pickle=False, **fields)


def _regrow(path: Path, grow: int) -> None:
    """Dilate or erode a mask with a disc; what lies beyond the image counts as the mask."""
    mask = read_picture(path, "L") > 127
    r = abs(grow)
    y, x = np.mgrid[-r : r + 1, -r : r + 1]
    disc = x * x + y * y <= r * r
    changed = ndimage.binary_dilation(mask, disc) if grow > 0 else ndimage.binary_erosion(mask, disc, border_value=1)
    Image.fromarray(255 * np.asarray(changed, np.uint8)).save(path)


def make_rows(
    out: Path, capture: Path, names: list[str], refine: list[str], *, seed: int, poses: int | None, extra: list[str]
) -> None:  # fmt: skip
    """Train and score every noise with every choice of refinement, those not done before."""
    for noise in (n for n in NOISES if n.name in names):
        given = out / f"capture_{noise.name}"
        for choice in refine:
            run, score = out / f"run_{noise.name}_{choice}", out / f"{noise.name}_{choice}.json"
            if not score.exists():
                if not given.exists():
                    noisy_capture(capture, given, noise, seed)
                if not run.exists():
                    resume = ["--resume"] if begun(run) else []
                    _selfscan("train", given, "-o", run, "--refine-poses", choice, "--seed", seed, *extra, *resume)
                few = [] if poses is None else ["--poses", poses]
                _selfscan("eval", run, capture, "--json", score, *few)


def rows_in(out: Path) -> list[dict]:
    """All rows that were scored in OUT."""
    rows = []
    for noise in NOISES:
        for choice in CHOICES:
            score = out / f"{noise.name}_{choice}.json"
            if score.exists():
                quality = read_json_object(score, "a result of `selfscan eval --json`")
                commit = quality.get("machine", {}).get("commit")
                rows.append(
                    {"noise": noise.name, "says": noise.says, "refine": choice, "commit": commit, **numbers(quality)}
                )
    return rows


def numbers(quality: dict) -> dict[str, float | None]:
    """Novel-pose PSNR of the regions and P2S of all, from the JSON of `selfscan eval`."""
    scored = quality["novel_pose"]
    return {name: scored[name].get("psnr_db") for name in REGIONS} | {"p2s_cm": scored["total"].get("p2s_cm")}


def lost(rows: list[dict]) -> list[dict]:
    """Rows with the dB that each lost against the capture as it is, trained with the default ("auto") or "off"."""
    clean = {row["refine"]: row for row in rows if row["noise"] == "none"}
    reference = clean.get("off") or clean.get("auto") or clean.get("on")
    if reference is None:
        return rows
    out = []
    for row in rows:
        losses = {f"{name}_lost": reference[name] - row[name] for name in REGIONS
                  if reference[name] is not None and row[name] is not None}  # fmt: skip
        met = all(value < ALLOWED for value in losses.values())
        out.append(row | {name: round(value, 3) for name, value in losses.items()} | {"met": met})
    return out


def markdown(rows: list[dict], command: str) -> str:
    """The table as a page."""
    lines = [
        "# What noise costs",
        "",
        f"Novel-pose PSNR (dB) and, in brackets, dB lost against the capture as it is. Allowed: {ALLOWED} dB.",
        f"Command: `{command}`",
        "",
    ]
    table = []
    for row in rows:
        cells = [f"{row[name]:.2f} ({row.get(f'{name}_lost', 0):+.3f})" if row[name] is not None else "-"
                 for name in REGIONS]  # fmt: skip
        met = {True: "yes", False: "no", None: ""}[row.get("met")]
        table.append([row["says"], row["refine"], *cells, number(row["p2s_cm"], 3), met, row.get("commit") or ""])
    head = ["noise", "refinement", *REGIONS, "P2S cm", "met", "commit"]
    return "\n".join([*lines, *markdown_table(head, table)]) + "\n"


def _selfscan(*arguments: object) -> None:
    words = ["selfscan", *map(str, arguments)]
    note(" ".join(words))
    code = command(*words)()
    if code:
        raise AssetError(f"`{' '.join(words)}` ended with {code}")


def main(argv: list[str] | None = None) -> int:
    """The command line; see `python -m experiments.noise --help`."""
    parser = argparse.ArgumentParser(prog="python -m experiments.noise", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument(
        "out", metavar="OUT", type=Path, help="folder for captures, runs and the page; resumed if there"
    )
    parser.add_argument("--capture", type=Path, required=True, help="capture folder with truth/ (selfscan synth)")
    parser.add_argument("--noise", nargs="+", choices=[n.name for n in NOISES], default=[n.name for n in NOISES])
    parser.add_argument("--refine", nargs="+", choices=CHOICES, default=["off", "auto"])
    parser.add_argument("--poses", type=int, help="score only that many poses of each held-out set")
    parser.add_argument("--iterations", type=int, help="steps per part, instead of the preset's")
    parser.add_argument("--seed", type=int, default=0)
    argv = sys.argv[1:] if argv is None else argv
    options = parser.parse_args(argv)
    if not (options.capture / "truth" / "rest.npz").is_file():
        raise AssetError(f"{options.capture}: expected a capture with truth/, made by `selfscan synth`")
    options.out.mkdir(parents=True, exist_ok=True)
    extra = [] if options.iterations is None else ["--iterations", str(options.iterations)]
    make_rows(options.out, options.capture, options.noise, options.refine, seed=options.seed, poses=options.poses,
              extra=extra)  # fmt: skip
    rows = lost(rows_in(options.out))
    text = markdown(rows, "python -m experiments.noise " + " ".join(argv))
    write_json(options.out / "noise.json", {"format": "selfscan-noise", "rows": rows})
    write_text(options.out / "noise.md", text)
    print(text)
    return 0


if __name__ == "__main__":
    end_with(main)
