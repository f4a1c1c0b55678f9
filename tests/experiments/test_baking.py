"""The experiment on a bake's settings: which bakes it makes and keeps, how it scores them, number formats, its page."""

import json
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

import experiments.baking
import experiments.baking_formats
import experiments.baking_scores
from avatar.gltf.avatar_file import write_avatar
from avatar.texture import mipmaps
from bake.options import BakeOptions
from experiments.baking import main, rows_of
from experiments.baking_formats import SHIPPED, format_rows, moved
from experiments.baking_page import change
from experiments.baking_scores import References, Seen, avatar_pictures, read_references
from player.scene.mannequin import mannequin

SIZE = (96, 96)


@pytest.fixture(scope="module")
def avatar():
    """The built-in body with texels that are all different, shown as its network has it."""
    made = mannequin(texture=128)
    noise = np.random.default_rng(0).integers(0, 256, made.levels[0].base_color.shape).astype(np.uint8)
    levels = tuple(replace(level, base_color=noise) for level in made.levels)
    return replace(made, levels=levels, default_view="network", amplitude=0.3)


@pytest.fixture
def small(monkeypatch):
    for module in (experiments.baking_scores, experiments.baking_formats):
        monkeypatch.setattr(module, "FRAME_SIZE", SIZE)
    monkeypatch.setattr(experiments.baking_scores, "FRAMES", 1)


@pytest.fixture
def few_formats(monkeypatch):
    every = experiments.baking_formats.variants
    monkeypatch.setattr(experiments.baking_formats, "variants", lambda *given: every(*given)[:2])


def test_each_row_differs_from_the_default_in_what_it_names():
    default = BakeOptions(texture=1024)
    rows = rows_of(default)
    assert rows[0].key == "default" and rows[0].options == default
    assert len({row.key for row in rows}) == len(rows)
    for row in rows[1:]:
        assert row.options != default and replace(default, **row.changed) == row.options
    names = [row.key for row in rows]
    assert "texture-1024" not in names and "texture-2048" in names and "faces-60000" in names
    words = {row.key: row.words for row in rows}
    assert words["faces-60000"] == "60,000 triangles" and words["texture-512"] == "512 x 512 texels"
    assert words["texture_from-field+texel_samples-1"] == "textures from the field, 1 sample a texel"


class InThisProcess:
    """A child process that is none."""

    def __init__(self, target, args):
        self.target, self.args, self.exitcode = target, args, None

    def start(self):
        try:
            self.target(*self.args)
            self.exitcode = 0
        except RuntimeError:
            self.exitcode = 1

    def join(self):
        pass


@pytest.fixture
def bakes(monkeypatch, avatar, small):
    """Bakes that are made, of avatars whose textures have as many texels as they were asked for, up to 128."""
    made: list[BakeOptions] = []

    def bake_apart(run, capture, out, options, stages):
        if options.steps == 30:
            raise RuntimeError("no such bake")
        made.append(options)
        halved = {256: 1, 128: 1, 64: 2, 512: 3}.get(options.texture, 1)
        levels = tuple(replace(one, base_color=mipmaps(one.base_color, halved)[-1]) for one in avatar.levels[:1])
        write_avatar(out, replace(avatar, levels=levels))
        stages.write_text(json.dumps({"stages": {"surface": 2.0, "level 0": 8.0}, "view": "network"}))

    class Spawn:
        Process = InThisProcess

    # five processor seconds a bake
    used = count(0.0, 5.0)
    monkeypatch.setattr(experiments.baking, "children_seconds", lambda: next(used))
    monkeypatch.setattr(experiments.baking, "bake_apart", bake_apart)
    monkeypatch.setattr(experiments.baking.multiprocessing, "get_context", lambda kind: Spawn)
    return made


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    facts = {"format": "selfscan-run", "version": 1, "subject": "someone", "preset": "demo", "cpu_seconds": 700.0}
    (folder / "run.json").write_text(json.dumps(facts))
    return folder


@pytest.fixture
def drawn_field(monkeypatch, avatar, context):
    """The field shows the avatar as it is."""

    def field_pictures(run, seen):
        pictures = avatar_pictures(context, avatar, [(one.pose, one.camera) for one in seen])
        return [
            experiments.baking_scores.Reference(one.region, one.pose, one.camera, picture, picture.max(-1) > 0)
            for one, picture in zip(seen, pictures, strict=True)
        ]

    monkeypatch.setattr(experiments.baking_scores, "field_pictures", field_pictures)


