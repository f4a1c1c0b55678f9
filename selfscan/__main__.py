"""The `selfscan` command: finds the subcommand, imports it only then, and turns bad input into one line."""

import os
import re
import signal
import sys
import tempfile
import traceback
from difflib import get_close_matches

from command.errors import AssetError, missing_package
from command.interrupt import StopRequest, prompt_stop
from selfscan.streams import exit_code, guard_streams

USAGE = """usage: selfscan COMMAND ...

Turn four phone videos of a person into an avatar to pose, watch and film in real time.

make an avatar
  make    FILMS -o NAME.glb    four films (--camera makes them) to an avatar: import, train and bake
  synth   SUBJECT OUT          four self-scan videos of a built-in or rigged person, with ground truth
  import  KIND ...             your own videos (video, easymocap) or the authors' data (totalselfscan) as a capture
  check   CAPTURE_OR_VIDEOS      is this usable? overlays, numbers, a verdict with what to do
  train   CAPTURE -o RUN       part fields (signed distance and colour) from a capture
  bake    RUN -o NAME.glb      one mesh, one atlas, skin weights and a tiny view network in one file

use it
  render  AVATAR --motion FILE -o OUT    a picture, frames or a film, with or without GPU and display
  play    AVATAR [--motion FILE]         a window: orbit, pause, step, scrub; --live vmc:39539: posed by a sender
  web     AVATAR [--motion FILE] -o PAGE.html   one page that draws the avatar in any browser, offline
  stream  MOTION --to vmc:HOST:PORT      sends a motion as live poses (VMC, or JSON with udp:)
  export  AVATAR --motion FILE -o OUT    the motion as BVH, animated GLB or AMASS npz, for other programs

judge it
  eval    RUN_OR_AVATAR CAPTURE          how near to the truth: cm, PSNR, SSIM, FLIP
  inspect AVATAR -o DIR                  pictures and one page: parts, weights, texels, seams, what was seen
  bench   AVATAR -o DIR                  accuracy against time on this machine
  doctor                                 which OpenGL context works here, and what is missing

`selfscan COMMAND --help` explains a command, `selfscan --version` says which this is, `selfscan --debug COMMAND ...`
shows where an error arose. Try `selfscan render builtin --motion counting -o film.mp4`.
"""
COMMANDS = re.findall(r"^  ([a-z]+) ", USAGE, re.MULTILINE)
PACKAGES = ("files", "command", "avatar", "geometry", "capture", "train", "player", "bake", "shaders", "synth", "bench",
            "experiments")
# what a command needs beyond the base install
EXTRAS = {
    "make": "bake", "synth": "bench", "import": "train", "check": "train", "train": "train",
    "bake": "bake", "eval": "bake,bench", "bench": "bake,bench", "inspect": "inspect",
}  # fmt: skip
# commands that hold decoded images
DRAWING = ("render", "play")


def main(argv: list[str] | None = None) -> int:
    """Run one subcommand; the exit code: 0 done, 1 bad input (one line says what), 2 wrong usage, 130 or 143 a signal.

    Without arguments the process is ours, and its streams are guarded.
    """
    if argv is not None:
        return _run(argv)
    guard_streams()
    try:
        code = _run(sys.argv[1:])
    except SystemExit as stop:  # argparse
        code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    return exit_code(code)


def _run(argv: list[str]) -> int:
    debug = argv[:1] == ["--debug"]
    argv = argv[1:] if debug else argv
    if not argv or argv[0] in ("-h", "--help"):
        print(USAGE, end="")
        return 0 if argv else 2
    if argv[0] in ("-V", "--version"):
        print(f"selfscan {_version()}")
        return 0
    name, rest = argv[0], argv[1:]
    stop = StopRequest()
    try:
        with prompt_stop() as stop:
            return _dispatch(name, rest)
    except KeyboardInterrupt as stopped:
        return _stopped(name, getattr(stopped, "number", signal.SIGINT))
    except Exception as error:
        # what it was raised into made another error of it
        if stop.number is not None and not isinstance(error, AssetError):
            return _stopped(name, stop.number)
        # a bar that was on its way has left the cursor behind it
        clear = "\r\x1b[K" if sys.stderr.isatty() else ""
        print(f"{clear}selfscan {name}: {_explained(error, argv, debug)}", file=sys.stderr)
        if debug:
            traceback.print_exc()
        return 1


def _stopped(name: str, number: int) -> int:
    print(f"\nselfscan {name}: stopped", file=sys.stderr)
    return 128 + number


def _explained(error: Exception, argv: list[str], debug: bool) -> str:
    """One line on what went wrong: with the input, with the machine, or, in all other cases, with us."""
    if isinstance(error, AssetError):
        return str(error)
    if isinstance(error, FileNotFoundError) and error.filename is None:
        return "the folder that this terminal is in was deleted; change to one that is there"
    if isinstance(error, OSError):
        return f"{f'{error.filename}: ' if error.filename else ''}{error.strerror or error}"
    if isinstance(error, MemoryError):
        return f"not enough memory {error}".rstrip()
    said = (str(error).splitlines() or [""])[0][:200]
    line = f"an error that should not happen, {type(error).__name__}: {said}; please report it"
    return line if debug else f"{line} with {_written_report(error, argv)}"


def _written_report(error: Exception, argv: list[str]) -> str:
    """The file that holds what a report needs, or where there can be none, how to see it."""
    lines = [f"selfscan {_version()}, Python {sys.version}", f"arguments: {argv}", *traceback.format_exception(error)]
    try:
        handle, path = tempfile.mkstemp(prefix="selfscan-report-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write("\n".join(lines))
    except OSError:
        return "what `selfscan --debug ...` shows"
    return path


def _version() -> str:
    from importlib.metadata import version

    return version("selfscan")


def _dispatch(name: str, rest: list[str]) -> int:
    # before torch is loaded: threads that spin while they wait take the processor from each other, several times slower
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    # the fits' small products took eight times the processor on two threads that wait for each other as on one
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        if name == "make":
            from selfscan.make import main as run
        elif name == "synth":
            from synth.options import main as run
        elif name == "import":
            from capture.read.command import main as run
        elif name == "check":
            from capture.check.options import main as run
        elif name == "train":
            from train.command import main as run
        elif name == "bake":
            from bake.command import main as run
        elif name == "eval":
            from bench.eval_command import eval_main as run
        elif name == "bench":
            from bench.bench_command import bench_main as run
        elif name == "render":
            from player.film.command import render_main as run
        elif name == "play":
            from player.play_command import play_main as run
        elif name == "export":
            from player.export_command import export_main as run
        elif name == "web":
            from player.web_command import web_main as run
        elif name == "inspect":
            from bench.inspect.options import inspect_main as run
        elif name == "stream":
            from player.live.command import stream_main as run
        elif name == "doctor":
            from player.doctor import doctor_main as run
        else:
            near = get_close_matches(name, COMMANDS, 1)
            meant = f"did you mean {near[0]}? " if near else ""
            print(f"selfscan: no command {name!r}; {meant}`selfscan --help` lists all", file=sys.stderr)
            return 2
        if name in DRAWING:
            from player.gl.memory import give_back_freed_memory

            give_back_freed_memory()
        # a command imports what it needs once its arguments are read
        return run(rest)
    except ModuleNotFoundError as error:
        if error.name and error.name.split(".")[0] in PACKAGES:
            raise
        raise missing_package(error.name, EXTRAS.get(name, "gui")) from None


if __name__ == "__main__":
    sys.exit(main())
