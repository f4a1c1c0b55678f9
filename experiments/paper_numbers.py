"""The numbers of the paper's tables: TotalSelfScan (Dong et al. 2022) on SynTotalHuman, tables 1 to 4.

Distances in cm, PSNR in dB. Rows of other methods are quoted until those are built here.
"""

REGIONS = ("head", "hands", "total")
GEOMETRY = ("p2s_cm", "chamfer_cm")
IMAGE = ("psnr_db", "ssim", "lpips")

Scores = dict[str, dict[str, float]]  # region, then metric


def _row(names: tuple[str, ...], *numbers: float) -> Scores:
    """Numbers in the order of the paper's columns: head, hands, total, each with `names`."""
    width = len(names)
    assert len(numbers) == width * len(REGIONS)
    return {region: dict(zip(names, numbers[i * width : (i + 1) * width])) for i, region in enumerate(REGIONS)}


QUOTED_GEOMETRY = {  # table 1
    "NeuralBody": _row(GEOMETRY, 1.55, 1.46, 1.29, 1.19, 2.16, 1.98),
    "AniNeRF": _row(GEOMETRY, 1.80, 1.69, 1.12, 1.00, 2.55, 2.21),
    "AniSDF": _row(GEOMETRY, 0.76, 0.91, 0.79, 0.75, 1.90, 1.97),
}
QUOTED_IMAGE = {  # table 2
    "NeuralBody": _row(IMAGE, 18.94, 0.914, 0.184, 18.51, 0.893, 0.240, 19.97, 0.855, 0.239),
    "AniNeRF": _row(IMAGE, 20.92, 0.928, 0.153, 20.60, 0.907, 0.179, 23.71, 0.889, 0.185),
    "AniSDF": _row(IMAGE, 21.91, 0.934, 0.104, 21.31, 0.930, 0.111, 25.57, 0.916, 0.129),
}
PAPER_GEOMETRY = {  # tables 1 and 3
    "ours": _row(GEOMETRY, 0.59, 0.82, 0.55, 0.52, 1.84, 1.89),
    "single": _row(GEOMETRY, 1.03, 1.26, 1.25, 1.22, 1.95, 1.97),
}
PAPER_IMAGE = {  # tables 2 and 4
    "ours": _row(IMAGE, 22.23, 0.934, 0.084, 22.49, 0.941, 0.076, 26.15, 0.921, 0.114),
    "single": _row(IMAGE, 20.38, 0.919, 0.120, 20.75, 0.927, 0.140, 25.19, 0.907, 0.144),
    "no_ray_transform": _row(IMAGE, 21.07, 0.933, 0.095, 22.14, 0.939, 0.085, 25.43, 0.916, 0.123),
}
