import numpy as np
import pytest

from avatar.avatar_file import read_avatar
from avatar.errors import AssetError
from bake.bake import BakeOptions, bake_run, check_complete
from bake.command import main
from bake.decimate import find_faults
from bake.surface import Mesh


@pytest.fixture(scope="module")
def baked(run, small, tmp_path_factory):
    folder = tmp_path_factory.mktemp("baked")
    lines = []
    bake_run(run, folder / "one.glb", small, lines.append)
    return folder, lines


def welded(level):
    """The level's triangles with the copies that the atlas made of a vertex merged again."""
    _, index = np.unique(level.positions, axis=0, return_inverse=True)
    return index.reshape(-1)[level.faces.astype(np.int64)]


def test_same_run_bakes_to_the_same_bytes(run, small, baked):
    folder, _ = baked
    bake_run(run, folder / "two.glb", small, lambda line: None)
    assert (folder / "one.glb").read_bytes() == (folder / "two.glb").read_bytes()


def test_file_holds_what_was_promised(baked, run):
    avatar = read_avatar(baked[0] / "one.glb")
    # this field's colour ignores the direction
    assert avatar.default_view == "off" and avatar.network is None
    (level,) = avatar.levels
    assert not find_faults(welded(level), len(level.positions))
    assert (level.weights.astype(int).sum(1) == 255).all()
    assert level.base_color.shape == (256, 256, 3)
    np.testing.assert_allclose(np.linalg.norm(level.view_dir, axis=1), 1, atol=1e-3)
    facts = avatar.provenance["baked"]
    assert facts["against_field"]["paper_db"] > 24
    assert facts["levels"][0]["field_to_mesh_mm"]["mean"] < 1.5
    assert avatar.provenance["preset"] == "analytic"


def test_progress_says_what_was_measured(baked):
    text = "\n".join(baked[1])
    for word in ("surface:", "level 0:", "default view: off", "against the field:", "MB"):
        assert word in text


def test_sheen_ships_a_view_mode_that_is_nearer_to_the_cone_field(sheen_run, small, tmp_path):
    avatar = bake_run(sheen_run, tmp_path / "sheen.glb", small, lambda line: None)
    assert avatar.default_view in ("network", "linear") and avatar.levels[0].features is not None
    scores = avatar.provenance["baked"]["against_field"]["cone_db"]
    assert scores[avatar.default_view] > scores["off"]
    assert (tmp_path / "sheen.onnx").exists() == (avatar.network is not None)
    assert read_avatar(tmp_path / "sheen.glb").levels[0].features.shape == (128, 128, 4)


def test_a_hand_that_broke_off_is_named(run):
    surface = run.surface
    body = (surface.part[surface.faces] != 2).all(1)
    with pytest.raises(AssetError, match="hand_left should be one piece"):
        from bake.surface import compact

        check_complete(compact(surface.vertices, surface.faces[body])[0], surface.vertices, surface.part)
    check_complete(Mesh(surface.vertices, surface.faces), surface.vertices, surface.part)


@pytest.mark.parametrize("options", [{"faces": 10}, {"texture": 1000}, {"texture": 32}])
def test_bad_options_are_refused(options):
    with pytest.raises(ValueError, match="should be"):
        BakeOptions(**options)


def test_command_refuses_what_is_no_run(tmp_path):
    with pytest.raises(AssetError, match="expected a run folder, found nothing"):
        main([str(tmp_path / "absent"), "-o", str(tmp_path / "a.glb")])


@pytest.mark.parametrize("extra", [["--texture", "1000"], ["--faces", "3"], ["--nonsense"]])
def test_wrong_usage_exits_2(tmp_path, extra, capsys):
    with pytest.raises(SystemExit) as stop:
        main([str(tmp_path), "-o", "a.glb", *extra])
    assert stop.value.code == 2
