"""Writing motion as BVH: the 52 joints under our names, resting in T-pose, bones unturned, y up, facing +z.

The root has six channels, every other joint three. With the channels in the order Z, X, Y a joint's rotation is

    R = Rz(a) Rx(b) Ry(c) = | ca cc - sa sb sc   -sa cb   ca sc + sa sb cc |
                            | sa cc + ca sb sc    ca cb   sa sc - ca sb cc |
                            |     -cb sc            sb          cb cc      |

Each R has two such triples, (a, b, c) and (a + pi, pi - b, c + pi), up to full turns; the one nearest to the frame
before is written, so that curves do not jump in programs that draw or smooth them. Where cb = 0 only a + c or
a - c is known: c stays as it was. avatar/motion/bvh.py reads such a file back joint by joint
(avatar/motion/smplh_rig.py).
"""

from pathlib import Path
from typing import IO

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.motion.clip import Clip, Motion
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINTS, PARENTS
from files.whole import whole_file

BLOCK = 256  # frames in memory at once
# cos b below which a and c cannot be separated; float64 leaves 1e-9 of a degree to a + c
GIMBAL = 1e-7
# length of a fingertip, as a part of the bone before
LAST_BONE = 0.8
HEAD, TOES = np.array([0.0, 0.2, 0.0]), np.array([0.0, 0.0, 0.07])  # End Sites, metres


def write_bvh(path: Path | str, motion: Clip | Motion, joints: Float[Array, "52 3"], *, unit: float = 1.0) -> None:
    """Write a clip, or a motion of any length in constant memory; whole or not at all.

    `joints` are the rest positions of the body it is for (pose 0, metres). `unit` is the metres of one unit of the
    file: 1 as Blender takes it, 0.01 for the programs that expect centimetres. The skeleton rests with its soles on
    the ground where the motion knows the height of its pelvis.

    Raises:
        ValueError: no frames, numbers that are not finite, or a unit that is not positive.
    """
    if not (np.isfinite(unit) and unit > 0):
        raise ValueError(f"unit should be positive metres, is {unit}")
    count = motion.frames
    motion.read(0, min(1, count)).check()
    with whole_file(path, "w") as file:
        rest = np.asarray(joints, np.float64) + [0, motion.pelvis_height or 0, 0]
        order = _write_hierarchy(file, rest / unit, unit)
        file.write(f"MOTION\nFrames: {count}\nFrame Time: {1 / float(motion.rate)!r}\n")
        before = np.zeros((52, 3))
        for first in range(0, count, BLOCK):
            clip = motion.read(first, min(first + BLOCK, count))
            clip.check()
            angles = euler_zxy(matrix_from_axis_angle(clip.axis_angle), before)
            before = angles[-1]
            turns = np.degrees(angles)[:, order].reshape(len(angles), 156)
            np.savetxt(file, np.concatenate([clip.root / unit, turns], axis=1), fmt="%.9g")


def euler_zxy(R: Float[Array, "frames n 3 3"], before: Float[Array, "n 3"]) -> Float[Array, "frames n 3"]:
    """Angles (a, b, c) with R = Rz(a) Rx(b) Ry(c), radians, each frame nearest to the one before it."""
    cos_b = np.hypot(R[..., 0, 1], R[..., 1, 1])
    b = np.arctan2(R[..., 2, 1], cos_b)
    a = np.arctan2(-R[..., 0, 1], R[..., 1, 1])
    c = np.arctan2(-R[..., 2, 0], R[..., 2, 2])
    locked = cos_b < GIMBAL
    # a + c where b is 90 degrees, a - c where it is -90
    together = np.arctan2(R[..., 1, 0], R[..., 0, 0])
    sign = np.sign(R[..., 2, 1])
    out = np.empty((*b.shape, 3))
    for frame in range(len(R)):
        first = np.stack([a[frame], b[frame], c[frame]], -1)
        held = np.stack([together[frame] - sign[frame] * before[:, 2], b[frame], before[:, 2]], -1)
        first = np.where(locked[frame][:, None], held, first)
        second = np.stack([first[:, 0] + np.pi, np.pi - first[:, 1], first[:, 2] + np.pi], -1)
        both = np.stack([first, second])
        both += 2 * np.pi * np.round((before - both) / (2 * np.pi))
        nearer = np.argmin(np.square(both - before).sum(-1), axis=0)
        before = np.take_along_axis(both, nearer[None, :, None], axis=0)[0]
        out[frame] = before
    return out


def _write_hierarchy(file: IO[str], joints: Float[Array, "52 3"], unit: float) -> list[int]:
    """HIERARCHY; gives the joints in the order that it has them, which is the order of the channels."""
    order: list[int] = []

    def numbers(v: Array) -> str:
        return " ".join(f"{x:.8f}" for x in v + 0.0)

    def write(joint: int, depth: int) -> None:
        """A joint, and below it its children, or where it has none its End Site."""
        order.append(joint)
        pad = "\t" * depth
        offset = joints[joint] - joints[PARENTS[joint]] if joint else joints[0]
        places = "6 Xposition Yposition Zposition" if joint == 0 else "3"
        file.write(f"{pad}{'JOINT' if joint else 'ROOT'} {JOINTS[joint]}\n{pad}{{\n")
        file.write(f"{pad}\tOFFSET {numbers(offset)}\n{pad}\tCHANNELS {places} Zrotation Xrotation Yrotation\n")
        children = np.flatnonzero(joint == PARENTS)
        for child in children:
            write(int(child), depth + 1)
        if not len(children):
            name = JOINTS[joint]
            fixed = HEAD if name == "head" else TOES if name.endswith("_foot") else None
            tip = LAST_BONE * offset if fixed is None else fixed / unit
            file.write(f"{pad}\tEnd Site\n{pad}\t{{\n{pad}\t\tOFFSET {numbers(tip)}\n{pad}\t}}\n")
        file.write(f"{pad}}}\n")

    file.write("HIERARCHY\n")
    write(0, 0)
    return order
