import re
from fnmatch import fnmatch
from pathlib import Path

import pytest

from player.gl.blocks import bind_block
from player.gl.context import open_context
from player.gl.shader import ShaderError, assembled, compile_program, names_in_conditions


@pytest.fixture
def context():
    """Not shared: moderngl leaves the program of a failed compilation behind."""
    context = open_context()
    yield context
    context.release()


FRAGMENT = "#version 330\nout vec4 color;\nvoid main() { color = vec4(1.0); }\n"


def vertex(body: str) -> str:
    return f"#version 330\n{body}\nvoid main() {{ gl_Position = vec4(0.0); }}\n"


def test_an_error_in_an_include_names_its_file_and_line(context):
    generated = {
        "a.vert": '#version 330\n\n#include "b.glsl"\nvoid main() { gl_Position = vec4(0.0); }\n',
        "b.glsl": "// fine\nfloat half_of(float x) {\n    return y / 2.0;\n}\n",
        "a.frag": FRAGMENT,
    }
    with pytest.raises(ShaderError, match=r"shaders/b\.glsl:3"):
        compile_program(context.gl, "a.vert", "a.frag", {}, generated)
    generated["b.glsl"] = "// fine\n"
    generated["a.vert"] = generated["a.vert"].replace("vec4(0.0)", "vec4(oops)")
    with pytest.raises(ShaderError, match=r"shaders/a\.vert:4"):
        compile_program(context.gl, "a.vert", "a.frag", {}, generated)


def test_an_unknown_define_and_a_forgotten_one_are_errors(context):
    generated = {"a.vert": vertex("#if FANCY == 1\n#endif"), "a.frag": FRAGMENT}
    with pytest.raises(ShaderError, match=r"no #if tests \['SHINY'\]; \['FANCY'\] not given"):
        compile_program(context.gl, "a.vert", "a.frag", {"SHINY": 1}, generated)
    compile_program(context.gl, "a.vert", "a.frag", {"FANCY": 0}, generated).release()


def test_an_include_is_taken_once_and_only_where_it_is_compiled():
    generated = {
        "top.vert": '#version 330\n#include "x.glsl"\n#include "x.glsl"\n#if MODE == 1\n#include "none.glsl"\n#endif\n',
        "x.glsl": "float once;\n",
    }
    source, order = assembled("top.vert", {"MODE": 0}, generated)
    assert source.count("float once;") == 1 and order == ["top.vert", "x.glsl"]
    with pytest.raises(ShaderError, match=r"none\.glsl: no such shader"):
        assembled("top.vert", {"MODE": 1}, generated)
    assert names_in_conditions(source) == {"MODE"}


def test_a_block_of_another_size_is_refused(context):
    generated = {
        "a.vert": "#version 330\nlayout(std140) uniform Frame { vec4 a; };\nvoid main() { gl_Position = a; }\n",
        "a.frag": FRAGMENT,
    }
    program = compile_program(context.gl, "a.vert", "a.frag", {}, generated)
    with pytest.raises(RuntimeError, match="16 bytes in GLSL, 80 in"):
        bind_block(program, "Frame")
    program.release()


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
