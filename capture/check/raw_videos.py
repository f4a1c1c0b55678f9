"""Are these four videos good enough to be fitted? What is wrong is said with what to do about it, before any work."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from capture.raw.four_videos import KEYPOINTS, find_videos, judge_videos, part_keypoints
from capture.raw.judge import Judged
from capture.raw.video_file import open_video
from command.errors import AssetError


def examine_videos(paths: Sequence[Path], keypoints: Path | None) -> dict[str, Judged]:
    """Judge four videos; without `keypoints` those beside them, in a folder of that name, are taken.

    Raises:
        AssetError: a video or its keypoints cannot be read.
    """
    files = find_videos(paths)
    folder = files["body"].parent / "keypoints" if keypoints is None else keypoints
    videos = {part: open_video(path) for part, path in files.items()}
    if not folder.is_dir():
        raise AssetError(f"{folder}: expected {KEYPOINTS}; --keypoints DIR says where they are")
    return judge_videos(videos, {part: part_keypoints(folder, part, video) for part, video in videos.items()})


def video_lines(judged: Mapping[str, Judged]) -> list[str]:
    """The report for reading: a line for each video, then the verdict and what to do."""
    out = []
    for at in judged.values():
        facts = at.facts()
        width, height = facts["size"]
        out.append(
            f"{at.glance.video.name:<10} {width} x {height}, {facts['rate']:.0f} frames/s, {facts['seconds']:.1f} s; "
            f"empty room {facts['empty'] / facts['rate']:.1f} s; the person in {facts['with_person']} frames, "
            f"{facts['usable']} can be used"
        )
    out += ["", verdict_line(judged)]
    for at in judged.values():
        out += [f"  {problem.line(at.glance.video.name)}" for problem in sorted(at.problems, key=lambda r: not r.fatal)]
    return out


def verdict_line(judged: Mapping[str, Judged]) -> str:
    """Usable; usable, but ...; not usable because ..., as for a capture folder."""
    problems = [(at.glance.video.name, problem) for at in judged.values() for problem in at.problems]
    fatal = [f"{name}: {problem.what}" for name, problem in problems if problem.fatal]
    if fatal:
        return f"not usable because {'; '.join(fatal)}"
    if problems:
        return f"usable, but {'; '.join(f'{name}: {problem.what}' for name, problem in problems)}"
    return "usable"


def usable(judged: Mapping[str, Judged]) -> bool:
    """Whether these videos can be fitted: none has a fatal problem."""
    return not any(problem.fatal for at in judged.values() for problem in at.problems)
