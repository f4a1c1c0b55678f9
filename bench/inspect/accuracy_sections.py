"""Sections on accuracy: distance to the field and to the truth, and what the file says of itself."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar, Level
from avatar.skeleton import PARTS, skin_transforms
from avatar.skinning import skin_points
from bake.promises import baked_facts, recorded_loss
from bench.inspect import mesh_facts
from bench.inspect.colors import DIVERGING, Ramp
from bench.inspect.inspection import Inspector
from bench.inspect.page import PageSection, flattened, picture
from bench.score.surface_distance import check_same_unit
from bench.score.true_mesh import read_true_mesh
from command.errors import AssetError
from geometry.closest import closest_points, triangle_index

FIELD_MEAN = 0.5  # millimetres
MOST_BYTES = 12e6
PAPER_DB = 40.0
FIELD, TRUTH = Ramp(-2.0, 2.0, " mm", DIVERGING), Ramp(0.0, 10.0, " mm")


def field_distance(inspector: Inspector) -> PageSection | None:
    """Mesh against the field of the run."""
    if inspector.measured.field is None:
        return None
    signed, area = inspector.measured.field, mesh_facts.areas(inspector.level)
    mean = float((np.abs(signed) * area).sum() / area.sum())
    inspector.facts["field_to_mesh_mm"] = {"mean_of_worst": mean, "max": float(np.abs(signed).max())}
    what = "triangles from the field's surface, mean of each one's farthest of four points"
    inspector.check(what, f"{mean:.3f} mm", f"at most {FIELD_MEAN:g} mm", mean <= FIELD_MEAN)
    image = inspector.draw(FIELD.colors(signed))
    shown = picture("field", image, f"signed distance, millimetres, largest {np.abs(signed).max():.2f}")
    return PageSection("field", [shown], FIELD.legend())


def truth_distance(inspector: Inspector) -> PageSection | None:
    """Mesh against the true surface of the capture."""
    if inspector.measured.truth is None:
        return None
    millimetres = inspector.measured.truth
    area, part = mesh_facts.areas(inspector.level), mesh_facts.face_parts(inspector.level)
    each = millimetres[inspector.level.faces].mean(1)
    rows, found = [("part", "mean, mm", "95 of 100 below, mm")], {}
    for name, chosen in [("total", part >= 0), *((name, part == k) for k, name in enumerate(PARTS))]:
        if not (area * chosen).sum() > 0:
            continue
        mean = float((each * area * chosen).sum() / (area * chosen).sum())
        p95 = float(np.quantile(each[chosen], 0.95))
        found[name] = {"p2s_mm": mean, "p95_mm": p95}
        rows.append((name, f"{mean:.2f}", f"{p95:.2f}"))
    inspector.facts["truth"] = found
    total = f"{found['total']['p2s_mm'] / 10:.3f} cm"
    inspector.check("distance to the true surface in T-pose (P2S)", total, "as small as can be", None)
    image = inspector.draw(TRUTH.colors(millimetres))
    return PageSection("truth", [picture("truth", image, "P2S, millimetres")], TRUTH.legend(), rows)


def provenance(inspector: Inspector) -> list[PageSection]:
    """What baking and training wrote into the file."""
    baked, paper = baked_facts(inspector.avatar), recorded_loss(inspector.avatar).get("paper_db")
    if isinstance(paper, int | float):
        what = "baked paper mode against the paper field, as baking measured it"
        inspector.check(what, f"{paper:.2f} dB", f"at least {PAPER_DB:g} dB", paper >= PAPER_DB)
    size = inspector.path.stat().st_size
    inspector.check("size of the file", f"{size / 1e6:.2f} MB", f"at most {MOST_BYTES / 1e6:g} MB", size <= MOST_BYTES)
    inspector.facts["bytes"] = size
    rest = {key: value for key, value in inspector.avatar.provenance.items() if key != "baked"}
    written = [("what", "value"), *flattened(baked)] if baked else []
    comes = [("what", "value"), *flattened(rest)]
    return [PageSection("accuracy", rows=written), PageSection("provenance", rows=comes)]


def from_run(level: Level, run: Path) -> Float[np.ndarray, "faces"]:
    """`from_field` with the field of a run folder."""
    # torch: imported before anything draws
    from bake.field import numpy_field
    from train.run import read_run

    return from_field(level, numpy_field(read_run(run).field.functions()).distance)


def from_field(level: Level, distance: Callable[[np.ndarray], np.ndarray]) -> Float[np.ndarray, "faces"]:
    """Signed distance of a field, millimetres, on each triangle: of centre and corners the farthest.

    Positive where the triangle lies outside of the field's surface.
    """
    points = level.positions.astype(np.float64)
    corners = np.asarray(distance(points), np.float64)[level.faces]
    middle = np.asarray(distance(points[level.faces].mean(1)), np.float64)
    every = np.concatenate([corners, middle[:, None]], axis=1)
    farthest = np.abs(every).argmax(1)
    return 1e3 * every[np.arange(len(every)), farthest]


def from_truth(avatar: Avatar, level: Level, capture: Path) -> Float[np.ndarray, "vertices"]:
    """P2S at each vertex, millimetres: to the visible surface of the subject, both in pose 0."""
    truth = read_true_mesh(capture)
    joints, rest = avatar.joint_positions.astype(np.float64), avatar.canonical_pose.astype(np.float64)
    transforms = skin_transforms(np.zeros((52, 3)), joints, truth.joints[0], rest=rest)
    points = skin_points(level.positions.astype(np.float64), level.skin, transforms)
    try:
        check_same_unit(truth.vertices, points)
    except ValueError as error:
        raise AssetError(f"{capture}: {error}") from None
    index = triangle_index(truth.vertices, truth.faces[truth.visible])
    return 1e3 * closest_points(points, index).distance
