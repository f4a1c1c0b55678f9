"""glTF 2.0 files (.glb, .gltf, .vrm): the container, accessors and images.

A file is an untrusted claim: every count, offset, stride and index is checked against the bytes that are
really there before anything is allocated, so what a file costs in memory is bounded by its size. Bytes
and JSON come from `avatar/gltf/container.py`; what the accessors mean (nodes, skins, triangles) is
`avatar/gltf/scene.py`; writing is `avatar/gltf/write.py`.

glTF 2.0 specification, sections 3.6 (binary data) and 4 (GLB).
"""

import shlex
from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from avatar.gltf.container import MAX_BYTES, WHAT, glb_chunks, uri_bytes
from command.errors import AssetError
from files.input_file import JsonObject, parse_json, read_bytes, short

COMPONENT_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
ELEMENT_SHAPES = {"SCALAR": (), "VEC2": (2,), "VEC3": (3,), "VEC4": (4,), "MAT2": (2, 2), "MAT3": (3, 3),
                  "MAT4": (4, 4)}  # fmt: skip

# Required extensions that change nothing we read, or that are read here. KHR_materials_* is read as its base.
READ_EXTENSIONS = (
    "KHR_mesh_quantization EXT_texture_webp KHR_texture_transform KHR_lights_punctual KHR_node_visibility"
).split()
READ_PREFIXES = ("KHR_materials_", "VRM", "SELFSCAN_")
# Extensions we do not read, and the glTF-Transform command line that turns each into plain glTF.
CONVERTERS = {
    "EXT_meshopt_compression": "copy {} plain.glb",
    "KHR_meshopt_compression": "copy {} plain.glb",
    "KHR_draco_mesh_compression": "copy {} plain.glb",
    "KHR_texture_basisu": "ktxdecompress {} plain.glb",
    "EXT_texture_avif": 'png {} plain.glb --formats "*"',
    "KHR_materials_pbrSpecularGlossiness": "metalrough {} plain.glb",
}

COLLECTIONS = (
    "accessors animations buffers bufferViews images materials meshes nodes samplers scenes skins textures"
).split()


