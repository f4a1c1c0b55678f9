"""The animation of a rigged glTF (.glb, .gltf, .vrm) or of a VRM animation (.vrma), as a motion of our skeleton.

A bone's rest frame in a glTF file may point anywhere, so its local rotations mean nothing alone. What counts is
its turn away from rest, in the world: with R(t) = world_from_bone at time t and R0 at rest,

    G(t) = R(t) R0^T        and for a rig like ours, local_k = G_parent^T G_k

Rest is the file's default nodes, or the pose that its skin is bound in where that lies nearer to a T-pose. A rig
whose joints are SMPL+H's in T-pose is read exactly; any other goes through avatar/motion/retarget.py, which keeps the
directions of the bones. Channels are sampled as glTF 2.0, appendix C has it: STEP, LINEAR (slerp), CUBICSPLINE.
Morph targets under ARKit's names move the face, and our joints of the eyes turn them.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from avatar.face import SHAPES
from avatar.face_names import shapes_called
from avatar.gaze import angles_of, gaze_of
from avatar.gltf.document import Gltf, read_gltf
from avatar.gltf.face import EYE_JOINTS
from avatar.gltf.humanoid import Naming, find_naming
from avatar.gltf.scene import NodePlace, node_parents, node_place, parents_first, read_skin
from avatar.motion.clip import Motion, RestSkeleton
from avatar.motion.retarget import retarget
from avatar.motion.rig import AnimatedRig, PlacedJoints
from avatar.motion.smplh_rig import LIMBS, is_smplh, off_t_pose, read_exactly
from avatar.rotation import (
    matrix_from_quaternion,
    nearest_rotation,
    normalised_quaternion,
    quaternion_from_matrix,
    slerp,
)
from avatar.skeleton import JOINT_NUMBERS as J
from avatar.skeleton import JOINTS
from command.errors import AssetError
from command.progress import plural
from files.input_file import JsonObject

PATHS = {"rotation": 4, "translation": 3}  # numbers a key
LONGEST = 1e6  # seconds
EARLY = 1e-4  # seconds by which a frame may come before the key that was meant for it
# bytes of all samplers together; accessors may share their bytes
MAX_KEY_BYTES = 1 << 28
# frames per second of keys that are taken for the file's own frames
SLOWEST, FASTEST = 10.0, 480.0
ASSUMED_RATE = 30.0
# degrees by which the bind pose must beat the default nodes
BIND_CLOSER = 5.0
MOST_TARGETS = 1000  # a mesh has at most
# instead of a joint's number in a rig: the mesh of the face, and the eyes
FACE, EYES = -1, (-2, -3)


@dataclass(frozen=True)
class Channel:
    """One animated property of one node."""

    times: Float[Array, "keys"]  # seconds, increasing
    # (keys, n), or (keys, 3, n) with tangents before and behind
    values: Array
    interpolation: str
    rotation: bool

    def at(self, time: Float[Array, "frames"]) -> Float[Array, "frames n"]:
        """Values at these times; before the first and after the last key the nearest one holds."""
        last, spline = len(self.times) - 1, self.interpolation == "CUBICSPLINE"
        # a step holds from its key on, whose float32 may lie behind the frame's own time
        early = EARLY if self.interpolation == "STEP" else 0.0
        k = np.clip(np.searchsorted(self.times, time + early, side="right") - 1, 0, last)
        values = self.values[:, 1] if spline else self.values
        if self.interpolation == "STEP" or last == 0:
            return values[k].astype(np.float64)
        k = np.minimum(k, last - 1)
        step = self.times[k + 1] - self.times[k]
        u = np.clip((time - self.times[k]) / step, 0, 1)
        a, b = values[k].astype(np.float64), values[k + 1].astype(np.float64)
        if spline:
            out, into = self.values[k, 2].astype(np.float64), self.values[k + 1, 0].astype(np.float64)
            u, step = u[:, None], step[:, None]
            u2, u3 = u * u, u * u * u
            leaving = (2 * u3 - 3 * u2 + 1) * a + step * (u3 - 2 * u2 + u) * out
            return leaving + (3 * u2 - 2 * u3) * b + step * (u3 - u2) * into
        if self.rotation:
            return slerp(a, b, u)
        return a + u[:, None] * (b - a)


@dataclass(frozen=True, kw_only=True)
class GltfRig(AnimatedRig):
    """The nodes that move a humanoid, called as in JOINTS, or "__..." where they lie between them."""

    # where they stand in their parents without a channel
    local: tuple[NodePlace, ...]
    channels: dict[tuple[int, str], Channel] = field(repr=False)
    start: float  # seconds
    # what each morph target of the face is of SHAPES
    targets: Float[Array, "targets 52"] = field(repr=False)
    # world_from_bone and places at rest
    rest: tuple[Float[Array, "nodes 3 3"], Float[Array, "nodes 3"]]

    @property
    def rest_positions(self) -> Float[Array, "nodes 3"]:
        return self.rest[1]

    def transforms(self, frames: Int[Array, "frames"]) -> PlacedJoints:
        """Turn away from rest and place of every node in the world."""
        world, places = self.world(self.start + frames / self.rate)
        return world @ np.swapaxes(self.rest[0], -1, -2), places

    def faces(self, start: int, stop: int) -> tuple[Float[Array, "frames 52"], Float[Array, "frames 2 2"]]:
        """Weights and gaze of frames, as `Motion.faces` gives them."""
        time = self.start + np.arange(start, stop) / self.rate
        weights = np.clip(self.channels[FACE, "weights"].at(time) @ self.targets, 0, 1)
        gaze = gaze_of(weights)
        for eye, number in enumerate(EYES):
            if (number, "rotation") in self.channels:
                ahead = matrix_from_quaternion(self._rotation(number, EYE_JOINTS[eye], time))[..., 2]
                gaze[:, eye] = [angles_of(one) for one in ahead]
        return weights, gaze

    def _rotation(self, number: int, name: str, time: Float[Array, "frames"]) -> Float[Array, "frames 4"]:
        """The quaternions of an animated joint."""
        try:
            return normalised_quaternion(self.channels[number, "rotation"].at(time))
        except ValueError:  # a spline between q and -q
            raise AssetError(f"{self.path}: animations[0]: rotation of {name} passes zero") from None

    def world(self, time: Float[Array, "frames"]) -> PlacedJoints:
        """world_from_node: rotations without scale, and places."""
        count = len(self.names)
        R, at = np.zeros((len(time), count, 3, 3)), np.zeros((len(time), count, 3))
        # with scale, which moves the children
        linear = np.zeros((len(time), count, 3, 3))
        for node, (parent, (place, own, scale)) in enumerate(zip(self.parents, self.local, strict=True)):
            if (node, "rotation") in self.channels:
                own = self._rotation(node, self.names[node], time)
            if (node, "translation") in self.channels:
                place = self.channels[node, "translation"].at(time)
            local = matrix_from_quaternion(own)
            if parent < 0:
                R[:, node], at[:, node], linear[:, node] = local, place, local * scale
            else:
                R[:, node] = R[:, parent] @ local
                at[:, node] = at[:, parent] + (linear[:, parent] @ place[..., None])[..., 0]
                linear[:, node] = linear[:, parent] @ (local * scale)
        return R, at


def read_gltf_motion(path: Path | str, skeleton: RestSkeleton | None = None) -> Motion:
    """Open the first animation of a rigged glTF; `skeleton` is the one that it is to move.

    Raises:
        AssetError: not a glTF we read, no animation of a humanoid's joints, channels that are not as they
            claim, a rig without hips, knees, ankles, shoulders, elbows or head by name.
    """
    gltf = read_gltf(path)
    notes: list[str] = []
    naming = find_naming(gltf.path, gltf.json)
    rig = _rig(gltf, naming, notes)
    unturned = np.abs(rig.rest[0][[name in J for name in rig.names]] - np.eye(3)).max(initial=0) < 1e-4
    faces = rig.faces if (FACE, "weights") in rig.channels else None
    if not (naming.name == "SMPL+H" and unturned and is_smplh(rig)):
        return replace(retarget(rig, skeleton, up_known=True, assumed=tuple(notes)), faces=faces)
    # avatar/gltf/animation.py leaves the height of the pelvis there
    extras = gltf.items("animations")[0].get("extras")
    height = extras.get("pelvisHeight") if isinstance(extras, dict) else None
    known = float(height) if isinstance(height, int | float) and 0.01 < height < 100 else None
    return replace(read_exactly(rig, notes, pelvis_height=known), faces=faces)


def _rig(gltf: Gltf, naming: Naming, notes: list[str]) -> GltfRig:
    """The part of the node tree that carries joints, its rest pose and its channels."""
    named = len(naming.nodes) >= 12
    joint_of = {node: joint for joint, node in naming.nodes.items()} if named else {}
    if named:
        notes.append(f"joints: {len(naming.nodes)} of {len(JOINTS)} found by {naming.name} names")
    parents = node_parents(gltf)
    needed: set[int] = set()
    nodes = gltf.items("nodes")
    for node in joint_of or [i for i, item in enumerate(nodes) if "mesh" not in item]:
        while node >= 0 and node not in needed:
            needed.add(int(node))
            node = int(parents[node])
    order = [node for node in parents_first(parents) if node in needed]
    place = {node: k for k, node in enumerate(order)}
    if not order:
        raise AssetError(f"{gltf.path}: nodes: expected a humanoid's joints, found none")
    local = tuple(_rest_place(gltf, node) for node in order)
    mesh, targets = _face(gltf)
    # elsewhere eyes may rest turned
    called = [str(node.get("name")) for node in nodes] if naming.name == "SMPL+H" else []
    moved = {called.index(eye): k for k, eye in zip(EYES, EYE_JOINTS, strict=True) if eye in called} | place
    wanted = {(node, path): (moved[node], width) for node in moved for path, width in PATHS.items()}
    channels = _channels(gltf, wanted | {(mesh, "weights"): (FACE, len(targets))}, notes)
    if (FACE, "weights") in channels:
        notes.append(f"face: {int(targets.any(0).sum())} of {len(SHAPES)} shapes by the names of morph targets")
    rate, start, frames = _timing(gltf, channels, notes)
    rig = GltfRig(
        path=gltf.path,
        names=tuple(joint_of.get(n, f"__{n}") if named else str(nodes[n].get("name", f"__{n}"))[:100] for n in order),
        parents=tuple(place[int(parents[n])] if parents[n] >= 0 else -1 for n in order),
        frames=frames, rate=rate, local=local, channels=channels, start=start, targets=targets,
        rest=(np.zeros((len(order), 3, 3)), np.zeros((len(order), 3))),
    )  # fmt: skip
    _check_scales(gltf, rig, order)
    R, at = replace(rig, channels={}).world(np.zeros(1))
    return replace(rig, rest=_rest(gltf, naming, order, R[0], at[0], notes))


def _check_scales(gltf: Gltf, rig: GltfRig, order: list[int]) -> None:
    """Scales and places multiply down the tree: refused before they leave what numbers hold."""
    total = np.ones(len(order))
    for k, (parent, (place, _, scale)) in enumerate(zip(rig.parents, rig.local, strict=True)):
        total[k] = scale.max() * (total[parent] if parent >= 0 else 1)
        if not (scale.min() > 1e-9 and total[k] < 1e9 and np.abs(place).max() < 1e9):
            raise gltf.error(f"nodes[{order[k]}] in the world", "of scale and place below 1e9", float(total[k]))


def _rest_place(gltf: Gltf, index: int) -> NodePlace:
    """A node at rest; a `matrix` is taken apart."""
    node, where = gltf.items("nodes")[index], f"nodes[{index}]"
    if "matrix" in node:
        matrix = gltf.numbers(node, "matrix", where, (4, 4)).T
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        if not (np.linalg.det(matrix[:3, :3]) > 0 and (scale > 0).all()):
            raise gltf.error(f"{where}.matrix", "one that does not mirror or flatten", node["matrix"])
        return NodePlace(matrix[:3, 3], quaternion_from_matrix(matrix[:3, :3] / scale), scale)
    place = node_place(gltf, index)
    if not (place.scale > 0).all():
        raise gltf.error(f"{where}.scale", "positive, a mirrored bone has no rotation", node["scale"])
    return place


def _face(gltf: Gltf) -> tuple[int, Float[Array, "targets 52"]]:
    """The node of the mesh with most of ARKit's shapes by the names of its targets, and what each target is of them."""
    best, found = -1, np.zeros((0, len(SHAPES)))
    for mesh, item in enumerate(gltf.items("meshes")):
        extras = item.get("extras")
        names = extras.get("targetNames") if isinstance(extras, dict) else None
        known = [shapes_called(str(name)) or {} for name in names[:MOST_TARGETS]] if isinstance(names, list) else []
        targets = np.zeros((len(known), len(SHAPES)))
        for row, shapes in zip(targets, known, strict=True):
            row[list(shapes)] = list(shapes.values())
        if targets.any(0).sum() > found.any(0).sum():
            best, found = mesh, targets
    return next((k for k, item in enumerate(gltf.items("nodes")) if item.get("mesh") == best), -1), found


