"""Sections that our own renderer draws: the avatar as it looks."""

import numpy as np

from bench.inspect import looks as pictures_of
from bench.inspect.inspection import Inspector
from bench.inspect.page import PagePicture, Section, animation, png
from bench.inspect.views import strip

# times that view dependence is shown
CHANGE = 8


def looks(inspector: Inspector) -> Section:
    """As drawn, in the canonical pose."""
    plain = strip(pictures_of.standing(inspector.context, inspector.avatar, inspector.views, "off"))
    pictures = [PagePicture("look_off", png(plain), "png", "the paper's colors")]
    mode = inspector.avatar.default_view
    if mode != "off":
        image = strip(pictures_of.standing(inspector.context, inspector.avatar, inspector.views, mode))
        pictures.append(PagePicture(f"look_{mode}", png(image), "png", f"with view dependence ({mode})"))
        change = np.clip(128 + CHANGE * (image.astype(float) - plain), 0, 255).astype(np.uint8)
        pictures.append(
            PagePicture("look_change", png(change), "png", f"what view dependence adds, {CHANGE} times, on grey")
        )
    return Section(
        "look",
        "As drawn",
        "The finest level in the pose it is stored in. Look for blur, colors of one part on "
        "another, a line at neck or "
        "wrists, fingers grown together.",
        pictures,
    )


def posed(inspector: Inspector) -> Section:
    """Poses that strain the skin."""
    pictures = [
        PagePicture(f"pose_{name.replace(' ', '_')}", png(image), "png", name, width=380)
        for name, image in pictures_of.posed(
            inspector.context, inspector.avatar, max(inspector.size * 3 // 4, 64)
        ).items()
    ]
    return Section(
        "poses",
        "Posed",
        "Linear blend skinning in poses that strain it. Look for collapsed elbows and knees, armpits "
        "that pull the chest "
        "along, fingers that drag each other.",
        pictures,
    )


def turntable(inspector: Inspector, frames: int) -> Section:
    """Once round."""
    size = (inspector.size * 3 // 4 // 2 * 2, inspector.size)
    turn = animation(list(pictures_of.turntable(inspector.context, inspector.avatar, size, frames)), 6.0)
    mode = inspector.avatar.default_view
    return Section(
        "turntable",
        "Turntable",
        f"The avatar at ease, as its file asks to be drawn (view dependence: {mode}).",
        [PagePicture("turntable", turn, "webp", f"{frames} views, 6 seconds")],
    )


def levels(inspector: Inspector) -> Section:
    """Levels of detail side by side."""
    pictures, rows = [], [("level", "triangles", "texture", "PSNR against the finest, dB")]
    first = None
    for number, level in enumerate(inspector.avatar.levels):
        front, _, head, _, hand, _ = pictures_of.standing(
            inspector.context, inspector.avatar, inspector.views, "off", number
        )
        image = np.hstack([front, np.vstack([head, hand])])
        first = image if first is None else first
        error = np.square((image.astype(float) - first) / 255).mean()
        decibels = "same" if number == 0 else f"{-10 * np.log10(max(error, 1e-12)):.1f}"
        rows.append((str(number), str(len(level.faces)), f"{level.base_color.shape[1]}", decibels))
        pictures.append(PagePicture(f"level_{number}", png(image), "png", f"{len(level.faces)} triangles", width=380))
    return Section(
        "levels",
        "Levels of detail",
        "The same views of each level, in the paper's colors, the background counted.",
        pictures,
        None,
        rows,
    )
