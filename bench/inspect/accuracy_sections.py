"""Sections on accuracy: distance to the field, and what the file says of itself."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Level
from bake.promises import baked_facts, recorded_loss
from bench.inspect.colors import DIVERGING, Ramp
from bench.inspect.inspection import Inspector
from bench.inspect.page import PageSection, flattened, picture
from geometry.mesh import face_areas

FIELD_MEAN = 0.5  # millimetres
MOST_BYTES = 12e6
PAPER_DB = 40.0
FIELD = Ramp(-2.0, 2.0, " mm", DIVERGING)


def field_distance(inspector: Inspector) -> PageSection | None:
    """Mesh against the field of the run."""
    if inspector.from_field is None:
        return None
    signed, level = inspector.from_field, inspector.level
    area = face_areas(level.positions, level.faces)
    mean = float((np.abs(signed) * area).sum() / area.sum())
    inspector.facts["field_to_mesh_mm"] = {"mean_of_worst": mean, "max": float(np.abs(signed).max())}
    what = "triangles from the field's surface, mean of each one's farthest of four points"
    inspector.check(what, f"{mean:.3f} mm", f"at most {FIELD_MEAN:g} mm", mean <= FIELD_MEAN)
    image = inspector.draw(FIELD.colors(signed))
    shown = picture("field", image, f"signed distance, millimetres, largest {np.abs(signed).max():.2f}")
    return PageSection("field", [shown], FIELD.legend())


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
