"""The run folder: what training leaves for baking and measuring."""

import dataclasses
import json
import zlib
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatar.light import CaptureLight, light_from_json
from avatar.skeleton import PARTS
from capture.folder import CaptureSubject, read_faces, read_skin, read_subject
from capture.template.layers import HAIR
from capture.template.parts import part_boxes
from command.errors import AssetError
from command.settings import SettingsSource, record_of
from files.input_file import read_json, unusable
from files.npz import field as field_of
from files.npz import indices, read_npz
from files.whole import whole_file
from train.eye_grid import OpenEyes
from train.field import PartField
from train.fused import CanonicalField, FusedField
from train.light import seen_lights_from_json
from train.preset import PartPreset, Preset
from train.surface import Surface
from train.template_grid import TemplateGrid
from train.weight_file import read_weights

FORMAT, VERSION = "selfscan-run", 1
# what experiments/rivals writes of systems that have a density and no surface
RIVAL = "selfscan-rival"
WHAT = "a trained part of a run"


@dataclass(frozen=True)
class BakeSource:
    """What baking takes from a trained person."""

    field: CanonicalField[Tensor]
    surface: Surface
    subject: CaptureSubject
    # run.json: passed on to the avatar file
    provenance: dict[str, Any]
    # the body video's, in the world of the poses; None: the field's colors hold the light
    world_light: CaptureLight | None = None
    # the field with the surfaces of these parts as they were before they learned; None: nothing was learned
    with_templates: Callable[[Collection[str]], CanonicalField[Tensor]] | None = None


@dataclass(frozen=True)
class Run:
    path: Path
    field: FusedField
    surface: Surface
    subject: CaptureSubject
    # what it was trained with, as run.json holds it
    preset: Preset
    provenance: dict[str, Any]  # all of run.json
    # the videos', by part; empty: the fields' colors hold the light
    lights: dict[str, CaptureLight] = dataclasses.field(default_factory=dict)

    # the body video's, in the world of the poses
    world_light: CaptureLight | None = None

    @property
    def bake_source(self) -> BakeSource:
        with_templates = lambda names: self.field.with_templates(names).functions()
        return BakeSource(
            self.field.functions(), self.surface, self.subject, self.provenance, self.world_light,
            with_templates if self.preset.learned else None,
        )  # fmt: skip

    @property
    def light(self) -> CaptureLight | None:
        """The body video's light, which is everyone's reference; None: light is no factor of its own."""
        return self.lights.get("body")


def build_field(
    subject: CaptureSubject, index: int, preset: PartPreset, template: TemplateGrid, frames: int
) -> PartField:
    extent = part_boxes(subject)[index].extent
    low, high = (torch.tensor(edge, dtype=torch.float32, device="cpu") for edge in (extent.low, extent.high))
    half = 0.5 * (high - low)
    networks = preset.networks.build(frames, half, preset.displacement_reach)
    return PartField(template, low, high, networks)


def write_part(path: Path, field: PartField) -> None:
    """One part's weights, readable with weights_only."""
    content = {"state": field.state_dict(), "cell": field.template.cell, "frames": len(field.appearance.weight)}
    with whole_file(path) as file:
        torch.save(content, file)


def read_part(path: Path, subject: CaptureSubject, index: int, preset: PartPreset) -> PartField:
    """Read one part.

    Raises:
        AssetError: the file is not such a part, or its shapes are another preset's.
    """
    content = read_weights(path, WHAT)
    with unusable(f"{path}: expected {WHAT}, found"):
        state, cell, frames = content["state"], float(content["cell"]), content["frames"]
        template = TemplateGrid(state["template.values"], state["template.low"], cell)
        build = lambda: build_field(subject, index, preset, template, frames)
        # what the preset asks for is known before memory is taken for it
        with torch.device("meta"):
            expected = {name: value.shape for name, value in build().state_dict().items()}
        found = {name: value.shape for name, value in state.items()}
        other = sorted(name for name in expected | found if expected.get(name) != found.get(name))
        if other:
            raise ValueError(f"{other[0]} of shape {found.get(other[0])}, the preset has {expected.get(other[0])}")
        field = build()
        field.load_state_dict(state)
    return field


def write_eyes(path: Path, eyes: OpenEyes) -> None:
    """eyes.npz: the open eyes that the surface shows."""
    values, share, low = (grid.cpu().numpy() for grid in (eyes.values, eyes.share, eyes.low))
    with open(path, "wb") as file:
        np.savez(file, cell=np.float64(eyes.cell), values=values, share=share, low=low)


def read_eyes(path: Path) -> OpenEyes | None:
    """Read eyes.npz; None where a run has none.

    Raises:
        AssetError: a field is absent or misshapen.
    """
    if not path.exists():
        return None
    fields = read_npz(path, "open eyes", ("values", "share", "low", "cell"))
    values = field_of(path, fields, "values", (None, None, None))
    share = field_of(path, fields, "share", values.shape)
    low, cell = field_of(path, fields, "low", (3,)), field_of(path, fields, "cell", ())
    if not float(cell) > 0:
        raise AssetError(f"{path}: cell should be a length in metres, is {float(cell)}")
    values, share, low = (torch.tensor(array, dtype=torch.float32) for array in (values, share, low))
    return OpenEyes(values, share, low, float(cell))


