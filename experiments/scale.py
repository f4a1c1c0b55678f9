"""How the time of a frame grows: with avatars, triangles, pixels, and frames in the motion.

    python -m experiments.scale [AVATAR] -o out/scale [--rounds 20] [--size 640x640]

Points of a sweep take turns, one frame each, in rounds; over their medians t a power is fitted by least squares,

    log t = log c + p log x

and the interval of p is the middle 95 % over rounds drawn with replacement. A fixed cost of every frame draws p below
1. Processor time, all threads together, holds on a busy machine too. Nothing is read back.
"""

import argparse
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil, sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from avatar.gltf.avatar_file import read_avatar
from bench.ladder.machine import Quiet
from bench.report.writer import markdown_table
from experiments.alternating import here
from files.whole import check_folder, whole_folder, write_json, write_text
from player.draw.drawing import BarePose
from player.gl.context import Context, open_context
from player.scene.arguments import parse_size
from player.scene.framing import extent, fitted_camera
from player.scene.mannequin import mannequin
from player.scene.motions import motion_for
from player.scene.renderer import Renderer
from player.scene.track import Track

SIZE = (640, 640)
# metres between avatars, and radians above the ground from which they are seen
SPACING, ABOVE = 1.2, 0.35
# of the counting clip, drawn in turn
FRAMES = 60
RESAMPLES = 1000
# of a motion file's numbers: a byte each, so that a million frames are 156 MB
COLUMNS = 156


@dataclass(frozen=True)
class ScaleSteps:
    """Where each sweep is measured."""

    avatars: tuple[int, ...] = (1, 2, 5, 10, 20, 50, 100)
    # pixels a side
    sides: tuple[int, ...] = (160, 320, 640, 1280)
    # each many times the two stretches of 256 that are kept: a jump has to read
    frames: tuple[int, ...] = (10_000, 100_000, 1_000_000)


class Power(NamedTuple):
    """An exponent with its interval."""

    exponent: float
    low: float
    high: float


def fitted_power(x: Sequence[float | int], times: Float[np.ndarray, "rounds points"]) -> Power:
    """The power of x by which times grow."""
    log_x = np.log(np.asarray(x, np.float64))
    log_x -= log_x.mean()

    def slope(rounds: np.ndarray) -> float:
        log_t = np.log(np.median(rounds, axis=0))
        return float(log_x @ (log_t - log_t.mean()) / (log_x @ log_x))

    rng = np.random.default_rng(0)
    drawn = [slope(times[rng.integers(0, len(times), len(times))]) for _ in range(RESAMPLES)]
    return Power(slope(times), *(float(one) for one in np.percentile(drawn, [2.5, 97.5])))


class Sweep(NamedTuple):
    """One cause, measured."""

    name: str
    x: tuple[int, ...]
    wall: Float[np.ndarray, "rounds points"]  # ms
    cpu: Float[np.ndarray, "rounds points"]
    # making the renderer, s, and GL memory: of sweeps that draw
    start: tuple[float, ...] = ()
    bytes: tuple[int, ...] = ()

    def row(self) -> dict[str, Any]:
        """For JSON."""
        rounded = {
            key: np.median(ms, axis=0).round(4).tolist() for key, ms in (("ms", self.wall), ("cpu_ms", self.cpu))
        }
        powers = {key: fitted_power(self.x, ms)._asdict() for key, ms in (("wall", self.wall), ("cpu", self.cpu))}
        out = {"name": self.name, "x": list(self.x), **rounded, "exponents": powers}
        return out | {"start_s": [round(one, 3) for one in self.start], "bytes": list(self.bytes)}


def take_turns(
    programs: Sequence[Callable[[int], object]], rounds: int
) -> tuple[Float[np.ndarray, "rounds points"], Float[np.ndarray, "rounds points"]]:
    """Milliseconds of each program in each round, passed and of processors; each runs once untimed before."""
    turns = [[here(run, 1)(2 * number) for run in programs] for number in range(rounds)]
    wall, cpu = np.array([[(turn.wall[0], turn.cpu[0]) for turn in row] for row in turns]).transpose(2, 0, 1)
    # a clock that did not move
    return np.maximum(wall, 1e-4), np.maximum(cpu, 1e-4)


