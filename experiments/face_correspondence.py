"""Whether a registered template puts lips, lids and brows where they are: four scans whose truth is known.

    python -m experiments.face_correspondence OUT [--data DIR] [--templates DIR]

The four people of the sample data (c-frame/valid-avatars-glb) share one texture layout, which says what point of one is
what point of another, and each has 65 shapes of the face by the same artist. Their templates are registered as `synth`
does (kept in OUT), or come from pixels: DIR/NAME/subject.npz of a run and DIR/NAME/avatar.glb, its bake, laid onto the
scan by the face's surface. Then, for each of the twelve ordered pairs:

- a vertex of the first person's skin goes to the closest place of their template that faces the same way, from there to
  the same place of the second person's template, and on to the closest point of their skin; how far is that off the
  vertex with the same texture coordinates? Regions are told by the first person's own shapes;
- the first person's shapes are carried to the second person by the same two steps, as plain offsets, and compared with
  the second person's own: mean length of the difference over that of the motion, where it moves. Carried by texture
  coordinates the same number says how much the two people differ.

Once as registered, once as a bake takes it: moved to the lips and brows that the scan's or the bake's picture shows
(bake/face/features.py). Writes OUT/face_correspondence.json and .md.
"""

import argparse
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Integer, UInt8
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.baked_avatar import Level
from avatar.gltf.avatar_file import read_avatar
from avatar.gltf.document import read_gltf
from avatar.gltf.rigged import Rigged, RiggedPart, read_rigged
from avatar.gltf.scene import read_base_color
from avatar.similarity import similarity_from_landmarks
from avatar.skeleton import JOINTS
from bake.face.features import aligned
from bake.face.template import PersonFace, person_face
from bench.report.writer import markdown_table
from capture.folder import read_subject
from capture.read.template import write_template
from experiments.program import end_with, note
from files.input_file import JsonObject
from files.npz import read_npz
from files.whole import write_json, write_text
from geometry.closest import closest_points, match_surface, triangle_index
from geometry.icp import rigid_icp
from geometry.mesh import blended, vertex_normals
from player.draw.raster import Rasteriser
from player.gl.context import open_context
from synth.cutout import cut_out
from synth.subject import read_subject as read_synth_subject
from synth.template import register
from synth.visibility import visible_faces

PEOPLE = ("White_M_1", "White_F_1", "Black_M_2", "Asian_F_2")
SKIN = "H_DDS_HighRes"
# region: its shapes, which of their largest motion makes a vertex one of it, and the goal of issue 27, mm
REGIONS = {
    "mouth": (("Kiss_h",), 0.5, 2.0),
    "lids": (("ReyeClose_h", "LeyeClose_h"), 0.3, 1.5),
    "brows": (("RRbrowUp_h", "RbrowUp_h", "LbrowUp_h", "LLbrowUp_h"), 0.6, 3.0),
}
# error of carried shapes over their motion
GOAL = 0.33
# texture coordinates of one point differ by less
SAME_UV = 3e-4
# metres: a vertex that a shape moves by less stays; a shape that moves none by as much is left out
STILL, LEAST = 3e-4, 2e-3
FIELDS = ("names", "vertex", "scale", "delta")


class Scan(NamedTuple):
    """One person in pose 0, the pelvis at the origin, metres: skin as it is seen from outside, shapes and template."""

    name: str
    points: Float[Array, "n 3"]
    faces: Integer[Array, "faces 3"]  # what is seen
    uv: Float[Array, "n 2"]
    shapes: tuple[str, ...]
    offsets: Float32[Array, "shapes n 3"]
    person: PersonFace
    baked: PersonFace  # as a bake takes it

    @property
    def seen(self) -> Bool[Array, "n"]:
        """Vertices of what is seen."""
        return np.isin(np.arange(len(self.points)), self.faces)

    def length(self, names: tuple[str, ...]) -> Float[Array, "n"]:
        """How far the farthest of some shapes moves each vertex, metres."""
        return np.linalg.norm(self.offsets[[self.shapes.index(name) for name in names]], axis=2).max(0)


