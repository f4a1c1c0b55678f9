"""Paint the two built-in people again and write what `selfscan synth builtin` reads.

python -m experiments.builtin [FOLDER]     default: synth/data
"""

import sys
from pathlib import Path

from experiments.builtin import builtin_subject
from experiments.builtin.glb import write_subject

folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[2] / "synth" / "data"
folder.mkdir(parents=True, exist_ok=True)
for sex in ("male", "female"):
    path = folder / f"builtin_{sex}.glb"
    write_subject(path, builtin_subject(sex))
    print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")
