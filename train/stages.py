"""The stages of a training run (TotalSelfScan, 3.4): parts first, each from its own video; then one person."""

import io
import os
import platform
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import torch

from avatar.light import CaptureLight
from avatar.similarity import Registration, similarity_from_landmarks
from avatar.skeleton import PARTS
from capture.fit.align import ROUNDS
from capture.fit.refine import RefineJob, copy_refined, may_refine, refine_capture, with_learned, with_refined
from capture.folder import Capture, CaptureSubject, read_capture, read_subject, write_subject
from capture.light.fit import fit_capture_light, light_line
from capture.template.clothes import with_clothes
from capture.template.hull import with_hair
from capture.template.parts import with_rigid_head
from capture.videos import let_go
from command.errors import AssetError
from command.interrupt import prompt_stop
from command.progress import Progress, ProgressBoard, Reporter
from command.settings import settings_json
from command.workers import run_jobs
from files.whole import exclusive_lock, whole_folder
from train import run as run_folder
from train.command import TrainOptions
from train.compose import HeadPlacement, TrainedParts, compose, consistent_placement, landmark_placement, timed
from train.distributed import Ranks, join_ranks
from train.field import PartField
from train.light import video_light
from train.part_job import PartJob, megabytes, memory_text, step_note, train_part
from train.preset import Preset, chosen_preset
from train.seen import seen_parts
from train.session import Session, capture_digest, capture_place, digest_of, open_session
from train.trainer import Checkpoints, Watch, peak_memory
from train.union import read_rays

# the order of the parts in which two workers end together
HEAVIEST_FIRST = (1, 0, 2, 3)

T = TypeVar("T")


def clocks() -> np.ndarray:
    """Seconds of the wall clock and of the processor, this process and its finished children together."""
    return np.array([time.monotonic(), sum(os.times()[:4])])


@dataclass(frozen=True)
class Training:
    """A training under way: what its stages share."""

    options: TrainOptions
    preset: Preset
    # once refined, with the poses, masks and frames that this leaves of it
    capture: Capture
    session: Session
    ranks: Ranks
    # this rank's
    device: str
    # where the head's video lies on the template before anything is learned
    head: HeadPlacement
    say: Callable[[str], None]
    # as `clocks` stood
    began: np.ndarray
    # each video's; empty: light is no factor of its own
    lights: dict[str, CaptureLight] = field(default_factory=dict)
    # what was done to poses and masks, for run.json
    refined: dict[str, Any] = field(default_factory=dict)
    # seconds of what is done before the parts are trained, by name
    seconds: dict[str, float] = field(default_factory=dict)

    def from_writer(self, make: Callable[[], T]) -> T:
        """What `make` gives on the rank that writes, for all ranks."""
        return self.ranks.broadcast(make() if self.ranks.writes else cast(T, None))


def train(options: TrainOptions, preset: Preset | None = None) -> Path:
    """Train all parts, compose them, and write the run folder; `preset` replaces the one that the options name.

    Parts learn independently (stage 1), two at a time on a CPU with two cores, each on its own thread; under
    torchrun one after the other, each on all ranks. Checkpoints and logs lie beside the run folder, in RUN.partial,
    until the run is complete. A signal raises `Stopped` once they are saved.
    """
    with ExitStack() as held:
        training = begin(options, chosen_preset(options) if preset is None else preset, held)
        if training is not None:
            training = prepared(training)
            at = training.session.partial
            learned = [index for index in HEAVIEST_FIRST if index in training.preset.learned]
            seen = lambda: seen_parts(training.capture, training.preset, training.lights, at, options.seed)
            facts = training.from_writer(seen)
            if learned:
                facts |= train_parts(training, [part_job(training, at, index) for index in learned])
            finish(training, facts)
    return options.out


