"""The field an avatar was baked from, as rungs of accuracy against time: slow, and what the rest is measured by.

The last is the truth of the model: volume rendering (NeuS, train/render.py). Each pixel's ray is cut into sections in a
band round the posed surface; their ends are taken back into the canonical frame by the inverse of the one blended
matrix of the surface point that the ray hits (the band is thinner than what that changes over), and weighted as in
training. Pixels that miss the posed surface are left black: outside of it, training's band ends.
"""

import time
from collections.abc import Sequence
from itertools import chain

import numpy as np
import torch

from avatar.camera import Camera, pixel_rays
from avatar.skinning import blended_rotations, blended_transforms
from bake.cone import interpolated
from bench.field.posed_field import MaskedPicture, PosedField, faces_in_picture
from bench.ladder.rung_pictures import ComparedFrame, MeasuredRung
from bench.ladder.rung_scores import row_of
from command.progress import progress
from player.draw.drawing import BarePose
from player.draw.raster import Rasteriser
from player.gl.context import Context
from train.render import crossing, section_weights
from train.run import Run

# sections of a ray, 0 for its first surface crossing; the last rung is what all others are compared with
FIELD_RUNGS = {"field, surface": 0, "field, volume of 64": 64}
# frames timed at least, but of a volume each of the frames once
FIELD_ROUNDS = 3
# half the band, in widths beta of the surface: Phi has then passed by 1 - 1e-6
REACH = 8.0
# share of a pixel; what weighs less cannot be seen, and is not asked for its color
LEAST = 2e-3
# rays at once
CHUNK = 8192


def field_rungs(run: Run, context: Context, frames: Sequence[ComparedFrame], baked_ms: float) -> list[MeasuredRung]:
    """The field of a run, drawn in each way, the slowest first; `baked_ms`: what the player takes."""
    field, beta = PosedField(run), run.preset.parts[0].beta[1]
    size = sum(tensor.nbytes for tensor in chain(run.field.parameters(), run.field.buffers()))
    raster, rungs = Rasteriser(context), []
    try:
        for name, sections in FIELD_RUNGS.items():
            ms, drawn = [], []
            rounds = len(frames) if sections else max(FIELD_ROUNDS, len(frames))
            for number in progress(range(rounds), name):
                frame = frames[number % len(frames)]
                start = time.perf_counter()
                if sections:
                    picture = draw_volume(field, raster, frame.pose, frame.camera, beta=beta, sections=sections)
                else:
                    picture = field.draw(raster, *frame.pose, frame.camera, directions="cone")
                ms.append(1e3 * (time.perf_counter() - start))
                if number < len(frames):
                    drawn.append(picture.color)
            row = row_of(name, np.array(ms), size) | {"times_faster": round(float(baked_ms / np.median(ms)), 5)}
            rungs.insert(0, MeasuredRung(row, None, drawn))
    finally:
        raster.release()
    return rungs


def draw_volume(
    field: PosedField, raster: Rasteriser, pose: BarePose, camera: Camera, *, beta: float, sections: int
) -> MaskedPicture:
    """One picture on black, colors inside the cone that training saw. `beta` is the surface's width, metres."""
    surface, posed = field.surface, field.surface.posed(*pose)
    faces = faces_in_picture(posed, surface.faces, camera)
    fragments = raster.draw(posed, faces, camera)
    rows, columns = np.nonzero(fragments.face >= 0)
    width, height = camera.size
    image, opacity = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.float32)
    transforms = surface.transforms(*pose)
    matrices = blended_transforms(surface.skin, transforms)
    turns = blended_rotations(surface.skin, transforms)
    origins, directions = pixel_rays(camera, np.stack([columns, rows], -1) + 0.5)
    steps = np.linspace(-REACH * beta, REACH * beta, sections + 1)
    for start in range(0, len(rows), CHUNK):
        own = slice(start, start + CHUNK)
        corners = faces[fragments.face[rows[own], columns[own]]]
        weight = fragments.barycentric[rows[own], columns[own]].astype(np.float64)
        hit = (weight[:, :, None] * posed[corners]).sum(1)
        back = np.linalg.inv((weight[:, :, None, None] * matrices[corners]).sum(1))
        rays, eyes = directions[own], origins[own]
        far = ((hit - eyes) * rays).sum(1)
        points = eyes[:, None] + (far[:, None] + steps)[:, :, None] * rays[:, None]
        ends = np.einsum("nij,nsj->nsi", back[:, :3, :3], points) + back[:, None, :3, 3]
        distance = torch.from_numpy(field.distance(ends.reshape(-1, 3)).reshape(ends.shape[:2])).double()
        shares = section_weights(distance, beta).weights.numpy()
        ray, section = np.nonzero(shares > LEAST)
        at = crossing(distance, torch.from_numpy(ends)).numpy()[ray, section]
        turn = turns[corners[np.arange(len(corners)), weight.argmax(1)]][ray]
        seen = interpolated(field.cone, corners[ray], weight[ray])
        color = field.shown(at, seen, turn, rays[ray], "cone")
        total = np.zeros((len(corners), 3))
        np.add.at(total, ray, shares[ray, section, None] * color)
        image[rows[own], columns[own]] = total
        opacity[rows[own], columns[own]] = (shares * (shares > LEAST)).sum(1)
    return MaskedPicture(np.clip(image, 0, 1), opacity >= 0.5)
