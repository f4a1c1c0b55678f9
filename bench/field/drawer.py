"""What is evaluated, a run's field or a baked avatar, as a surface to pose and a picture to draw."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from avatar.camera import Camera
from avatar.gltf.avatar_file import Avatar, read_avatar
from bench.field.posed_field import Directions, MaskedPicture, PosableSurface, PosedField, averaged
from bench.score.metrics import rectangle
from player.draw.raster import Rasteriser
from player.effects.light import Light
from player.gl.context import open_context
from player.scene.effects import PLAIN
from player.scene.renderer import Renderer
from train.run import Run, read_run

# paper mode, in the light of the videos where the file keeps it apart from the albedo: so the truth was taken
FILMED = replace(PLAIN, view="off", light=Light())


class Drawer:
    """Draws the field of a run (a folder) or a baked avatar (a file) as filmed, and gives back what it made."""

    def __init__(self, source: Path | Run, directions: Directions = "global"):
        self.path = source.path if isinstance(source, Run) else Path(source)
        self.directions: Directions = directions  # a field's alone
        self.field: PosedField | None = None
        self.avatar: Avatar | None = None
        if isinstance(source, Run) or self.path.is_dir():
            run = source if isinstance(source, Run) else read_run(self.path)
            self.provenance = run.provenance
            self.field = PosedField(run)
            self.surface = self.field.surface
        else:
            self.avatar = read_avatar(self.path)
            self.provenance, level = self.avatar.provenance, self.avatar.levels[0]
            held = level.positions, self.avatar.joint_positions, self.avatar.canonical_pose
            positions, joints, pose = (np.asarray(a, np.float64) for a in held)
            self.surface = PosableSurface(positions, level.faces.astype(np.int64), level.skin, joints, pose)
        self.context = open_context()
        self.raster = Rasteriser(self.context)
        self.renderers: dict[tuple[int, int], Renderer] = {}

    def draw(
        self,
        axis_angle: Float[np.ndarray, "52 3"],
        root: Float[np.ndarray, "3"],
        camera: Camera,
        samples: int = 1,
        where: Bool[np.ndarray, "height width"] | None = None,
    ) -> MaskedPicture:
        """One picture on black; `samples` squared rays for each pixel, averaged. A field is drawn only in the rectangle
        of `where`, and asked for colors only there."""
        if self.field is not None:
            width, height = camera.size
            picture = MaskedPicture(np.zeros((height, width, 3), np.float32), np.zeros((height, width), bool))
            where = np.ones((height, width), bool) if where is None else where
            box = rectangle(where)
            if box is not None:
                rows, columns = box
                size = columns.stop - columns.start, rows.stop - rows.start
                part, how = camera.cropped(columns.start, rows.start, size), self.directions
                picture.color[box], picture.mask[box] = self.field.draw(
                    self.raster, axis_angle, root, part, samples=samples, directions=how, where=where[box]
                )
            return picture
        assert self.avatar is not None
        size = (samples * camera.size[0], samples * camera.size[1])
        if size not in self.renderers:
            self.renderers[size] = Renderer(self.context, [self.avatar], size, effects=FILMED)
        pixels = self.renderers[size].draw([(axis_angle, root)], camera).astype(np.float32) / 255
        return averaged(pixels[..., :3], pixels[..., 3] > 0.5, samples)

    def release(self) -> None:
        self.context.release()
