"""What a session costs besides the frame: start, memory, size, filming, live poses, ten thousand frames.

Each function returns rows of the report: {"name", "value", "unit", "detail"}, with "bar" and "met" where the project
promises something. CPU sums over all threads; processes are started anew, so nothing is warm that would not be.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from avatar.gltf.avatar_file import read_avatar
from command.errors import AssetError
from experiments.alternating import Turn, alternate
from experiments.gl_counts import counting, counts_of
from experiments.live_sender import sending
from player.draw.drawing import BarePose
from player.film.film import Film
from player.gl.context import Context, open_context
from player.live.inbox import Inbox
from player.live.playback import LivePlayback
from player.live.receiver import listen
from player.scene.address import Address
from player.scene.renderer import Renderer

Row = dict[str, Any]
MIB = 1 << 20
ROOT = Path(__file__).parents[1]
PATIENCE = 30.0  # seconds until a sender must have started
SETTLED = 500  # frames after which memory should not grow


def row(
    name: str,
    value: float | int,
    unit: str,
    detail: str = "",
    *,
    most: float | int | None = None,
    least: float | int | None = None,
) -> Row:
    """A row; `most` or `least` is what the project promises."""
    out: Row = {"name": name, "value": round(float(value), 3), "unit": unit, "detail": detail}
    if most is not None:
        out |= {"bar": f"<= {most:g}", "met": bool(value <= most)}
    if least is not None:
        out |= {"bar": f">= {least:g}", "met": bool(value >= least)}
    return out


# starting


# A process of its own starts the command: Linux counts into the largest memory of a process that of the one it was
# forked from, and this one holds avatars and contexts.
LAUNCHER = """
import json, resource, subprocess, sys, time
begun = time.perf_counter()
code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
took = time.perf_counter() - begun
print(json.dumps([code, took, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss]))
"""


def started(argv: Sequence[str | Path], surroundings: dict[str, str]) -> tuple[float, float]:
    """Wall seconds from start to end of `selfscan ARGV`, and its largest resident memory, MiB.

    Raises:
        AssetError: the command failed.
    """
    words = [sys.executable, "-c", LAUNCHER, sys.executable, "-m", "selfscan", *map(str, argv)]
    process = subprocess.run(words, cwd=ROOT, env=surroundings, capture_output=True, text=True, check=False)
    try:
        code, took, resident = json.loads(process.stdout)
    except ValueError:
        code, took, resident = process.returncode or 1, 0.0, 0
    if code:
        raise AssetError(f"selfscan {argv[0]} ended with {code}: {process.stderr[-300:]!r}")
    return took, resident / (1024 if sys.platform != "darwin" else MIB)


def first_frame(avatar: Path, repeats: int = 5) -> list[Row]:
    """`selfscan render AVATAR --motion counting --frame 0 -o x.png`, from process start to its end.

    Warm: Mesa's shader cache holds the programs; cold: it is off, as on a machine that never drew.
    """
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "x.png"
        argv = ["render", avatar, "--motion", "counting", "--frame", "0", "-o", out]
        for name, extra in (("warm", {}), ("cold", {"MESA_SHADER_CACHE_DISABLE": "true"})):
            surroundings = os.environ | extra
            runs = [started(argv, surroundings) for _ in range(repeats + (name == "warm"))]
            seconds = [took for took, _ in runs[name == "warm" :]]
            rows.append(
                row(
                    f"first frame, shader cache {name}", min(seconds), "s",
                    f"best of {repeats}; median {np.median(seconds):.2f}", most=1.0,
                )
            )  # fmt: skip
        rows.append(row("resident memory, one picture", max(rss for _, rss in runs), "MiB", "peak", most=250.0))
    return rows


def film_memory(avatar: Path) -> list[Row]:
    """Peak memory of filming the counting clip."""
    with tempfile.TemporaryDirectory() as folder:
        _, rss = started(
            ["render", avatar, "--motion", "counting", "--frames", "0:90", "-o", Path(folder) / "x.mp4"],
            dict(os.environ),
        )
    return [row("resident memory, film", rss, "MiB", "peak, 90 frames to mp4, encoder included", most=250.0)]


def installed(keep: Path | None = None) -> list[Row]:
    """Size of a fresh environment after `pip install` of the project without extras, MB (10^6 bytes on disk)."""
    if not (ROOT / "pyproject.toml").is_file():
        raise AssetError(f"{ROOT}: the base install is measured from a source checkout; there is none")
    with tempfile.TemporaryDirectory() as folder:
        place = keep or Path(folder) / "venv"
        venv.create(place, with_pip=True, clear=True)
        empty = on_disk(place)
        begun = time.perf_counter()
        done = subprocess.run(
            [place / "bin" / "python", "-m", "pip", "install", "--quiet", ROOT],
            capture_output=True,
            text=True,
        )
        if done.returncode:
            raise AssetError(f"pip install {ROOT}: {done.stderr.strip()[-300:]}")
        took, whole = time.perf_counter() - begun, on_disk(place)
        largest = sorted(
            ((on_disk(p), p.name) for p in place.glob("lib/python*/site-packages/*") if p.name != "pip"),
            reverse=True,
        )
    told = ", ".join(f"{name} {size / 1e6:.0f}" for size, name in largest[:5])
    return [
        row("base install", (whole - empty) / 1e6, "MB", f"{told}; {took:.0f} s with downloads", most=250.0),
        row("base install, with pip itself", whole / 1e6, "MB", "the whole environment"),
    ]


def on_disk(path: Path) -> int:
    """Bytes of a folder or file as the disk holds them, links not followed."""
    total = path.lstat().st_blocks * 512
    if path.is_dir() and not path.is_symlink():
        total += sum(p.lstat().st_blocks * 512 for p in path.rglob("*"))
    return total


# filming


def film_ratio(
    context: Context,
    avatar: Avatar,
    poses: Sequence[BarePose],
    camera: Camera,
    *,
    frames: int = 60,
    rounds: int = 5,
) -> list[Row]:
    """Frames a second of drawing alone, encoding alone and filming, side by side in alternating rounds."""
    renderer = Renderer(context, [avatar], camera.size, background=(0.17, 0.18, 0.2, 1.0))
    try:
        ready = [renderer.draw([pose], camera) for pose in poses]

        def draw(_round: int) -> None:
            for n in range(frames):
                renderer.draw([poses[n % len(poses)]], camera)

        def encode(_round: int) -> None:
            with tempfile.TemporaryDirectory() as folder, Film(Path(folder) / "x.mp4", 30.0) as film:
                for n in range(frames):
                    film.add(ready[n % len(ready)])

        def both(_round: int) -> None:
            with tempfile.TemporaryDirectory() as folder, Film(Path(folder) / "x.mp4", 30.0) as film:
                for n in range(frames):
                    film.add(renderer.draw([poses[n % len(poses)]], camera))

        times = alternate(
            {job.__name__: timed(job) for job in (draw, encode, both)}, seconds=0, least=rounds, most=rounds
        )
    finally:
        renderer.release()
    a, b, c = (times[name].rounds / frames for name in ("draw", "encode", "both"))
    share = np.median((np.maximum(a, b) if not context.software else a + b) / c)
    against = "1 / (1/draw + 1/encode)" if context.software else "the slower of the two"
    size = f"{camera.size[0]}x{camera.size[1]} mp4"
    rates = [1000 / float(np.median(ms)) for ms in (a, b, c)]
    return [
        row(f"film {size}, {name}", rate, "frames/s", f"{rounds} rounds of {frames} frames")
        for name, rate in zip(("drawing alone", "encoding alone", "drawn and encoded"), rates, strict=True)
    ] + [row("film speed, share of what is possible", share, "", f"of {against}", least=0.8)]


def timed(job):
    """A job as a turn of one frame."""

    def turn(number: int) -> Turn:
        start, used = time.perf_counter(), time.process_time()
        job(number)
        wall = 1e3 * (time.perf_counter() - start)
        return Turn(np.array([wall]), np.array([1e3 * (time.process_time() - used)]))

    return turn


# live


def live_latency(
    context: Context,
    avatar: Avatar,
    camera: Camera,
    *,
    seconds: float | int = 8.0,
    fuzz_seconds: float | int = 3.0,
) -> list[Row]:
    """VMC of 55 bones at 240 Hz from another process over UDP, drawn as fast as it goes and read back; then the same
    with 10,000 spoilt packets a second beside it."""
    inbox = Inbox("vmc")
    renderer = Renderer(context, [avatar], camera.size)
    listener = listen(Address("vmc", "127.0.0.1", 0), inbox)
    try:
        playback = LivePlayback(inbox, listener.address, [avatar])
        image = renderer.draw(playback.poses(), camera)

        def draw_for(duration: float) -> tuple[float, int]:
            begun, frames = time.perf_counter(), 0
            while time.perf_counter() - begun < duration:
                renderer.draw(playback.poses(), camera)
                playback.drawn()
                frames += 1
            return time.perf_counter() - begun, frames

        with sending(listener.address.port, rate=240.0):
            playback.wait_for_pose()
            draw_for(0.5)
            playback.latency.spans.clear()
            before = inbox.counters.frames
            took, frames = draw_for(seconds)
            rate, spans = (inbox.counters.frames - before) / took, 1000 * np.array(playback.latency.spans)
        ms = 1000 * took / frames
        with sending(listener.address.port, rate=240.0, fuzz=10_000.0):
            begun, spoilt = time.perf_counter(), inbox.counters.malformed
            while inbox.counters.malformed == spoilt and time.perf_counter() - begun < PATIENCE:
                # until the sender is up
                draw_for(0.1)
            received, spoilt = inbox.counters.received, inbox.counters.malformed
            draw_for(fuzz_seconds)
            received, spoilt = inbox.counters.received - received, inbox.counters.malformed - spoilt
        time.sleep(0.3)  # the last packets
        held = playback.poses()[0][0]
        again = renderer.draw(playback.poses(), camera)
    finally:
        listener.close()
        renderer.release()
    waited, whole = np.percentile(spans[:, 1], 95), np.percentile(spans[:, 2], 95)
    fine = bool(np.isfinite(held).all() and (again[..., 3] > 0).any() and again.shape == image.shape)
    return [
        row("live: received to taken for drawing, p95", waited, "ms",
            f"55-bone VMC, {rate:.0f} of 240 poses/s read while drawing a frame in {ms:.1f} ms; median "
            f"{np.median(spans[:, 1]):.2f}", most=round(ms, 2)),
        row("live: received to picture in memory, p95", whole, "ms", f"median {np.median(spans[:, 2]):.2f}",
            most=round(1000 / 60 + ms, 2)),
        row("live: spoilt packets taken in a second", received / fuzz_seconds, "1/s",
            f"{spoilt} of {received} counted as malformed; afterwards the last good pose "
            + ("is drawn" if fine else "IS LOST")),
    ]  # fmt: skip


# a long run


def long_run(avatar: Avatar, poses: Sequence[BarePose], *, frames: int = 10_000, size=(320, 320)) -> list[Row]:
    """Growth of GL objects, GL memory and resident memory over many frames of the dearest view mode."""
    from player.budget.ladder import views_of
    from player.scene.framing import fitted_camera

    camera = fitted_camera(np.array([p[1] for p in poses]) + [[0, 0.9, 0]], 0.0, size)
    with counting():
        context = open_context()
    counts = counts_of(context)
    try:
        renderer = Renderer(context, [avatar], size, view=views_of(avatar)[0])
        for n in range(SETTLED):
            renderer.draw([poses[n % len(poses)]], camera)
        objects, held, memory = counts.objects(), counts.live_bytes, resident()
        for n in range(frames):
            renderer.draw([poses[n % len(poses)]], camera)
        grown = sum(counts.objects().values()) - sum(objects.values())
        memory_grown, gl_grown = resident() - memory, counts.live_bytes - held
    finally:
        context.release()
    return [
        row(f"{frames} frames: GL objects more", grown, "", f"{sum(objects.values())} live", most=0),
        row(f"{frames} frames: GL memory more", gl_grown / MIB, "MiB", f"{held / MIB:.1f} MiB live", most=0),
        row(f"{frames} frames: resident memory more", memory_grown, "MiB", f"{memory:.0f} MiB before", most=4),
    ]


def resident() -> float:
    """Resident memory of this process now, MiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / MIB


KINDS = ("first", "memory", "install", "film", "live", "long")


def measure(kinds: Sequence[str], path: Path, context: Context, poses: Sequence[BarePose], camera: Camera) -> list[Row]:
    """The rows of these kinds; a kind that cannot be measured here gives one row that says why."""
    avatar = read_avatar(path)
    jobs = {
        "first": lambda: first_frame(path),
        "memory": lambda: film_memory(path),
        "install": installed,
        "film": lambda: film_ratio(context, avatar, poses, camera),
        "live": lambda: live_latency(context, avatar, camera),
        "long": lambda: long_run(avatar, poses),
    }
    rows: list[Row] = []
    for kind in kinds:
        print(f"measuring: {kind}", flush=True)
        try:
            rows += jobs[kind]()
        except (AssetError, OSError) as error:
            rows.append({"name": kind, "value": None, "unit": "", "detail": f"not measured: {error}"})
    return rows
