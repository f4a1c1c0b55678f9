"""Level of detail by size on screen: an avatar far away is drawn with fewer triangles and a smaller texture.

A level will do for an avatar h pixels tall while it has at least DENSITY h^2 triangles. A finer level is taken at once,
a coarser one only after it would have done for WAIT frames in a row for an avatar MARGIN times as tall, so that a size
about a limit changes nothing to and fro. A film keeps one level of each avatar from its first frame to its last, that
of its largest size: no frame depends on which were drawn before it.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

from avatar.baked_avatar import Avatar

# triangles a square pixel of height, of the box that an avatar is sure to stay inside: a quarter taller than a person.
# Measured in docs/speed.md: at a tenth, 10,000 and 2,500 triangles begin where a person is 250 and 130 pixels tall.
DENSITY = 0.1
MARGIN, WAIT = 1.15, 30


class BySize(NamedTuple):
    """A level of detail by each avatar's size on screen, none finer than this one, or these, one an avatar."""

    finest: int | Sequence[int] = 0


def level_for(avatar: Avatar, height: float, finest: int = 0) -> int:
    """The coarsest level, from `finest` on, that will do for the avatar at a height of so many pixels."""
    fitting = [k for k in range(finest, len(avatar.levels)) if len(avatar.levels[k].faces) >= DENSITY * height**2]
    return max(fitting, default=finest)


class DetailBySize:
    """Chooses the levels of detail of a scene's avatars, frame by frame."""

    def __init__(self, avatars: Sequence[Avatar]):
        self._avatars = avatars
        # frames for which a coarser level would have done; None: it has not been seen at this level
        self._waited: list[int | None] = [None] * len(avatars)

    def chosen(
        self, levels: Sequence[int], finest: Sequence[int], heights: Sequence[float | None],
        still: Collection[int] = (),
    ) -> tuple[int, ...]:  # fmt: skip
        """The levels to draw now, after `levels`, none finer than `finest`. heights: pixels, None of one that is out of
        view, which keeps its level as those of `still` do."""
        out = list(levels)
        for index, (avatar, height) in enumerate(zip(self._avatars, heights, strict=True)):
            if index in still:
                continue
            if height is None:
                # its change is not seen when it comes back
                self._waited[index] = None
                continue
            enough = level_for(avatar, height, finest[index])
            waited, coarser = self._waited[index], level_for(avatar, MARGIN * height, finest[index])
            self._waited[index] = 0
            if enough < levels[index] or waited is None:
                out[index] = enough
            elif coarser > levels[index]:
                self._waited[index] = waited + 1
                if waited + 1 >= WAIT:
                    out[index], self._waited[index] = coarser, 0
        return tuple(out)
