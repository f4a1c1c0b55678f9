"""Accuracy against time of one avatar on this machine (`selfscan bench`): a page that plays, table, JSON, plot.

Every rung of the player's ladder, and the field it was baked from when the run is given, is timed on a few
frames by alternating rounds and compared with the best rung, and with the truth when the capture is given.
"""

import os
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.gltf.avatar_file import read_avatar
from bench.bench_command import BenchCommand
from bench.ladder.machine import Quiet
from bench.ladder.rung_pictures import SIZE, MeasuredRung, held_out_frames, motion_frames, rung_pictures
from bench.ladder.rung_scores import crop_of, mark_dominated, part_boxes, person_scores, row_of
from bench.report.frontier.page import PagePictures, frontier_page
from bench.report.rung_page import markdown, plot
from bench.report.writer import Json
from files.whole import whole_folder, write_json, write_text
from player.budget.ladder import Timing, rungs_of, time_rungs
from player.budget.rung import Rung
from player.gl.context import open_context

Pictures = list[Float[Array, "height width 3"]]


def bench(command: BenchCommand) -> Json:
    """Measure the ladder, write bench.html, bench.json, bench.md and pareto.png into its folder."""
    assert command.avatar is not None
    avatar, capture, field, rounds = read_avatar(command.avatar), command.capture, None, command.rounds
    if command.run is not None:
        from bench.field.rungs import field_rungs  # they bring torch
        from train.run import read_run

        # before minutes of timing: it may be no run
        field = partial(field_rungs, read_run(command.run))
    count, size = command.frames, command.size or SIZE
    frames = held_out_frames(capture, count) if capture is not None else motion_frames(avatar, count, size)
    with open_context() as context:
        rungs = rungs_of(avatar)
        seen, full = [(frame.pose, frame.camera) for frame in frames], frames[0].camera.size
        with Quiet() as quiet:
            timings = time_rungs(context, avatar, rungs, seen, full, rounds=rounds)
        measured = [
            MeasuredRung(timed_row(rung, timing, timings[0]), timing.ms, rung_pictures(context, avatar, rung, frames))
            for rung, timing in zip(rungs, timings, strict=True)
        ]
        if field is not None:
            measured = [*field(context, frames, measured[0].row["ms_median"]), *measured]
        truths = [f.truth.image() for f in frames if f.truth is not None]

    rows, pictures = [one.row for one in measured], {one.row["name"]: one.pictures for one in measured}
    best, baked = rows[0]["name"], rungs[0].name
    # where the person is: as the truth says, else where anything was drawn
    masks = [shown.max(-1) > 0 if frame.truth is None else frame.truth.mask()
             for frame, shown in zip(frames, pictures[best], strict=True)]  # fmt: skip
    crops = [crop_of(mask) for mask in masks]
    parts = [part_boxes(avatar, *frame.pose, frame.camera) for frame in frames]
    references: dict[str | None, Pictures] = {None: pictures[best]}
    references |= {} if best == baked else {"against_baked": pictures[baked]}
    references |= {} if capture is None else {"against_truth": truths}
    drawn = [one.pictures for one in measured]
    # FLIP is most of a report's time
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as cores:
        for against, reference in references.items():
            scores = cores.map(partial(person_scores, reference, crops, masks, parts), drawn)
            for row, found in zip(rows, scores, strict=True):
                row |= found if against is None else {against: found}
            mark_dominated(rows, [one.ms for one in measured], against)
    result = {
        "format": "selfscan-bench",
        **quiet.facts(context),
        "avatar": avatar.name,
        "frames": len(frames),
        "size": list(full),
        "rounds": rounds,
        "best_rung": best,
        "best_baked_rung": baked,
        "rungs": rows,
    }
    first = PagePictures(
        {name: shown[0] for name, shown in pictures.items()}, truths[0] if truths else None, crops[0], parts[0]
    )
    with whole_folder(command.out) as folder:
        write_json(folder / "bench.json", result)
        write_text(folder / "bench.md", markdown(result))
        write_text(folder / "bench.html", frontier_page(result, first, avatar, rungs))
        plot(result, folder / "pareto.png")
    return result


def timed_row(rung: Rung, timing: Timing, best: Timing) -> Json:
    faster = round(float(np.median(best.ms / timing.ms)), 3)
    return row_of(rung.name, timing.ms, timing.bytes) | {"start_ms": round(timing.start_ms, 1), "times_faster": faster}
