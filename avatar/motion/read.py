"""Opening a motion: which reader a file, a folder or a built-in name goes to.

A reader is a file beside this one and a line of READERS.
"""

import os
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from avatar.body import Body
from avatar.motion.clip import Motion, RestSkeleton
from command.errors import AssetError
from files.input_file import name_order

BUILTIN_MOTIONS = ("counting", "walking")
MOTIONS_FOLDER = Path(str(files("avatar") / "data" / "motions"))


class PoseReader(NamedTuple):
    """A kind of pose file, and its reader in the file `module` beside this one, imported when it is needed."""

    # "*.npz": a folder with such files
    suffixes: tuple[str, ...]
    # how messages name it
    name: str
    module: str
    read: str
    # the argument beside the path: "body" or "skeleton"
    takes: str
    # the function that recognises it among files of the same suffix; none: every other file is one
    recognised: str = ""


# the first that recognises a file reads it
READERS = (
    PoseReader((".npz", "*.npz"), "SAM 3D Body", "sam3d_body", "read_sam3d_body", "skeleton", "is_sam3d_body"),
    PoseReader((".npz",), "AMASS", "amass", "read_amass", "body"),
    PoseReader((".pkl",), "", "pickled", "read_pickled_motion", "body"),
    PoseReader((".bvh",), "", "bvh", "read_bvh", "skeleton"),
    PoseReader((".glb", ".gltf", ".vrm", ".vrma"), "", "gltf", "read_gltf_motion", "skeleton"),
    PoseReader((".csv",), "ARKit's shapes", "face_csv", "read_face_csv", "skeleton"),
    PoseReader((".json",), "MediaPipe", "mediapipe", "read_mediapipe", "skeleton", "is_mediapipe_file"),
    PoseReader((".json", "*.json"), "EasyMocap", "easymocap", "read_easymocap", "body"),
)


def _described() -> str:
    """The suffixes that are read, each with the names of its readers, the general one first."""
    names: dict[str, list[str]] = {}
    for reader in READERS:
        suffixes = " ".join(suffix for suffix in reader.suffixes if suffix[0] == ".")
        names.setdefault(suffixes, []).insert(0, reader.name)
    kinds = [f"{suffixes} {' or '.join(found)}".rstrip() for suffixes, found in names.items()]
    return f"a motion ({', '.join(kinds)}, a folder of frames)"


MOTION_FILES = _described()


def read_motion(source: Path | str, *, body: Body | None = None, skeleton: RestSkeleton | None = None) -> Motion:
    """Open a motion: a pose file of READERS, a folder with a file a frame, or the name of a built-in one.

    `body` is the body the file was made for; it settles where `trans` puts the pelvis and what hand coefficients mean.
    `skeleton` is the one that the motion is to move (default: the built-in man's): its bones take the directions of
    another rig's. What had to be assumed is in `notes`.

    Raises:
        AssetError: the file is absent, of an unknown kind, or holds what cannot be explained.
    """
    if str(source) in BUILTIN_MOTIONS:
        return builtin_motion(str(source))
    path = Path(source)
    if not path.exists():
        raise AssetError(f"{path}: no such file; expected {MOTION_FILES}, or one of {', '.join(BUILTIN_MOTIONS)}")
    suffix = path.suffix.lower()
    if path.is_dir():
        suffix = "*.npz" if _names(path, ".npz") else "*.json"
    for reader in READERS:
        if suffix in reader.suffixes:
            module = import_module(f"avatar.motion.{reader.module}")
            if suffix[0] == "*" or not reader.recognised or getattr(module, reader.recognised)(path):
                given = {reader.takes: body if reader.takes == "body" else skeleton}
                return getattr(module, reader.read)(path, **given)
    raise AssetError(f"{path}: expected {MOTION_FILES}, found '{path.suffix}'")


def _names(folder: Path, ending: str) -> list[str]:
    """The files of a folder with this ending, hidden ones left out."""
    try:
        return [name for name in os.listdir(folder) if name.lower().endswith(ending) and not name.startswith(".")]
    except OSError as error:
        raise AssetError(f"{folder}: cannot be read: {error.strerror}") from None


def frame_files(folder: Path, ending: str, what: str) -> list[Path]:
    """The files of a folder with this ending, in the order of their names (numbers in them count as numbers).

    Raises:
        AssetError: the folder cannot be read, or has none.
    """
    names = _names(folder, ending)
    if not names:
        raise AssetError(f"{folder}: expected {what} ({ending}), found none")
    return [folder / name for name in sorted(names, key=name_order)]


def builtin_motion(name: str) -> Motion:
    """A clip that ships with the project (`experiments/builtin_motions.py` authors them): "counting" or "walking"."""
    from avatar.motion.amass import read_amass

    if name not in BUILTIN_MOTIONS:
        raise ValueError(f"no built-in motion {name!r}; there are {', '.join(BUILTIN_MOTIONS)}")
    return read_amass(MOTIONS_FOLDER / f"{name}.npz")
