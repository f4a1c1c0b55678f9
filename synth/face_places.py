"""Where eyes, nose, ears and iBUG's 68 points are on a person's face: what a detector looks for, and what is judged.

An average face is laid onto this one by the tip of its nose; its eyes go to where the eyeballs are, its mouth to the
dent between the lips, and what lies between follows. Drawn people's places are those of the free body, whose shape
they have: laid on a drawn face the average is a centimetre off (rms; ears, and one mouth of eight, two).
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from avatar.skeleton import PARTS
from capture.read.places import landmark_vertices
from synth.subject import SynthSubject

# metres from the tip of the nose on the average face: middle of the left eye, and height of mouth and chin
EYE, MOUTH, CHIN = (0.0325, 0.035), -0.038, -0.075
# how little depth counts, which the average face knows least, of features before FRONT: metres from the tip of the nose
DEPTH, FRONT = 0.3, -0.04
# metres: heights of the profile that are told apart, where lips may meet, and how far that lies behind
# the upper and the lower one
STEP, LIPS, DENT = 0.0015, (-0.048, -0.022), (0.0007, 0.0003)


def face_places(subject: SynthSubject) -> dict[str, Float[Array, "3"]]:
    """Eyes, nose, ears and face_00 to face_67, pose 0, metres."""
    if subject.features is not None:
        return dict(subject.features)
    points = subject.vertices.astype(np.float64)
    skin = (subject.part == PARTS.index("head")) & ~subject.hair
    nose = points[landmark_vertices(points, skin)["nose_tip"]]
    names, spots = _average_face()
    seen = subject.faces[skin[subject.faces].all(1)]
    spots = _laid_on(spots, _eye_beside(points - nose, subject.eye), _lips_meet(points - nose, seen))
    # eyeballs are not skin, and lie under lids
    candidates = points[skin if subject.eye is None else skin & ~subject.eye]
    out = {}
    for name, spot in zip(names, spots, strict=True):
        # onto the skin: the mean of the vertices nearest to the spot
        deep = DEPTH if spot[2] > FRONT else 1.0
        nearest = np.argsort(np.linalg.norm((candidates - (nose + spot)) * [1, 1, deep], axis=1))[:4]
        out[name] = candidates[nearest].mean(0)
    return out


def _average_face() -> tuple[list[str], Float[Array, "points 3"]]:
    """The points of an average face, metres from the tip of its nose."""
    spots = {"nose": (0.0, 0.0, 0.0), "left_eye": (*EYE, -0.026), "left_ear": (0.085, 0.028, -0.137)}
    spots |= {f"right_{name[5:]}": (-spots[name][0], *spots[name][1:]) for name in ("left_eye", "left_ear")}
    t = np.pi * np.arange(17) / 16
    jaw = np.stack([-0.07 * np.cos(t), 0.03 - 0.105 * np.sin(t), -0.09 + 0.07 * np.sin(t)], 1)
    k = np.arange(5)
    brow = np.stack([-0.055 + 0.01 * k, 0.048 + 0.003 * np.sin(np.pi * k / 4) * 3, -0.032 + 0.004 * k], 1)
    bridge = np.array([[0, 0.035, -0.018], [0, 0.023, -0.012], [0, 0.011, -0.005], [0, 0, 0]])
    nostril = np.array([[-0.015, -0.013, -0.013], [-0.008, -0.015, -0.008]])
    nostrils = np.concatenate([nostril, [[0, -0.016, -0.006]], nostril[::-1] * [-1, 1, 1]])
    eye = np.array([[-0.047, 0.035], [-0.037, 0.04], [-0.027, 0.04], [-0.018, 0.034], [-0.027, 0.03], [-0.037, 0.03]])
    right_eye = np.concatenate([eye, np.full((6, 1), -0.027)], 1)
    left_eye = right_eye[[3, 2, 1, 0, 5, 4]] * [-1, 1, 1]
    a = np.pi * np.arange(12) / 6
    lips = np.stack([-0.025 * np.cos(a), MOUTH + 0.01 * np.sin(a), -0.014 - 0.008 * np.cos(a) ** 2], 1)
    b = np.pi * np.arange(8) / 4
    inner = np.stack([-0.017 * np.cos(b), MOUTH + 0.003 * np.sin(b), np.full(8, -0.014)], 1)
    face = np.concatenate([jaw, brow, brow[::-1] * [-1, 1, 1], bridge, nostrils, right_eye, left_eye, lips, inner])
    names = [*spots, *(f"face_{number:02d}" for number in range(68))]
    return names, np.concatenate([np.array(list(spots.values())), face])


def _eye_beside(points: Float[Array, "vertices 3"], eye: Bool[Array, "vertices"] | None) -> tuple[float, float]:
    """How far the left eyeball's middle is to the side and up from the tip of the nose, which is at 0."""
    left = points[eye & (points[:, 0] > 0)] if eye is not None else points[:0]
    if not len(left):
        return EYE
    across, up, _ = 0.5 * (left.min(0) + left.max(0))
    return float(across), float(up)


def _lips_meet(points: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"]) -> float:
    """How far up from the tip of the nose the profile has its first dent below it; MOUTH where there is none."""
    edges = np.concatenate([faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0], [1, 0], [2, 1], [0, 2])])
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    cut = (a[:, 0] <= 0) & (b[:, 0] > 0) & (a[:, 2] > -0.04) & (a[:, 1] < LIPS[1] + 0.01) & (a[:, 1] > LIPS[0] - 0.01)
    a, b = a[cut], b[cut]
    profile = a - (a[:, :1] / (b[:, :1] - a[:, :1])) * (b - a)
    heights = np.arange(LIPS[1], LIPS[0], -STEP)
    depth = np.array([profile[np.abs(profile[:, 1] - y) <= STEP, 2].max(initial=-1) for y in heights])
    for k in range(1, len(heights)):
        lower_lip = depth[k + 1 : k + 6].max(initial=-1)
        if depth[k] < depth[:k].max() - DENT[0] and depth[k] < lower_lip - DENT[1]:
            return float(heights[k])
    return MOUTH


def _laid_on(spots: Float[Array, "points 3"], eye: tuple[float, float], mouth: float) -> Float[Array, "points 3"]:
    """The spots, stretched so that eyes and mouth are where they were measured; ears and chin stay."""
    at, by = [CHIN, MOUTH, 0.0, EYE[1], 0.07], [0.0, mouth - MOUTH, 0.0, eye[1] - EYE[1], eye[1] - EYE[1]]
    before = np.clip((spots[:, 2] + 0.09) / 0.03, 0, 1)
    up = before * np.interp(spots[:, 1], at, by)
    # from the bridge outwards to the eye's middle, and as far beyond
    high = np.clip(spots[:, 1] / EYE[1], 0, 1) * before
    side = high * np.clip(spots[:, 0] / EYE[0], -1, 1) * (eye[0] - EYE[0])
    return spots + np.stack([side, up, np.zeros_like(up)], 1)
