"""Where the picture is seen from: the cameras, whether they go along with the avatar, and the path being recorded."""

from avatar.camera import Camera
from command.progress import plural
from player.scene.cameras import Cameras
from player.scene.capture_view import CaptureView
from player.window.recorder import free_name
from player.window.state import WindowState


class Viewpoint:
    """The cameras of the window and what they follow. `capture` is the source video, where there is one."""

    def __init__(self, state: WindowState, cameras: Cameras, *, capture: CaptureView | None, follow: bool):
        self.state, self.cameras, self.capture = state, cameras, capture
        # the orbit goes along with the first avatar, from where that was in the beginning
        self.follow = follow
        self._start = state.last.poses[0][1]

    def camera(self) -> Camera:
        """What is looked through now, for the free area."""
        _, _, width, height = self.state.layout.area
        along = (self.state.last.poses[0][1] - self._start) * [1.0, 0.0, 1.0] if self.follow else None
        size = (max(width, 1), max(height, 1))
        return self.cameras.camera(size, self.state.timeline.seconds, self.video_frame, along)

    @property
    def video_frame(self) -> int:
        """The frame of the source video that belongs to now."""
        if self.capture is None:
            return 0
        return min(int(self.state.timeline.seconds * self.capture.poses.rate + 1e-6), len(self.capture.images) - 1)

    @property
    def shows_video(self) -> bool:
        return self.capture is not None and self.cameras.kind == "capture"

    def add_key(self) -> None:
        """Record the camera of now as a key of the path."""
        seconds = self.state.timeline.seconds
        self.cameras.add_key(seconds, self.camera())
        self.state.messages.say(f"camera key {len(self.cameras.keys)} at {seconds:.2f} s; j saves the path")

    def save_path(self) -> None:
        """Write the recorded path beside the other files of this run."""
        if not self.cameras.keys or self.cameras.path is None:
            self.state.messages.say("no camera keys yet: k records one")
            return
        name = free_name("selfscan-path", ".json")
        self.cameras.path.write(name)
        self.state.messages.say(f"{name} written: {plural(len(self.cameras.keys), 'key')}")
