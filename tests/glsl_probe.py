"""Runs a GLSL expression on many inputs and reads the results back as floats."""

import moderngl
import numpy as np

from player.gl.blocks import BINDING
from player.gl.shader import compile_program

WIDTH = 256
TYPES = {1: "float", 2: "vec2", 3: "vec3", 4: "vec4"}


def probe(context, includes, expression, inputs, generated=None, blocks=None, ints=(), stage="fragment"):
    """`expression` (a vec4) for each row of `inputs` {name: (N,) or (N, 2..4) float32}; names in `ints` are uvec4.

    includes are put before it; `blocks` are the contents of uniform blocks by name.
    """
    context.make_current()
    gl = context.gl
    inputs = {name: np.asarray(value) for name, value in inputs.items()}
    inputs = {name: value[:, None] if value.ndim == 1 else value for name, value in inputs.items()}
    count = len(next(iter(inputs.values())))
    height = -(-count // WIDTH)
    kinds = {name: "uvec4" if name in ints else TYPES[value.shape[1]] for name, value in inputs.items()}
    include = "\n".join(f'#include "{name}"' for name in includes)
    block = '#include "frame.glsl"\n' if "view_cone.glsl" in includes else ""
    place = f"""
    vec2 cell = vec2(gl_VertexID % {WIDTH}, gl_VertexID / {WIDTH}) + 0.5;
    gl_Position = vec4(2.0 * cell / vec2({WIDTH}, {height}) - 1.0, 0.0, 1.0);"""
    attributes = "\n".join(f"in {kind} {name};" for name, kind in kinds.items())
    if stage == "vertex":
        vertex = (
            f"{block}{include}\n{attributes}\nflat out vec4 result;\nvoid main() {{ {place}\n result = {expression}; }}"
        )
        fragment = "flat in vec4 result;\nout vec4 value;\nvoid main() { value = result; }"
    else:
        outs = "\n".join(f"flat out {kind} {name}_;" for name, kind in kinds.items())
        copies = " ".join(f"{name}_ = {name};" for name in kinds)
        vertex = f"{attributes}\n{outs}\nvoid main() {{ {place}\n {copies} }}"
        ins = "\n".join(f"flat in {kind} {name}_;" for name, kind in kinds.items())
        names = " ".join(f"{kind} {name} = {name}_;" for name, kind in kinds.items())
        fragment = f"{block}{include}\n{ins}\nout vec4 value;\nvoid main() {{ {names}\n value = {expression}; }}"
    sources = {"probe.vert": "#version 330\n" + vertex, "probe.frag": "#version 330\n" + fragment}
    program = compile_program(gl, "probe.vert", "probe.frag", {}, {**(generated or {}), **sources})
    buffers, content = [], []
    for name, values in (blocks or {}).items():
        buffers.append(gl.buffer(np.ascontiguousarray(values).tobytes()))
        buffers[-1].bind_to_uniform_block(BINDING[name][1])
        if name in program:
            program[name].binding = BINDING[name][1]
    for name, value in inputs.items():
        if name not in program:
            continue
        dtype, code = ("u4", "u4") if name in ints else ("f4", "f4")
        buffers.append(gl.buffer(np.ascontiguousarray(value, dtype).tobytes()))
        content.append((buffers[-1], f"{value.shape[1]}{code}", name))
    array = gl.vertex_array(program, content)
    image = gl.renderbuffer((WIDTH, height), 4, dtype="f4")
    target = gl.framebuffer([image])
    target.use()
    target.clear()
    gl.enable_only(moderngl.NOTHING)
    array.render(moderngl.POINTS, vertices=count)
    raw = np.frombuffer(target.read(components=4, dtype="f4"), np.float32).reshape(-1, 4)[:count]
    assert gl.error == "GL_NO_ERROR"
    context.leave_framebuffer()
    for thing in (target, image, array, program, *buffers):
        thing.release()
    return raw