def begin(
    options: TrainOptions, preset: Preset, held: ExitStack, decides: dict[str, Any] | None = None
) -> Training | None:
    """A training with its capture and session; None where --resume finds it finished.

    `held` keeps the lock on the run folder and what signals do. `decides` is what else decides the result.
    """
    held.enter_context(prompt_stop())
    ranks, device = join_ranks(options.device)
    say: Callable[[str], None] = partial(print, flush=True) if ranks.writes else lambda text: None
    capture, session = read_capture(options.capture), None
    _check_like(options, preset, capture)
    if ranks.writes:
        held.enter_context(exclusive_lock(options.out))
        settings = _what_decides(options, preset, capture) | (decides or {})
        session = open_session(options.out, settings, resume=options.resume, force=options.force, say=say)
    session = ranks.broadcast(session)
    if session is None:
        return None
    began = clocks()
    head = landmark_placement(_register_landmarks(capture, say))
    if preset.learned:
        names = ", ".join(preset.names[index] for index in preset.learned)
        say(f"stage 1: {names} by volume rendering of signed distance (Eq. 10-12), preset {preset.name}")
        say(f"logs and checkpoints: {session.partial}")
    else:
        say("a first avatar: the template as carved, in the colors that the videos show; nothing is learned")
    return Training(options, preset, capture, session, ranks, device, head, say, began)


def prepared(training: Training) -> Training:
    """The training with refined poses and masks, the head's place, its own template and its light."""
    with timed(training.seconds, "poses and masks"):
        refined = _refine(training)
    # frames that were left out count nowhere from here on
    capture = with_refined(training.capture, training.session.partial)
    training = _with_consistent_head(replace(training, capture=capture, refined=refined))
    if training.options.like is not None:
        return _prepared_like(training, training.options.like)
    return _with_light(_with_own_template(training))


def _check_like(options: TrainOptions, preset: Preset, capture: Capture) -> None:
    """Whether the run that --like names prepared what this training would.

    Raises:
        AssetError: it did not, or one of the two refines poses first.
    """
    if options.like is None:
        return
    facts, numbers = run_folder.read_facts(options.like), settings_json(preset)
    names = ("hair", "clothes", "light")
    here = {name: numbers[name] for name in names} | {"seed": options.seed, "capture": capture_digest(capture.path)}
    there = {name: facts["settings"].get(name) for name in names}
    there |= {"seed": facts["seed"], "capture": facts["capture_at"]["digest"]}
    other = [name for name in here if here[name] != there[name]]
    if other:
        raise AssetError(f"--like {options.like}: expected the same {', '.join(here)} as here, its {other[0]} differs")
    if facts["refined"] or may_refine(capture, options.refine_poses):
        raise AssetError(f"--like {options.like}: poses are refined before hair and clothes are carved; leave it out")


def _prepared_like(training: Training, run: Path) -> Training:
    """The training with the template and the light of another run of the same capture."""
    capture = _with_template(training, read_subject(run / "subject.npz", training.capture.subject.name))
    training.say(f"hair, clothes and light as {run} found them")
    return replace(training, capture=capture, lights=run_folder.lights_of(run, run_folder.read_facts(run)))


def _what_decides(options: TrainOptions, preset: Preset, capture: Capture) -> dict[str, Any]:
    """What decides the result of a training: --resume needs the same again."""
    return {
        "capture": capture_digest(capture.path),
        "preset": preset.name,
        "iterations": [part.iterations for part in preset.parts],
        "seed": options.seed,
        "numbers": digest_of(settings_json(preset)),
        "refine_poses": options.refine_poses,
    }


def finish(training: Training, facts: dict[str, dict]) -> None:
    """From trained parts to the run folder; under torchrun the work of one rank.

    A preset of one part is a person of one network, which has no other part to meet; `facts` are the parts'.
    """
    if not training.ranks.writes:
        return
    preset, device, out, partial = training.preset, training.device, training.session.out, training.session.partial
    capture, head = with_learned(training.capture, partial), training.head
    seconds = training.seconds | {name: fact["seconds"] for name, fact in facts.items()}
    fields = read_fields(training, partial)
    torch.set_num_threads(os.cpu_count() or 1)
    progress = Progress("body, stage 2", preset.union.iterations)
    with whole_folder(out) as folder:
        place = head.canonical_from_head
        lights = {part: video_light(training.capture, part, light, place) for part, light in training.lights.items()}
        parts = TrainedParts(
            fields=fields, rays=read_rays(partial / "body.rays", torch.device(device)) if preset.meets else None,
            head=head, seed=training.options.seed, seconds=seconds, lights=lights,
        )  # fmt: skip
        person = compose(
            capture, parts, preset, training.say, device=device,
            checkpoints=Checkpoints(path=partial / "union.ckpt", resume=training.session.resumed),
            watch=Watch(report=lambda step, report: progress.update(step, step_note(report))),
        )  # fmt: skip
        if preset.meets:
            shutil.copyfile(partial / "body.pt", folder / "body_stage1.pt")
        for name, field in zip(preset.names, fields):
            run_folder.write_part(folder / f"{name}.pt", field)
        copy_refined(partial, folder)
        if (partial / "logs").is_dir():
            shutil.copytree(partial / "logs", folder / "logs")
        run_folder.write_surface(folder / "surface.npz", person.surface)
        if person.eyes is not None:
            run_folder.write_eyes(folder / "eyes.npz", person.eyes)
        shutil.copyfile(partial / "subject.npz", folder / "subject.npz")
        seconds["all"] = float((clocks() - training.began)[0])
        run_folder.write_json(folder / "run.json", _run_facts(training, facts, seconds) | person.facts)
    shutil.rmtree(partial, ignore_errors=True)
    memory = memory_text(peak_memory(device))
    training.say(f"{out}: {len(person.surface.vertices)} surface vertices, {seconds['all']:.0f} s, {memory}")