def _channels(
    gltf: Gltf, wanted: dict[tuple[int, str], tuple[int, int]], notes: list[str]
) -> dict[tuple[int, str], Channel]:
    """The channels of the first animation, of nodes' properties by number in the rig and numbers a key."""
    animations = gltf.items("animations")
    if not animations:
        raise gltf.error("animations", "one at least: a file that stands still is no motion", animations)
    animation, where = animations[0], "animations[0]"
    title = str(animation.get("name", "unnamed"))[:60]
    others = [str(a.get("name", f"number {i}"))[:40] for i, a in enumerate(animations[1:6], 1)]
    rest = f", the first of {len(animations)} ({', '.join(others)} are not read)" if others else ""
    notes.append(f"animation: {title!r}{rest}")
    samplers = gltf.objects(animation, "samplers", where)
    entries = gltf.objects(animation, "channels", where)
    channels: dict[tuple[int, str], Channel] = {}
    # channels may share a sampler: its keys are held once
    held: dict[tuple[int, str], Channel] = {}
    scaled = False
    for i, entry in enumerate(entries):
        field_name, target = f"{where}.channels[{i}]", entry.get("target")
        if not isinstance(target, dict) or not isinstance(target.get("path"), str):
            raise gltf.error(f"{field_name}.target", "an object with a path", target)
        if "node" not in target:
            continue  # an extension's target
        node, path = gltf.index("nodes", target["node"], f"{field_name}.target.node"), target["path"]
        scaled |= (node, "rotation") in wanted and path == "scale"
        if (node, path) not in wanted:
            continue
        place, width = wanted[node, path]
        if (place, path) in channels:
            raise gltf.error(field_name, "the only one for its node and path", target)
        number = entry.get("sampler")
        if type(number) is not int or not 0 <= number < len(samplers):
            raise gltf.error(f"{field_name}.sampler", f"an index below {len(samplers)}", number)
        if (number, path) not in held:
            held[number, path] = _channel(gltf, samplers[number], path, width, f"{where}.samplers[{number}]")
            size = sum(one.times.nbytes + one.values.nbytes for one in held.values())
            if size > MAX_KEY_BYTES:
                raise gltf.error(f"{where}.samplers", f"keys of at most {MAX_KEY_BYTES} bytes together", size)
        channels[place, path] = held[number, path]
    if not channels:
        raise gltf.error(f"{where}.channels", "rotations of a humanoid's joints", f"{len(entries)} others")
    if scaled:
        notes.append("scale: animated scales are left out")
    return channels


