"""Number formats of what the player draws: the same avatar with numbers of fewer bits, or kept where others keep them.

Of an avatar that experiments/baking.py baked, each variant as time of a frame, in turns with the avatar as it is
shipped, and as difference from its picture. Shipped are: posing in float64, rounded to float32 at its end; positions
and texture coordinates in float32; features of 8 bits; network weights of float32 as literals of the shader.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import moderngl
import numpy as np
from jaxtyping import Float, UInt8

from avatar.baked_avatar import Avatar, ViewNetwork
from avatar.camera import Camera
from avatar.gltf.avatar_file import read_avatar
from avatar.texture import mip_levels, mipmaps
from bench.ladder.rung_scores import compared, crop_of
from experiments.baking_scores import FRAME_SIZE, References, timed_in_turns
from player.draw.drawing import BarePose
from player.draw.posing import PosedBones, Poser
from player.gl.constants import avatar_constants
from player.gl.context import Context, open_context
from player.gl.shader import uniform
from player.gl.texture import image_texture
from player.scene.renderer import Renderer

SHIPPED = "as shipped"
# metres from the world's origin that a person stands in the rows on posing
FAR = 1000.0
CONSTANT = re.compile(r"const (vec\d|mat\dx?\d?) (\w+) = \1\(([^)]*)\);")
# OpenGL looks down -z with +y up
VIEW_FROM_CAMERA = np.diag([1.0, -1.0, -1.0, 1.0])

Frames = Sequence[tuple[BarePose, Camera]]


@dataclass(frozen=True)
class Variant:
    """One way to keep the avatar's numbers."""

    group: str
    name: str
    make: Callable[[], Renderer]


def variants(context: Context, avatar: Avatar) -> list[Variant]:
    """All that the avatar has numbers for, the shipped one first."""
    view, level = avatar.default_view, avatar.levels[0]

    def drawn(one: Avatar) -> Renderer:
        return Renderer(context, [one], FRAME_SIZE, view=view)

    def posed(kind: type[Poser]) -> Renderer:
        renderer = drawn(avatar)
        renderer.posers = [kind(avatar, level)]
        return renderer

    def changed(**fields: Any) -> Callable[[], Renderer]:
        return lambda: drawn(replace(avatar, levels=(replace(level, **fields),)))

    found = [
        Variant("", SHIPPED, lambda: drawn(avatar)),
        Variant("posing", "all of it in float32", lambda: posed(SinglePoser)),
        Variant("posing", "in float64, bones rounded to float16", lambda: posed(HalfPoser)),
        Variant("mesh", "positions rounded to float16", changed(positions=halved(level.positions))),
        Variant("mesh", "texture coordinates rounded to float16", changed(uv=halved(level.uv))),
    ]
    features = level.features
    if view != "off" and features is not None:
        found += [
            Variant("features", f"rounded to {bits} bits", changed(features=of_bits(features, bits)))
            for bits in (6, 4, 2)
        ]
        found += [
            Variant("features", f"as textures of {name}", lambda dtype=dtype: with_float_features(drawn, avatar, dtype))
            for name, dtype in (("float16", "f2"), ("float32", "f4"))
        ]
    if view == "network":
        found.append(Variant("weights", "as uniforms", lambda: with_uniforms(drawn, avatar)))
        found += [
            Variant("weights", f"rounded to {name}", partial(with_rounded, drawn, avatar, to))
            for name, to in (("float16", halved), ("8 bits", integers(8)), ("6 bits", integers(6)))
        ]
    return found


