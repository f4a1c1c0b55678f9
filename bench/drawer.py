"""What is evaluated, a run's field or a baked avatar, as a surface to pose and a picture to draw."""

from pathlib import Path
from typing import Any

import numpy as np
from train.run import read_run

from avatar.avatar_file import Avatar, Level, read_avatar
from avatar.camera import Camera
from avatar.skinning import SkinWeights
from bench.field_view import Picture, PosableSurface, draw_surface, paper_colour, run_directions, run_surface
from player.context import open_context
from player.raster import Rasteriser
from player.renderer import Renderer


def level_surface(avatar: Avatar, level: Level) -> PosableSurface:
    """One level of a baked avatar as a posable mesh."""
    skin = SkinWeights(level.joints.astype(np.int64), (level.weights / np.float32(255)).astype(np.float32))
    return PosableSurface(
        level.positions.astype(np.float64),
        level.faces.astype(np.int64),
        skin,
        np.asarray(avatar.joint_positions, np.float64),
        np.asarray(avatar.canonical_pose, np.float64),
    )


class Drawer:
    """Draws the field of a run, or a baked avatar, and gives back what it made."""

    def __init__(self, path: Path):
        self.path = Path(path)
        self.context = open_context()
        self.raster = Rasteriser(self.context)
        self.renderers: dict[tuple[tuple[int, int], str], Any] = {}
        if self.path.is_dir():
            self.run = read_run(self.path)
            self.avatar = None
            self.surface = run_surface(self.run)
            self.directions = run_directions(self.run)
            self.colour = paper_colour(self.run)
        else:
            self.run = None
            self.avatar = read_avatar(self.path)
            self.surface = level_surface(self.avatar, self.avatar.levels[0])

    def draw(self, axis_angle: np.ndarray, root: np.ndarray, camera: Camera) -> Picture:
        if self.run is not None:
            return self.draw_field(self.surface, axis_angle, root, camera)
        return self.draw_avatar(axis_angle, root, camera)

    def draw_field(
        self,
        surface: PosableSurface,
        axis_angle: np.ndarray,
        root: np.ndarray,
        camera: Camera,
        samples: int = 1,
    ) -> Picture:
        posed = surface.posed(axis_angle, root)
        return draw_surface(self.raster, surface, posed, self.directions, self.colour, camera, samples)

    def draw_avatar(
        self, axis_angle: np.ndarray, root: np.ndarray, camera: Camera, view: str = "auto"
    ) -> Picture:
        key = camera.size, view
        if key not in self.renderers:
            self.renderers[key] = Renderer(self.context, [self.avatar], camera.size, view=view)
        pixels = self.renderers[key].draw([(axis_angle, root)], camera)
        alpha = pixels[..., 3]
        return Picture((pixels[..., :3] / np.float32(255)).astype(np.float32), alpha > 127)

    def release(self) -> None:
        for renderer in self.renderers.values():
            renderer.release()
        self.raster.release()
        self.context.release()
