"""Rendering: from what a command asks for to a picture, frames or a film."""

import math
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from avatar.baked_avatar import Avatar
from command.errors import AssetError, missing_package
from command.progress import Progress, plural, progress
from files.whole import check_file, check_folder, exclusive_lock, write_json
from player.budget.ladder import choice_words
from player.budget.measure import BudgetScene
from player.budget.rung import Rung
from player.budget.table import rung_within
from player.film.command import RenderCommand
from player.film.film import VIDEO, film_kind, join_pieces
from player.film.parts import LENGTH, Parts
from player.film.shot import FULL, Shot, ShotRenderer, with_whole_paths
from player.film.stage import Fit, Stage, camera_from_option
from player.gl.context import Context, open_context
from player.scene.arguments import with_effects, with_options
from player.scene.effects import Effects
from player.scene.motions import frame_range
from player.scene.opened import still_faces
from player.scene.renderer import Renderer
from player.scene.scene import BUILTIN, Scene, SceneAvatar, SceneCamera, side_by_side

# 3,000 triangles of a baked avatar: coarser levels are for people far away
DRAFT_LEVEL = 2
BUDGET_FRAMES = 4  # frames of a film that a budget is measured on
FASTEST = 60.0  # frames a second of a film, unless more are asked for


def render(command: RenderCommand) -> None:
    """Draw a picture, frames or a film, as `selfscan render` does; what it did is printed.

    Raises:
        AssetError: a file cannot be read or written, or no OpenGL context can be had.
    """
    if film_kind(command.output):
        check_file(command.output)
    else:
        check_folder(command.output, Path(command.camera) if command.camera else None)
    if command.json:
        check_file(command.json)
    scene = scene_of(command)
    # while files are read and unpacked, the driver wakes up; both are work outside of Python
    with ThreadPoolExecutor(1) as pool:
        # what a budget buys may be any of them
        reading = pool.submit(Stage, scene, None if command.budget else level_of(command) + 1)
        context = None if command.workers else open_context(command.context, command.gpu)
        try:
            try:
                stage = reading.result()
            finally:
                # if it failed it keeps its error, and that this frame with all that is open
                del reading
            render_stage(command, stage, context)
        finally:
            if context is not None:
                context.release()


def render_stage(command: RenderCommand, stage: Stage, context: Context | None) -> None:
    """Draw what the command asks for, from an opened scene, with this context (None: workers draw)."""
    stage.scene = replace(stage.scene, effects=effects_for(command.quality, stage.scene.effects, stage.avatars))
    kind, frame, frames = film_kind(command.output), command.frame, stage.frames
    if frame is not None and stage.camera.kind == "turntable" and stage.still is None:
        frame_range(stage.name, frames, None, frame)
        stage.hold(frame / stage.rate)
        frame = None
    start, stop = frame_range(stage.name, stage.frames, command.frames, frame, kind == ".png")
    if kind == ".png":
        if frames > 1:
            other = "; --frame N draws another" if command.frame is None else ""
            print(f"{stage.name}: frame {command.frame or 0} of {plural(frames, 'frame')}{other}")
    else:
        start, stop = at_rate(command, stage, start, stop)
    rung, fit = replace(FULL, level=level_of(command)), stage.fit(start, stop)
    if command.budget:
        assert context is not None, "workers are refused with a budget"
        rung = buy_rung(command, stage, context, fit, start, stop)
    stage.notes += still_faces(stage.tracks, stage.avatars, rung.level)
    shot = Shot(
        stage.scene, start, stop, stage.size(), stage.rate, fit, stage.still, rung,
        command.quality, command.context, command.gpu,
    )  # fmt: skip
    shared = bool(command.resume or command.workers)
    if kind == ".png" or not (shared or (stop - start > LENGTH and kind in ("", *VIDEO))):
        film_at_once(command, shot, stage, context)
    else:
        with exclusive_lock(Path(command.output)):
            film_in_parts(command, shot, stage, context)


