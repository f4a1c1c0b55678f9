"""The page of an avatar as text: bytes, shaders, viewer, and a policy that lets it ask no one for anything."""

import base64
import html
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.resources import files

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.motion.clip import Clip
from command.errors import unicode_text
from files.input_file import Json, JsonObject
from player.scene.framing import FOV, extent, facing, fitted
from player.web.essl import programs
from player.web.packing import Packed, packed_avatar, packed_motion

# what browsers enforce: nothing is fetched, sent, embedded or submitted
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "base-uri 'none'; form-action 'none'"
)
# in this order, one script
DRAWING = ("page.js", "unpack.js", "posing.js", "face.js", "drawing.js", "orbit.js")
# a page for everyone's mail and phone
MOST_BYTES = 12_000_000


def blob_elements(blobs: Mapping[str, bytes]) -> str:
    """Bytes that a script of the page reads by name."""
    return "\n".join(
        f'<script type="text/plain" id="{name}">{base64.b64encode(blob).decode("ascii")}</script>'
        for name, blob in sorted(blobs.items())
    )


def json_element(content: Json) -> str:
    """JSON that may stand inside a script element: no text in it ends the element."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def filled(template: str, parts: Mapping[str, str]) -> str:
    """The template with @NAME@ replaced by each part; a part's own text is not looked at again."""
    return re.sub(f"@({'|'.join(parts)})@", lambda found: parts[found[1]], template)


def page_of(package: str, scripts: Sequence[str], title: str, blobs: Mapping[str, bytes], facts: JsonObject) -> str:
    """A page that draws avatars: body.html, page.css and scripts of a package, and the bytes and facts they read."""
    drawing, own = ["frame.html", *DRAWING], ["body.html", "page.css", *scripts]
    frame, *shared = ((files("player.web") / name).read_text("utf-8") for name in drawing)
    body, style, *more = ((files(package) / name).read_text("utf-8") for name in own)
    parts = {
        "POLICY": POLICY, "TITLE": html.escape(unicode_text(title)), "STYLE": style, "BLOBS": blob_elements(blobs),
        "FACTS": json_element(facts), "SCRIPT": "\n".join([*shared, *more]),
    }  # fmt: skip
    return filled(frame.replace("@BODY@", body), parts)


def first_camera(avatar: Avatar, clip: Clip) -> JsonObject:
    """The camera of `selfscan render --camera front` on a square picture, and that of a person who stays in place."""
    azimuth = facing(clip.axis_angle[0], avatar.joint_positions.astype(np.float64))
    root = np.where([False, True, False], clip.root, clip.root[0])
    view, points = fitted(extent(avatar, clip), azimuth, (640, 640)), extent(avatar, replace(clip, root=root))
    alone, narrow = fitted(points, azimuth, (640, 640)), fitted(points, azimuth, (320, 640))
    person = {"target": alone.target.tolist(), "distance": alone.distance, "narrow": narrow.distance}
    return {
        "target": view.target.tolist(), "distance": view.distance, "person": person, "azimuth": view.azimuth,
        "elevation": view.elevation, "fov": float(FOV),
    }  # fmt: skip


def packed_player(avatar: Avatar, clip: Clip) -> Packed:
    """An avatar in motion: what a page must know to draw it, and its bytes."""
    faced = avatar.eyes is not None and clip.face is not None
    packed, motion = packed_avatar(avatar, faced=faced), packed_motion(clip if faced else replace(clip, face=None))
    facts = {
        "avatar": packed.facts,
        "motion": motion.facts,
        "view": avatar.default_view,
        "camera": first_camera(avatar, clip),
        "programs": programs(avatar, faced=faced),
    }
    return Packed(facts, {**packed.blobs, **motion.blobs})


def avatar_page(avatar: Avatar, clip: Clip, title: str) -> tuple[str, dict[str, int]]:
    player = packed_player(avatar, clip)
    text = page_of("player.web", ["viewer.js"], title, player.blobs, player.facts)
    return text, {name: len(blob) for name, blob in player.blobs.items()}
