"""Writing glTF 2.0 binary files: accessors and images gathered into one buffer, then the GLB bytes.

Every accessor has a buffer view of its own, four-byte aligned and tightly packed, in the order of the calls:
the same calls give the same bytes.
"""

import json
import struct

import numpy as np

from avatar.gltf.document import COMPONENT_TYPES, ELEMENT_SHAPES
from files.input_file import JsonObject

VERTICES, INDICES = 34962, 34963  # bufferView.target: ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER


class GltfBuilder:
    """The binary part of a file under construction."""

    def __init__(self) -> None:
        self.accessors: list[JsonObject] = []
        self.views: list[JsonObject] = []
        self.images: list[JsonObject] = []
        self.binary = bytearray()

    def add_accessor(
        self, values: np.ndarray, target: int | None = None, *, normalised: bool = False, bounds: bool = False
    ) -> int:
        """Store an array (count, ...) and return its accessor; `bounds` adds the min and max POSITION needs.

        Matrices are given in NumPy's order (`matrix @ column`) and stored by columns.
        """
        component = {np.dtype(name): code for code, name in COMPONENT_TYPES.items()}.get(values.dtype)
        kind = {shape: name for name, shape in ELEMENT_SHAPES.items()}.get(values.shape[1:])
        if component is None or kind is None or len(values) == 0:
            raise ValueError(f"glTF cannot hold an array of shape {values.shape} and dtype {values.dtype}")
        stored = values.swapaxes(-1, -2) if kind.startswith("MAT") else values
        accessor: JsonObject = {
            "bufferView": self.add_view(np.ascontiguousarray(stored).tobytes(), target),
            "componentType": component,
            "count": len(values),
            "type": kind,
        }
        if normalised:
            accessor["normalized"] = True
        if bounds:
            accessor["min"] = np.atleast_1d(values.min(axis=0)).tolist()
            accessor["max"] = np.atleast_1d(values.max(axis=0)).tolist()
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def add_sparse(self, rows: np.ndarray, values: np.ndarray, count: int) -> int:
        """Store an array (count, 3) of float32 that is zero but in some rows, ascending, with min and max."""
        everything = np.concatenate([values, np.zeros((int(len(values) < count), 3), np.float32)])
        rows = rows.astype(np.uint16 if count <= 1 << 16 else np.uint32)
        indices = {
            "bufferView": self.add_view(rows.tobytes(), None),
            "componentType": 5123 if rows.itemsize == 2 else 5125,
        }
        stored = {"bufferView": self.add_view(np.ascontiguousarray(values).tobytes(), None)}
        self.accessors.append(
            {
                "componentType": 5126,
                "count": count,
                "type": "VEC3",
                "min": everything.min(axis=0).tolist(),
                "max": everything.max(axis=0).tolist(),
                "sparse": {"count": len(rows), "indices": indices, "values": stored},
            }
        )
        return len(self.accessors) - 1

    def add_image(self, data: bytes, name: str) -> int:
        """Store a PNG and return its index."""
        self.images.append({"name": name, "mimeType": "image/png", "bufferView": self.add_view(data, None)})
        return len(self.images) - 1

    def add_view(self, data: bytes, target: int | None) -> int:
        """Store bytes, four-byte aligned, and return their buffer view."""
        self.binary.extend(b"\0" * (-len(self.binary) % 4))
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self.views.append(view)
        self.binary.extend(data)
        return len(self.views) - 1

    def to_bytes(self, document: JsonObject) -> bytes:
        """The GLB of `document` (nodes, meshes ...) with what was added here."""
        document = document | {"accessors": self.accessors, "bufferViews": self.views, "images": self.images}
        document["buffers"] = [{"byteLength": len(self.binary)}] if self.binary else []
        # glTF has no empty lists
        document = {key: value for key, value in document.items() if value != []}
        # half a surrogate pair, as names of files may hold, is a question mark: strict readers refuse its JSON escape
        stated = json.dumps(document, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
        text = stated.encode("utf-8", "replace")
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        if self.binary:
            binary = bytes(self.binary) + b"\0" * (-len(self.binary) % 4)
            chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
