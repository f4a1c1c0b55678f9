"""The systems that the paper compares with, trained here on the same captures and judged by the same eval.

`python -m experiments.rivals` trains and judges them. A file a system: single.py (the paper's own ablation), anisdf.py,
aninerf.py, neuralbody.py; each says which equations it has and what was left out. The first two are fields of train/
with other settings; the last two have a density instead of a surface and share density.py (their rays, volume rendering
and meshes) and learning.py (their loop).
"""
