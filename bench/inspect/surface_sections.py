"""Sections on the surface that the file holds: parts, weights, texels, seams, cones, triangles."""

import numpy as np

from avatar.skeleton import JOINTS, PARTS
from avatar.texture import mip_levels
from bench.inspect import mesh_facts
from bench.inspect.colors import (
    ABSENT,
    PALE,
    PART_COLORS,
    SEQUENTIAL,
    Legend,
    categorical,
    hexadecimal,
    part_colors,
    ramp,
    ticks,
)
from bench.inspect.inspection import GREY, Inspector
from bench.inspect.mesh_facts import MIPS, median_by_area
from bench.inspect.page import PagePicture, PageSection, picture

SEAM_MEDIAN, SEAM_P99 = 1.0, 4.0  # bytes
SEAM_RANGE = 8.0  # bytes
CONE_RANGE = 60.0  # degrees
ATLAS = 820  # pixels


def parts(inspector: Inspector) -> PageSection:
    """Body, head and hands."""
    part = mesh_facts.vertex_parts(inspector.level)
    share = {name: mesh_facts.share_of_area(inspector.level, part == k) for k, name in enumerate(PARTS)}
    inspector.facts["area_share_by_part"] = share
    image = inspector.draw(part_colors(part.astype(np.int64)))
    named = tuple((color, f"{name} ({share[name]:.0%})") for color, name in zip(PART_COLORS, PARTS, strict=True))
    return PageSection(
        "parts",
        "Parts",
        "The part whose joints move a vertex most, with its share of the surface.",
        [picture("parts", image, "parts")],
        Legend(named=named),
    )


def weights(inspector: Inspector, joints: list[str]) -> PageSection:
    """Skin weights: the heaviest joint, and single joints."""
    palette = categorical(52).astype(np.float64)
    share = inspector.level.skin.weights
    blended = np.einsum("vi,vic->vc", share, palette[inspector.level.joints])
    pictures = [
        picture("weights", inspector.draw(np.round(blended).astype(np.uint8)), "joints' colors blended by weight")
    ]
    for name in joints:
        values = mesh_facts.joint_weight(inspector.level, JOINTS.index(name))
        image = inspector.draw(ramp(values, 0.0, 1.0))
        pictures.append(picture(f"weight_{name}", image, f"{name}: weight 0 (dark) to 1 (bright)"))
    used = np.unique(mesh_facts.heaviest_joint(inspector.level))
    absent = [JOINTS[k] for k in range(52) if k not in used]
    inspector.facts["joints_that_move_nothing_most"] = absent
    named = tuple((hexadecimal(categorical(52)[k]), JOINTS[k]) for k in used)
    return PageSection(
        "weights",
        "Skin weights",
        "Soft borders run round a limb, never along it; left and right, and neighbouring fingers, do "
        "not exchange colors." + (f" No vertex is moved most by: {', '.join(absent)}." if absent else ""),
        pictures,
        Legend(named=named),
    )


def texels(inspector: Inspector) -> PageSection:
    """How fine the texture is where."""
    millimetres = mesh_facts.texel_millimetres(inspector.level)
    part, area = mesh_facts.face_parts(inspector.level), mesh_facts.areas(inspector.level)
    by_part = {name: median_by_area(millimetres, area * (part == k)) for k, name in enumerate(PARTS)}
    inspector.facts["texel_mm_by_part"] = by_part
    if by_part["body"] and by_part["head"]:
        ratio = by_part["body"] / by_part["head"]
        inspector.check("texels of the head, against the body", f"{ratio:.1f} times as dense", "2 to 3", ratio > 1.9)
    high = 2.0 * max([value for value in by_part.values() if value] or [1.0])
    image = inspector.draw(ramp(millimetres, 0.0, high))
    rows = [("part", "median side of a texel, mm")]
    rows += [(name, f"{value:.2f}" if value else "none") for name, value in by_part.items()]
    return PageSection(
        "texels",
        "Texel density",
        "Side of a texel on the surface. Head and hands should be darker (finer); a bright patch is "
        "stretched in the atlas.",
        [picture("texels", image, "side of a texel, millimetres"), _atlas(inspector)],
        Legend(SEQUENTIAL, ticks(0.0, high, suffix=" mm"), ((ABSENT, "no texels"),)),
        rows,
    )


