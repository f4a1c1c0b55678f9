"""`selfscan synth`: the four self-scan videos of a person whose mesh is known, and the truth to measure against."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from avatar.camera import write_cameras
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import PARTS
from capture.read.folder import write_poses
from capture.read.template import write_template
from command.errors import AssetError
from command.progress import plural, progress
from command.settings import settings_json
from files.whole import check_folder, whole_folder, write_json
from player.draw.raster import Rasteriser
from player.gl.context import open_context
from synth.cutout import cut_out
from synth.film import Shots, disturbed, plan_videos, write_frames
from synth.head_frame import cameras_in_head_frame, landmarks, seeded_similarity
from synth.light import light_of
from synth.options import RawConfig, SynthConfig
from synth.people.body import built_in
from synth.people.person import person
from synth.photo import Studio
from synth.raw.film import FACE_FILE, FILES, MASK_STEP, film_raw, mistakes_of
from synth.raw.film import RATE as RAW_RATE
from synth.subject import SynthSubject, read_subject
from synth.template import RegisteredTemplate, register, shape_only
from synth.truth import DetectorOf, novel_poses, novel_views, take_set, write_photo, write_rest
from synth.visibility import visible_faces

# frames per second that the videos claim: a turn of 36 or 72 degrees a second
RATE = 10.0


def synth(subject: str, out: Path, config: SynthConfig) -> dict:
    """Write the capture folder of a subject ("builtin", "builtin:female", "builtin:12", a file); returns capture.json.

    Raises:
        AssetError: the subject cannot be read, or the folder not be written.
    """
    config = replace(config, size=config.size or 256, light=config.light or "even")
    assert config.size is not None and config.light is not None
    check_folder(out)
    person = _person(subject)
    with open_context() as context:
        rasteriser = Rasteriser(context)
        studio = Studio(rasteriser, person, sheen=config.sheen)
        videos = plan_videos(studio, config.frames, config.size)
        visible = visible_faces(rasteriser, person.vertices, person.faces)
        exact = config.template == "registered"
        template = register(person, visible, rasteriser) if exact else shape_only(person, visible)
        residual = template.residual
        print(
            f"template: {template.body}, {residual['surface_cm']:.2f} cm from the visible surface "
            f"(head {residual['head_cm']:.2f}, hands {residual['hands_cm']:.2f}); "
            f"{int(template.hair.sum())} of {len(template.hair)} vertices under hair"
        )
        facts = _facts(person, template, config)
        with whole_folder(out) as folder:
            write_template(folder / "subject.npz", template.mesh, template.hair, template.eyes)
            _film(folder, studio, template, videos, config)
            if config.truth:
                write_rest(folder / "truth", person, visible)
                _take_held_out(folder / "truth", studio, config)
            write_json(folder / "capture.json", facts)
    for part, shots in videos.items():
        camera = shots.cameras[0]
        distance = np.linalg.norm(camera.eye - shots.root.mean(0)) if part == "body" else np.linalg.norm(camera.eye)
        pixel = f"{1000 * distance / camera.K[0, 0]:.2f} mm a pixel"
        print(f"{part}: {plural(config.frames, 'frame')} of {config.size} px, {pixel}")
    return facts


def synth_raw(subject: str, out: Path, config: SynthConfig, raw: RawConfig) -> dict:
    """Write the four raw videos of a subject, with the truth in out/truth, held-out pictures where they are asked for;
    returns its raw.json.

    Raises:
        AssetError: the subject cannot be read, or the folder not be written.
    """
    config = replace(config, size=config.size or 1080, light=config.light or "room")
    assert config.size is not None and config.light is not None
    check_folder(out)
    person = _person(subject)
    facts = {"subject": person.name, "subject_licence": person.licence, **settings_json(config), **settings_json(raw)}
    lights = {part: light_of(config.light, part, config.seed) for part in PARTS}
    with open_context() as context, whole_folder(out) as folder:
        rasteriser = Rasteriser(context)
        plan = film_raw(folder, Studio(rasteriser, person, 2, config.sheen), lights, config.size, raw, config.seed)
        if config.truth:
            write_rest(folder / "truth", person, visible_faces(rasteriser, person.vertices, person.faces))
            if raw.held_out:
                looks = DetectorOf(mistakes_of(raw), config.seed) if raw.keypoints else None
                _take_held_out(folder / "truth", Studio(rasteriser, person, sheen=config.sheen), config, looks)
        frames = {part: len(shots.root) for part, shots in plan.items()}
        said = {"format": "selfscan-raw-truth", "rate": RAW_RATE, "mask_step": MASK_STEP, **facts, "frames": frames}
        write_json(folder / "truth" / "raw.json", said)
    for part, shots in plan.items():
        width, height = shots.camera.size
        print(f"{FILES.get(part, FACE_FILE)}: {plural(len(shots.root), 'frame')} of {width} x {height} px")
    return facts


def _person(name: str) -> SynthSubject:
    person = cut_out(load_subject(name))
    print("; ".join([f"{person.name}: {len(person.vertices)} vertices, {len(person.faces)} faces", *person.notes]))
    return person


def load_subject(name: str) -> SynthSubject:
    """A subject by name or file."""
    if name.partition(":")[0] != "builtin":
        return read_subject(Path(name))
    _, _, who = name.partition(":")
    if who.isdecimal() and len(who) < 10:
        return person(int(who))
    sex = who or "male"
    if name not in ("builtin", f"builtin:{sex}") or sex not in ("male", "female"):
        raise AssetError(f"{name}: expected builtin, builtin:female, builtin:SEED or a .glb, .gltf or .vrm file")
    return replace(built_in(sex), name=f"builtin:{sex}", notes=())


def _facts(person: SynthSubject, template: RegisteredTemplate, config: SynthConfig) -> dict:
    return {
        "format": "selfscan-capture",
        "version": 1,
        "subject": person.name,
        "units": "metres",
        "parts": list(PARTS),
        **{name: vars(config)[name] for name in ("light", "sheen", "seed", "size", "frames")},
        "pose_noise_deg": config.pose_noise,
        "input": "given" if config.template == "registered" else "shape_only",
        "body": template.body,
        "body_licence": template.mesh.licence,
        "subject_licence": person.licence,
        "registration": {key: round(value, 4) for key, value in template.residual.items()},
        "head_units_per_metre": float(np.cbrt(np.linalg.det(seeded_similarity(config.seed)[:3, :3]))),
        "notes": list(person.notes),
    }


def _film(
    folder: Path, studio: Studio, template: RegisteredTemplate, videos: dict[str, Shots], config: SynthConfig
) -> None:
    """Take the four videos and write them with the cameras, poses and facts that training reads."""
    for part, shots in videos.items():
        truth, out = folder / "truth" / part, folder / part
        for made in (truth, out / "images", out / "masks"):
            made.mkdir(parents=True)
        present = np.ones(len(shots.root), bool)
        write_frames(truth / "video.npz", shots.axis_angle, shots.root, shots.cameras[0], present)
        light = light_of(config.light or "even", part, config.seed)
        for i, camera in enumerate(progress(shots.cameras, f"filming {part}")):
            photo = studio.take(studio.posed(shots.axis_angle[i], shots.root[i]), camera, light)
            write_photo(out, f"{i:06d}", photo)
        if part == "head":
            similarity = seeded_similarity(config.seed)
            write_cameras(out / "cameras.npz", cameras_in_head_frame(shots, studio.subject.joints, similarity))
            write_json(out / "landmarks.json", landmarks(template, similarity, config.seed))
            continue
        written = disturbed(shots, config.pose_noise, config.seed)
        turn = matrix_from_axis_angle(written.axis_angle[:, 0])
        write_cameras(out / "cameras.npz", shots.cameras)
        # the subject's pelvis joint is at 0 in pose 0: trans is where it stands, or where the template's does
        root = written.root + turn @ np.array(template.pelvis)
        write_poses(out / "poses.npz", written.axis_angle, root, RATE)


def _take_held_out(folder: Path, studio: Studio, config: SynthConfig, looks: DetectorOf | None = None) -> None:
    """The held-out pictures, in the light of the body video; keypoints where a detector is."""
    light = light_of(config.light or "even", "body", config.seed)
    every, seed = config.truth_every, config.seed
    sets = {"novel_pose": novel_poses(seed)[::every], "novel_view": novel_views(seed)[::every]}
    finer = Studio(studio.rasteriser, studio.subject, 2, studio.sheen)
    for number, (name, stands) in enumerate(sets.items(), 1):
        seed = 100_000 * number + config.seed
        taken = take_set(finer, stands, folder / name, light, seed, looks)
        for _ in progress(taken, f"{name.replace('_', ' ')}s, held out", 4 * len(stands)):
            pass
