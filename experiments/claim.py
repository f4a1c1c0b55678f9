"""The claim, made fair: a person from four raw videos, beside what is given and what a shape alone gives.

    python -m experiments.claim builtin White_F.glb:female -o out/claim --steps 200 --poses 2

PERSON is what `selfscan synth` takes; `:female` after a file is the free body that the fit begins with. Everybody is
filmed by one phone in one room (OUT/PERSON/raw: videos with noise, sway and a room behind, a detector's keypoints with
noise and bias, truth apart), and three captures are made of it: *given* (template registered to the true mesh, true
joints, exact poses, masks and cameras, the same light), *shape only* (a free body's shape coefficients, its own joints,
no hair label; masks and cameras exact) and *from pixels* (`selfscan import video`). All are trained alike and judged by
`selfscan eval` on the same held-out pictures. What exists is kept: the same command goes on. OUT/claim.json and
OUT/claim.md hold the tables of all people in OUT.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from capture.folder import INPUTS
from command.command_line import Help, Option, parse
from command.errors import AssetError
from command.settings import AtLeast, OneOf
from command.stages import Stage, command, run_stages
from experiments.claim_page import FORMAT, page
from experiments.light import folder_name
from experiments.program import distinct, end_with, note, written
from experiments.short_training import begun, share_in_words, total_steps, training_words
from files.input_file import read_json_object
from files.whole import write_json, write_text
from synth.people.looks import draw
from train.preset import PRESETS

# minutes on two idle cores: of the raw videos, a second of turn at 360 px; of held-out pictures; of an import, a frame
# at 360 px; of a preset's whole training; of an evaluation, a pose
FILMING, HELD_OUT, IMPORT, TRAINING, POSE = 0.25, 3.0, 0.1, 10.0, 0.7


@dataclass(frozen=True)
class Options:
    """What decides the numbers; a folder holds those of one of them."""

    preset: Annotated[str, OneOf(tuple(sorted(PRESETS)))] = "demo"
    steps: Annotated[int | None, AtLeast(1), "of every part, instead of the preset's"] = None
    size: Annotated[int, AtLeast(96), "pixels of the videos' shorter side"] = 540
    seconds: Annotated[float, "of the turn in each raw video"] = 20.0
    frames: Annotated[int, AtLeast(8), "used of each video"] = 40
    seed: Annotated[int, "of filming and training"] = 0
    poses: Annotated[int, AtLeast(1), "of each held-out set, which has 20"] = 20
    light: Annotated[str, "of everything that is filmed"] = "room"


@dataclass(frozen=True)
class ClaimCommand:
    people: Annotated[tuple[str, ...], Option(positional=True, metavar="PERSON", several=True),
        "builtin, builtin:female or a rigged .glb[:female]"]
    out: Annotated[Path, Option(("-o", "--out"), "OUT"), "gets claim.md and claim.json"]
    options: Annotated[Options, "what decides the numbers"]
    only: Annotated[tuple[str, ...], OneOf(INPUTS), Option(metavar="COLUMN", repeated=True),
        "make no other column (may be given again); what is there stays in the table"] = ()

    def __post_init__(self):
        distinct([folder_of(person) for person in self.people], "people")


ABOUT = Help(
    "python -m experiments.claim",
    "A person from four raw videos beside what is given: one table, three kinds of input.",
    "example: python -m experiments.claim builtin White_F.glb:female -o out/claim --steps 200 --poses 2",
)


def person_and_sex(name: str) -> tuple[str, str]:
    """What `synth` takes, and the free body that the fit begins with."""
    person, _, sex = name.partition(":")
    if person == "builtin" and sex.isdecimal():
        return name, draw(int(sex)).sex
    if sex not in ("", "male", "female"):
        raise AssetError(f"{name}: expected PERSON, PERSON:male or PERSON:female")
    return (name if person == "builtin" else person), sex or "male"


def folder_of(name: str) -> str:
    """What a person's folder is called; people are told apart by it."""
    return folder_name(person_and_sex(name)[0])


def stature_of(person: str) -> float:
    """What somebody knows of themselves: metres from the floor to the skull."""
    from experiments.fitting import Filming
    from player.draw.raster import Rasteriser
    from player.gl.context import open_context

    with open_context() as context:
        return Filming(person, Rasteriser(context)).stature


