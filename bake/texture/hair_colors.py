"""Where hanging hair and what it hangs over show each other's colors.

Poses are estimated: in many frames a lock ends elsewhere than on the surface. So hair shows the shirt behind it, and a
shoulder beside hair shows hair; both count as unseen. A color is compared with a tone, which is a color without its
brightness: u of unit length, and off(c, u) the root mean square of c - (c u) u over the channels, sRGB.
"""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.rotation import unit_or_zero
from bake.texture.fill import TexelSurface, largest_piece, nearest_places, one_of_each_cell

# difference from the tone of a lock of hair, from which a place of it shows something else
STRANGE = 0.06
# metres round such a place within which half of that difference is enough
MIXED = 0.006
# metres beside hair within which what it hangs over may show it; places farther away with whose tones that is compared;
# what a color differs from all of these at least, and how many times less from hair's tone; what is brighter than so
# great a share of the hair is none
BESIDE, COMPARED, OTHER, NEARER, BRIGHT = 0.06, 24, 0.03, 2.0, 0.95


def strange_beside_hair(
    surface: TexelSurface, color: Float[Array, "texels 3"], seen: Bool[Array, "texels"], chin: float | None
) -> Bool[Array, "texels"]:
    """Texels that show what hangs before or behind them. None above the `chin` (canonical height, metres): hair that
    reaches too far into a forehead shows skin, on which the hair's color would end in a saw."""
    return strange_on_hair(surface, color, seen, chin) | hair_on_body(surface, color, seen, chin)


def strange_on_hair(
    surface: TexelSurface, color: Float[Array, "texels 3"], seen: Bool[Array, "texels"], chin: float | None
) -> Bool[Array, "texels"]:
    """Texels of hanging hair that show what lies behind it, and within MIXED of these what is a mix of the two."""
    found = np.zeros(len(color), bool)
    for piece in np.flatnonzero(np.arange(surface.piece.max() + 1) != largest_piece(surface)):
        own = surface.piece == piece
        if (own & seen).any():
            off = _off(color, unit_or_zero(np.median(color[own & seen], axis=0)))
            found[_with_mixed(surface, np.flatnonzero(own & (off > STRANGE)), own & (off > STRANGE / 2))] = True
    return found if chin is None else found & (surface.points[:, 1] < chin)


def hair_on_body(
    surface: TexelSurface, color: Float[Array, "texels 3"], seen: Bool[Array, "texels"], chin: float | None
) -> Bool[Array, "texels"]:
    """Seen texels of the largest piece beside hair that show it: their tone is hair's, and none of those that lie
    around farther from hair. Cloth and skin of hair's own tone stay, and what is brighter than hair is."""
    found = np.zeros(len(color), bool)
    low = np.full(len(color), True) if chin is None else surface.points[:, 1] < chin
    of_body = surface.piece == largest_piece(surface)
    hair, body = np.flatnonzero(seen & low & ~of_body), np.flatnonzero(seen & low & of_body)
    if not len(hair) or not len(body):
        return found
    away = KDTree(surface.points[hair]).query(surface.points[body], distance_upper_bound=BESIDE)[0]
    near, far = body[away < BESIDE], one_of_each_cell(surface, body[away >= BESIDE])
    if not len(near) or not len(far):
        return found
    around = unit_or_zero(color[nearest_places(surface, far, near, COMPARED)[1]])
    other = np.min([_off(color[near], tones) for tones in np.swapaxes(around, 0, 1)], axis=0)
    tone = unit_or_zero(np.median(color[hair], axis=0))
    own, dark = _off(color[near], tone), color[near] @ tone < np.quantile(color[hair] @ tone, BRIGHT)
    mixed = np.zeros(len(color), bool)
    mixed[near] = (other > OTHER / 2) & (own < NEARER * other)
    found[_with_mixed(surface, near[(other > OTHER) & (NEARER * own < other) & dark], mixed)] = True
    return found


def _off(color: Float[Array, "texels 3"], tone: Float[Array, "*texels 3"]) -> Float[Array, "texels"]:
    """How far colors are from a tone, darker or brighter: `tone` of unit length, one or one a texel."""
    return np.sqrt(np.square(color - (color * tone).sum(-1, keepdims=True) * tone).mean(-1))


def _with_mixed(surface: TexelSurface, strange: Array, mixed: Bool[Array, "texels"]) -> Array:
    """The texels numbered `strange`, and those that may be `mixed` within MIXED of them."""
    rows = np.flatnonzero(mixed)
    if not len(strange):
        return strange
    away = KDTree(surface.points[strange]).query(surface.points[rows], distance_upper_bound=MIXED)[0]
    return np.concatenate([strange, rows[away < MIXED]])
