"""`selfscan check`: is this capture usable?"""

import shlex
from dataclasses import replace
from pathlib import Path

from capture.check.options import CheckCommand
from capture.check.report import CaptureReport, examine, report_facts
from capture.check.sheet import contact_sheet, overlay
from capture.check.verdict import verdict
from capture.folder import Capture, read_capture
from capture.raw.four_videos import examine_videos, face_film, find_videos, found_lines, holds_videos, unfilmed_lines
from capture.raw.judge import Verdict, verdict_of
from capture.read.face_film import open_face_film, shown_line
from capture.videos import even
from command.errors import AssetError
from command.stages import as_word
from files.whole import check_file, check_folder, whole_file, write_json


def check_capture(arguments: CheckCommand) -> int:
    """Examine, print; 1 when the capture is not usable."""
    if arguments.json:
        check_file(arguments.json)
    if arguments.out and not arguments.out.is_dir():
        check_folder(arguments.out)
    first, *others = arguments.capture
    if others or holds_videos(first):
        return _check_videos(arguments)
    if arguments.keypoints:
        raise AssetError(f"--keypoints: is for videos as filmed, {first} is a capture")
    if first.is_dir() and not (first / "capture.json").exists():
        raise AssetError(f"{first}: expected a capture, as `selfscan import` and `selfscan synth` make it, or films "
                         "(body.mp4, head.mp4, left.mp4, right.mp4), found neither")  # fmt: skip
    capture = read_capture(first)
    try:
        report = examine(capture)
    except ValueError as error:  # the landmarks determine nothing
        raise AssetError(f"{capture.path / 'head' / 'landmarks.json'}: {error}") from None
    judged = verdict(report)
    print("\n".join([*lines(report, judged), *_then(judged, "train", first, "-o", "RUN")]))
    facts = {"capture": str(capture.path), "usable": judged.usable, "verdict": judged.line(),
             "findings": [vars(finding) for finding in judged.findings], **report_facts(report)}  # fmt: skip
    _write_facts(arguments, facts)
    if arguments.out:
        path = arguments.out / "overlays.png"
        write_overlays(path, capture, report)
        print(f"{path}: outline of the mask red, of the template's parts in other colors")
    return 0 if judged.usable else 1


def _check_videos(arguments: CheckCommand) -> int:
    videos = examine_videos(arguments.capture, arguments.keypoints)
    judged = verdict_of(replace(p, part=at.glance.video.name) for at in videos.values() for p in at.problems)
    found = [*(at.line() for at in videos.values()), *found_lines(videos), *unfilmed_lines(videos)]
    face = face_film(arguments.capture)
    if face is not None:
        folder = arguments.keypoints or find_videos(arguments.capture)["body"].parent / "keypoints"
        found.append(shown_line(open_face_film(face, folder, videos["body"].glance.keypoints.order)))
    points = ["--keypoints", arguments.keypoints] if arguments.keypoints else []
    then = _then(judged, "make", *arguments.capture, *points, "-o", "NAME.glb")
    print("\n".join([*found, "", *judged.lines(), *then]))
    facts = {part: at.facts() for part, at in videos.items()}
    _write_facts(arguments, {"videos": facts, "usable": judged.usable, "verdict": judged.line()})
    return 0 if judged.usable else 1


def _then(judged: Verdict, *words: str | Path) -> list[str]:
    """The command that comes next, where there is one."""
    return [f"then: {shlex.join(['selfscan', *map(as_word, words)])}"] if judged.usable else []


def _write_facts(arguments: CheckCommand, facts: dict) -> None:
    if arguments.json:
        write_json(arguments.json, facts)
    if arguments.out:
        arguments.out.mkdir(exist_ok=True)
        write_json(arguments.out / "check.json", facts)


def lines(report: CaptureReport, judged: Verdict) -> list[str]:
    """The report for reading."""
    out = [
        f"template {report.height:.2f} m tall; head frame by {report.landmarks} landmarks, "
        f"{report.landmark_residual * 1000:.1f} mm off (Eq. 6)",
        "",
        "part        frames  mm/pixel  distance  outline px  worst frames     overlap  seen  gap   sharp  clipped",
    ]
    for name, part in report.parts.items():
        worst = ", ".join(str(frame) for frame in part.worst)
        clipped = part.exposure.burnt + part.exposure.black
        sharp = f"{part.frames - len(part.blurred)}/{part.frames}"
        out.append(
            f"{name:<11} {part.frames:>6} {part.metres_per_pixel * 1000:>9.1f} {part.distance:>7.2f} m "
            f"{part.mean.spread:>11.2f}  {worst:<15} {part.mean.iou:>8.3f} {part.coverage.seen:>5.0%} "
            f"{part.coverage.gap:>3.0f}° {sharp:>7} {clipped:>8.1%}"
        )
    if report.unseen:
        out += ["", "hardly seen; the avatar gets the color of what lies round it there:"]
        out += [f"  {place.line()}" for place in report.unseen]
    return [*out, "", *judged.lines()]


def write_overlays(path: Path, capture: Capture, report: CaptureReport) -> None:
    """Contact sheet: of each video three frames round the turn and the worst one."""
    rows = []
    for name, part in report.parts.items():
        video, by_frame = capture.videos[name], {o.frame: o for o in part.outlines}
        chosen = [part.outlines[i].frame for i in even(len(part.outlines), 3)] + [part.worst[0]]
        row = []
        for i, frame in enumerate(chosen):
            o = by_frame[frame]
            spread, iou, worst = o.agreement.spread, o.agreement.iou, ", worst" * (i == 3)
            picture = overlay(video.images[frame], video.masks[frame], o.parts, o.step)
            row.append((f"{name} {frame}: {spread:.1f} px, overlap {iou:.2f}{worst}", picture))
        rows.append(row)
    with whole_file(path) as file:
        contact_sheet(rows).save(file, format="PNG")