def stages(options: Options, name: str, out: Path) -> dict[str, list[Stage]]:
    """The commands of one person by column; "raw" comes first."""
    person, sex = person_and_sex(name)
    raw = out / "raw"
    same = ["--size", str(options.size), "--seed", str(options.seed), "--light", options.light]
    fine = (options.size / 360) ** 2
    filmed = ["--raw", "--keypoints", "--held-out", "--seconds", f"{options.seconds:g}"]
    film = command("selfscan", "synth", person, raw, *filmed, *same)
    minutes = HELD_OUT + FILMING * fine * (options.seconds + 2.4)
    found = {"raw": [Stage("film four raw videos", raw / "truth" / "raw.json", film, minutes)]}
    exact = ["selfscan", "synth", person]
    more = ["--frames", str(options.frames), "--no-truth", *same]

    def imported() -> int:
        told = ["--sex", sex, "--stature", f"{stature_of(person):.3f}", "--frames", str(options.frames)]
        return command("selfscan", "import", "video", raw, "-o", out / "from_pixels" / "capture", *told)()

    said = share_in_words(options.preset, options.steps)
    part = total_steps(options.preset, options.steps) / total_steps(options.preset, None)
    for kind in INPUTS:
        folder = out / kind.replace(" ", "_")
        capture, run, quality = folder / "capture", folder / "run", folder / "quality.json"
        make = {
            "given": command(*exact, capture, *more),
            "shape only": command(*exact, capture, "--template", "shape", *more),
            "from pixels": imported,
        }[kind]
        made = IMPORT * fine * options.frames if kind == "from pixels" else 1.5

        def train(capture: Path = capture, run: Path = run) -> int:
            words = [*training_words(capture, run, options.preset, options.steps), "--seed", str(options.seed)]
            return command(*words, *(["--resume"] if begun(run) else []))()

        judge = command("selfscan", "eval", run, raw, "--poses", str(options.poses), "--json", quality)
        found[kind] = [
            Stage(f"{kind}: capture", capture / "capture.json", make, made),
            Stage(f"{kind}: train, {said}", run / "run.json", train, 2 + TRAINING * part),
            Stage(f"{kind}: evaluate", quality, judge, 1 + 2 * POSE * options.poses),
        ]
    return found


def settle(out: Path, said: dict[str, Any]) -> None:
    """Numbers of different settings do not share a folder.

    Raises:
        AssetError: the folder holds others.
    """
    path = out / "options.json"
    if path.exists():
        there = read_json_object(path, "the options of this folder's results")
        other = [f"{key} {there.get(key)}" for key, value in said.items() if there.get(key) != value]
        if other:
            raise AssetError(f"{path}: holds results of {', '.join(other)}; ask for the same, or choose another -o")
        return
    out.mkdir(parents=True, exist_ok=True)
    write_json(path, said)


def run_all(options: Options, people: Sequence[str], out: Path, kinds: Sequence[str] = INPUTS) -> list[str]:
    """The columns `kinds` of every person; what could not be made, in words."""
    absent = []
    columns = [(name, kind, todo) for name in people
               for kind, todo in stages(options, name, out / folder_of(name)).items()
               if kind == "raw" or kind in kinds]  # fmt: skip
    for number, (name, kind, todo) in enumerate(columns):
        later = [stage for _, _, others in columns[number + 1 :] for stage in others]
        after = sum((stage.minutes for stage in later if not stage.product.exists()), 0.0)
        note(f"{folder_of(name)}, {kind}")
        todo[0].product.parent.parent.mkdir(parents=True, exist_ok=True)
        try:
            run_stages(todo, after)
        except AssetError as error:
            absent.append(f"{folder_of(name)}, {kind}: {error}")
    return absent


def collect(out: Path) -> dict[str, dict[str, Any]]:
    """What `selfscan eval` found, by person and kind of input.

    Raises:
        AssetError: a file is no such result, or of another kind of input than its column.
    """
    found: dict[str, dict[str, Any]] = {}
    for path in sorted(out.glob("*/*/quality.json")):
        kind = path.parent.name.replace("_", " ")
        result = read_json_object(path, "a result of `selfscan eval --json`")
        if result.get("input") != kind:
            raise AssetError(f"{path}: input should be {kind!r}, is {result.get('input')!r}")
        found.setdefault(path.parent.parent.name, {})[kind] = result
    return found


def main(argv: Sequence[str]) -> int:
    given = parse(ClaimCommand, argv, ABOUT)
    options, out = given.options, given.out
    settle(out, asdict(options))
    absent = run_all(options, given.people, out, given.only or INPUTS)
    found = collect(out)
    facts = asdict(options) | {"share": share_in_words(options.preset, options.steps)}
    write_json(out / "claim.json", {"format": FORMAT, "options": facts, "people": found, "absent": absent})
    write_text(out / "claim.md", page(found, facts))
    return written(out / "claim.md", absent, "made")


if __name__ == "__main__":
    end_with(main)
