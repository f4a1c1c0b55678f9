"""`selfscan make`: films become an avatar in one go; a first one after minutes, a better one while you watch it.

Each step is the command that a person would type, in a process of its own, and is kept once it is done: Ctrl-C and the
same command goes on. OUT.making beside the avatar holds what they leave.
"""

import json
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

from capture.read.command import FilmOptions
from command.command_line import Help, Option, parse
from command.errors import AssetError
from command.progress import clock_time
from command.stages import Stage, command, run_stages
from files.input_file import read_json
from files.whole import check_file, whole_file

# steps a part of the short training; the long one has the preset's own
SHORT = 250

ABOUT = Help(
    "selfscan make",
    """Make an avatar of films of one person, four or the body's alone: read them, fit the person, and write a first
avatar, textures solved from the films; then train the fields of the paper and write a better one over it. `selfscan
play --follow` shows the first while the second is made, and then the second. Stopped, the same command goes on where it
was.""",
    """example:
  selfscan make me -o me.glb --stature 1.78       me/ has body.mp4, head.mp4, left.mp4, right.mp4 and keypoints/
  selfscan make me -o me.glb --minutes 4          the first avatar alone""",
)


@dataclass(frozen=True)
class MakeCommand:
    """`selfscan make`."""

    films: Annotated[tuple[Path, ...], Option(positional=True, metavar="FILMS", several=True),
        "body, head, left and right hand, in this order, the body alone, or a folder with body.mp4 and any of "
        "head.mp4, left.mp4 and right.mp4"]
    out: Annotated[Path, Option(("-o", "--out"), "NAME.glb"), "avatar file, replaced whole by each better one"]
    reading: Annotated[FilmOptions, "how the films are read"]
    minutes: Annotated[Literal["4", "15", "60"],
        "of two quiet cores after the films are read: 4, the fitted template in the films' colors; 15, fields of "
        f"{SHORT} steps a part as well; 60, the whole training"] = "15"

    def __post_init__(self):
        if self.out.suffix.lower() != ".glb":
            raise ValueError(f"-o should name a .glb file, is {self.out}")

    @property
    def work(self) -> Path:
        """Where steps leave what they made."""
        return self.out.with_name(self.out.stem + ".making")


def words_of(reading: FilmOptions) -> list[str]:
    """The options as `selfscan import video` takes them, those that are not as they are by default."""
    words = []
    for field in fields(reading):
        value = getattr(reading, field.name)
        if value != field.default:
            words += [f"--{field.name}", str(value)]
    return words


def claim(wanted: MakeCommand) -> None:
    """Make the folder of the work, or go on in it where it is of the same films, read the same way.

    Raises:
        AssetError: it is of others.
    """
    files = [find for film in wanted.films for find in (sorted(film.iterdir()) if film.is_dir() else [film])]
    films = [[str(file.resolve()), file.stat().st_size] for file in files if file.is_file()]
    asked = {"films": films, "reading": words_of(wanted.reading)}
    note = wanted.work / "make.json"
    if wanted.work.exists() and read_json(note, "what `selfscan make` was asked for") != asked:
        raise AssetError(f"{wanted.work}: holds the work on other films or options: remove it, or choose another -o")
    wanted.work.mkdir(exist_ok=True)
    with whole_file(note, "w") as file:
        json.dump(asked, file)


def published(product: Path, out: Path, began: float) -> int:
    """Put a finished avatar where the user wants it, whole, and say how long it took."""
    with open(product, "rb") as source, whole_file(out, "wb") as file:
        shutil.copyfileobj(source, file)
    taken = clock_time(time.monotonic() - began)
    print(f"\n{out}: ready after {taken}; look at it: selfscan play {out} --follow", flush=True)
    return 0


def make_stages(wanted: MakeCommand) -> list[Stage]:
    """The commands, in order, and how many minutes each takes on two quiet cores."""
    work, began = wanted.work, time.monotonic()
    capture, first, run = work / "capture", work / "first", work / f"fields_{wanted.minutes}"

    def bake(name: str, source: Path, product: Path) -> Stage:
        baked = command("selfscan", "bake", source, "-o", product)
        return Stage(name, product, lambda: baked() or published(product, wanted.out, began), 3.0)

    read = ["selfscan", "import", "video", *wanted.films, "-o", capture, *words_of(wanted.reading)]
    stages = [
        Stage("read the films and fit the person", capture / "capture.json", command(*read), 2.5),
        Stage("the template in the films' colors", first / "run.json",
              command("selfscan", "train", capture, "-o", first, "--preset", "preview"), 2.0),
        bake("first avatar", first, work / "first.glb"),
    ]  # fmt: skip
    if wanted.minutes != "4":
        resume = ["--resume"] if run.with_name(run.name + ".partial").exists() else []
        short = ["--iterations", SHORT] if wanted.minutes == "15" else []
        train = command("selfscan", "train", capture, "-o", run, *map(str, short), *resume)
        stages.append(Stage("fields of body, head and hands", run / "run.json", train, 6.0 if not short else 3.5))
        stages.append(bake("better avatar", run, run.with_suffix(".glb")))
    return stages


def main(argv: Sequence[str]) -> int:
    """Parse the command line and make the avatar."""
    wanted = parse(MakeCommand, argv, ABOUT)
    for film in wanted.films:
        if not film.exists():
            raise AssetError(f"{film}: expected a film, or a folder of them, found nothing")
    check_file(wanted.out)
    claim(wanted)
    stages = make_stages(wanted)
    run_stages(stages)
    if not wanted.out.exists():
        published(stages[-1].product, wanted.out, time.monotonic())
    return 0
