"""The picture of one row: truth, row and their difference in a novel pose, and close-ups of neck and wrists.

The close-ups are in the T-pose, in colour and as lit geometry; a row's are put between those of the truth and of
ours, which the row "ours" leaves in the same folder.
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image

from avatar.camera import Camera, orbit_camera
from avatar.skeleton import JOINTS
from avatar.texture import bytes_of
from bench.field.drawer import Drawer
from bench.ladder.rung_pictures import spread_poses
from bench.report.sheet import save_sheet, sheet
from bench.score.metrics import rectangle
from bench.score.picture_scores import is_t_pose
from bench.score.true_mesh import TrueMesh
from capture.held_out import HeldOutView
from experiments.ceiling import true_subject
from files.picture import read_picture
from files.whole import whole_file
from player.draw.raster import Rasteriser
from synth.light import light_of
from synth.photo import Studio

VIEW_TITLE = {"body": "", "head": "face", "hand_left": "left hand", "hand_right": "right hand"}
SIDE = 260  # pixels of a close-up
# differences are shown so many times as large
DIFFERENCE = 3.0
PLACES = {"neck": "neck", "wrist_left": "left_wrist", "wrist_right": "right_wrist"}
KINDS = ("colour", "shape")


def write_sheet(
    drawer: Drawer,
    truth: TrueMesh,
    capture: Path,
    facts: dict[str, Any],
    views: list[HeldOutView],
    title: str,
    out: Path,
    seams: dict[str, dict[str, float | None]] | None,
) -> None:
    """Write `out`.png; with `seams`, the close-ups as well."""
    rows, titles = [], []
    bent = [view for view in views if not is_t_pose(view)]
    for kind in ("body", "head", "hand_left", "hand_right"):
        for view in spread_poses(bent, kind, 1):
            true, ours = view.image(), drawer.draw(view.axis_angle, view.root, view.camera, 2).color
            apart = np.clip(DIFFERENCE * np.abs(ours - true), 0, 1)
            where = square_about(view)
            rows.append([bytes_of(picture[where]) for picture in (true, ours, apart)])
            name = f"{VIEW_TITLE[kind]}, pose {view.pose_index}".lstrip(", ")
            titles.append([f"truth: {name}", out.name, f"difference x {DIFFERENCE:.0f}"])
    if seams is not None:
        close = close_ups(drawer, truth, capture, facts, out)
        for kind in KINDS:
            for place in PLACES:
                names = [name for name in ("truth", "ours", out.name) if (name, place, kind) in close]
                names = list(dict.fromkeys(names))
                rows.append([close[name, place, kind] for name in names])
                titles.append([f"{place.replace('_', ' ')}: {name}" for name in names[:-1]])
                titles[-1].append(f"{names[-1]}: {seam_text(seams.get(place, {}))}")
    heading = f"{title}: {facts.get('subject', capture.name)}, {facts.get('light', '?')} light"
    save_sheet(out.with_suffix(".png"), sheet(rows, titles, heading, columns=2))


def seam_text(seam: dict[str, float | None]) -> str:
    """A seam's two numbers in the caption of its close-up."""
    step, colour = seam.get("step_mm"), seam.get("shown_color_step")
    texts = [f"{step:.2f} mm"] if step is not None else []
    texts += [f"colour {colour:.1f}"] if colour is not None else []
    return ", ".join(texts)


def square_about(view: HeldOutView) -> tuple[slice, slice]:
    """The whole close-up; of a body view the square round the person, a little wider."""
    width, height = view.camera.size
    where = rectangle(view.mask()) if view.view == "body" else None
    if where is None:
        return slice(0, height), slice(0, width)
    (top, bottom), (left, right) = ((side.start, side.stop - 1) for side in where)
    side = min(int(1.06 * max(bottom - top, right - left)) + 4, height, width)
    top = int(np.clip((top + bottom - side) // 2, 0, height - side))
    left = int(np.clip((left + right - side) // 2, 0, width - side))
    return slice(top, top + side), slice(left, left + side)


def close_ups(
    drawer: Drawer, truth: TrueMesh, capture: Path, facts: dict[str, Any], out: Path
) -> dict[tuple[str, str, str], UInt8[np.ndarray, "side side 3"]]:
    """Tiles by (row, place, kind): this row's, and those of the truth and of ours that are kept beside `out`."""
    pose = np.zeros((52, 3)), np.zeros(3)
    folder = out.parent / "close-ups"
    folder.mkdir(exist_ok=True)
    tiles = {}
    if out.name == "ours":
        studio = Studio(drawer.raster, true_subject(capture, truth), 2, float(facts.get("sheen", 0.0)))
        light = light_of(facts["light"], "body", int(facts["seed"]))
        for place, camera in cameras(drawer.surface.joints).items():
            posed = truth.posed(*pose)
            photo = studio.take(posed, camera, light)
            tiles["truth", place, "colour"] = photo.image * (photo.mask > 127)[..., None]
            tiles["truth", place, "shape"] = lit_shape(drawer.raster, posed, truth.faces, camera)
    for place, camera in cameras(drawer.surface.joints).items():
        colour = drawer.draw(*pose, camera, 2).color
        tiles[out.name, place, "colour"] = bytes_of(colour)
        posed = drawer.surface.posed(*pose)
        tiles[out.name, place, "shape"] = lit_shape(drawer.raster, posed, drawer.surface.faces, camera)
    if out.name == "ours":
        for (name, place, kind), tile in tiles.items():
            with whole_file(folder / f"{name}_{place}_{kind}.png") as file:
                Image.fromarray(tile).save(file, "PNG")
    else:
        for name in ("truth", "ours"):
            for place in PLACES:
                for kind in KINDS:
                    path = folder / f"{name}_{place}_{kind}.png"
                    if path.exists():
                        tiles[name, place, kind] = read_picture(path)
    return tiles


def cameras(joints: Float[np.ndarray, "52 3"]) -> dict[str, Camera]:
    """A camera for each seam, T-pose, pelvis at the origin; about 30 cm wide."""
    out = {}
    for place, joint in PLACES.items():
        target = joints[JOINTS.index(joint)] - joints[0]
        outward = np.sign(target[0]) if place != "neck" else 0.0
        target = target + [-0.03 * outward, 0.0, 0.0]  # the wrist's overlap begins on the forearm
        azimuth, elevation = (0.35, 0.0) if place == "neck" else (0.0, 0.6)
        out[place] = orbit_camera(target, 1.2, azimuth, elevation, (SIDE, SIDE), 0.25)
    return out


def lit_shape(
    raster: Rasteriser, posed: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], camera: Camera
) -> UInt8[np.ndarray, "height width 3"]:
    """The bare surface in grey, flat faces, lit from above the camera."""
    fragments = raster.draw(posed, faces, camera)
    hit = fragments.face >= 0
    a, b, c = posed[faces[fragments.face[hit]]].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    R = camera.camera_from_world[:3, :3]
    light = np.array([-0.35, -0.75, -0.55]) @ R  # camera frame: right, down, forward
    image = np.zeros((*fragments.face.shape, 3), np.float64)
    image[hit] = (30 + 190 * np.abs(normals @ light))[:, None]
    return np.clip(image, 0, 255).astype(np.uint8)
