"""Feet that stay where they stand: a filter of the motions, before anything is drawn. No pass.

Apart from held_feet.py, so that a scene that does not ask for it loads no inverse kinematics.
"""

from collections.abc import Sequence
from typing import Annotated, ClassVar

from command.settings import Above, AtLeast, AtMost, settings
from player.draw.plan import Absent, Draft, Pass, PassState, Stage


@settings
class FootLock:
    """When a toe is held; lengths are those of a grown person's, and scale with the avatar's legs."""

    stage: ClassVar[Stage] = Stage.AVATARS

    speed: Annotated[float, Above(0), AtMost(5),
        "metres a second: a toe slower than this is held, until it is twice as fast"] = 0.35
    height: Annotated[float, Above(0), AtMost(1),
        "metres above where toes stand: a lower one is held, until it is twice as high"] = 0.03
    farthest: Annotated[float, AtLeast(0), AtMost(1), "metres that a toe is moved at most"] = 0.15
    release: Annotated[float, Above(0), AtMost(5), "seconds in which it comes to its place and is let go"] = 0.15

    def passes(self, draft: Draft) -> Sequence[Pass]:
        return (Absent("foot lock", "motions are filtered before they are drawn", state=PassState.KEPT),)
