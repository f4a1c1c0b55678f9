"""The page of accuracy against time: rows, the same frame in each rung, and the avatar itself, to be drawn there."""

import html
import io
from collections.abc import Sequence
from dataclasses import asdict
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from PIL import Image

from avatar.baked_avatar import Avatar
from player.motions import motion_for
from player.rung import Rung
from player.web.packing import Packed, packed_avatar, packed_motion
from player.web.page import (
    DRAWING,
    MOST_BYTES,
    POLICY,
    blob_elements,
    filled,
    json_element,
    script_of,
    viewer_facts,
)

# a difference is shown so many times larger
ENLARGED = 8
# of the counting clip that the avatar plays
CLIP_FRAMES = 150


class PagePictures(NamedTuple):
    """One frame: as each rung shows it, its truth where there is one, the person's rectangle, head and hands."""

    by_rung: dict[str, Float[np.ndarray, "height width 3"]]
    truth: Float[np.ndarray, "height width 3"] | None
    crop: tuple[slice, slice]
    parts: dict[str, tuple[slice, slice]]


def frontier_page(result: dict[str, Any], pictures: PagePictures, avatar: Avatar, rungs: Sequence[Rung]) -> str:
    """The page; without the avatar itself where that would make it larger than a page may be, which it says."""
    blobs = picture_blobs(result, pictures)
    draws = {rung.name: rung for rung in rungs}
    facts: dict[str, Any] = {
        "result": {**result, "rungs": [{**row, "draw": drawn_by(draws.get(row["name"]))} for row in result["rungs"]]},
        "effects": effect_points(result),
        "picture": picture_facts(pictures),
        "references": references(result, pictures),
        "enlarged": ENLARGED,
        "player": None,
    }
    text = _text(result, facts, blobs)
    clip = motion_for(avatar, "counting").read(0, CLIP_FRAMES)
    packed, motion = packed_avatar(avatar), packed_motion(clip)
    if len(text) + (packed.bytes + motion.bytes) * 4 / 3 < MOST_BYTES - 200_000:
        return _with_player(result, facts, blobs, avatar, packed, motion, clip)
    return text


def _with_player(result, facts, blobs, avatar: Avatar, packed: Packed, motion: Packed, clip) -> str:
    player = viewer_facts(avatar, packed, motion, clip)
    return _text(result, {**facts, "player": player}, {**blobs, **packed.blobs, **motion.blobs})


def _text(result: dict[str, Any], facts: dict[str, Any], blobs: dict[str, bytes]) -> str:
    own = {name: (files("bench.frontier") / name).read_text("utf-8") for name in
           ("page.html", "page.css", "chart.js", "report.js")}  # fmt: skip
    script = "\n".join((script_of(DRAWING), own["chart.js"], own["report.js"]))
    return filled(
        own["page.html"],
        {
            "POLICY": POLICY,
            "TITLE": html.escape(f"{result['avatar']}: what accuracy costs in time"),
            "STYLE": own["page.css"],
            "BLOBS": blob_elements(blobs),
            "FACTS": json_element(facts),
            "SCRIPT": script,
        },
    )


def effect_points(result: dict[str, Any]) -> list[dict[str, Any]]:
    """Effects as rungs, where truth judged them; the page itself cannot draw them."""
    return [{**row["point"], "draw": None, "effect": True} for row in result["effects"] if "point" in row]


def drawn_by(rung: Rung | None) -> dict[str, Any] | None:
    """How the page draws a rung; None: only the program that measured it can."""
    if rung is None:
        return None
    return {key: value for key, value in asdict(rung).items() if key != "name"}


def references(result: dict[str, Any], pictures: PagePictures) -> list[dict[str, Any]]:
    """What rungs are compared with, first what the page begins with: the best that the player draws, since an avatar's
    textures may be better than its field's; the field; true pictures. `scores`: where a row holds them, or itself."""
    names = [row["name"] for row in result["rungs"]]
    best, baked = result["best_rung"], result["best_baked_rung"]
    found: list[dict[str, Any]] = []
    if best != baked:
        found.append(
            {"key": "baked", "scores": "against_baked", "name": baked, "picture": f"picture{names.index(baked)}"}
        )
    found.append({"key": "best", "scores": None, "name": best, "picture": f"picture{names.index(best)}"})
    if pictures.truth is not None:
        found.append({"key": "truth", "scores": "against_truth", "name": "true picture", "picture": "truth"})
    return found


def picture_facts(pictures: PagePictures) -> dict[str, Any]:
    """Size of the cropped pictures, and where head and hands are in them: left, top, width, height."""
    rows, columns = pictures.crop
    boxes = {}
    for name, (down, across) in pictures.parts.items():
        boxes[name] = [across.start - columns.start, down.start - rows.start,
                       across.stop - across.start, down.stop - down.start]  # fmt: skip
    size = [columns.stop - columns.start, rows.stop - rows.start]
    return {"size": size, "boxes": boxes}


def picture_blobs(result: dict[str, Any], pictures: PagePictures) -> dict[str, bytes]:
    """The frame in each rung, and how it differs from what it is compared with, as WebP: to look at, nothing is
    measured on them."""
    crop, blobs = pictures.crop, {}
    compared_with = {
        "baked": pictures.by_rung[result["best_baked_rung"]],
        "best": pictures.by_rung[result["best_rung"]],
    }
    if pictures.truth is not None:
        compared_with["truth"] = pictures.truth
    rungs = len(result["rungs"])
    for number, row in enumerate([*result["rungs"], *effect_points(result)]):
        shown = pictures.by_rung[row["name"]][crop]
        blobs[f"picture{number}"] = webp(shown)
        for reference in references(result, pictures):
            if number >= rungs and reference["key"] != "truth":
                continue
            other = compared_with[reference["key"]][crop]
            blobs[f"difference-{reference['key']}-{number}"] = webp(ENLARGED * np.abs(shown - other))
    if pictures.truth is not None:
        blobs["truth"] = webp(pictures.truth[pictures.crop])
    return blobs


def webp(picture: Float[np.ndarray, "height width 3"]) -> bytes:
    out = io.BytesIO()
    image = Image.fromarray(np.round(np.clip(picture, 0, 1) * 255).astype(np.uint8))
    image.save(out, "WEBP", quality=90, method=4)
    return out.getvalue()