def write_surface(path: Path, surface: Surface) -> None:
    fields = vars(surface) | {f"skin_{name}": values for name, values in surface.skin._asdict().items()}
    arrays = {name: fields[name].astype(dtype) for name, (dtype, _) in SURFACE.items()}
    with open(path, "wb") as file:
        np.savez(file, **arrays)


# arrays of surface.npz: type, and numbers a row
SURFACE = {
    "vertices": ("f4", (3,)), "faces": ("u4", (3,)), "normals": ("f4", (3,)), "part": ("u1", ()),
    "skin_joints": ("u1", (4,)), "skin_weights": ("f4", (4,)), "view_count": ("f4", ()), "view_mean": ("f4", (3,)),
    "view_covariance": ("f4", (6,)), "layer": ("u1", ()),
}  # fmt: skip


def read_surface(path: Path) -> Surface:
    """Read surface.npz.

    Raises:
        AssetError: a field is absent or misshapen.
    """
    fields = read_npz(path, "a surface", SURFACE)
    count = len(field_of(path, fields, "vertices", (None, 3)))
    for name, (_, columns) in SURFACE.items():
        field_of(path, fields, name, (None if name == "faces" else count, *columns))
    return Surface(
        fields["vertices"].astype(np.float64), read_faces(path, fields, count), fields["normals"].astype(np.float64),
        indices(path, fields, "part", (count,), len(PARTS), "parts"), read_skin(path, fields, count),
        fields["view_count"], fields["view_mean"], fields["view_covariance"],
        indices(path, fields, "layer", (count,), HAIR + 1, "layers"),
    )  # fmt: skip


def write_json(path: Path, facts: dict) -> None:
    """run.json: format, version, the facts and their checksum."""
    content = {"format": FORMAT, "version": VERSION, **facts}
    path.write_text(json.dumps(content | {"check": _check(content)}, indent=1), "utf-8")


def _check(facts: dict) -> int:
    """CRC-32 of facts without their checksum, as JSON has them: a rotten digit still is JSON."""
    return zlib.crc32(json.dumps({name: value for name, value in facts.items() if name != "check"}).encode())


def read_facts(path: Path) -> dict:
    """run.json of a run folder.

    Raises:
        AssetError: there is none, it is of another format, or it was changed since it was written.
    """
    facts = read_json(path / "run.json", "a run folder, as `selfscan train` makes it")
    if isinstance(facts, dict) and facts.get("format") == RIVAL:
        raise AssetError(f"{path}: is a run of {facts.get('system')}, which has no surface and no colors on it to bake")
    if not isinstance(facts, dict) or facts.get("format") != FORMAT or facts.get("version") != VERSION:
        raise AssetError(f"{path / 'run.json'}: expected format {FORMAT!r} version {VERSION}")
    if facts.get("check", _check(facts)) != _check(facts):
        raise AssetError(f"{path / 'run.json'}: damaged, or changed by hand: its checksum is another (`check`)")
    return facts


def matrix_of(path: Path, facts: dict, name: str) -> Float[np.ndarray, "4 4"]:
    """An invertible matrix of run.json.

    Raises:
        AssetError: it is absent, misshapen, not finite or singular.
    """
    try:
        matrix = np.array(facts.get(name), np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-12:
        raise AssetError(f"{path / 'run.json'}: {name} should be an invertible 4x4 matrix")
    return matrix


def lights_of(path: Path, facts: dict) -> dict[str, CaptureLight]:
    """The lights of run.json, by video; runs without a light factor have none.

    Raises:
        AssetError: they are not lights, or not of all four videos.
    """
    lights = facts.get("light")
    if lights is None:
        return {}
    where = f"{path / 'run.json'}: light"
    if not isinstance(lights, dict) or set(lights) != set(PARTS):
        found = sorted(lights) if isinstance(lights, dict) else repr(lights)[:80]
        raise AssetError(f"{where} should hold {', '.join(PARTS)} or be null, is {found}")
    return {part: _light(where, lights[part]) for part in PARTS}


def _light(where: str, content: object) -> CaptureLight:
    try:
        return light_from_json(content)
    except ValueError as error:
        raise AssetError(f"{where}: {error}") from None


def read_run(path: Path | str) -> Run:
    """Read a run folder.

    Raises:
        AssetError: not a run folder, or a file in it is unusable.
    """
    path = Path(path)
    facts = read_facts(path)
    try:
        preset = record_of(Preset, facts.get("settings"), SettingsSource(whole=True), ("settings",))
    except ValueError as error:
        raise AssetError(f"{path / 'run.json'}: {error}") from None
    subject = read_subject(path / "subject.npz", name=str(facts.get("subject", "")))
    parts = enumerate(zip(preset.names, preset.parts, strict=True))
    fields = [read_part(path / f"{name}.pt", subject, i, own) for i, (name, own) in parts]
    correction = matrix_of(path, facts, "canonical_from_head_field")
    inverse = torch.tensor(np.linalg.inv(correction), dtype=torch.float32)
    field = FusedField(fields, part_boxes(subject), inverse).eval().requires_grad_(False)
    field.eyes = read_eyes(path / "eyes.npz")
    lights = lights_of(path, facts)
    world = None
    if lights:
        field.seen = seen_lights_from_json(f"{path / 'run.json'}: light_seen", facts.get("light_seen"))
        world = _light(f"{path / 'run.json'}: light_world", facts.get("light_world"))
    return Run(path, field, read_surface(path / "surface.npz"), subject, preset, facts, lights, world)
