"""What the measurements mean for a person who wants an avatar: usable or not, why, and what to do.

The numbers stand between what was measured on clean captures of four people and on spoilt ones (pose noise of 2
degrees, masks eroded by 3 px, exchanged hands, one side never filmed); docs/decisions.md has the table.
"""

from dataclasses import dataclass

from capture.check.report import CaptureReport, PartReport
from capture.check.silhouette import MISALIGNED, common
from command.progress import plural

Frames = tuple[int, ...]

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


@dataclass(frozen=True)
class Finding:
    """Something to act on."""

    part: str
    fatal: bool
    what: str
    advice: str


@dataclass(frozen=True)
class Verdict:
    """The findings, worst first, and what follows."""

    findings: tuple[Finding, ...]

    @property
    def usable(self) -> bool:
        return not any(finding.fatal for finding in self.findings)

    def line(self) -> str:
        """The verdict in one line."""
        if not self.findings:
            return "usable"
        reasons = [f for f in self.findings if f.fatal] or list(self.findings)
        said = "; ".join(f"{f.part}: {f.what}" for f in reasons[:3])
        more = f"; and {len(reasons) - 3} more" if len(reasons) > 3 else ""
        return ("usable, but " if self.usable else "not usable because ") + said + more


def verdict(report: CaptureReport) -> Verdict:
    """Weigh a report."""
    found: list[Finding] = []
    mm = report.landmark_residual * 1000
    if report.landmark_residual > RESIDUAL[0]:
        advice = "mark the landmarks again; left and right, or one of them, may be wrong"
        found.append(Finding("head", report.landmark_residual > RESIDUAL[1],
                             f"landmarks are {mm:.0f} mm off the template (Eq. 6)", advice))  # fmt: skip
    for part in report.parts.values():
        found += _of_frames(part) + _of_masks(part) + _of_poses(part) + _of_views(part)
    found += _of_face(report)
    return Verdict(tuple(sorted(found, key=lambda finding: not finding.fatal)))


def _of_face(report: CaptureReport) -> list[Finding]:
    face, found = report.face, []
    if face is None:
        return []
    if face.frames == 0:
        return [Finding("head", False, "no frame shows the eyes from the front", "film the face as well")]
    if face.iris < IRIS_PIXELS:
        found.append(Finding("head", False, f"an iris is {face.iris:.0f} pixels wide",
                             "film the head closer, or give larger images: iris and white run together"))  # fmt: skip
    if face.closed:
        found.append(Finding("head", False, f"lids look closed in frames {listed(face.closed)}",
                             "leave these frames out: half-closed lids end up in the texture of the eyes"))  # fmt: skip
    return found


def _of_frames(part: PartReport) -> list[Finding]:
    found = []
    if part.frames < FEW:
        found.append(Finding(part.part, False, f"{plural(part.frames, 'frame')} only", f"take {FEW} or more from it"))
    if part.missing:
        found.append(Finding(part.part, False, f"frame numbers are missing: {listed(part.missing)}",
                             "extract the video again, or rename if they were left out on purpose"))  # fmt: skip
    if part.repeated:
        many = len(part.repeated) > SHARE * part.frames
        found.append(
            Finding(
                part.part,
                many,
                f"frames repeat the one before: {listed(part.repeated)}",
                "extract at no more than the video's own rate; poses must skip the same frames",
            )
        )
    if part.blurred:
        found.append(Finding(part.part, False, f"blurred frames: {listed(part.blurred)}",
                             "leave them out, or film again in more light and turn slower"))  # fmt: skip
    if part.exposure.burnt > CLIPPED:
        found.append(Finding(part.part, False, f"{part.exposure.burnt:.0%} of the person is burnt out",
                             "lock the exposure lower and film again"))  # fmt: skip
    if part.exposure.black > CRUSHED:
        found.append(
            Finding(part.part, False, f"{part.exposure.black:.0%} of the person is black", "film in more light")
        )
    if part.metres_per_pixel > COARSE[part.part]:
        found.append(Finding(part.part, False, f"a pixel is {part.metres_per_pixel * 1000:.0f} mm wide",
                             "film closer, or give larger images"))  # fmt: skip
    return found


def _of_masks(part: PartReport) -> list[Finding]:
    found = []
    if part.empty:
        many = len(part.empty) > SHARE * part.frames
        found.append(Finding(part.part, many, f"masks show no person in frames {listed(part.empty)}",
                             "segment those frames again; they teach nothing"))  # fmt: skip
    if part.jumps and part.part != "head" and part.mean.iou > FOLLOWS:
        found.append(Finding(part.part, False, f"masks change size in frames {listed(part.jumps)}",
                             "look at those masks: a limb, the hair or a piece of background"))  # fmt: skip
    # else it is the template that leaves the image
    if part.cropped and part.mean.iou > FOLLOWS:
        share = len(part.cropped) / len(part.outlines)
        found.append(
            Finding(part.part, False, f"cut by the image border in {share:.0%} of the frames", "film from farther")
        )
    shift = common(part.mean.offset, part.size[1])
    if part.part != "head" and abs(shift) > OFFSET and part.mean.spread < abs(part.mean.offset):
        size = "smaller" if shift > 0 else "larger"
        found.append(
            Finding(
                part.part,
                False,
                f"masks are {abs(part.mean.offset):.0f} px {size} than the template all along",
                "look at their outlines: loose clothes also look so; --refine-poses on measures and corrects it",
            )
        )
    if part.part == "head" and part.outside > LEFT_OUT:
        found.append(
            Finding(
                part.part,
                part.outside > 0.5,
                f"masks leave out {part.outside:.0%} of the head",
                "landmarks, cameras and masks of the head video should be of one reconstruction",
            )
        )
    return found


def _of_poses(part: PartReport) -> list[Finding]:
    if part.exchanged:
        return [Finding(part.part, True, "it shows the other hand", "exchange the folders hand_left and hand_right")]
    if part.part == "head":
        return []
    if part.mean.iou < ELSEWHERE:
        return [
            Finding(
                part.part,
                True,
                f"template and masks overlap by {part.mean.iou:.0%} only",
                "poses, cameras, masks and images should be of the same frames, in metres of one world",
            )
        ]
    error = common(part.mean.spread, part.size[1])
    if error > MISALIGNED:
        return [
            Finding(
                part.part,
                False,
                f"poses are {part.mean.spread:.1f} px off the masks, most in {listed(part.worst)}",
                "train with --refine-poses on; look at overlays.png",
            )
        ]
    return []


def _of_views(part: PartReport) -> list[Finding]:
    found = []
    gap, seen = part.coverage.gap, part.coverage.seen
    if gap > GAP:
        found.append(Finding(part.part, False, f"{gap:.0f} degrees of the turn have no frame",
                             "film a whole turn, evenly"))  # fmt: skip
    if seen < SEEN[0]:
        found.append(
            Finding(
                part.part,
                seen < SEEN[1],
                f"{seen:.0%} of the surface is seen in 3 frames or more",
                "film every side, from above and below as well; what no frame saw stays the template",
            )
        )
    return found


def listed(frames: Frames, most: int = 6) -> str:
    """Frame numbers for reading."""
    text = ", ".join(str(frame) for frame in frames[:most])
    return f"{text} and {len(frames) - most} more" if len(frames) > most else text
