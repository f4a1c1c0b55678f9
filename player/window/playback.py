"""The pose of every avatar on screen at a moment: each with its own motion or live source, start and place."""

from collections.abc import Sequence

import numpy as np

from player.live.face_sender import with_head
from player.live.playback import LivePlayback
from player.scene.renderer import Pose
from player.scene.track import Track
from player.window.timeline import Timeline


class Playback:
    """All tracks on one timeline. `live` says which avatars a live source poses instead of their track's motion."""

    def __init__(
        self, tracks: Sequence[Track], live: Sequence[tuple[LivePlayback, Sequence[int]]] = (), *,
        rate: float | None = None,
    ):  # fmt: skip
        self.tracks, self.live = list(tracks), list(live)
        rate = rate or tracks[0].motion.rate
        frames = max(int(np.ceil(track.end * rate - 1e-6)) for track in tracks)
        self.timeline = Timeline(max(frames, 1), rate)

    def advance(self, dt: float | int) -> None:
        """Let time pass."""
        self.timeline.advance(dt)
        for live, _ in self.live:
            live.advance(dt)

    def poses(self) -> list[Pose]:
        """A pose for each avatar, now."""
        poses: list[Pose | None] = [None] * len(self.tracks)
        for live, indices in self.live:
            live.playing = self.timeline.playing
            for index, pose in zip(indices, live.poses(), strict=True):
                track = self.tracks[index]
                moved = live.moves_body
                poses[index] = track.placed(pose) if moved else with_head(track.pose(self.timeline.seconds), pose)
        return [
            pose if pose is not None else track.pose(self.timeline.seconds)
            for pose, track in zip(poses, self.tracks, strict=True)
        ]

    def close(self) -> None:
        """Let go of the motions, whose files close with them."""
        self.tracks.clear()

    def drawn(self) -> None:
        """The picture of the last `poses` is on the screen."""
        for live, _ in self.live:
            live.drawn()

    def status(self) -> str:
        """Where the timeline is, and how the live sources do."""
        lines = [live.status() for live, _ in self.live]
        if not self.live or self.timeline.frames > 1:
            lines.insert(0, self.timeline.status())
        return "  ".join(lines)
