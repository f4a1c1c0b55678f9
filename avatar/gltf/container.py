"""The bytes of a glTF file: GLB chunks, JSON text, data URIs and the files beside it; all of bounded size."""

import base64
import binascii
import struct
from pathlib import Path
from urllib.parse import unquote

from command.errors import AssetError
from files.input_file import read_bytes, short

WHAT = "a glTF file"
# a file, and all buffers together; text and base64 are held a few times over
MAX_BYTES = 1 << 28


def glb_chunks(path: Path, data: bytes) -> tuple[memoryview, memoryview | None]:
    """The JSON chunk and the binary chunk of a GLB."""
    if len(data) < 20:
        raise AssetError(f"{path}: GLB should be at least 20 bytes, is {len(data)}: truncated")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise AssetError(f"{path}: GLB version should be 2, is {version}")
    if length != len(data):
        raise AssetError(f"{path}: GLB length should be {length} as its header says, is {len(data)} bytes")
    chunks, at = [], 12
    while at < length:
        if at + 8 > length:
            raise AssetError(f"{path}: GLB chunk header at byte {at} should be 8 bytes, is {length - at}")
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > length:
            raise AssetError(f"{path}: GLB chunk at byte {at} should end within {length}, ends at {at + 8 + size}")
        chunks.append((kind, memoryview(data)[at + 8 : at + 8 + size]))
        at += 8 + size
    if chunks[0][0] != 0x4E4F534A:
        raise AssetError(f"{path}: first GLB chunk should be JSON (0x4E4F534A), is {chunks[0][0]:#x}")
    has_binary = len(chunks) > 1 and chunks[1][0] == 0x004E4942
    return chunks[0][1], chunks[1][1] if has_binary else None


def uri_bytes(path: Path, uri: object, field: str) -> bytes:
    """What a URI holds: a base64 data URI, or a file in the folder of the .gltf and nowhere else."""
    if not isinstance(uri, str):
        raise AssetError(f"{path}: {field} should be a text, is {short(uri)}")
    if uri.startswith("data:"):
        head, comma, body = uri.partition(",")
        if not comma or not head.endswith(";base64"):
            raise AssetError(f"{path}: {field} should be a base64 data URI, is {short(head)}")
        try:
            return base64.b64decode(body, validate=True)
        except (binascii.Error, ValueError) as error:
            raise AssetError(f"{path}: {field} should be base64, is not: {error}") from None
    name = unquote(uri)
    if ":" in name or "\\" in name or "\0" in name:
        raise AssetError(f"{path}: {field} should be a relative file name, is {short(uri)}")
    folder = path.parent.resolve()
    target = (folder / name).resolve()
    if not target.is_relative_to(folder):
        raise AssetError(f"{path}: {field} should stay inside the file's folder, is {short(uri)}")
    return read_bytes(target, WHAT, most=MAX_BYTES)
