"""Where the picture is seen from: the cameras, whether they go along with the avatar, and the path being recorded."""

import numpy as np
from jaxtyping import Float

from avatar.camera import Camera
from avatar.skeleton import JOINTS, PARENTS, joint_transforms
from command.progress import plural
from player.draw.posing import posed_vertices
from player.scene.framing import fitted
from player.scene.scene import SceneCamera
from player.window.recorder import free_name
from player.window.show import Show
from player.window.state import WindowState

HEAD = JOINTS.index("head")
# how much farther away than a part just fits, so that what is about it is seen too
AROUND = 1.25
FLAT = (1.0, 0.0, 1.0)


class Viewpoint:
    """The cameras of the window and what they follow. `capture` is the source video, where there is one."""

    def __init__(self, state: WindowState, show: Show):
        self.state, self.cameras, self.capture = state, show.cameras, show.capture
        # the orbit goes along with the first avatar, from where that was in the beginning
        self.follow = show.follow
        # or with a joint of an avatar, and where that was then
        self._part: tuple[int, int, Float[np.ndarray, "3"]] | None = None
        self.begin()

    def begin(self) -> None:
        self._start = self.state.playback.poses()[0][1]

    @property
    def _size(self) -> tuple[int, int]:
        _, _, width, height = self.state.layout.area
        return max(width, 1), max(height, 1)

    def camera(self) -> Camera:
        """What is looked through now, for the free area."""
        playback = self.state.playback
        rate = playback.tracks[0].motion.rate
        return self.cameras.camera(self._size, playback.timeline.seconds, rate, self._along())

    def _along(self) -> Float[np.ndarray, "3"] | None:
        """How far the orbit has gone along, metres."""
        if self._part is not None:
            index, joint, place = self._part
            return self.joints(index)[joint, :3, 3] - place
        return (self.state.last.poses[0][1] - self._start) * FLAT if self.follow else None

    def joints(self, index: int) -> Float[np.ndarray, "52 4 4"]:
        """world_from_joint of an avatar in the last frame."""
        axis_angle, root, _ = self.state.last.poses[index]
        return joint_transforms(axis_angle, self.state.avatars[index].joint_positions.astype(np.float64), root)

    def show_part(self, joint: int, middle: int) -> None:
        """Look from the front at what a joint of the selected avatar moves; go along with the joint in its middle."""
        index = self.state.selection.avatar
        avatar, joints, below = self.state.avatars[index], self.joints(index), [joint]
        # a child has a higher number than its parent
        for child in range(joint, len(PARENTS)):
            below += [child] * (PARENTS[child] in below)
        level = avatar.level(2)
        points = posed_vertices(avatar, level, self.state.last.poses[index][:2])[np.isin(level.skin.heaviest, below)]
        x, _, z = joints[HEAD if joint == HEAD else 0, :3, 2]
        orbit, azimuth = self.cameras.orbit, float(np.arctan2(x, z))
        view = fitted(points, azimuth, self._size, fov=orbit.fov)
        orbit.look(view._replace(distance=AROUND * view.distance))
        self.cameras.kind, self._part = "orbit", (index, middle, joints[middle, :3, 3])

    def reset(self) -> None:
        self._part = None
        self.cameras.orbit.reset()

    def scene_camera(self) -> SceneCamera:
        """The orbit or turntable of now as a scene has it."""
        kind, orbit, along = self.cameras.kind, self.cameras.orbit, self._along()
        if kind != "turntable":
            kind = "follow" if self.follow and self._part is None else "front"
        # what goes along is placed as it was in the beginning
        eye = orbit.camera((1, 1), None if kind == "follow" else along).eye
        target = orbit.target if kind == "follow" or along is None else orbit.target + along
        places = [tuple(np.round(place, 6).tolist()) for place in (eye, target)]
        seconds = self.cameras.turn_seconds if kind == "turntable" else None
        fov = round(float(np.degrees(orbit.fov)), 6)
        return SceneCamera(kind, seconds=seconds, fov_deg=fov, eye=places[0], target=places[1])

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
        """Write the recorded path beside the other files of this run; that it cannot be written is said."""
        if not self.cameras.keys or self.cameras.path is None:
            self.state.messages.say("no camera keys yet: k records one")
            return
        with self.state.messages.saying_errors():
            name = free_name("selfscan-path", ".json")
            self.cameras.path.write(name)
            self.state.messages.say(f"{name} written: {plural(len(self.cameras.keys), 'key')}")
