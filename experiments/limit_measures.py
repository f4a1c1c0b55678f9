"""Errors of the promises in docs/limits.md at a value (experiments/limits.py), through the files that a user gives.

Pictures are of the free body, painted so that a color is a place on it. What they should be is either the picture of a
usual value, where the promise is that nothing changes, or drawn in double precision by geometry/rasterise.py.
"""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from avatar.baked_avatar import Avatar
from avatar.camera import Camera, look_at, write_camera
from avatar.face import FaceFrame
from avatar.gltf.avatar_file import read_avatar, write_avatar
from avatar.motion.amass import write_amass
from avatar.motion.clip import Clip, Motion
from avatar.motion.read import read_motion
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from geometry.rasterise import rasterise
from player.draw.face import FaceBlend, within_limits
from player.draw.posing import posed_vertices
from player.film.film import Film
from player.film.stage import Stage
from player.gl.context import Context
from player.scene.camera_path import CameraPath
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer
from player.scene.scene_file import read_scene
from player.scene.track import Track

Image = UInt8[np.ndarray, "height width 4"]
SIDE = 96  # pixels of a picture
ALIKE = 16  # of 255; triangles are drawn exactly with one color each
PERSON, FRONT = '[[avatar]]\npath = "person.glb"\n', '[[camera]]\nkind = "front"\n'
PLAIN = 'view = "off"\nantialiasing = "none"\n'
RATE = 30  # frames a second


@dataclass(frozen=True)
class Place:
    """Where files are written and pictures drawn."""

    folder: Path
    context: Context


@cache
def painted(texels: int = 256) -> Avatar:
    """The free body without view dependence, its color a straight function of x + y + z."""
    body = mannequin()
    level = body.levels[0]
    low, high = level.positions.min(0), level.positions.max(0)
    along = ((level.positions - low) / (high - low)).mean(1)
    # away from the texture's ends, which its mips wrap round
    uv = np.stack([0.1 + 0.8 * along, np.full_like(along, 0.5)], 1)
    row = np.linspace(0, 255, texels)
    color = np.tile(np.stack([row, 255 - row, np.full_like(row, 128)], -1).astype(np.uint8), (16, 1, 1))
    level = replace(level, uv=uv, base_color=color, features=None)
    return replace(body, levels=(level,), network=None, linear=None, default_view="off")


def scene_picture(
    place: Place, avatars: str = PERSON, camera: str = FRONT, *, effects: str = PLAIN,
    size: tuple[int, int] = (SIDE, SIDE),
) -> tuple[Image, Stage, Camera]:  # fmt: skip
    """The first frame of a scene file whose tables these are, the scene that was opened, and its camera."""
    if not (place.folder / "person.glb").exists():
        write_avatar(place.folder / "person.glb", painted())
    path = place.folder / "scene.toml"
    head = f'size = {list(size)}\n[background]\nkind = "transparent"\n[effects]\n'
    path.write_text(head + effects + avatars + camera)
    stage = Stage(read_scene(path))
    poses, scene = stage.poses(0), stage.scene
    view = stage.camera_at(stage.fit(0, 1), 0, 1, size)(0, poses[0].root)
    renderer = Renderer(place.context, stage.avatars, size, effects=scene.effects, background=scene.background)
    try:
        return renderer.draw(poses, view), stage, view
    finally:
        renderer.release()


@cache
def usual(place: Place, effects: str = PLAIN) -> Image:
    return scene_picture(place, effects=effects)[0]


def exact(stage: Stage, camera: Camera) -> Image:
    """The same in double precision; all avatars are one."""
    avatar, poses = stage.avatars[0], stage.poses(0)
    level, out = avatar.levels[0], np.zeros((camera.size[1], camera.size[0], 4), np.uint8)
    vertices = np.concatenate([posed_vertices(avatar, level, pose[:2]) for pose in poses])
    faces = np.concatenate([level.faces.astype(np.int64) + k * len(level.positions) for k in range(len(poses))])
    seen = rasterise(vertices, faces, camera, near=1e-12).face
    person, texels = seen >= 0, level.base_color.shape[1]
    u = level.uv[level.faces[seen[person] % len(level.faces)], 0].mean(1)
    out[person, :3], out[person, 3] = level.base_color[0, np.minimum(u * texels, texels - 1).astype(int)], 255
    return out


def differing(image: Image, expected: Image) -> float:
    """Share of the person's pixels that differ by more than ALIKE; 1 where nobody is seen."""
    off = np.abs(image.astype(int) - expected).max(-1) > ALIKE
    person = (image[..., 3] > 0) | (expected[..., 3] > 0)
    return float(off.sum() / person.sum()) if person.any() else 1.0


