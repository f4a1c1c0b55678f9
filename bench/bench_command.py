"""`selfscan bench`: what it is asked for, and its command line; the work is in bench/report/report.py."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from avatar.gltf.avatar_file import read_avatar
from command.command_line import Help, Option, parse
from command.settings import AtLeast, AtMost
from files.whole import check_folder
from player.scene.arguments import parse_size


@dataclass(frozen=True)
class BenchCommand:
    out: Annotated[Path, Option(("-o",), "DIR"), "folder to write"]
    avatar: Annotated[Path | None, Option(positional=True, metavar="AVATAR"),
        "avatar file (.glb), or builtin; of --effects none: the built-in body"] = None
    effects: Annotated[bool, "instead: what each effect of a scene costs, alone and all together"] = False
    run: Annotated[Path | None, Option(metavar="RUN"), "run folder it was baked from: adds the field as a rung"] = None
    capture: Annotated[Path | None, Option(metavar="CAPTURE"),
        "capture folder with truth/: held-out poses and true pictures"] = None
    rounds: Annotated[int, AtLeast(6), AtMost(100_000), "timed frames for each rung; fewer say nothing with 95 %"] = 20
    frames: Annotated[int, AtLeast(1), AtMost(10_000), "pictures compared"] = 4
    size: Annotated[tuple[int, int] | None, AtLeast(1), Option(metavar="WxH", parse=parse_size),
        "pixels (default: 640x640)"] = None

    def __post_init__(self):
        if self.avatar is None and not self.effects:
            raise ValueError("give AVATAR or --effects")
        if self.effects and (self.run or self.capture):
            raise ValueError("--run and --capture are of the ladder of an avatar: leave --effects out")
        if self.size is not None and self.capture is not None:
            raise ValueError("--size: the true pictures of --capture have their own")


BENCH = Help(
    "selfscan bench",
    """What accuracy costs in time on this machine: every way the player can draw an avatar, timed and compared with the
best one, with the field it came from (--run) and with the truth (--capture).""",
    """examples
  selfscan bench avatar.glb --run run --capture capture -o bench
  selfscan bench --effects -o effects           or of an avatar: selfscan bench avatar.glb --effects -o effects""",
)


def bench_main(argv: list[str]) -> int:
    """`selfscan bench AVATAR [--run RUN] [--capture CAPTURE] -o DIR`, or `selfscan bench [AVATAR] --effects -o DIR`."""
    command = parse(BenchCommand, argv, BENCH)
    check_folder(command.out, command.avatar, command.run, command.capture)
    if command.effects:
        return _effects(command)
    from bench.report.report import bench

    result = bench(command)
    wide = max(len(row["name"]) for row in result["rungs"])
    for row in result["rungs"]:
        flip = "the best" if row["name"] == result["best_rung"] else f"FLIP {row['flip']:.4f}"
        print(f"{row['name']:{wide}}{row['ms_median']:10.2f} ms{flip:>14}{'  dominated' * row['dominated']}")
    if result["warning"]:
        print(result["warning"])
    print(f"wrote {command.out}/bench.html, to open in a browser, and bench.md")
    return 0


def _effects(command: BenchCommand) -> int:
    from bench.ladder.effects import SIZE, bench_effects
    from player.scene.mannequin import mannequin

    avatar = mannequin() if command.avatar is None else read_avatar(command.avatar)
    result = bench_effects(avatar, command.out, rounds=command.rounds, size=command.size or SIZE)
    for row in result["effects"]:
        print(f"{row['name']:36}{row['ms']:10.2f} ms{row['times_bare']:10.2f} x{row['bytes'] / 1e6:10.2f} MB")
    if result["warning"]:
        print(result["warning"])
    print(f"wrote {command.out}/effects.md")
    return 0
