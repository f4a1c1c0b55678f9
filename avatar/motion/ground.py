"""Where the ground of a motion is, for the avatar that it moves: its soles shall stand at y = 0.

Files differ: AMASS's trans is counted from a body that is not in the file, BVH rigs have shoes of their own, fits from
videos have no floor at all. So the ground is looked for: h is the height of the avatar's lowest point in each of some
frames spread over the motion, and

    ground = median of the h within 3 cm above their 5th percentile

which is the height that the body stands at again and again. The whole motion is moved by that one number, so jumps
stay jumps and stairs stay stairs. Where fewer than a tenth of the frames touch that level (someone swims, hangs or
climbs all the time) there is no ground to be seen, and the heights stay as they are in the file.
"""

import contextlib
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.hull import BodyHull, lowest_points
from avatar.motion.clip import Motion
from command.errors import AssetError

# frames looked at, in runs of neighbours, within the first so many of the motion
SAMPLED_FRAMES, RUN, LOOKED_AT = 256, 4, 36_000
LOWEST = 5.0  # percent of the frames, which may sink in
BAND = 0.03  # metres of play of a standing foot
LEAST_SHARE = 0.1  # the share of frames that must stand
# metres by which a motion is moved that knows its ground, for feet of another shape
SHOES = 0.1
# metres below which it is not visible
UNSEEN = 0.0005


class GroundLevel(NamedTuple):
    """What is added to the heights of a motion, and why."""

    lift: float  # metres
    note: str


def _percentile(values: Float[Array, "values"], percent: float) -> float:
    """As np.percentile, which imports masked arrays: 40 ms of a first picture."""
    return float(np.interp(percent / 100 * (len(values) - 1), np.arange(len(values)), np.sort(values)))


def find_ground(motion: Motion, hull: BodyHull) -> GroundLevel:
    """The ground of a motion that was fitted to this body."""
    heights = _lowest_points(motion, hull)
    if not len(heights):
        return GroundLevel(0.0, "ground: not looked for, no frame could be read")
    low = _percentile(heights, LOWEST)
    standing = heights[(heights >= low) & (heights <= low + BAND)]
    touching = float((heights <= low + BAND).mean())
    level = _percentile(standing, 50.0) if len(standing) else low
    if touching < LEAST_SHARE:
        return GroundLevel(0.0, "ground: the body never stands, so the file's heights are kept")
    if motion.grounded and abs(level) > SHOES:
        side = "above" if level > 0 else "below"
        return GroundLevel(0.0, f"ground: the file's own; the lowest point stays {_length(level)} {side} it")
    if abs(level) < UNSEEN:
        return GroundLevel(0.0, "ground: the soles touch it as they are")
    moved = "lowered" if level > 0 else "raised"
    return GroundLevel(-level, f"ground: the motion is {moved} by {_length(level)} so that the soles touch it")


def on_ground(motion: Motion, hull: BodyHull) -> Motion:
    """The motion, moved up or down as a whole so that the soles of this body stand at y = 0, with a note."""
    lift, note = find_ground(motion, hull)
    return motion.changed(note, lambda pose, root: (pose, root + [0.0, lift, 0.0] if lift else root))


def _lowest_points(motion: Motion, hull: BodyHull) -> Float[Array, "frames"]:
    """Height of the body's lowest point in frames spread over the motion; frames that cannot be read are left out."""
    count = min(motion.frames, LOOKED_AT)
    if count <= SAMPLED_FRAMES:
        runs = [(k, min(k + 64, count)) for k in range(0, count, 64)]
    else:
        runs = [(k, k + RUN) for k in np.linspace(0, count - RUN, SAMPLED_FRAMES // RUN).astype(int).tolist()]
    poses, roots = [np.zeros((0, 52, 3))], [np.zeros((0, 3))]
    for run in runs:
        # a broken frame is an error when it is shown, not before
        with contextlib.suppress(AssetError):
            pose, root = motion.block(*run)
            poses.append(pose)
            roots.append(root)
    return lowest_points(hull, np.concatenate(poses), np.concatenate(roots))


def _length(metres: float) -> str:
    metres = abs(metres)
    return f"{metres:.2f} m" if metres >= 1 else f"{100 * metres:.1f} cm"
