"""`selfscan make`: films become an avatar in one go; a first one after minutes, a better one while you watch it.

Each step is the command that a person would type, in a process of its own, and is kept once it is done: Ctrl-C and the
same command goes on. OUT.making beside the avatar holds what they leave.
"""

import filecmp
import hashlib
import os
import shlex
import shutil
import sys
import time
import webbrowser
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Literal

from capture.read.command import FilmOptions
from command.command_line import Help, Option, parse
from command.errors import AssetError
from command.progress import clock_time
from command.stages import Stage, as_word, command, run_stages
from files.input_file import read_json_object
from files.whole import check_file, exclusive_lock, is_free, whole_file, write_json

# steps a part of the short training; those of a head alone and of a long training are the presets' own
SHORT = 250
# texels a side of the first avatar's atlas, and from how many millions of pixels a picture films show more than these
FIRST, FINER = 1024, 0.5

ABOUT = Help(
    "selfscan make",
    """Make an avatar of films of one person, four or the body's alone: read them, fit the person, and write a first
avatar, the fitted template with textures solved from the films, then a better one over it whose head was learned, hair
and all. Asked for more minutes, train all fields of the paper; a part whose template meets the films' outlines better
keeps it. `selfscan play --follow` shows the first while the second is made, and then the second. Stopped, the same
command goes on where it was.""",
    """example:
  selfscan make me -o me.glb --stature 1.78       me/ has body.mp4, head.mp4, left.mp4, right.mp4 and keypoints/
  selfscan make me -o me.glb --minutes 4          the first avatar alone
  selfscan make --camera -o me.glb                films you with a webcam first, into me.films/""",
)


@dataclass(frozen=True)
class MakeCommand:
    """`selfscan make`."""

    out: Annotated[Path, Option(("-o", "--out"), "NAME.glb"), "avatar file, replaced whole by each better one"]
    reading: Annotated[FilmOptions, "how the films are read"]
    films: Annotated[tuple[Path, ...], Option(positional=True, metavar="FILMS", several=True),
        "body, head, left and right hand, in this order, the body alone, or a folder with body.mp4 and any of "
        "head.mp4, left.mp4 and right.mp4; and face.mp4, where you say ah, smile, move brows and blink"] = ()
    camera: Annotated[str | None, Option(metavar="CAMERA", const=""),
        "film them now with a webcam, the first one or the one of this name or number, into NAME.films; a window shows "
        "where to stand and what to do, and films that are there are kept"] = None
    minutes: Annotated[Literal["4", "6", "15", "60"],
        f"of two quiet cores: 4, the fitted template in the films' colors, {FIRST} texels a side; 6, a learned head, "
        f"and finer textures where pictures of the films have more than {FINER} million pixels; "
        f"15, fields of all parts, {SHORT} steps each; 60, the whole training"] = "6"

    def __post_init__(self):
        if self.out.suffix.lower() != ".glb":
            raise ValueError(f"-o should name a .glb file, is {self.out}")
        if bool(self.films) == (self.camera is not None):
            raise ValueError("expected FILMS or --camera, one of the two")

    @property
    def work(self) -> Path:
        """Where steps leave what they made."""
        return self.out.with_name(self.out.stem + ".making")

    @property
    def filmed(self) -> Path:
        """The folder of films that --camera makes."""
        return self.out.with_name(self.out.stem + ".films")


def words_of(reading: FilmOptions) -> list[str]:
    """The options as `selfscan import video` takes them, those that are not as they are by default."""
    words = []
    for field in fields(reading):
        value = getattr(reading, field.name)
        if value != field.default:
            words += [f"--{field.name}", as_word(value)]
    return words