class Crowd(NamedTuple):
    """Avatars on a square, all in the picture, each somewhere else in the clip."""

    renderer: Renderer
    poses: list[list[BarePose]]
    camera: Camera
    # in which the renderer was made: meshes, textures, programs
    start: float  # seconds

    def draw(self, number: int) -> None:
        assert self.renderer.target is not None
        self.renderer.draw_into(self.renderer.target, self.poses[number % len(self.poses)], self.camera)
        self.renderer.context.gl.finish()


def crowd(context: Context, avatar: Avatar, count: int, *, level: int = 0, size: tuple[int, int] = SIZE) -> Crowd:
    """An avatar `count` times: mesh and textures are made once, each is posed and drawn on its own."""
    clip = motion_for(avatar, "counting").read(0, FRAMES)
    side = ceil(sqrt(count))
    at = np.array([[k % side - 0.5 * (side - 1), 0.0, k // side] for k in range(count)]) * SPACING
    points = extent(avatar, clip)
    (left, _, behind), (right, _, front) = at.min(0), at.max(0)
    corners = [points + (x, 0.0, z) for x in (left, right) for z in (behind, front)]
    camera = fitted_camera(np.concatenate(corners), 0.0, size, elevation=ABOVE)
    poses = [
        [(clip.axis_angle[(n + 7 * k) % FRAMES], clip.root[(n + 7 * k) % FRAMES] + at[k]) for k in range(count)]
        for n in range(4)
    ]
    start = time.perf_counter()
    renderer = Renderer(context, [avatar] * count, size, level=level)
    context.gl.finish()
    return Crowd(renderer, poses, camera, time.perf_counter() - start)


def drawn_sweep(
    name: str, crowds: Mapping[int, Callable[[], Crowd]], rounds: int, report: Callable[[str], None]
) -> Sweep:
    """Crowds by what they are counted by, drawn in turns."""
    report(name)
    made: list[Crowd] = []
    try:
        for make in crowds.values():
            made.append(make())
        wall, cpu = take_turns([one.draw for one in made], rounds)
        starts, sizes = tuple(one.start for one in made), tuple(one.renderer.plan.bytes for one in made)
        return Sweep(name, tuple(crowds), wall, cpu, starts, sizes)
    finally:
        for one in made:
            one.renderer.release()


def motion_sweep(avatar: Avatar, lengths: Sequence[int], rounds: int, report: Callable[[str], None]) -> Sweep:
    """Poses anywhere in motion files of these lengths, each after a jump: a stretch of frames is read for it."""
    name = "frames in the motion file"
    report(name)
    with tempfile.TemporaryDirectory() as folder:
        tracks = []
        for length in lengths:
            path = Path(folder) / f"{length}.npz"
            write_still_motion(path, length)
            motion = motion_for(avatar, str(path))
            tracks.append(Track(motion))
        places = np.random.default_rng(0).permutation(2 * rounds) / (2 * rounds)

        def jump(track: Track, number: int) -> None:
            # frames beyond the two stretches that a track keeps
            track.pose((0.97 * places[number % len(places)] + 0.01 * (number % 2)) * track.end)

        wall, cpu = take_turns([partial(jump, track) for track in tracks], rounds)
        tracks.clear()
    return Sweep(name, tuple(lengths), wall, cpu)


def write_still_motion(path: Path, frames: int) -> None:
    """A pose file of zeros, written piece by piece."""
    with zipfile.ZipFile(path, "w") as archive, archive.open("poses.npy", "w", force_zip64=True) as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "|i1", "fortran_order": False, "shape": (frames, COLUMNS)})
        whole, rest = divmod(frames, 10_000)
        for count in [10_000] * whole + [rest]:
            file.write(bytes(count * COLUMNS))


def bench_scale(
    avatar: Avatar,
    out: Path,
    *,
    rounds: int = 20,
    size: tuple[int, int] = SIZE,
    steps: ScaleSteps = ScaleSteps(),
    report: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Measure every sweep, write scale.json and scale.md into folder `out`."""
    last = len(avatar.levels) - 1
    with open_context() as context, Quiet() as quiet:

        def standing(level: int) -> Sweep:
            made = {count: partial(crowd, context, avatar, count, level=level, size=size) for count in steps.avatars}
            return drawn_sweep(f"avatars, {len(avatar.levels[level].faces)} triangles each", made, rounds, report)

        few = len(avatar.levels[last].faces)
        sweeps = [standing(last)]
        if last:
            sweeps.append(standing(0))
            by_faces = {
                len(one.faces): partial(crowd, context, avatar, 1, level=k, size=size)
                for k, one in enumerate(avatar.levels)
            }
            sweeps.append(drawn_sweep("triangles of one avatar", by_faces, rounds, report))
        by_pixels = {
            side * side: partial(crowd, context, avatar, 1, level=last, size=(side, side)) for side in steps.sides
        }
        sweeps.append(drawn_sweep(f"pixels, one avatar of {few} triangles", by_pixels, rounds, report))
        sweeps.append(motion_sweep(avatar, steps.frames, rounds, report))
    result = {
        "format": "selfscan-bench-scale",
        **quiet.facts(context),
        "avatar": avatar.name,
        "size": list(size),
        "rounds": rounds,
        "sweeps": [sweep.row() for sweep in sweeps],
    }
    with whole_folder(out) as folder:
        write_json(folder / "scale.json", result)
        write_text(folder / "scale.md", scale_markdown(result))
    return result


def scale_markdown(result: dict[str, Any]) -> str:
    """The tables, and where they were measured."""
    facts = result["machine"]
    lines = [
        "# How the time of a frame grows",
        "",
        f"{result['avatar']}, {' x '.join(map(str, result['size']))} pixels where nothing else is said; "
        f"{facts['renderer']}; {facts['cpu']}, {facts['cores']} cores; load {facts['load_average']:.1f}; commit "
        f"{facts['commit']}. {result['rounds']} rounds in turns; the exponent p of t = c x^p with its 95 % interval.",
        "",
    ]
    rows = []
    for row in result["sweeps"]:
        cpu, wall = (
            f"{one['exponent']:.2f} ({one['low']:.2f} to {one['high']:.2f})"
            for one in (row["exponents"]["cpu"], row["exponents"]["wall"])
        )
        points = ", ".join(f"{x}: {ms:.3g}" for x, ms in zip(row["x"], row["cpu_ms"], strict=True))
        rows.append([row["name"], cpu, wall, points])
    head = ["what grows", "p of processor time", "p of time passed"]
    lines += markdown_table([*head, "processor ms a frame, from the least to the most"], rows)
    if result["warning"]:
        lines += ["", result["warning"]]
    return "\n".join([*lines, ""])


def main(argv: list[str] | None = None) -> int:
    """Measure, and print the exponents."""
    parser = argparse.ArgumentParser("python -m experiments.scale", description="How the time of a frame grows.")
    parser.add_argument("avatar", nargs="?", type=Path, help="avatar file (.glb); none: the built-in body")
    parser.add_argument("-o", dest="out", type=Path, required=True, help="folder to write")
    parser.add_argument("--rounds", type=int, default=20, help="timed frames of each point")
    parser.add_argument("--size", type=parse_size, default=SIZE, help="pixels, WxH")
    command = parser.parse_args(argv)
    command.out.parent.mkdir(parents=True, exist_ok=True)
    check_folder(command.out)
    avatar = mannequin() if command.avatar is None else read_avatar(command.avatar)
    result = bench_scale(avatar, command.out, rounds=command.rounds, size=command.size)
    for row in result["sweeps"]:
        power = row["exponents"]["cpu"]
        print(f"{row['name']:48} time ~ x^{power['exponent']:.2f} ({power['low']:.2f} to {power['high']:.2f})")
    if result["warning"]:
        print(result["warning"])
    print(f"wrote {command.out}/scale.md")
    return 0


if __name__ == "__main__":
    sys.exit(main())
