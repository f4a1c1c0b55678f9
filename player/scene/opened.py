"""The files of a scene, opened: avatars, their motions and the cameras. Films and the window begin here."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.camera import read_camera, read_cameras
from avatar.gltf.avatar_file import read_avatar
from player.scene.acting import opened_acting
from player.scene.camera_path import CameraPath, is_path
from player.scene.cameras import FrameCameras
from player.scene.capture_view import CaptureView, open_capture
from player.scene.framing import pelvis_height
from player.scene.motions import ground_for, motion_for, standing
from player.scene.scene import MANNEQUINS, Scene, SceneAvatar, SceneCamera
from player.scene.track import Track


def opened_avatars(scene: Scene, levels: int | None = None) -> list[Avatar]:
    """The avatars of a scene, their `levels` finest levels of detail (None: all); one that stands several times is read
    once."""
    read = {path: opened_avatar(path, levels) for path in dict.fromkeys(entry.path for entry in scene.avatars)}
    return [read[entry.path] for entry in scene.avatars]


def opened_avatar(path: str, levels: int | None = None) -> Avatar:
    """An avatar file, or one of those that travel with the program, by its name."""
    if path in MANNEQUINS:
        from player.scene.mannequin import clothed

        return clothed("female" if path.endswith(":female") else "male")
    return read_avatar(path, levels=levels)


def opened_tracks(
    scene: Scene, avatars: Sequence[Avatar], cameras: Sequence[SceneCamera], capture: CaptureView | None = None
) -> list[Track]:
    """The motion of each avatar in its place, as it is seen through these cameras. One that is posed live stands; the
    first, where it has no motion, moves as in the video of the capture."""
    assert len(avatars) == len(scene.avatars)
    return [opened_track(scene, index, avatar, capture, cameras) for index, avatar in enumerate(avatars)]


def opened_track(
    scene: Scene, index: int, avatar: Avatar, capture: CaptureView | None, cameras: Sequence[SceneCamera] | None = None
) -> Track:
    """The motion of one avatar of a scene; `cameras` are the scene's, where no others are named."""
    entry = scene.avatars[index]
    ground = ground_for(entry.ground, scene.cameras if cameras is None else cameras)
    track = _track(entry, avatar, ground, capture if index == 0 else None)
    track.joints, track.foot_lock = avatar.joint_positions, scene.effects.foot_lock
    track.acting = opened_acting(entry, avatar)
    return track


def _track(entry: SceneAvatar, avatar: Avatar, ground: str, capture: CaptureView | None) -> Track:
    at, turn = np.array(entry.at, np.float64), float(np.radians(entry.turn_deg))
    if entry.live is not None and entry.motion is None:
        return Track(standing(pelvis_height(avatar)), at=at, turn=turn, name=entry.live)
    if entry.motion is None and capture is not None:
        return Track(capture.poses, entry.start, at, turn, f"the {capture.part} video")
    motion = motion_for(avatar, entry.motion, body=entry.body, hands=entry.hands, ground=ground)
    return Track(motion, entry.start, at, turn, entry.motion or motion.name)


def notes_of(tracks: Sequence[Track]) -> list[str]:
    """What was assumed about the motions: what holds for all of them once, the rest by avatar."""
    if len({track.motion.notes for track in tracks}) == 1:
        return list(tracks[0].motion.notes)
    shared = set.intersection(*(set(track.motion.notes) for track in tracks))
    return [
        note if note in shared else f"avatar {k} ({track.name}), {note}"
        for k, track in enumerate(tracks, 1)
        for note in track.motion.notes
        if note not in shared or k == 1
    ]


def still_faces(tracks: Sequence[Track], avatars: Sequence[Avatar], level: int = 0) -> list[str]:
    """A note for each avatar whose face life, speech or its motion should move, and that has none at this level."""
    notes = []
    for track, avatar in zip(tracks, avatars, strict=True):
        if avatar.level(level).face is not None or (track.acting is None and track.pose(0.0).face is None):
            continue
        finest, drawn = sum(one.face is not None for one in avatar.levels), min(level, len(avatar.levels) - 1)
        why = f"at level {drawn}; levels below {finest} have a face" if finest else "for want of one in its file"
        notes.append(f"{avatar.name}: its face stays still {why}")
    return notes


def opened_capture(camera: SceneCamera) -> CaptureView | None:
    """The video of a capture that a camera is; None for cameras of other kinds."""
    if camera.kind != "capture" or camera.path is None:
        return None
    return open_capture(camera.path, camera.name or "body")


def opened_camera(camera: SceneCamera, capture: CaptureView | None = None) -> CameraPath | FrameCameras:
    """The cameras of a file: along a path, or one for each frame; of a capture, where it is one."""
    assert camera.path is not None, "these kinds have a path"
    capture = capture or opened_capture(camera)
    if capture is not None:
        return capture.frame_cameras
    if Path(camera.path).suffix.lower() == ".npz":
        return FrameCameras(read_cameras(camera.path))
    if camera.kind == "path" or is_path(camera.path):
        return CameraPath.read(camera.path)
    return FrameCameras([read_camera(camera.path)])


def still_seconds(tracks: Sequence[Track], camera: CameraPath | FrameCameras | None) -> float:
    """Seconds that the cameras of a file last before bodies that no motion moves; 0 where one does."""
    if not isinstance(camera, FrameCameras) or any(track.motion.frames > 1 for track in tracks):
        return 0.0
    return len(camera.cameras) / (camera.rate or tracks[0].motion.rate)
