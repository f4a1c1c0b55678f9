"""An avatar and its motion as the bytes of a page: what unpack.js reads.

Numbers become whole steps of their range: positions, texture coordinates and rotations 2^24, about what float32 holds
of them (with 2^16 vertices move by some 20 micrometres, a hundredth of a pixel, and 65 pixels of an outline flip: 44 dB
instead of 62 on the same rasteriser); directions and cones 2^16. Joints, skin weights and textures stay exact. Each
component lies by itself as the differences of neighbours (vertices are in drawing order, so neighbours are near), all
lowest bytes first, compressed by zlib.

    value[i] = offset + scale (sum of differences up to i, modulo 2^bits)     difference z: (z >> 1) ^ -(z & 1)

The base color is a lossless WebP: browsers decode it to these very bytes when asked to leave its colors alone. Features
are no image there: four values of which one would be an alpha channel, which decoders premultiply; they are planes of
bytes, each the difference to Paeth's guess from its neighbours (as in PNG).
"""

import io
import zlib
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8, UInt32
from PIL import Image

from avatar.baked_avatar import Avatar, Level
from avatar.face import Eye
from avatar.gaze import DOWN, UP, YAW
from avatar.motion.clip import Clip
from avatar.rotation import quaternion_from_axis_angle
from avatar.skeleton import PARENTS, joint_transforms, rigid_inverse
from files.input_file import JsonObject
from player.draw.face import FaceBlend
from player.draw.mesh import draw_order, interleaved
from player.draw.posing import Poser

# bytes a number: of what moves pixels, and of directions
FINE, COARSE = 3, 2
# a frame of motion has so many before it is compressed
MOTION_BYTES = FINE * (4 * 52 + 3)


@dataclass(frozen=True)
class Packed:
    """A part of a page: what unpack.js must know of it, and its bytes by name."""

    facts: JsonObject
    blobs: dict[str, bytes]

    @property
    def bytes(self) -> int:
        return sum(map(len, self.blobs.values()))


def packed_avatar(avatar: Avatar, *, faced: bool = False) -> Packed:
    """Skeleton and all levels of detail; `faced`: with what its face needs to move."""
    joints = avatar.joint_positions.astype(np.float64)
    inverse = rigid_inverse(joint_transforms(avatar.canonical_pose.astype(np.float64), joints))
    levels = [packed_level(avatar, number, faced=faced) for number in range(len(avatar.levels))]
    facts = {
        "name": avatar.name,
        "parents": PARENTS.tolist(),
        # each joint from its parent, pose 0
        "offsets": (joints - np.where(PARENTS[:, None] < 0, 0.0, joints[PARENTS])).round(7).tolist(),
        "jointFromCanonical": inverse[:, :3].reshape(52, 12).round(9).tolist(),
        "levels": [level.facts for level in levels],
    }
    return Packed(facts, {name: blob for level in levels for name, blob in level.blobs.items()})


def packed_level(avatar: Avatar, number: int, *, faced: bool = False) -> Packed:
    """Mesh and textures of one level of detail."""
    # pages pose the 52 joints alone
    level = replace(avatar.levels[number], twist=None)
    order, faces = draw_order(level.positions, level.faces)
    skin = interleaved(level)[order]
    named = f"level{number}"
    arrays: list[tuple[str, JsonObject, bytes]] = [
        _range("position", level.positions[order], FINE),
        _range("uv", level.uv[order], FINE),
        _range("view_mean", level.view_dir[order], COARSE),
        _halves("view_q", level.view_q[order]),
        _range("view_seen", level.view_seen[order][:, None], COARSE),
        _bytes("joints", skin["joints"]),
        _bytes("weights", skin["weights"]),
        ("faces", {"kind": "indices", "count": faces.size}, _differences(faces.reshape(-1, 1).astype(np.int64), 4)),
    ]
    color, face = io.BytesIO(), {}
    Image.fromarray(level.base_color).save(color, "WEBP", lossless=True, quality=60, method=4, exact=True)
    blobs = {f"{named}.color": color.getvalue()}
    if faced and level.face is not None and avatar.eyes:
        face["face"], blobs[f"{named}.face"], slots = packed_face(level, avatar.eyes)
        slots = slots[order].astype(np.int64)[:, None]
        arrays.insert(-1, ("face_slot", {"kind": "indices", "count": len(slots)}, _differences(slots, 4)))
    blobs[f"{named}.mesh"] = zlib.compress(b"".join(data for _, _, data in arrays), 9)
    facts: JsonObject = {
        "vertices": len(order),
        "triangles": len(faces),
        "arrays": [{"name": name, **how} for name, how, _ in arrays],
        "radii": Poser(avatar, level).radii.round(6).tolist(),
        "color": {"size": list(level.base_color.shape[1::-1])},
        "features": None if level.features is None else {"size": list(level.features.shape[1::-1])},
        **face,
    }
    if level.features is not None:
        blobs[f"{named}.features"] = zlib.compress(paeth(level.features), 9)
    return Packed(facts, blobs)