def _channel(gltf: Gltf, sampler: JsonObject, path: str, width: int, where: str) -> Channel:
    interpolation = sampler.get("interpolation", "LINEAR")
    if interpolation not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise gltf.error(f"{where}.interpolation", "LINEAR, STEP or CUBICSPLINE", interpolation)
    times = gltf.accessor(sampler.get("input"), field=f"{where}.input")
    if times.ndim != 1 or times.dtype != np.float32:
        raise gltf.error(f"{where}.input", "floats, one a key", (times.shape, times.dtype.name))
    times = times.astype(np.float64)
    if times[0] < 0 or times[-1] > LONGEST or (np.diff(times) <= 0).any():
        raise gltf.error(f"{where}.input", f"increasing seconds from 0 to {LONGEST:g}", times)
    values = gltf.accessor(sampler.get("output"), as_float=True, field=f"{where}.output")
    each = 3 if interpolation == "CUBICSPLINE" else 1
    keys = each * len(times)
    if values.shape != ((keys * width,) if path == "weights" else (keys, width)):
        raise gltf.error(f"{where}.output", f"({keys}, {width}) for {path}", values.shape)
    values = values.reshape((len(times), 3, width) if each == 3 else (keys, width))
    if path == "rotation":
        length = np.linalg.norm((values[:, 1] if each == 3 else values).astype(np.float64), axis=-1)
        wrong = np.abs(length - 1) > 0.01
        if wrong.any():
            bad = int(np.argmax(wrong))
            raise gltf.error(f"{where}.output", "unit quaternions", f"length {length[bad]:.3g} at key {bad}")
    elif not (np.abs(values) < 1e6).all():
        raise gltf.error(f"{where}.output", "places within 1e6 units", float(np.abs(values).max()))
    return Channel(times, values, interpolation, path == "rotation")


