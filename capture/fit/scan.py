"""Videos to a person: body, and of hands and head what was filmed, each from what the ones before it found."""

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from avatar.limits import axis_angle_from_joint_angles
from avatar.rotation import axis_angle_from_matrix, rotation_between
from avatar.skeleton import PARTS, skin_transforms
from capture.fit import body, hand, head
from capture.fit.eyes import with_eyes_of_pictures
from capture.fit.focal import Focal, focal_of_videos
from capture.fit.footage import Estimate, Footage, footage_of
from capture.fit.person import person_of
from capture.fit.points import body_points
from capture.fit.refusals import check_fit, check_footage, check_upright
from capture.fit.trunk import trunk_angles
from capture.raw.scan import FittedScan, FittedVideo, RawScan, RawVideo
from capture.read.template import TemplateMesh, body_template
from command.errors import AssetError
from command.progress import Progress, ProgressBoard, Reporter, plural
from command.workers import run_jobs

Step = TypeVar("Step")

# shorter sides of the picture: a phone's video, where its file does not say
FOCAL = 1.5
# relative standard deviations of the focal length: guessed, written by the phone, given by the user, and found in all
# videos, from which one alone would draw it away
GUESSED, WRITTEN, GIVEN, FOUND = 0.1, 0.05, 0.005, 0.003
# what each video's fit reports
STEPS = {"focal length": 4, "body": 10, "hand_left": 6, "hand_right": 6, "head": 8}
# one hand's fingers begin as the other's were found
CLOSE_UPS = {"hands": ("hand_left", "hand_right"), "head": ("head",)}
OPENCV = np.diag([1.0, -1.0, -1.0])
LANDMARKS = {
    "nose_tip": "face_30", "nose_bridge": "face_27", "chin": "face_08", "left_mouth": "face_54",
    "right_mouth": "face_48", "left_eye_outer": "face_45", "right_eye_outer": "face_36", "left_eye_inner": "face_42",
    "right_eye_inner": "face_39", "left_ear": "left_ear", "right_ear": "right_ear",
}  # fmt: skip


def fit_scan(scan: RawScan, *, sex: str = "male", stature: float | None = None) -> FittedScan:
    """The person of the videos, their poses and cameras.

    `sex` ("male", "female") is the free body that is begun with; `stature` in metres (None: that body's own, and every
    length with it).

    Raises:
        AssetError: a video has too few points, points that are not of its person, or a fit that explains too little.
    """
    notes = [] if stature else [f"stature not given: {person_of(sex).stature:.2f} m of the free body, {sex}"]
    fit = _Fit(Progress("fitting", STEPS["focal length"] + STEPS["body"]).update)
    found: dict[str, FittedVideo] = {}
    person = person_of(sex, stature)
    phone = phone_of(scan.videos.values())
    footages = {part: footage_in(video, phone) for part, video in scan.videos.items()}
    for part, footage in footages.items():
        check_footage(part, footage)
    check_upright(footages["body"])
    if any(video.focal is None for video in scan.videos.values()):
        tracked = {part: tracked_in(video, phone) for part, video in scan.videos.items()}
        phone = fit.step("focal length", lambda report: focal_of_videos(person, tracked, report))
        pixels = phone.shorter_sides * min(scan.videos["body"].size)
        notes.append(
            f"focal length not given: {pixels:.0f} pixels ({100 * phone.sigma:.1f} % unsure) found from the videos"
        )
        phone = replace(phone, sigma=FOUND)
        footages = {part: footage_in(video, phone) for part, video in scan.videos.items()}

    footage = footages["body"]
    estimate = fit.step("body", lambda report: body.fit_body(person, footage, report))
    # sides that the detector exchanged are of no account here
    usable = check_fit("body", estimate, body.sides_restored(estimate, footage))
    found["body"] = posed_video(estimate, footage, usable, level=True)

    estimate, closer, said = _with_close_ups(scan, footages, phone, estimate)
    joints = estimate.person.joints(estimate.g)
    # a body's video shows a face well enough, but fingers as some pixels
    found |= {part: closer[part] if part in closer else carried(part, found["body"], joints) for part in PARTS[1:]}
    notes += said
    for part, fitted in found.items():
        if not fitted.usable.all():
            bad = scan.videos.get(part, scan.videos["body"]).frames[~fitted.usable]
            notes.append(f"{part}: {plural(len(bad), 'frame')} left out, unexplained by the fit: {bad.tolist()[:20]}")
    vertices = estimate.person.vertices(estimate.g)
    table = body_points()
    landmarks = {name: int(table[point].vertices[0]) for name, point in LANDMARKS.items()}
    places = {name: (vertices[vertex], vertex) for name, vertex in landmarks.items()}
    return FittedScan(template_of(estimate), found, places, tuple(notes))


