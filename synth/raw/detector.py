"""Keypoints as OpenPose writes them, of a person whose joints are known: projected, with a detector's mistakes.

Noise that partly lasts, a bias of each point that stays on the body (where detectors put "hip" or "wrist" is not where
the joint is), outliers, sides exchanged for a few frames, and confidences that fall where the body hides a point.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.camera import Camera, project
from avatar.skeleton import JOINTS, joint_transforms
from capture.keypoints.openpose import FACE_POINTS
from capture.keypoints.orders import BODY_25
from capture.keypoints.record import FACE, SIDES, hand_points
from player.draw.raster import Rasteriser
from synth.face_places import face_places
from synth.subject import SynthSubject

# share of points that lie far off, and pixels (of 1080) by which
OUTLIERS, FAR = 0.03, 40.0
# share of frames in which a run of exchanged sides begins, and its longest
EXCHANGED, LONGEST = 0.012, 3
# the share of the noise's variance that lasts, and how much is left from frame to frame
LASTING, KEPT = 0.5, 0.85
# factor on the noise of what is hidden
HIDDEN = 2.5
# the share of the body's bias that points of hands and face have
SMALL = 0.3
# metres that a point may lie behind the surface and still count as seen
DEPTH = {
    "hip": 0.2, "hips": 0.25, "shoulders": 0.2, "shoulder": 0.16, "knee": 0.12, "elbow": 0.09, "ankle": 0.1,
    "wrist": 0.07, "hand": 0.07,
}  # fmt: skip
FINGER_DEPTH, SURFACE_DEPTH = 0.025, 0.02
# below this many points no person is found
FEWEST = 4


@dataclass(frozen=True)
class Mistakes:
    noise: float  # pixels of 1080
    bias: float  # metres
    # outliers, exchanged sides and confidences that vary
    clumsy: bool = True


@dataclass(frozen=True)
class _Point:
    """One point of the detector on the person: the mean of joints, or a vertex carried by a joint."""

    name: str
    joints: tuple[int, ...]
    offset: Float[Array, "3"]  # from the first joint, pose 0
    depth: float


class Detector:
    def __init__(
        self, subject: SynthSubject, rasteriser: Rasteriser, camera: Camera, mistakes: Mistakes, seed: list[int]
    ):
        self.subject, self.rasteriser, self.mistakes = subject, rasteriser, mistakes
        self.camera = camera
        small = tuple(round(side * min(1.0, 480 / min(camera.size))) for side in camera.size)
        self.small = camera.resized((small[0], small[1]))
        self.points = _points(subject)
        self.rng = np.random.default_rng([*seed, 61])
        # the bias belongs to the person, hence it is the same in all four videos
        person = np.random.default_rng([seed[0], 62])
        bias = person.standard_normal((len(self.points), 3))
        small_ones = [p.depth <= FINGER_DEPTH for p in self.points]
        reach = mistakes.bias * np.where(small_ones, SMALL, 1.0)
        self.bias = reach[:, None] * bias / np.linalg.norm(bias, axis=1, keepdims=True)
        self.lasting = self.rng.standard_normal((len(self.points), 2))
        self.exchanged_for = 0

    def look(
        self, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"], vertices: Float[Array, "vertices 3"],
        moved: Mapping[str, Float[Array, "3"]] | None = None,
    ) -> Float[Array, "points 3"] | None:  # fmt: skip
        """x, y (the middle of the first pixel is .5) and confidence of every point; None: no person is found.
        `moved`: how far some are off their places in pose 0."""
        G = joint_transforms(axis_angle, self.subject.joints.astype(np.float64), root)
        off, still = moved or {}, np.zeros(3)
        at = np.stack([
            G[list(point.joints), :3, 3].mean(0)
            + G[point.joints[0], :3, :3] @ (point.offset + bias + off.get(point.name, still))
            for point, bias in zip(self.points, self.bias, strict=True)
        ])  # fmt: skip
        pixels, depth = project(self.camera, at)
        seen, hidden = self._visible(vertices, pixels, depth)
        rng, unit = self.rng, min(self.camera.size) / 1080 * self.mistakes.noise
        white = rng.standard_normal(self.lasting.shape)
        fresh = rng.standard_normal(self.lasting.shape)
        self.lasting = KEPT * self.lasting + np.sqrt(1 - KEPT**2) * fresh
        noise = np.sqrt(1 - LASTING) * white + np.sqrt(LASTING) * self.lasting
        pixels = pixels + unit * np.where(hidden, HIDDEN, 1.0)[:, None] * noise
        sure = np.clip(rng.normal(0.87, 0.06, len(at)), 0.6, 1)
        confidence: Array = np.where(hidden, rng.uniform(0.15, 0.5, len(at)), sure)
        # the face's network finds nothing on a head that is turned away, and others lose what is hidden now and then
        surface = np.array([point.depth <= SURFACE_DEPTH for point in self.points])
        lost = hidden & (rng.uniform(size=len(at)) < np.where(surface, 0.85, 0.1))
        confidence = np.where(~seen | lost, 0.0, confidence)
        if self.mistakes.clumsy:
            wild = rng.uniform(size=len(at)) < OUTLIERS
            pixels[wild] += min(self.camera.size) / 1080 * FAR * rng.standard_normal((int(wild.sum()), 2))
            confidence = np.where(wild, confidence * rng.uniform(0.4, 1.0, len(at)), confidence)
            self._exchange_sides(pixels, confidence)
        if (confidence > 0.3).sum() < FEWEST:
            return None
        return np.concatenate([pixels, confidence[:, None]], 1)

    def write(self, path: Path, rows: Float[Array, "points 3"] | None) -> None:
        """A frame's file."""
        people = []
        if rows is not None:
            rows = np.where(rows[:, 2:] > 0, rows - [0.5, 0.5, 0], 0)
            pupils = np.zeros((FACE_POINTS - len(FACE), 3))
            groups = np.split(np.round(np.concatenate([rows, pupils]), 3), [25, 46, 67])
            keys = ("pose", "hand_left", "hand_right", "face")
            person = {f"{key}_keypoints_2d": group.ravel().tolist() for key, group in zip(keys, groups, strict=True)}
            people = [{"person_id": [-1], **person}]
        path.write_text(json.dumps({"version": 1.3, "people": people}))

    def _visible(
        self, vertices: Float[Array, "vertices 3"], pixels: Float[Array, "points 2"], depth: Float[Array, "points"]
    ) -> tuple[Bool[Array, "points"], Bool[Array, "points"]]:
        """Which points are in the picture, and which of them the body hides."""
        drawn = self.rasteriser.draw(vertices, self.subject.faces, self.small).depth
        inside = (pixels >= 0).all(1) & (pixels < self.camera.size).all(1) & (depth > 0)
        small = pixels * self.small.size[0] / self.camera.size[0]
        x, y = np.clip(small, 0, np.array(self.small.size) - 1).astype(int).T
        behind = depth - drawn[y, x]
        return inside, behind > [point.depth for point in self.points]

    def _exchange_sides(self, pixels: Float[Array, "points 2"], confidence: Float[Array, "points"]) -> None:
        """Left and right of arms or legs, for a few frames now and then."""
        if self.exchanged_for == 0 and self.rng.uniform() < EXCHANGED:
            self.exchanged_for = int(self.rng.integers(1, LONGEST + 1))
            self.limbs = ("hip", "knee", "ankle") if self.rng.uniform() < 0.5 else ("elbow", "wrist")
        if self.exchanged_for == 0:
            return
        self.exchanged_for -= 1
        names = [point.name for point in self.points]
        left, right = ([names.index(f"{side}_{limb}") for limb in self.limbs] for side in SIDES)
        for values in (pixels, confidence):
            values[left + right] = values[right + left]


