"""Mutators that know how a file is built: values of JSON, members of archives, chunks of pictures, parts of a GLB.

Bytes flipped at random seldom pass a length or a checksum. These change what lies behind both and mend both. Each
takes a file that may be spoilt already and returns None where it is no longer what the mutator knows.
"""

import io
import json
import random
import re
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

# a change of bytes by the fuzzer itself
Plain = Callable[[bytes], bytes]
Mutator = Callable[[bytes, random.Random, Plain], bytes | None]

WRONG = [
    None, True, -1, 0, 1, 2, 52, 53, 255, 5126, 2**31, 2**40, 2**63, 10**30, 1e29, 1e-320, -0.5, "", "VEC3", "x\x1b[2J",
    [], {}, [0], [[]], [[[0]]], {"a": 1}, "9" * 400, "\ud800", float("nan"), float("inf"),
]  # fmt: skip
NUMBERS = [
    b"1e308", b"-1e308", b"5e-324", b"1e999", b"9" * 400, b"-1", b"0", b"nan", b"inf", b"65536", b"4294967296", b"-0",
    b"true", b'""', b"[]", b"0x7f", b"1_0",
]  # fmt: skip
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
# what makes a vector of the length of the others
MOST = 1 << 16


def places(value: Any) -> list[tuple]:
    """(holder, key) of what is in a value of JSON, the outermost first; at most some thousand."""
    found, holders = [], [value]
    for holder in holders:
        keys = holder if isinstance(holder, dict) else range(len(holder[:300])) if isinstance(holder, list) else ()
        for key in keys:
            found.append((holder, key))
            holders.append(holder[key])
        if len(found) > 4000:
            break
    return found


def _changed(document: object, rng: random.Random) -> object:
    """The document with one to three of its values others, gone, doubled or moved."""
    root = [document]
    for _ in range(rng.choice((1, 1, 2, 3))):
        holder, key = rng.choice(places(root))
        act = rng.random()
        if act < 0.35:
            holder[key] = rng.choice(WRONG)
        elif act < 0.5 and isinstance(holder[key], (int, float)) and not isinstance(holder[key], bool):
            holder[key] = rng.choice((holder[key] + 1, -holder[key], holder[key] * 1e6, holder[key] * 1.5))
        elif act < 0.65:
            other, place = rng.choice(places(root))
            holder[key] = json.loads(json.dumps(other[place]))
        elif act < 0.8 and holder is not root:
            del holder[key]
        elif isinstance(holder, list) and holder is not root and len(holder) < MOST:
            holder += holder[key : key + 1] * rng.choice((1, 2, 50))
        elif isinstance(holder, dict):
            holder[rng.choice(["", "a", str(key) + "s", "extras", "frames"])] = holder[key]
    return root[0]


def json_mutated(data: bytes, rng: random.Random, plain: Plain) -> bytes | None:
    try:
        return json.dumps(_changed(json.loads(data), rng)).encode()
    except (ValueError, RecursionError, TypeError, OverflowError):
        return None


def text_mutated(data: bytes, rng: random.Random, plain: Plain) -> bytes | None:
    """A number becomes another, a line or a word goes or comes twice."""
    numbers, act = list(NUMBER.finditer(data)), rng.random()
    if numbers and act < 0.5:
        found = rng.choice(numbers)
        return data[: found.start()] + rng.choice(NUMBERS) + data[found.end() :]
    cut = b"\n" if act < 0.8 else b" "
    pieces = data.split(cut)
    at = rng.randrange(len(pieces))
    pieces[at : at + 1] = rng.choice(([], [pieces[at]] * 2, [rng.choice(pieces)], [pieces[at], rng.choice(pieces)]))
    return cut.join(pieces)


