"""A surface as a bake would have it, without baking: the built-in face from the front, lips closed, with eyeballs."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array
from painted_capture import free_subject
from scipy.ndimage import grey_closing

from avatar.baked_avatar import Level
from avatar.face_template import builtin_face
from avatar.skeleton import JOINTS
from bake.face.features import FAR, PIXEL, front_camera
from bake.face.template import PersonFace, person_face
from capture.folder import CaptureSubject
from geometry.closest import beyond_loop
from geometry.mesh import vertex_normals
from geometry.rasterise import rasterise

# metres between vertices, which lie on a grid
STEP = 0.0015
SKIN, LIPS, WHITE, IRIS = (0.8, 0.6, 0.5), (0.45, 0.2, 0.2), (0.85, 0.83, 0.8), (0.25, 0.35, 0.5)


class FaceSheet(NamedTuple):
    """A level that is a sheet before the built-in face, and that face."""

    level: Level
    person: PersonFace
    subject: CaptureSubject


def face_sheet(texels: int = 512, lids: float = 0.0) -> FaceSheet:
    """The sheet, its lips' line, whites and irises painted; lids end so many metres above the template's."""
    subject = free_subject("male")
    person = person_face(subject)
    low, high = (f(person.vertices[person.skin].reshape(-1, 3), axis=0) for f in (np.min, np.max))
    x = np.arange(person.eyes.centres[:, 0].min() - 0.03, person.eyes.centres[:, 0].max() + 0.03, STEP)
    y = np.arange(low[1] + 0.02, high[1] - 0.02, STEP)
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    points = np.c_[grid, heights(x, y, person)]
    columns, rows = len(x), len(y)
    number = np.arange(columns * rows).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    uv = (grid - grid.min(0)) / np.ptp(grid, axis=0) * 0.98 + 0.01
    normals, count = vertex_normals(points, faces), len(points)
    at = grid.min(0) + ((np.mgrid[:texels, :texels][::-1].reshape(2, -1).T + 0.5) / texels - 0.01) / 0.98 * np.ptp(
        grid, axis=0
    )
    ones = np.eye(1, 4, dtype=np.uint8).repeat(count, 0)
    level = Level(
        points.astype(np.float32), normals.astype(np.float32), uv.astype(np.float32), faces.astype(np.uint32),
        ones * JOINTS.index("head"), ones * 255, -normals.astype(np.float32), np.zeros((count, 6), np.float32),
        np.ones(count, np.float32), (255 * painted(at, person, lids)).astype(np.uint8).reshape(texels, texels, 3),
        np.full((texels // 2, texels // 2, 4), 128, np.uint8),
    )  # fmt: skip
    return FaceSheet(level, person, subject)


def heights(x: Array, y: Array, person: PersonFace) -> Array:
    """z of the template's outermost skin, or of an eyeball that lies before it, on a grid; lips touch."""
    low, high = np.array([x[0], y[0], 0.0]), np.array([x[-1], y[-1], person.vertices[:, 2].max()])
    depth = rasterise(person.vertices, person.skin, front_camera(low, high)).depth[::-1]
    z = FAR + high[2] - depth[np.ix_(*(np.round((v - v[0]) / PIXEL).astype(int) for v in (y, x)))]
    z = np.where(np.isfinite(z), z, person.vertices[person.skin, 2].min())
    lips = y < person.eyes.centres[0, 1] - 0.04
    z[lips] = grey_closing(z[lips], 5)
    for center, radius in zip(*person.eyes):
        deep = radius**2 - (y[:, None] - center[1]) ** 2 - (x - center[0]) ** 2
        z = np.where(deep > 0, np.maximum(z, center[2] + np.sqrt(np.maximum(deep, 0))), z)
    return z.ravel()


def painted(at: Array, person: PersonFace, lids: float = 0.0) -> Array:
    """sRGB of places seen from the front."""
    color = np.tile(SKIN, (len(at), 1))
    upper, lower = (person.vertices[half] for half in builtin_face().seam)
    middle = 0.5 * (np.interp(at[:, 0], *upper[:, :2].T) + np.interp(at[:, 0], *lower[np.argsort(lower[:, 0]), :2].T))
    color[(np.abs(at[:, 1] - middle) < 0.0015) & (at[:, 0] > upper[0, 0]) & (at[:, 0] < upper[-1, 0])] = LIPS
    for center, (upper, lower) in zip(person.eyes.centres, person.face.lids):
        away = np.linalg.norm(at - center[:2], axis=1)
        near = np.flatnonzero(away < 0.02)
        edge = person.vertices[np.r_[upper, lower[-2:0:-1]], :2] + [0, lids]
        open_ = near[beyond_loop(at[near], edge) < 0.0005]
        color[open_] = np.where(away[open_, None] < 0.006, IRIS, WHITE)
        color[open_[away[open_] < 0.0024]] = 0.04
    return color
