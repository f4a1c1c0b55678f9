"""One avatar's view dependence as GLSL constants: what shaders/view_*.glsl include under a fixed name.

Literals measured 3-6 times faster than uniforms on a software rasteriser (the compiler folds and keeps them in
code); the price is one program per avatar.
"""

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar, ViewNetwork


def literal(value: float) -> str:
    """A GLSL float that reads back as the same float32: nine digits and a decimal point, whatever the locale."""
    if not np.isfinite(value):
        raise ValueError(f"a shader constant should be finite, is {value}")
    text = f"{value:.9g}"
    return text if "." in text or "e" in text else text + ".0"


def constructor(kind: str, values: Float[np.ndarray, "n"]) -> str:
    """`mat4(...)` or `vec4(...)` of values in GLSL's order (matrices by columns)."""
    return f"{kind}({', '.join(literal(float(value)) for value in values)})"


def network_constants(network: ViewNetwork, amplitude: float) -> str:
    """Constants for view_network.glsl: matrices cut into 4x4 blocks, of layer 1 by features (W1_F) and [t', |t'|]
    (W1_T), for four hidden units each."""
    lines = [f"const float AMPLITUDE = {literal(float(amplitude))};"]
    for block in range(4):
        four = slice(4 * block, 4 * block + 4)
        for name, columns in (("F", network.w1[:, :4]), ("T", network.w1[:, 4:])):
            lines.append(f"const mat4 W1_{name}{block} = {constructor('mat4', columns[four].T.ravel())};")
        lines.append(f"const vec4 B1_{block} = {constructor('vec4', network.b1[four])};")
        lines.append(f"const mat4x3 WY_{block} = {constructor('mat4x3', network.w2[:, four].T.ravel())};")
    lines.append(f"const vec3 BY = {constructor('vec3', network.b2)};")
    return "\n".join(lines) + "\n"


def linear_constants(linear: Float[np.ndarray, "4 3 3"]) -> str:
    """Constants for view_linear.glsl: M_i, which multiply column vectors."""
    lines = [f"const mat3 LINEAR_{i} = {constructor('mat3', M.T.ravel())};" for i, M in enumerate(linear)]
    return "\n".join(lines) + "\n"


def avatar_constants(avatar: Avatar) -> dict[str, str]:
    """Generated includes of one avatar, by include name."""
    out = {}
    if avatar.network is not None:
        out["network_constants.glsl"] = network_constants(avatar.network, avatar.amplitude)
    if avatar.linear is not None:
        out["linear_constants.glsl"] = linear_constants(avatar.linear)
    return out
