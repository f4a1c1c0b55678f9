"""The stages of a training run (TotalSelfScan, 3.4): parts first, each from its own video; then one person."""

import io
import os
import platform
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from avatar.errors import AssetError
from avatar.files import whole_folder
from avatar.interrupt import prompt_stop
from avatar.light import CaptureLight
from avatar.progress import Progress, ProgressBoard, Reporter
from avatar.similarity import Registration, similarity_from_landmarks
from avatar.skeleton import PARTS
from capture.folder import Capture, CaptureSubject, read_capture, write_subject
from capture.light.fit import fit_capture_light, light_line
from capture.repair.refine import ROUNDS, RefineJob, copy_refined, refine_capture, with_learned, with_refined
from capture.videos import let_go
from train import run as run_folder
from train.clothes import with_clothes
from train.compose import (
    HeadPlacement,
    TrainedParts,
    compose,
    consistent_placement,
    landmark_placement,
    place_head,
)
from train.distributed import Ranks, join_ranks
from train.field import PartField
from train.hull import with_hair
from train.light import VideoLight, video_light
from train.log import tensorboard_installed
from train.options import TrainOptions
from train.part_job import PartJob, megabytes, memory_text, step_note, train_part
from train.preset import Preset
from train.rigid import with_rigid_head
from train.session import Session, capture_digest, capture_place, digest_of, exclusive_lock, open_session
from train.single import part_names, part_presets
from train.stored_preset import preset_json
from train.trainer import Checkpoints, Watch, peak_memory
from train.union import read_rays
from train.workers import run_jobs

# time of what follows stage 1, as a share of it, for the time left; demo on two cores
AFTER = 0.2


class Clocks(NamedTuple):
    """Seconds of the wall clock and of the processor, this process and its finished children together."""

    wall: float
    processor: float

    @classmethod
    def now(cls) -> "Clocks":
        return cls(time.monotonic(), sum(os.times()[:4]))

    def since(self) -> "Clocks":
        """What has passed."""
        now = Clocks.now()
        return Clocks(now.wall - self.wall, now.processor - self.processor)


