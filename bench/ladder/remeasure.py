"""What an avatar file says was lost in baking, measured again with the run it came from.

The field is drawn on the run's own surface, posed by the run's own weights: nothing that is compared was made by
the bake on both sides, so that wrong skin weights or a broken mesh in the file show as well.
"""

import numpy as np
from scipy.spatial import KDTree

from avatar.baked_avatar import Avatar, Level
from bake import measure
from bake.bake import field_surface, run_surface, score_json
from bake.field import numpy_field
from bake.level import rounded, size_facts
from bench.report.writer import Json
from capture.held_out import HeldOutView
from geometry.mesh import TriangleMesh
from train.run import BakeSource


def remeasured(avatar: Avatar, run: BakeSource, held_out: dict[str, list[HeldOutView]]) -> Json:
    """`said`: what the file holds; `found`: the same measured now; `on_held_out`: on pictures of the capture.

    A file whose textures are from the videos was compared with the field before it got them: what is found against
    the field is then how much they changed.
    """
    kept = baked_facts(avatar).get("template_kept")
    field = numpy_field(run.with_templates(kept) if kept and run.with_templates is not None else run.field)
    surface = field_surface(run, run_surface(run.surface, len(run.subject.joints)), field)
    said = recorded_facts(avatar)
    views = measure.test_views(surface.joints, said["against_field"].get("image", 512))
    found = {
        "against_field": score_json(measure.compare(avatar, surface, views)),
        "levels": [level_facts_again(level, surface, run) for level in avatar.levels],
    }
    # solved against the videos, or read from the field
    texture_from = "videos" if baked_facts(avatar).get("texture_from") == "videos" else "field"
    out: Json = {"texture_from": texture_from, "said": said, "found": found}
    pictures = [
        measure.ScoredView(
            f"{view.view} of {name.replace('_', ' ')} {view.pose_index}", view.axis_angle, view.root, view.camera, name
        )
        for name, views in held_out.items()
        for view in views
    ]
    if pictures:
        score = measure.compare(avatar, surface, pictures)
        worst = min(score.per_view, key=lambda name: score.per_view[name])
        out["on_held_out"] = {
            **score_json(score),
            "worst_db": rounded(score.per_view[worst]),
            "worst": worst,
            "pictures": len(pictures),
        }
    return out


def baked_facts(avatar: Avatar) -> Json:
    """What baking wrote into the file; empty where it did not."""
    baked = avatar.provenance.get("baked")
    return baked if isinstance(baked, dict) else {}


def recorded_facts(avatar: Avatar) -> Json:
    """The part of a bake's provenance that is measured again; empty where the file does not say."""
    baked = baked_facts(avatar)
    against, levels = baked.get("against_field"), baked.get("levels")
    return {
        "against_field": against if isinstance(against, dict) else {},
        "levels": [level for level in levels if isinstance(level, dict)] if isinstance(levels, list) else [],
    }


def level_facts_again(level: Level, surface: measure.FieldSurface, run: BakeSource) -> Json:
    """Distance of a level's triangles to the field, triangles and texel side by part."""
    mesh = TriangleMesh(level.positions.astype(np.float64), level.faces.astype(np.int64))
    away = measure.field_to_mesh(surface.distance, mesh)
    # that of the run's vertex nearest to each face's middle
    _, nearest = KDTree(surface.mesh.vertices).query(mesh.vertices[mesh.faces].mean(1))
    part = np.asarray(run.surface.part, np.int64)[nearest]
    height, width = level.base_color.shape[:2]
    sizes = size_facts(mesh, part, level.uv.astype(np.float64)[mesh.faces] * [width, height], part)
    return {"field_to_mesh_mm": {"mean": rounded(away.mean() * 1e3), "max": rounded(away.max() * 1e3)}, **sizes}