def _timing(gltf: Gltf, channels: dict[tuple[int, str], Channel], notes: list[str]) -> tuple[float, float, int]:
    """Frame rate, time of the first frame, number of frames: the keys' own where they are evenly spaced."""
    start = min(float(c.times[0]) for c in channels.values())
    stop = max(float(c.times[-1]) for c in channels.values())
    times = max((c.times for c in channels.values()), key=len)
    rate, even = ASSUMED_RATE, False
    if len(times) > 1:
        own = (len(times) - 1) / float(times[-1] - times[0])
        even = SLOWEST <= own <= FASTEST and bool((np.abs(np.diff(times) * own - 1) < 0.02).all())
        if even:
            rate = float(round(own)) if abs(own - round(own)) < 0.02 else own
    frames = int(np.floor((stop - start) * rate + 0.01)) + 1
    keys = f"{plural(len(times), 'key')}, {'even' if even else 'uneven or far apart'}"
    notes.append(f"sampled at {rate:g} frames per second, {plural(frames, 'frame')} ({keys})")
    if start > 0:
        notes.append(f"starts at {start:.3f} s, its first key")
    return rate, start, frames


def _rest(
    gltf: Gltf, naming: Naming, order: list[int], R: Array, at: Array, notes: list[str]
) -> tuple[Float[Array, "nodes 3 3"], Float[Array, "nodes 3"]]:
    """The rest pose: default nodes, or the bind pose of a skin that holds the limbs and is nearer to a T-pose."""
    place = {joint: order.index(node) for joint, node in naming.nodes.items() if node in order}
    if not all(joint in place for joint in LIMBS) or naming.name.startswith("VRM"):
        # VRM rests in T-pose by its specification
        return R, at
    best, head, hip = off_t_pose(at, place), place["head"], place["left_hip"]
    for number, described in enumerate(gltf.items("skins")[:64]):
        skin, where = read_skin(gltf, number), f"skins[{number}].inverseBindMatrices"
        if "inverseBindMatrices" not in described or not all(naming.nodes[joint] in skin.nodes for joint in LIMBS):
            continue
        frames = {}
        for node, joint_from_mesh in zip(skin.nodes, skin.joint_from_mesh, strict=True):
            if node in order:
                if not np.linalg.det(joint_from_mesh[:3, :3]) > 0:
                    raise gltf.error(where, "of bones not mirrored", node)
                if not 1e-12 < np.linalg.det(joint_from_mesh) < 1e12:
                    raise gltf.error(where, "of bones that are neither flat nor vast", node)
                frames[order.index(node)] = np.linalg.inv(joint_from_mesh)
        # the mesh's own units against the world's: found by the distance of the hips to the head
        mine = np.linalg.norm(frames[head][:3, 3] - frames[hip][:3, 3])
        if not mine > 0:
            continue
        unit = np.linalg.norm(at[head] - at[hip]) / mine
        bound_R, bound_at = R.copy(), at.copy()
        for k, frame in frames.items():
            bound_R[k] = nearest_rotation(frame[:3, :3])
            bound_at[k] = frame[:3, 3] * unit
        off = off_t_pose(bound_at, place)
        if off < best - BIND_CLOSER:
            notes.append(f"rest pose: the skin's bind pose ({off:.0f} degrees off a T-pose, the nodes {best:.0f})")
            return bound_R, bound_at
    return R, at
