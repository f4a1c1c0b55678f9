"""Scores of head, hands and the whole person as JSON, from pictures and surface distances; hands pool both."""

from typing import Any

from bench.picture_scores import ImageScores
from bench.posed_geometry import Distances


def regions_of(
    distances: dict[str, Distances], images: dict[str, ImageScores] | None = None
) -> dict[str, dict[str, Any]]:
    """{"head": M, "left_hand": M, "right_hand": M, "hands": M, "total": M}; hands pool left and right.

    "eyes" stands beside the head where pictures of them were scored, "skin_beside_hair" last where there is hair.
    """
    distances, images = dict(distances), dict(images or {})
    if {"left_hand", "right_hand"} <= distances.keys():
        distances["hands"] = distances["left_hand"].merged(distances["right_hand"])
    if {"left_hand", "right_hand"} <= images.keys():
        images["hands"] = images["left_hand"].merged(images["right_hand"])
    regions = ["head", *(("eyes",) if "eyes" in images else ()), "left_hand", "right_hand", "hands", "total"]
    if "skin_beside_hair" in distances and distances["skin_beside_hair"].to_truth:
        regions.append("skin_beside_hair")
    return {region: region_scores(distances.get(region), images.get(region)) for region in regions}


def without_eyes(reason: str) -> dict[str, Any]:
    """M of an eye region that cannot be scored."""
    keys = ("psnr_db", "psnr_mask_db", "ssim", "flip", "lpips")
    return {**dict.fromkeys(keys), "reasons": dict.fromkeys(keys, reason)}


def region_scores(distances: Distances | None, images: ImageScores | None) -> dict[str, Any]:
    """M: {"p2s_cm", "chamfer_cm", "psnr_db", "ssim", "flip", "lpips"}, null with its reason in "reasons"."""
    out: dict[str, Any] = {}
    reasons: dict[str, str] = {}
    if distances is not None:
        whole = distances.scores()
        out |= {"p2s_cm": rounded(whole.p2s), "chamfer_cm": rounded(whole.chamfer)}
        if whole.p2s is None:
            reasons["p2s_cm"] = reasons["chamfer_cm"] = "the reconstruction has no surface in this region"
        for name, hair in (("hair", True), ("without_hair", False)):
            apart = distances.scores(hair=hair)
            if distances.to_truth and any(h.any() for h in distances.hair_to_surface):
                out[name] = {"p2s_cm": rounded(apart.p2s), "chamfer_cm": rounded(apart.chamfer)}
    if images is not None:
        out["pictures"] = len(images.ssim)
        for name, score in images.scores().items():
            out[name] = rounded(score.value)
            if score.value is None:
                reasons[name] = score.reason
    if reasons:
        out["reasons"] = reasons
    return out


def rounded(value: float | None, digits: int = 4) -> float | None:
    return None if value is None else round(value, digits)


def gather(one: dict[str, Distances], into: dict[str, Distances]) -> None:
    """Add the distances of one pose."""
    for region, distances in one.items():
        into[region] = into[region].merged(distances)
