"""The trained field of a run made ready for drawing: its fine surface on the zero set, answered for by torch."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from jaxtyping import Float

from avatar.light import CaptureLight
from avatar.skeleton import BIG_POSE
from avatar.skinning import SkinWeights
from bake.cone import view_cone
from bench.posed_field import PosableSurface, PosedField
from train.fused import FusedField
from train.run import Run

CHUNK = 1 << 16  # field queries at once
# metres: a vertex is not moved farther than this in one step onto the zero set
FARTHEST = 0.002
CLOSE = 5e-5  # metres: nearer than this counts as on it


@contextmanager
def one_thread() -> Iterator[None]:
    """Torch on one thread: on a machine that others use too, its threads wait for each other by spinning, and a
    picture of the field was measured to take seven times its processor seconds on two."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@one_thread()
def field_view(run: Run) -> PosedField:
    """A run's field with its fine surface, skin and view cone."""
    s = run.surface
    surface = PosableSurface(
        on_zero_set(run.field, np.asarray(s.vertices, np.float64)),
        np.asarray(s.faces, np.int64),
        SkinWeights(s.skin.joints.astype(np.int64), s.skin.weights),
        np.asarray(run.subject.joints, np.float64),
        BIG_POSE,
    )
    count, mean, covariance, normals = (
        np.asarray(a, np.float64) for a in (s.view_count, s.view_mean, s.view_covariance, s.normals)
    )
    cone = view_cone(count, mean, covariance, normals, surface.faces)
    answers, light = FieldAnswers(run.field), run.world_light
    lit = None if light is None else lambda *asked: answers.lit(light, *asked)
    return PosedField(surface, cone, answers.distance, answers.color, lit)


class FieldAnswers:
    """A torch field asked with arrays, a piece at a time."""

    def __init__(self, field: FusedField):
        self.field = field

    @one_thread()
    def distance(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Signed distance of canonical points, metres."""
        out = np.empty(len(points), np.float32)
        with torch.no_grad():
            for start in range(0, len(points), CHUNK):
                x = torch.as_tensor(points[start : start + CHUNK], dtype=torch.float32)
                out[start : start + CHUNK] = self.field.distance(x).numpy()
        return out

    @one_thread()
    def color(self, points: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Color of canonical points on the surface at given unit directions."""
        out = np.empty((len(points), 3), np.float32)
        with torch.no_grad():
            for start in range(0, len(points), CHUNK):
                x = torch.as_tensor(points[start : start + CHUNK], dtype=torch.float32)
                d = torch.as_tensor(directions[start : start + CHUNK], dtype=torch.float32)
                out[start : start + CHUNK] = self.field.color(x, d).clamp(0, 1).numpy()
        return out

    @one_thread()
    def lit(
        self,
        light: CaptureLight,
        points: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        rotations: Float[np.ndarray, "n 3 3"],
        towards_eye: Float[np.ndarray, "n 3"],
    ) -> Float[np.ndarray, "n 3"]:
        """Color of canonical points under a light of the world; `rotations` are world_from_canonical."""
        out = np.empty((len(points), 3), np.float32)
        for start in range(0, len(points), CHUNK):
            own = slice(start, start + CHUNK)
            x, d = (torch.as_tensor(a[own], dtype=torch.float32) for a in (points, directions))
            with torch.no_grad():
                albedo, normals = (
                    a.numpy().astype(np.float64) for a in (self.field.albedo(x, d), self.field.light_normal(x))
                )
            normals = np.einsum("nij,nj->ni", rotations[own], normals)
            out[own] = light.shown(albedo, light.shading(normals), light.highlight(normals, towards_eye[own]))
        return out


def on_zero_set(field: FusedField, points: Float[np.ndarray, "n 3"], steps: int = 2) -> Float[np.ndarray, "n 3"]:
    """Points near the surface moved along the gradient onto the zero set: Newton steps, each at most FARTHEST."""
    moved = torch.as_tensor(points, dtype=torch.float32).clone()
    with torch.no_grad():
        for start in range(0, len(moved), CHUNK):
            part = moved[start : start + CHUNK]
            for _ in range(steps):
                distance = field.distance(part)
                # what lies farther off is no surface of the field's but where layers were divided (train/layers.py)
                off = (distance.abs() > CLOSE) & (distance.abs() < 3 * FARTHEST)
                if not bool(off.any()):
                    break
                step = distance[off].clamp(-FARTHEST, FARTHEST)[:, None] * field.normal(part[off])
                part[off] = part[off] - step
    return moved.numpy().astype(np.float64)