def buy_rung(command: RenderCommand, stage: Stage, context: Context, fit: Fit | None, start: int, stop: int) -> Rung:
    """The rung, chosen by what they cost on this machine; its view mode is put into the scene. A film keeps it from its
    first frame to its last."""
    size, scene, budget = stage.size(), stage.scene, command.budget
    assert budget is not None
    camera_at = stage.camera_at(fit, start, stop, size)
    timed = np.unique(np.linspace(start, stop - 1, BUDGET_FRAMES).round().astype(int)).tolist()
    frames = [(poses := stage.poses(frame), camera_at(frame, poses[0][1])) for frame in timed]
    drawn = BudgetScene(stage.avatars, frames, size, scene.effects, scene.background, reads_back=True)
    try:
        priced, chosen = rung_within(
            context, drawn, [entry.path for entry in scene.avatars], budget=budget, level=command.level
        )
    except ValueError as error:
        raise AssetError(str(error)) from None
    stage.notes.append(choice_words(chosen, priced, budget))
    stage.scene = replace(scene, effects=replace(scene.effects, view=chosen.rung.view))
    return chosen.rung


def at_rate(command: RenderCommand, stage: Stage, start: int, stop: int) -> tuple[int, int]:
    """The film's frames for the frames start .. stop - 1 of the motion, at the rate asked for.

    A rate that no one asked for is at most FASTEST, the motion's divided by a whole number: every second, third ...
    frame as it is.
    """
    before = stage.rate
    rate = command.rate or (before if stage.scene.rate else before / math.ceil(before / FASTEST))
    if rate == before or (command.rate is None and command.frame is not None):
        return start, stop
    stage.film_at(rate)
    if command.rate is None:
        filmed = f"filmed at {rate:g} (--rate {before:g} takes all)"
        stage.notes.append(f"{stage.name}: {before:g} frames a second, {filmed}")
    if stage.still is not None:
        return 0, stage.frames
    first, last = (min(math.ceil(frame * rate / before - 1e-6), stage.frames) for frame in (start, stop))
    if first >= last:
        raise AssetError(f"--rate {rate:g}: frames {start}:{stop} are shorter than one frame of the film")
    return first, last


def level_of(command: RenderCommand) -> int:
    if command.level is not None:
        return command.level
    return DRAFT_LEVEL if command.quality == "draft" else 0


def scene_of(command: RenderCommand) -> Scene:
    """The scene that the command asks for; its options override what a scene file says."""
    if command.scene:
        from player.scene.scene_file import read_scene

        scene = read_scene(command.scene)
    else:
        like = SceneAvatar(
            BUILTIN, hands=command.hands, ground=command.ground, body=command.body, life=command.life,
            speech=command.speech,
        )  # fmt: skip
        scene = Scene(side_by_side(command.avatar, [command.motion], like=like))
    if command.camera is not None:
        scene = replace(scene, cameras=(camera_from_option(command.camera),))
    if command.seconds is not None:
        camera = replace((scene.cameras or (SceneCamera(),))[0], seconds=command.seconds)
        scene = replace(scene, cameras=(camera,))
    effects = with_effects(scene.effects, command.effects)
    return with_options(scene, effects, command.size, command.background)


def effects_for(quality: str, effects: Effects, avatars: Sequence[Avatar]) -> Effects:
    """What a quality means for the effects that are left open."""
    views = {"draft": {"off"}, "best": {avatar.default_view for avatar in avatars}}.get(quality, set())
    smooth = {"draft": "none", "best": "msaa"}.get(quality, "auto")
    view = views.pop() if effects.view == "auto" and len(views) == 1 else effects.view
    return replace(effects, view=view, antialiasing=smooth if effects.antialiasing == "auto" else effects.antialiasing)


def film_at_once(command: RenderCommand, shot: Shot, stage: Stage, context: Context | None) -> None:
    """Draw and encode the whole film in this process."""
    path, began = Path(command.output), time.perf_counter()
    with ShotRenderer(shot, stage, context) as drawn:
        film = drawn.film(path, progress(range(shot.start, shot.stop), "frames", shot.stop - shot.start))
        took, rate = time.perf_counter() - began, (shot.stop - shot.start) / max(drawn.drawing, 1e-9)
        print_notes(stage, [*film.notes, drawing_summary(drawn)])
        print_result(shot, path, f"drawn at {rate:.0f} frames/s, written in {took:.1f} s")
        if command.explain:
            print_passes(drawn.renderer, command.json)


