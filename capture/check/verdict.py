"""What the measurements mean for a person who wants an avatar: usable or not, why, and what to do.

The numbers stand between what was measured on clean captures of four people and on spoilt ones (pose noise of 2
degrees, masks eroded by 3 px, exchanged hands, one side never filmed); docs/decisions.md has the table.
"""

from capture.check.report import CaptureReport, PartReport
from capture.check.silhouette import MISALIGNED, common
from capture.raw.judge import Finding, Verdict, verdict_of
from command.progress import plural

Frames = tuple[int, ...]
# whether it is so of a part; whether that is fatal, what was found, and what to do
Row = tuple[bool, bool, str, str]

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
    residual = report.landmark_residual
    rows: list[tuple[str, Row]] = [("head", (
        residual > RESIDUAL[0], residual > RESIDUAL[1],
        f"landmarks are {residual * 1000:.0f} mm off the template (Eq. 6)",
        "mark the landmarks again; left and right, or one of them, may be wrong",
    ))]  # fmt: skip
    for part in report.parts.values():
        rows += [(part.part, row) for row in (*_frames(part), *_masks(part), *_poses(part), *_views(part))]
    return verdict_of(Finding(part, fatal, what, advice) for part, (so, fatal, what, advice) in rows if so)


def _frames(part: PartReport) -> list[Row]:
    burnt, black, pixel = part.exposure.burnt, part.exposure.black, part.metres_per_pixel
    return [
        (part.frames < FEW, False, f"{plural(part.frames, 'frame')} only", f"take {FEW} or more from it"),
        (bool(part.repeated), len(part.repeated) > SHARE * part.frames,
         f"frames repeat the one before: {listed(part.repeated)}",
         "extract at no more than the video's own rate; poses must skip the same frames"),
        (bool(part.blurred), False, f"blurred frames: {listed(part.blurred)}",
         "leave them out, or film again in more light and turn slower"),
        (burnt > CLIPPED, False, f"{burnt:.0%} of the person is burnt out", "lock the exposure lower and film again"),
        (black > CRUSHED, False, f"{black:.0%} of the person is black", "film in more light"),
        (pixel > COARSE[part.part], False, f"a pixel is {pixel * 1000:.0f} mm wide",
         "film closer, or give larger images"),
    ]  # fmt: skip


def _masks(part: PartReport) -> list[Row]:
    head, follows, offset = part.part == "head", part.mean.iou > FOLLOWS, part.mean.offset
    shift = common(offset, part.size[1])
    return [
        (bool(part.empty), len(part.empty) > SHARE * part.frames,
         f"masks show no person in frames {listed(part.empty)}", "segment those frames again; they teach nothing"),
        (bool(part.jumps) and not head and follows, False, f"masks change size in frames {listed(part.jumps)}",
         "look at those masks: a limb, the hair or a piece of background"),
        # else it is the template that leaves the image
        (bool(part.cropped) and follows, False,
         f"cut by the image border in {len(part.cropped) / len(part.outlines):.0%} of the frames", "film from farther"),
        (not head and abs(shift) > OFFSET and part.mean.spread < abs(offset), False,
         f"masks are {abs(offset):.0f} px {'smaller' if shift > 0 else 'larger'} than the template all along",
         "look at their outlines: loose clothes also look so; --refine-poses on measures and corrects it"),
        (head and part.outside > LEFT_OUT, part.outside > 0.5, f"masks leave out {part.outside:.0%} of the head",
         "landmarks, cameras and masks of the head video should be of one reconstruction"),
    ]  # fmt: skip


def _poses(part: PartReport) -> list[Row]:
    posed, elsewhere = part.part != "head" and not part.exchanged, part.mean.iou < ELSEWHERE
    return [
        (part.exchanged, True, "it shows the other hand", "exchange the folders hand_left and hand_right"),
        (posed and elsewhere, True, f"template and masks overlap by {part.mean.iou:.0%} only",
         "poses, cameras, masks and images should be of the same frames, in metres of one world"),
        (posed and not elsewhere and common(part.mean.spread, part.size[1]) > MISALIGNED, False,
         f"poses are {part.mean.spread:.1f} px off the masks, most in {listed(part.worst)}",
         "train with --refine-poses on; look at overlays.png"),
    ]  # fmt: skip


def _views(part: PartReport) -> list[Row]:
    gap, seen = part.coverage.gap, part.coverage.seen
    return [
        (gap > GAP, False, f"{gap:.0f} degrees of the turn have no frame", "film a whole turn, evenly"),
        (seen < SEEN[0], seen < SEEN[1], f"{seen:.0%} of the surface is seen in 3 frames or more",
         "film every side, from above and below as well; what no frame saw stays the template"),
    ]  # fmt: skip


def listed(frames: Frames) -> str:
    """Frame numbers for reading, six at most."""
    text = ", ".join(map(str, frames[:6]))
    return f"{text} and {len(frames) - 6} more" if len(frames) > 6 else text
