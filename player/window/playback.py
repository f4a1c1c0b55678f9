"""The pose of every avatar on screen at a moment: each with its own motion or live source, start and place."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from player.live.face_sender import with_head
from player.live.playback import LivePlayback
from player.scene.renderer import Pose
from player.scene.track import Track
from player.window.timeline import Timeline


class Playback:
    """All tracks on one timeline. `live` says which avatars a live source poses instead of their track's motion."""

    def __init__(
        self, tracks: Sequence[Track], live: Sequence[tuple[LivePlayback, Sequence[int]]] = (), *,
        rate: float | None = None, least: float = 0.0,
    ):  # fmt: skip
        """rate: frames a second of the timeline; None: the first motion's. least: seconds that it lasts at least."""
        self.tracks, self.live, self._rate, self._least = list(tracks), list(live), rate, least
        self.timeline = self._timeline()
        # seconds that have passed for life, which does not begin anew with the timeline
        self.lived = 0.0

    def _timeline(self) -> Timeline:
        rate = self._rate or self.tracks[0].motion.rate
        seconds = max(self._least, *(track.lasts() for track in self.tracks))
        return Timeline(max(int(np.ceil(seconds * rate - 1e-6)), 1), rate)

    def change(self, index: int, track: Track) -> None:
        """Another motion for an avatar, which stands where it stood; time begins anew, as long as it takes now."""
        before, self.tracks[index] = self.tracks[index], track
        track.at, track.turn, self._least = before.at, before.turn, 0.0
        line, self.timeline = self.timeline, self._timeline()
        self.timeline.playing, self.timeline.speed = line.playing, line.speed

    def advance(self, dt: float | int) -> None:
        self.timeline.advance(dt)
        self.lived += max(dt, 0.0) if self.timeline.playing else 0.0
        for live, _ in self.live:
            live.advance(dt)

    def poses(self) -> list[Pose]:
        """A pose for each avatar, now."""
        poses: list[Pose | None] = [None] * len(self.tracks)
        for live, indices in self.live:
            live.playing = self.timeline.playing
            for index, pose in zip(indices, live.poses(), strict=True):
                track = self.tracks[index]
                poses[index] = track.placed(pose) if live.moves_body else with_head(self._moved(track), pose)
        return [
            pose if pose is not None else self._moved(track) for pose, track in zip(poses, self.tracks, strict=True)
        ]

    def _moved(self, track: Track) -> Pose:
        return track.pose(self.timeline.seconds, self.lived)

    def faced(self, poses: Sequence[Pose], eye: Float[np.ndarray, "3"]) -> list[Pose]:
        """The poses with what faces do now, before a camera at `eye`."""
        now = self.timeline.seconds
        return [track.faced(pose, now, eye, self.lived) for track, pose in zip(self.tracks, poses, strict=True)]

    @property
    def film_seconds(self) -> float:
        """The moment in a film behind the avatars: where the timeline is; where it has one frame, what has passed."""
        return self.timeline.seconds if self.timeline.frames > 1 else self.lived

    @property
    def lives(self) -> bool:
        """Whether a face moves even if nothing else does."""
        acting = (track.acting for track in self.tracks)
        return self.timeline.playing and any(one is not None and one.seed is not None for one in acting)

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
