"""Skin weights of a baked avatar against the paper's rule, over real poses: stretched edges, surfaces in surfaces.

    python -m experiments.skin_rules AVATAR RUN MOTION... [--poses 200] [--level 1] [--json FILE]

The paper gives each vertex the weights of the nearest template vertex; the bake those of the closest point that
faces the same way and belongs to the same limb, the rest inpainted (bake/skin.py). Both are tried on the same
mesh. Prints a table in Markdown.
"""

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer
from scipy.spatial import KDTree

from avatar.gltf.avatar_file import Avatar, read_avatar
from avatar.motion.read import read_motion
from avatar.skeleton import skin_transforms
from avatar.skinning import SkinWeights, dense_weights, skin_points
from bake.skin import quantised
from bench.report.writer import markdown_table
from command.errors import AssetError
from command.progress import progress
from files.whole import write_json
from geometry.mesh import half_edges

# an edge longer or shorter than this many times its rest length counts as torn or crushed
STRETCH = 2.0
FINGERS = slice(22, 52)  # joints


class Posed(NamedTuple):
    """What one rule did in one pose."""

    # 999 of 1000 edges are longer or shorter than at rest by at most this factor
    stretch_p999: float
    stretched: float  # share of edges beyond STRETCH
    # pairs of triangles that cut through each other and do not touch at rest
    crossings: int
    hand_stretched: float  # the same share among the edges of fingers


def real_poses(paths: list[Path], count: int) -> Float[np.ndarray, "poses 52 3"]:
    """`count` poses spread evenly over all frames of some motions.

    Raises:
        AssetError: the motions have fewer frames than that.
    """
    motions = [read_motion(path) for path in paths]
    frames = sum(motion.frames for motion in motions)
    if frames < count:
        raise AssetError(f"{count} poses asked, the {len(paths)} motions have {frames} frames")
    chosen = np.unique(np.linspace(0, frames - 1, count).round().astype(int))
    poses, first = [], 0
    for motion in motions:
        for index in chosen[(chosen >= first) & (chosen < first + motion.frames)] - first:
            poses.append(motion.read(int(index), int(index) + 1).axis_angle[0])
        first += motion.frames
    return np.stack(poses)


def crossing_pairs(
    vertices: Float[np.ndarray, "vertices 3"], faces: Integer[np.ndarray, "faces 3"]
) -> Integer[np.ndarray, "pairs 2"]:
    """Pairs of triangles that cut through each other, those that share a vertex left out.

    Pairs are tried whose centres are nearer than the longest reach of all but a thousandth of the triangles.
    """
    corners = vertices[faces]
    centre = corners.mean(1)
    reach = np.linalg.norm(corners - centre[:, None], axis=2).max(1)
    near = KDTree(centre).query_pairs(2 * float(np.quantile(reach, 0.999)), output_type="ndarray")
    near = near[np.linalg.norm(centre[near[:, 0]] - centre[near[:, 1]], axis=1) < reach[near].sum(1)]
    shared = (faces[near[:, 0]][:, :, None] == faces[near[:, 1]][:, None]).any((1, 2))
    near = near[~shared]
    crossing = np.zeros(len(near), bool)
    for one, other in ((0, 1), (1, 0)):
        for corner in range(3):
            start = corners[near[:, one], corner]
            ahead = corners[near[:, one], (corner + 1) % 3] - start
            crossing |= _meets(start, ahead, corners[near[:, other]])
    return near[crossing]


