"""Quality against time from raw films: each avatar that `selfscan make` leaves is judged, beside when it was there.

    python -m experiments.minutes builtin White_F.glb:female -o out/minutes --minutes 15

PERSON is what `selfscan synth` takes, as for `experiments.first_avatars`, whose films these are. All are filmed first,
then made one after the other, of four videos and of the body's alone, then judged: only the second of these is timed,
and wants a machine with nothing else to do. What exists is kept: the same command goes on; who was not made in one go
has no time. OUT/minutes.json, README.md, minutes.png and sheet.jpg are of those who are named.
"""

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from avatar.gltf.avatar_file import read_avatar
from avatar.skeleton import JOINTS, PARTS
from bench.ladder.machine import commit, cpu_name
from bench.report.writer import markdown_table, number
from command.command_line import Help, Option, parse
from command.errors import AssetError
from command.progress import clock_time
from command.stages import Stage, command, run_stages
from experiments.beside_sheet import Shot, avatar_tiles, save_tiles, true_tiles
from experiments.claim import folder_of, person_and_sex, settle, stature_of
from experiments.claim_page import number_of
from experiments.first_avatars import FILMING, JUDGING, Filming, cell
from experiments.program import distinct, end_with, note, written
from files.input_file import read_json_object
from files.whole import whole_file, write_json, write_text

# folder and heading of what `make` is given
FILMS = {"four": "four videos", "body": "the body's video alone"}
# file that `make` leaves, its run folder, heading; in the order in which they come
AVATARS = (
    ("first", "first", "first avatar"),
    ("head", "head", "learned head"),
    ("fields_15", "fields_15", "fields, short training"),
    ("fields_60", "fields_60", "fields, whole training"),
)
# heading, row and metric of `eval --json` with the region's name in place of *, digits
COLUMNS = (
    ("P2S aligned, cm", ("beside", "filmed_aligned", "*", "p2s_cm"), 2),
    ("way back, 95 %, cm", ("beside", "filmed_aligned", "*", "back_95_cm"), 1),
    ("novel poses, mask, dB", ("novel_pose", "*", "psnr_mask_db"), 1),
    ("novel poses, FLIP", ("novel_pose", "*", "flip"), 3),
    ("novel views, mask, dB", ("novel_view", "*", "psnr_mask_db"), 1),
    ("eyes in novel views, dB", ("novel_view", "eyes", "psnr_db"), 1),
)
# what the figure draws: heading, metric, regions
DRAWN = (
    ("new poses, on the person, PSNR dB (higher is better)", COLUMNS[2][1]),
    ("surface to the true one, aligned, cm (lower is better)", COLUMNS[0][1]),
)
COLORS = {"total": "tab:blue", "head": "tab:orange", "hands": "tab:green"}
FACE, HAND = (
    Shot(JOINTS.index("head"), 0.08, 0.3, 0.72, 30.0),
    Shot(JOINTS.index("left_middle1"), 0.0, 0.9, 0.5, 30.0),
)


@dataclass(frozen=True)
class Options(Filming):
    """What decides the numbers; a folder holds those of one of them."""

    minutes: Annotated[Literal["4", "6", "15", "60"], "as `make` takes them; the body's video alone is given 4"] = "15"


@dataclass(frozen=True)
class Minutes:
    people: Annotated[tuple[str, ...], Option(positional=True, metavar="PERSON", several=True),
        "builtin, builtin:female, builtin:SEED or a rigged .glb[:female]"]  # fmt: skip
    out: Annotated[Path, Option(("-o", "--out"), "OUT"), "gets README.md, minutes.json, minutes.png and sheet.jpg"]
    options: Annotated[Options, "what decides the numbers"]

    def __post_init__(self):
        distinct([folder_of(person) for person in self.people], "people")


ABOUT = Help(
    "python -m experiments.minutes",
    "Quality against time from raw films: each avatar that `selfscan make` leaves, judged, and when it was there.",
    "example: python -m experiments.minutes builtin White_F.glb:female -o out/minutes --minutes 15",
)


class Made(NamedTuple):
    """An avatar that `make` leaves: of which films, its heading, its file, its run folder."""

    films: str
    name: str
    file: Path
    run: Path

    @property
    def quality(self) -> Path:
        return self.file.with_suffix(".json")