def read_scan(data: Path, name: str, out: Path, templates: Path | None) -> Scan:
    """A person of the sample data; the template is registered, and kept in `out`, where it is nowhere yet."""
    path = data / "characters" / f"{name}_Casual.glb"
    gltf, subject = read_gltf(path), cut_out(read_synth_subject(path))
    rigged = read_rigged(gltf)
    number = next(k for k, part in enumerate(rigged.parts) if SKIN in part.called)
    skin, first = rigged.parts[number], sum(len(part.vertices) for part in rigged.parts[:number])
    points = rigged.vertices[first : first + len(skin.vertices)].astype(np.float64)
    whole = np.concatenate([part.faces + at for part, at in zip(rigged.parts, _starts(rigged.parts), strict=True)])
    with open_context() as context:
        rasteriser = Rasteriser(context)
        seen = visible_faces(rasteriser, rigged.vertices.astype(np.float32), whole.astype(np.int32))
        kept = (templates or out / "templates") / name / "subject.npz"
        if templates is None and not kept.exists():
            note(f"{name}: registering")
            visible = visible_faces(rasteriser, subject.vertices, subject.faces)
            found = register(subject, visible, rasteriser)
            kept.parent.mkdir(parents=True, exist_ok=True)
            write_template(kept, found.mesh, found.hair, found.eyes)
    begin = sum(len(part.faces) for part in rigged.parts[:number])
    faces = skin.faces[seen[begin : begin + len(skin.faces)]].astype(np.int64)
    stored = read_npz(data / "morphs" / f"{name}_morphs.npz", "shapes", tuple(f"{SKIN}/{k}" for k in FIELDS))
    raw = gltf.accessor(next(m for m in gltf.items("meshes") if m.get("name") == SKIN)["primitives"][0]["attributes"]
                        ["POSITION"], as_float=True)  # fmt: skip
    rows = stored[f"{SKIN}/vertex"]
    into = similarity_from_landmarks(raw[rows].astype(np.float64), points[rows])
    if into.residual > 1e-4:
        raise ValueError(f"{name}: the head should be its bind pose's, is off by {into.residual} m")
    offsets = np.zeros((len(stored[f"{SKIN}/names"]), len(points), 3), np.float32)
    offsets[:, rows] = stored[f"{SKIN}/delta"] * float(stored[f"{SKIN}/scale"]) @ into.transform[:3, :3].T
    names = tuple(str(shape) for shape in stored[f"{SKIN}/names"])
    person = person_face(read_subject(kept, name))
    picture = scan_level(rigged, number, read_base_color(gltf, skin.material, [])[0])
    if templates is None:
        faced = (person, aligned(person, picture))
    else:
        faced = (person, aligned(person, read_avatar(kept.parent / "avatar.glb", levels=1).levels[0]))
        eyes = picture.positions[len(points) :]
        faced = tuple(laid_on(one, points, faces, 0.5 * (eyes.min(0) + eyes.max(0))) for one in faced)
    return Scan(name, points, faces, skin.uv.astype(np.float64), names, offsets, *faced)


def laid_on(
    person: PersonFace, points: Float[Array, "n 3"], faces: Integer[Array, "faces 3"], eyes: Float32[Array, "3"]
) -> PersonFace:
    """A face moved rigidly onto a scan whose eyes' middle is given."""
    vertices = person.vertices + eyes - person.eyes.centres.mean(0)
    moved = rigid_icp(vertices[np.unique(person.skin)], triangle_index(points, faces))
    return person._replace(vertices=vertices @ moved[:3, :3].T + moved[:3, 3])


