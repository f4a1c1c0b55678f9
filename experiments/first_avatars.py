"""People from raw videos by `selfscan make`: what comes out, person by person, in one table and one sheet.

    python -m experiments.first_avatars builtin:1 White_F.glb:female -o out/first --size 400 --seconds 3

PERSON is what `selfscan synth` takes; `:female` after a file is the free body that the fit begins with. Everybody is
filmed by one phone in one room (OUT/PERSON/raw: four videos, a simulated detector's keypoints, held-out pictures apart
in truth/), made into an avatar (OUT/PERSON/me.glb) and judged by `selfscan eval`. What exists is kept: the same command
goes on. OUT/first_avatars.json, README.md and sheet.jpg are of those who are named.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from bench.report.writer import markdown_table, number
from command.command_line import Help, Option, parse
from command.errors import AssetError
from command.settings import AtLeast
from command.stages import Stage, command, run_stages
from experiments.beside_sheet import write_sheet
from experiments.claim import folder_of, person_and_sex, settle, stature_of
from experiments.claim_page import number_of, numbers
from experiments.program import distinct, end_with, note, written
from files.input_file import read_json_object
from files.whole import write_json, write_text

REGIONS = ("total", "head", "hands")
# heading; row and metric of `eval --json`, the region's name in place of *; digits
COLUMNS = (
    ("P2S aligned, cm", ("beside", "filmed_aligned", "*", "p2s_cm"), 2),
    ("way back, 95 %, cm", ("beside", "filmed_aligned", "*", "back_95_cm"), 1),
    ("limbs' / fingers' joints aligned, cm", ("beside", "filmed_joints_aligned", "*"), 2),
    ("outlines of novel poses, mean", ("novel_pose", "total", "outline_iou"), 3),
    ("the worst of them", ("novel_pose", "total", "outline_worst"), 3),
    ("outlines of the T-pose, mean of eight sides", ("beside", "t_pose", "total", "outline_iou"), 2),
    ("features of the face, aligned by themselves, mm", ("beside", "t_pose", "head", "face_mm"), 1),
    ("the same on the aligned head, mm", ("beside", "t_pose", "head", "face_on_head_mm"), 1),
    ("novel views, box, dB", ("novel_view", "*", "psnr_db"), 1),
    ("novel views, mask, dB", ("novel_view", "*", "psnr_mask_db"), 1),
    ("novel poses, box, dB", ("novel_pose", "*", "psnr_db"), 1),
    ("novel poses, mask, dB", ("novel_pose", "*", "psnr_mask_db"), 1),
    ("eyes in novel views, dB", ("novel_view", "eyes", "psnr_db"), 1),
)
# minutes on two idle cores: of filming and of judging a person
FILMING, JUDGING = 3.0, 3.0


@dataclass(frozen=True)
class Filming:
    """How everybody is filmed."""

    size: Annotated[int, AtLeast(96), "pixels of the videos' shorter side"] = 400
    seconds: Annotated[float, "of the turn in each video"] = 3.0
    truth_every: Annotated[int, AtLeast(1), "of the 20 held-out poses and 10 views film only every N-th"] = 6
    seed: Annotated[int, "of filming"] = 0

    @property
    def words(self) -> list[str]:
        """As `synth` takes them."""
        return ["--raw", "--keypoints", "--held-out", "--truth-every", str(self.truth_every), "--size",
                str(self.size), "--seconds", f"{self.seconds:g}", "--seed", str(self.seed)]  # fmt: skip


@dataclass(frozen=True)
class Options(Filming):
    """What decides the numbers; a folder holds those of one of them."""

    minutes: Annotated[Literal["4", "6"], "as `make` takes them: 4, nothing learned; 6, the head"] = "4"


@dataclass(frozen=True)
class FirstAvatars:
    people: Annotated[tuple[str, ...], Option(positional=True, metavar="PERSON", several=True),
        "builtin, builtin:female, builtin:SEED or a rigged .glb[:female]"]  # fmt: skip
    out: Annotated[Path, Option(("-o", "--out"), "OUT"), "gets README.md, first_avatars.json and sheet.jpg"]
    options: Annotated[Options, "what decides the numbers"]

    def __post_init__(self):
        distinct([folder_of(person) for person in self.people], "people")


ABOUT = Help(
    "python -m experiments.first_avatars",
    "People from four raw videos each by `selfscan make`: one table, one sheet of pictures.",
    "example: python -m experiments.first_avatars builtin:1 White_F.glb:female -o out/first",
)


def stages(options: Options, name: str, out: Path) -> list[Stage]:
    """The commands of one person."""
    person, sex = person_and_sex(name)
    raw, avatar, quality = out / "raw", out / "me.glb", out / "quality.json"

    def make() -> int:
        known = ["--sex", sex, "--stature", f"{stature_of(person):.3f}", "--minutes", str(options.minutes)]
        return command("selfscan", "make", raw, "-o", avatar, *known)()

    run = avatar.with_suffix(".making") / ("first" if options.minutes == "4" else "head")
    film = command("selfscan", "synth", person, raw, *options.words)
    judge = command("selfscan", "eval", avatar, raw, "--run", run, "--json", quality)
    return [
        Stage("film four raw videos", raw / "truth" / "raw.json", film, FILMING),
        Stage("make", avatar, make, int(options.minutes) + 1.0),
        Stage("evaluate", quality, judge, JUDGING),
    ]  # fmt: skip


def cell(results: Sequence[dict[str, Any]], keys: tuple[str, ...], digits: int) -> str:
    """The median over people of a number or of its three regions; a dash where none has it."""
    regions = {}
    for region in REGIONS:
        found = [number_of(result, [region if key == "*" else key for key in keys]) for result in results]
        known = [value for value in found if value is not None]
        regions[region] = float(np.median(known)) if known else None
    return numbers(regions, digits) if "*" in keys else number(regions["total"], digits)


def page(found: dict[str, dict[str, Any]], options: Options) -> str:
    """The table of everybody; the median first."""
    machines = [result.get("machine", {}) for result in found.values()]
    commits = ", ".join(sorted({str(machine.get("commit")) for machine in machines}))
    cpus = ", ".join(sorted({f"{machine.get('cpu')}, {machine.get('cores')} cores" for machine in machines}))
    everybody = {f"median of {len(found)}": list(found.values())} | {name: [one] for name, one in found.items()}
    rows = [[heading, *(cell(some, keys, digits) for some in everybody.values())] for heading, keys, digits in COLUMNS]
    return "\n".join([
        "# People from raw videos, by `selfscan make`",
        "",
        "Written by `python -m experiments.first_avatars`. Four synthetic videos of a phone in a room, a simulated",
        "detector's keypoints, height and sex go in; poses of held-out pictures are fitted to them. Totals, heads and",
        f"hands stand in this order. `--minutes {options.minutes}`; {options.size} px, a turn of {options.seconds:g} s",
        f"in each video, seed {options.seed}; every {options.truth_every}th held-out picture.",
        f"{cpus}, commit {commits}.",
        "",
        "Surfaces and joints: poses of the person's own videos, after ICP, head and hands by themselves. Outlines: IoU",
        "of the whole person in held-out pictures; of the T-pose from eight sides. Features: brows, nose and lips.",
        "Box: with its black background, which flatters; mask: the true person alone.",
        "",
        *markdown_table(["", *everybody], rows),
        "",
        "![Truth and avatar side by side, two columns of people: face, side of the head, front, back](sheet.jpg)",
        "",
    ])  # fmt: skip


def main(argv: Sequence[str]) -> int:
    given = parse(FirstAvatars, argv, ABOUT)
    options, out = given.options, given.out
    settle(out, asdict(options))
    absent, found, pairs = [], {}, []
    for name in given.people:
        folder = out / folder_of(name)
        note(folder.name)
        folder.mkdir(parents=True, exist_ok=True)
        try:
            run_stages(stages(options, name, folder))
        except AssetError as error:
            absent.append(f"{folder.name}: {error}")
            continue
        found[folder.name] = read_json_object(folder / "quality.json", "a result of `selfscan eval --json`")
        pairs.append((person_and_sex(name)[0], folder / "me.glb"))
    if not found:
        raise AssetError(f"{out}: nobody was made: {'; '.join(absent)}")
    write_json(out / "first_avatars.json", {"options": asdict(options), "people": found, "absent": absent})
    write_sheet(out / "sheet.jpg", pairs)
    write_text(out / "README.md", page(found, options))
    return written(out / "README.md", absent, "made")


if __name__ == "__main__":
    end_with(main)
