"""Charts and their packing (xatlas), part by part, in a process of its own whose time is bounded.

Run as `python -m bake.atlas IN.npz OUT.npz` by `unwrap`: a pathological mesh can keep the unwrapper busy for
many minutes inside native code, and only a process can be stopped there.
"""

import resource
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Integer
from numpy import ndarray as Array

from command.errors import AssetError
from files.npz import read_npz
from geometry.decimate import MOST_FACES

# square metres of a chart at most, times its part's density squared: larger ones are squeezed, slow and hard to pack
CHART_AREA = 0.15
# share of the usual texels, below which a triangle counts as squeezed, if it has so much area in square metres
SQUEEZED, SEEN_AREA = 0.33, 1e-6
# rounds of packing at most: each gives a chart of their own to those that were squeezed
ROUNDS = 3


class Unwrapped(NamedTuple):
    """A mesh cut into charts: an atlas vertex is one vertex of the mesh in one chart."""

    # the vertex each atlas vertex copies
    source: Integer[Array, "corners"]
    uv: Float[Array, "corners 2"]  # [0, 1], v down as in glTF
    # atlas vertices; the order is the input's, part by part
    faces: Integer[Array, "faces 3"]
    face_part: Integer[Array, "faces"]
    charts: int
    utilisation: float  # share of the atlas that charts cover


def unwrap(
    vertices: Float[Array, "vertices 3"], faces: Integer[Array, "faces 3"], face_part: Integer[Array, "faces"],
    density: Float[Array, "parts"], *, size: int, padding: int, seconds: float = 120.0,
) -> Unwrapped:  # fmt: skip
    """Texture coordinates of a mesh in one square atlas.

    density multiplies a part's texels per metre. padding is the gutter between charts, in texels of `size`.

    Raises:
        AssetError: the unwrapper did not end within `seconds` of processor time, failed, or lost triangles.
    """
    if len(faces) > MOST_FACES:
        raise ValueError(f"{len(faces)} triangles to unwrap: at most {MOST_FACES}, decimate first")
    if not np.isfinite(vertices).all():
        raise ValueError("vertices to unwrap are not finite")
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder, "in.npz"), Path(folder, "out.npz")
        np.savez(given, vertices=vertices, faces=faces, part=face_part, density=density, size=size, padding=padding)
        try:
            done = subprocess.run(
                [sys.executable, "-m", "bake.atlas", str(given), str(found), str(int(np.ceil(seconds)))],
                # the wall clock, which on a busy machine says little of the mesh
                timeout=10 * seconds,
                capture_output=True,
                text=True,
                cwd=Path(__file__).parent.parent,
            )
            late = done.returncode == -signal.SIGXCPU
        except subprocess.TimeoutExpired:
            late = True
        if late:
            raise AssetError(
                f"atlas: unwrapping {len(faces)} triangles should end within {seconds:g} s of processor time and did "
                "not; the mesh is too broken to unwrap (see `selfscan inspect`), or ask for fewer --faces"
            )
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            raise AssetError(f"atlas: the unwrapper failed with status {done.returncode}: {last}")
        data = read_npz(found, "unwrapped triangles", Unwrapped._fields)
    if len(data["faces"]) != len(faces):
        raise AssetError(f"atlas: {len(faces)} triangles went in and {len(data['faces'])} came out")
    return Unwrapped(
        data["source"], data["uv"].astype(np.float64), data["faces"], data["face_part"], int(data["charts"]),
        float(data["utilisation"]),
    )  # fmt: skip


def pack(vertices: Array, faces: Array, face_part: Array, density: Array, size: int, padding: int) -> Unwrapped:
    """What `unwrap` runs in its process. A triangle that its chart squeezes together gets a chart beside it."""
    group, order = 2 * face_part, np.argsort(face_part, kind="stable")
    for _ in range(ROUNDS):
        packed = _pack_groups(vertices, faces, group, density, size, padding)
        corners = vertices[packed.source][packed.faces]
        narrow = order[squeezed(corners, size * packed.uv[packed.faces], density[packed.face_part])]
        if not len(narrow):
            break
        group[narrow] |= 1
    return packed