def scan_level(rigged: Rigged, number: int, texture: UInt8[Array, "height width 3"]) -> Level:
    """The skin, which is part `number` and has this texture, with the eyeballs, as a baked level."""
    starts = _starts(rigged.parts)
    parts = [number, *(k for k, part in enumerate(rigged.parts) if "_eye" in part.called)]
    own = np.concatenate([starts[k] + np.arange(len(rigged.parts[k].vertices)) for k in parts])
    sizes = np.cumsum([0, *(len(rigged.parts[k].vertices) for k in parts)])
    faces = np.concatenate([rigged.parts[k].faces + at for k, at in zip(parts, sizes, strict=False)])
    # eyeballs are of one color of the skin's texture
    uv = np.concatenate([rigged.parts[k].uv * (k == number) for k in parts]).astype(np.float32)
    points, count = rigged.vertices[own].astype(np.float32), len(own)
    first, normals = np.eye(1, 4, dtype=np.uint8).repeat(count, 0), vertex_normals(points, faces).astype(np.float32)
    return Level(
        points, normals, uv, faces.astype(np.uint32), JOINTS.index("head") * first, 255 * first, -normals,
        np.zeros((count, 6), np.float32), np.ones(count, np.float32), np.ascontiguousarray(texture[..., :3]), None,
    )  # fmt: skip


def _starts(parts: list[RiggedPart]) -> list[int]:
    return np.cumsum([0, *(len(part.vertices) for part in parts)])[:-1].tolist()


def same_vertices(a: Scan, b: Scan) -> Integer[Array, "n"]:
    """For each vertex of one scan that of another with its texture coordinates; -1: none."""
    seen = np.flatnonzero(b.seen)
    away, near = KDTree(b.uv[seen]).query(a.uv)
    return np.where(away < SAME_UV, seen[near], -1)


def landed(a: Scan, b: Scan, rows: Integer[Array, "k"]) -> Float[Array, "k 3"]:
    """Where vertices of one scan come to lie on another through both templates."""
    match = match_surface(a.points[rows], vertex_normals(a.points, a.faces)[rows], a.person.vertices, a.person.skin)
    there = blended(b.person.vertices, b.person.skin[match.face], match.barycentric)
    return closest_points(there, triangle_index(b.points, b.faces)).point


def carried(a: Scan, b: Scan, rows: Integer[Array, "k"]) -> Float[Array, "shapes k 3"]:
    """What one scan's shapes move vertices of another by, through both templates, metres."""
    template, skin = a.person.vertices, a.person.skin
    used = np.unique(skin)
    on_scan = match_surface(template[used], vertex_normals(template, skin)[used], a.points, a.faces)
    flat = lambda offsets: offsets.transpose(1, 0, 2).reshape(offsets.shape[1], -1).astype(np.float64)
    of_template = np.zeros((len(template), 3 * len(a.shapes)))
    of_template[used] = blended(flat(a.offsets), a.faces[on_scan.face], on_scan.barycentric)
    normals = vertex_normals(b.points, b.faces)[rows]
    match = match_surface(b.points[rows], normals, b.person.vertices, b.person.skin)
    found = blended(of_template, b.person.skin[match.face], match.barycentric)
    return found.reshape(len(rows), -1, 3).transpose(1, 0, 2)


def pair_scores(a: Scan, b: Scan) -> JsonObject:
    """What the module's docstring says of one pair; lengths in mm."""
    same, back = same_vertices(a, b), same_vertices(b, a)
    regions: JsonObject = {}
    for region, (names, share, _) in REGIONS.items():
        length = a.length(names)
        rows = np.flatnonzero(a.seen & (same >= 0) & (length > share * length.max()))
        off = 1e3 * np.linalg.norm(landed(a, b, rows) - b.points[same[rows]], axis=1)
        regions[region] = np.sort(off).round(3).tolist()
    rows = np.flatnonzero(b.seen & (back >= 0) & (np.linalg.norm(b.offsets, axis=2).max(0) > STILL))
    through, by_uv, own = carried(a, b, rows), a.offsets[:, back[rows]], b.offsets[:, rows]
    motion: list[list[float]] = []
    for ours, theirs, truth in zip(through, by_uv, own):
        length = np.linalg.norm(truth, axis=1)
        moves = length > STILL
        if length.max() > LEAST:
            off = (np.linalg.norm(one - truth, axis=1)[moves].mean() for one in (ours, theirs))
            motion.append([round(float(one / length[moves].mean()), 4) for one in off])
    return {"from": a.name, "to": b.name, "regions": regions, "motion": motion}


