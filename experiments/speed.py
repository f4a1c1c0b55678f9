"""How fast the player draws: against the bare draw of the same mesh, against other players, and around the frame.

    python -m experiments.speed AVATAR -o DIR [--size 640x640 ...] [--seconds 20] [--rows all|none|first,live,...]
                          [--peers] [--peers-dir DIR] [--styles default,lightest]

docs/speed.md says what is measured and how. Writes speed.json, speed.md and speed.png into DIR.
"""

import argparse
import os
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from avatar.baked_avatar import Avatar, ViewNetwork
from avatar.camera import Camera
from avatar.gltf.avatar_file import read_avatar
from bench.ladder.machine import Quiet
from command.errors import AssetError
from experiments import speed_peers, speed_rows
from experiments.alternating import alternate, here
from experiments.bare_draw import BareDraw, coverage
from experiments.speed_page import markdown, plot
from files.whole import check_folder, whole_folder, write_json, write_text
from player.budget.ladder import views_of
from player.budget.rung import VIEW_NAMES
from player.draw.drawing import BarePose
from player.gl.context import Context, open_context
from player.scene.arguments import parse_size
from player.scene.framing import extent, facing, fitted_camera
from player.scene.motions import motion_for
from player.scene.renderer import Renderer

SIZES = ((640, 640), (1280, 720), (1920, 1080))
# of the counting clip, drawn in turn
POSES = 16
# timed frames of a program before the next one's turn
TURN = 3
# frames a second as a share of a bare skinned draw, and at 1280x720: what the project promises on two idle cores
SHARES = {"off": 0.9, "network": 0.65}
RATES_720 = {"off": 90.0, "network": 60.0}
TIMES_PEERS = 5.0


