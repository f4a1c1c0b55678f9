"""`make demo`: the whole path on the built-in person, from four synthetic videos to a film of the avatar.

    python -m experiments.demo out/demo

The person shines a little (`synth --sheen`): what is seen depends on from where, the avatar gets a view network
and the film, whose camera goes round, shows it. Stages run in order, each says its name, its share of the
time and, at its end, its seconds. A stage whose output is complete is kept, so an interrupted demo goes on where it
stopped; once a stage has run anew, all after it run anew as well.
"""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

from avatar.gltf.avatar_file import read_avatar
from command.stages import Stage, command, run_stages
from experiments.program import end_with
from files.whole import write_text

# strength of the shine that depends on the view, and pixels of the videos' sides
SHEEN, SIZE = 0.5, 512
SCENE = """# The film of `make demo`. Change it and film again: selfscan render --scene {name} -o avatar.mp4
size = [640, 640]

[[avatar]]
path = "avatar.glb"
motion = "counting"
life = 1

[[camera]]
kind = "orbit"

[background]
color = "#3a4656"

[effects]
view = "{view}"
antialiasing = "auto"
"""


def film(avatar: Path, scene: Path, out: Path) -> Callable[[], int]:
    """Write the scene, with the view mode that the bake chose per pixel, and film it."""

    def run() -> int:
        write_text(scene, SCENE.format(name=scene.name, view=read_avatar(avatar).default_view))
        return command("selfscan", "render", "--scene", scene, "-o", out)()

    return run


def stages(out: Path) -> list[Stage]:
    """The commands of the demo, as a user would type them."""
    capture, run, avatar = out / "capture", out / "run", out / "avatar.glb"
    resume = ["--resume"] if run.with_name(run.name + ".partial").exists() else []
    # without --run: volumes of the field take most of a minute a frame, and a true picture is at hand
    measured = ["--capture", capture, "--frames", "2", "--rounds", "20"]
    report, sheet, selfscan = out / "report", out / "contact.png", partial(command, "selfscan")
    filmed = selfscan("synth", "builtin", capture, "--size", str(SIZE), "--sheen", str(SHEEN), "--truth-every", "3")
    trained = selfscan("train", capture, "-o", run, "--preset", "demo", *resume)
    return [
        Stage("synthesise four videos", capture / "capture.json", filmed, 1.2),
        Stage("train four part fields", run / "run.json", trained, 5.0),
        Stage("bake the avatar", avatar, selfscan("bake", run, "-o", avatar, "--capture", capture), 1.5),
        Stage("film", out / "avatar.mp4", film(avatar, out / "film.toml", out / "avatar.mp4"), 0.5),
        Stage("contact sheet", sheet, command("experiments.contact_sheet", run, avatar, capture, "-o", sheet), 0.7),
        Stage("accuracy against time", report / "bench.json", selfscan("bench", avatar, "-o", report, *measured), 1.0),
    ]


def summary(out: Path, seconds: dict[str, float]) -> list[str]:
    """How long the demo took, which promises its avatar missed, what to look at, in order, and what to type next."""
    avatar = read_avatar(out / "avatar.glb")
    lines = [f"{name:26}{taken:6.0f} s" for name, taken in seconds.items()]
    lines += [f"{'together':26}{sum(seconds.values()):6.0f} s"]
    missed = avatar.provenance.get("baked", {}).get("missed", [])
    lines += [f"missed: {line}" for line in missed]
    return [
        *lines,
        "",
        "look at, in this order:",
        f"  1. {out / 'avatar.mp4'}: the avatar, filmed (its scene: {out / 'film.toml'})",
        f"  2. {out / 'contact.png'}: true pictures, the field and the avatar side by side",
        f"  3. {out / 'report' / 'bench.html'}: how exact and how fast each way to draw it is",
        "",
        "type next, to turn it yourself:",
        f"  selfscan play {out / 'avatar.glb'}",
    ]


def main(argv: list[str]) -> None:
    parser = argparse.ArgumentParser("python -m experiments.demo", description="The whole path on the built-in person.")
    parser.add_argument("out", type=Path, nargs="?", default=Path("out/demo"), help="folder (%(default)s)")
    out = parser.parse_args(argv).out
    out.mkdir(parents=True, exist_ok=True)
    print("\n" + "\n".join(summary(out, run_stages(stages(out)))))


if __name__ == "__main__":
    end_with(main)