def from_exact(picture: tuple[Image, Stage, Camera]) -> float:
    return differing(picture[0], exact(*picture[1:]))


def away(place: Place, metres: float) -> float:
    return differing(scene_picture(place, PERSON + f"at = [{metres!r}, 0, 0]\n")[0], usual(place))


def away_in_shadow(place: Place, metres: float) -> float:
    effects = PLAIN + "[effects.ground]\n[effects.contact]\n"
    image = scene_picture(place, PERSON + f"at = [{metres!r}, 0, 0]\n", effects=effects)[0]
    return differing(image, usual(place, effects))


def motion_away(place: Place, metres: float) -> float:
    clip = Clip(np.zeros((1, 52, 3)), np.array([[metres, 0.9, 0.0]]), RATE)
    write_amass(place.folder / "clip.npz", clip)
    return differing(scene_picture(place, PERSON + 'motion = "clip.npz"\n')[0], usual(place))


def one_behind(place: Place, metres: float) -> float:
    """Seen by a camera that stands still."""
    camera = FRONT + "eye = [0, 1, 4]\ntarget = [0, 1, 0]\n"
    return from_exact(scene_picture(place, PERSON + PERSON + f"at = [0, 0, {-metres!r}]\n", camera))


def turned_on_stage(place: Place, degrees: float) -> float:
    image, expected = (
        scene_picture(place, PERSON + f"turn_deg = {angle!r}\n")[0] for angle in (degrees, math.fmod(degrees, 360))
    )
    return differing(image, expected)


def sized(place: Place, times: float) -> float:
    body = painted()
    level = body.levels[0]
    level = replace(level, positions=(level.positions.astype(np.float64) * times).astype(np.float32))
    body = replace(body, levels=(level,), joint_positions=body.joint_positions * times)
    write_avatar(place.folder / "sized.glb", body)
    return differing(scene_picture(place, PERSON.replace("person", "sized"))[0], usual(place))


def camera_away(place: Place, metres: float) -> float:
    """Its focal length grows with its distance."""
    focal = SIDE * metres / 2.2
    K = np.array([[focal, 0, SIDE / 2], [0, focal, SIDE / 2], [0, 0, 1]])
    camera = Camera(K, look_at((0, -0.1, metres), (0, -0.1, 0)), (SIDE, SIDE))
    write_camera(place.folder / "camera.json", camera)
    table = '[[camera]]\nkind = "file"\npath = "camera.json"\n'
    return from_exact(scene_picture(place, PERSON + "turn_deg = 70\n", table))


def field_of_view(place: Place, degrees: float) -> float:
    return from_exact(scene_picture(place, camera=FRONT + f"fov_deg = {degrees!r}\n"))


def picture_wide(place: Place, pixels: float) -> float:
    return from_exact(scene_picture(place, size=(int(pixels), 64)))


def texture_wide(place: Place, texels: float) -> float:
    write_avatar(place.folder / "texture.glb", painted.__wrapped__(int(texels)))
    return from_exact(scene_picture(place, PERSON.replace("person", "texture")))


def triangles(place: Place, count: float) -> float:
    """The free body's, over and over."""
    body = painted()
    level = body.levels[0]
    faces = np.resize(level.faces, (int(count), 3))
    write_avatar(place.folder / "faces.glb", replace(body, levels=(replace(level, faces=faces),)))
    return differing(scene_picture(place, PERSON.replace("person", "faces"))[0], usual(place))


def avatars(place: Place, count: float) -> float:
    """All but the last stand behind the camera."""
    aside = "".join(PERSON + f"at = [{k}, 0, 500]\n" for k in range(int(count) - 1))
    camera = FRONT + "eye = [0, 1, 4]\ntarget = [0, 0.9, 0]\n"
    return differing(scene_picture(place, aside + PERSON, camera)[0], scene_picture(place, PERSON, camera)[0])


def reread(place: Place, pose: np.ndarray, rate: float = RATE) -> Motion:
    write_amass(place.folder / "clip.npz", Clip(pose, np.ones((2, 3)), rate))
    return read_motion(place.folder / "clip.npz")


def joint_turns(place: Place, turns: float) -> float:
    """Degrees off."""
    axis, pose = np.array([0.36, 0.48, 0.8]), np.zeros((2, 52, 3))
    pose[:, 16] = axis * (0.5 + 2 * np.pi * round(turns))
    found = matrix_from_axis_angle(reread(place, pose).read().axis_angle[0, 16])
    off = axis_angle_from_matrix(found @ matrix_from_axis_angle(-0.5 * axis))
    return float(np.degrees(np.linalg.norm(off)))


