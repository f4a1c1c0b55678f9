"""A ball of 10 cm in the charts of a texture."""

from typing import NamedTuple

import numpy as np
from capsules import ball_mesh

from bake.atlas import Unwrapped, unwrap
from bake.texture.seams import ChartEdges, chart_edges
from bake.texture.texels import TexelMap, barycentric, rasterise_charts
from geometry.decimate import decimate
from geometry.mesh import TriangleMesh


class ChartedBall(NamedTuple):
    chart: Unwrapped
    texels: TexelMap
    edges: ChartEdges
    # of each triangle of the charts
    corners: np.ndarray
    # of each texel
    points: np.ndarray
    mesh: TriangleMesh


def charted_ball(size: int, padding: int, *, faces: int = 800, step: float = 0.006, above: float = 1.0) -> ChartedBall:
    """Unwrapped into size x size texels; 2.5 times as dense above a height, metres."""
    mesh = decimate(ball_mesh(step=step), faces)
    dense = (mesh.vertices[mesh.faces].mean(1)[:, 1] > above).astype(int)
    chart = unwrap(mesh.vertices, mesh.faces, dense, np.array([1.0, 2.5]), size=size, padding=padding)
    texels = rasterise_charts(chart.uv, chart.faces, size)
    corners = mesh.vertices[chart.source][chart.faces]
    weight = barycentric(chart.uv, chart.faces, texels, np.zeros(2))
    points = (weight[:, :, None] * corners[texels.face]).sum(1)
    return ChartedBall(chart, texels, chart_edges(chart.uv, chart.faces, chart.source), corners, points, mesh)


def line(count: int) -> TexelMap:
    """So many texels in a row."""
    return TexelMap(np.arange(count), np.zeros(count, int), np.ones(count, bool), count)
