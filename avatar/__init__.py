"""Foundation of selfscan, on NumPy, with Pillow to decode pictures: rotations, body, cameras, motion, avatar files.

Conventions, stated once for the whole project
==============================================

Axes and units. Right-handed; +y up, +z out of the subject's chest, +x the subject's left. Metres, radians,
seconds. Signed distance is negative inside.

Matrices multiply column vectors and are named ``target_from_source``: ``x_target = target_from_source @
x_source``. Arrays are row-major and are transposed exactly once, when bytes go to OpenGL.

Rotations. Axis-angle vectors, right-handed. Quaternions are (x, y, z, w), as in glTF.

Frames.

- *world*: posed bodies and cameras. A root translation is the position of the pelvis joint in the world.
- *pose 0*: the T-pose, pelvis joint at the origin.
- *canonical*: the "big pose" (both legs 30 degrees apart from pose 0), pelvis joint at the origin. The fields,
  the surface, the view statistics and the vertices of an avatar file live here. The pose is stored as a
  vector in each file that depends on it.
- *head*: the head video's own frame, as structure from motion leaves it.
- *camera*: OpenCV (+z forward, +y down) in captures and camera files; OpenGL (-z forward) in the player.

Images. Row 0 is the top. Pixel centres lie at .5. Colours in files and on screen are sRGB; what is linear
says so.

Poses. 52 axis-angle vectors in SMPL+H order: 0-21 body, 22-36 left hand, 37-51 right hand, fingers in the
order index, middle, pinky, ring, thumb; zero is the flat hand.

Skinning. One rule everywhere: ``B_k = G_k(pose) G_k(rest)^-1`` and ``x_posed = (sum_k w_k B_k) x_rest``; the
inverse map is the inverse of that one blended matrix. Directions go through the orthonormal rule of
``avatar.skinning.blended_rotations``.

The names below are the public ones of this package, each imported when it is asked for; docs/python.md shows them.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from avatar.baked_avatar import Avatar
    from avatar.camera import Camera, look_at, pinhole
    from avatar.gltf.avatar_file import read_avatar, write_avatar
    from avatar.motion.amass import write_amass
    from avatar.motion.clip import Clip, Motion, resample
    from avatar.motion.read import read_motion
    from avatar.skeleton import JOINTS
    from command.errors import AssetError

_MODULES = {
    "avatar.baked_avatar": ("Avatar",),
    "avatar.camera": ("Camera", "look_at", "pinhole"),
    "avatar.gltf.avatar_file": ("read_avatar", "write_avatar"),
    "avatar.motion.amass": ("write_amass",),
    "avatar.motion.clip": ("Clip", "Motion", "resample"),
    "avatar.motion.read": ("read_motion",),
    "avatar.skeleton": ("JOINTS",),
    "command.errors": ("AssetError",),
}
_PUBLIC = {name: module for module, names in _MODULES.items() for name in names}
__all__ = ["JOINTS", "AssetError", "Avatar", "Camera", "Clip", "Motion", "look_at", "pinhole", "read_avatar",
           "read_motion", "resample", "write_amass", "write_avatar"]  # fmt: skip


def __getattr__(name: str) -> object:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