def avatars(folder: Path) -> list[Made]:
    """What `make` has left of a person's four videos and of the body's alone."""
    every = [
        Made(films, heading, folder / films / "me.making" / f"{stem}.glb", folder / films / "me.making" / run)
        for films in FILMS
        for stem, run, heading in AVATARS
    ]
    return [made for made in every if made.file.exists()]


def make_stage(person: str, sex: str, folder: Path, films: str, minutes: str) -> Stage:
    """`make` of a person's films, which notes when each avatar was there; where it was stopped and goes on, nothing."""
    out, clock = folder / films, folder / films / "seconds.json"
    source = folder / "raw" if films == "four" else folder / "raw" / "body.mp4"

    def run() -> int:
        known = ["--sex", sex, "--stature", f"{stature_of(person):.3f}", "--minutes", minutes]
        fresh, began = not out.exists(), time.time()
        out.mkdir(exist_ok=True)
        code = command("selfscan", "make", source, "-o", out / "me.glb", *known)()
        if code == 0:
            there = [one.file for one in avatars(folder) if one.films == films]
            seconds = {file.stem: file.stat().st_mtime - began if fresh else None for file in there}
            where = f"{cpu_name()}, {os.cpu_count()} cores, commit {commit()}"
            write_json(clock, {"machine": where, "seconds": seconds})
        return code

    return Stage(f"make of {FILMS[films]}", clock, run, int(minutes) + 1.0)


def off_the_films(avatar: Path) -> float:
    """How far what an avatar shows lies from the films that its textures were solved against: root mean square of
    255, the mean over the films."""
    videos = read_avatar(avatar).provenance["baked"]["videos"]
    return sum(videos[part]["rms_after"] for part in PARTS) / len(PARTS)


def judged(made: Made) -> dict[str, Any]:
    """What `eval` found, when the avatar was there and where it was made, and how far it lies from the films."""
    found = read_json_object(made.quality, "a result of `selfscan eval --json`")
    clock = read_json_object(made.file.parents[1] / "seconds.json", "when each avatar was there")
    off = off_the_films(made.file) if made.films == "four" else None
    seconds = clock["seconds"].get(made.file.stem)
    return found | {"films": made.films, "avatar": made.name, "seconds": seconds, "off_films": off,
                    "made": clock["machine"]}  # fmt: skip


def table(some: list[dict[str, Any]], chosen: str) -> list[str]:
    """A line for each avatar of one kind of films: the median over the people who have it."""
    rows = []
    for name in dict.fromkeys(result["avatar"] for result in some):
        same = [result for result in some if result["avatar"] == name]
        seconds = [result["seconds"] for result in same if result["seconds"] is not None]
        off = [result["off_films"] for result in same if result["off_films"] is not None]
        rows.append([
            f"{chosen}: {name}",
            clock_time(float(np.median(seconds))) if seconds else "-",
            number(float(np.median(off)) if off else None, 1),
            *(cell(same, keys, digits) for _, keys, digits in COLUMNS),
        ])  # fmt: skip
    return rows


def page(found: dict[str, list[dict[str, Any]]], options: Options) -> str:
    """The medians over all people, and the tables of each."""
    everybody = [result for results in found.values() for result in results]
    places = "; ".join(sorted({result["made"] for result in everybody}))
    commits = ", ".join(sorted({str(result.get("machine", {}).get("commit")) for result in everybody}))
    head = ["", "ready after", "off its films, of 255", *(heading for heading, _, _ in COLUMNS)]
    lines = [
        "# Quality against time, from raw films",
        "",
        "Written by `python -m experiments.minutes`. Synthetic videos of a phone in a room, a simulated detector's",
        "keypoints, height, sex go in (*from pixels*); `selfscan make` leaves avatars, each is judged. *Ready after*:",
        "from the command's start, films to file, poses included; before the first there is nothing to see. *Off its",
        "films*: root mean square of the textures solved against them. Total, head and hands",
        f"stand in this order. {options.size} px, a turn of {options.seconds:g} s in each video, seed {options.seed};",
        f"every {options.truth_every}th held-out picture. Made on {places}; judged at {commits}.",
        "",
        "Surfaces: poses of the person's own videos, after ICP, head and hands by themselves. Mask: the true person",
        "alone, without the black background.",
        "",
        "![Novel poses and surfaces against the seconds of `make`](minutes.png)",
    ]
    for title, results in {f"Median of {len(found)}": everybody, **found}.items():
        rows = [row for key, name in FILMS.items()
                for row in table([result for result in results if result["films"] == key], name)]  # fmt: skip
        lines += ["", f"## {title}", "", *markdown_table(head, rows)]
    return "\n".join([*lines, "", "![Truth, then each avatar in this order: face, left hand](sheet.jpg)", ""])


