"""selfscan bake: run folder -> avatar file."""

import argparse
from pathlib import Path

from avatar.errors import AssetError

HELP = """Bake a trained run into one avatar file.

The fused field becomes one closed mesh (30k triangles, with 10k and 3k beside it), one texture atlas per
level, skin weights for the 52 joints, and, where the person's look really depends on the view, a tiny network.
The file is a plain glTF binary that any viewer opens. What baking lost is measured and written into the file.

With --capture (a capture that holds the truth, as `selfscan synth` writes it) every view mode of the file is
compared with true pictures that training never saw, and the best becomes the file's default; the file says so.
RUN/fields.onnx, the field itself for ONNX Runtime, is written into the run folder when it is not there yet."""


def main(argv: list[str]) -> int:
    """Parse the command line and bake."""
    parser = argparse.ArgumentParser(
        prog="selfscan bake", description=HELP, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="run folder, as `selfscan train` writes it")
    parser.add_argument("-o", dest="out", type=Path, required=True, metavar="NAME.glb", help="avatar file to write")
    parser.add_argument("--faces", type=int, default=30_000, help="triangles of the finest level (%(default)s)")
    parser.add_argument("--texture", type=int, default=2048, help="its atlas, texels per side (%(default)s)")
    parser.add_argument(
        "--quality",
        choices=("normal", "high"),
        default="normal",
        help="view network: normal (4 features, 8-16-3) or high (8 features, 12-16-16-3: twice the feature images)",
    )
    parser.add_argument(
        "--capture", type=Path, metavar="CAPTURE", help="choose the default view mode by this capture's truth"
    )
    arguments = parser.parse_args(argv)
    if arguments.out.suffix.lower() != ".glb":
        parser.error(f"-o should name a .glb file, is {arguments.out}")
    if arguments.faces < 200:
        parser.error(f"--faces should be at least 200, is {arguments.faces}")
    size = arguments.texture
    if size < 64 or size > 8192 or size & (size - 1):
        parser.error(f"--texture should be a power of two from 64 to 8192, is {size}")
    if not arguments.run.is_dir():
        raise AssetError(
            f"{arguments.run}: expected a run folder, found {'a file' if arguments.run.exists() else 'nothing'}"
        )

    from bake.bake import bake

    bake(
        arguments.run,
        arguments.out,
        arguments.faces,
        size,
        quality=arguments.quality,
        capture=arguments.capture,
    )
    return 0
