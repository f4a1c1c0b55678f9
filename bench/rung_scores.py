"""How exact the rungs of accuracy against time are: scores over the person's rectangle, and which are dominated."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import binom

from bench import metrics


def crop_of(mask: Bool[np.ndarray, "height width"]) -> tuple[slice, slice]:
    """Where pictures are compared: the rectangle of the person, a little wider."""
    where = metrics.rectangle(mask)
    height, width = mask.shape
    if where is None:
        return slice(0, height), slice(0, width)
    margin = 4
    rows, columns = where
    return (
        slice(max(0, rows.start - margin), min(height, rows.stop + margin)),
        slice(max(0, columns.start - margin), min(width, columns.stop + margin)),
    )


def compared(references: list, drawn: list, crops: list[tuple[slice, slice]]) -> dict[str, Any]:
    """PSNR of the pooled error, SSIM and FLIP over the rectangles; null with the reason for equal pictures."""
    error, ssim, flip = metrics.PooledError(), [], []
    for reference, picture, where in zip(references, drawn, crops, strict=True):
        error.add(reference[where], picture[where])
        ssim.append(metrics.ssim(reference[where], picture[where]))
        flip.append(metrics.flip(reference[where], picture[where]))
    scores = {"psnr_db": error.psnr(), "ssim": metrics.mean_score(ssim), "flip": metrics.mean_score(flip)}
    out: dict[str, Any] = {n: None if s.value is None else round(s.value, 4) for n, s in scores.items()}
    reasons = {n: s.reason for n, s in scores.items() if s.value is None}
    return out | ({"reasons": reasons} if reasons else {})


def row_of(name: str, ms: Float[np.ndarray, "n"], size: int) -> dict[str, Any]:
    median, tail = float(np.median(ms)), float(np.percentile(ms, 95))
    interval = [round(edge, 3) for edge in median_interval(ms)]
    return {
        "name": name,
        "ms_median": round(median, 3),
        "ms_interval": interval,
        "ms_p95": round(tail, 3),
        "bytes": int(size),
    }


def median_interval(values: Float[np.ndarray, "n"]) -> tuple[float, float]:
    """Between which two of the values the median lies with 95 % confidence, whatever their distribution; all of them
    are too few under 6 values."""
    ordered = np.sort(values)
    outside = int(binom.ppf(0.025, len(ordered), 0.5)) if len(ordered) > 5 else 1
    return float(ordered[outside - 1]), float(ordered[len(ordered) - outside])


def mark_dominated(rows: list[dict[str, Any]]) -> None:
    """A rung is dominated when another is no slower and no less exact, and better in one of the two."""

    def exactness(row: dict[str, Any]) -> float:
        return float("inf") if row["psnr_db"] is None else float(row["psnr_db"])

    for row in rows:
        row["dominated"] = any(
            other["ms_median"] <= row["ms_median"]
            and exactness(other) >= exactness(row)
            and (other["ms_median"], -exactness(other)) != (row["ms_median"], -exactness(row))
            for other in rows
        )
