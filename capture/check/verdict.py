"""What the measurements mean for a person who wants an avatar: usable or not, why, and what to do.

The numbers stand between what was measured on clean captures of four people and on spoilt ones (pose noise of 2
degrees, masks eroded by 3 px, exchanged hands, one side never filmed); docs/decisions.md has the table.
"""

from collections.abc import Callable
from functools import partial

from capture.check.face import FaceReport
from capture.check.report import CaptureReport, PartReport
from capture.check.silhouette import MISALIGNED, common
from capture.raw.judge import Finding, Verdict, verdict_of
from command.progress import plural

Frames = tuple[int, ...]
# says of one part whether it is fatal, what was found, and what to do
Add = Callable[[bool, str, str], None]

# overlap of template and mask under which poses, cameras and masks are not of one video
ELSEWHERE = 0.15
# overlap above which the template follows the person and says what the mask should show
FOLLOWS = 0.6
# common pixels: masks that much larger or smaller than the template all along
OFFSET = 1.2
# share of the template's head that the masks leave out
LEFT_OUT = 0.05
# metres of the landmarks: worth a look, refused by training
RESIDUAL = (0.006, 0.02)
# share of a part's surface seen in a few frames: holes, a side never filmed
SEEN = (0.8, 0.6)
IRIS_PIXELS = 6.0  # pixels across an iris under which iris, pupil and white run together
GAP = 60.0  # degrees of the turn without a frame
FEW = 16  # frames of a video
# share of the frames: so many bad ones are no accident
SHARE = 0.2
# share of the person's pixels that are burnt out
CLIPPED = 0.02
CRUSHED = 0.10  # share that is black
COARSE = {"body": 0.012, "head": 0.004, "hand_left": 0.004, "hand_right": 0.004}  # metres a pixel


def verdict(report: CaptureReport) -> Verdict:
    """Weigh a report."""
    found: list[Finding] = []

    def add(part: str, fatal: bool, what: str, advice: str) -> None:
        found.append(Finding(part, fatal, what, advice))

    if report.landmark_residual > RESIDUAL[0]:
        what = f"landmarks are {report.landmark_residual * 1000:.0f} mm off the template (Eq. 6)"
        advice = "mark the landmarks again; left and right, or one of them, may be wrong"
        add("head", report.landmark_residual > RESIDUAL[1], what, advice)
    for part in report.parts.values():
        for weigh in (_add_frames, _add_masks, _add_poses, _add_views):
            weigh(part, partial(add, part.part))
    if report.face is not None:
        _add_face(report.face, partial(add, "head"))
    return verdict_of(found)


def _add_face(face: FaceReport, add: Add) -> None:
    if face.frames == 0:
        add(False, "no frame shows the eyes from the front", "film the face as well")
        return
    if face.iris < IRIS_PIXELS:
        advice = "film the head closer, or give larger images: iris and white run together"
        add(False, f"an iris is {face.iris:.0f} pixels wide", advice)
    if face.closed:
        advice = "leave these frames out: half-closed lids end up in the texture of the eyes"
        add(False, f"lids look closed in frames {listed(face.closed)}", advice)


def _add_frames(part: PartReport, add: Add) -> None:
    if part.frames < FEW:
        add(False, f"{plural(part.frames, 'frame')} only", f"take {FEW} or more from it")
    if part.missing:
        advice = "extract the video again, or rename if they were left out on purpose"
        add(False, f"frame numbers are missing: {listed(part.missing)}", advice)
    if part.repeated:
        advice = "extract at no more than the video's own rate; poses must skip the same frames"
        many = len(part.repeated) > SHARE * part.frames
        add(many, f"frames repeat the one before: {listed(part.repeated)}", advice)
    if part.blurred:
        advice = "leave them out, or film again in more light and turn slower"
        add(False, f"blurred frames: {listed(part.blurred)}", advice)
    if part.exposure.burnt > CLIPPED:
        add(False, f"{part.exposure.burnt:.0%} of the person is burnt out", "lock the exposure lower and film again")
    if part.exposure.black > CRUSHED:
        add(False, f"{part.exposure.black:.0%} of the person is black", "film in more light")
    if part.metres_per_pixel > COARSE[part.part]:
        add(False, f"a pixel is {part.metres_per_pixel * 1000:.0f} mm wide", "film closer, or give larger images")


def _add_masks(part: PartReport, add: Add) -> None:
    if part.empty:
        many = len(part.empty) > SHARE * part.frames
        advice = "segment those frames again; they teach nothing"
        add(many, f"masks show no person in frames {listed(part.empty)}", advice)
    if part.jumps and part.part != "head" and part.mean.iou > FOLLOWS:
        advice = "look at those masks: a limb, the hair or a piece of background"
        add(False, f"masks change size in frames {listed(part.jumps)}", advice)
    # else it is the template that leaves the image
    if part.cropped and part.mean.iou > FOLLOWS:
        share = len(part.cropped) / len(part.outlines)
        add(False, f"cut by the image border in {share:.0%} of the frames", "film from farther")
    shift = common(part.mean.offset, part.size[1])
    if part.part != "head" and abs(shift) > OFFSET and part.mean.spread < abs(part.mean.offset):
        size = "smaller" if shift > 0 else "larger"
        advice = "look at their outlines: loose clothes also look so; --refine-poses on measures and corrects it"
        add(False, f"masks are {abs(part.mean.offset):.0f} px {size} than the template all along", advice)
    if part.part == "head" and part.outside > LEFT_OUT:
        advice = "landmarks, cameras and masks of the head video should be of one reconstruction"
        add(part.outside > 0.5, f"masks leave out {part.outside:.0%} of the head", advice)


def _add_poses(part: PartReport, add: Add) -> None:
    if part.exchanged:
        add(True, "it shows the other hand", "exchange the folders hand_left and hand_right")
    elif part.part == "head":
        return
    elif part.mean.iou < ELSEWHERE:
        advice = "poses, cameras, masks and images should be of the same frames, in metres of one world"
        add(True, f"template and masks overlap by {part.mean.iou:.0%} only", advice)
    elif common(part.mean.spread, part.size[1]) > MISALIGNED:
        what = f"poses are {part.mean.spread:.1f} px off the masks, most in {listed(part.worst)}"
        add(False, what, "train with --refine-poses on; look at overlays.png")


def _add_views(part: PartReport, add: Add) -> None:
    gap, seen = part.coverage.gap, part.coverage.seen
    if gap > GAP:
        add(False, f"{gap:.0f} degrees of the turn have no frame", "film a whole turn, evenly")
    if seen < SEEN[0]:
        advice = "film every side, from above and below as well; what no frame saw stays the template"
        add(seen < SEEN[1], f"{seen:.0%} of the surface is seen in 3 frames or more", advice)


def listed(frames: Frames) -> str:
    """Frame numbers for reading, six at most."""
    text = ", ".join(map(str, frames[:6]))
    return f"{text} and {len(frames) - 6} more" if len(frames) > 6 else text