def _points(subject: SynthSubject) -> list[_Point]:
    """BODY_25, two hands and the face, in OpenPose's order."""
    joints = subject.joints.astype(np.float64)
    points = subject.vertices.astype(np.float64)
    strongest = subject.skin.heaviest
    face = face_places(subject)
    out = []
    for name in (*BODY_25, *hand_points("left"), *hand_points("right"), *FACE):
        side, _, rest = name.partition("_")
        kind = rest if side in SIDES else name
        if name in face:
            head = JOINTS.index("head")
            out.append(_Point(name, (head,), face[name] - joints[head], SURFACE_DEPTH))
        elif name in ("shoulders", "hips"):
            pair = tuple(JOINTS.index(f"{s}_{name[:-1]}") for s in SIDES)
            out.append(_Point(name, pair, np.zeros(3), DEPTH[name]))
        elif kind in ("big_toe", "small_toe", "heel"):
            foot = JOINTS.index(f"{side}_foot")
            mine = points[np.isin(strongest, [foot, JOINTS.index(f"{side}_ankle")])]
            mine = mine[mine[:, 1] < np.quantile(mine[:, 1], 0.4)]
            outward = mine[:, 0] * (1 if side == "left" else -1)
            score = -mine[:, 2] if kind == "heel" else mine[:, 2] + (0.6 if kind == "small_toe" else -0.3) * outward
            out.append(_Point(name, (foot,), mine[score.argmax()] - joints[foot], 0.06))
        elif kind.endswith("_tip"):
            last = JOINTS.index(f"{side}_{kind.removesuffix('_tip')}3")
            along = joints[last] - joints[last - 1]
            mine = points[strongest == last] - joints[last]
            tip = mine[(mine @ along).argmax()] if len(mine) else along
            out.append(_Point(name, (last,), 0.85 * tip, FINGER_DEPTH))
        else:
            joint = JOINTS.index(f"{side}_wrist" if kind == "hand" else name)
            depth = FINGER_DEPTH if kind[-1] in "123" else DEPTH[kind]
            out.append(_Point(name, (joint,), np.zeros(3), depth))
    return out
