"""One avatar under inspection: what its sections share, what they give, and colored meshes drawn by PyVista off screen.

VTK finds a context by itself, first on an X server. Without one it complains and goes on; so where our own context
was reached through EGL, VTK has to take EGL at once, and where through OSMesa, OSMesa.
"""

import os
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Real, UInt8
from numpy import ndarray as Array

from avatar.baked_avatar import Avatar, Level
from avatar.camera import Camera
from bench.inspect.page import Check, PageSection
from bench.inspect.views import DISTANCE, standard_views, strip
from bench.report.writer import Json
from player.gl.context import Context

WINDOWS = {"egl": "vtkEGLRenderWindow", "osmesa": "vtkOSOpenGLRenderWindow"}
BACKGROUND = (246, 246, 244)
GREY = (196, 196, 192)
# metres that lines stand off the surface, so as not to sink into it
LIFT = 0.0004


class ColoredLines(NamedTuple):
    """Edges of a mesh that are drawn a little above it."""

    edges: Int[Array, "edges 2"]
    colors: UInt8[Array, "edges 3"]


class MeshPlotter:
    """Draws meshes from the standard views; `kind` is how our own OpenGL context was reached."""

    def __init__(self, cameras: list[Camera], kind: str):
        if sys.platform == "linux" and kind in WINDOWS:
            os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", WINDOWS[kind])
        # VTK reads the variable as it is imported
        import pyvista

        self.pyvista, self.cameras = pyvista, cameras
        self.plotters = {}
        for size in {camera.size for camera in cameras}:
            plotter = pyvista.Plotter(off_screen=True, window_size=list(size), lighting="none")
            plotter.renderer.SetBackground(*(c / 255 for c in BACKGROUND))
            plotter.add_light(pyvista.Light(light_type="headlight", intensity=1.0))
            plotter.enable_anti_aliasing("ssaa")
            self.plotters[size] = plotter

    def draw(
        self, level: Level, colors: UInt8[Array, "n 3"], lines: ColoredLines | None, *, wire: bool
    ) -> UInt8[Array, "height width 3"]:
        """The strip of views; colors are one a vertex or one a triangle. `wire` draws the edges in close views."""
        pv = self.pyvista
        points, faces = level.positions.astype(np.float64), level.faces.astype(np.int64)
        mesh = pv.PolyData.from_regular_faces(points.astype(np.float32), faces)
        mesh["rgb"] = colors
        shading = {"scalars": "rgb", "rgb": True, "ambient": 0.35, "diffuse": 0.65, "specular": 0.0}
        edges = None
        if lines is not None and len(lines.edges):
            raised = points + LIFT * level.normals.astype(np.float64)
            table = np.concatenate([np.full((len(lines.edges), 1), 2), lines.edges], axis=1)
            edges = pv.PolyData(raised.astype(np.float32), lines=table.ravel())
            edges["rgb"] = lines.colors
        for plotter in self.plotters.values():
            plotter.clear_actors()
        near = min(size for size, _ in self.plotters)
        for size, plotter in self.plotters.items():
            plotter.add_mesh(mesh, show_edges=wire and size[0] == near, edge_color="#404040", line_width=1, **shading)
            if edges is not None:
                plotter.add_mesh(edges, scalars="rgb", rgb=True, line_width=3, lighting=False)
        return strip([self._from(camera) for camera in self.cameras])

    def _from(self, camera: Camera) -> UInt8[Array, "height width 3"]:
        plotter = self.plotters[camera.size]
        own, target = plotter.camera, camera.eye + DISTANCE * camera.camera_from_world[2, :3]
        own.position, own.focal_point, own.up = camera.eye, target, (0.0, 1.0, 0.0)
        own.view_angle = float(np.degrees(2 * np.arctan(0.5 * camera.size[1] / camera.K[1, 1])))
        own.clipping_range = (0.5, 12.0)
        plotter.render()
        return np.asarray(plotter.screenshot(return_img=True))[..., :3].copy()

    def release(self) -> None:
        for plotter in self.plotters.values():
            plotter.close()


class Inspector:
    """One avatar, drawn topic by topic, and what is found: the page shows checks and sections, the JSON holds facts and
    checks. `from_field`: signed millimetres of each triangle to the run's field, where a run was given. `size`
    is the side of the large views in pixels."""

    def __init__(
        self, avatar: Avatar, path: Path, context: Context, from_field: Float[Array, "faces"] | None, size: int
    ):
        self.avatar, self.path, self.context, self.from_field = avatar, path, context, from_field
        self.level, self.size = avatar.levels[0], size
        self.grey = np.tile(np.array(GREY, np.float64), (len(self.level.positions), 1))
        self.views = standard_views(avatar, size)
        self.studio: MeshPlotter | None = None
        self.checks, self.sections = list[Check](), list[PageSection]()
        self.facts: Json = {"format": "selfscan-inspection", "version": 1, "avatar": path.name}

    def draw(self, colors: Real[Array, "n 3"], lines: ColoredLines | None = None, *, wire: bool = False) -> Array:
        """The finest level in these colors, 0 to 255, one a vertex or one a triangle."""
        if self.studio is None:
            self.studio = MeshPlotter(list(self.views.values()), self.context.kind)
        return self.studio.draw(self.level, np.round(colors).astype(np.uint8), lines, wire=wire)

    def check(self, what: str, value: str, expected: str, good: bool | None) -> None:
        self.checks.append(Check(what, value, expected, good))

    def release(self) -> None:
        if self.studio is not None:
            self.studio.release()
