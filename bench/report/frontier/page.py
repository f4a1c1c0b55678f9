"""The page of accuracy against time: rows, the same frame in each rung, and the avatar itself, to be drawn there."""

import io
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from PIL import Image

from avatar.baked_avatar import Avatar
from avatar.texture import bytes_of
from bench.report.rung_page import RUNG_COLUMNS
from bench.report.writer import Json
from player.budget.rung import Rung, with_halved_textures
from player.scene.motions import motion_for
from player.web.page import MOST_BYTES, packed_player, page_of

# a difference is shown so many times larger
ENLARGED = 8
# the avatar plays so many frames of the counting clip
CLIP_FRAMES = 150
# sides of textures are halved at most so often to fit the page
MOST_HALVINGS = 3


Picture = Float[np.ndarray, "height width 3"]


class PagePictures(NamedTuple):
    """One frame: as each rung shows it, its truth where there is one, the person's rectangle, head and hands."""

    by_rung: dict[str, Picture]
    truth: Picture | None
    crop: tuple[slice, slice]
    parts: dict[str, tuple[slice, slice]]


def frontier_page(result: Json, pictures: PagePictures, avatar: Avatar, rungs: Sequence[Rung]) -> str:
    """The page. The avatar's textures are halved until it is no larger than a page may be; where that does not help, it
    says that it is without the avatar."""
    compared_with = references(result, pictures)
    # how the page draws a rung; None: only the program that measured it can
    draws = {rung.name: {key: value for key, value in asdict(rung).items() if key != "name"} for rung in rungs}
    facts: Json = {
        "result": {**result, "rungs": [{**row, "draw": draws.get(row["name"])} for row in result["rungs"]]},
        "picture": picture_facts(pictures),
        "references": [reference for reference, _ in compared_with],
        "enlarged": ENLARGED,
        "columns": [column._asdict() for column in RUNG_COLUMNS],
        "player": None,
        "halvings": 0,
    }
    blobs = picture_blobs(result, pictures, compared_with)
    title = f"{result['avatar']}: what accuracy costs in time"
    written = partial(page_of, "bench.report.frontier", ["chart.js", "report.js"], title)
    text, clip = written(blobs, facts), motion_for(avatar, "counting").read(0, CLIP_FRAMES)
    for halvings in range(MOST_HALVINGS + 1):
        player = packed_player(with_halved_textures(avatar, halvings), clip)
        if len(text) + player.bytes * 4 / 3 < MOST_BYTES - 200_000:
            return written({**blobs, **player.blobs}, facts | {"player": player.facts, "halvings": halvings})
    return text


def references(result: Json, pictures: PagePictures) -> list[tuple[Json, Picture]]:
    """What rungs are compared with, first what the page begins with: true pictures where there are any; the best that
    the player draws, since an avatar's textures may be better than its field's; the field. `scores`: where a row holds
    them, None: the row itself does."""
    names = [row["name"] for row in result["rungs"]]
    found: list[tuple[Json, Picture]] = []
    if pictures.truth is not None:
        true = {"key": "truth", "scores": "against_truth", "name": "true picture", "picture": "truth"}
        found.append((true, pictures.truth))
    best, baked = result["best_rung"], result["best_baked_rung"]
    for key, scores, name in (("baked", "against_baked", baked), ("best", None, best)):
        if key == "best" or best != baked:
            facts = {"key": key, "scores": scores, "name": name, "picture": f"picture{names.index(name)}"}
            found.append((facts, pictures.by_rung[name]))
    return found


def picture_facts(pictures: PagePictures) -> Json:
    """Size of the cropped pictures, and where head and hands are in them: left, top, width, height."""
    rows, columns = pictures.crop
    boxes = {}
    for name, (down, across) in pictures.parts.items():
        boxes[name] = [across.start - columns.start, down.start - rows.start,
                       across.stop - across.start, down.stop - down.start]  # fmt: skip
    size = [columns.stop - columns.start, rows.stop - rows.start]
    return {"size": size, "boxes": boxes}


def picture_blobs(
    result: Json, pictures: PagePictures, compared_with: Sequence[tuple[Json, Picture]]
) -> dict[str, bytes]:
    """The frame in each rung, and how it differs from what it is compared with, as WebP: to look at, nothing is
    measured on them."""
    crop, blobs = pictures.crop, {}
    for number, row in enumerate(result["rungs"]):
        shown = pictures.by_rung[row["name"]][crop]
        blobs[f"picture{number}"] = webp(shown)
        for reference, other in compared_with:
            blobs[f"difference-{reference['key']}-{number}"] = webp(ENLARGED * np.abs(shown - other[crop]))
    if pictures.truth is not None:
        blobs["truth"] = webp(pictures.truth[crop])
    return blobs


def webp(picture: Picture) -> bytes:
    out = io.BytesIO()
    Image.fromarray(bytes_of(picture)).save(out, "WEBP", quality=90, method=4)
    return out.getvalue()
