"""Which way a rigid set of points faces in every frame: a first guess from pictures alone.

Each of many rotations is tried: points turned by it, drawn without perspective, are scaled and shifted onto the
keypoints (robust least squares). Of what fits in single frames, the path of smallest cost and smallest turns from frame
to frame is taken (Viterbi 1967); frames that show nothing turn on as those beside them do. What a mirror image in depth
would fit as well (nothing but a plane of points seen without perspective), points off the plane decide: nose, toes,
thumb.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle, matrix_from_quaternion
from geometry.least_squares import robust_cost, robust_weight

# metres by which a body in a T-pose may be off its points
SLACK = 0.05
# degrees from frame to frame
TURN = 25.0
# what it costs that a detector begins or ends to exchange sides, and each frame of it: at first as much as a turn that
# no person makes between frames, for long less than half a turn there and back
SWITCH, EXCHANGED = 5.0, 0.2
ROUNDS = 4
# points that say where a frame faces; frames on either side of a gap that say how it turns
LEAST, BESIDE = 3, 6


class Directions(NamedTuple):
    rotation: Float[Array, "frames 3 3"]  # world_from_points
    scale: Float[Array, "frames"]  # pixels of a metre at the points
    origin: Float[Array, "frames 2"]  # pixels of the points' origin

    exchanged: Bool[Array, "frames"]  # fits better with left and right exchanged


def turns_about_y(step: int = 5, leans: tuple[int, ...] = (-12, 0, 12)) -> Float[Array, "n 3 3"]:
    """Headings of a person who stands, degrees apart, leaning to and from the camera."""
    turn = np.radians(np.arange(0, 360, step))
    about_y = matrix_from_axis_angle(turn[:, None] * np.array([0, 1.0, 0]))
    lean = matrix_from_axis_angle(np.radians(np.array(leans, float))[:, None] * np.array([1.0, 0, 0]))
    return np.concatenate([one @ about_y for one in lean])


def all_turns(count: int = 1200) -> Float[Array, "count 3 3"]:
    """Rotations spread evenly (super-Fibonacci spirals, Alexa 2022)."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, R = np.sqrt(s / count), np.sqrt(1 - s / count)
    a, b = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    return matrix_from_quaternion(np.stack([r * np.sin(a), r * np.cos(a), R * np.sin(b), R * np.cos(b)], 1))


def find_directions(
    points: Float[Array, "points 3"], pixels: Float[Array, "frames points 2"], seen: Bool[Array, "frames points"],
    candidates: Float[Array, "n 3 3"], mirrored: Int[Array, "points"] | None = None, slack: float = SLACK,
) -> Directions:  # fmt: skip
    """The guess for points about their own origin; `mirrored`: for each point the one of the other side.

    `slack`: metres by which a rigid guess may be off its points.
    """
    flat = np.einsum("nij,pj->npi", candidates[:, :2], points) * [1.0, -1.0]
    fits = [_fits(flat, pixels, seen, slack)]
    if mirrored is not None:
        fits.append(_fits(flat, pixels[:, mirrored], seen[:, mirrored], slack))
    # frames, as named or exchanged, candidates
    cost, scale, origin = (np.stack(values, 1) for values in zip(*fits))
    cost *= seen.sum(1)[:, None, None] / slack**2
    cost[:, 1:] += EXCHANGED
    exchanged, path = _smooth_path(cost, candidates)
    frame = np.arange(len(path))
    found = frame, exchanged, path
    rotation = _turned_on(candidates[path], seen.sum(1) >= LEAST)
    return Directions(rotation, scale[found], origin[found], exchanged == 1)


def _turned_on(rotation: Float[Array, "frames 3 3"], seen: Bool[Array, "frames"]) -> Float[Array, "frames 3 3"]:
    """The rotations, those of unseen frames between seen ones an even turn: of the two ways round the one that goes on
    as the frames beside the gap turn."""
    out, known = rotation.copy(), np.flatnonzero(seen)
    step = axis_angle_from_matrix(rotation[1:] @ np.swapaxes(rotation[:-1], 1, 2))
    step[~(seen[1:] & seen[:-1])] = 0
    for a, b in zip(known[:-1], known[1:]):
        if b == a + 1:
            continue
        beside = np.r_[step[max(a - BESIDE, 0) : a], step[b : b + BESIDE]]
        rate = beside.sum(0) / max(np.count_nonzero(beside.any(1)), 1)
        way = axis_angle_from_matrix(rotation[b] @ rotation[a].T)
        other = way * (1 - 2 * np.pi / max(np.linalg.norm(way), 1e-9))
        way = min(way, other, key=lambda turn: np.linalg.norm(turn - rate * (b - a)))
        out[a + 1 : b] = matrix_from_axis_angle(np.arange(1, b - a)[:, None] / (b - a) * way) @ rotation[a]
    return out