def glb_mutated(data: bytes, rng: random.Random, plain: Plain) -> bytes | None:
    """The JSON or the bytes of a GLB changed, its lengths made right again."""
    try:
        size = struct.unpack_from("<I", data, 12)[0]
        document, binary = json.loads(data[20 : 20 + size]), data[28 + size :]
    except (struct.error, ValueError, RecursionError):
        return None
    if rng.random() < 0.7:
        text = json_mutated(json.dumps(document).encode(), rng, plain) or b"{}"
    else:
        text, binary = json.dumps(document).encode(), plain(binary)
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def zip_mutated(data: bytes, rng: random.Random, plain: Plain) -> bytes | None:
    """A member changed, renamed, doubled or left out; all checksums are right."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(info, archive.read(info)) for info in archive.infolist() if info.file_size < MOST * 16]
    except Exception:  # of an archive that is none any more
        return None
    if not members:
        return None
    at, act = rng.randrange(len(members)), rng.random()
    info, content = members[at]
    name = info.filename
    if act < 0.7:
        # the header of an array is what a reader goes by; 128 bytes
        head = rng.random() < 0.5
        content = plain(content[:128]) + content[128:] if head else content[:128] + plain(content[128:])
        content = text_mutated(content, rng, plain) or content if rng.random() < 0.3 else content
    elif act < 0.8:
        content = rng.choice(members)[1]
    elif act < 0.9:
        name = rng.choice([*(one.filename for one, _ in members), "../" + name, name + "x", ""]) or "a"
    out = io.BytesIO()
    kind = rng.choice((zipfile.ZIP_STORED, info.compress_type))
    with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(out, "w", kind) as archive:
        for place, (one, old) in enumerate(members):
            if place == at and act >= 0.95:
                continue
            archive.writestr(name if place == at else one.filename, content if place == at else old)
    return out.getvalue()


def png_mutated(data: bytes, rng: random.Random, plain: Plain) -> bytes | None:
    """A chunk of a PNG changed (pixels behind their compression), its length and checksum right."""
    chunks, at = [], 8
    while at + 12 <= len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        chunks.append([kind, data[at + 8 : at + 8 + size]])
        at += 12 + size
    if not chunks:
        return None
    chosen = rng.choice(chunks)
    if chosen[0] == b"IDAT" and rng.random() < 0.5:
        try:
            chosen[1] = zlib.compress(plain(zlib.decompress(chosen[1])))
        except zlib.error:
            chosen[1] = plain(chosen[1])
    else:
        chosen[1] = plain(chosen[1])
    if rng.random() < 0.2:
        chunks.insert(rng.randrange(len(chunks)), list(rng.choice(chunks)))
    whole = b"".join(struct.pack(">I4s", len(c), k) + c + struct.pack(">I", zlib.crc32(k + c)) for k, c in chunks)
    return data[:8] + whole


def riff_mutated(data: bytes, rng: random.Random, plain: Plain) -> bytes | None:
    """A chunk of a wave or AVI file changed, the lengths right."""
    if data[:4] != b"RIFF" or len(data) < 20:
        return None
    chunks, at = [], 12
    while at + 8 <= len(data):
        kind, size = struct.unpack_from("<4sI", data, at)
        chunks.append([kind, data[at + 8 : at + 8 + size]])
        at += 8 + size + size % 2
    chosen = rng.choice(chunks)
    chosen[1] = plain(chosen[1])
    whole = b"".join(struct.pack("<4sI", k, len(c)) + c + bytes(len(c) % 2) for k, c in chunks)
    return struct.pack("<4sI", b"RIFF", len(whole) + 4) + data[8:12] + whole


def boxes_mutated(data: bytes, rng: random.Random, plain: Plain) -> bytes | None:
    """A box of an MP4 changed, in the deepest that is met, the lengths of those around it right."""
    found, at = [], 0
    while at + 8 <= len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        if size < 8 or at + size > len(data):
            return None
        found.append([kind, data[at + 8 : at + size]])
        at += size
    if not found:
        return None
    chosen = (
        rng.choice([one for one in found if one[0] == b"moov"] or found) if rng.random() < 0.8 else rng.choice(found)
    )
    inner = boxes_mutated(chosen[1], rng, plain) if chosen[0].isalpha() and rng.random() < 0.9 else None
    chosen[1] = inner or plain(chosen[1])
    return b"".join(struct.pack(">I4s", len(content) + 8, kind) + content for kind, content in found)


def noise(rng: random.Random) -> Plain:
    """Bytes changed without a fuzzer: some others, a piece cut out, doubled, moved, or a number of a boundary."""

    def plain(data: bytes) -> bytes:
        changed = bytearray(data or b"\0")
        for _ in range(rng.choice((1, 1, 2, 4))):
            at, length, act = rng.randrange(len(changed)), rng.choice((1, 2, 4, 8, 64)), rng.random()
            if act < 0.4:
                changed[at] = rng.randrange(256)
            elif act < 0.7:
                size, order = rng.choice((1, 2, 4, 8)), rng.choice(("little", "big"))
                value = rng.choice((0, 1, 2**7, 2**15, 2**31, 2**32 - 1, 2**63, 2**64 - 1)) % 256**size
                changed[at : at + size] = value.to_bytes(size, order)
            elif act < 0.85 and len(changed) > length:
                del changed[at : at + length]
            else:
                other = rng.randrange(len(changed))
                changed[at:at] = changed[other : other + length]
            changed = changed or bytearray(1)
        return bytes(changed)

    return plain


# by what the file begins with
BEGINNINGS: list[tuple[bytes, Mutator]] = [
    (b"glTF", glb_mutated),
    (b"PK\x03\x04", zip_mutated),
    (b"\x89PNG", png_mutated),
    (b"RIFF", riff_mutated),
    (b"{", json_mutated),
    (b"[{", json_mutated),
]


def mutated(data: bytes, rng: random.Random, plain: Plain, *, text: bool) -> bytes:
    """A file changed as what it is; one time in four, and where it is nothing known, by its bytes alone."""
    known = next((mutate for start, mutate in BEGINNINGS if data.startswith(start)), None)
    if known is None and data[4:8] == b"ftyp":
        known = boxes_mutated
    chosen = rng.random()
    found = known(data, rng, plain) if known is not None and chosen < 0.7 else None
    if found is None and text and chosen < 0.8:
        found = text_mutated(data, rng, plain)
    return plain(data) if found is None else found
