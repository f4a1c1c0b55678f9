"""EasyMocap's pose folders: one JSON file a frame (000000.json), each a list of people with Rh, Th, poses, shapes.

EasyMocap rotates about the origin, X_world = R(Rh) X_body + Th, standard SMPL about the pelvis. Hence, with J0
the pelvis of the file's shaped body,

    pelvis = Th + R J0          that is, trans = Th - J0 + R J0

J0 comes from the user's model (`--body`), else it is the usual one, and the notes say so. `poses` may carry a
root of its own (66, 72, 78, 87, 156, 165 numbers), which turns about the pelvis before Rh and is zero in
practice, or none (63, 69, 75, 84, 153, 162). Hands are in `poses` or apart, in handl and handr: PCA coefficients, or
45 numbers that are offsets from the mean. EasyMocap adds MANO's mean to both unless `use_flat_mean` is set.
Newer files put the list under "annots". The files do not know their frame rate.
"""

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.body import Body
from avatar.motion.clip import Motion, spread_frames
from avatar.motion.pose_vector import (
    NEEDS_MODEL,
    TURNS,
    PoseLayout,
    expanded,
    pose_layout,
    readable,
    rested_pelvis,
    up_axis,
    upright_of,
)
from avatar.rotation import (
    axis_angle_from_quaternion,
    matrix_from_axis_angle,
    matrix_from_quaternion,
    quaternion_from_axis_angle,
    quaternion_product,
    turned,
)
from command.errors import AssetError
from files.input_file import JsonObject, read_json

MAX_BYTES = 1 << 24  # one frame's file
# looked at for the up axis
SAMPLED_FRAMES = 30
ASSUMED_RATE = 30.0
RESULT_FOLDERS = ("smpl", "smplh", "smplx", "smplfull", "smpl-full")


def read_easymocap(path: Path | str, *, body: Body | None = None) -> Motion:
    """Open an EasyMocap folder, or one of its files as a single frame; `body` is the model of the fit.

    Of several people the one with the lowest id in the first frame is read.

    Raises:
        AssetError: no frames, a frame without the person, numbers of other lengths than in the first frame,
            hand coefficients without a model that has their components. File and field are named.
    """
    path = Path(path)
    notes: list[str] = []
    name_of, frames = _frames(path, notes)
    person, lengths, layout = _opened(name_of(0), body, notes)

    def rows(start: int, stop: int) -> dict[str, Array]:
        return _rows([name_of(frame) for frame in range(start, stop)], person, lengths)

    seen = [(name_of(int(k)), _people(name_of(int(k)))) for k in spread_frames(frames, SAMPLED_FRAMES)]
    # a frame without the person is an error when it is read, not before
    Rh = [_numbers(file, here[person], "Rh") for file, here in seen if person in here]
    turn = np.array(TURNS[up_axis(upright_of(np.array(Rh)), notes)])
    W = matrix_from_quaternion(turn)
    shapes = rows(0, 1).get("shapes", np.zeros((1, 0)))[0]
    J0, height = rested_pelvis(shapes, body, notes, what="Th + R J0, J0", smplx=layout.smplx)
    given = 0 if body is None or height is None or layout.smplx else body.shape_directions.shape[2]
    used = min(lengths.get("shapes", 0), given)
    notes.append(f"no frame rate in EasyMocap's files: {ASSUMED_RATE:g} frames per second assumed")

    def block(start: int, stop: int) -> tuple[Array, Array]:
        """Poses and roots of frames start .. stop - 1, as `Motion.block` gives them."""
        values = rows(start, stop)
        pose = _joint_poses(values, layout, body)
        places = np.broadcast_to(J0, (stop - start, 3))
        if used and body is not None:  # the fit may shape every frame differently
            change = values["shapes"][:, :used] - shapes[:used]
            places = places + change @ body.joint_directions[0, :, :used].T
        R = matrix_from_axis_angle(values["Rh"])
        pelvis = values["Th"] + (R @ places[..., None])[..., 0]
        pose[:, 0] = turned(pose[:, 0], turn)
        return pose, pelvis @ W.T

    return Motion(path.name, frames, ASSUMED_RATE, tuple(notes), block, height)