@dataclass(frozen=True)
class Gltf:
    """One file: its JSON, and the bytes of its buffers, already known to be as long as the JSON says."""

    path: Path
    json: JsonObject
    buffers: tuple[memoryview, ...]

    def error(self, field: str, expected: str, found: object) -> AssetError:
        return AssetError(f"{self.path}: {field} should be {expected}, is {short(found)}")

    def items(self, collection: str) -> list[JsonObject]:
        """A top-level list of objects (`nodes`, `meshes` ...), empty where the file has none."""
        return self.json.get(collection, [])

    def item(self, collection: str, index: object, field: str) -> JsonObject:
        return self.items(collection)[self.index(collection, index, field)]

    def index(self, collection: str, index: object, field: str) -> int:
        """A reference into a collection: a whole number that exists there."""
        count = len(self.items(collection))
        if type(index) is not int or not 0 <= index < count:
            raise self.error(field, f"an index below {count} ({collection})", index)
        return index

    def integer(self, holder: JsonObject, key: str, field: str, *, low: int = 0, default: int | None = None) -> int:
        """A whole number of at least `low`; absent means `default` where there is one."""
        value = holder.get(key, default)
        if type(value) is not int or not low <= value <= MAX_BYTES:
            raise self.error(f"{field}.{key}", f"a whole number from {low} to {MAX_BYTES}", value)
        return value

    def numbers(self, holder: JsonObject, key: str, field: str, shape: tuple[int, ...]) -> Array:
        """A flat JSON list of finite numbers as a float64 array of `shape`."""
        value = holder.get(key)
        size = prod(shape)
        if not isinstance(value, list) or len(value) != size:
            raise self.error(f"{field}.{key}", f"{size} numbers", value)
        if not all(type(v) in (int, float) and abs(v) < 1e30 for v in value):
            raise self.error(f"{field}.{key}", f"{size} finite numbers", value)
        return np.array(value, dtype=np.float64).reshape(shape)

    def objects(self, holder: JsonObject, key: str, field: str) -> list[JsonObject]:
        value = holder.get(key)
        if not isinstance(value, list) or not value or not all(isinstance(v, dict) for v in value):
            raise self.error(f"{field}.{key}", "a list of objects", value)
        return value

    def view(self, index: object, field: str) -> memoryview:
        """The bytes of a buffer view."""
        view = self.item("bufferViews", index, field)
        where = f"bufferViews[{index}]"
        buffer = self.buffers[self.index("buffers", view.get("buffer"), f"{where}.buffer")]
        offset = self.integer(view, "byteOffset", where, default=0)
        length = self.integer(view, "byteLength", where, low=1)
        if offset + length > len(buffer):
            raise self.error(f"{where} end", f"within its buffer of {len(buffer)} bytes", offset + length)
        return buffer[offset : offset + length]

    def extensions(self, holder: JsonObject, field: str) -> JsonObject:
        """The `extensions` object of any glTF object, empty where it has none."""
        extensions = holder.get("extensions", {})
        if not isinstance(extensions, dict):
            raise self.error(f"{field}.extensions", "an object", extensions)
        return extensions

    def accessor(self, index: object, *, as_float: bool = False, field: str = "accessor") -> Array:
        """The values of an accessor: (count,), (count, n) for vectors, (count, n, n) for matrices.

        The array is the caller's own. Matrices are transposed to NumPy's order: `matrix @ column`. Integers
        stay as stored; with `as_float` they become float32, and normalised ones their fraction:
        c / (2^bits - 1), max(c / (2^(bits-1) - 1), -1) when signed. Floats must be finite.
        """
        accessor = self.item("accessors", index, field)
        where = f"accessors[{index}]"
        component, kind = accessor.get("componentType"), accessor.get("type")
        if type(component) is not int or component not in COMPONENT_TYPES:
            raise self.error(f"{where}.componentType", f"one of {sorted(COMPONENT_TYPES)}", component)
        if not isinstance(kind, str) or kind not in ELEMENT_SHAPES:
            raise self.error(f"{where}.type", f"one of {list(ELEMENT_SHAPES)}", kind)
        dtype, shape = np.dtype(COMPONENT_TYPES[component]), ELEMENT_SHAPES[kind]
        if len(shape) == 2 and dtype.itemsize * shape[0] % 4:
            raise self.error(f"{where}.componentType", "float for a matrix", component)
        count = self.integer(accessor, "count", where, low=1)

        if "sparse" in accessor:
            values = self._with_sparse(accessor, dtype, shape, count, where)
        else:
            values = self._elements(accessor, dtype, shape, count, where).copy()
        if dtype.kind == "f":
            if not np.isfinite(values).all():
                first = tuple(np.argwhere(~np.isfinite(values))[0].tolist())
                raise AssetError(f"{self.path}: {where} should be finite, is {values[first]} at {first}")
        elif as_float:
            values = values.astype(np.float32)
            if accessor.get("normalized", False) is True:
                values = np.maximum(values / np.float32(np.iinfo(dtype).max), np.float32(-1))
        return values.swapaxes(-1, -2) if len(shape) == 2 else values

    def _with_sparse(self, accessor: JsonObject, dtype: np.dtype, shape: tuple[int, ...], count: int, where: str):
        """Elements of a buffer view, or zeros without one, some of them replaced (glTF 2.0, section 3.6.2.3)."""
        sparse, where_sparse = accessor["sparse"], f"{where}.sparse"
        if not isinstance(sparse, dict) or not all(isinstance(sparse.get(key), dict) for key in ("indices", "values")):
            raise self.error(where_sparse, "an object with indices and values", sparse)
        if "bufferView" in accessor:
            values = self._elements(accessor, dtype, shape, count, where).copy()
        else:
            bytes_there, size = sum(map(len, self.buffers)), dtype.itemsize * prod(shape)
            # zeros cost nothing in a file, but as much in memory as what is there
            if count * size > bytes_there:
                raise self.error(f"{where}.count", f"at most {bytes_there // size}: the file is no larger", count)
            values = np.zeros((count, *shape), dtype)
        given = self.integer(sparse, "count", where_sparse, low=1)
        kind = sparse["indices"].get("componentType")
        if type(kind) is not int or kind not in (5121, 5123, 5125):
            raise self.error(f"{where_sparse}.indices.componentType", "one of [5121, 5123, 5125]", kind)
        stored = np.dtype(COMPONENT_TYPES[kind])
        index = self._elements(sparse["indices"], stored, (), given, f"{where_sparse}.indices").astype(np.int64)
        if index[-1] >= count or (np.diff(index) <= 0).any():
            raise self.error(f"{where_sparse}.indices", f"ascending and below {count}", index[-1].item())
        values[index] = self._elements(sparse["values"], dtype, shape, given, f"{where_sparse}.values")
        return values

    def _elements(self, holder: JsonObject, dtype: np.dtype, shape: tuple[int, ...], count: int, where: str) -> Array:
        """`count` elements of a buffer view, as a view of its bytes, bounds checked."""
        data = self.view(holder.get("bufferView"), f"{where}.bufferView")
        offset = self.integer(holder, "byteOffset", where, default=0)
        size = stride = dtype.itemsize * prod(shape)
        view = self.items("bufferViews")[holder["bufferView"]]
        if "byteStride" in view:
            stride = self.integer(view, "byteStride", f"bufferViews[{holder['bufferView']}]", low=1)
            if stride < size:
                raise self.error(f"{where} byteStride", f"at least the element's {size} bytes", stride)
        end = offset + stride * (count - 1) + size
        if end > len(data):
            raise self.error(f"{where} end", f"within its buffer view of {len(data)} bytes", end)
        strides = (stride,) + tuple(np.zeros((1, *shape), dtype).strides[1:])
        return np.ndarray((count, *shape), dtype, data, offset, strides)

    def image(self, index: object) -> bytes:
        """The encoded bytes of an image, which begins as a PNG, a JPEG or a WebP image does."""
        image = self.item("images", index, "image")
        where = f"images[{index}]"
        if "bufferView" in image:
            data = bytes(self.view(image["bufferView"], f"{where}.bufferView"))
        else:
            data = uri_bytes(self.path, image.get("uri"), f"{where}.uri")
        if data.startswith((b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff")) or (data[:4], data[8:12]) == (b"RIFF", b"WEBP"):
            return data
        if data[:8] == b"\xabKTX 20\xbb":
            raise AssetError(refusal(self.path, "KHR_texture_basisu"))
        raise self.error(where, "a PNG, JPEG or WebP image", data[:12])


def refusal(path: Path, extension: str) -> str:
    """Why a file with this required extension is not read, and the command that removes it."""
    message = f"{path}: the file requires the extension {extension[:80]!r}, which is not read here"
    if extension in CONVERTERS:
        command = CONVERTERS[extension].format(shlex.quote(str(path)))
        return f"{message}; convert it with: npx @gltf-transform/cli {command}"
    return f"{message}; export the file without it"


def read_gltf(path: str | Path) -> Gltf:
    """Read a .glb, .vrm or .gltf file with the buffers it names.

    Raises:
        AssetError: anything that is not as the file claims, or an extension that is required and not read.
    """
    path = Path(path)
    data = read_bytes(path, WHAT, most=MAX_BYTES)
    if data[:4] == b"glTF":
        text, binary = glb_chunks(path, data)
    else:
        text, binary = memoryview(data), None
    document = parse_json(bytes(text), str(path), "glTF")
    if not isinstance(document, dict):
        raise AssetError(f"{path}: should be glTF JSON, is {short(document)}")
    gltf = Gltf(path, document, ())
    _check_document(gltf)
    return Gltf(path, document, tuple(_read_buffers(gltf, binary)))


def _check_document(gltf: Gltf) -> None:
    """The version, the required extensions, and that every collection is a list of objects."""
    asset = gltf.json.get("asset")
    version = asset.get("version") if isinstance(asset, dict) else None
    if not isinstance(version, str) or not version.startswith("2."):
        raise gltf.error("asset.version", "2.x", version)
    for key in ("extensionsUsed", "extensionsRequired"):
        names = gltf.json.get(key, [])
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise gltf.error(key, "a list of names", names)
    for name in gltf.json.get("extensionsRequired", []):
        read = name in READ_EXTENSIONS or name.startswith(READ_PREFIXES)
        if name in CONVERTERS or not read:
            raise AssetError(refusal(gltf.path, name))
    for key in COLLECTIONS:
        items = gltf.json.get(key, [])
        if not isinstance(items, list):
            raise gltf.error(key, "a list of objects", items)
        for i, item in enumerate(items):
            if not isinstance(item, dict):
                raise gltf.error(f"{key}[{i}]", "an object", item)


def _read_buffers(gltf: Gltf, binary: memoryview | None) -> list[memoryview]:
    """The bytes of every buffer: the binary chunk, data URIs, and files beside the .gltf."""
    buffers, total = [], 0
    for i, buffer in enumerate(gltf.items("buffers")):
        where = f"buffers[{i}]"
        length = gltf.integer(buffer, "byteLength", where, low=1)
        if "uri" in buffer:
            data = memoryview(uri_bytes(gltf.path, buffer["uri"], f"{where}.uri"))
        elif i == 0 and binary is not None:
            data = binary
        else:
            # a meshopt buffer to be filled by decompression
            for name in gltf.extensions(buffer, where):
                if name in CONVERTERS:
                    raise AssetError(refusal(gltf.path, name))
            raise gltf.error(where, "bytes in the file or a uri", buffer)
        if length > len(data):
            raise gltf.error(f"{where}.byteLength", f"at most the {len(data)} bytes there", length)
        total += len(data)
        if total > MAX_BYTES:
            raise gltf.error("buffers", f"at most {MAX_BYTES} bytes", total)
        buffers.append(data[:length])
    return buffers
