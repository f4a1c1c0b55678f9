"""A scene: avatars with their motions, cameras, background and effects. Read from scene.toml, or made of options.

docs/scenes.md documents the file. Fields here are keys there.
"""

from dataclasses import dataclass, field

from player.effects import Background, Effects

CAMERAS = ("front", "orbit", "turntable", "file", "path", "capture")


@dataclass(frozen=True)
class SceneAvatar:
    """One avatar on stage."""

    path: str  # avatar file (.glb), or mannequin, mannequin:female: the built-in body
    motion: str | None = None  # pose file, EasyMocap folder, counting or walking; none: T-pose
    live: str | None = None  # vmc:PORT, udp:PORT or ws:PORT, instead of a motion
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)  # metres, added to where the motion puts it
    turn_deg: float = 0.0  # about the vertical through the world's origin, before `at`
    hands: str = "file"  # the motion's hands: file, flat, relaxed or mean
    body: str | None = None  # SMPL+H model that the pose file was made for
    start: float = 0.0  # seconds into the motion at which the scene begins


@dataclass(frozen=True)
class SceneCamera:
    """One camera. Render uses the first, play switches between them."""

    kind: str = "front"  # front and orbit are fitted to the avatars; turntable, file, path, capture
    path: str | None = None  # camera file, camera path (JSON) or capture folder
    name: str | None = None  # shown in the window; of a capture: body, head, hand_left or hand_right
    seconds: float | None = None  # one turn of orbit and turntable; none: the length of the motion
    fov_deg: float | None = None  # vertical field of view of fitted cameras


@dataclass(frozen=True)
class Scene:
    """Everything that render and play show."""

    avatars: tuple[SceneAvatar, ...]
    cameras: tuple[SceneCamera, ...] = (SceneCamera(),)
    background: Background = field(default_factory=Background)
    effects: Effects = field(default_factory=Effects)
    size: tuple[int, int] | None = None  # pixels; none: the camera file's, else 640 x 640
    rate: float | None = None  # frames per second; none: the first motion's