def asked(run: Path, capture: Path, out: Path, *more: str) -> list[str]:
    return [str(run), "--capture", str(capture), "-o", str(out), "--texture", "256", "--poses", "1", "--seconds", "0",
            *more]  # fmt: skip


def test_every_bake_is_made_and_scored_once_and_the_page_says_what_it_costs(
    bakes, drawn_field, few_formats, run, oracle, tmp_path, capsys
):
    capture, out = oracle[0], tmp_path / "out"
    words = asked(run, capture, out, "--rows", "default", "texture-512", "steps-30")
    assert main(words) == 1
    assert [one.texture for one in bakes] == [256, 512]
    assert "not measured: 30 distillation steps: the bake failed" in capsys.readouterr().err
    result = json.loads((out / "baking.json").read_text())
    default, coarse = result["rows"]
    assert (default["key"], coarse["key"]) == ("default", "texture-512")
    # the field is the avatar itself, of which the other one's texels are means
    assert default["scores"]["field"]["total"]["flip"] in (None, 0.0)
    assert coarse["scores"]["field"]["total"]["flip"] > 0.01
    assert set(default["scores"]["truth"]) == {"total", "head", "hands"}
    mean, error = change(coarse, default, "field")
    assert mean == pytest.approx(coarse["scores"]["field"]["total"]["flip"], abs=1e-4) and error == 0.0
    page = (out / "baking.md").read_text()
    assert "| 512 x 512 texels |" in page and "Not measured: 30 distillation steps" in page
    # what is there is kept, scores as well; the rows of an earlier call stay on the page
    scored = (out / "default" / "scores.json").stat().st_mtime_ns
    assert main(asked(run, capture, out, "--rows", "default")) == 0
    assert len(bakes) == 2 and (out / "default" / "scores.json").stat().st_mtime_ns == scored
    assert len(json.loads((out / "baking.json").read_text())["rows"]) == 2
    # other settings of the default ask for another bake
    other = asked(run, capture, out, "--rows", "default")
    other[other.index("256")] = "128"
    assert main(other) == 0
    assert [one.texture for one in bakes] == [256, 512, 128]


def test_numbers_of_fewer_bits_change_the_picture_the_less_the_more_bits_they_keep(avatar, small, oracle, tmp_path):
    path = tmp_path / "avatar.glb"
    write_avatar(path, avatar)
    references = read_references(tmp_path, oracle[0], 1)
    result = format_rows(path, references, 0.0)
    rows = {row["name"]: row for row in result["rows"]}
    assert rows[SHIPPED]["frame"]["times_first"] == 1.0 and "flip" not in rows[SHIPPED]
    # the same numbers kept elsewhere: the same picture but for rounding
    for name in ("weights: as uniforms", "features: as textures of float32"):
        assert rows[name]["largest"] <= 1, name
    error = {name: -(row["psnr_mask_db"] or np.inf) for name, row in rows.items() if name != SHIPPED}
    for kind in ("weights: rounded to {} bits", "features: rounded to {} bits"):
        fewer, more = (4, 6) if "features" in kind else (6, 8)
        assert error[kind.format(more)] < error[kind.format(fewer)], kind
    # far off only bones worked out in double precision stay where they are
    assert error["posing: all of it in float32, 1000 m from the origin"] > error["posing: all of it in float32"]
    shipped = rows[f"{SHIPPED}, 1000 m from the origin"]
    assert shipped["frame"] is None and shipped["largest"] <= 2


def test_bodies_and_cameras_moved_together_give_one_view_and_without_truth_the_field_is_compared(
    oracle, tmp_path, monkeypatch
):
    seen: Seen = read_references(tmp_path, oracle[0], 1).seen[0]
    pose, camera = moved(seen.pose, seen.camera)
    point = seen.pose[1] @ seen.camera.camera_from_world[:3, :3].T + seen.camera.camera_from_world[:3, 3]
    there = pose[1] @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    np.testing.assert_allclose(there, point, atol=1e-9)
    monkeypatch.setattr(experiments.baking_scores, "run_joints", lambda run: mannequin(texture=16).joint_positions)
    references: References = read_references(tmp_path, None, 3)
    assert not references.has_truth and references.names == "field"
    assert {one.region for one in references.seen} == {"total", "head", "hands"} and references.bodies