def _atlas(inspector: Inspector) -> PagePicture:
    """The base color with the edges of its charts."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(inspector.level.base_color).resize((ATLAS, ATLAS), Image.Resampling.LANCZOS)
    draw = ImageDraw.Draw(image)
    faces = inspector.level.faces.astype(np.int64)
    ends = np.sort(np.concatenate([faces[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    border, uses = np.unique(ends, axis=0, return_counts=True)
    for a, b in ATLAS * inspector.level.uv.astype(np.float64)[border[uses == 1]]:
        draw.line([tuple(a), tuple(b)], fill=(255, 0, 170), width=1)
    return picture("atlas", np.asarray(image), "base color, chart edges in pink", width=620)


def seams(inspector: Inspector) -> PageSection:
    """Steps of color across chart edges."""
    rows = [("level", "mip", "drawn by us", "median", "p99", "largest", "edges")]
    found = []
    shown = None
    for number, level in enumerate(inspector.avatar.levels):
        seam = mesh_facts.seams(level, mesh_facts.weld(level))
        shown = seam if number == 0 else shown
        for mip, steps in enumerate(seam.steps if len(seam.edges) else []):
            median, p99 = (float(value) for value in np.quantile(steps, [0.5, 0.99]))
            drawn, most = mip < mip_levels(level.base_color.shape), float(steps.max())
            found.append({"level": number, "mip": mip, "drawn": drawn, "median": median, "p99": p99, "max": most})
            steps_text = f"{median:.2f}", f"{p99:.2f}", f"{most:.1f}"
            rows.append((str(number), str(mip), "yes" if drawn else "no", *steps_text, str(len(seam.edges))))
    inspector.facts["seam_steps"] = found
    if found:
        median, p99 = (max(row[key] for row in found if row["drawn"]) for key in ("median", "p99"))
        inspector.check(
            "step of color across chart edges, the worst level and mip that the player draws",
            f"median {median:.2f}, p99 {p99:.2f} of 255",
            f"median at most {SEAM_MEDIAN:g}, p99 at most {SEAM_P99:g}",
            median <= SEAM_MEDIAN and p99 <= SEAM_P99,
        )
    assert shown is not None
    pictures = []
    for mip in (0, MIPS - 1):
        image = inspector.draw(
            np.tile(np.array(GREY, np.uint8), (len(inspector.level.positions), 1)),
            lines=shown.edges,
            line_colors=ramp(shown.step[mip], 0.0, SEAM_RANGE),
            normals=inspector.level.normals.astype(np.float64),
        )
        near = "seen from near (mip 0)" if mip == 0 else f"seen from {2**mip} times as far (mip {mip})"
        pictures.append(picture(f"seams_mip{mip}", image, f"color step of the finest level, {near}"))
    return PageSection(
        "seams",
        "Chart seams",
        "Edges where the atlas was cut, colored by the largest difference of color between the two "
        "sides (of 255). Where it is "
        "bright a line may be seen; it should not gather on the face, the neck or the wrists. Our "
        "player stops at the mips that the atlas' "
        "gutters keep apart; other viewers go on to coarser ones.",
        pictures,
        Legend(SEQUENTIAL, ticks(0.0, SEAM_RANGE, suffix="/255")),
        rows,
    )


def cones(inspector: Inspector) -> PageSection:
    """What training saw, and from how many sides."""
    degrees, never = mesh_facts.cone_degrees(inspector.level).mean(1), mesh_facts.unseen(inspector.level)
    seen = inspector.level.view_seen.astype(np.float64)
    share = mesh_facts.share_of_area(inspector.level, ~never)
    inspector.facts |= {
        "seen_area_share": share,
        "cone_degrees_median": float(np.median(degrees[~never])) if (~never).any() else None,
    }
    inspector.check("surface that a camera saw in training", f"{share:.1%}", "the rest keeps the paper's color", None)
    cone = inspector.draw(ramp(np.where(never, np.nan, degrees), 0.0, CONE_RANGE))
    sight = inspector.draw(ramp(np.where(never, np.nan, seen), 0.0, 1.0))
    return PageSection(
        "cones",
        "Cones and unseen regions",
        "How far color may follow the eye: the half-angle of directions that training saw, mean of "
        "widest and narrowest, times how "
        "well the point was seen. Pink was never seen: armpits, between fingers, soles. Its color "
        "is the field's guess.",
        [
            picture("cones", cone, f"half-angle of the cone, degrees, 0 to {CONE_RANGE:g}"),
            picture("seen", sight, "how well a point was seen, 0 (dark) to 1 (bright)"),
        ],
        Legend(SEQUENTIAL, ticks(0.0, CONE_RANGE, suffix="°"), ((ABSENT, "never seen"),)),
    )


def triangles(inspector: Inspector) -> PageSection:
    """Sizes of triangles, and whether the mesh is closed."""
    millimetres = mesh_facts.edge_millimetres(inspector.level)
    part, area = mesh_facts.face_parts(inspector.level), mesh_facts.areas(inspector.level)
    head = ("level", "triangles", "vertices", "texture", "open edges", "edges of more than two", "pieces")
    rows: list[tuple[str, ...]] = [head]
    found, good = [], True
    for number, level in enumerate(inspector.avatar.levels):
        closed = mesh_facts.closedness(mesh_facts.weld(level))
        good &= closed.open_edges == 0 and closed.crowded_edges == 0
        height, width = level.base_color.shape[:2]
        faces, vertices = len(level.faces), len(level.positions)
        found.append({"faces": faces, "vertices": vertices, "texture": [width, height], **closed._asdict()})
        rows.append((str(number), str(faces), str(vertices), f"{width} x {height}", *map(str, closed)))
    inspector.facts["levels"] = found
    holes = ", ".join(f"{f['open_edges']} and {f['crowded_edges']}" for f in found)
    inspector.check("open edges, and edges of more than two triangles, level by level", holes, "0 and 0", good)
    by_part = {name: median_by_area(millimetres, area * (part == k)) for k, name in enumerate(PARTS)}
    inspector.facts["edge_mm_by_part"] = by_part
    high = 2.0 * max([value for value in by_part.values() if value] or [1.0])
    image = inspector.draw(ramp(millimetres, 0.0, high, PALE), wire=True)
    text = ", ".join(f"{name} {value:.1f} mm" for name, value in by_part.items() if value)
    return PageSection(
        "triangles",
        "Triangles",
        f"Mean length of a triangle's edges (median: {text}); the close views show the edges. Slivers "
        "and sudden changes of size "
        "come out as lines in the light.",
        [picture("triangles", image, "edge length, millimetres")],
        Legend(PALE, ticks(0.0, high, suffix=" mm")),
        rows,
    )
