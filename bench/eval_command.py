"""`selfscan eval`: what it is asked for, and its command line; the work is in bench/score/quality.py."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from avatar.gltf.avatar_file import avatar_place
from command.command_line import Help, Option, parse
from command.errors import AssetError
from command.settings import AtLeast
from files.whole import check_file, write_json


@dataclass(frozen=True)
class EvalCommand:
    subject: Annotated[Path, Option(positional=True, metavar="RUN_OR_AVATAR"), "run folder, or avatar file (.glb)"]
    capture: Annotated[Path, Option(positional=True, metavar="CAPTURE"),
        "capture folder with truth/ (selfscan synth), or of a raw scan (synth --raw --keypoints --held-out)"]
    json: Annotated[Path | None, Option(metavar="FILE"), "write every number here as well"] = None
    poses: Annotated[int | None, AtLeast(1), "a quick look: only N poses of each set"] = None
    lpips: Annotated[tuple[Path, ...], Option(metavar="FILE", several=True),
        "LPIPS's weights, which are not shipped: one file of the whole network's state dictionary, or torchvision's "
        "AlexNet and the lpips package's linear layers (bench/score/lpips.py says how)"] = ()
    run: Annotated[Path | None, Option(metavar="RUN"),
        "run the avatar was baked from: its template before training stands beside; avatars from pixels need it, "
        "since their poses are fitted to the held-out pictures with that template"] = None


EVAL = Help(
    "selfscan eval",
    """Measure a trained run or a baked avatar against the ground truth of a synthetic capture: P2S and Chamfer (cm),
PSNR, SSIM, FLIP for head, hands and the whole person, novel poses and views. What comes from raw videos is measured
against the folder of `synth --raw --keypoints --held-out`: its poses are fitted to the held-out pictures, never read
from the truth.""",
    "example: selfscan eval run capture --json quality.json",
)


def eval_main(argv: list[str]) -> int:
    """`selfscan eval RUN_OR_AVATAR CAPTURE [--json FILE]`."""
    command = parse(EvalCommand, argv, EVAL)
    subject = avatar_place(command.subject)
    if not subject.exists():
        raise AssetError(f"{subject}: expected a run folder or an avatar file, found nothing")
    if command.json:
        check_file(command.json)
    from bench.score.quality import evaluate
    from bench.score.quality_table import print_table

    result = evaluate(subject, command.capture, poses=command.poses, run=command.run, lpips=command.lpips)
    print_table(result)
    if command.json:
        write_json(command.json, result)
    return 0
