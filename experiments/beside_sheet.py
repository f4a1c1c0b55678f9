"""True people and their avatars beside each other: face, side of the head, front, back.

python -m experiments.beside_sheet sheet.jpg builtin:2=two.glb person.glb=made.glb ...
"""

import argparse
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from avatar.camera import Camera, orbit_camera
from avatar.gltf.avatar_file import read_avatar
from avatar.skeleton import JOINTS, joint_transforms
from files.whole import whole_file
from player.draw.raster import Rasteriser
from player.gl.context import open_context
from player.scene.offscreen import OffscreenRenderer
from synth.command import load_subject
from synth.light import STILL
from synth.photo import Studio

HEAD, PELVIS = JOINTS.index("head"), JOINTS.index("pelvis")
Tile = UInt8[np.ndarray, "side side 3"]


class Shot(NamedTuple):
    """A close-up: a joint, metres over it, azimuth, distance (metres), field of view (degrees)."""

    joint: int
    over: float
    azimuth: float
    distance: float
    field: float


VIEWS = (Shot(HEAD, 0.08, 0.0, 0.72, 30), Shot(HEAD, 0.08, 0.9, 0.72, 30), Shot(PELVIS, -0.05, 0.35, 2.9, 38),
         Shot(PELVIS, -0.05, np.pi, 2.9, 38))  # fmt: skip
GROUND = np.array([44, 45, 51], np.uint8)
ROOT = np.zeros(3)


def hanging_arms() -> Float[np.ndarray, "52 3"]:
    """A pose with the arms down."""
    pose = np.zeros((len(JOINTS), 3))
    pose[[JOINTS.index("left_shoulder"), JOINTS.index("right_shoulder")], 2] = -1.2, 1.2
    return pose


def cameras(joints: Float[np.ndarray, "52 3"], side: int, shots: Iterable[Shot]) -> Iterator[Camera]:
    """Of a person with those joints in pose 0, whose pelvis is at ROOT."""
    place = joint_transforms(hanging_arms(), joints)[:, :3, 3]
    for joint, over, azimuth, distance, field in shots:
        target = place[joint] - place[PELVIS] + [0, over, 0]
        yield orbit_camera(target, distance, azimuth, 0.05, (side, side), np.radians(field))


def true_tiles(name: str, side: int, shots: Iterable[Shot] = VIEWS, sheen: float = 0.0) -> list[Tile]:
    """The person that was filmed, in soft light, shining as in the films."""
    subject = load_subject(name)
    with open_context() as context:
        studio = Studio(Rasteriser(context), subject, 2, sheen)
        vertices = studio.posed(hanging_arms(), ROOT)
        photos = [studio.take(vertices, camera, STILL["soft"]) for camera in cameras(subject.joints, side, shots)]
    return [np.where(photo.mask[..., None] > 0, photo.image, GROUND) for photo in photos]


def avatar_tiles(path: str | Path, side: int, shots: Iterable[Shot] = VIEWS) -> list[Tile]:
    """The avatar as the player draws it."""
    avatar = read_avatar(path)
    with OffscreenRenderer(avatar, size=(side, side)) as renderer:
        views = cameras(np.asarray(avatar.joint_positions, np.float64), side, shots)
        return [renderer.draw(hanging_arms(), ROOT, camera)[..., :3] for camera in views]


def write_sheet(out: Path, pairs: Iterable[tuple[str, str | Path]], side: int = 512, sheen: float = 0.0) -> None:
    """Two columns of people, or one of two at most: person as `synth` takes it, and its avatar file."""
    rows = []
    for person, avatar in pairs:
        both = zip(true_tiles(person, side, sheen=sheen), avatar_tiles(avatar, side), strict=True)
        rows.append(np.concatenate([np.concatenate(tiles, 1) for tiles in both], 1))
    high = max(min(2, len(rows)), -(-len(rows) // 2))
    rows += [np.zeros_like(rows[0])] * (-len(rows) % high)
    save_tiles(out, [rows[at : at + high] for at in range(0, len(rows), high)])


def save_tiles(out: Path, columns: Iterable[Iterable[UInt8[np.ndarray, "high wide 3"]]]) -> None:
    """Columns of pictures of one size beside each other, as a PNG or a JPEG."""
    sheet = np.concatenate([np.concatenate(list(column)) for column in columns], 1)
    with whole_file(out, "wb") as file:
        Image.fromarray(sheet).save(file, "PNG" if out.suffix == ".png" else "JPEG", quality=82, optimize=True)


def main(argv: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.beside_sheet", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("pairs", nargs="+", metavar="PERSON=AVATAR", help="as `synth` takes a person, and its .glb")
    parser.add_argument("--side", type=int, default=512, help="pixels of a picture")
    parser.add_argument("--sheen", type=float, default=0.0, help="of the films, as `synth` takes it")
    options = parser.parse_args(argv)
    write_sheet(options.out, [tuple(pair.rsplit("=", 1)) for pair in options.pairs], options.side, options.sheen)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