@dataclass(frozen=True)
class EasyMocapFit:
    """EasyMocap's fit of one person to chosen frames, in the world of its cameras."""

    axis_angle: Float[Array, "frames 52 3"]  # the world's rotation in the root
    Rh: Float[Array, "frames 3"]  # about the origin of the world
    Th: Float[Array, "frames 3"]  # metres
    shapes: Float[Array, "frames n"]
    notes: tuple[str, ...]  # what was assumed


def frame_numbers(path: Path) -> dict[int, Path]:
    """The files of an EasyMocap folder by frame number; AssetError where there are none."""
    name_of, count = _frames(path, [])
    return {int(name_of(k).stem): name_of(k) for k in range(count)}


def read_fit(files: Sequence[Path], *, body: Body) -> EasyMocapFit:
    """The frames in `files` as they are: nothing is turned to y-up; `body` expands the hands, and has their mean.

    Raises:
        AssetError: as `read_easymocap`, or the fit is SMPL-X's.
    """
    notes: list[str] = []
    person, lengths, layout = _opened(files[0], body, notes)
    if layout.smplx:
        found = f"{lengths['poses']} numbers, SMPL-X's with jaw and eyes"
        raise AssetError(f"{files[0]}: poses should be of SMPL or SMPL+H as {body.name} is, has {found}")
    values = _rows(files, person, lengths)
    pose = _joint_poses(values, layout, body)
    return EasyMocapFit(pose, values["Rh"], values["Th"], values.get("shapes", np.zeros((len(files), 0))), tuple(notes))


def _opened(first: Path, body: Body | None, notes: list[str]) -> tuple[int, dict[str, int], PoseLayout]:
    """Who is read of the first frame's file, how many numbers each field has, and `_layout` of them."""
    people = _people(first)
    person = min(people)
    if len(people) > 1:
        notes.append(f"people: {sorted(people)} in the first frame, {person} is read")
    lengths = {
        key: len(_numbers(first, people[person], key))
        for key in ("poses", "Rh", "Th", "shapes", "handl", "handr")
        if key in people[person] or key in ("poses", "Rh", "Th")
    }
    return person, lengths, _layout(first, lengths, body, notes)


def _rows(files: Sequence[Path], person: int, lengths: dict[str, int]) -> dict[str, Array]:
    """The person's fields, a row a file."""
    out = {key: np.zeros((len(files), n)) for key, n in lengths.items()}
    for row, file in enumerate(files):
        here = _people(file)
        if person not in here:
            raise AssetError(f"{file}: no person {person}; there are {sorted(here)}")
        for key, n in lengths.items():
            values = _numbers(file, here[person], key)
            if len(values) != n:
                raise AssetError(f"{file}: {key} should have {n} numbers as in frame 0, has {len(values)}")
            out[key][row] = values
    return out


def _joint_poses(values: dict[str, Array], layout: PoseLayout, body: Body | None) -> Float[Array, "frames 52 3"]:
    """Axis-angle vectors of all joints, the world's rotation in the root; the hands' mean is added here, once."""
    columns = np.concatenate([values[key] for key in ("poses", "handl", "handr") if key in values], 1)
    pose = expanded(columns, layout, body)
    if pose[:, 0].any():
        q = quaternion_product(*(quaternion_from_axis_angle(v) for v in (values["Rh"], pose[:, 0])))
        pose[:, 0] = axis_angle_from_quaternion(q)
    else:
        pose[:, 0] = values["Rh"]
    return pose