def summary(pairs: list[JsonObject]) -> JsonObject:
    """Medians and 9 in 10 of all pairs' points, and the range of the pairs' medians; means of the shapes."""
    out: JsonObject = {}
    for region, (*_, goal) in REGIONS.items():
        off = np.concatenate([pair["regions"][region] for pair in pairs])
        medians = [float(np.median(pair["regions"][region])) for pair in pairs]
        out[region] = {
            "points": len(off), "median_mm": round(float(np.median(off)), 2),
            "p90_mm": round(float(np.percentile(off, 90)), 2),
            "pairs_mm": [round(min(medians), 2), round(max(medians), 2)], "goal_mm": goal,
        }  # fmt: skip
    motion = np.concatenate([pair["motion"] for pair in pairs])
    through, differ = motion.mean(0).round(3).tolist()
    out["pairs"] = [
        {"from": pair["from"], "to": pair["to"], "error_of_motion": np.mean(pair["motion"], 0).round(3).tolist()}
        | {f"{region}_mm": round(float(np.median(pair["regions"][region])), 2) for region in REGIONS}
        for pair in pairs
    ]
    out["shapes"] = {"count": len(motion), "error_of_motion": through, "people_differ": differ}
    return out


def markdown(kinds: dict[str, JsonObject]) -> str:
    """The table of summaries, by kind of template."""
    rows = [
        [region, kind, str(one["points"]), f"{one['median_mm']:.1f}",
         " to ".join(f"{mm:.1f}" for mm in one["pairs_mm"]), f"{one['p90_mm']:.1f}", f"{one['goal_mm']:g}"]
        for region in REGIONS for kind, found in kinds.items() for one in (found[region],)
    ]  # fmt: skip
    head = ["region", "template", "points", "median mm", "of single pairs", "9 in 10 mm", "goal mm"]
    lines = [
        "# Correspondence of faces against truth",
        "",
        "Four scans, twelve ordered pairs (`python -m experiments.face_correspondence`): a point of one person carried",
        "to another through both templates, off the true one by",
        "",
        *markdown_table(head, rows),
        "",
        *(
            f"Shapes carried from one to another, {kind} ({found['shapes']['count']}): error "
            f"{found['shapes']['error_of_motion']:.2f} of the motion (goal {GOAL:g}; with true correspondence "
            f"{found['shapes']['people_differ']:.2f}: so much people differ)."
            for kind, found in kinds.items()
        ),
    ]
    return "\n".join(lines) + "\n"


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("SELFSCAN_DATA", "../shared/data")))
    parser.add_argument("--templates", type=Path, help="of people from pixels, in place of registering")
    arguments = parser.parse_args(argv)
    arguments.out.mkdir(parents=True, exist_ok=True)
    scans = [read_scan(arguments.data, name, arguments.out, arguments.templates) for name in PEOPLE]
    baked = [scan._replace(person=scan.baked) for scan in scans]
    found: dict[str, JsonObject] = {}
    for kind, people in (("as registered", scans), ("as baked", baked)):
        found[kind] = summary([pair_scores(a, b) for a in people for b in people if a is not b])
    text = markdown(found)
    write_json(arguments.out / "face_correspondence.json", found)
    write_text(arguments.out / "face_correspondence.md", text)
    print(text)
    return 0


if __name__ == "__main__":
    end_with(main)