def halved(values: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
    """Values as float16 holds them."""
    return values.astype(np.float16).astype(np.float32)


def integers(bits: int) -> Callable[[Float[np.ndarray, "*any"]], Float[np.ndarray, "*any"]]:
    """Rounding to signed whole numbers of so many bits, times one float for each matrix."""

    def round_to(values: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
        most = 2 ** (bits - 1) - 1
        step = max(float(np.abs(values).max()), 1e-20) / most
        return (np.round(values / step) * step).astype(np.float32)

    return round_to


def with_rounded(
    drawn: Callable[[Avatar], Renderer], avatar: Avatar, to: Callable[[np.ndarray], np.ndarray]
) -> Renderer:
    """The avatar with each matrix and bias of its network rounded."""
    assert avatar.network is not None
    network = ViewNetwork(*map(to, vars(avatar.network).values()))
    return drawn(replace(avatar, network=network))


def of_bits(features: UInt8[np.ndarray, "*any"], bits: int) -> UInt8[np.ndarray, "*any"]:
    """Features as so many bits hold them, read as bytes."""
    most = 2**bits - 1
    return np.round(np.round(features / 255 * most) / most * 255).astype(np.uint8)


class SinglePoser(Poser):
    """Bones multiplied in float32: the camera's, the joints' and the rest pose's matrices are rounded first."""

    def posed(self, axis_angle: Float[np.ndarray, "52 3"], root: Float[np.ndarray, "3"], camera: Camera) -> PosedBones:
        world_from_joint = self._with_helpers(axis_angle, self.chain.transforms(axis_angle, root, np.eye(4)))
        view_from_world = (VIEW_FROM_CAMERA @ camera.camera_from_world).astype(np.float32)
        view_from_joint = view_from_world @ world_from_joint.astype(np.float32)
        product = view_from_joint @ self.joint_from_canonical.astype(np.float32)
        return PosedBones(product.astype(np.float64), view_from_joint[:, :3, 3].astype(np.float64), self.radii)


class HalfPoser(Poser):
    """Bones whose product is rounded to float16."""

    def posed(self, axis_angle: Float[np.ndarray, "52 3"], root: Float[np.ndarray, "3"], camera: Camera) -> PosedBones:
        bones = super().posed(axis_angle, root, camera)
        return bones._replace(view_from_canonical=halved(bones.view_from_canonical).astype(np.float64))


def with_float_features(drawn: Callable[[Avatar], Renderer], avatar: Avatar, dtype: str) -> Renderer:
    """The player's own renderer, whose features are the same numbers in textures of floats."""

    def float_texture(context: Context, image: UInt8[np.ndarray, "h w c"], *, coarse: bool = False) -> moderngl.Texture:
        if not coarse:  # no feature
            return image_texture(context, image)
        chain = [mip.astype(np.float32) / np.float32(255) for mip in mipmaps(image, mip_levels(image.shape))]
        height, width, channels = image.shape
        texture = context.gl.texture((width, height), channels, chain[0].astype(dtype).tobytes(), dtype=dtype)
        texture.build_mipmaps(max_level=len(chain) - 1)
        for number, mip in enumerate(chain[1:], 1):
            texture.write(mip.astype(dtype).tobytes(), level=number)
        minify = moderngl.NEAREST_MIPMAP_NEAREST if context.software else moderngl.LINEAR_MIPMAP_LINEAR
        texture.filter = (minify, moderngl.LINEAR)
        if not context.software:
            texture.anisotropy = 8.0
        return texture

    with patch("player.effects.avatar.image_texture", float_texture):
        return drawn(avatar)


def with_uniforms(drawn: Callable[[Avatar], Renderer], avatar: Avatar) -> Renderer:
    """The player's own renderer, whose shader is given the network's weights as uniforms."""
    written = {name: CONSTANT.sub(r"uniform \1 \2;", text) for name, text in avatar_constants(avatar).items()}
    values = {
        name: np.array([float(value) for value in numbers.split(",")], np.float32)
        for text in avatar_constants(avatar).values()
        for _, name, numbers in CONSTANT.findall(text)
    }
    with patch("player.effects.avatar.avatar_constants", lambda _: written):
        renderer = drawn(avatar)
    found = 0
    for handle in renderer.plan.handles:
        program = renderer.resources[handle]
        if isinstance(program, moderngl.Program):
            for name in values.keys() & set(program):
                uniform(program, name).write(values[name].tobytes())
                found += 1
    assert found, "no program has the network's uniforms"
    return renderer


def format_rows(path: Path, references: References, seconds: float) -> dict[str, Any]:
    """Every variant of an avatar's finest level: frames in turns with the shipped one, and its picture beside that."""
    avatar = read_avatar(path)
    avatar = replace(avatar, levels=avatar.levels[:1])
    shown = [(one.pose, one.camera.resized(FRAME_SIZE)) for one in references.seen if one.region in ("total", "head")]
    bodies = [(one.pose, one.camera.resized(FRAME_SIZE)) for one in references.bodies]
    with open_context() as context:
        found = variants(context, avatar)
        renderers = {row_name(one): one.make() for one in found}
        pictures = {name: drawn_pictures(renderer, shown) for name, renderer in renderers.items()}
        far = {
            f"{name}, {FAR:g} m from the origin": drawn_pictures(renderers[name], [moved(*one) for one in shown])
            for name in (SHIPPED, "posing: all of it in float32")
        }
        times = timed_in_turns(renderers, bodies, seconds, SHIPPED)
    masks = [picture.max(-1) > 0 for picture in pictures[SHIPPED]]
    rows = []
    for name, drawn in {**pictures, **far}.items():
        row: dict[str, Any] = {"name": name, "frame": times["rows"].get(name)}
        if name != SHIPPED:
            row |= compared(pictures[SHIPPED], drawn, [crop_of(mask) for mask in masks], masks)
            row["largest"] = max(
                int(np.abs(np.rint(255 * a) - np.rint(255 * b)).max())
                for a, b in zip(drawn, pictures[SHIPPED], strict=True)
            )
        rows.append(row)
    return {"rows": rows, "view": avatar.default_view, "times": {k: v for k, v in times.items() if k != "rows"}}


def row_name(one: Variant) -> str:
    return f"{one.group}: {one.name}" if one.group else one.name


def drawn_pictures(renderer: Renderer, frames: Frames) -> list[Float[np.ndarray, "height width 3"]]:
    return [renderer.draw([pose], camera)[..., :3].astype(np.float32) / 255 for pose, camera in frames]


def moved(pose: BarePose, camera: Camera) -> tuple[BarePose, Camera]:
    """A person and the camera before it, FAR from the origin."""
    away = np.array([FAR, 0.0, 0.0])
    camera_from_world = camera.camera_from_world.copy()
    camera_from_world[:3, 3] -= camera_from_world[:3, :3] @ away
    return (pose[0], pose[1] + away), replace(camera, camera_from_world=camera_from_world)