def claim(wanted: MakeCommand) -> None:
    """Make the folder of the work, or go on in it where it is of the same films and keypoints, read the same way.

    Raises:
        AssetError: it is of others, or the films are not told apart.
    """
    from capture.raw.four_videos import face_film, find_videos

    named, face = find_videos(wanted.films), face_film(wanted.films)
    films = [[str(film.resolve()), film.stat().st_size] for film in (*named.values(), *([face] if face else []))]
    given = wanted.reading.keypoints
    points = named["body"].parent / "keypoints" if given == "auto" else Path(given)
    sizes = sorted((path.name, path.stat().st_size) for path in points.rglob("*") if path.is_file())
    # anew by another detector, they are hardly as long
    asked = {"films": films, "keypoints": hashlib.sha256(repr(sizes).encode()).hexdigest()[:16],
             "reading": words_of(wanted.reading)}  # fmt: skip
    note = wanted.work / "make.json"
    if not is_free(wanted.work) and not note.exists():
        raise AssetError(f"{wanted.work}: is in the way, and not the work of `selfscan make`; remove or rename it")
    if note.exists() and os.listdir(wanted.work) != [note.name]:
        before = read_json_object(note, "what `selfscan make` was asked for")
        if before != asked:
            words = " ".join(map(str, before.get("reading") or ["none"]))
            names = {"films": "films", "keypoints": "keypoints", "reading": f"options ({words})"}
            other = next((name for field, name in names.items() if before.get(field) != asked[field]), "options")
            raise AssetError(f"{wanted.work}: holds the work on other {other}: remove it, or choose another -o")
    wanted.work.mkdir(exist_ok=True)
    write_json(note, asked)


def film_yourself(wanted: MakeCommand) -> MakeCommand:
    """The command with the films that the webcam makes first, where they were not made yet.

    Raises:
        AssetError: there is no camera or no display.
    """
    from capture.raw.filming import film_parts, unfilmed
    from capture.raw.webcam import open_camera
    from player.window.picture_window import PictureWindow

    folder = wanted.filmed
    if wanted.work.exists() and not folder.exists():
        raise AssetError(f"{wanted.work}: holds the work on other films than {folder}: remove it, or choose another -o")
    # once films were read, those that were left out stay out
    if not wanted.work.exists() and unfilmed(folder):
        with ExitStack() as held:
            try:
                camera = held.enter_context(closing(open_camera(wanted.camera or "")))
                window = held.enter_context(closing(PictureWindow((1280, 720))))
            except AssetError as error:
                raise AssetError(f"{error}; or film with a phone, put body.mp4, head.mp4, left.mp4 and right.mp4 into "
                                 f"a folder ME, and run selfscan make ME -o {wanted.out}") from None  # fmt: skip
            folder.mkdir(exist_ok=True)
            film_parts(folder, camera, window.show)
    return replace(wanted, films=(folder,), camera=None)


def published(product: Path, out: Path, began: float) -> int:
    """Put a finished avatar where the user wants it, whole, and say how long it took."""
    with open(product, "rb") as source, whole_file(out, "wb") as file:
        shutil.copyfileobj(source, file)
    taken = clock_time(time.monotonic() - began)
    print(f"\n{out}: ready after {taken}; look at it: selfscan play {shlex.quote(as_word(out))} --follow", flush=True)
    return 0


def show_page(address: str) -> None:
    """Open a page in the user's browser, and say its address where there may be none."""
    print(f"  {address}", flush=True)
    # without a display it would be one that takes the terminal
    if sys.platform in ("win32", "darwin") or "DISPLAY" in os.environ or "WAYLAND_DISPLAY" in os.environ:
        webbrowser.open(address)


def clicking(wanted: MakeCommand) -> tuple[Path, Stage] | None:
    """The body's film and the stage in which the person clicks its keypoints; None: they are there, are found by a
    detector, or there is no terminal."""
    from capture.raw.click import click_joints
    from capture.raw.four_videos import find_videos
    from capture.raw.video_file import open_video

    reading, body = wanted.reading, find_videos(wanted.films)["body"]
    product = wanted.work / "keypoints" / "body.json"
    there = reading.keypoints != "auto" or reading.models is not None or (body.parent / "keypoints").is_dir()
    if there or not (product.exists() or sys.stdin.isatty()):
        return None

    def run() -> None:
        print(f"no keypoints beside {body.name} and no --models: click your joints on this page. Head and hands are "
              "cut from the body's film; for films of their own a detector is needed (docs/capture.md).")  # fmt: skip
        product.parent.mkdir(exist_ok=True)
        click_joints(open_video(body), product, show_page)

    return body, Stage("your joints, clicked by you", product, run, 5.0)


