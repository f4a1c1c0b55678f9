"""`selfscan export`: a motion, fitted to an avatar, for other people's programs."""

import argparse
from pathlib import Path

import numpy as np

from avatar.errors import AssetError
from avatar.gltf.animation import write_animated
from avatar.gltf.avatar_file import read_avatar
from avatar.motion.amass import write_amass
from avatar.motion.bvh_write import write_bvh
from avatar.motion.clip import Clip, Motion
from avatar.progress import progress
from player.arguments import add_hands, parse_frames
from player.motions import BLOCK, frame_range, notes, opened_motion, retargeted

EXAMPLES = """examples
  selfscan export me.glb --motion counting -o me_counting.glb     for Blender, three.js and others
  selfscan export me.glb --motion walk.bvh -o walk.npz            AMASS keys, z up
  selfscan export me.glb --motion take.npz --frames 100:400 -o take.bvh

OUT decides the kind:
  .glb   the avatar file with one animation: joint rotations and the pelvis' place, a key each frame. It stays
         an avatar file, and is itself a motion: selfscan render me.glb --motion me_counting.glb -o film.mp4
  .bvh   skeleton of this avatar at rest in T-pose, y up, metres (--unit cm where centimetres are expected)
  .npz   AMASS keys (poses, trans, mocap_framerate ...), z up as AMASS is

The root is scaled to the avatar's legs, as render and play do. What was assumed is printed.
docs/interchange.md says how to open each in Blender, three.js and others."""
SUFFIXES = (".bvh", ".glb", ".npz")
UNITS = {"m": 1.0, "cm": 0.01}


def export_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="selfscan export",
        description="Write a motion, fitted to an avatar, as BVH, as an animated GLB, or as AMASS npz.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("avatar", metavar="AVATAR", help="avatar file (.glb)")
    parser.add_argument("--motion", required=True, metavar="FILE",
                        help="pose file (.npz, .pkl, .bvh, .glb, .vrma ...), EasyMocap folder, or: counting, walking"
                        )  # fmt: skip
    parser.add_argument("--frames", type=parse_frames, metavar="A:B", help="only frames A to B-1")
    parser.add_argument("--body", metavar="MODEL",
                        help="SMPL+H model (.npz, .pkl) that the pose file was made for")  # fmt: skip
    add_hands(parser)
    parser.add_argument("--unit", choices=tuple(UNITS), default="m", help="of lengths in a .bvh (default: m)")
    parser.add_argument("-o", "--output", required=True, metavar="OUT", help="OUT.bvh, OUT.glb or OUT.npz")
    return parser


def export_main(argv: list[str]) -> int:
    """Write a motion for other programs."""
    parser = export_parser()
    options = parser.parse_args(argv)
    out = Path(options.output)
    kind = out.suffix.lower()
    if kind not in SUFFIXES:
        parser.error(f"-o: expected a name that ends in {', '.join(SUFFIXES)}, found {options.output!r}")
    if options.unit != "m" and kind != ".bvh":
        parser.error(f"--unit is for .bvh; {kind} files are in metres")
    if out.exists() and Path(options.avatar).exists() and out.samefile(options.avatar):
        parser.error(f"-o: {out} is the avatar itself; choose another name")

    avatar = read_avatar(options.avatar)
    motion = opened_motion(options.motion, options.body, options.hands)
    start, stop = frame_range(motion, None, options.frames, single=False)
    read = retargeted(motion, avatar)
    first = read(start, start + 1)

    def block(a: int, b: int) -> tuple:
        clip = read(start + a, start + b)
        return clip.axis_angle, clip.root

    fitted = Motion(motion.name, stop - start, motion.rate, first.notes, block, first.pelvis_height)
    try:
        if kind == ".bvh":
            write_bvh(out, fitted, avatar.joint_positions, unit=UNITS[options.unit])
        elif kind == ".glb":
            write_animated(out, options.avatar, _whole(fitted), name=Path(motion.name).stem)
        else:
            write_amass(out, _whole(fitted))
    except ValueError as error:
        raise AssetError(f"{motion.name}: {error}") from None
    for note in notes([read], start):
        print(note)
    seconds = (stop - start) / motion.rate
    size = out.stat().st_size / 1e6
    print(f"{out}: {stop - start} frames at {motion.rate:g} per second ({seconds:.1f} s), {size:.1f} MB")
    return 0


def _whole(motion: Motion) -> Clip:
    """All frames at once: these files are written in one piece."""
    firsts = range(0, motion.frames, BLOCK)
    blocks = [motion.read(k, min(k + BLOCK, motion.frames)) for k in progress(firsts, "frames read", len(firsts))]
    axis_angle, root = (
        np.concatenate([b.axis_angle for b in blocks]),
        np.concatenate([b.root for b in blocks]),
    )
    return Clip(axis_angle, root, motion.rate, motion.notes, motion.pelvis_height)
