"""The built-in body with a made-up face: a jaw that drops and lids that close over two balls."""

from dataclasses import replace
from functools import cache

import numpy as np
import trimesh

from avatar.baked_avatar import Avatar
from avatar.face import SHAPES, Eye, FaceFrame, FaceShapes
from player.scene.mannequin import mannequin

HEAD, RADIUS = 15, 0.012


def ball(center):
    """Points of a sphere and its triangles, seen from outside."""
    sphere = trimesh.creation.icosphere(subdivisions=2)
    points = np.asarray(sphere.vertices)
    return (center + RADIUS * points).astype(np.float32), points.astype(np.float32), np.asarray(sphere.faces)


@cache
def faced() -> Avatar:
    avatar = mannequin()
    level = avatar.levels[0]
    head = np.flatnonzero((level.joints[:, 0] == HEAD) & (level.weights[:, 0] > 200))
    points = level.positions[head].astype(np.float64)
    front, middle = points[:, 2].max() - 0.02, points.mean(0)
    eyes = tuple(
        Eye(np.array([x, middle[1] + 0.02, front - 0.012]), np.array([0.0, 0.0, 1.0]), RADIUS) for x in (0.033, -0.033)
    )
    offsets = np.zeros((len(SHAPES), len(head), 3), np.float32)
    jaw = (points[:, 1] < middle[1] - 0.05) & (points[:, 2] > middle[2])
    offsets[SHAPES.index("jawOpen"), jaw] = [0, -0.03, -0.005]
    for eye, side in zip(eyes, ("Left", "Right")):
        near = np.linalg.norm(points - eye.center, axis=1) < 0.03
        offsets[SHAPES.index(f"eyeBlink{side}"), near] = 0.8 * (eye.center - points[near])
        offsets[SHAPES.index(f"eyeWide{side}"), near] = 0.3 * (points[near] - eye.center)
    moved = offsets.any((0, 2))
    balls, first = [], len(level.positions)
    fields = {name: [getattr(level, name)] for name in ("positions", "normals", "uv", "joints", "weights", "faces")}
    for eye in eyes:
        positions, normals, faces = ball(eye.center)
        count = len(positions)
        fields["positions"].append(positions), fields["normals"].append(normals)
        fields["uv"].append(np.full((count, 2), 0.5, np.float32) + 0.02 * normals[:, :2])
        fields["joints"].append(np.tile(np.array([HEAD, 0, 0, 0], np.uint8), (count, 1)))
        fields["weights"].append(np.tile(np.array([255, 0, 0, 0], np.uint8), (count, 1)))
        fields["faces"].append((faces + first).astype(np.uint32))
        balls.append([first, count])
        first += count
    whole = {name: np.concatenate(parts) for name, parts in fields.items()}
    pad = first - len(level.positions)
    face = FaceShapes(head[moved].astype(np.uint32), offsets[:, moved], np.array(balls, np.uint32))
    level = replace(
        level, **whole, face=face, view_dir=-whole["normals"], view_q=np.pad(level.view_q, ((0, pad), (0, 0))),
        view_seen=np.pad(level.view_seen, (0, pad)),
    )  # fmt: skip
    return replace(avatar, levels=(level,), eyes=eyes)


def doing(gaze=(0.0, 0.0), **weights: float) -> FaceFrame:
    """A frame of a face: weights by name of shape, and where both eyes look, radians."""
    return FaceFrame(np.array([weights.get(name, 0.0) for name in SHAPES]), np.array([gaze, gaze]))
