"""The shaders of shaders/ for a browser: GLSL 3.30 turned into GLSL ES 3.00 (WebGL2) by a rule.

What the two languages share is nearly all of it. The rule: the version line; every precision stated, and high; no
comments (they hold letters that ES has none of), no `#line`; and the bias of the base color's mipmaps, a state of the
texture on a desktop (player/gl/texture.py), becomes the third argument of its look-up, a constant that the page sets to
0 on a GPU.
"""

import re
from collections.abc import Mapping

from avatar.baked_avatar import Avatar
from player.effects.avatar import STAGE, views_of
from player.gl.constants import avatar_constants
from player.gl.shader import ShaderError, assembled, names_in_conditions

VERSION = "#version 330\n"
# highp is not the default of a fragment's floats, nor of most samplers
HEADER = """#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
"""
COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
# the look-up that has a bias on a software rasteriser
BIASED = "texture(base_color, surface_uv)"
STAGES = ("avatar.vert", "avatar.frag")


def essl(source: str) -> str:
    """One stage of GLSL 3.30 as GLSL ES 3.00.

    Raises:
        ShaderError: it is of another version, or holds letters that GLSL ES has none of.
    """
    if not source.startswith(VERSION):
        raise ShaderError(f"expected {VERSION.strip()!r} in the first line, found {source[:20]!r}")
    source = COMMENT.sub("", source.removeprefix(VERSION)).replace(BIASED, f"{BIASED[:-1]}, MIP_BIAS)")
    lines = [line.strip() for line in source.splitlines()]
    text = HEADER + "".join(f"{line}\n" for line in lines if line and not line.startswith("#line"))
    if not text.isascii():
        letter = next(letter for letter in text if not letter.isascii())
        raise ShaderError(f"{letter!r} outside of a comment: GLSL ES has no such letter")
    return text


def program(defines: Mapping[str, int], generated: Mapping[str, str]) -> dict[str, str]:
    """Both stages of an avatar's program in a variant. Names that are tested and not given are effects that a page does
    not have: 0, off.

    Raises:
        ShaderError: a define that no `#if` tests.
    """
    asked = set().union(*(names_in_conditions(assembled(name, defines, generated)[0]) for name in STAGES))
    if not set(defines) <= asked:
        raise ShaderError(f"{' + '.join(STAGES)}: no #if tests {sorted(set(defines) - asked)}")
    whole = dict.fromkeys(sorted(asked), 0) | dict(defines)
    vertex, fragment = (essl(assembled(name, whole, generated)[0]) for name in STAGES)
    if fragment.count("MIP_BIAS") != 1:
        raise ShaderError(f"avatar.frag: expected `{BIASED}` once, found it {fragment.count('MIP_BIAS')} times")
    return {"vertex": vertex, "fragment": fragment}


def programs(avatar: Avatar, *, faced: bool = False) -> dict[str, dict[str, str]]:
    """A program for each view mode that the avatar's file holds, by its name (player/effects/avatar.py); `faced`: one
    that moves its face."""
    constants = avatar_constants(avatar)
    more = {"FACE": 1} if faced else {}
    found = {"off": program({"VIEW_STAGE": 0, **more}, {})}
    if avatar.levels[0].features is None:
        return found
    for view in reversed(views_of(avatar)[:-1]):
        network = view == "network" or (view == "vertex" and avatar.network is not None)
        found[view] = program({"VIEW_STAGE": STAGE[view], "VIEW_MODEL": int(network), **more}, constants)
    return found
