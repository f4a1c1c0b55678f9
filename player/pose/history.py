"""One pose, and undo and redo of posing: one immutable `KeptPose` replaced by another, and the way back.

Changes that carry the same drag mark become one step, however many pixels the pointer took.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.face import REST, FaceFrame

# steps of undo that are kept
STEPS = 500


@dataclass(frozen=True, eq=False)
class KeptPose:
    """One pose; its arrays are never written to."""

    axis_angle: Float[Array, "52 3"]
    root: Float[Array, "3"]
    # what the face does (avatar/face.py)
    weights: Float[Array, "52"] = field(default_factory=lambda: REST.weights)
    gaze: Float[Array, "2 2"] = field(default_factory=lambda: REST.gaze)

    @property
    def face(self) -> FaceFrame | None:
        """None: it rests."""
        frame = FaceFrame(self.weights, self.gaze)
        return None if frame.rests else frame

    def __post_init__(self):
        for name, given in list(vars(self).items()):
            value = np.array(given, np.float64)  # a copy: the giver may go on writing to its own
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def same(self, other: "KeptPose") -> bool:
        """Equal to the last bit."""
        return all(np.array_equal(one, vars(other)[name]) for name, one in vars(self).items())


class History:
    """The present pose, what was done before it with the pose before each step, and what was undone."""

    def __init__(self, pose: KeptPose):
        self.pose = self.saved = pose
        self.past: list[tuple[str, KeptPose]] = []
        self.future: list[tuple[str, KeptPose]] = []
        # mark of the drag that the last step belongs to
        self._drag: object | None = None

    @property
    def dirty(self) -> bool:
        """Whether the pose was changed since saving or loading; undoing back to what was saved counts as unchanged."""
        return self.pose is not self.saved

    def change(self, label: str, pose: KeptPose, drag: object | None = None) -> None:
        """Put `pose` in place of what is; steps with an equal `drag` mark (not None) are one step of undo."""
        if drag is None or drag != self._drag:
            self.past.append((label, self.pose))
            del self.past[:-STEPS]
        self.future.clear()
        self._drag = drag
        self.pose = pose

    def before(self, drag: object | None) -> KeptPose:
        """The pose in which a drag began that is under way; of any other change, what is."""
        return self.past[-1][1] if drag is not None and drag == self._drag else self.pose

    def end_drag(self) -> None:
        """The pointer was let go: the next change is a step of its own. A drag that led nowhere leaves no step."""
        if self._drag is not None and self.past:
            before = self.past[-1][1]
            if before.same(self.pose):
                self.pose = before
                self.past.pop()
        self._drag = None

    def mark_saved(self) -> None:
        self.end_drag()
        self.saved = self.pose

    def undo(self) -> str | None:
        """One step back; its name, or None where there is none."""
        return self._walk(self.past, self.future)

    def redo(self) -> str | None:
        return self._walk(self.future, self.past)

    def _walk(self, come_from: list[tuple[str, KeptPose]], leave_to: list[tuple[str, KeptPose]]) -> str | None:
        self.end_drag()
        if not come_from:
            return None
        label, pose = come_from.pop()
        leave_to.append((label, self.pose))
        self.pose = pose
        return label