@dataclass(frozen=True)
class _Training:
    """A training under way: what its stages share."""

    options: TrainOptions
    preset: Preset
    # once refined, with the poses, masks and frames that this leaves of it
    capture: Capture
    session: Session
    ranks: Ranks
    # this rank's
    device: str
    # where the head's video lies on the template before anything is learnt
    head: HeadPlacement
    say: Callable[[str], None]
    # of each video; empty: light is no factor of its own
    lights: dict[str, CaptureLight] = field(default_factory=dict)
    # of what is done before the parts are trained, by name
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Seconds of the block go to run.json under this name."""
        began = time.monotonic()
        yield
        self.seconds[name] = time.monotonic() - began

    def video_light(self, part: str, canonical_from_head: np.ndarray) -> VideoLight | None:
        """A video's light as its part's rays meet it; None where light is no factor."""
        light = self.lights.get(part)
        return None if light is None else video_light(self.capture, part, light, canonical_from_head)


def train(options: TrainOptions, preset: Preset | None = None) -> Path:
    """Train all parts, compose them, and write the run folder; `preset` replaces the one that the options name.

    Parts learn independently (stage 1), two at a time on a CPU with two cores, each on its own thread; under
    torchrun one after the other, each on all ranks. Checkpoints, logs and previews lie beside the run folder, in
    RUN.partial, until the run is complete. A signal raises `Stopped` once they are saved.
    """
    preset = options.chosen_preset() if preset is None else preset
    with prompt_stop(), ExitStack() as held:
        ranks, device = join_ranks(options.device)
        say: Callable[[str], None] = _say if ranks.writes else lambda text: None
        capture, out = read_capture(options.capture), options.out
        session = None
        if ranks.writes:
            held.enter_context(exclusive_lock(out))
            decides = _what_decides(options, preset, capture)
            session = open_session(out, decides, resume=options.resume, force=options.force, say=say)
        session = ranks.broadcast(session)
        if session is None:
            return out
        began = Clocks.now()
        if ranks.writes and not tensorboard_installed():
            say("logs: CSV only; `pip install tensorboard` adds events for it")

        head = landmark_placement(_register_landmarks(capture, say))
        training = _Training(options, preset, capture, session, ranks, device, head, say)
        say(
            f"stage 1: {', '.join(part_names(preset))} by volume rendering of signed distance (Eq. 10-12), "
            f"preset {preset.name}"
        )
        say(f"logs, previews and checkpoints: {session.partial}")
        with training.timed("poses and masks"):
            refined = _refine(training)
        # from here on there is no other: frames that were left out are in nobody's count
        training = replace(training, capture=with_refined(capture, session.partial))
        training = _with_light(_with_own_template(_with_consistent_head(training)))
        head = _head_of_single(training) if preset.single else training.head
        facts = _train_parts(training, session.partial, head.canonical_from_head)
        if ranks.writes:
            _compose(training, head, facts, refined, began)
    return out


def _what_decides(options: TrainOptions, preset: Preset, capture: Capture) -> dict[str, Any]:
    """What decides the result of a training: --resume needs the same again."""
    placed = None if options.head_from is None else _place_read_from(options.head_from, capture).canonical_from_head
    return {
        "capture": capture_digest(capture.path),
        "preset": preset.name,
        "iterations": [part.iterations for part in preset.parts],
        "seed": options.seed,
        "numbers": digest_of(preset_json(preset)),
        "refine_poses": options.refine_poses,
        "single": preset.single,
        "head_from": None if placed is None else digest_of({"canonical_from_head": placed.tolist()}),
    }


def _compose(training: _Training, head: HeadPlacement, facts: dict[str, dict], refined: dict, began: Clocks) -> None:
    """From trained parts to the run folder; under torchrun the work of one rank."""
    preset, device, out, partial = training.preset, training.device, training.session.out, training.session.partial
    capture = with_learned(training.capture, partial)
    seconds = training.seconds | {name: fact["seconds"] for name, fact in facts.items()}
    names = part_names(preset)
    fields = _read_fields(training, partial, len(names))
    torch.set_num_threads(os.cpu_count() or 1)
    progress = Progress("body, stage 2", preset.union.iterations)
    with whole_folder(out) as folder:
        rays = None if preset.single else read_rays(partial / "body.rays", torch.device(device))
        lit = {part: training.video_light(part, head.canonical_from_head) for part in training.lights}
        parts = TrainedParts(
            fields=fields, rays=rays, head=head, seed=training.options.seed, seconds=seconds,
            lights={part: light for part, light in lit.items() if light is not None},
        )  # fmt: skip
        person = compose(
            capture, parts, preset, training.say, device=device,
            checkpoints=Checkpoints(path=partial / "union.ckpt", resume=training.session.resumed),
            watch=Watch(report=lambda step, report: progress.update(step, step_note(report))),
        )  # fmt: skip
        if not preset.single:
            shutil.copyfile(partial / "body.pt", folder / "body_stage1.pt")
        run_folder.write_codes(folder / "codes.npz", dict(zip(names, fields)))
        for name, field in zip(names, fields):
            run_folder.write_part(folder / f"{name}.pt", field)
        copy_refined(partial, folder)
        for name in ("logs", "preview"):
            if (partial / name).is_dir():
                shutil.copytree(partial / name, folder / name)
        run_folder.write_surface(folder / "surface.npz", person.surface, person.tables)
        if person.eyes is not None:
            run_folder.write_eyes(folder / "eyes.npz", person.eyes)
        shutil.copyfile(partial / "subject.npz", folder / "subject.npz")
        spent = began.since()
        seconds["all"] = spent.wall
        memory = peak_memory(device)
        run_folder.write_json(
            folder / "run.json",
            {
                "subject": capture.subject.name,
                "preset": preset.name,
                "settings": preset_json(preset),
                "seed": training.options.seed,
                "device": device,
                "machine": f"{platform.machine()}, {os.cpu_count()} cores, torch {torch.__version__}",
                "capture": capture.facts,
                "capture_at": capture_place(capture.path, out),
                "body_licence": capture.facts.get("body_licence", "not stated by the capture"),
                "subject_licence": capture.facts.get("subject_licence", "not stated by the capture"),
                "canonical_pose": "hips opened 30 degrees about z (avatar.skeleton.BIG_POSE)",
                "seconds": {name: round(value, 1) for name, value in seconds.items()},
                # with its workers', without other ranks'; of the last sitting, as the seconds are
                "cpu_seconds": round(spent.processor, 1),
                "resumed": training.session.resumed,
                "peak_memory_mb": {name: fact["peak_memory_mb"] for name, fact in facts.items()}
                | {"composition": megabytes(memory)},
                "parts": facts,
                "refined": refined,
                "light": None,
                **person.facts,
            },
        )
    shutil.rmtree(partial, ignore_errors=True)
    vertices = len(person.surface.vertices)
    training.say(f"{out}: {vertices} surface vertices, {seconds['all']:.0f} s, {memory_text(memory)}")


def _read_fields(training: _Training, folder: Path, count: int) -> list[PartField]:
    """The first `count` trained parts, from a folder."""
    parts = list(zip(part_names(training.preset), part_presets(training.preset), strict=True))[:count]
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


def _place_read_from(run: Path, capture: Capture) -> HeadPlacement:
    """Where a finished run of four parts on the same capture has the head.

    Raises:
        AssetError: it is no such run.
    """
    facts = run_folder.read_facts(run)
    if "single" in facts.get("parts", {}):
        raise AssetError(f"{run}: is a single network; --head-from needs a run of four parts")
    if facts.get("capture") != capture.facts:
        raise AssetError(f"{run}: was trained on another capture; --head-from needs a run on {capture.path}")
    final = np.linalg.inv(run_folder.matrix_of(run, facts, "head_from_canonical"))
    correction = run_folder.matrix_of(run, facts, "canonical_from_head_field")
    landmarks = Registration(np.linalg.solve(correction, final), float("nan"))
    return HeadPlacement(landmarks, correction, {**facts.get("registration", {}), "from": "a run of four parts"})


def _head_of_single(training: _Training) -> HeadPlacement:
    """Where the single network gets the head: where four parts have it, by a finished run or by placing it now."""
    options, partial = training.options, training.session.partial
    if options.head_from is not None:
        training.say(f"head: where {options.head_from} has it")
        return _place_read_from(options.head_from, training.capture)
    training.say("head: body and head are trained as parts and placed first; --head-from RUN takes a finished run's")
    folder = partial / "placement"
    if training.ranks.writes:
        folder.mkdir(exist_ok=True)
        for path in (partial / "subject.npz", *sorted(partial.glob("refined_*.npz"))):
            shutil.copyfile(path, folder / path.name)
    training.ranks.broadcast(None)
    parts = replace(training, preset=replace(training.preset, single=False))
    _train_parts(parts, folder, training.head.canonical_from_head, order=(1, 0))
    head = None
    if training.ranks.writes:
        capture = with_learned(training.capture, folder)
        head = place_head(capture, _read_fields(parts, folder, 2), training.head, training.say,
                          outlines=training.preset.hair.consistency)  # fmt: skip
        head = replace(head, facts={**head.facts, "from": "body and head trained for it"})
    head = training.ranks.broadcast(head)
    assert head is not None
    return head


def _with_consistent_head(training: _Training) -> _Training:
    """The head placed by its own video, where the preset says so."""
    if not training.preset.hair.consistency:
        return training
    head = None
    if training.ranks.writes:
        with training.timed("head by its own video"):
            head = consistent_placement(training.capture, training.head.landmarks, training.say)
    head = training.ranks.broadcast(head)
    assert head is not None
    return replace(training, head=head)


def _with_own_template(training: _Training) -> _Training:
    """The template with a rigid head and with standing hair and loose clothes joined to it, written for workers and
    run folder.
    """
    capture, partial, hair = training.capture, training.session.partial, training.preset.hair
    with training.timed("hair carved"):
        subject = with_hair(
            with_rigid_head(capture.subject), capture, training.head.canonical_from_head,
            hollows=hair.hollows, layers=hair.layers,
        )  # fmt: skip
    subject = replace(subject, head_reach=hair.reach)
    added = len(subject.rest) - len(capture.subject.rest)
    if added:
        training.say(f"hair stands off the template: {added} vertices carved from the masks join it")
    if training.preset.clothes:
        with training.timed("clothes carved"):
            dressed = _dressed(subject, capture, training.say)
        if dressed is not subject:
            added = len(dressed.rest) - len(subject.rest)
            training.say(f"clothes stand off the template: {added} vertices carved from the masks join it")
        subject = dressed
    if training.ranks.writes:
        write_subject(partial / "subject.npz", subject)
    # no rank reads it before it is written
    training.ranks.broadcast(None)
    return replace(training, capture=replace(capture, subject=subject))


def _dressed(subject: CaptureSubject, capture: Capture, say: Callable[[str], None]) -> CaptureSubject:
    """The subject with loose clothes joined to it; where they cannot be joined it stays as it is, and that is said."""
    try:
        return with_clothes(subject, capture.videos["body"])
    except ValueError as error:
        say(f"clothes stand off the template and are left out (as by --without clothes): {error}")
        return subject


def _with_light(training: _Training) -> _Training:
    """The capture's light, told from albedo before training, where the preset asks for it and there is one."""
    if not training.preset.light:
        return training
    lights = None
    if training.ranks.writes:
        with training.timed("light"):
            found = fit_capture_light(training.capture, seed=training.options.seed)
        training.say(f"{light_line(found)}, {training.seconds['light']:.0f} s")
        lights = found.lights
    return replace(training, lights=training.ranks.broadcast(lights) or {})


