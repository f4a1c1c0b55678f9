"""The page of an avatar as text: bytes, shaders, viewer, and a policy that lets it ask no one for anything."""

import html
import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.motion.clip import Clip
from player.scene.framing import ELEVATION, FOV, extent, facing, fitted
from player.web.essl import programs
from player.web.packing import Packed, packed_avatar, packed_motion, text_of

# what browsers enforce: nothing is fetched, sent, embedded or submitted
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "base-uri 'none'; form-action 'none'"
)
# in this order, one script
DRAWING = ("unpack.js", "posing.js", "drawing.js", "orbit.js")
# a page for everyone's mail and phone
MOST_BYTES = 12_000_000


def page_text(name: str) -> str:
    """A file beside this one."""
    return (files("player.web") / name).read_text("utf-8")


def script_of(names: Sequence[str]) -> str:
    """Files beside this one as one script."""
    return "\n".join(page_text(name) for name in names)


def blob_elements(blobs: Mapping[str, bytes]) -> str:
    """Bytes that a script of the page reads by name."""
    return "\n".join(
        f'<script type="text/plain" id="{name}">{text_of(blob)}</script>' for name, blob in sorted(blobs.items())
    )


def json_element(content: Any) -> str:
    """JSON that may stand inside a script element: no text in it ends the element."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def filled(template: str, parts: Mapping[str, str]) -> str:
    """The template with @NAME@ replaced by each part; a part's own text is not looked at again."""
    pieces = template.split("@")
    # words between two @ that are no part stay as they are
    out, k = [pieces[0]], 1
    while k < len(pieces):
        if pieces[k] in parts and k + 1 < len(pieces):
            out += [parts[pieces[k]], pieces[k + 1]]
            k += 2
        else:
            out += ["@", pieces[k]]
            k += 1
    return "".join(out)


def first_camera(avatar: Avatar, clip: Clip) -> dict[str, Any]:
    """The camera of `selfscan render --camera front` on a square picture, and how far away one twice as high is."""
    azimuth, points = facing(clip.axis_angle[0], avatar.joint_positions.astype(np.float64)), extent(avatar, clip)
    view, narrow = fitted(points, azimuth, (640, 640)), fitted(points, azimuth, (320, 640))
    return {
        "target": view.target.tolist(), "distance": view.distance, "narrow": narrow.distance, "azimuth": azimuth,
        "elevation": ELEVATION, "fov": float(FOV),
    }  # fmt: skip


def viewer_facts(avatar: Avatar, packed: Packed, motion: Packed, clip: Clip) -> dict[str, Any]:
    """What viewer.js must know."""
    return {
        "avatar": packed.facts,
        "motion": motion.facts,
        "view": avatar.default_view,
        "camera": first_camera(avatar, clip),
        "programs": programs(avatar),
    }


def avatar_page(avatar: Avatar, clip: Clip, title: str) -> tuple[str, dict[str, int]]:
    """The page, and the bytes of what is in it."""
    packed, motion = packed_avatar(avatar), packed_motion(clip)
    blobs = {**packed.blobs, **motion.blobs}
    text = filled(
        page_text("page.html"),
        {
            "POLICY": POLICY,
            "TITLE": html.escape(title),
            "STYLE": page_text("page.css"),
            "BLOBS": blob_elements(blobs),
            "FACTS": json_element(viewer_facts(avatar, packed, motion, clip)),
            "SCRIPT": script_of((*DRAWING, "viewer.js")) + "\nview().catch(failed);\n",
        },
    )
    return text, {name: len(blob) for name, blob in blobs.items()}
