"""GLSL programs from shaders/: includes, named variants, and compile errors as file:line.

`#include "name.glsl"` is replaced by the file, once per stage, between `#line` directives. A variant is a set
of named defines: each must be tested by some `#if` of the source, and each name tested must be given, so that
a misspelt or forgotten switch is an error and never a silent 0.
"""

import re
from collections.abc import Mapping
from importlib.resources import files

import moderngl
import numpy as np

INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"\s*$')
CONDITION = re.compile(r"^\s*#\s*(?:if|elif)\b(.*)$", re.MULTILINE)
COMPARISON = re.compile(r"^#\s*if\s+(\w+)\s*([!=]=)\s*(\d+)$")
NAME = re.compile(r"\b[A-Z][A-Z0-9_]+\b")
PLACE = re.compile(r"^(?:(?:ERROR|WARNING):\s*)?(\d+)[:(](\d+)\)?", re.MULTILINE)  # 0:12(3) | 0(12) | ERROR: 0:12

UniformValue = float | int | tuple[float | int, ...] | np.ndarray | np.generic
Uniforms = dict[str, UniformValue]


class ShaderError(RuntimeError):
    """A shader that does not compile, or a variant it does not have. Says file:line."""


def shader_source(name: str, generated: Mapping[str, str] | None = None) -> str:
    """Text of a shader: generated text first (constants made for one avatar), else the file in shaders/."""
    if generated and name in generated:
        return generated[name]
    path = files("shaders") / name
    if not path.is_file():
        raise ShaderError(f"shaders/{name}: no such shader")
    return path.read_text("utf-8")


def assembled(
    name: str, defines: Mapping[str, int], generated: Mapping[str, str] | None = None
) -> tuple[str, list[str]]:
    """One stage as the compiler gets it, and the files by their `#line` number."""
    order: list[str] = []

    def expand(file: str, lines: list[str]) -> None:
        """Add a file's lines, those of its includes where they stand."""
        number = len(order)
        order.append(file)
        text = shader_source(file, generated).splitlines()
        if number:
            lines.append(f"#line 1 {number}")
        # whether each of the open #ifs is compiled
        branches: list[bool] = []
        for at, line in enumerate(text, 1):
            directive = line.strip()
            if not directive.startswith("#"):
                lines.append(line)
                continue
            _follow(directive, branches, defines)
            include = INCLUDE.match(line)
            if include:
                if include[1] not in order and all(branches):
                    expand(include[1], lines)
                lines.append(f"#line {at + 1} {number}")
            else:
                lines.append(line)
            if number == 0 and line.startswith("#version"):
                lines.extend(f"#define {key} {value}" for key, value in defines.items())
                lines.append(f"#line {at + 1} 0")

    lines: list[str] = []
    expand(name, lines)
    return "\n".join(lines) + "\n", order


def _follow(directive: str, branches: list[bool], defines: Mapping[str, int]) -> None:
    """Keep track of `#if NAME == 1`, `#else`, `#endif`: an include that is not compiled need not exist."""
    word = directive[1:].lstrip()
    if word.startswith("if"):
        condition = COMPARISON.match(directive)
        if condition is None:
            raise ShaderError(f"shaders: only `#if NAME == value` and `!=` are understood, not {directive!r}")
        same = defines.get(condition[1], 0) == int(condition[3])
        branches.append(same == (condition[2] == "=="))
    elif word.startswith("else"):
        branches[-1] = not branches[-1]
    elif word.startswith("endif"):
        branches.pop()


def names_in_conditions(source: str) -> set[str]:
    """Names of defines that the source's `#if`s ask about."""
    return {name for condition in CONDITION.findall(source) for name in NAME.findall(condition)}


def compile_program(
    gl: moderngl.Context, vertex: str, fragment: str, defines: Mapping[str, int] | None = None,
    generated: Mapping[str, str] | None = None,
) -> moderngl.Program:  # fmt: skip
    """Compile and link shaders/vertex with shaders/fragment in the variant that `defines` names.

    Raises:
        ShaderError: a define that no `#if` tests, a tested name that is not given, or what the compiler says,
            with every position as file:line.
    """
    defines = dict(defines or {})
    stages = [assembled(name, defines, generated) for name in (vertex, fragment)]
    asked = set().union(*(names_in_conditions(source) for source, _ in stages))
    if asked != set(defines):
        unknown, missing = sorted(set(defines) - asked), sorted(asked - set(defines))
        facts = [f"no #if tests {unknown}"] * bool(unknown) + [f"{missing} not given"] * bool(missing)
        raise ShaderError(f"shaders/{vertex} + {fragment}: {'; '.join(facts)}")
    try:
        return gl.program(vertex_shader=stages[0][0], fragment_shader=stages[1][0])
    except moderngl.Error as error:
        message = str(error)
        order = stages[1][1] if "fragment_shader" in message else stages[0][1]
        raise ShaderError(located(message, order)) from None


def uniform(program: moderngl.Program, name: str) -> moderngl.Uniform:
    found = program[name]
    assert isinstance(found, moderngl.Uniform), f"{name} is a {type(found).__name__}"
    return found


def set_uniforms(program: moderngl.Program, **values: UniformValue) -> None:
    """Give uniforms their values; arrays lie as GLSL has them, matrices by columns."""
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            uniform(program, name).write(np.ascontiguousarray(value, np.float32).tobytes())
        else:
            uniform(program, name).value = value


def located(message: str, order: list[str]) -> str:
    """A compiler's message with `source:line` positions turned into `shaders/file:line`."""

    def name(match: re.Match[str]) -> str:
        source = int(match[1])
        return f"shaders/{order[source]}:{match[2]}" if source < len(order) else match[0]

    return PLACE.sub(name, message)
