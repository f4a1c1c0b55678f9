"""Scores of head, hands and the whole person as JSON, from pictures and surface distances; hands pool both."""

from bench.report.writer import Json
from bench.score.metrics import METRICS, PICTURE_METRICS, ImageScores
from bench.score.posed_geometry import Distances, PoseDistances, pooled_distance
from bench.score.surface_distance import SurfaceDistance


def regions_of(distances: Distances, images: dict[str, ImageScores] | None = None) -> dict[str, Json]:
    """{"head": M, "left_hand": M, "right_hand": M, "hands": M, "total": M}; hands pool left and right.

    "eyes" stands beside the head where pictures of them were scored, "skin_beside_hair" last where there is hair.
    """
    distances, images = dict(distances), dict(images or {})
    if {"left_hand", "right_hand"} <= distances.keys():
        distances["hands"] = distances["left_hand"] + distances["right_hand"]
    if {"left_hand", "right_hand"} <= images.keys():
        images["hands"] = images["left_hand"].merged(images["right_hand"])
    regions = ["head", *(("eyes",) if "eyes" in images else ()), "left_hand", "right_hand", "hands", "total"]
    if distances.get("skin_beside_hair"):
        regions.append("skin_beside_hair")
    return {region: region_scores(distances.get(region), images.get(region)) for region in regions}


def without_eyes(reason: str) -> Json:
    """M of an eye region that cannot be scored."""
    keys = [metric.key for metric in PICTURE_METRICS]
    return {**dict.fromkeys(keys), "reasons": dict.fromkeys(keys, reason)}


def region_scores(distances: list[PoseDistances] | None, images: ImageScores | None) -> Json:
    """M: one number for each of METRICS, {"p2s_cm", "back_cm", ..., "lpips"}, null with its reason in "reasons"."""
    out: Json = {}
    reasons: dict[str, str] = {}
    if distances is not None:
        out |= surface_scores(pooled_distance(distances))
        if out["p2s_cm"] is None:
            reasons |= dict.fromkeys(out, "the reconstruction has no surface in this region")
        for name, hair in (("hair", True), ("without_hair", False)):
            if any(pose.hair_to_surface.any() for pose in distances):
                out[name] = surface_scores(pooled_distance(distances, hair))
    if images is not None:
        out["pictures"] = images.pictures
        for name, score in images.scores().items():
            out[name] = rounded(score.value)
            if score.value is None:
                reasons[name] = score.reason
    if reasons:
        out["reasons"] = reasons
    return out


def surface_scores(distance: SurfaceDistance) -> dict[str, float | None]:
    return {m.key: rounded(m.of_surfaces(distance)) for m in METRICS if m.of_surfaces is not None}


def rounded(value: float | None, digits: int = 4) -> float | None:
    return None if value is None else round(value, digits)
