"""`selfscan make` whose stages are tiny: `python -m tiny_commands make ...` runs each of them through this file too."""

import sys
from dataclasses import replace

from command.stages import command
from selfscan import make
from selfscan.__main__ import main


def run(words: list[str]) -> int:
    if words[0] == "make":
        make.command = lambda *stage: command("tiny_commands", *stage[1:])
    elif words[0] == "train":
        from train.preset import PRESETS, PREVIEW

        coarse = tuple(replace(part, cell=0.006, spacing=0.006) for part in PREVIEW.parts)
        PRESETS["preview"] = replace(PREVIEW, parts=coarse, surface_cells=(0.03, 0.015, 0.008))
    elif words[0] == "synth":
        # the body's film alone
        from synth.raw import film

        film.PARTS = ("body",)
    elif words[0] == "bake":
        words = [*words, "--faces", "3000", "--texture", "256"]
    return main(words)


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