def _refine(training: _Training) -> dict:
    """Refined poses and masks into the session's folder, two videos at a time; what was found."""
    found = None
    if training.ranks.writes:
        workers = min(2, os.cpu_count() or 1) if _on_one_cpu(training) else 1

        def run(jobs: Mapping[str, RefineJob], work: Callable[[RefineJob, Reporter], dict]) -> dict[str, dict]:
            # each worker reads its own
            let_go(training.capture.videos)
            board = ProgressBoard(dict.fromkeys(jobs, ROUNDS), workers)
            try:
                return run_jobs(jobs, work, board, workers) if jobs else {}
            finally:
                board.close()

        partial, choice, capture = training.session.partial, training.options.refine_poses, training.capture
        if training.preset.clothes and choice != "off":
            # or the outline of a skirt would be taken for that of legs that stand elsewhere
            capture = replace(capture, subject=_dressed(capture.subject, capture, training.say))
        found = refine_capture(capture, partial, choice, training.say, run)
    return training.ranks.broadcast(found) or {}


def _on_one_cpu(training: _Training) -> bool:
    return training.device == "cpu" and training.ranks.count == 1


def _train_parts(
    training: _Training, folder: Path, canonical_from_head: np.ndarray, order: tuple[int, ...] = (1, 0, 2, 3)
) -> dict[str, dict]:
    """Stage 1 for the parts of `order`, heavier ones first so that two workers end together."""
    options, preset, ranks = training.options, training.preset, training.ranks
    cores = os.cpu_count() or 1
    order = (0,) if preset.single else order
    workers = min(2, cores, len(order)) if _on_one_cpu(training) else 1
    threads = 1 if workers > 1 else max(cores // ranks.count, 1)
    jobs = {
        part_names(preset)[index]: PartJob(
            capture=str(training.capture.path), index=index, preset=preset, canonical_from_head=canonical_from_head,
            folder=str(folder), device=training.device, threads=threads, ranks=ranks, seed=options.seed,
            light=training.video_light(PARTS[index], canonical_from_head),
            resume=training.session.resumed, save_every=options.save_every, preview_every=options.preview,
        )
        for index in order
    }  # fmt: skip
    # each worker reads its own video; those of this process would lie beside them for as long as they learn
    let_go(training.capture.videos)
    totals = {name: job.settings.iterations for name, job in jobs.items()}
    stream = None if ranks.writes else io.StringIO()
    board = ProgressBoard(totals, workers, after=AFTER, stream=stream)
    try:
        return run_jobs(jobs, train_part, board, workers)
    finally:
        board.close()


def _say(text: str) -> None:
    print(text, flush=True)
