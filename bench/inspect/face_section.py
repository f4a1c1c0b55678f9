"""The face at 512 pixels, as the person in the video would look at it; beside true pictures where they are known."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from avatar.baked_avatar import Avatar
from avatar.psnr import decibels, error_between, pooled
from avatar.skeleton import PARTS
from avatar.texture import bytes_of
from bench.inspect.drawn_sections import standing
from bench.inspect.inspection import Inspector
from bench.inspect.page import PageSection, picture
from bench.inspect.views import face_views
from bench.score.picture_scores import NO_EYES, eye_region
from bench.score.true_mesh import TrueMesh, read_true_mesh
from capture.held_out import HeldOutView, read_held_out
from player.draw.raster import Rasteriser
from player.gl.context import Context
from player.scene.renderer import Renderer

SIDE = 512
# true close-ups that are shown, spread over the held-out poses
SHOWN = 3


class FacePicture(NamedTuple):
    """A held-out close-up of the head beside the avatar in its pose, before its camera; pixels in [0, 1]."""

    truth: Float[np.ndarray, "height width 3"]
    drawn: Float[np.ndarray, "height width 3"]
    # where true head, and true eyes with 3 mm round them, are seen and the avatar is
    head: Bool[np.ndarray, "height width"]
    eyes: Bool[np.ndarray, "height width"]


def face(inspector: Inspector, capture: Path | None) -> PageSection:
    """Three views of the face, and close-ups beside the truth with the error of head and eye region."""
    images = standing(inspector, face_views(inspector.avatar, SIDE), "off")
    pictures = [picture("face", np.hstack(images), "the face, in the paper's colors")]
    rows: list[tuple[str, ...]] = []
    # a capture may know the true mesh and hold no pictures of it
    if capture is not None and (capture / "truth" / "novel_pose").is_dir():
        truth = read_true_mesh(capture)
        close_ups = beside_truth(inspector.context, inspector.avatar, truth, read_held_out(capture, "novel_pose"))
        shown = [close_ups[i] for i in np.unique(np.linspace(0, len(close_ups) - 1, SHOWN).astype(int))]
        pairs = np.hstack([np.vstack([bytes_of(one.truth), bytes_of(one.drawn)]) for one in shown])
        pictures.append(picture("face_truth", pairs, "above: true pictures; below: the avatar"))
        head = region_db(close_ups, "head")
        eyes = region_db(close_ups, "eyes") if truth.eye is not None else None
        inspector.facts["face"] = {"head_db": head, "eyes_db": eyes, "pictures": len(close_ups)}
        if truth.eye is None:
            inspector.facts["face"]["reason"] = NO_EYES
        rows = [("region", f"PSNR inside it, {len(close_ups)} held-out close-ups"),
                ("head", _text(head)), ("eyes, with 3 mm round them", _text(eyes))]  # fmt: skip
        inspector.check("eye region", _text(eyes), "24 dB or more", None if eyes is None else eyes >= 24)
    return PageSection("face", pictures, None, rows)


def beside_truth(context: Context, avatar: Avatar, truth: TrueMesh, views: list[HeldOutView]) -> list[FacePicture]:
    """Every close-up of the head in `views`."""
    views = [view for view in views if view.view == "head"]
    raster = Rasteriser(context)
    found, renderer = [], None
    try:
        for view in views:
            if renderer is None:
                renderer = Renderer(context, [avatar], view.camera.size, view="off", background=(0.0, 0.0, 0.0, 0.0))
            image = renderer.draw([(view.axis_angle, view.root)], view.camera)
            covered = image[..., 3] == 255
            posed = truth.posed(view.axis_angle, view.root)
            head = (view.parts() == PARTS.index("head") + 1) & covered
            eyes = eye_region(raster, truth, posed, view.camera) & covered
            drawn = image[..., :3] / np.float64(255) * covered[..., None]
            found.append(FacePicture(view.image().astype(np.float64), drawn, head, eyes))
    finally:
        raster.release()
        if renderer is not None:
            renderer.release()
    return found


def region_db(close_ups: list[FacePicture], region: str) -> float | None:
    """PSNR of the pooled error inside a region of all close-ups; None where none shows it."""
    error = pooled(error_between(one.truth, one.drawn, getattr(one, region)) for one in close_ups)
    return None if error.count == 0 else round(decibels(max(error.square / error.count, 1e-12)), 2)


def _text(db: float | None) -> str:
    return "not known" if db is None else f"{db:.1f} dB"
