"""Uniform blocks: the layout GLSL gives them (std140), as NumPy dtypes that mirror shaders/*.glsl."""

import moderngl
import numpy as np

from avatar.skeleton import JOINTS

# GLSL type: (numpy format, size, alignment), OpenGL 4.6 section 7.6.2.2
STD140 = {
    "float": ("f4", 4, 4),
    "vec3": (("f4", (3,)), 12, 16),
    "vec4": (("f4", (4,)), 16, 16),
    # stored by columns: assign matrix.T
    "mat4": (("f4", (4, 4)), 64, 16),
    # declared row_major: the three rows of [R | t], assign matrix[:3]
    "mat4x3": (("f4", (3, 4)), 48, 16),
    "vec4[16]": (("f4", (16, 4)), 16 * 16, 16),
    "vec4[300]": (("f4", (300, 4)), 300 * 16, 16),
    "vec4[52]": (("f4", (52, 4)), 52 * 16, 16),
    "mat4x3[52]": (("f4", (52, 3, 4)), 52 * 48, 16),
}


def std140(**fields: str) -> np.dtype:
    """Structured dtype with the offsets GLSL gives these fields, in order."""
    offsets, end = [], 0
    for kind in fields.values():
        _, size, alignment = STD140[kind]
        offsets.append(-(-end // alignment) * alignment)
        end = offsets[-1] + size
    formats = [STD140[kind][0] for kind in fields.values()]
    size = -(-end // 16) * 16
    return np.dtype({"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": size})


FRAME = std140(clip_from_view="mat4", view_amount="float")
BONES = std140(view_from_canonical="mat4x3[52]")
TURNS = std140(view_from_canonical_q="vec4[52]")
DUALS = std140(view_from_canonical_d="vec4[52]")
CAPSULES = std140(capsule_start="vec4[16]", capsule_along="vec4[16]")
LOOSE = std140(loose_offset="vec4[300]")
BINDING = {
    "Frame": (FRAME, 0),
    "Bones": (BONES, 1),
    "Turns": (TURNS, 2),
    "Duals": (DUALS, 3),
    "Capsules": (CAPSULES, 4),
    "Loose": (LOOSE, 5),
}
OF_BONES = ("Bones", "Turns", "Duals")


def block_bytes(name: str, bones: int = len(JOINTS)) -> int:
    """Of a block; those that hold every bone's grow with their number (shaders/counts.glsl)."""
    size = BINDING[name][0].itemsize
    return size // len(JOINTS) * bones if name in OF_BONES else size


def bind_block(program: moderngl.Program, name: str, bones: int = len(JOINTS)) -> None:
    """Give a block its binding point; refuse if GLSL and Python disagree on its size."""
    if name not in program:
        # the compiler removed a block this variant never reads
        return
    block, size = program[name], block_bytes(name, bones)
    assert isinstance(block, moderngl.UniformBlock), f"{name} is a {type(block).__name__}"
    if block.size != size:
        raise RuntimeError(f"uniform block {name}: {block.size} bytes in GLSL, {size} in blocks.py")
    block.binding = BINDING[name][1]
