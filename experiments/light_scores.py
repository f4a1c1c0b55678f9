"""A run under a light beside the truth: as filmed, as bare albedo, and lit by a lamp that no video had.

True pictures are drawn here, from the subject's own mesh, in the poses and from the cameras of the even capture's
held-out sets, so that all lights of a person are compared on the same pixels.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from avatar.light import CaptureLight, lamps_of
from avatar.psnr import decibels
from bake.field import one_thread
from bench.field.drawer import Drawer
from bench.ladder.machine import machine
from bench.score.picture_scores import SAMPLES, VIEW_REGION, region_of
from capture.folder import read_capture
from capture.held_out import SETS, HeldOutView, read_held_out, some_poses
from experiments.table_row import digest
from geometry.mesh import vertex_normals
from synth.command import load_subject
from synth.cutout import cut_out
from synth.light import StudioLight, light_of
from synth.photo import Studio
from synth.room import Room
from train.run import Run, read_run

Array = np.ndarray
FORMAT = "selfscan-light-scores"
REGIONS = ("total", "head", "hands")
# a lamp from a side where no light of synth's stands
KEY = StudioLight(0.35, 0.65, (-0.8, 0.2, 0.55))
EVEN = StudioLight(1.0, 0.0, (0.0, 0.0, 1.0))
# cosine between normal and the body's camera, under which no standing camera sees a person who turns before it
TURNED_AWAY = 0.1


@dataclass
class Errors:
    """Squared errors of a region's pixels, and of those turned away from all videos."""

    squared: Float[Array, "2"] = field(default_factory=lambda: np.zeros(2))
    pixels: Float[Array, "2"] = field(default_factory=lambda: np.zeros(2))

    def add(self, error: Float[Array, "n 3"], away: Bool[Array, "n"]) -> None:
        each = np.square(error).mean(1)
        self.squared += [each.sum(), each[away].sum()]
        self.pixels += [len(each), away.sum()]

    def decibels(self, which: int) -> float | None:
        if self.pixels[which] == 0 or self.squared[which] == 0:
            return None
        return round(decibels(float(self.squared[which] / self.pixels[which])), 2)

    def rms(self, which: int) -> float | None:
        if self.pixels[which] == 0:
            return None
        return round(255 * float(np.sqrt(self.squared[which] / self.pixels[which])), 2)


@dataclass(frozen=True)
class Compared:
    """One held-out picture: pixels inside a region's true mask, true and ours, in each light."""

    region: str
    away: Bool[Array, "n"]
    # shown in the light of the capture, in the mean light, as albedo
    pairs: dict[str, tuple[Float[Array, "n 3"], Float[Array, "n 3"]]]
    # how ours is lit by a light, in the same pixels, with albedo times a gain
    relit: Callable[[float], Float[Array, "n 3"]]
    key: Float[Array, "n 3"]


def stamp(run: Path, poses: int) -> dict[str, Any]:
    """What scores follow from; the same stamp is not measured again."""
    return {"run": digest(run / "run.json"), "poses": poses}


def measured(run: Path, person: str, even: Path, light: str, seed: int, poses: int) -> dict[str, Any]:
    """Scores of a run that was filmed under `light`; `even` is the even capture, whose held-out poses are taken."""
    began = time.process_time()
    subject = cut_out(load_subject(person))
    true_light = light_of(light, "body", seed)
    source = read_run(run)
    drawer = Drawer(source)
    studio = Studio(drawer.raster, subject, supersample=2)
    camera_axis = -np.asarray(_body_axis(even))
    try:
        result: dict[str, Any] = {"found": found_light(source.world_light, true_light)}
        with one_thread():
            for name in SETS:
                views = some_poses(read_held_out(even, name), poses)
                compared = [compare(drawer, source, studio, view, true_light, camera_axis) for view in views]
                result[name] = scores(compared)
        measured_on = machine(drawer.context)
    finally:
        drawer.release()
    return result | {"machine": measured_on, "cpu_seconds": round(time.process_time() - began, 1)}


def _body_axis(capture: Path) -> Float[Array, "3"]:
    """The way the body's camera looks, world."""
    return read_capture(capture, parts=("body",)).videos["body"].cameras[0].camera_from_world[2, :3]