def _run_facts(training: Training, parts: dict[str, dict], seconds: dict[str, float]) -> dict[str, Any]:
    """What run.json says of the training; composition adds to it."""
    preset, facts = training.preset, training.capture.facts
    memory = {name: fact["peak_memory_mb"] for name, fact in parts.items()}
    return {
        "subject": training.capture.subject.name,
        "preset": preset.name,
        "settings": settings_json(preset),
        "seed": training.options.seed,
        "device": training.device,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, torch {torch.__version__}",
        "capture": facts,
        "capture_at": capture_place(training.capture.path, training.session.out),
        "body_licence": facts.get("body_licence", "not stated by the capture"),
        "subject_licence": facts.get("subject_licence", "not stated by the capture"),
        "canonical_pose": "hips opened 30 degrees about z (avatar.skeleton.BIG_POSE)",
        "seconds": {name: round(value, 1) for name, value in seconds.items()},
        # with its workers', without other ranks'; of the last sitting, as the seconds are
        "cpu_seconds": round(float((clocks() - training.began)[1]), 1),
        "resumed": training.session.resumed,
        "peak_memory_mb": memory | {"composition": megabytes(peak_memory(training.device))},
        "parts": parts,
        "refined": training.refined,
        "light": None,
    }


def read_fields(training: Training, folder: Path, count: int | None = None) -> list[PartField]:
    """The first `count` trained parts, or all, from a folder."""
    parts = list(zip(training.preset.names, training.preset.parts, strict=True))[:count]
    subject = training.capture.subject
    return [run_folder.read_part(folder / f"{name}.pt", subject, index, own) for index, (name, own) in enumerate(parts)]


def _register_landmarks(capture: Capture, say: Callable[[str], None]) -> Registration:
    """Eq. 6: canonical_from_head, a similarity; AssetError where the landmarks do not fit the template."""
    video = capture.videos["head"]
    assert video.landmarks is not None and video.landmark_vertices is not None
    landmarks = similarity_from_landmarks(video.landmarks, capture.subject.vertices[video.landmark_vertices])
    say(f"head frame by {len(video.landmarks)} landmarks (Eq. 6): residual {landmarks.residual * 1000:.1f} mm")
    if landmarks.residual > 0.02:
        raise AssetError(
            f"{capture.path / 'head' / 'landmarks.json'}: landmarks should fit the template within 20 mm, "
            f"are {landmarks.residual * 1000:.0f} mm off"
        )
    return landmarks


def _with_consistent_head(training: Training) -> Training:
    if not training.preset.hair.consistency:
        return training

    def placed() -> HeadPlacement:
        with timed(training.seconds, "head by its own video"):
            return consistent_placement(training.capture, training.head.landmarks, training.say)

    return replace(training, head=training.from_writer(placed))


