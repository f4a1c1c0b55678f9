"""One way to draw an avatar: a record of numbers, and how each of them is realised."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from avatar.baked_avatar import Avatar, Level, TwistSkin
from avatar.texture import mipmaps
from player.effects.background import Background
from player.gl.context import Context
from player.scene.effects import PLAIN, Effects
from player.scene.renderer import Renderer

VIEW_NAMES = {"network": "network per pixel", "linear": "linear", "vertex": "per vertex", "off": "paper mode"}
SHARE_NAMES = {
    4.0: "16 samples a pixel", 2.0: "4 samples a pixel",
    0.75: "3/4 resolution", 0.5: "half resolution", 0.25: "quarter resolution",
}  # fmt: skip
# joints that a vertex of the file follows at most
MOST_JOINTS = 4
BLACK = Background("color", (0.0, 0.0, 0.0, 0.0))


@dataclass(frozen=True)
class Rung:
    """What is traded for time, in the order of the fields: view dependence; level of detail, 0 the finest; pixels as a
    share of full resolution on each side, above 1 several for each pixel shown; how often the sides of the textures are
    halved; how many joints each vertex follows."""

    name: str
    view: str
    level: int = 0
    share: float = 1.0
    halvings: int = 0
    joints: int = MOST_JOINTS

    def size(self, full: tuple[int, int]) -> tuple[int, int]:
        """Pixels it draws, at least one."""
        return max(1, round(full[0] * self.share)), max(1, round(full[1] * self.share))

    def prepared(self, avatars: Sequence[Avatar]) -> list[Avatar]:
        """The avatars with its textures and joints; one that stands several times stays one."""
        once = {id(avatar): with_strongest_joints(avatar, self.joints) for avatar in avatars}
        once = {key: with_halved_textures(avatar, self.halvings) for key, avatar in once.items()}
        return [once[id(avatar)] for avatar in avatars]

    def renderer(
        self, context: Context, avatars: Sequence[Avatar], full: tuple[int, int], *, effects: Effects = PLAIN,
        background: Background = BLACK,
    ) -> Renderer:  # fmt: skip
        """A renderer that draws the avatars so, on its share of `full` pixels."""
        effects = replace(effects, view=self.view)
        return Renderer(
            context, self.prepared(avatars), self.size(full), effects=effects, background=background, level=self.level
        )  # fmt: skip


def shown(pixels: UInt8[np.ndarray, "height width 3"], full: tuple[int, int]) -> UInt8[np.ndarray, "rows columns 3"]:
    """What was drawn at full resolution: fewer pixels enlarged linearly, several for each the mean of them."""
    picture = Image.fromarray(np.ascontiguousarray(pixels))
    if picture.size == full:
        return pixels
    more = picture.width > full[0] or picture.height > full[1]
    return np.asarray(picture.resize(full, Image.Resampling.BOX if more else Image.Resampling.BILINEAR))


def rung_of(
    avatar: Avatar, view: str, level: int = 0, share: float = 1.0, halvings: int = 0, joints: int = MOST_JOINTS
) -> Rung:
    """The rung of these numbers, named after what it draws of this avatar."""
    drawn = avatar.level(level)
    words = [VIEW_NAMES[view], f"{round(len(drawn.faces) / 1000)}k"]
    if halvings:
        words.append(f"texture {min(drawn.base_color.shape[:2]) >> halvings}")
    if joints < MOST_JOINTS:
        words.append(f"{joints} joint" + "s" * (joints > 1))
    if share != 1:
        words.append(SHARE_NAMES[share])
    return Rung(", ".join(words), view, level, share, halvings, joints)


def with_halved_textures(avatar: Avatar, times: int) -> Avatar:
    """The avatar with the sides of all textures halved `times` times, each texel the mean of four."""
    if not times:
        return avatar
    levels = [
        replace(
            level,
            base_color=mipmaps(level.base_color, times + 1)[-1],
            features=None if level.features is None else mipmaps(level.features, times + 1)[-1],
        )
        for level in avatar.levels
    ]
    return replace(avatar, levels=tuple(levels))


def with_strongest_joints(avatar: Avatar, count: int) -> Avatar:
    """The avatar whose vertices follow only the `count` joints of most weight, which then sum to 1. Shaders for it read
    no more than those (`Level.influences`)."""
    if all(level.influences <= count for level in avatar.levels):
        return avatar

    def weaker(level: Level) -> Level:
        joints, weights = strongest_joints(level.joints, level.weights, count)
        twist = None if level.twist is None else TwistSkin(*strongest_joints(*level.drawn_skin, count))
        return replace(level, joints=joints, weights=weights, twist=twist)

    return replace(avatar, levels=tuple(weaker(level) for level in avatar.levels))


def strongest_joints(
    joints: UInt8[np.ndarray, "vertices 4"], weights: UInt8[np.ndarray, "vertices 4"], count: int
) -> tuple[UInt8[np.ndarray, "vertices 4"], UInt8[np.ndarray, "vertices 4"]]:
    """The `count` heaviest first, weights scaled to sum to 255; what rounding leaves goes to the heaviest."""
    order = np.argsort(-weights.astype(np.int16), axis=1, kind="stable")
    kept = np.take_along_axis(weights, order, 1).astype(np.int64)
    kept[:, count:] = 0
    kept = kept * 255 // kept.sum(1, keepdims=True)
    kept[:, 0] += 255 - kept.sum(1)
    named = np.where(kept > 0, np.take_along_axis(joints, order, 1), 0)
    return named.astype(np.uint8), kept.astype(np.uint8)
