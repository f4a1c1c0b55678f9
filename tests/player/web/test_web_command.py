"""`selfscan web`: what it writes and refuses, and the rule that turns shaders/ into GLSL ES."""

import dataclasses

import numpy as np
import pytest
from refusals import refused
from tiny_avatar import tiny_avatar

from avatar.gltf.avatar_file import write_avatar
from avatar.motion.clip import Clip
from command.errors import AssetError
from player.gl.shader import ShaderError
from player.scene.motions import motion_for
from player.web import packing, page
from player.web.essl import essl, program, programs
from player.web_command import write_page
from selfscan.__main__ import main


def test_the_rule_for_shaders():
    source = "#version 330\n#define A 1\n// d̄ is a comment\n#line 3 1\nin vec2 uv; /* two\nlines */ out vec4 c;\n"
    assert essl(source).splitlines() == [
        "#version 300 es", "precision highp float;", "precision highp int;", "precision highp sampler2D;",
        "#define A 1", "in vec2 uv;  out vec4 c;",
    ]  # fmt: skip
    refused(ShaderError, "'é' outside of a comment", essl, "#version 330\nfloat é;\n")
    refused(ShaderError, "expected '#version 330'", essl, "#version 410\n")
    refused(ShaderError, r"no #if tests \['NONSENSE'\]", program, {"VIEW_STAGE": 0, "NONSENSE": 1}, {})


def test_programs_are_those_of_the_view_modes_without_effects():
    """A new effect of the shaders leaves the page as it is."""
    vertex = program({"VIEW_STAGE": 0}, {})["vertex"]
    assert {"#define LIT 0", "#define SKINNING 0", "#define VIEW_STAGE 0"} <= set(vertex.splitlines())
    assert list(programs(tiny_avatar())) == ["off", "vertex", "linear", "network"]
    assert list(programs(tiny_avatar(network=None, default_view="linear"))) == ["off", "vertex", "linear"]
    bare = tiny_avatar()
    level = dataclasses.replace(bare.levels[0], features=None)
    assert list(programs(dataclasses.replace(bare, levels=(level,), default_view="off"))) == ["off"]
    assert page.filled("<@A@ at@home @B@>", {"A": "@B@", "B": "x"}) == "<@B@ at@home x>"
    assert "</script" not in page.json_element({"name": "</script><b>"})


def test_turns_do_not_jump():
    """Quaternions of neighbouring frames lie on one side: what is between them is between."""
    axis_angle = np.zeros((20, 52, 3))
    axis_angle[:, 0, 1] = np.linspace(3.0, 3.3, 20)
    axis_angle[axis_angle > np.pi] -= 2 * np.pi
    packed = packing.packed_motion(Clip(axis_angle, np.zeros((20, 3)), 30.0))
    spread = np.array(packed.facts["turns"]["scale"]) * (256**packing.FINE - 1)
    # y and w of the pelvis go a little way, none from one side of the sphere to the other
    assert 0 < spread[1] < 0.05 and 0.1 < spread[3] < 0.2


def test_the_command(tmp_path, capsys):
    write_avatar(tmp_path / "me.glb", tiny_avatar())
    out = tmp_path / "me.html"
    assert main(["web", str(tmp_path / "me.glb"), "--frames", "0:3", "--title", "caf\udce9", "-o", str(out)]) == 0
    assert "MB, 3 frames; geometry" in capsys.readouterr().out and "<title>caf\\udce9" in out.read_text("utf-8")
    text = out.read_text("utf-8")
    assert text.count('id="level') >= 3 and 'id="level1.mesh"' in text and "://" not in text
    assert main(["web", str(tmp_path / "me.glb"), "--levels", "1", "-o", str(out)]) == 0
    assert 'id="level1.mesh"' not in out.read_text("utf-8")
    assert main(["web", str(tmp_path / "me.glb"), "--frames", "0:9999", "-o", str(out)]) == 1
    assert "frames 0:9999 asked for, it has 300" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["web", str(tmp_path / "me.glb"), "-o", str(tmp_path / "me.glb")])
    assert "expected a name that ends in .html" in capsys.readouterr().err


def test_a_page_that_would_be_too_large_is_refused_by_its_parts(tmp_path, monkeypatch):
    avatar = tiny_avatar()
    motion = motion_for(avatar, "counting")
    long = dataclasses.replace(motion, frames=100_000)
    with pytest.raises(AssetError, match=r"expected at most \d+ frames on a page, found 100000; --frames A:B"):
        write_page(tmp_path / "me.html", avatar, long, 0, 100_000, "me")
    monkeypatch.setattr(page, "MOST_BYTES", 20_000)
    with pytest.raises(AssetError, match=r"expected at most 0 MB, found 0.* \(geometry 0.00 MB, base color"):
        write_page(tmp_path / "me.html", avatar, motion, 0, 10, "me")
    assert list(tmp_path.iterdir()) == []
