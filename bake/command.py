"""selfscan bake: run folder -> avatar file."""

from avatar.errors import AssetError
from avatar.files import check_file
from avatar.settings import Help, parse
from bake.options import BakeCommand

HELP = """Bake a trained run into one avatar file.

The fused field becomes one closed mesh (30k triangles, with 10k, 3k and 1k beside it), one texture atlas per
level, skin weights for the 52 joints, and, where the person's look really depends on the view, a tiny network.
The file is a plain glTF binary that any viewer opens. What baking lost is measured and written into the file.

With --capture (a capture that holds the truth, as `selfscan synth` writes it) every view mode of the file is
compared with true pictures that training never saw, and the best becomes the file's default; the file says so.
RUN/fields.onnx, the field itself for ONNX Runtime, is written into the run folder when it is not there yet."""


ABOUT = Help(
    "selfscan bake", HELP, "example: selfscan bake out/run -o me.glb --capture out/capture && selfscan play me.glb"
)


def main(argv: list[str]) -> int:
    """Parse the command line and bake."""
    command = parse(BakeCommand, argv, ABOUT)
    if not command.run.is_dir():
        found = "a file" if command.run.exists() else "nothing"
        raise AssetError(f"{command.run}: expected a run folder, found {found}")
    check_file(command.out)
    from bake.bake import bake

    bake(command.run, command.out, command.options, capture=command.capture)
    return 0