class _CloseUps(NamedTuple):
    """Videos that are fitted one after the other, for a worker process."""

    footages: dict[str, Footage]
    film: RawVideo | None  # the one that shows the head, where that is among them
    estimate: Estimate  # the body's
    filmed: bool  # or cut from the body's video, which may show too little


class _SeenClose(NamedTuple):
    """What close-ups add to the body: coefficients, offsets and their videos; or why there is nothing."""

    g: Float[Array, "g"]
    offsets: Float[Array, "vertices 3"]
    videos: dict[str, FittedVideo]
    failure: str = ""


def _fit_close_ups(job: _CloseUps, reporter: Reporter) -> _SeenClose:
    fit, estimate, videos = _Fit(reporter.step), job.estimate, {}
    person, g = estimate.person, estimate.g
    try:
        for part, footage in job.footages.items():
            estimate, videos[part] = fit.close_up(part, estimate, footage, job.film)
            if part == "head" and job.film is not None and job.filmed:
                trunk = trunk_angles(estimate, footage, job.film.keypoints)
                videos[part] = replace(videos[part], trunk=trunk)
    except AssetError as error:
        if job.filmed:
            raise
        return _SeenClose(np.zeros_like(g), np.zeros_like(person.offsets), {}, str(error))
    return _SeenClose(estimate.g - g, estimate.person.offsets - person.offsets, videos)


def _with_close_ups(
    scan: RawScan, footages: Mapping[str, Footage], phone: Focal, estimate: Estimate
) -> tuple[Estimate, dict[str, FittedVideo], list[str]]:
    """The person with head and hands as their videos show them, those videos, and what is worth saying."""
    film = scan.videos.get("head", replace(scan.videos["body"], part="head"))
    seen = {"head": footage_in(film, phone)} | dict(footages)
    jobs = {}
    for name, parts in CLOSE_UPS.items():
        there = {part: seen[part] for part in parts if part in seen}
        if there:
            jobs[name] = _CloseUps(
                there, film if name == "head" else None, estimate, parts[0] in footages or name == "hands"
            )
    workers = min(os.cpu_count() or 1, len(jobs))
    board = ProgressBoard({name: sum(STEPS[part] for part in job.footages) for name, job in jobs.items()}, workers)
    done = run_jobs(jobs, _fit_close_ups, board, workers)
    person, videos = estimate.person, {}
    for each in done.values():
        videos |= each.videos
    person = replace(person, offsets=person.offsets + sum(each.offsets for each in done.values()))
    estimate = replace(estimate, person=person, g=estimate.g + sum(each.g for each in done.values()))
    said = [f"{name}: as the body holds it: {each.failure}" for name, each in done.items() if each.failure]
    return estimate, videos, said


