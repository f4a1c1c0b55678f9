"""The base colour of a glTF material: its texture times its factor, and where it has holes."""

import numpy as np

from avatar.errors import AssetError
from avatar.gltf.document import Gltf
from avatar.gltf.scene import texture_image
from avatar.picture import WITH_WEBP, decode_picture


def material_of(gltf: Gltf, index: int) -> dict:
    """A material's JSON, empty where there is none."""
    return gltf.items("materials")[index] if index >= 0 else {}


def _within(gltf: Gltf, index: int, *keys: str) -> dict:
    """An object inside a material, empty where the file has none."""
    found = material_of(gltf, index)
    for key in keys:
        found = found.get(key, {})
        if not isinstance(found, dict):
            raise gltf.error(f"materials[{index}].{key}", "an object", found)
    return found


def base_texture(gltf: Gltf, index: int) -> dict:
    """Which texture it has, by which coordinates; empty where it has none."""
    return _within(gltf, index, "pbrMetallicRoughness", "baseColorTexture")


def read_base_color(gltf: Gltf, index: int, notes: list[str]) -> tuple[np.ndarray, np.ndarray | None]:
    """Base colour (H, W, 3) sRGB and, where the material cuts holes, alpha (H, W) with its cutoff moved to 128.

    What is assumed is added to the notes.
    """
    material = material_of(gltf, index)
    described = base_texture(gltf, index)
    coloring = _within(gltf, index, "pbrMetallicRoughness")
    factor = np.ones(4)
    if "baseColorFactor" in coloring:
        factor = gltf.numbers(coloring, "baseColorFactor", f"materials[{index}].pbrMetallicRoughness", (4,))
    if "KHR_texture_transform" in gltf.extensions(described, f"materials[{index}].baseColorTexture"):
        raise AssetError(
            f"{gltf.path}: materials[{index}]: expected plain texture coordinates, found KHR_texture_transform; "
            "bake it with a glTF tool first"
        )
    if "index" in described:
        source = texture_image(gltf, described["index"], field=f"materials[{index}].baseColorTexture.index")
        data, _mime = gltf.image(source)
        try:
            rgba = decode_picture(data, "RGBA", formats=WITH_WEBP)
        except ValueError as error:
            raise AssetError(f"{gltf.path}: images[{source}]: {error}") from None
    else:
        rgba = np.full((1, 1, 4), 255, np.uint8)
    color = rgba[..., :3]
    if not np.array_equal(factor[:3], [1, 1, 1]):  # the factor is linear, the texture sRGB
        steps = np.arange(256) / 255
        linear = np.where(steps <= 0.04045, steps / 12.92, ((steps + 0.055) / 1.055) ** 2.4)
        scaled = np.clip(linear[:, None] * factor[:3], 0, 1)
        encoded = np.where(scaled <= 0.0031308, 12.92 * scaled, 1.055 * scaled ** (1 / 2.4) - 0.055)
        table = np.round(255 * encoded).astype(np.uint8)
        color = np.stack([table[color[..., c], c] for c in range(3)], -1)

    mode = material.get("alphaMode", "OPAQUE")
    if mode == "OPAQUE":
        return np.ascontiguousarray(color), None
    cutoff = material.get("alphaCutoff", 0.5) if mode == "MASK" else 0.5
    if type(cutoff) not in (int, float) or not 0 <= cutoff < 1e6:
        raise gltf.error(f"materials[{index}].alphaCutoff", "a number from 0", cutoff)
    if mode == "BLEND":
        notes.append(f"material {material.get('name', index)} blends: drawn with holes where alpha is below one half")
    opacity = rgba[..., 3] / 255 * factor[3]
    # piecewise linear, so that a bilinear sample passes 128 where the file's passes its cutoff
    moved = np.interp(opacity, [0, max(cutoff, 1e-6), max(1, cutoff + 1e-6)], [0, 128, 255])
    return np.ascontiguousarray(color), np.round(moved).astype(np.uint8)