def megapixels(films: Sequence[Path]) -> float:
    """Millions of pixels of a picture of the largest film."""
    from capture.raw.four_videos import find_videos
    from capture.raw.video_file import open_video

    sizes = [open_video(film).size for film in find_videos(films).values()]
    return max(width * height for width, height in sizes) / 1e6


def make_stages(wanted: MakeCommand) -> list[Stage]:
    """The commands, in order, and how many minutes each takes on two quiet cores, as measured with films of 400 and 720
    pixels."""
    large = megapixels(wanted.films)
    work, began, clicked = wanted.work, time.monotonic(), clicking(wanted)
    capture, first, run_folder = work / "capture", work / "first", work / f"fields_{wanted.minutes}"
    texels = () if large > FINER else ("--texture", FIRST)

    def bake(name: str, source: Path, product: Path, minutes: float, *words: object) -> Stage:
        """Bake a run and put the avatar where the user wants it."""
        baked = command("selfscan", "bake", source, "-o", product, *map(str, words))
        return Stage(name, product, lambda: baked() or published(product, wanted.out, began), minutes)

    def train(name: str, run: Path, minutes: float, *words: object) -> Stage:
        """Train a run; what the first one found of hair, clothes and light is taken over."""
        resume = ["--resume"] if run.with_name(run.name + ".partial").exists() else []
        like = [] if run == first else ["--like", first]
        trained = command("selfscan", "train", capture, "-o", run, *like, *map(str, words), *resume)
        return Stage(name, run / "run.json", trained, minutes)

    films, points = wanted.films, []
    if clicked is not None:
        films, points = [clicked[0]], ["--keypoints", clicked[1].product.parent]
    read = ["selfscan", "import", "video", *films, "-o", capture, *words_of(wanted.reading), *points]
    stages = [
        *([clicked[1]] if clicked else []),
        Stage("read the films and fit the person", capture / "capture.json", command(*read), 0.9 + 1.7 * large),
        train("the template in the films' colors", first, 1.2, "--preset", "preview"),
        bake("first avatar", first, work / "first.glb", 0.8 + 1.6 * large, "--texture", FIRST),
    ]
    if wanted.minutes in ("6", "60"):
        stages.append(train("the head's field", work / "head", 1.0, "--preset", "head"))
        stages.append(bake("avatar with a learned head", work / "head", work / "head.glb", 1.0 + 3.0 * large, *texels))
    if wanted.minutes in ("15", "60"):
        short = ["--iterations", SHORT] if wanted.minutes == "15" else []
        stages.append(train("fields of body, head and hands", run_folder, 3.5 if short else 6.0, *short))
        stages.append(bake("avatar of the fields", run_folder, run_folder.with_suffix(".glb"), 2.5, *texels))
    return stages


def main(argv: Sequence[str]) -> int:
    """Parse the command line and make the avatar."""
    wanted = parse(MakeCommand, argv, ABOUT)
    check_file(wanted.out)
    wanted.reading.check()
    with exclusive_lock(wanted.out):
        make(wanted)
    return 0


def make(wanted: MakeCommand) -> None:
    """Make the avatar, from where an earlier call was stopped."""
    if wanted.camera is not None:
        wanted = film_yourself(wanted)
    claim(wanted)
    stages = make_stages(wanted)
    ran = run_stages(stages)
    made = [stage.product for stage in stages if stage.product.suffix == ".glb"]
    # a kill may come between an avatar and its taking the place of the one before
    before = [] if stages[-1].name in ran else made[:-1]
    if not wanted.out.exists() or any(filecmp.cmp(wanted.out, avatar, shallow=False) for avatar in before):
        published(made[-1], wanted.out, time.monotonic())
