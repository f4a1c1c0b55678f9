"""What a bake promises, and what it says at its end where it missed one: plain lines, each with what to do."""

from typing import Any, TypeAlias

from avatar.baked_avatar import Avatar
from bake.options import MOST_FACES, BakeOptions

# what the file's provenance says of a bake: JSON's values by name
Facts: TypeAlias = dict[str, Any]

# PSNR of the baked avatar against its field, paper mode, where the file holds the field's own colors
PAPER_DB = 40.0
# bytes: 99 of 100 color steps across chart edges exceed what the picture itself steps there by less, in every mip
SEAM_STEP = 3.8
# bytes of the avatar file, with the options as they are by default
FILE_SIZE = 12e6
# metres: about as tall as the people who are filmed
PERSON_MM = 1700.0


def baked_facts(avatar: Avatar) -> Facts:
    """What the bake of an avatar file wrote into it; empty where it did not."""
    baked = avatar.provenance.get("baked")
    return baked if isinstance(baked, dict) else {}


def recorded_loss(avatar: Avatar) -> Facts:
    """What the file says that it lost against its field; empty where it does not say."""
    against = baked_facts(avatar).get("against_field")
    return against if isinstance(against, dict) else {}


def missed_promises(facts: Facts, options: BakeOptions, size: int) -> list[str]:
    """The promises that a bake missed; `facts` as provenance.baked holds them, `size` the file's bytes."""
    lines = []
    against = facts["against_field"]
    by_field = facts["texture_from"] == "field"
    if by_field and against["paper_db"] is not None and against["paper_db"] < PAPER_DB:
        views = against["per_view_db"]
        worst = min((name for name, db in views.items() if db is not None), key=lambda name: views[name])
        more = min(2 * options.faces, MOST_FACES)
        lines.append(
            f"{against['paper_db']:.1f} dB against the field, promised are {PAPER_DB:g} (worst view: {worst}, "
            f"{views[worst]:.1f} dB): "
            + (f"try --faces {more}; " if more > options.faces else "")
            + "`selfscan inspect` shows where it differs"
        )
    for number, level in enumerate(facts["levels"]):
        steps = [mip["seen_p99"] for mip in level["seam_step"]["mips"]]
        wide = [mip for mip, step in enumerate(steps) if step > SEAM_STEP]
        if wide:
            texel = level["texel_mm_by_part"].get("body") or 1.0
            pixels = PERSON_MM / (texel * 2 ** wide[0])
            missed = ", ".join(f"mip {mip} {steps[mip]:.1f}" for mip in wide)
            lines.append(
                f"level {number}: 1 in 100 points on chart edges steps by more than {SEAM_STEP:g} of 255 beyond what "
                f"the picture steps there ({missed}): faint lines may show where the person is less than {pixels:.0f} "
                "px tall; `selfscan inspect` shows them"
            )
    for part, fit in facts.get("videos", {}).items():
        if isinstance(fit, dict) and fit["rms_after"] > fit["rms_before"]:
            lines.append(
                f"{part}: its video differs by {fit['rms_after']:.1f} of 255 from the texture made of it, "
                f"{fit['rms_before']:.1f} from the field's: try --texture-from field"
            )
    # more where more texels or triangles were asked for
    limit = FILE_SIZE * max(1.0, (options.texture / 2048) ** 2, options.faces / 30_000)
    if size > limit:
        lines.append(
            f"the file has {size / 1e6:.1f} MB, promised are at most {limit / 1e6:.0f}: most of it is --texture's"
        )
    return lines