def _fits(
    flat: Float[Array, "n points 2"], pixels: Float[Array, "frames points 2"], seen: Bool[Array, "frames points"],
    slack: float,
) -> tuple[Float[Array, "frames n"], Float[Array, "frames n"], Float[Array, "frames n 2"]]:  # fmt: skip
    """Robust mean square misfit (square metres), scale and origin of each rotation in each frame."""
    cost, scale = np.zeros((2, len(pixels), len(flat)))
    origin = np.zeros((len(pixels), len(flat), 2))
    for f, (q, here) in enumerate(zip(pixels, seen)):
        if here.sum() < LEAST:
            cost[f] = slack**2
            scale[f] = np.nan
            continue
        p, q = flat[:, here], q[here]
        weight = np.ones(p.shape[:2])
        for _ in range(ROUNDS):
            total = weight.sum(1)[:, None]
            middle_p = (weight[:, :, None] * p).sum(1) / total
            middle_q = weight @ q / total
            a, b = p - middle_p[:, None], q - middle_q[:, None]
            s = (weight * (a * b).sum(2)).sum(1) / np.maximum((weight * (a * a).sum(2)).sum(1), 1e-9)
            s = np.maximum(s, 1.0)
            e: Array = ((b / s[:, None, None] - a) ** 2).sum(2)
            weight = robust_weight(e, 2 * slack)
        cost[f] = robust_cost(e, 2 * slack).mean(1)
        scale[f] = s
        origin[f] = middle_q - s[:, None] * middle_p
    return cost, scale, origin


def _smooth_path(
    cost: Float[Array, "frames sides n"], candidates: Float[Array, "n 3 3"]
) -> tuple[Int[Array, "frames"], Int[Array, "frames"]]:
    """The cheapest path through sides and candidates, with turns and exchanges between neighbouring frames."""
    flat = candidates.reshape(len(candidates), 9)
    angle = np.arccos(np.clip((flat @ flat.T - 1) / 2, -1, 1))
    turn = (angle / np.radians(TURN)) ** 2
    # a jump costs no more than that: the person may have turned quickly
    turn = 16 * turn / (16 + turn)
    sides, count = cost.shape[1:]
    total, back = cost[0].copy(), []
    for row in cost[1:]:
        before = (total[:, :, None] + turn).argmin(1)
        through = np.take_along_axis(total, before, 1) + turn[before, np.arange(count)]
        from_side = (through[:, None] + SWITCH * (1 - np.eye(sides))[:, :, None]).argmin(0)
        came = np.take_along_axis(through, from_side, 0) + SWITCH * (from_side != np.arange(sides)[:, None])
        back.append(np.ravel_multi_index((from_side, np.take_along_axis(before, from_side, 0)), (sides, count)))
        total = came + row
    path = [int(total.argmin())]
    for previous in reversed(back):
        path.append(int(previous.reshape(-1)[path[-1]]))
    side, chosen = np.unravel_index(path[::-1], (sides, count))
    return side, chosen


def place_of(found: Directions, focal: float, centre: Float[Array, "2"]) -> Float[Array, "frames 3"]:
    """Where the origin of a rigid guess is: depth from its scale; frames without one take their neighbours'."""
    frame = np.arange(len(found.scale))
    good = np.isfinite(found.scale)
    scale = np.interp(frame, frame[good], found.scale[good])
    origin = np.stack([np.interp(frame, frame[good], found.origin[good, k]) for k in range(2)], 1)
    # people do not jump to and fro: one distance, by the median
    depth = focal / np.where(np.abs(scale / np.median(scale) - 1) < 0.2, scale, np.median(scale))
    across = (origin - centre) / focal * depth[:, None]
    return np.stack([across[:, 0], -across[:, 1], -depth], 1)


def opposite(names: tuple[str, ...]) -> Int[Array, "points"]:
    """For each named point the one of the other side; itself where there is none."""
    index, other = {name: k for k, name in enumerate(names)}, {"left": "right", "right": "left"}
    parted = [name.partition("_") for name in names]
    return np.array([index.get(f"{other.get(side)}_{rest}", k) for k, (side, _, rest) in enumerate(parted)])