def film_in_parts(command: RenderCommand, shot: Shot, stage: Stage, context: Context | None) -> None:
    """Draw the parts that are missing, here or on a cluster, and join them when all are there."""
    path = Path(command.output)
    shot = replace(shot, scene=with_whole_paths(shot.scene))
    parts = Parts(path, shot.start, shot.stop, shot.identity())
    parts.begin(resume=command.resume)
    missing, total = parts.missing(), shot.stop - shot.start
    present = total - sum(b - a for a, b in missing)
    if present:
        print(f"{present} of {plural(total, 'frame')} {'is' if present == 1 else 'are'} in {parts.folder}")
    began, notes = time.perf_counter(), []
    try:
        if missing and command.workers:
            notes = draw_on_cluster(command.workers, shot, parts)
        elif missing:
            frames = chain.from_iterable(range(*part) for part in missing)
            with ShotRenderer(shot, stage, context) as drawn:
                film = drawn.film(path, progress(frames, "frames", total - present), list(map(parts.piece, missing)))
                notes = [*film.notes, drawing_summary(drawn)]
                if command.explain:
                    print_passes(drawn.renderer, command.json)
    except BaseException:
        written = len(parts.ranges) - len(parts.missing())
        if written:
            print(f"{written} of {plural(len(parts.ranges), 'part')} kept in {parts.folder}; the same command with "
                  f"--resume goes on", file=sys.stderr)  # fmt: skip
        else:
            parts.discard()
        raise
    print_notes(stage, notes)
    join_pieces(list(map(parts.piece, parts.ranges)), path, shot.rate)
    parts.discard()
    print_result(shot, path, f"in {plural(len(parts.ranges), 'part')}, written in {time.perf_counter() - began:.1f} s")


def draw_on_cluster(address: str, shot: Shot, parts: Parts) -> list[str]:
    """Draw the missing parts on a cluster; returns its notes for the user."""
    try:
        from player.film.cluster import draw_parts_on_cluster
    except ModuleNotFoundError as error:
        raise missing_package(error.name, "cluster", "--workers") from None

    missing = parts.missing()
    if address.isdecimal() and len(missing) < 2 * int(address):
        said = f"{plural(len(missing), 'part')} of at most {LENGTH} frames for {plural(int(address), 'worker')}"
        print(f"{said}: a film this short is drawn sooner without --workers")
    report, frames = Progress("frames", sum(b - a for a, b in missing)), 0
    notes: list[str] = []
    for (start, stop), drawn in draw_parts_on_cluster(address, shot, parts, parts.identity["files"]):
        frames += stop - start
        report.update(frames)
        notes += [line for line in (*drawn.notes, f"drawn by {drawn.renderer}") if line not in notes]
    return notes


def print_notes(stage: Stage, notes: Sequence[str]) -> None:
    """What was assumed of the scene, and what the drawing had to say."""
    for note in (*stage.notes, *notes):
        print(note)


def drawing_summary(drawn: ShotRenderer) -> str:
    return f"{drawn.context.attempts[-1]}; view {', '.join(drawn.renderer.views)}"


def print_result(shot: Shot, path: Path, rest: str) -> None:
    width, height = shot.size
    if film_kind(path) in VIDEO:
        from player.film.encoder import padded_size

        width, height = padded_size(shot.size)
    print(f"{path}: {plural(shot.stop - shot.start, 'frame')}, {width}x{height}, {rest}")


def print_passes(renderer: Renderer, json_path: str | None) -> None:
    """Print and write the passes of the last frame."""
    rows = renderer.explain()
    for row in rows:
        cost = f"{row['ms']:8.2f} ms {row['bytes'] / 1e6:8.2f} MB"
        print(f"  {row['name']:24} {row['state']:13} {cost}  {row['why']}")
    if json_path:
        write_json(Path(json_path), {"passes": rows})
