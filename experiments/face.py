"""What a baked face does: holes in the head at each shape, what is seen of closed eyes, lids beside their balls, lips.

    python -m experiments.face AVATAR.glb [--json FILE]

A hole is a pixel inside the head's outline that shows the background, with every shape alone at .5 and 1, from the
front, from 30 and 60 degrees to one side and 30 to the other, and from 20 degrees below, at 512 pixels. Shapes are
blended here with NumPy, and the level drawn as one that stays still.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Integer
from numpy import ndarray as Array
from scipy.ndimage import binary_fill_holes

from avatar.baked_avatar import Avatar, Level
from avatar.camera import Camera, orbit_camera
from avatar.face import SHAPES, SIDES
from avatar.gltf.avatar_file import read_avatar
from avatar.skeleton import JOINTS, joint_transforms
from experiments.program import end_with
from player.scene.effects import Background, Effects
from player.scene.offscreen import OffscreenRenderer

VIEWS = {"front": (0, 0), "left": (30, 0), "right": (-30, 0), "side": (60, 0), "below": (0, -20)}
MAGENTA = (1.0, 0.0, 1.0, 1.0)
PLAIN = Effects(view="off", antialiasing="none")


def posed(level: Level, weights: Float[Array, "52"]) -> Level:
    """The level with its face so, as one that stays still."""
    assert level.face is not None
    points = level.positions.copy()
    points[level.face.vertices] += np.einsum("s,svc->vc", weights, level.face.offsets).astype(np.float32)
    return replace(level, positions=points, face=None)


def weights_of(**values: float) -> Float[Array, "52"]:
    """Weights of some shapes by name; one without a side is both sides'."""
    out = np.zeros(len(SHAPES))
    for name, value in values.items():
        for number, shape in enumerate(SHAPES):
            if shape in (name, *(f"{name}{side.title()}" for side in SIDES)):
                out[number] = value
    return out


def cameras(avatar: Avatar, size: int = 512) -> dict[str, Camera]:
    """VIEWS of the head in the T-pose."""
    head = joint_transforms(np.zeros((52, 3)), avatar.joint_positions, np.zeros(3))[JOINTS.index("head"), :3, 3]
    middle = head + [0, 0.075, 0.03]
    return {
        name: orbit_camera(middle, 0.75, np.radians(azimuth), np.radians(elevation), (size, size), 0.42)
        for name, (azimuth, elevation) in VIEWS.items()
    }


def drawn(avatar: Avatar, level: Level) -> dict[str, Float32[Array, "height width 3"]]:
    """A still level from all VIEWS, before magenta."""
    alone = replace(avatar, levels=(level,), eyes=None)
    with OffscreenRenderer(alone, (512, 512), effects=PLAIN, background=Background(color=MAGENTA)) as renderer:
        return {
            name: renderer.draw(np.zeros((52, 3)), np.zeros(3), camera).astype(np.float32)
            for name, camera in cameras(avatar).items()
        }


def holes(picture: Float32[Array, "height width 3"]) -> int:
    """Pixels of magenta inside the outline."""
    there = np.abs(picture - [255, 0, 255]).sum(2) > 3
    return int((np.asarray(binary_fill_holes(there)) & ~there).sum())


def lips(level: Level) -> tuple[Integer[Array, "n"], Integer[Array, "n"]]:
    """Vertices of the upper and of the lower lip that lie in one place at rest and part when the jaw opens."""
    assert level.face is not None
    own = level.face.vertices
    place = np.round(level.positions[own] * 1e6).astype(np.int64)
    order = np.lexsort(place.T)
    same = (place[order[1:]] == place[order[:-1]]).all(1)
    a, b = order[:-1][same], order[1:][same]
    down = level.face.offsets[SHAPES.index("jawOpen"), :, 1]
    apart = np.abs(down[a] - down[b]) > 2e-3
    a, b = a[apart], b[apart]
    upper = down[a] > down[b]
    return own[np.where(upper, a, b)], own[np.where(upper, b, a)]


def lid_gaps(avatar: Avatar, level: Level) -> dict[str, float]:
    """How far the nearest vertex of the lids is off its ball at rest and while it closes, mm."""
    assert level.face is not None and avatar.eyes is not None
    found = {}
    # what was made anew, the rims among it, was seen from nowhere
    filmed = np.zeros(len(level.positions), bool)
    filmed[level.face.vertices] = level.view_seen[level.face.vertices] > 0
    for weight in (0.0, 0.25, 0.5, 0.75, 1.0):
        points = posed(level, weights_of(eyeBlink=weight)).positions
        least = np.inf
        for eye in avatar.eyes:
            offset = points - eye.center
            near = filmed & (np.linalg.norm(level.positions - eye.center, axis=1) < 0.018) & (offset[:, 2] > 0)
            least = min(least, float(np.linalg.norm(offset[near], axis=1).min() - eye.radius))
        found[f"{weight:g}"] = round(1e3 * least, 3)
    return found


def ball_pixels(avatar: Avatar, level: Level, weights: Float[Array, "52"]) -> dict[str, int]:
    """Pixels of the balls that each view shows."""
    assert level.face is not None
    still = posed(level, weights)
    paint = np.array(still.uv)
    for first, count in level.face.balls:
        # the strip's last texel, which is made green
        paint[first : first + count] = (np.array(still.base_color.shape[1::-1]) - 0.5) / still.base_color.shape[1::-1]
    image = still.base_color.copy()
    image[-4:, -4:] = (0, 255, 0)
    pictures = drawn(avatar, replace(still, uv=paint, base_color=image))
    return {name: int((np.abs(one - [0, 255, 0]).sum(2) < 60).sum()) for name, one in pictures.items()}


def measured(avatar: Avatar) -> dict[str, object]:
    """All of it for the finest level."""
    level = avatar.levels[0]
    assert level.face is not None
    worst = {}
    for name in ("rest", *SHAPES):
        for weight in (0.0,) if name == "rest" else (0.5, 1.0):
            weights = np.zeros(len(SHAPES)) if name == "rest" else weights_of(**{name: weight})
            found = {view: holes(one) for view, one in drawn(avatar, posed(level, weights)).items()}
            if any(found.values()) or name == "rest":
                worst[f"{name} {weight:g}"] = found
    upper, lower = lips(level)
    gaps = {}
    for weight in (0.5, 1.0):
        points = posed(level, weights_of(jawOpen=weight, mouthClose=weight)).positions
        gaps[f"{weight:g}"] = round(1e3 * float(np.linalg.norm(points[upper] - points[lower], axis=1).max()), 3)
    blinks = {f"{w:g}": ball_pixels(avatar, level, weights_of(eyeBlink=w)) for w in (0.0, 0.5, 0.75, 1.0)}
    entries = int(level.face.offsets.any(2).sum())
    return {
        "holes": worst, "ball_pixels": blinks, "lids_off_ball_mm": lid_gaps(avatar, level), "mouth_close_gap_mm": gaps,
        "moving": len(level.face.vertices), "entries": entries, "sparse_bytes": 14 * entries,
    }  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m experiments.face", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("avatar", type=Path)
    parser.add_argument("--json", type=Path, help="file to write")
    arguments = parser.parse_args(argv)
    found = measured(read_avatar(arguments.avatar))
    text = json.dumps(found, indent=1)
    print(text)
    if arguments.json:
        arguments.json.write_text(text + "\n")
    return 0


if __name__ == "__main__":
    end_with(main)