class _Fit:
    def __init__(self, show: Callable[[int, str], None]):
        self.show, self.done = show, 0

    def step(self, name: str, make: Callable[[body.Report], Step]) -> Step:
        end = self.done + STEPS[name]
        found = make(lambda note: self.report(f"{name}: {note}"))
        self.done = end
        self.show(end, name)
        return found

    def close_up(
        self, part: str, estimate: Estimate, footage: Footage, film: RawVideo | None
    ) -> tuple[Estimate, FittedVideo]:
        """Head, with the film that shows it, or hand, after what was found before; AssetError: too few points show it,
        or nothing explains them."""
        check_footage(part, footage)
        person, g = estimate.person, estimate.g
        if part == "head":
            estimate = self.step(part, lambda report: head.fit_head(person, g, footage, report))
            camera = estimate.camera(footage)
            cameras = tuple(replace(camera, camera_from_world=pose) for pose in head.camera_from_head(estimate))
            usable = check_fit(part, estimate, footage)
            assert film is not None
            estimate = with_eyes_of_pictures(estimate, cameras, film, usable)
            return estimate, FittedVideo(cameras, None, None, usable)
        side = part.removeprefix("hand_")
        estimate = self.step(part, lambda report: hand.fit_hand(person, g, footage, side, report))
        return estimate, posed_video(estimate, footage, check_fit(part, estimate, footage), level=False)

    def report(self, note: str) -> None:
        self.done += 1
        self.show(self.done, note)


def phone_of(videos: Iterable[RawVideo]) -> Focal:
    """The focal length that is begun with: what the phone wrote into its files, else what is usual."""
    written = [video.focal_written / min(video.size) for video in videos if video.focal_written]
    return Focal(float(np.median(written)), WRITTEN) if written else Focal(FOCAL, GUESSED)


def names_and_joints(part: str) -> tuple[tuple[str, ...], Int[Array, "joints"]]:
    """The named points that a part's video is fitted to, and the joints that turn in it."""
    if part == "body":
        return body.body_names(), body.MOVING
    if part == "head":
        return head.NAMES, np.zeros(0, np.int64)
    side = part.removeprefix("hand_")
    return hand.hand_names(side), hand.hand_joints(side)


def footage_in(video: RawVideo, phone: Focal) -> Footage:
    """The frames kept of one video; its own focal length, where given, else the phone's."""
    given = video.focal is not None
    focal = video.focal if video.focal is not None else phone.shorter_sides * min(video.size)
    return footage_of(video.keypoints, video.masks, *names_and_joints(video.part), focal=focal,
                      focal_sigma=GIVEN if given else phone.sigma)  # fmt: skip


def tracked_in(video: RawVideo, phone: Focal) -> Footage:
    """The points of more frames of one video; its masks are empty."""
    points = video.keypoints if video.track is None else video.track
    masks = np.broadcast_to(np.uint8(0), (len(points.pixels), *video.size[::-1]))
    return footage_of(points, masks, *names_and_joints(video.part), focal=phone.shorter_sides * min(video.size),
                      focal_sigma=phone.sigma)  # fmt: skip


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
    camera = replace(estimate.camera(footage), camera_from_world=camera_from_world)
    axis_angle = axis_angle_from_joint_angles(estimate.angles)
    axis_angle[:, 0] = axis_angle_from_matrix(turn @ estimate.heading)
    return FittedVideo((camera,) * len(usable), axis_angle, (estimate.root - middle) @ turn.T, usable)


def carried(part: str, body: FittedVideo, joints: Float[Array, "52 3"]) -> FittedVideo:
    """A part as the body's video holds it: a head goes with its bone, a hand is stiff. `joints` are pose 0's."""
    if part != "head":
        return body
    assert body.axis_angle is not None and body.root is not None
    heads = skin_transforms(body.axis_angle, joints, body.root, rest=np.zeros((52, 3)))[:, head.HEAD]
    cameras = (replace(c, camera_from_world=c.camera_from_world @ h) for c, h in zip(body.cameras, heads))
    return FittedVideo(tuple(cameras), None, None, body.usable)


def template_of(estimate: Estimate) -> TemplateMesh:
    person = estimate.person
    vertices, joints = person.vertices(estimate.g), person.joints(estimate.g)
    return replace(body_template(person.body), vertices=vertices - joints[0], joints=joints - joints[0])
