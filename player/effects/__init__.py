"""What a frame can show, one effect a file: what it asks for, what it owns, when it can show, how it draws.

    settings   a frozen dataclass (`Outline`): its fields are keys of the scene, checked, documented and shown in the
               window from there; `stage` says where in a frame it draws
    asks for   `settings.passes(draft)` declares programs, buffers and images to the draft (plan.py) and gives
               its passes; what it declares exists as long as it is asked for, and not before
    owns       typed handles of those objects, fields of its passes; state that is no GL object by `draft.keep`
    can show   `decide(drawing)`: runs, kept or skipped in this frame, with the reason
    draws      `draw(drawing)`; `warm(warming)` draws next to nothing once, while the driver compiles

A new effect is its file here, its shader, and its line in `Effects` (player/scene/effects.py): scene files, their
schema and tables, `--effect NAME`, `--explain` and the window's panel read that line.
"""
