"""Whether what a part learned meets the outlines of its own film: where it does worse than the template that it began
with, the template stays."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from avatar.skeleton import PARTS, skin_transforms
from avatar.skinning import SkinWeights, skin_points
from bake.level import rounded
from bake.promises import Facts
from bake.run_capture import RunVideos
from capture.folder import PartVideo
from capture.template.hull import moved_camera
from capture.videos import even
from geometry.cells import distance_to
from geometry.mesh import face_values
from player.draw.raster import Rasteriser
from player.gl.context import open_context
from train.run import BakeSource

# frames that are compared; rows of them at most; how far beside a part its outline is looked for, share of the rows
COMPARED, ROWS, BESIDE = 12, 540, 0.03
# a part goes whose outlines are off by this factor more than its template's
WORSE = 1.05


class Candidate(NamedTuple):
    """A surface that may be the person's; canonical, metres."""

    vertices: Float[Array, "vertices 3"]
    faces: Int[Array, "faces 3"]
    skin: SkinWeights
    part: Int[Array, "faces"]  # index into PARTS

    def drawn(
        self, rasteriser: Rasteriser, video: PartVideo, frame: int, videos: RunVideos, joints: Float[Array, "52 3"]
    ) -> Int[Array, "height width"]:
        """The part that each pixel shows, -1 where there is none, with at most ROWS rows."""
        vertices, camera = self.vertices, video.cameras[frame]
        if video.axis_angle is not None and video.root is not None:
            transforms = skin_transforms(video.axis_angle[frame], joints, video.root[frame])
            vertices = skin_points(vertices, self.skin, transforms)
        else:
            camera = moved_camera(camera, videos.head_from_canonical)
        step = -(-camera.size[1] // ROWS)
        camera = camera.resized((camera.size[0] // step, camera.size[1] // step))
        face = rasteriser.draw(vertices, self.faces, camera).face
        return np.where(face >= 0, self.part[face], -1)


def worse_parts(run: BakeSource, videos: RunVideos) -> tuple[dict[str, str], Facts]:
    """The parts whose template meets the outlines of their own films better than what they learned, each with how much,
    and what the file says of all."""
    subject, surface = run.subject, run.surface
    template, learned = (
        Candidate(one.vertices, one.faces, one.skin, face_values(one.part, one.faces)) for one in (subject, surface)
    )
    worse, facts = {}, {}
    if run.with_templates is None:
        return worse, facts
    with open_context() as context:
        rasteriser = Rasteriser(context)
        for part, fact in run.provenance["parts"].items():
            if not fact["steps"]:
                continue
            video, sums = videos.video(part), np.zeros(3)
            for frame in even(len(video.cameras), COMPARED):
                shown = [one.drawn(rasteriser, video, frame, videos, subject.joints) for one in (template, learned)]
                unsure = None if video.unsure is None else video.unsure[frame]
                sums += off_outline(shown, video.masks[frame], unsure, PARTS.index(part))
            off = sums[:2] / max(sums[2], 1)
            facts[part] = {"template": rounded(off[0]), "learned": rounded(off[1])}
            if off[1] > WORSE * off[0]:
                worse[part] = f"its outlines are {off[1]:.1%} of the film's area off, its template's {off[0]:.1%}"
        rasteriser.release()
    return worse, facts


def off_outline(
    shown: list[Int[Array, "height width"]], mask: Bool[Array, "rows columns"],
    unsure: Bool[Array, "rows columns"] | None, part: int,
) -> Float[Array, "n"]:  # fmt: skip
    """Pixels about a part in which each picture differs from the mask, and last those of the mask."""
    height, width = shown[0].shape
    step = -(-mask.shape[0] // ROWS)
    smaller = np.s_[step // 2 :: step, step // 2 :: step]
    mask = mask[smaller][:height, :width]
    own = np.any([one == part for one in shown], 0)
    other = np.any([one >= 0 for one in shown], 0) & ~own
    away = distance_to(own) if own.any() else np.full(own.shape, np.inf)
    near = away < BESIDE * height
    if other.any():
        near &= away <= distance_to(other)
    if unsure is not None:
        near &= ~unsure[smaller][:height, :width]
    return np.array([*(float(((one >= 0) != mask)[near].sum()) for one in shown), float(mask[near].sum())])
