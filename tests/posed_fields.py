"""Fields made up for the built-in body, ready to be drawn."""

from pathlib import Path

import numpy as np
import torch
from painted_capture import free_subject
from scipy.spatial import KDTree

from bench.field.posed_field import PosedField
from train.fused import FusedField
from train.preset import DEMO
from train.run import Run
from train.surface import Surface


def run_of(make_field):
    """The built-in body as a run's surface, over a field made for its canonical vertices."""
    subject = free_subject("male")
    count = len(subject.vertices)
    surface = Surface(
        vertices=subject.vertices,
        faces=subject.faces,
        normals=np.tile([0.0, 0, 1], (count, 1)),
        part=np.zeros(count, np.int64),
        skin=subject.skin,
        view_count=np.full(count, 40.0),
        view_mean=np.tile([0.0, 0, -0.9], (count, 1)),
        view_covariance=np.tile([0.01, 0, 0, 0.01, 0, 0], (count, 1)),
        layer=np.zeros(count, np.int64),
    )
    return Run(Path("run"), make_field(subject.vertices, subject.faces), surface, subject, DEMO, {})


def view_of(make_field):
    """The same ready for drawing."""
    return PosedField(run_of(make_field))


class NearField(FusedField):
    """The signed distance to the tangent plane of the nearest vertex, in smooth stripes."""

    def __init__(self, vertices, faces):
        torch.nn.Module.__init__(self)
        corners = vertices[faces]
        normals = np.zeros_like(vertices)
        np.add.at(normals, faces, np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, None])
        self.tree, self.at = KDTree(vertices), vertices
        self.register_buffer("weights", torch.zeros(1000))
        self.normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def distance(self, points):
        points = points.double().numpy()
        near = self.tree.query(points)[1]
        return torch.as_tensor(((points - self.at[near]) * self.normals[near]).sum(1)).float()

    def normal(self, points):
        return torch.as_tensor(self.normals[self.tree.query(points.double().numpy())[1]]).float()

    def color(self, points, directions):
        return 0.5 + 0.3 * torch.sin(20 * points)
