"""Images as textures, every mipmap against means over blocks; shaders that are put together and compiled."""

import re
from ctypes import c_int, c_uint, c_void_p
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path

import moderngl
import numpy as np
import pytest
from refusals import refused
from tiny_avatar import tiny_avatar, tiny_level

from avatar.camera import Camera, look_at
from avatar.texture import mip_levels, sample_texture
from player.gl import texture
from player.gl.blocks import bind_block
from player.gl.context import open_context
from player.gl.shader import ShaderError, assembled, compile_program, names_in_conditions
from player.gl.texture import image_texture
from player.scene.renderer import Renderer


def block_means(image, level):
    size = 1 << level
    height, width, channels = image.shape
    return image.reshape(height // size, size, width // size, size, channels).mean((1, 3), dtype=np.float64)


def held_level(context, texture, level, height, width):
    """What the device holds, as RGBA: moderngl reads no levels but those it made."""
    out = np.zeros((height, width, 4), np.uint8)
    read = context.function("glGetTexImage", c_uint, c_int, c_uint, c_uint, c_void_p)
    texture.use()
    read(0x0DE1, level, 0x1908, 0x1401, out.ctypes.data)  # of a 2D texture, RGBA, unsigned bytes
    return out


@pytest.mark.parametrize("shape", [(1024, 1024, 3), (1024, 512, 4), (8, 2, 3), (512, 12, 4)])
def test_mipmaps_on_the_device_are_the_means_of_blocks(context, shape):
    image = np.random.default_rng(3).integers(0, 256, shape, dtype=np.uint8)
    texture = image_texture(context, image)
    assert texture.components == shape[2]
    for level in range(mip_levels(shape)):
        height, width = (max(side >> level, 1) for side in shape[:2])
        held = held_level(context, texture, level, height, width)
        # each halving rounds by at most half, and passes on the error of the one before
        assert np.abs(held[..., : shape[2]] - block_means(image, level)).max() <= 0.5 * level + 1e-9
        assert shape[2] == 4 or (held[..., 3] == 255).all()
    texture.release()


def test_mipmaps_have_the_sizes_of_opengl_are_counted_and_one_texel_only_where_asked(context):
    image = np.full((515, 301, 3), (10, 200, 90), np.uint8)
    texture = image_texture(context, image)
    held = held_level(context, texture, 1, 257, 150)
    assert (held == (10, 200, 90, 255)).all()
    texture.release()
    before = context.counts.live_bytes
    texture = image_texture(context, np.zeros((1024, 1024, 3), np.uint8))
    assert context.counts.live_bytes - before == sum(4 * (1024 >> i) ** 2 for i in range(mip_levels((1024, 1024))))
    texture.release()
    assert context.counts.live_bytes == before
    image = np.zeros((4, 4, 4), np.uint8)
    fine, coarse = (image_texture(context, image, coarse=coarse) for coarse in (False, True))
    assert (fine.filter != coarse.filter) == context.software
    assert fine.filter[1] == coarse.filter[1] == moderngl.LINEAR  # enlarged, all four
    fine.release()
    coarse.release()


@pytest.fixture(scope="module")
def board():
    """A square of 1 m that faces +z, its texture noise that changes over some four texels of 512."""
    noise = np.random.default_rng(0).uniform(0, 255, (128, 128, 1)).repeat(3, 2)
    grid = (np.arange(512) + 0.5) / 512
    uv = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    image = sample_texture(noise, uv).reshape(512, 512, 3).round().astype(np.uint8)
    corners = np.array([[-0.5, 0.5, 0], [-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0]], np.float32)
    flat = replace(
        tiny_level(vertices=4, faces=2, features=0),
        positions=corners,
        uv=np.array([[0, 0], [0, 1], [1, 1], [1, 0]], np.float32),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
        joints=np.zeros((4, 4), np.uint8),
        weights=np.array([[255, 0, 0, 0]] * 4, np.uint8),
        base_color=image,
    )
    return tiny_avatar(levels=(flat,), network=None, linear=None, default_view="off")


def drawn(avatar, size):
    eye = look_at(np.array([0.9, 0.3, 1.6]), np.zeros(3))  # aslant: a pixel covers 1.5 x 1.8 texels
    K = np.array([[1.6 * size, 0, size / 2], [0, 1.6 * size, size / 2], [0, 0, 1]])
    with_context = open_context()
    try:
        renderer = Renderer(with_context, [avatar], (size, size), view="off")
        picture = renderer.draw([(np.zeros((52, 3)), np.zeros(3))], Camera(K, eye, (size, size)))[..., :3] / 255.0
        renderer.release()
        return picture, with_context.software
    finally:
        with_context.release()


def test_picture_is_nearer_to_one_of_many_samples(board, monkeypatch):
    many, _ = drawn(board, 4 * 384)
    true = many.reshape(384, 4, 384, 4, 3).mean((1, 3))
    one, software = drawn(board, 384)
    inside = (np.abs(many - many[0, 0]).sum(-1) > 0).reshape(384, 4, 384, 4).all((1, 3))
    error = np.sqrt(np.mean((one - true)[inside] ** 2))
    if software:
        monkeypatch.setattr(texture, "MIP_BIAS", 0.0)
        blurred, _ = drawn(board, 384)
        assert np.sqrt(np.mean((blurred - true)[inside] ** 2)) > 1.6 * error
    assert error < 4 / 255


@pytest.fixture
def fresh():
    """Not shared: moderngl leaves the program of a failed compilation behind."""
    context = open_context()
    yield context
    context.release()


FRAGMENT = "#version 330\nout vec4 color;\nvoid main() { color = vec4(1.0); }\n"


def vertex(body: str) -> str:
    return f"#version 330\n{body}\nvoid main() {{ gl_Position = vec4(0.0); }}\n"


def test_an_error_in_an_include_names_its_file_and_line(fresh):
    generated = {
        "a.vert": '#version 330\n\n#include "b.glsl"\nvoid main() { gl_Position = vec4(0.0); }\n',
        "b.glsl": "// fine\nfloat half_of(float x) {\n    return y / 2.0;\n}\n",
        "a.frag": FRAGMENT,
    }
    refused(ShaderError, r"shaders/b\.glsl:3", compile_program, fresh.gl, "a.vert", "a.frag", {}, generated)
    generated["b.glsl"] = "// fine\n"
    generated["a.vert"] = generated["a.vert"].replace("vec4(0.0)", "vec4(oops)")
    refused(ShaderError, r"shaders/a\.vert:4", compile_program, fresh.gl, "a.vert", "a.frag", {}, generated)


def test_defines_are_those_tested_and_blocks_have_their_size(fresh):
    generated = {"a.vert": vertex("#if FANCY == 1\n#endif"), "a.frag": FRAGMENT}
    with pytest.raises(ShaderError, match=r"no #if tests \['SHINY'\]; \['FANCY'\] not given"):
        compile_program(fresh.gl, "a.vert", "a.frag", {"SHINY": 1}, generated)
    compile_program(fresh.gl, "a.vert", "a.frag", {"FANCY": 0}, generated).release()
    generated = {
        "a.vert": "#version 330\nlayout(std140) uniform Frame { vec4 a; };\nvoid main() { gl_Position = a; }\n",
        "a.frag": FRAGMENT,
    }
    program = compile_program(fresh.gl, "a.vert", "a.frag", {}, generated)
    refused(RuntimeError, "16 bytes in GLSL, 80 in", bind_block, program, "Frame")
    program.release()


def test_an_include_is_taken_once_and_only_where_it_is_compiled():
    generated = {
        "top.vert": '#version 330\n#include "x.glsl"\n#include "x.glsl"\n#if MODE == 1\n#include "none.glsl"\n#endif\n',
        "x.glsl": "float once;\n",
    }
    source, order = assembled("top.vert", {"MODE": 0}, generated)
    assert source.count("float once;") == 1 and order == ["top.vert", "x.glsl"]
    refused(ShaderError, r"none\.glsl: no such shader", assembled, "top.vert", {"MODE": 1}, generated)
    assert names_in_conditions(source) == {"MODE"}


def test_every_shader_begins_with_what_it_is_and_is_listed():
    """One topic a file: a comment first, short enough to read at once,
    and a place in the table of shaders/README.md.
    """
    folder = Path(__file__).parents[2] / "shaders"
    listed = re.findall(r"`([\w*.]+)`", (folder / "README.md").read_text())
    for path in folder.iterdir():
        if path.suffix not in (".glsl", ".vert", ".frag"):
            continue
        lines = path.read_text("utf-8").splitlines()
        first = lines[1] if path.suffix != ".glsl" else lines[0]
        assert first.startswith("// "), f"{path.name} should say what it is first"
        assert len(lines) < 100 and max(map(len, lines)) <= 120, path.name
        assert any(fnmatch(path.name, pattern) for pattern in listed), f"{path.name} is not in shaders/README.md"
