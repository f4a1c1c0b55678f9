"""Sections on the surface that the file holds: parts, weights, seams, cones, triangles."""

import numpy as np

from avatar.skeleton import JOINTS, PARTS
from avatar.skinning import dense_weights
from avatar.texture import mip_levels
from bench.inspect import mesh_facts
from bench.inspect.colors import ABSENT, PART_COLORS, Legend, Ramp, categorical, rgb
from bench.inspect.inspection import ColoredLines, Inspector
from bench.inspect.mesh_facts import MIPS
from bench.inspect.page import PageSection, picture
from capture.read.template import part_of

SEAM_MEDIAN, SEAM_P99 = 1.0, 4.0  # bytes
SEAMS = Ramp(0.0, 8.0, "/255")
CONES = Ramp(0.0, 60.0, "°")
SHARES = Ramp(0.0, 1.0)


def parts(inspector: Inspector) -> PageSection:
    """Body, head and hands."""
    part = part_of(inspector.level.skin)
    share = {name: mesh_facts.share_of_area(inspector.level, part == k) for k, name in enumerate(PARTS)}
    inspector.facts["area_share_by_part"] = share
    image = inspector.draw(rgb(PART_COLORS)[part])
    named = tuple((color, f"{name} ({share[name]:.0%})") for color, name in zip(PART_COLORS, PARTS, strict=True))
    return PageSection("parts", [picture("parts", image, "parts")], Legend(named=named))


def weights(inspector: Inspector) -> PageSection:
    """Skin weights."""
    skin, palette = inspector.level.skin, categorical(52)
    dense = dense_weights(skin)
    pictures = [picture("weights", inspector.draw(dense @ rgb(palette)), "joints' colors blended by weight")]
    used = np.unique(skin.heaviest)
    absent = [JOINTS[k] for k in range(52) if k not in used]
    inspector.facts["joints_that_move_nothing_most"] = absent
    more = f"No vertex is moved most by: {', '.join(absent)}." if absent else ""
    return PageSection("weights", pictures, Legend(named=tuple((palette[k], JOINTS[k]) for k in used)), more=more)


def seams(inspector: Inspector) -> PageSection:
    """Steps of color across chart edges."""
    rows, found = [("level", "mip", "drawn by us", "median", "p99", "largest", "edges")], []
    levels = [(level, mesh_facts.seams(level)) for level in inspector.avatar.levels]
    for number, (level, seam) in enumerate(levels):
        for mip, steps in enumerate(seam.steps if len(seam.edges) else []):
            median, p99 = (float(value) for value in np.quantile(steps, [0.5, 0.99]))
            drawn, most = mip < mip_levels(level.base_color.shape), float(steps.max())
            found.append({"level": number, "mip": mip, "drawn": drawn, "median": median, "p99": p99, "max": most})
            steps_text = f"{median:.2f}", f"{p99:.2f}", f"{most:.1f}"
            rows.append((str(number), str(mip), "yes" if drawn else "no", *steps_text, str(len(seam.edges))))
    inspector.facts["seam_steps"] = found
    if found:
        median, p99 = (max(row[key] for row in found if row["drawn"]) for key in ("median", "p99"))
        what = "step of color across chart edges, the worst level and mip that the player draws"
        expected, good = f"median at most {SEAM_MEDIAN:g}, p99 at most {SEAM_P99:g}", median <= SEAM_MEDIAN
        inspector.check(what, f"median {median:.2f}, p99 {p99:.2f} of 255", expected, good and p99 <= SEAM_P99)
    pictures, shown = [], levels[0][1]
    for mip in (0, MIPS - 1):
        image = inspector.draw(inspector.grey, ColoredLines(shown.edges, SEAMS.colors(shown.steps[mip].max(0))))
        near = "seen from near (mip 0)" if mip == 0 else f"seen from {2**mip} times as far (mip {mip})"
        pictures.append(picture(f"seams_mip{mip}", image, f"color step of the finest level, {near}"))
    return PageSection("seams", pictures, SEAMS.legend(), rows)


def cones(inspector: Inspector) -> PageSection:
    """What training saw, and from how many sides."""
    degrees, seen = mesh_facts.cone_degrees(inspector.level).mean(1), inspector.level.view_seen.astype(np.float64)
    # no camera looked at these in training
    never = seen <= 0
    share = mesh_facts.share_of_area(inspector.level, ~never)
    inspector.facts |= {
        "seen_area_share": share,
        "cone_degrees_median": float(np.median(degrees[~never])) if (~never).any() else None,
    }
    inspector.check("surface that a camera saw in training", f"{share:.1%}", "the rest keeps the paper's color", None)
    cone = inspector.draw(CONES.colors(np.where(never, np.nan, degrees)))
    sight = inspector.draw(SHARES.colors(np.where(never, np.nan, seen)))
    pictures = [
        picture("cones", cone, f"half-angle of the cone, degrees, 0 to {CONES.high:g}"),
        picture("seen", sight, "how well a point was seen, 0 (dark) to 1 (bright)"),
    ]
    return PageSection("cones", pictures, CONES.legend((ABSENT, "never seen")))


def triangles(inspector: Inspector) -> PageSection:
    """How many triangles each level has, and whether it is closed."""
    head = ("level", "triangles", "vertices", "texture", "open edges", "edges of more than two", "pieces")
    rows: list[tuple[str, ...]] = [head]
    found = []
    for number, level in enumerate(inspector.avatar.levels):
        closed = mesh_facts.closedness(level)
        height, width = level.base_color.shape[:2]
        faces, vertices = len(level.faces), len(level.positions)
        found.append({"faces": faces, "vertices": vertices, "texture": [width, height], **closed._asdict()})
        rows.append((str(number), str(faces), str(vertices), f"{width} x {height}", *map(str, closed)))
    inspector.facts["levels"] = found
    holes = [(one["open_edges"], one["crowded_edges"]) for one in found]
    shown = ", ".join(f"{open_edges} and {crowded}" for open_edges, crowded in holes)
    what = "open edges, and edges of more than two triangles, level by level"
    inspector.check(what, shown, "0 and 0", not np.any(holes))
    pictures = [picture("triangles", inspector.draw(inspector.grey, wire=True), "the finest level")]
    return PageSection("triangles", pictures, rows=rows)