def compare(
    drawer: Drawer,
    run: Run,
    studio: Studio,
    view: HeldOutView,
    light: StudioLight | Room,
    camera_axis: Float[Array, "3"],
) -> Compared:
    """One picture drawn by us and by the truth in each light; the drawer draws the run."""
    shown = drawer.field
    assert shown is not None
    vertices = studio.posed(view.axis_angle, view.root)
    mask = region_of(view, VIEW_REGION[view.view])[0]
    true = {
        name: studio.take(vertices, view.camera, one).image[mask] / 255
        for name, one in (("captured", light), ("albedo", EVEN), ("key", KEY))
    }
    own, before = run.world_light, shown.light

    def ours(light: CaptureLight | None) -> Float[Array, "n 3"]:
        shown.light = light
        try:
            return drawer.draw(view.axis_angle, view.root, view.camera, SAMPLES, mask).color[mask].astype(np.float64)
        finally:
            shown.light = before

    gamma = 1.0 if own is None else own.gamma
    bare = ours(CaptureLight(1.0, gamma=gamma, frame="world"))
    lamps = lamps_of(np.array([KEY.direction]), np.array([KEY.key]))
    key = CaptureLight(KEY.ambient, lamps, frame="world")
    mean = ours(None)
    pairs = {
        "captured": (true["captured"], mean if own is None else ours(own)),
        "mean_light": (true["captured"], mean),
        "albedo": (true["albedo"], bare),
    }
    return Compared(
        "hands" if "hand" in view.view else VIEW_REGION[view.view],
        turned_away(studio, vertices, view, camera_axis)[mask],
        pairs,
        lambda gain: ours(key.scaled(gain)),
        true["key"],
    )


def turned_away(
    studio: Studio, vertices: Float[Array, "vertices 3"], view: HeldOutView, camera_axis: Float[Array, "3"]
) -> Bool[Array, "height width"]:
    """Pixels whose true normals no video's camera faces, since all look the same way."""
    faces = studio.subject.faces
    drawn = studio.rasteriser.draw(vertices, faces, view.camera)
    hit = drawn.face >= 0
    normals = vertex_normals(vertices, faces, studio.welded)[faces[drawn.face[hit]]]
    normals = (drawn.barycentric[hit][:, :, None] * normals).sum(1)
    away = np.zeros(hit.shape, bool)
    away[hit] = normals @ camera_axis < TURNED_AWAY * np.linalg.norm(normals, axis=1)
    return away


def scores(compared: list[Compared]) -> dict[str, Any]:
    """Scores of a set by kind and region; `turned_away` those of the pixels that no camera faced."""
    gain = common_gain(compared)
    errors = {kind: {region: Errors() for region in REGIONS} for kind in ("captured", "mean_light", "albedo", "key")}
    for one in compared:
        for kind, (true, ours) in one.pairs.items():
            ours = np.clip(gain * ours, 0, 1) if kind == "albedo" else ours
            errors[kind][one.region].add(ours - true, one.away)
        errors["key"][one.region].add(one.relit(gain) - one.key, one.away)
    by_region = lambda kind, which, score: {region: score(errors[kind][region], which) for region in REGIONS}
    summary = lambda which: {
        "captured": by_region("captured", which, Errors.decibels),
        "mean_light": by_region("mean_light", which, Errors.decibels),
        "key": by_region("key", which, Errors.decibels),
        "albedo_rms": by_region("albedo", which, Errors.rms),
    }
    share = {region: round(float(one.pixels[1] / max(one.pixels[0], 1)), 3) for region, one in errors["key"].items()}
    return summary(0) | {"gain": round(gain, 3), "turned_away": summary(1) | {"share": share}}


def common_gain(compared: list[Compared]) -> float:
    """The factor between our albedo and the true texture, least squares over all pictures: how bright a light is
    cannot be told from how bright a person is."""
    true, ours = (np.concatenate([one.pairs["albedo"][side] for one in compared]) for side in (0, 1))
    return float((true * ours).sum() / max(float(np.square(ours).sum()), 1e-12))


def found_light(found: CaptureLight | None, true: StudioLight | Room) -> str:
    """What was found beside what there was, in words."""
    if isinstance(true, Room):
        there = {f"source {i + 1}": np.array(source.direction) for i, source in enumerate(true.sources)}
    else:
        there = {} if true.key == 0 else {"key": np.array(true.direction)}
    if found is None or not found.lamps:
        return "none" if not there else f"none, there were {', '.join(there)}"
    off = {name: _degrees(found, direction) for name, direction in there.items()}
    words = [f"{name} {least:.1f} degrees off" for name, least in off.items()] or ["there was none"]
    if isinstance(true, StudioLight) and true.key:
        strength = found.strengths.max()
        words.append(f"ambient / key {found.ambient / strength:.2f} for {true.ambient / true.key:.2f}")
    lamps = "a lamp" if len(found.lamps) == 1 else f"{len(found.lamps)} lamps"
    return f"{lamps}, gamma {found.gamma:g}: " + ", ".join(words)


def _degrees(found: CaptureLight, direction: Float[Array, "3"]) -> float:
    cosines = found.directions @ (direction / np.linalg.norm(direction))
    return float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).min())
