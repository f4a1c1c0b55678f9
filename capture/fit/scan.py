"""Four videos to a person: body, hands, head, each from what the ones before it found."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from avatar.camera import Camera
from avatar.progress import Progress
from avatar.rotation import axis_angle_from_matrix, rotation_between
from capture.fit import body, hand, head
from capture.fit.footage import Estimate, Footage, footage_of
from capture.fit.joint_turns import rotations
from capture.fit.kinematics import Lens
from capture.fit.person import Person, person_of
from capture.fit.points import body_points
from capture.fit.refusals import check_fit, check_footage, check_upright
from capture.fit.stored import fingerprint, read_estimate, write_estimate
from capture.imports.template import Template
from capture.raw_scan import FittedScan, FittedVideo, RawScan, RawVideo

Array = np.ndarray

# of the shorter side of the picture: a phone's video, where nobody says
FOCAL = 1.5
# relative standard deviations of the focal length: guessed, told, and found in the body's video by the same phone
GUESSED, TOLD, FOUND = 0.1, 0.005, 0.005
# what each video's fit reports
STEPS = {"body": 10, "hand_left": 7, "hand_right": 7, "head": 9}
OPENCV = np.diag([1.0, -1.0, -1.0])
LANDMARKS = {
    "nose_tip": "face_30", "nose_bridge": "face_27", "chin": "face_08", "left_mouth": "face_54",
    "right_mouth": "face_48", "left_eye_outer": "face_45", "right_eye_outer": "face_36", "left_eye_inner": "face_42",
    "right_eye_inner": "face_39", "left_ear": "left_ear", "right_ear": "right_ear",
}  # fmt: skip


def fit_scan(scan: RawScan, *, sex: str = "male", stature: float | None = None, work: Path | None = None) -> FittedScan:
    """The person of four videos, their poses and cameras.

    `sex` ("male", "female") is the free body that is begun with; `stature` in metres (None: that body's own, and every
    length with it). Finished steps are kept in the folder `work`, and not done again for the same videos.

    Raises:
        AssetError: a video has too few points, points that are not of its person, or a fit that explains too little.
    """
    notes = [] if stature else [f"stature not told: {person_of(sex).stature:.2f} m of the free body, {sex}"]
    fit = _Fit(work)
    found: dict[str, FittedVideo] = {}

    video = scan.videos["body"]
    focal = video.focal or FOCAL * min(video.size)
    footage = footage_of(video.keypoints, video.masks, body.body_names(), body.MOVING, focal=focal,
                         focal_doubt=TOLD if video.focal else GUESSED)  # fmt: skip
    check_footage("body", footage)
    check_upright(footage)
    estimate = fit.step("body", person_of(sex, stature), np.zeros(0), footage,
                        lambda person, g, report: body.fit_body(person, footage, report))  # fmt: skip
    # sides that the detector exchanged are of no account here
    usable = check_fit("body", estimate, body.sides_restored(estimate, footage))
    found["body"] = posed_video(estimate, footage, usable, level=True)
    if not video.focal:
        notes.append(f"focal length not told: {estimate.lens(footage).focal:.0f} pixels found from the body's video")
    phone = estimate.lens(footage).focal / min(video.size)

    for part in ("hand_left", "hand_right"):
        side = part.removeprefix("hand_")
        footage = _close_up(scan.videos[part], hand.hand_names(side), hand.hand_joints(side), phone)
        check_footage(part, footage)
        estimate = fit.step(part, estimate.person, estimate.g, footage, lambda person, g, report:
                            hand.fit_hand(person, g, footage, side, report))  # fmt: skip
        found[part] = posed_video(estimate, footage, check_fit(part, estimate, footage), level=False)

    footage = _close_up(scan.videos["head"], head.NAMES, np.zeros(0, np.int64), phone)
    check_footage("head", footage)
    estimate = fit.step("head", estimate.person, estimate.g, footage,
                        lambda person, g, report: head.fit_head(person, g, footage, report))  # fmt: skip
    lens = estimate.lens(footage)
    cameras = tuple(opencv_camera(lens, pose, footage.size) for pose in head.camera_from_head(estimate))
    found["head"] = FittedVideo(cameras, None, None, check_fit("head", estimate, footage))

    for part, fitted in found.items():
        if not fitted.usable.all():
            bad = scan.videos[part].frames[~fitted.usable]
            notes.append(f"{part}: {len(bad)} frames left out, the fit does not explain them: {bad.tolist()[:20]}")
    vertices = estimate.person.vertices(estimate.g)
    table = body_points()
    landmarks = {name: int(table[point].vertices[0]) for name, point in LANDMARKS.items()}
    places = {name: (vertices[vertex], vertex) for name, vertex in landmarks.items()}
    return FittedScan(template_of(estimate), found, places, tuple(notes))


class _Fit:
    """Steps of the fit: done, or read back, and reported."""

    def __init__(self, work: Path | None):
        self.work, self.done = work, 0
        self.progress = Progress("fitting", sum(STEPS.values()))
        self.before = ""
        if work is not None:
            work.mkdir(parents=True, exist_ok=True)

    def step(self, part: str, person: Person, g: Array, footage: Footage, fit: Callable[..., Estimate]) -> Estimate:
        inputs = fingerprint(footage, self.before, person.body.name, person.stature)
        path = None if self.work is None else self.work / f"{part}.npz"
        estimate = None if path is None else read_estimate(path, person, inputs)
        end = self.done + STEPS[part]
        if estimate is None:
            estimate = fit(person, g, lambda note: self.report(f"{part}: {note}"))
            if path is not None:
                write_estimate(path, estimate, inputs)
        self.before, self.done = inputs, end
        self.progress.update(self.done, part)
        return estimate

    def report(self, note: str) -> None:
        self.done += 1
        self.progress.update(self.done, note)


def _close_up(video: RawVideo, names: tuple[str, ...], moving: Array, phone: float) -> Footage:
    """The footage of a hand or the head, filmed by the phone that filmed the body."""
    focal = video.focal or phone * min(video.size)
    return footage_of(
        video.keypoints, video.masks, names, moving, focal=focal, focal_doubt=TOLD if video.focal else FOUND
    )


def opencv_camera(lens: Lens, camera_from_world: Float[Array, "4 4"], size: tuple[int, int]) -> Camera:
    """The camera of a picture."""
    K = np.array([[lens.focal, 0, lens.centre[0]], [0, lens.focal, lens.centre[1]], [0, 0, 1.0]])
    return Camera(K, camera_from_world, size)


def posed_video(estimate: Estimate, footage: Footage, usable: Bool[Array, "frames"], *, level: bool) -> FittedVideo:
    """Poses in a world with the person at its origin; `level`: turned so that the person stands upright on average."""
    up = np.array([0, 1.0, 0])
    turn = np.eye(3)
    if level:
        mean = (estimate.heading @ up).mean(0)
        turn = rotation_between(mean / np.linalg.norm(mean), up)
    middle = estimate.root.mean(0)
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = OPENCV @ turn.T
    camera_from_world[:3, 3] = OPENCV @ middle
    camera = opencv_camera(estimate.lens(footage), camera_from_world, footage.size)
    local = rotations(estimate.angles)
    local[:, 0] = turn @ estimate.heading
    return FittedVideo(
        (camera,) * len(usable), axis_angle_from_matrix(local), (estimate.root - middle) @ turn.T, usable
    )


def template_of(estimate: Estimate) -> Template:
    """The person in pose 0."""
    person = estimate.person
    base = person.body
    vertices, joints = person.vertices(estimate.g), person.joints(estimate.g)
    return Template(
        vertices - joints[0], base.faces, base.skin, joints - joints[0], base.licence, base.uv, base.uv_faces
    )