def points(results: Sequence[dict[str, Any]], films: str, keys: tuple[str, ...], region: str) -> Iterator[Any]:
    """(seconds, value) of each avatar that has both."""
    for result in results:
        value = number_of(result, [region if key == "*" else key for key in keys])
        if result["films"] == films and result["seconds"] is not None and value is not None:
            yield result["seconds"], value


def plot(found: dict[str, list[dict[str, Any]]], path: Path) -> None:
    """Quality against seconds: faint lines are people, thick ones their median; crosses, the body's video alone."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator

    figure = Figure(figsize=(10, 4.4), dpi=110, layout="constrained")
    for ax, (label, keys) in zip(figure.subplots(1, len(DRAWN)), DRAWN, strict=True):
        for region, color in COLORS.items():
            of_all = [list(points(results, "four", keys, region)) for results in found.values()]
            for line in of_all:
                ax.plot(*zip(*line, strict=True), "o-", color=color, alpha=0.25, ms=3, lw=1) if line else None
            if of_all and len({len(line) for line in of_all}) == 1 and of_all[0]:
                seconds, value = np.median(np.array(of_all), 0).T
                ax.plot(seconds, value, "o-", color=color, ms=5, lw=2, label=f"{region}, four videos, median")
            alone = [p for results in found.values() for p in points(results, "body", keys, region)]
            if alone:
                ax.plot(*np.median(np.array(alone), 0), "x", color=color, ms=8, mew=2, label=f"{region}, body alone")
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.xaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
        ax.set_xlabel("seconds from films to avatar")
        ax.set_ylabel(label)
        ax.grid(alpha=0.3)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    with whole_file(path) as file:
        figure.savefig(file, format="png")


def write_pictures(out: Path, people: Sequence[str]) -> None:
    """A row of faces and one of left hands for each person: truth, then every avatar."""
    rows = []
    for person in people:
        made = avatars(out / folder_of(person))
        tiles = [true_tiles(person_and_sex(person)[0], 512, (FACE, HAND))]
        rows.append(tiles + [avatar_tiles(one.file, 512, (FACE, HAND)) for one in made])
    save_tiles(out / "sheet.jpg", [[tile for row in column for tile in row] for column in zip(*rows, strict=True)])


def main(argv: Sequence[str]) -> int:
    given = parse(Minutes, argv, ABOUT)
    options, out = given.options, given.out
    settle(out, asdict(options))
    told = {name: person_and_sex(name) for name in given.people}
    for name, (person, _) in told.items():
        raw = out / folder_of(name) / "raw"
        raw.parent.mkdir(parents=True, exist_ok=True)
        film = command("selfscan", "synth", person, raw, *options.words)
        run_stages([Stage(f"film {folder_of(name)}", raw / "truth" / "raw.json", film, FILMING)])
    absent, there = [], []
    for name, (person, sex) in told.items():
        note(folder_of(name))
        try:
            for films, minutes in (("four", options.minutes), ("body", "4")):
                run_stages([make_stage(person, sex, out / folder_of(name), films, minutes)])
            there.append(name)
        except AssetError as error:
            absent.append(f"{folder_of(name)}: {error}")
    found: dict[str, list[dict[str, Any]]] = {}
    for name in there:
        folder = out / folder_of(name)
        for made in avatars(folder):
            words = ["selfscan", "eval", made.file, folder / "raw", "--run", made.run, "--json", made.quality]
            run_stages([Stage(f"judge {folder.name}: {made.name}", made.quality, command(*words), JUDGING)])
            found.setdefault(folder.name, []).append(judged(made))
    write_json(out / "minutes.json", {"options": asdict(options), "people": found, "absent": absent})
    if not found:
        raise AssetError(f"{out}: nobody was made: {'; '.join(absent)}")
    plot(found, out / "minutes.png")
    write_pictures(out, there)
    write_text(out / "README.md", page(found, options))
    return written(out / "README.md", absent, "made")


if __name__ == "__main__":
    end_with(main)