def _frames(path: Path, notes: list[str]) -> tuple[Callable[[int], Path], int]:
    """The file of each frame (a function of its number) and how many there are."""
    if path.is_file():
        return (lambda frame: path), 1
    try:
        with os.scandir(path) as entries:
            names = (e.name for e in entries)
            numbered = [(int(n[:-5]), len(n) - 5) for n in names if re.fullmatch(r"[0-9]{1,12}\.json", n)]
    except OSError as error:
        raise AssetError(f"{path}: cannot be read: {error.strerror}") from None
    if not numbered:
        inside = next((name for name in RESULT_FOLDERS if (path / name).is_dir()), "")
        hint = f"; its folder {inside}/ may be meant" if inside else ""
        raise AssetError(f"{path}: expected EasyMocap frames 000000.json, 000001.json, ...; found none{hint}")
    # a million names would take ten times the memory
    numbers, widths = np.array(sorted(numbered), np.int64).T
    twice = numbers[1:][np.diff(numbers) == 0]
    if len(twice):
        raise AssetError(f"{path}: frame {twice[0]} is there twice, with and without leading zeros")
    missing = int(numbers[-1] - numbers[0]) + 1 - len(numbers)
    if missing:
        notes.append(f"frames: numbers {numbers[0]} to {numbers[-1]} skip {missing}; played without a gap")
    return (lambda frame: path / f"{numbers[frame]:0{widths[frame]}d}.json"), len(numbers)


def _people(path: Path) -> dict[int, JsonObject]:
    """The people of one frame by their id."""
    people = read_json(path, "a frame of EasyMocap", most=MAX_BYTES)
    if isinstance(people, dict):
        people = people.get("annots", [people])
    if not isinstance(people, list) or not all(isinstance(person, dict) for person in people):
        raise AssetError(f"{path}: expected a list of people or an object with annots")
    found: dict[int, JsonObject] = {}
    for person in people:
        number = person.get("id", person.get("personID", 0))
        if type(number) is not int or number in found:
            raise AssetError(f"{path}: id should be a whole number, once, is {str(number)[:40]!r}")
        found[number] = person
    if not found:
        raise AssetError(f"{path}: no people")
    return found


def _numbers(path: Path, person: JsonObject, key: str) -> Array:
    """A field as a row of finite numbers: [[...]] and [...] alike."""
    if key not in person:
        raise AssetError(f"{path}: no {key}; the person has {sorted(map(str, person))[:12]}")
    value = person[key]
    if isinstance(value, list) and len(value) == 1 and isinstance(value[0], list):
        value = value[0]
    if not isinstance(value, list) or not all(type(v) in (int, float) and abs(v) < 1e6 for v in value):
        raise AssetError(f"{path}: {key} should be one row of finite numbers, is {str(value)[:60]}")
    if key in ("Rh", "Th") and len(value) != 3:
        raise AssetError(f"{path}: {key} should be 3 numbers, is {len(value)}")
    return np.array(value, np.float64)


def _layout(path: Path, lengths: dict[str, int], body: Body | None, notes: list[str]) -> PoseLayout:
    """Layout of `poses` and, where the hands are apart, of handl and handr behind it."""
    count = lengths["poses"]
    layout = pose_layout(count, root_apart=True)
    if layout is None:
        known = "63, 66, 69, 72, 75, 78, 84, 87, 153, 156, 162 or 165"
        raise AssetError(f"{path}: poses should have {known} numbers, has {count}")
    if not readable(layout, body):
        raise AssetError(f"{path}: poses has {count} numbers, 2 x {layout.components} for the hands: {NEEDS_MODEL}")
    apart = lengths.get("handl", 0)
    if apart != lengths.get("handr", 0):
        raise AssetError(f"{path}: handl has {apart} numbers, handr {lengths.get('handr', 0)}")
    if apart:
        if layout.hands is not None:
            raise AssetError(f"{path}: hands twice: in poses ({count} numbers) and in handl and handr")
        full = apart == 45
        kind = "45 numbers, as offsets from the mean" if full else f"{apart} PCA coefficients, expanded"
        note = f"hands: handl and handr, {kind}, mean added (EasyMocap's use_flat_mean: False)"
        hands = slice(count, count + 2 * apart)
        layout = PoseLayout(layout.rooted, hands, 0 if full else apart, note, full, layout.smplx)
        if not readable(layout, body):
            raise AssetError(f"{path}: handl has {apart} numbers: {NEEDS_MODEL}")
    notes.append(layout.note)
    return layout
