"""Undo and redo of posing: one immutable `PoseState` replaced by another, and the way back.

Changes that carry the same drag mark become one step, however many pixels the pointer took.
"""

from dataclasses import dataclass

from player.pose.keyframes import Easing, Keys, Pose, pose_at

# steps of undo that are kept
STEPS = 500


@dataclass(frozen=True, eq=False)
class PoseState:
    """All that undo brings back."""

    pose: Pose
    keys: Keys = ()
    easing: Easing = "linear"
    frame: int = 0  # the timeline's

    @property
    def unkeyed(self) -> bool:
        """Whether there are keys and the pose is not what they give at this frame."""
        return bool(self.keys) and not pose_at(self.keys, self.frame, self.easing).same(self.pose)


class History:
    """The present state, what was done before it with the state before each step, and what was undone."""

    def __init__(self, state: PoseState):
        self.state = self.saved = state
        self.past: list[tuple[str, PoseState]] = []
        self.future: list[tuple[str, PoseState]] = []
        # mark of the drag that the last step belongs to
        self._drag: object | None = None

    @property
    def dirty(self) -> bool:
        """Whether there is what a file would lack: keys, easing, or a pose changed since saving or loading.

        Undoing back to what was saved counts as unchanged.
        """
        state, saved = self.state, self.saved
        if state.keys is not saved.keys or state.easing != saved.easing:
            return True
        return state.unkeyed if state.keys else state.pose is not saved.pose

    def change(self, label: str, state: PoseState, drag: object | None = None) -> None:
        """Put `state` in place of what is; steps with an equal `drag` mark (not None) are one step of undo."""
        if drag is None or drag != self._drag:
            if self.state is state:
                return
            self._step(label)
        self.future.clear()
        self._drag = drag
        self.state = state

    def end_drag(self) -> None:
        """The pointer was let go: the next change is a step of its own. A drag that led nowhere leaves no step."""
        if self._drag is not None and self.past:
            before = self.past[-1][1]
            if before.pose.same(self.state.pose) and before.keys is self.state.keys:
                self.state = before
                self.past.pop()
        self._drag = None

    def go_to(self, label: str, state: PoseState) -> None:
        """Another frame of the timeline: no step of undo, unless the present pose was changed and is no key."""
        if self.state.unkeyed:
            self._step(label)
            self.future.clear()
        self.state = state

    def mark_saved(self) -> None:
        """The present state is in a file."""
        self.end_drag()
        self.saved = self.state

    def undo(self) -> str | None:
        """One step back; its name, or None where there is none."""
        return self._walk(self.past, self.future)

    def redo(self) -> str | None:
        return self._walk(self.future, self.past)

    def _walk(self, come_from: list[tuple[str, PoseState]], leave_to: list[tuple[str, PoseState]]) -> str | None:
        self.end_drag()
        if not come_from:
            return None
        label, state = come_from.pop()
        leave_to.append((label, self.state))
        self.state = state
        return label

    def _step(self, label: str) -> None:
        self.past.append((label, self.state))
        del self.past[:-STEPS]
