"""The sections of the page, one topic each: measure, colour, draw, say what to look for."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from avatar.baked_avatar import Avatar, Level
from avatar.skeleton import JOINTS
from bench.inspect import looks, mesh_facts
from bench.inspect.colors import (
    ABSENT,
    DIVERGING,
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
from bench.inspect.drawing import GREY, Studio
from bench.inspect.mesh_facts import MIPS, PARTS, median_by_area
from bench.inspect.page import Check, Picture, Section, animation, flattened, png
from bench.inspect.views import standard_views, strip
from player.context import Context
from player.plan import mip_levels

SEAM_MEDIAN, SEAM_P99 = 1.0, 4.0  # bytes
FIELD_MEAN = 0.5  # millimetres
MOST_BYTES = 12e6
PAPER_DB = 40.0
FIELD_RANGE, TRUTH_RANGE = 2.0, 10.0  # millimetres, ends of the ramps
SEAM_RANGE = 8.0  # bytes
CONE_RANGE = 60.0  # degrees
ATLAS = 820  # pixels
CHANGE = 8  # times that view dependence is shown


@dataclass
class Measured:
    """Distances to what only a run or a capture knows; None where they were not given."""

    field: Float[np.ndarray, "f"] | None  # millimetres, signed, per triangle
    truth: Float[np.ndarray, "v"] | None  # millimetres, per vertex


@dataclass
class Inspection:
    """What the page shows and what the JSON holds."""

    checks: list[Check]
    sections: list[Section]
    facts: dict[str, Any]


class Inspector:
    """One avatar, drawn topic by topic; `size` is the side of the large views in pixels."""

    def __init__(self, avatar: Avatar, path: Path, context: Context, measured: Measured, size: int):
        self.avatar, self.path, self.context, self.measured = avatar, path, context, measured
        self.level, self.size = avatar.levels[0], size
        self.views = standard_views(avatar, size)
        self.studio: Studio | None = None
        self.checks: list[Check] = []
        self.facts: dict[str, Any] = {"format": "selfscan-inspection", "version": 1, "avatar": path.name}

    def draw(self, colors: UInt8[np.ndarray, "n 3"], level: Level | None = None, **lines: Any) -> np.ndarray:
        level = self.level if level is None else level
        if self.studio is None:
            self.studio = Studio(self.views, self.context.kind)
        return self.studio.draw(
            level.positions.astype(np.float64), level.faces.astype(np.int64), colors, **lines
        )

    def check(self, what: str, value: str, expected: str, good: bool | None) -> None:
        self.checks.append(Check(what, value, expected, good))

    def release(self) -> None:
        if self.studio is not None:
            self.studio.release()

    # topics

    def looks(self) -> Section:
        """As drawn, in the canonical pose."""
        plain = strip(looks.standing(self.context, self.avatar, self.views, "off"))
        pictures = [Picture("look_off", png(plain), "png", "the paper's colours")]
        mode = self.avatar.default_view
        if mode != "off":
            image = strip(looks.standing(self.context, self.avatar, self.views, mode))
            pictures.append(Picture(f"look_{mode}", png(image), "png", f"with view dependence ({mode})"))
            change = np.clip(128 + CHANGE * (image.astype(float) - plain), 0, 255).astype(np.uint8)
            pictures.append(
                Picture(
                    "look_change", png(change), "png", f"what view dependence adds, {CHANGE} times, on grey"
                )
            )
        return Section(
            "look", "As drawn",
            "The finest level in the pose it is stored in. Look for blur, colours of one part on another, a line at neck or "
            "wrists, fingers grown together.",
            pictures,
        )  # fmt: skip

    def posed(self) -> Section:
        """Poses that strain the skin."""
        pictures = [
            Picture(f"pose_{name.replace(' ', '_')}", png(image), "png", name, width=380)
            for name, image in looks.posed(self.context, self.avatar, max(self.size * 3 // 4, 64)).items()
        ]
        return Section(
            "poses", "Posed",
            "Linear blend skinning in poses that strain it. Look for collapsed elbows and knees, armpits that pull the chest "
            "along, fingers that drag each other.",
            pictures,
        )  # fmt: skip

    def turntable(self, frames: int) -> Section:
        """Once round."""
        size = (self.size * 3 // 4 // 2 * 2, self.size)
        turn = animation(list(looks.turntable(self.context, self.avatar, size, frames)), 6.0)
        mode = self.avatar.default_view
        return Section(
            "turntable", "Turntable", f"The avatar at ease, as its file asks to be drawn (view dependence: {mode}).",
            [Picture("turntable", turn, "webp", f"{frames} views, 6 seconds")],
        )  # fmt: skip

    def parts(self) -> Section:
        """Body, head and hands."""
        part = mesh_facts.vertex_parts(self.level)
        share = {name: mesh_facts.share_of_area(self.level, part == k) for k, name in enumerate(PARTS)}
        self.facts["area_share_by_part"] = share
        image = self.draw(part_colors(part.astype(np.int64)))
        named = tuple(
            (color, f"{name} ({share[name]:.0%})") for color, name in zip(PART_COLORS, PARTS, strict=True)
        )
        return Section(
            "parts", "Parts", "The part whose joints move a vertex most, with its share of the surface.",
            [Picture("parts", png(image), "png", "parts")], Legend(named=named),
        )  # fmt: skip

    def weights(self, joints: list[str]) -> Section:
        """Skin weights: the heaviest joint, and single joints."""
        palette = categorical(52).astype(np.float64)
        share = self.level.weights.astype(np.float64) / 255
        blended = np.einsum("vi,vic->vc", share, palette[self.level.joints])
        pictures = [Picture("weights", png(self.draw(np.round(blended).astype(np.uint8))), "png",
                            "joints' colours blended by weight")]  # fmt: skip
        for name in joints:
            values = mesh_facts.joint_weight(self.level, JOINTS.index(name))
            image = self.draw(ramp(values, 0.0, 1.0))
            pictures.append(
                Picture(f"weight_{name}", png(image), "png", f"{name}: weight 0 (dark) to 1 (bright)")
            )
        used = np.unique(mesh_facts.heaviest_joint(self.level))
        absent = [JOINTS[k] for k in range(52) if k not in used]
        self.facts["joints_that_move_nothing_most"] = absent
        named = tuple((hexadecimal(categorical(52)[k]), JOINTS[k]) for k in used)
        return Section(
            "weights", "Skin weights",
            "Soft borders run round a limb, never along it; left and right, and neighbouring fingers, do not exchange colours."
            + (f" No vertex is moved most by: {', '.join(absent)}." if absent else ""),
            pictures, Legend(named=named),
        )  # fmt: skip

    def texels(self) -> Section:
        """How fine the texture is where."""
        millimetres = mesh_facts.texel_millimetres(self.level)
        part, area = mesh_facts.face_parts(self.level), mesh_facts.areas(self.level)
        by_part = {name: median_by_area(millimetres, area * (part == k)) for k, name in enumerate(PARTS)}
        self.facts["texel_mm_by_part"] = by_part
        if by_part["body"] and by_part["head"]:
            ratio = by_part["body"] / by_part["head"]
            self.check(
                "texels of the head, against the body", f"{ratio:.1f} times as dense", "2 to 3", ratio > 1.9
            )
        high = 2.0 * max([value for value in by_part.values() if value] or [1.0])
        image = self.draw(ramp(millimetres, 0.0, high))
        rows = [("part", "median side of a texel, mm")]
        rows += [(name, f"{value:.2f}" if value else "none") for name, value in by_part.items()]
        return Section(
            "texels", "Texel density",
            "Side of a texel on the surface. Head and hands should be darker (finer); a bright patch is stretched in the atlas.",
            [Picture("texels", png(image), "png", "side of a texel, millimetres"), self._atlas()],
            Legend(SEQUENTIAL, ticks(0.0, high, suffix=" mm"), ((ABSENT, "no texels"),)), rows,
        )  # fmt: skip

    def _atlas(self) -> Picture:
        """The base colour with the edges of its charts."""
        from PIL import Image, ImageDraw

        image = Image.fromarray(self.level.base_color).resize((ATLAS, ATLAS), Image.Resampling.LANCZOS)
        draw = ImageDraw.Draw(image)
        faces = self.level.faces.astype(np.int64)
        ends = np.sort(np.concatenate([faces[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
        border, uses = np.unique(ends, axis=0, return_counts=True)
        for a, b in ATLAS * self.level.uv.astype(np.float64)[border[uses == 1]]:
            draw.line([tuple(a), tuple(b)], fill=(255, 0, 170), width=1)
        return Picture("atlas", png(np.asarray(image)), "png", "base colour, chart edges in pink", width=620)

    def seams(self) -> Section:
        """Steps of colour across chart edges."""
        rows = [("level", "mip", "drawn by us", "median", "p99", "largest", "edges")]
        found = []
        shown = None
        for number, level in enumerate(self.avatar.levels):
            seam = mesh_facts.seams(level, mesh_facts.weld(level))
            shown = seam if number == 0 else shown
            for mip, steps in enumerate(seam.steps if len(seam.edges) else []):
                median, p99 = (float(value) for value in np.quantile(steps, [0.5, 0.99]))
                drawn, most = mip < mip_levels(level.base_color.shape), float(steps.max())
                found.append(
                    {"level": number, "mip": mip, "drawn": drawn, "median": median, "p99": p99, "max": most}
                )
                rows.append((str(number), str(mip), "yes" if drawn else "no", f"{median:.2f}", f"{p99:.2f}", f"{most:.1f}",
                             str(len(seam.edges))))  # fmt: skip
        self.facts["seam_steps"] = found
        if found:
            median, p99 = (max(row[key] for row in found if row["drawn"]) for key in ("median", "p99"))
            self.check("step of colour across chart edges, the worst level and mip that the player draws",
                       f"median {median:.2f}, p99 {p99:.2f} of 255", f"median at most {SEAM_MEDIAN:g}, p99 at most {SEAM_P99:g}",
                       median <= SEAM_MEDIAN and p99 <= SEAM_P99)  # fmt: skip
        assert shown is not None
        pictures = []
        for mip in (0, MIPS - 1):
            image = self.draw(
                np.tile(np.array(GREY, np.uint8), (len(self.level.positions), 1)),
                lines=shown.edges,
                line_colors=ramp(shown.step[mip], 0.0, SEAM_RANGE),
                normals=self.level.normals.astype(np.float64),
            )
            near = "seen from near (mip 0)" if mip == 0 else f"seen from {2**mip} times as far (mip {mip})"
            pictures.append(
                Picture(f"seams_mip{mip}", png(image), "png", f"colour step of the finest level, {near}")
            )
        return Section(
            "seams", "Chart seams",
            "Edges where the atlas was cut, coloured by the largest difference of colour between the two sides (of 255). Where it is "
            "bright a line may be seen; it should not gather on the face, the neck or the wrists. Our player stops at the mips that the atlas' "
            "gutters keep apart; other viewers go on to coarser ones.",
            pictures,
            Legend(SEQUENTIAL, ticks(0.0, SEAM_RANGE, suffix="/255")), rows,
        )  # fmt: skip

    def cones(self) -> Section:
        """What training saw, and from how many sides."""
        degrees, never = mesh_facts.cone_degrees(self.level).mean(1), mesh_facts.unseen(self.level)
        seen = self.level.view_seen.astype(np.float64)
        share = mesh_facts.share_of_area(self.level, ~never)
        self.facts |= {
            "seen_area_share": share,
            "cone_degrees_median": float(np.median(degrees[~never])) if (~never).any() else None,
        }
        self.check(
            "surface that a camera saw in training", f"{share:.1%}", "the rest keeps the paper's colour", None
        )
        cone = self.draw(ramp(np.where(never, np.nan, degrees), 0.0, CONE_RANGE))
        sight = self.draw(ramp(np.where(never, np.nan, seen), 0.0, 1.0))
        return Section(
            "cones", "Cones and unseen regions",
            "How far colour may follow the eye: the half-angle of directions that training saw, mean of widest and narrowest, times how "
            "well the point was seen. Pink was never seen: armpits, between fingers, soles. Its colour is the field's guess.",
            [Picture("cones", png(cone), "png", f"half-angle of the cone, degrees, 0 to {CONE_RANGE:g}"),
             Picture("seen", png(sight), "png", "how well a point was seen, 0 (dark) to 1 (bright)")],
            Legend(SEQUENTIAL, ticks(0.0, CONE_RANGE, suffix="°"), ((ABSENT, "never seen"),)),
        )  # fmt: skip

    def triangles(self) -> Section:
        """Sizes of triangles, and whether the mesh is closed."""
        millimetres = mesh_facts.edge_millimetres(self.level)
        part, area = mesh_facts.face_parts(self.level), mesh_facts.areas(self.level)
        rows = [
            ("level", "triangles", "vertices", "texture", "open edges", "edges of more than two", "pieces")
        ]
        found, good = [], True
        for number, level in enumerate(self.avatar.levels):
            closed = mesh_facts.closedness(mesh_facts.weld(level))
            good &= closed.open_edges == 0 and closed.crowded_edges == 0
            height, width = level.base_color.shape[:2]
            found.append(
                {
                    "faces": len(level.faces),
                    "vertices": len(level.positions),
                    "texture": [width, height],
                    **closed._asdict(),
                }
            )
            rows.append((str(number), str(len(level.faces)), str(len(level.positions)), f"{width} x {height}",
                         str(closed.open_edges), str(closed.crowded_edges), str(closed.pieces)))  # fmt: skip
        self.facts["levels"] = found
        holes = ", ".join(f"{f['open_edges']} and {f['crowded_edges']}" for f in found)
        self.check("open edges, and edges of more than two triangles, level by level", holes, "0 and 0", good)
        by_part = {name: median_by_area(millimetres, area * (part == k)) for k, name in enumerate(PARTS)}
        self.facts["edge_mm_by_part"] = by_part
        high = 2.0 * max([value for value in by_part.values() if value] or [1.0])
        image = self.draw(ramp(millimetres, 0.0, high, PALE), wire=True)
        text = ", ".join(f"{name} {value:.1f} mm" for name, value in by_part.items() if value)
        return Section(
            "triangles", "Triangles",
            f"Mean length of a triangle's edges (median: {text}); the close views show the edges. Slivers and sudden changes of size "
            "come out as lines in the light.",
            [Picture("triangles", png(image), "png", "edge length, millimetres")],
            Legend(PALE, ticks(0.0, high, suffix=" mm")), rows,
        )  # fmt: skip

    def field_distance(self) -> Section | None:
        """Mesh against the field of the run."""
        if self.measured.field is None:
            return None
        signed, area = self.measured.field, mesh_facts.areas(self.level)
        mean = float((np.abs(signed) * area).sum() / area.sum())
        self.facts["field_to_mesh_mm"] = {"mean_of_worst": mean, "max": float(np.abs(signed).max())}
        self.check("triangles from the field's surface, mean of each one's farthest of four points", f"{mean:.3f} mm",
                   f"at most {FIELD_MEAN:g} mm", mean <= FIELD_MEAN)  # fmt: skip
        image = self.draw(ramp(signed, -FIELD_RANGE, FIELD_RANGE, DIVERGING))
        return Section(
            "field", "Distance to the field",
            "Of each triangle's centre and corners the one farthest from the field's surface. Red stands outside of it, blue inside.",
            [Picture("field", png(image), "png", f"signed distance, millimetres, largest {np.abs(signed).max():.2f}")],
            Legend(DIVERGING, ticks(-FIELD_RANGE, FIELD_RANGE, suffix=" mm")),
        )  # fmt: skip

    def truth_distance(self) -> Section | None:
        """Mesh against the true surface of the capture."""
        if self.measured.truth is None:
            return None
        millimetres = self.measured.truth
        area, part = mesh_facts.areas(self.level), mesh_facts.face_parts(self.level)
        each = millimetres[self.level.faces].mean(1)
        rows, found = [("part", "mean, mm", "95 of 100 below, mm")], {}
        for name, chosen in [("total", part >= 0), *((name, part == k) for k, name in enumerate(PARTS))]:
            if not (area * chosen).sum() > 0:
                continue
            mean = float((each * area * chosen).sum() / (area * chosen).sum())
            p95 = float(np.quantile(each[chosen], 0.95))
            found[name] = {"p2s_mm": mean, "p95_mm": p95}
            rows.append((name, f"{mean:.2f}", f"{p95:.2f}"))
        self.facts["truth"] = found
        self.check(
            "distance to the true surface in T-pose (P2S)",
            f"{found['total']['p2s_mm'] / 10:.3f} cm",
            "as small as can be",
            None,
        )
        image = self.draw(ramp(millimetres, 0.0, TRUTH_RANGE))
        return Section(
            "truth", "Distance to the truth",
            "Each vertex to the nearest point of the subject's own visible surface, both in T-pose. All of the mesh counts here, hidden "
            "folds too; `selfscan eval` scores what can be seen, over the test poses.",
            [Picture("truth", png(image), "png", "P2S, millimetres")],
            Legend(SEQUENTIAL, ticks(0.0, TRUTH_RANGE, suffix=" mm")), rows,
        )  # fmt: skip

    def levels(self) -> Section:
        """Levels of detail side by side."""
        pictures, rows = [], [("level", "triangles", "texture", "PSNR against the finest, dB")]
        first = None
        for number, level in enumerate(self.avatar.levels):
            front, _, head, _, hand, _ = looks.standing(self.context, self.avatar, self.views, "off", number)
            image = np.hstack([front, np.vstack([head, hand])])
            first = image if first is None else first
            error = np.square((image.astype(float) - first) / 255).mean()
            decibels = "same" if number == 0 else f"{-10 * np.log10(max(error, 1e-12)):.1f}"
            rows.append((str(number), str(len(level.faces)), f"{level.base_color.shape[1]}", decibels))
            pictures.append(
                Picture(f"level_{number}", png(image), "png", f"{len(level.faces)} triangles", width=380)
            )
        return Section(
            "levels",
            "Levels of detail",
            "The same views of each level, in the paper's colours, the background counted.",
            pictures,
            None,
            rows,
        )

    def provenance(self) -> list[Section]:
        """What baking and training wrote into the file."""
        baked = self.avatar.provenance.get("baked", {})
        against = baked.get("against_field") if isinstance(baked, dict) else None
        paper = against.get("paper_db") if isinstance(against, dict) else None
        if isinstance(paper, int | float):
            self.check("baked paper mode against the paper field, as baking measured it", f"{paper:.2f} dB", f"at least {PAPER_DB:g} dB",
                       paper >= PAPER_DB)  # fmt: skip
        size = self.path.stat().st_size
        self.check(
            "size of the file", f"{size / 1e6:.2f} MB", f"at most {MOST_BYTES / 1e6:g} MB", size <= MOST_BYTES
        )
        self.facts["bytes"] = size
        rest = {key: value for key, value in self.avatar.provenance.items() if key != "baked"}
        return [
            Section("accuracy", "Measured while baking", "As written into the file; paths are those of its JSON.",
                    rows=[("what", "value"), *flattened(baked)] if baked else []),
            Section("provenance", "Provenance", "Where the avatar comes from.", rows=[("what", "value"), *flattened(rest)]),
        ]  # fmt: skip
