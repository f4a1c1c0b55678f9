"""The face at 512 pixels, as the person in the video would look at it; beside true pictures where they are known."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from avatar.baked_avatar import Avatar
from avatar.skeleton import PARTS
from bench.eye_region import NO_EYES, eye_region
from bench.inspect import looks as pictures_of
from bench.inspect.inspection import Inspector
from bench.inspect.page import PagePicture, Section, png
from bench.inspect.views import face_views
from bench.true_mesh import TrueMesh, read_true_mesh
from capture.held_out import HeldOutView, read_held_out
from player.context import Context
from player.raster import Rasteriser
from player.renderer import Renderer

SIDE = 512
# true close-ups that are shown, spread over the held-out poses
SHOWN = 3


class CloseUp(NamedTuple):
    """A held-out close-up of the head beside the avatar in its pose, before its camera; pixels in [0, 1]."""

    truth: Float[np.ndarray, "height width 3"]
    drawn: Float[np.ndarray, "height width 3"]
    # where true head, and true eyes with 3 mm round them, are seen and the avatar is
    head: Bool[np.ndarray, "height width"]
    eyes: Bool[np.ndarray, "height width"]


def face(inspector: Inspector, capture: Path | None) -> Section:
    """Three views of the face, and close-ups beside the truth with the error of head and eye region."""
    avatar, context = inspector.avatar, inspector.context
    images = pictures_of.standing(context, avatar, face_views(avatar, SIDE), "off")
    pictures = [PagePicture("face", png(np.hstack(images)), "png", "the face, in the paper's colors")]
    rows: list[tuple[str, ...]] = []
    # a capture may know the true mesh and hold no pictures of it
    if capture is not None and (capture / "truth" / "novel_pose").is_dir():
        truth = read_true_mesh(capture)
        close_ups = beside_truth(context, avatar, truth, read_held_out(capture, "novel_pose"))
        shown = [close_ups[i] for i in np.unique(np.linspace(0, len(close_ups) - 1, SHOWN).astype(int))]
        pair = np.vstack(
            [np.hstack([_bytes(one.truth) for one in shown]), np.hstack([_bytes(one.drawn) for one in shown])]
        )
        pictures.append(PagePicture("face_truth", png(pair), "png", "above: true pictures; below: the avatar"))
        head = decibels(close_ups, "head")
        eyes = decibels(close_ups, "eyes") if truth.eye is not None else None
        inspector.facts["face"] = {"head_db": head, "eyes_db": eyes, "pictures": len(close_ups)}
        if truth.eye is None:
            inspector.facts["face"]["reason"] = NO_EYES
        rows = [("region", f"PSNR inside it, {len(close_ups)} held-out close-ups"),
                ("head", _text(head)), ("eyes, with 3 mm round them", _text(eyes))]  # fmt: skip
        inspector.check("eye region", _text(eyes), "24 dB or more", None if eyes is None else eyes >= 24)
    return Section(
        "face",
        "Face",
        "The face filling the picture. Look for whites, irises and pupils that are told apart, nostrils that are no "
        "stripes, a hairline, a collar that is a line.",
        pictures,
        None,
        rows,
    )


def beside_truth(context: Context, avatar: Avatar, truth: TrueMesh, views: list[HeldOutView]) -> list[CloseUp]:
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
            found.append(CloseUp(view.image().astype(np.float64), drawn, head, eyes))
    finally:
        raster.release()
        if renderer is not None:
            renderer.release()
    return found


def decibels(close_ups: list[CloseUp], region: str) -> float | None:
    """PSNR of the pooled error inside a region of all close-ups; None where none shows it."""
    square, count = 0.0, 0
    for one in close_ups:
        where = getattr(one, region)
        square += float(np.square(one.truth[where] - one.drawn[where]).sum())
        count += 3 * int(where.sum())
    return None if count == 0 else round(-10 * float(np.log10(max(square / count, 1e-12))), 2)


def _bytes(image: Float[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "height width 3"]:
    return np.clip(np.round(image * 255), 0, 255).astype(np.uint8)


def _text(db: float | None) -> str:
    return "not known" if db is None else f"{db:.1f} dB"
