"""An avatar file with a motion inside: glTF animation of the 52 joint nodes, for any program that plays glTF.

Node rotations are SMPL rotations (docs/avatar-format.md), so every frame is one key: a unit quaternion for each
joint and the place of the pelvis in the world, between keys LINEAR (slerp, glTF 2.0 appendix C). q and -q are the
same rotation; each key has the sign nearer to the key before, since not every viewer takes the shorter arc.
A joint that never turns has one key. Helper joints, where the file has them, have keys of their own, bend joints also
of their places: what moves them in ours (avatar/helper_joints.py) moves them in any program. So do the eyes, and the
shapes of a face have their weights, where the file and the motion have a face.
"""

import json
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from avatar.baked_avatar import Avatar
from avatar.face import eye_turn
from avatar.gltf.avatar_file import avatar_gltf, read_avatar
from avatar.gltf.avatar_write import helper_joints
from avatar.gltf.scene import read_skin
from avatar.gltf.write import GltfBuilder
from avatar.motion.clip import Clip
from avatar.rotation import axis_angle_from_matrix, normalised_quaternion, quaternion_from_axis_angle
from avatar.skeleton import JOINTS
from command.errors import AssetError
from files.input_file import JsonObject
from files.whole import whole_file

# in the animation's extras: metres above the soles of the body that it fits
PELVIS_HEIGHT = "pelvisHeight"


def write_animated(path: Path | str, avatar_path: Path | str, clip: Clip, *, name: str = "motion") -> None:
    """Write the avatar file `avatar_path` with the clip as its one animation; whole or not at all.

    Everything else stays byte for byte, so the result is still an avatar file.

    Raises:
        AssetError: `avatar_path` is not an avatar file, or it has an animation.
        ValueError: no frames, numbers that are not finite, or so many frames that float32 seconds repeat.
    """
    avatar, gltf = read_avatar(avatar_path, levels=1), avatar_gltf(avatar_path)
    if len(gltf.buffers) != 1:
        raise gltf.error("buffers", "one, the file's own", len(gltf.buffers))
    if gltf.items("animations"):
        raise AssetError(f"{avatar_path}: holds a motion; export from the avatar that it was made of")
    document: JsonObject = json.loads(json.dumps(gltf.json))
    builder = _kept(document, bytes(gltf.buffers[0]))
    document["animations"] = [_animation(builder, read_skin(gltf, 0).nodes, clip, name, avatar)]
    data = builder.to_bytes(document)
    with whole_file(path) as file:
        file.write(data)


def rotation_keys(axis_angle: Float[Array, "frames n 3"]) -> Float32[Array, "frames n 4"]:
    """Unit quaternions, each with the sign nearer to the one a frame before; the first with w >= 0."""
    q = normalised_quaternion(quaternion_from_axis_angle(axis_angle))
    turned = (q[1:] * q[:-1]).sum(-1) < 0
    flips = np.cumsum(turned, axis=0) % 2 == 1
    first = q[0, :, 3] < 0
    q[0][first] *= -1
    q[1:][flips ^ first] *= -1
    return q.astype(np.float32)


def _animation(builder: GltfBuilder, nodes: tuple[int, ...], clip: Clip, name: str, avatar: Avatar) -> JsonObject:
    clip.check()
    turns, moved, helpers = clip.axis_angle, [], helper_joints(avatar)
    if helpers:
        helper_turns, at = helpers.local(clip.axis_angle)
        turns = np.concatenate([turns, helper_turns], axis=1)
        # bend joints also change their place
        first = len(helpers.twist.offsets)
        moved = [(nodes[52 + k], "translation", at[:, k].astype(np.float32)) for k in range(first, at.shape[1])]
    if avatar.eyes is not None:
        eyes, weights = _face_keys(clip)
        turns = np.concatenate([turns, eyes], axis=1)
        # the node of the mesh stands behind those of the 52 joints
        moved += [] if weights is None else [(len(JOINTS), "weights", weights)]
    rotations, places = rotation_keys(turns), clip.root.astype(np.float32)
    times = (np.arange(len(places)) / float(clip.rate)).astype(np.float32)
    if (np.diff(times) <= 0).any():
        raise ValueError(f"{clip.frames} frames at {clip.rate:g} per second are more than float32 seconds can separate")
    every = builder.add_accessor(times, bounds=True)
    once = builder.add_accessor(times[:1], bounds=True)
    channels, samplers = [], []
    for node, path, values in [
        (nodes[0], "translation", places),
        *((node, "rotation", np.ascontiguousarray(rotations[:, joint])) for joint, node in enumerate(nodes)),
        *moved,
    ]:
        # the place of the pelvis, the first, keeps all of them: how long the motion is
        still = bool(samplers) and bool((values == values[0]).all())
        kept = values[:1] if still else values
        output = builder.add_accessor(kept.reshape(-1) if path == "weights" else kept)
        samplers.append({"input": once if still else every, "output": output, "interpolation": "LINEAR"})
        channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
    height = {} if clip.pelvis_height is None else {"extras": {PELVIS_HEIGHT: float(clip.pelvis_height)}}
    return {"name": name, "channels": channels, "samplers": samplers, **height}


def _face_keys(clip: Clip) -> tuple[Float[Array, "frames 2 3"], Float32[Array, "frames 52"] | None]:
    """Turns of the eyes, axis-angle, and weights of the shapes; None: they rest."""
    if clip.face is None or clip.gaze is None:
        return np.zeros((clip.frames, 2, 3)), None
    turns = [eye_turn(yaw, pitch) for yaw, pitch in clip.gaze.reshape(-1, 2).tolist()]
    weights = np.clip(clip.face, 0, 1).astype(np.float32)
    return axis_angle_from_matrix(np.array(turns)).reshape(-1, 2, 3), weights


def _kept(document: JsonObject, binary: bytes) -> GltfBuilder:
    """A builder that holds what the file has; taken out of `document`, where to_bytes puts it back."""
    builder = GltfBuilder()
    builder.accessors, builder.views = document.pop("accessors", []), document.pop("bufferViews", [])
    builder.images, builder.binary = document.pop("images", []), bytearray(binary)
    document.pop("buffers", None)
    return builder
