"""selfscan bake: run folder -> avatar file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from bake.options import BakeOptions
from command.command_line import Help, Option, parse
from command.errors import AssetError
from files.whole import check_file, exclusive_lock

HELP = """Bake a trained run into one avatar file.

The fused field becomes one closed mesh (30k triangles, with 10k, 3k and 1k beside it), one texture atlas per
level, skin weights for the 52 joints, and, where the person's look really depends on the view, a tiny network.
The file is a plain glTF binary that any viewer opens. What baking lost is measured and written into the file."""


ABOUT = Help(
    "selfscan bake", HELP, "example: selfscan bake run -o me.glb --capture capture && selfscan play me.glb"
)


@dataclass(frozen=True)
class BakeCommand:
    run: Annotated[Path, Option(positional=True, metavar="RUN"), "run folder, as `selfscan train` writes it"]
    out: Annotated[Path, Option(("-o",), "NAME.glb"), "avatar file to write"]
    options: Annotated[BakeOptions, "how it is baked"]
    capture: Annotated[Path | None, Option(metavar="CAPTURE"), "its videos, where run.json does not find them"] = None

    def __post_init__(self):
        if self.out.suffix.lower() != ".glb":
            raise ValueError(f"-o should name a .glb file, is {self.out}")
        if self.capture is not None and self.options.texture_from == "field":
            raise ValueError("--capture names the videos, which --texture-from field does not read")


def main(argv: list[str]) -> int:
    """Parse the command line and bake."""
    command = parse(BakeCommand, argv, ABOUT)
    if not command.run.is_dir():
        found = "a file" if command.run.exists() else "nothing"
        raise AssetError(f"{command.run}: expected a run folder, found {found}")
    check_file(command.out)
    from bake.bake import bake

    with exclusive_lock(command.out):
        bake(command.run, command.out, command.options, capture=command.capture)
    return 0