def packed_face(level: Level, eyes: tuple[Eye, Eye]) -> tuple[JsonObject, bytes, UInt32[np.ndarray, "vertices"]]:
    """What moves the face of one level: what face.js must know, the offsets of its shapes, the slot of each vertex."""
    blend, face = FaceBlend(level, eyes), level.face
    assert face is not None, "asked of levels with a face"
    _, how, data = _range("shapes", face.offsets.transpose(1, 0, 2).reshape(len(face.vertices), -1), COARSE)
    facts: JsonObject = {
        "moving": len(face.vertices),
        "rows": blend.rows,
        "shapes": how,
        "balls": [[slots.start, slots.stop - slots.start] for slots, _, _ in blend.balls],
        "lids": [(1 + lids).tolist() for lids, _, _ in blend.lids],
        "eyes": [{"center": eye.center.tolist(), "radius": eye.radius} for eye in eyes],
        "aside": [-YAW, YAW],
        "upwards": [-DOWN, UP],
    }
    return facts, zlib.compress(data, 9), blend.slots


def packed_motion(clip: Clip) -> Packed:
    """Rotations of the joints as unit quaternions xyzw, the pelvis' place, and what the face does where the clip says
    so: by component, then by frame."""
    q = quaternion_from_axis_angle(clip.axis_angle.astype(np.float64))
    # neighbours in time on the same half of the sphere: small differences, and what lies between them is between
    flips = np.where(np.einsum("fji,fji->fj", q[1:], q[:-1]) < 0, -1.0, 1.0)
    q[1:] *= np.cumprod(flips, axis=0)[:, :, None]
    turns, places = _range("turns", q.reshape(len(q), 208), FINE), _range("root", clip.root, FINE)
    facts: JsonObject = {"frames": len(q), "rate": float(clip.rate), "turns": turns[1], "root": places[1]}
    data = turns[2] + places[2]
    if clip.face is not None and clip.gaze is not None:
        _, facts["face"], rows = _range("face", np.concatenate([clip.face, clip.gaze.reshape(-1, 4)], axis=1), COARSE)
        data += rows
    return Packed(facts, {"motion": zlib.compress(data, 9)})


def paeth(image: UInt8[np.ndarray, "height width planes"]) -> bytes:
    """Planes, one after the other, as differences to Paeth's guess (PNG, section 9.4); zeros surround each."""
    planes = np.pad(np.moveaxis(image, 2, 0).astype(np.int16), ((0, 0), (1, 0), (1, 0)))
    left, above, corner = planes[:, 1:, :-1], planes[:, :-1, 1:], planes[:, :-1, :-1]
    guess = left + above - corner
    near = np.abs(guess - left), np.abs(guess - above), np.abs(guess - corner)
    found = np.where((near[0] <= near[1]) & (near[0] <= near[2]), left, np.where(near[1] <= near[2], above, corner))
    return (planes[:, 1:, 1:] - found).astype(np.uint8).tobytes()


def _range(name: str, values: Float[np.ndarray, "n components"], width: int) -> tuple[str, JsonObject, bytes]:
    """Steps of so many bytes over the range that the values take, a range for each component."""
    low, high = values.min(0).astype(np.float64), values.max(0).astype(np.float64)
    scale = (high - low) / (256**width - 1)
    steps = np.round((values - low) / np.where(scale > 0, scale, 1.0)).astype(np.int64)
    how = {"kind": "range", "bytes": width, "components": values.shape[1]}
    return name, how | {"offset": low.tolist(), "scale": scale.tolist()}, _differences(steps, width)


def _halves(name: str, values: Float[np.ndarray, "n components"]) -> tuple[str, JsonObject, bytes]:
    """Half floats, for sizes that a range of 16 bits cannot resolve. What is too large: cones too narrow to leave."""
    bits = np.clip(values, -65504, 65504).astype(np.float16).view(np.uint16).astype(np.int64)
    return name, {"kind": "half", "bytes": COARSE, "components": values.shape[1]}, _differences(bits, COARSE)


def _bytes(name: str, values: UInt8[np.ndarray, "n components"]) -> tuple[str, JsonObject, bytes]:
    return name, {"kind": "bytes", "components": values.shape[1]}, np.ascontiguousarray(values.T).tobytes()


def _differences(steps: Int[np.ndarray, "n components"], width: int) -> bytes:
    """Differences along the first axis, of so many bytes, component by component."""
    whole = 256**width
    # modulo the range, to the nearer side
    change = (np.diff(steps, axis=0, prepend=0) + whole // 2) % whole - whole // 2
    zigzag = ((change << 1) ^ (change >> 63)).T.reshape(-1)
    # all lowest bytes, then the next ones: what is small compresses
    return zigzag.astype("<u4").view(np.uint8).reshape(-1, 4).T[:width].tobytes()