def squeezed(corners: Array, uv: Array, density: Array) -> Integer[Array, "squeezed"]:
    """Triangles that in one direction get less than SQUEEZED of the texels that most of their part's get, by number.

    corners: (faces, 3, 3) metres; uv: (faces, 3, 2) texels.
    """
    along, across = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.maximum(np.linalg.norm(along, axis=1), 1e-9)
    x, height = (along * across).sum(1) / length, np.linalg.norm(np.cross(along, across), axis=1) / length
    first = (uv[:, 1] - uv[:, 0]) / length[:, None]
    second = (uv[:, 2] - uv[:, 0] - x[:, None] * first) / np.maximum(height, 1e-9)[:, None]
    least = np.linalg.svd(np.stack([first, second], 2), compute_uv=False)[:, 1] / density
    return np.flatnonzero((least < SQUEEZED * np.median(least)) & (0.5 * length * height > SEEN_AREA))


def _pack_groups(vertices: Array, faces: Array, group: Array, density: Array, size: int, padding: int) -> Unwrapped:
    """One xatlas mesh per group of triangles, each of the part of half its number, scaled by the part's density."""
    import xatlas

    atlas, used = xatlas.Atlas(), []
    for number in np.unique(group):
        own = np.flatnonzero(group == number)
        kept, local = np.unique(faces[own], return_inverse=True)
        atlas.add_mesh(
            np.ascontiguousarray(vertices[kept] * density[number // 2], np.float32),
            np.ascontiguousarray(local.reshape(-1, 3), np.uint32),
        )
        used.append((own, kept))
    charting, options = xatlas.ChartOptions(), xatlas.PackOptions()
    charting.max_chart_area = CHART_AREA
    # the packer overshoots the size it is asked for by about a fifth: the gutter is asked in its texels
    options.resolution = int(size * 0.82)
    options.padding = padding
    options.bilinear = True
    options.create_image = options.rotate_charts = False
    atlas.generate(charting, options)
    if atlas.atlas_count > 1:
        raise RuntimeError(f"{atlas.atlas_count} atlases")
    pieces, start, charts = [], 0, 0
    for i, (own, kept) in enumerate(used):
        mapping, indices, coordinates = atlas[i]
        mapping, indices, coordinates = place_degenerate_faces(atlas, i, mapping, indices.astype(np.int64), coordinates)
        if len(indices) != len(own):
            raise RuntimeError(f"{len(own)} triangles in, {len(indices)} out")
        pieces.append((kept[mapping], coordinates, indices + start))
        start += len(mapping)
        charts += atlas.get_mesh_chart_count(i)
    source, uv, triangles = (np.concatenate(column) for column in zip(*pieces, strict=True))
    own = np.concatenate([own for own, _ in used])
    order = np.lexsort((own, group[own] // 2))
    return Unwrapped(source, uv, triangles[order], group[own][order] // 2, charts, float(atlas.utilization))


def place_degenerate_faces(atlas: Any, number: int, mapping: Array, indices: Array, uv: Array) -> tuple:
    """Texture coordinates for the triangles without area, which the unwrapper leaves in no chart, at (0, 0).

    All three corners get the place that one of them has in a chart: the triangle shows one color, and is not
    wide enough for more.
    """
    charted = np.zeros(len(indices), bool)
    for chart in range(atlas.get_mesh_chart_count(number)):
        charted[atlas.get_mesh_chart(number, chart).faces] = True
    orphans = np.flatnonzero(~charted)
    if len(orphans) == 0:
        return mapping, indices, uv
    known = np.unique(indices[charted])
    place = np.full(int(mapping.max()) + 1, -1)
    place[mapping[known][::-1]] = known[::-1]
    homes = place[mapping[indices[orphans]]]
    home = np.where(homes.max(1) >= 0, np.where(homes[:, 0] >= 0, homes[:, 0], homes.max(1)), known[0])
    added_uv = np.repeat(uv[home], 3, axis=0)
    added = len(mapping) + np.arange(3 * len(orphans)).reshape(-1, 3)
    indices = indices.copy()
    old = indices[orphans]
    indices[orphans] = added
    mapping, uv = np.concatenate([mapping, mapping[old].reshape(-1)]), np.concatenate([uv, added_uv])
    used, renumbered = np.unique(indices, return_inverse=True)
    return mapping[used], renumbered.reshape(-1, 3), uv[used]


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_CPU, (int(sys.argv[3]), int(sys.argv[3]) + 5))
    mesh = read_npz(sys.argv[1], "triangles", ("vertices", "faces", "part", "density", "size", "padding"))
    packed = pack(
        mesh["vertices"], mesh["faces"], mesh["part"], mesh["density"], int(mesh["size"]), int(mesh["padding"])
    )
    np.savez(sys.argv[2], **packed._asdict())