def _with_own_template(training: Training) -> Training:
    """The template with a rigid head and with standing hair and loose clothes joined to it, written for workers and
    run folder.
    """
    capture, hair = training.capture, training.preset.hair
    with timed(training.seconds, "hair carved"):
        subject = with_hair(
            with_rigid_head(capture.subject), capture, training.head.canonical_from_head,
            hollows=hair.hollows, layers=hair.layers,
        )  # fmt: skip
    subject = replace(subject, head_reach=hair.reach)
    added = len(subject.rest) - len(capture.subject.rest)
    if added:
        training.say(f"hair stands off the template: {added} vertices carved from the masks join it")
    if training.preset.clothes:
        with timed(training.seconds, "clothes carved"):
            dressed = _dressed(subject, capture, training.say)
        if dressed is not subject:
            added = len(dressed.rest) - len(subject.rest)
            training.say(f"clothes stand off the template: {added} vertices carved from the masks join it")
        subject = dressed
    return replace(training, capture=_with_template(training, subject))


def _with_template(training: Training, subject: CaptureSubject) -> Capture:
    """The capture with the training's own template, which is written for workers and run folder."""
    if training.ranks.writes:
        write_subject(training.session.partial / "subject.npz", subject)
    # no rank reads it before it is written
    training.ranks.broadcast(None)
    return replace(training.capture, subject=subject)


def _dressed(subject: CaptureSubject, capture: Capture, say: Callable[[str], None]) -> CaptureSubject:
    """The subject with loose clothes joined to it; where they cannot be joined it stays as it is, and that is said."""
    try:
        return with_clothes(subject, capture.videos["body"], drawn_out=capture.fitted_here)
    except ValueError as error:
        say(f"clothes stand off the template and are left out (as by --without clothes): {error}")
        return subject


def _with_light(training: Training) -> Training:
    """The capture's light, apart from albedo, before training, where the preset asks for it and there is one."""
    if not training.preset.light:
        return training

    def fitted() -> dict[str, CaptureLight]:
        with timed(training.seconds, "light"):
            found = fit_capture_light(training.capture, seed=training.options.seed)
        training.say(f"{light_line(found)}, {training.seconds['light']:.0f} s")
        return found.lights

    return replace(training, lights=training.from_writer(fitted))


def _refine(training: Training) -> dict:
    """Refined poses and masks into the session's folder, two videos at a time; what was found."""
    workers = min(2, os.cpu_count() or 1) if _on_one_cpu(training) else 1

    def run(jobs: Mapping[str, RefineJob], work: Callable[[RefineJob, Reporter], dict]) -> dict[str, dict]:
        # each worker reads its own
        let_go(training.capture.videos)
        board = ProgressBoard(dict.fromkeys(jobs, ROUNDS), workers)
        return run_jobs(jobs, work, board, workers) if jobs else {}

    def refined() -> dict:
        choice, capture = training.options.refine_poses, training.capture
        if training.preset.clothes and may_refine(capture, choice):
            # or the outline of a skirt would be taken for that of legs that stand elsewhere
            capture = replace(capture, subject=_dressed(capture.subject, capture, training.say))
        return refine_capture(capture, training.session.partial, choice, training.say, run)

    return training.from_writer(refined)


def _on_one_cpu(training: Training) -> bool:
    return training.device == "cpu" and training.ranks.count == 1


def part_job(training: Training, folder: Path, index: int) -> PartJob:
    """Stage 1 of one part, which leaves what it learned in `folder`."""
    options, place = training.options, training.head.canonical_from_head
    name, light = PARTS[index], training.lights.get(PARTS[index])
    return PartJob(
        capture=str(training.capture.path), index=index, preset=training.preset, canonical_from_head=place,
        folder=str(folder), device=training.device, threads=1, ranks=training.ranks, seed=options.seed,
        light=None if light is None else video_light(training.capture, name, light, place),
        resume=training.session.resumed, save_every=options.save_every,
    )  # fmt: skip


def train_parts(training: Training, jobs: Sequence[PartJob]) -> dict[str, dict]:
    """Stage 1 of the jobs, two workers at most; what run.json says of each."""
    cores = os.cpu_count() or 1
    workers = min(2, cores, len(jobs)) if _on_one_cpu(training) else 1
    threads = 1 if workers > 1 else max(cores // training.ranks.count, 1)
    by_name = {job.name: replace(job, threads=threads) for job in jobs}
    # each worker reads its own video; those of this process would lie beside them for as long as they learn
    let_go(training.capture.videos)
    totals = {name: job.settings.iterations for name, job in by_name.items()}
    board = ProgressBoard(totals, workers, stream=None if training.ranks.writes else io.StringIO())
    return run_jobs(by_name, train_part, board, workers)
