"""A live take: the poses that came, put on an even clock and written with AMASS keys."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatar.motion.amass import write_amass
from avatar.motion.clip import Clip
from avatar.rotation import axis_angle_from_quaternion, quaternion_from_axis_angle, slerp
from player.live.frame import LivePose

# about 190 MB, 80 minutes at 60 frames a second
MOST_FRAMES = 300_000
USUAL_RATES = (24, 25, 30, 48, 50, 60, 72, 75, 90, 100, 120, 144, 240)
LONGEST_PAUSE = 2.0  # seconds; a longer silence is cut to this


class Take:
    """Frames of a live source, in the order of their times. Stops at MOST_FRAMES rather than fill the memory."""

    def __init__(self, most: int = MOST_FRAMES):
        self.times: list[float] = []
        self.poses: list[Float[np.ndarray, "53 3"]] = []  # joints, then the root
        self.most, self.full = most, False

    def add(self, time: float | int, pose: LivePose) -> None:
        if len(self.times) >= self.most:
            self.full = True
            return
        self.times.append(float(time))
        self.poses.append(np.concatenate([pose.axis_angle, pose.root[None]]).astype(np.float32))

    def clip(self, pelvis_height: float | None = None) -> Clip:
        """The take at an even rate: the usual one nearest to the median step, else that step's own.

        Each frame goes to its nearest tick and keeps its pose to the bit; of two on one tick the later stays; ticks
        without a frame are filled on the shorter arc.

        Raises:
            ValueError: no frame was recorded.
        """
        if not self.times:
            raise ValueError("no pose came, so there is no take")
        steps = np.minimum(np.maximum(np.diff(self.times), 0.0), LONGEST_PAUSE)
        rate = even_rate(steps)
        ticks = np.round(np.concatenate([[0.0], np.cumsum(steps)]) * rate).astype(np.int64)
        # the later of two on one tick
        last = np.append(np.flatnonzero(np.diff(ticks)), len(ticks) - 1)
        ticks = ticks[last] - ticks[last[0]]
        poses = np.stack([self.poses[i] for i in last]).astype(np.float64)
        axis_angle, root = filled(ticks, poses)
        notes = () if not self.full else (f"take: stopped after {self.most} frames",)
        return Clip(axis_angle, root, rate, notes, pelvis_height)

    def write(self, path: Path | str, pelvis_height: float | None = None) -> Clip:
        """Write the take as an AMASS file, whole or not at all."""
        clip = self.clip(pelvis_height)
        write_amass(path, clip)
        return clip


def even_rate(steps: Float[np.ndarray, "steps"]) -> float:
    """Frames a second of the usual step: a usual rate within 2 %, else the median's own; 30 for a single frame."""
    steps = steps[steps > 1e-4]
    if not len(steps):
        return 30.0
    rate = 1 / float(np.median(steps))
    nearest = min(USUAL_RATES, key=lambda usual: abs(usual - rate))
    return float(nearest) if abs(nearest - rate) < 0.02 * nearest else rate


def filled(
    ticks: np.ndarray, poses: Float[np.ndarray, "frames 53 3"]
) -> tuple[Float[np.ndarray, "ticks 52 3"], Float[np.ndarray, "ticks 3"]]:
    """Poses on every tick from 0 to the last: given ones as they are, the others between their neighbours."""
    wanted = np.arange(ticks[-1] + 1)
    after = np.searchsorted(ticks, wanted)
    out = poses[after].copy()
    missing = ticks[after] != wanted
    if missing.any():
        b = after[missing]
        a = b - 1
        part = (wanted[missing] - ticks[a]) / (ticks[b] - ticks[a])
        qa, qb = (quaternion_from_axis_angle(poses[i, :52]) for i in (a, b))
        out[missing, :52] = axis_angle_from_quaternion(slerp(qa, qb, np.repeat(part[:, None], 52, 1)))
        out[missing, 52] = poses[a, 52] + part[:, None] * (poses[b, 52] - poses[a, 52])
    return out[:, :52], out[:, 52]
