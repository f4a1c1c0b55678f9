"""What textures from the videos gain over the field's, on true pictures that nothing was trained on.

    python -m experiments.texture AVATAR.glb RUN [--capture CAPTURE] [-o OUT.glb] [--poses 20]

AVATAR.glb is RUN baked with `--texture-from field`. Its atlas is solved against the videos of the run (or of CAPTURE,
say of larger frames of the same person) and both avatars are drawn by the player, paper mode, beside the held-out
pictures: PSNR inside the mask of the whole person, head and hands; then how much of printed cloth is there
(experiments/print_bands.py). Seconds are the processor's; memory is the process's highest.
"""

import argparse
import json
import resource
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

# before any GL context: it loads an LLVM that crashes when Mesa's came first
import torch._dynamo  # noqa: F401

from avatar.gltf.avatar_file import Avatar, Level, read_avatar, write_avatar
from bake.bake import with_video_textures
from bake.cone import ViewCone
from bake.level import BakedLevel, Charted, places_on_finest
from bake.run_capture import run_videos
from bake.texture.seams import chart_edges
from capture.held_out import SETS, read_held_out, some_poses
from experiments.print_bands import print_bands
from experiments.view_modes import decibels_by_region, mode_errors
from player.gl.context import open_context
from train.run import read_facts


def level_of_file(level: Level) -> BakedLevel:
    """A level of an avatar file as the bake had it, but for its facts."""
    uv, points, normals = (values.astype(np.float64) for values in (level.uv, level.positions, level.normals))
    faces = level.faces.astype(np.int64)
    cone = ViewCone(*(values.astype(np.float64) for values in (level.view_dir, level.view_q, level.view_seen)))
    _, source = np.unique(level.positions, axis=0, return_inverse=True)
    edges = chart_edges(uv, faces, source.reshape(-1))
    return BakedLevel(level, Charted(uv, faces, points, normals, cone), edges, {})


def retextured(avatar: Avatar, run: Path, capture: Path | None) -> tuple[Avatar, dict[str, Any]]:
    """The avatar with its textures solved against the videos, and what the solve says of itself."""
    levels = [level_of_file(level) for level in avatar.levels]
    places = [places_on_finest(level, levels[0]) for level in levels[1:]]
    videos = run_videos(run, read_facts(run), capture)
    levels, facts = with_video_textures(levels, places, avatar.joint_positions, videos, print)
    facts["seam_steps"] = [level.facts["seam_step"]["mips"] for level in levels]
    return replace(avatar, levels=tuple(level.level for level in levels)), facts


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m experiments.texture", description=__doc__)
    parser.add_argument("avatar", type=Path)
    parser.add_argument("run", type=Path)
    parser.add_argument("--capture", type=Path, help="videos, where run.json does not find them")
    parser.add_argument("--truth", type=Path, help="capture with true pictures (default: --capture)")
    parser.add_argument("-o", "--out", type=Path, help="avatar with the new textures")
    parser.add_argument("--poses", type=int, help="of each held-out set (default: all)")
    options = parser.parse_args(argv)
    avatar = read_avatar(options.avatar)
    began = time.process_time()
    new, found = retextured(avatar, options.run, options.capture)
    found["cpu_seconds"] = round(time.process_time() - began, 1)
    found["peak_memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
    if options.out:
        write_avatar(options.out, new)
    truth = options.truth or options.capture
    with open_context() as context:
        for name in SETS:
            views = some_poses(read_held_out(truth, name), options.poses)
            scores = {
                label: decibels_by_region(mode_errors(context, one, views, ["off"])["off"])
                for label, one in (("field", avatar), ("videos", new))
            }
            gain = {key: _difference(scores["videos"][key], scores["field"][key]) for key in scores["field"]}
            found[name] = {**scores, "gain": gain}
            print(name, json.dumps(found[name]))
        found["print"] = {
            label: print_bands(context, one, truth)._asdict() for label, one in (("field", avatar), ("videos", new))
        }
    print(json.dumps(found, indent=1))
    return 0


def _difference(one: float | None, other: float | None) -> float | None:
    return None if one is None or other is None else round(one - other, 3)


if __name__ == "__main__":
    raise SystemExit(main())