def _meets(
    start: Float[np.ndarray, "n 3"], ahead: Float[np.ndarray, "n 3"], triangle: Float[np.ndarray, "n 3 3"]
) -> Bool[np.ndarray, "n"]:
    """Whether a segment passes through a triangle (Moeller and Trumbore 1997); not when it lies in its plane."""
    side1, side2 = triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0]
    across = np.cross(ahead, side2)
    determinant = (side1 * across).sum(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = start - triangle[:, 0]
        u = (offset * across).sum(1) / determinant
        turned = np.cross(offset, side1)
        v = (ahead * turned).sum(1) / determinant
        t = (side2 * turned).sum(1) / determinant
        return (np.abs(determinant) > 1e-16) & (u > 0) & (v > 0) & (u + v < 1) & (t > 0) & (t < 1)


def nearest_vertex_weights(
    points: Float[np.ndarray, "n 3"], vertices: Float[np.ndarray, "vertices 3"], skin: SkinWeights
) -> SkinWeights:
    """The paper's rule: weights of the nearest template vertex in the canonical pose."""
    _, nearest = KDTree(vertices).query(points)
    joints, weights = quantised(dense_weights(skin)[nearest])
    return SkinWeights(joints.astype(np.int64), weights / np.float32(255))


def compare_rules(
    avatar: Avatar,
    template: Float[np.ndarray, "vertices 3"],
    skin: SkinWeights,
    poses: Float[np.ndarray, "poses 52 3"],
    level: int,
) -> dict[str, Any]:
    """Both rules on a level of the avatar over all poses: means and worst pose of what `Posed` holds."""
    mesh = avatar.levels[level]
    points, first, merged = np.unique(mesh.positions, axis=0, return_index=True, return_inverse=True)
    points = points.astype(np.float64)
    faces = merged.reshape(-1)[mesh.faces.astype(np.int64)]
    ours = SkinWeights(mesh.joints[first].astype(np.int64), mesh.weights[first] / np.float32(255))
    rules = {"ours": ours, "nearest vertex": nearest_vertex_weights(points, template, skin)}
    edges = np.unique(np.sort(half_edges(faces), axis=1), axis=0)
    rest = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    edges, rest = edges[rest > 1e-4], rest[rest > 1e-4]
    finger = dense_weights(ours)[:, FINGERS].sum(1)[edges].min(1) > 0.5
    touching = {tuple(pair) for pair in crossing_pairs(points, faces).tolist()}
    found: dict[str, list[Posed]] = {name: [] for name in rules}
    for pose in progress(poses, "poses", len(poses)):
        transforms = skin_transforms(pose, avatar.joint_positions)
        for name, weights in rules.items():
            posed = skin_points(points, weights, transforms)
            ratio = np.linalg.norm(posed[edges[:, 0]] - posed[edges[:, 1]], axis=1) / rest
            factor = np.maximum(ratio, 1 / np.maximum(ratio, 1e-6))
            crossings = [p for p in crossing_pairs(posed, faces).tolist() if tuple(p) not in touching]
            found[name].append(
                Posed(
                    float(np.quantile(factor, 0.999)),
                    float((factor > STRETCH).mean()),
                    len(crossings),
                    float((factor[finger] > STRETCH).mean()) if finger.any() else 0.0,
                )
            )
    return {
        "poses": len(poses),
        "faces": len(faces),
        "rules": {
            name: {
                field: {
                    "mean": float(np.mean([getattr(p, field) for p in each])),
                    "worst": float(np.max([getattr(p, field) for p in each])),
                }
                for field in Posed._fields
            }
            for name, each in found.items()
        },
    }


def table(result: dict[str, Any]) -> str:
    """The comparison in Markdown."""
    head = ["rule", "999 of 1000 edges within", "edges beyond 2x", "finger edges beyond 2x", "crossing triangles"]
    shown = {"stretch_p999": "{:.2f}x", "stretched": "{:.3%}", "hand_stretched": "{:.3%}", "crossings": "{:.0f}"}
    rows = [
        [name, *(f"{how.format(one[key]['mean'])} ({how.format(one[key]['worst'])})" for key, how in shown.items())]
        for name, one in result["rules"].items()
    ]
    said = f"{result['poses']} poses, {result['faces']} triangles; mean over poses (worst pose)"
    return "\n".join([said, "", *markdown_table(head, rows)])


def main(argv: list[str] | None = None) -> int:
    """Command line; see the top of the file."""
    from capture.folder import read_subject

    parser = argparse.ArgumentParser(prog="python -m experiments.skin_rules", description=__doc__)
    parser.add_argument("avatar", type=Path, help="baked avatar, .glb")
    parser.add_argument("run", type=Path, help="the run it was baked from: its subject.npz is the template")
    parser.add_argument("motions", type=Path, nargs="+", help="motion files; poses are spread over their frames")
    parser.add_argument("--poses", type=int, default=200, help="how many (%(default)s)")
    parser.add_argument("--level", type=int, default=1, help="level of detail (%(default)s: 10k triangles)")
    parser.add_argument("--json", type=Path, help="write the numbers here")
    arguments = parser.parse_args(argv)
    avatar = read_avatar(arguments.avatar)
    if not 0 <= arguments.level < len(avatar.levels):
        parser.error(f"--level should be below {len(avatar.levels)}, is {arguments.level}")
    subject = read_subject(arguments.run / "subject.npz")
    poses = real_poses(arguments.motions, arguments.poses)
    result = compare_rules(avatar, subject.vertices, subject.skin, poses, arguments.level)
    if arguments.json:
        write_json(arguments.json, result)
    print(table(result))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
