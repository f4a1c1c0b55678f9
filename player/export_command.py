"""`selfscan export`: a motion, fitted to an avatar, or the avatar as VRM, for other people's programs."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from avatar.baked_avatar import Avatar
from avatar.gltf.animation import write_animated
from avatar.gltf.vrm_extension import PERMISSIONS, Likeness
from avatar.gltf.vrm_write import write_vrm
from avatar.motion.amass import write_amass
from avatar.motion.bvh_write import write_bvh
from command.command_line import Help, Option, parse
from command.errors import AssetError, unicode_text
from command.progress import plural
from command.settings import OneOf
from files.whole import check_file
from player.scene.arguments import AvatarOption, BodyOption, FramesOption, GroundOption, HandsOption
from player.scene.framing import pelvis_height
from player.scene.motions import frame_range, ground_for, motion_for
from player.scene.opened import opened_avatar

EXAMPLES = """examples
  selfscan export me.glb --motion counting -o me_counting.glb     for Blender, three.js and others
  selfscan export me.glb --motion walk.bvh -o walk.npz            AMASS keys, z up
  selfscan export me.glb --motion take.npz --frames 100:400 -o take.bvh
  selfscan export me.glb -o me.vrm --author "Anna Muster"         VRM 1.0: only the person may use it, unless --who

OUT decides the kind:
  .glb   the avatar file with one animation: joint rotations and the pelvis' place, a key each frame. It stays
         an avatar file, and is itself a motion: selfscan render me.glb --motion me_counting.glb -o film.mp4
  .bvh   skeleton of this avatar at rest in T-pose, y up, metres (--unit cm where centimetres are expected)
  .npz   AMASS keys (poses, trans, mocap_framerate ...), z up as AMASS is
  .vrm   the person without a motion, for Warudo, three-vrm and others: bones, face, gaze, unlit (--vrm0: VSeeFace)

The root is scaled to the avatar's legs and its ground is found, as render and play do. What was assumed is printed.
docs/interchange.md says how to open each in Blender, three.js and others."""
SUFFIXES = (".bvh", ".glb", ".npz", ".vrm")
UNITS = {"m": 1.0, "cm": 0.01}


@dataclass(frozen=True)
class ExportCommand:
    avatar: AvatarOption
    output: Annotated[Path, Option(("-o", "--output"), "OUT"), "OUT.bvh, OUT.glb, OUT.npz or OUT.vrm"]
    motion: Annotated[str | None, Option(metavar="FILE"),
        "pose file (.npz, .pkl, .bvh, .glb, .json ...), folder of frames, or: counting, walking"] = None
    author: Annotated[str | None, "of a .vrm: whose likeness it is (default: the avatar's name)"] = None
    who: Annotated[str, OneOf(PERMISSIONS), "of a .vrm: who may use this likeness; onlyAuthor is the person alone"] = (
        PERMISSIONS[0]
    )
    vrm0: Annotated[bool, "of a .vrm: VRM 0.x, for VSeeFace and other programs that read no 1.0"] = False
    frames: FramesOption = None
    body: BodyOption = None
    hands: HandsOption = "file"
    ground: GroundOption = "auto"
    unit: Annotated[str, OneOf(tuple(UNITS)), "of lengths in a .bvh"] = "m"

    def __post_init__(self):
        if self.kind not in SUFFIXES:
            raise ValueError(f"-o: expected a name that ends in {', '.join(SUFFIXES)}, found {str(self.output)!r}")
        if (self.motion is None) != (self.kind == ".vrm"):
            raise ValueError("--motion: expected one, except of a .vrm")
        if self.kind != ".vrm" and (self.author is not None or self.who != PERMISSIONS[0] or self.vrm0):
            raise ValueError("--author, --who and --vrm0 are for .vrm")
        if self.author and unicode_text(self.author) != self.author:
            raise ValueError(f"--author: expected UTF-8 text, found {self.author!r}")
        if self.unit != "m" and self.kind != ".bvh":
            raise ValueError(f"--unit is for .bvh; {self.kind} files are in metres")
        if self.output.exists() and Path(self.avatar).exists() and self.output.samefile(self.avatar):
            raise ValueError(f"-o: {self.output} is the avatar itself; choose another name")

    @property
    def kind(self) -> str:
        return self.output.suffix.lower()


WRITES = "Write a motion, fitted to an avatar, as BVH, as an animated GLB, or as AMASS npz; or the avatar as VRM."
EXPORT = Help("selfscan export", WRITES, EXAMPLES)


def export_main(argv: list[str]) -> int:
    """Write a motion or an avatar for other programs."""
    options = parse(ExportCommand, argv, EXPORT)
    check_file(options.output)
    avatar = opened_avatar(options.avatar)
    return export_vrm(options, avatar) if options.kind == ".vrm" else export_motion(options, avatar)


def export_vrm(options: ExportCommand, avatar: Avatar) -> int:
    """Write the avatar as .vrm, with who may use this likeness."""
    likeness = Likeness(avatar.name, options.author or avatar.name, options.who)
    version = 0 if options.vrm0 else 1
    write_vrm(options.output, options.avatar, likeness, pelvis_height(avatar), version=version)
    face = "face and gaze" if avatar.eyes is not None else "no face in the avatar's file"
    size = options.output.stat().st_size / 1e6
    name = ("VRM 0.x", "VRM 1.0")[version]
    print(f"{options.output}: {name}, {face}, {likeness.permission} ({likeness.author}), {size:.1f} MB")
    return 0


def export_motion(options: ExportCommand, avatar: Avatar) -> int:
    """Write a motion, fitted to the avatar."""
    out, kind = options.output, options.kind
    ground = ground_for(options.ground, ())
    motion = motion_for(avatar, options.motion, body=options.body, hands=options.hands, ground=ground)
    start, stop = frame_range(motion.name, motion.frames, options.frames)
    faces = motion.faces
    fitted = replace(
        motion, frames=stop - start, block=lambda a, b: motion.block(start + a, start + b),
        faces=None if faces is None else lambda a, b: faces(start + a, start + b),
    )  # fmt: skip
    try:
        if kind == ".bvh":
            write_bvh(out, fitted, avatar.joint_positions, unit=UNITS[options.unit])
        elif kind == ".glb":
            # written in one piece
            write_animated(out, options.avatar, fitted.read(), name=Path(motion.name).stem)
        else:
            write_amass(out, fitted)
    except ValueError as error:
        raise AssetError(f"{motion.name}: {error}") from None
    for note in motion.notes:
        print(note)
    seconds = (stop - start) / motion.rate
    size = out.stat().st_size / 1e6
    print(f"{out}: {plural(stop - start, 'frame')} at {motion.rate:g} per second ({seconds:.1f} s), {size:.1f} MB")
    return 0