def frames_off(track: Track, rate: float, first: int) -> float:
    """The largest distance of the frame shown from the one that the moment is of."""
    wanted = first + np.unique(np.geomspace(1, 1e6, 500).astype(int))
    start = Fraction(track.start) * Fraction(rate)
    return max(float(abs(track.frame(int(n) / rate) - n - start)) for n in wanted)


def still(frames: int, rate: float) -> Motion:
    return Motion("still", frames, rate, (), lambda start, stop: (np.zeros((stop - start, 52, 3)), np.zeros((1, 3))))


def clip_rate(place: Place, rate: float) -> float:
    read = float(reread(place, np.zeros((2, 52, 3)), rate).rate)
    return frames_off(Track(still(1 << 60, read)), rate, 0)


def clip_length(_place: Place, frames: float) -> float:
    return frames_off(Track(still(int(frames) + 2_000_000, RATE)), RATE, int(frames))


def scene_start(place: Place, seconds: float) -> float:
    path = place.folder / "scene.toml"
    path.write_text(PERSON + f"start = {float(round(seconds))!r}\n")
    return frames_off(Track(still(1 << 60, RATE), start=read_scene(path).avatars[0].start), RATE, 0)


def film_rate(place: Place, rate: float) -> float:
    """Frames off, of a thousand."""
    import av

    path = place.folder / "scene.toml"
    path.write_text(f"rate = {rate!r}\n{PERSON}")
    asked = read_scene(path).rate
    assert asked is not None
    with Film(place.folder / "film.mp4", asked) as film:
        for _ in range(1000):
            film.add(np.zeros((16, 16, 4), np.uint8))
    with av.open(place.folder / "film.mp4") as container:
        times = sorted(float(p.pts * p.time_base) for p in container.demux(video=0) if p.pts is not None and p.size)
    assert len(times) == 1000
    return float(np.abs(np.array(times) * rate - np.arange(1000)).max())


def key_gap(place: Place, seconds: float) -> float:
    """Metres that a path is off whose keys come so much faster."""
    eyes, places = ((0, 1, 3), (1, 1.2, 3), (2, 1, 2)), []
    for gap in (1.0, seconds):
        keys = [{"t": k * gap, "eye": eye, "target": [0, 1, 0]} for k, eye in enumerate(eyes)]
        (place.folder / "path.json").write_text(json.dumps({"keys": keys}))
        path = CameraPath.read(place.folder / "path.json")
        with np.errstate(all="ignore"):
            places.append([path.camera(t * gap, (64, 64)).eye for t in (0.0, 0.25, 0.5, 1.5, 2.0)])
    return float(np.nan_to_num(np.abs(np.subtract(*places)), nan=np.inf).max())


@cache
def faced() -> Avatar:
    """The built-in person, its textures small."""
    body = read_avatar("builtin")
    level = replace(body.levels[0], base_color=np.zeros((16, 16, 3), np.uint8), features=None)
    return replace(body, levels=(level,), network=None, linear=None, default_view="off")


def face_error(body: Avatar, weight: float) -> float:
    """Metres that vertices of an open jaw are off, where no lid holds them."""
    level, shape = body.levels[0], 17
    assert level.face is not None and body.eyes is not None
    blend, weights = FaceBlend(level, body.eyes), np.zeros(52)
    weights[shape] = weight
    free = np.setdiff1d(np.arange(len(level.face.vertices)), np.concatenate([lids for lids, _, _ in blend.lids]))
    moved = blend.offsets(within_limits(FaceFrame(weights, np.zeros((2, 2)))))[blend.moving, :3]
    return float(np.abs(moved - weight * level.face.offsets[shape].astype(np.float64))[free].max())


def face_offset(place: Place, metres: float) -> float:
    """Of a shape whose vertices move so far at most."""
    body = faced()
    level, face = body.levels[0], body.levels[0].face
    assert face is not None
    offsets = face.offsets.copy()
    offsets[17] *= metres / np.abs(offsets[17]).max()
    body = replace(body, levels=(replace(level, face=replace(face, offsets=offsets)),))
    write_avatar(place.folder / "face.glb", body)
    return face_error(read_avatar(place.folder / "face.glb"), 1.0)


def face_weight(_place: Place, weight: float) -> float:
    return face_error(faced(), weight)


Measure = Callable[[Place, float], float]
