"""Opening a motion: which reader a file, a folder or a built-in name goes to. Each reader is a file beside this one."""

import os
from importlib.resources import files
from pathlib import Path

from avatar.body import Body
from avatar.errors import AssetError
from avatar.input_file import read_json
from avatar.motion.clip import Motion, RestSkeleton

BUILTIN_MOTIONS = ("counting", "walking")
MOTIONS_FOLDER = Path(str(files("avatar") / "data" / "motions"))
LANDMARK_FILES = (".pbtxt", ".prototxt", ".textproto", ".jsonl")
MOTION_FILES = (
    "a motion (.npz AMASS or SAM 3D Body, .pkl, .bvh, .glb .gltf .vrm .vrma, .json EasyMocap or MediaPipe, .pbtxt, a "
    "folder of them)"
)


def read_motion(source: Path | str, *, body: Body | None = None, skeleton: RestSkeleton | None = None) -> Motion:
    """Open a motion: a pose file, a folder of them, or the name of a built-in one.

    .npz (AMASS; SAM 3D Body), .pkl (SMPL+H, MoSh, 3DPW), .bvh, .glb .gltf .vrm .vrma (animation), .json (EasyMocap;
    MediaPipe's landmarks, also .pbtxt and .jsonl), or a folder with a file a frame. `body` is the body the file was
    made for; it settles where `trans` puts the pelvis and what hand coefficients mean. `skeleton` is the one that the
    motion is to move (default: the built-in man's): its bones take the directions of another
    rig's. What had to be assumed is in `notes`.

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
        return _read_folder(path, body, skeleton)
    if suffix == ".json":
        from avatar.motion.easymocap import read_easymocap
        from avatar.motion.landmark_file import WHAT, is_mediapipe
        from avatar.motion.mediapipe import read_mediapipe

        if is_mediapipe(read_json(path, f"a frame of EasyMocap, or {WHAT}")):
            return read_mediapipe(path, skeleton)
        return read_easymocap(path, body=body)
    if suffix in LANDMARK_FILES:
        from avatar.motion.mediapipe import read_mediapipe

        return read_mediapipe(path, skeleton)
    if suffix == ".npz":
        from avatar.motion.amass import read_amass
        from avatar.motion.sam3d_body import is_sam3d_body, read_sam3d_body

        if is_sam3d_body(path):
            return read_sam3d_body(path, skeleton)
        return read_amass(path, body=body)
    if suffix == ".pkl":
        from avatar.motion.pickled import read_pickled_motion

        return read_pickled_motion(path, body=body)
    if suffix == ".bvh":
        from avatar.motion.bvh import read_bvh

        return read_bvh(path, skeleton)
    if suffix in (".glb", ".gltf", ".vrm", ".vrma"):
        from avatar.motion.gltf import read_gltf_motion

        return read_gltf_motion(path, skeleton)
    raise AssetError(f"{path}: expected {MOTION_FILES}, found '{path.suffix}'")


def _read_folder(path: Path, body: Body | None, skeleton: RestSkeleton | None) -> Motion:
    """A folder of frames: what its files are decides who made it."""
    from avatar.motion.easymocap import read_easymocap
    from avatar.motion.landmark_file import WHAT, is_mediapipe
    from avatar.motion.mediapipe import read_mediapipe
    from avatar.motion.sam3d_body import read_sam3d_body

    try:
        names = sorted(name for name in os.listdir(path) if not name.startswith("."))
    except OSError as error:
        raise AssetError(f"{path}: cannot be read: {error.strerror}") from None
    kinds = {Path(name).suffix.lower() for name in names}
    if ".npz" in kinds:
        return read_sam3d_body(path, skeleton)
    if kinds & set(LANDMARK_FILES):
        return read_mediapipe(path, skeleton)
    first = next((name for name in names if name.lower().endswith(".json")), None)
    if first is not None and is_mediapipe(read_json(path / first, f"a frame of EasyMocap, or {WHAT}")):
        return read_mediapipe(path, skeleton)
    return read_easymocap(path, body=body)


def builtin_motion(name: str) -> Motion:
    """A clip that ships with the project (`experiments/builtin_motions.py` authors them): "counting" or "walking"."""
    from avatar.motion.amass import read_amass

    if name not in BUILTIN_MOTIONS:
        raise ValueError(f"no built-in motion {name!r}; there are {', '.join(BUILTIN_MOTIONS)}")
    return read_amass(MOTIONS_FOLDER / f"{name}.npz")