def with_stand_in(avatar: Avatar) -> tuple[Avatar, bool]:
    """The avatar with a view network, of random weights where its file has none; whether they are random.

    What a network costs does not depend on its weights.
    """
    if avatar.network is not None:
        return avatar, False
    rng = np.random.default_rng(0)

    def normal(*shape: int) -> np.ndarray:
        return (0.3 * rng.normal(size=shape)).astype(np.float32)

    levels = tuple(
        replace(
            level,
            features=rng.integers(0, 256, (level.base_color.shape[0] // 2, level.base_color.shape[1] // 2, 4)).astype(
                np.uint8
            ),
        )
        for level in avatar.levels
    )  # fmt: skip
    network = ViewNetwork(normal(16, 8), normal(16), normal(3, 16), normal(3))
    return replace(avatar, levels=levels, network=network, linear=normal(4, 3, 3)), True


def body_frames(avatar: Avatar) -> tuple[list[BarePose], Any]:
    """Poses of the counting clip, and the camera `selfscan render` would take for a size."""
    clip = motion_for(avatar, "counting").read(0, 120)
    chosen = np.linspace(0, 119, POSES).round().astype(int)
    poses = [(clip.axis_angle[i].astype(np.float64), clip.root[i].astype(np.float64)) for i in chosen]
    points, azimuth = (
        extent(avatar, clip),
        facing(clip.axis_angle[0], avatar.joint_positions.astype(np.float64)),
    )
    return poses, partial(fitted_camera, points, azimuth)


def time_size(
    context: Context, avatar: Avatar, poses: Sequence[BarePose], camera: Camera, seconds: float | int
) -> dict[str, Any]:
    """All our modes and both bare draws at one size, in alternating rounds."""
    bare = {
        "bare skinned draw": BareDraw(context, avatar, poses, camera),
        "bare skinned draw, plain sampling": BareDraw(context, avatar, poses, camera, sharp=False),
        "bare static draw": BareDraw(context, avatar, poses, camera, static=True),
    }
    ours = {view: Renderer(context, [avatar], camera.size, view=view) for view in views_of(avatar)}
    try:
        programs = {name: here(program.draw, TURN) for name, program in bare.items()}
        for view, renderer in ours.items():
            programs[VIEW_NAMES[view]] = here(partial(draw_number, renderer, poses, camera), TURN)
        with Quiet() as quiet:
            times = alternate(programs, seconds=seconds)
        share = float(np.mean([coverage(bare["bare skinned draw"].draw(n)) for n in range(len(poses))]))
    finally:
        for thing in (*bare.values(), *ours.values()):
            thing.release()
    rows = [
        {
            "name": name,
            **t.row(),
            "of_bare_skinned": t.share_of(times["bare skinned draw"]),
            "of_plain_sampling": t.share_of(times["bare skinned draw, plain sampling"]),
        }
        for name, t in times.items()
    ]
    rounds = len(next(iter(times.values())).rounds)
    return {
        "size": list(camera.size), "coverage": round(share, 4), "rounds": rounds, "frames": rounds * TURN,
        "others_cpu_share": quiet.others, "rows": rows,
    }  # fmt: skip


def draw_number(renderer: Renderer, poses: Sequence[BarePose], camera: Camera, number: int) -> np.ndarray:
    return renderer.draw([poses[number % len(poses)]], camera)


def time_peers(
    context: Context,
    avatar: Avatar,
    poses: Sequence[BarePose],
    camera: Camera,
    folder: Path,
    names: Sequence[str],
    styles: Sequence[str],
    seconds: float | int,
) -> dict[str, Any]:
    """Each peer in turns with our paper mode and network, one peer at a time."""
    views = [view for view in views_of(avatar) if view in ("off", "network")]
    rows, failed = [], {}
    with tempfile.TemporaryDirectory() as scratch:
        body = Path(scratch) / "body.npz"
        speed_peers.write_body(body, avatar, poses, camera)
        for style in styles:
            for name in names:
                ours = {view: Renderer(context, [avatar], camera.size, view=view) for view in views}
                try:
                    draws = {view: here(partial(draw_number, r, poses, camera), TURN) for view, r in ours.items()}
                    share = coverage(draw_number(ours["off"], poses, camera, 0))
                    rows.append(one_peer(folder, body, name, style, draws, seconds, share))
                except AssetError as error:
                    failed[f"{name}, {style}"] = str(error)
                finally:
                    for renderer in ours.values():
                        renderer.release()
    return {
        "size": list(camera.size),
        "vertices": len(avatar.levels[0].positions),
        "rows": rows,
        "failed": failed,
    }


def one_peer(
    folder: Path, body: Path, name: str, style: str, draws: dict, seconds: float | int, share: float
) -> dict[str, Any]:
    print(f"peer: {name}, {style}", flush=True)
    with Quiet() as quiet, speed_peers.running(folder, body, name, style) as peer:
        times = alternate(draws | {"peer": lambda number: peer.turn(number, TURN)}, seconds=seconds, least=8)
        seen = speed_peers.covered(peer, body.parent / "picture.npy")
    if abs(seen / share - 1) > speed_peers.ALIKE:
        raise AssetError(
            f"{name}: covers {100 * seen:.1f} % of the picture, ours {100 * share:.1f} %: not the same work"
        )
    return {
        "name": peer.facts["name"], "version": peer.facts["version"], "style": style,
        "settings": peer.facts["settings"], "coverage": round(seen, 4), **times["peer"].row(),
        "first_frame_s": round(peer.facts["first_frame_s"], 2),
        "ours_fps": {VIEW_NAMES[view]: times[view].row()["fps"] for view in draws},
        "ours_faster": {VIEW_NAMES[view]: times[view].share_of(times["peer"]) for view in draws},
        "others_cpu_share": quiet.others,
    }  # fmt: skip


def bars(sizes: Sequence[dict[str, Any]], peers: dict[str, Any] | None) -> list[dict[str, Any]]:
    """What the project promises of the frame itself, beside what was found."""
    out = []
    for view, least in SHARES.items():
        for size in sizes:
            if tuple(size["size"]) == SIZES[0] and (found := _row(size, view)):
                out.append(speed_rows.row(f"{VIEW_NAMES[view]} of the bare skinned draw, 640x640",
                                          found["of_bare_skinned"]["wall"], "",
                                          f"CPU time {found['of_bare_skinned']['cpu']:.2f}; of one with plain sampling "
                                          f"{found['of_plain_sampling']['wall']:.2f}", least=least))  # fmt: skip
            if tuple(size["size"]) == SIZES[1] and (found := _row(size, view)):
                out.append(speed_rows.row(f"{VIEW_NAMES[view]}, 1280x720", found["fps"], "frames/s", "median",
                                          least=RATES_720[view]))  # fmt: skip
    for style in ("default", "lightest"):
        rows = [row for row in (peers or {}).get("rows", []) if row["style"] == style]
        if rows:
            fastest = max(rows, key=lambda row: row["fps"])
            for view, facts in fastest["ours_faster"].items():
                out.append(speed_rows.row(
                    f"{view}: times the fastest peer ({style})", facts["wall"], "",
                    f"{fastest['name']}, {fastest['fps']:.1f} frames/s; CPU time {facts['cpu']:.1f} times",
                    least=TIMES_PEERS if style == "default" else None,
                ))  # fmt: skip
    return out


def _row(size: dict[str, Any], view: str) -> dict[str, Any] | None:
    return next((row for row in size["rows"] if row["name"] == VIEW_NAMES[view]), None)


def speed(
    path: Path,
    out: Path,
    *,
    sizes: Sequence[tuple[int, int]] = SIZES,
    seconds: float | int = 20.0,
    rows: Sequence[str] = speed_rows.KINDS,
    peers: Path | None = None,
    peer_names: Sequence[str] = tuple(speed_peers.PACKAGES),
    styles: Sequence[str] = ("default", "lightest"),
) -> dict[str, Any]:
    """Measure, write speed.json, speed.md and speed.png into folder `out`, and return what was written."""
    out.parent.mkdir(parents=True, exist_ok=True)
    check_folder(out)
    avatar, stand_in = with_stand_in(read_avatar(path))
    poses, camera_of = body_frames(avatar)
    with open_context() as context, Quiet() as quiet:
        measured = []
        for size in sizes:
            print(f"measuring: {size[0]}x{size[1]}", flush=True)
            measured.append(time_size(context, avatar, poses, camera_of(size), seconds))
        found = None
        if peers is not None:
            found = time_peers(context, avatar, poses, camera_of(SIZES[0]), peers, peer_names, styles, seconds / 2)
        session = speed_rows.measure(rows, path, context, poses, camera_of(SIZES[0]))
    result = {
        "format": "selfscan-speed",
        "version": 1,
        "date": datetime.now(UTC).date().isoformat(),
        **quiet.facts(context),
        "avatar": avatar.name,
        "faces": len(avatar.levels[0].faces),
        "vertices": len(avatar.levels[0].positions),
        "texture": list(avatar.levels[0].base_color.shape[:2]),
        "network": "random weights: the file has none" if stand_in else "the file's",
        "sizes": measured,
        "peers": found,
        "rows": session,
        "bars": bars(measured, found),
    }
    with whole_folder(out) as folder:
        write_json(folder / "speed.json", result)
        write_text(folder / "speed.md", markdown(result))
        plot(result, folder / "speed.png")
    return result


def main(argv: list[str] | None = None) -> int:
    """`python -m experiments.speed AVATAR -o DIR`."""
    parser = argparse.ArgumentParser(prog="python -m experiments.speed", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("avatar", metavar="AVATAR", type=Path, help="avatar file (.glb)")
    parser.add_argument("-o", dest="out", metavar="DIR", type=Path, required=True, help="folder to write")
    parser.add_argument("--size", type=parse_size, action="append", metavar="WxH",
                        help="picture size, may be repeated (default: 640x640, 1280x720, 1920x1080)")  # fmt: skip
    parser.add_argument("--seconds", type=float, default=20.0, help="timing of each size (%(default)s)")
    parser.add_argument("--rows", default="all",
                        help=f"around the frame: all, none, or some of {','.join(speed_rows.KINDS)}")  # fmt: skip
    parser.add_argument("--peers", nargs="?", const=",".join(speed_peers.PACKAGES), metavar="NAMES",
                        help="time other players too: all, or some of %(const)s")  # fmt: skip
    parser.add_argument("--peers-dir", type=Path, metavar="DIR",
                        help="where their environments are, or will be installed (8 GB for all)")  # fmt: skip
    parser.add_argument("--styles", default="default,lightest", help="settings of the peers (%(default)s)")
    options = parser.parse_args(argv)
    named = {"all": list(speed_rows.KINDS), "none": []}.get(options.rows, options.rows.split(","))
    peers = options.peers.split(",") if options.peers else []
    styles = options.styles.split(",")
    for what, given, known in (
        ("--rows", named, speed_rows.KINDS),
        ("--peers", peers, tuple(speed_peers.PACKAGES)),
        ("--styles", styles, ("default", "lightest")),
    ):
        if unknown := [name for name in given if name not in known]:
            parser.error(f"{what}: no {', '.join(unknown)}; there are {', '.join(known)}")
    if not options.seconds > 0:
        parser.error(f"--seconds should be positive, is {options.seconds}")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    folder = (options.peers_dir or speed_peers.default_folder()) if peers else None
    try:
        result = speed(
            options.avatar,
            options.out,
            sizes=options.size or SIZES,
            seconds=options.seconds,
            rows=named,
            peers=folder.resolve() if folder else None,
            peer_names=peers,
            styles=styles,
        )
    except AssetError as error:
        print(f"experiments.speed: {error}")
        return 1
    print(markdown(result))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
