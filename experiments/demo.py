"""`make demo`: the whole path on the built-in person, from four raw videos to a film of the avatar.

    python -m experiments.demo out/demo

It is the road of who films themselves: `selfscan make` as it comes. A first avatar is there after a few minutes,
out/demo/avatar.glb; then the head's field is trained and baked over it (`--minutes 15` trains all four). The person
shines a little (`synth --sheen`), and the film's camera goes round. Stages run in order, each says its name, its share
of the time and, at its end, its seconds. A stage whose output is complete is kept, so an interrupted demo goes on where
it stopped; once a stage has run anew, all after it run anew as well.
"""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

from avatar.gltf.avatar_file import read_avatar
from command.stages import Stage, command, run_stages
from experiments.program import end_with
from files.whole import write_text

# strength of the shine that depends on the view, pixels of the videos' shorter side, seconds of a turn
SHEEN, SIZE, TURN = 0.5, 400, 3
# metres, as the person would say it
STATURE = 1.753
SCENE = """# The film of `make demo`. Change it and film again: selfscan render --scene {name} -o avatar.mp4
size = [640, 640]

[[avatar]]
path = "{avatar}"
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
        place = avatar.relative_to(scene.parent).as_posix()
        write_text(scene, SCENE.format(name=scene.name, avatar=place, view=read_avatar(avatar).default_view))
        return command("selfscan", "render", "--scene", scene, "-o", out)()

    return run


def stages(out: Path) -> list[Stage]:
    """The commands of the demo, as a user would type them."""
    films, avatar, report = out / "films", out / "avatar.glb", out / "report"
    first, head = (avatar.with_suffix(".making") / f"{name}.glb" for name in ("first", "head"))
    sheet, selfscan = out / "contact.png", partial(command, "selfscan")
    how = ["--raw", "--keypoints", "--size", str(SIZE), "--seconds", str(TURN), "--sheen", str(SHEEN)]
    known = ["--sex", "male", "--stature", str(STATURE)]
    beside = [f"builtin={path}" for path in (first, head)]
    return [
        Stage("film four raw videos", films / "truth" / "raw.json", selfscan("synth", "builtin", films, *how), 1.2),
        Stage("make an avatar of them", head, selfscan("make", films, "-o", avatar, *known), 5.5),
        Stage("film", out / "avatar.mp4", film(avatar, out / "film.toml", out / "avatar.mp4"), 0.2),
        Stage("contact sheet", sheet, command("experiments.beside_sheet", sheet, *beside, "--sheen", str(SHEEN)), 0.3),
        Stage("accuracy against time", report / "bench.json",
              selfscan("bench", avatar, "-o", report, "--frames", "2", "--rounds", "20"), 0.7),
    ]  # fmt: skip


def summary(out: Path, seconds: dict[str, float]) -> list[str]:
    """How long the demo took, which promises its avatar missed, what to look at, in order, and what to type next."""
    lines = [f"{name:26}{taken:6.0f} s" for name, taken in seconds.items()]
    lines += [f"{'together':26}{sum(seconds.values()):6.0f} s"]
    missed = read_avatar(out / "avatar.glb").provenance.get("baked", {}).get("missed", [])
    lines += [f"missed: {line}" for line in missed]
    return [
        *lines,
        "",
        "look at, in this order:",
        f"  1. {out / 'avatar.mp4'}: the avatar, filmed (its scene: {out / 'film.toml'})",
        f"  2. {out / 'contact.png'}: the true person beside the first avatar, and beside that with a learned head",
        f"  3. {out / 'report' / 'bench.html'}: how exact and how fast each way to draw it is",
        "",
        "type next, to turn it, and to train the fields of body, head and hands too:",
        f"  selfscan play {out / 'avatar.glb'}",
        f"  selfscan make {out / 'films'} -o {out / 'avatar.glb'} --sex male --stature {STATURE} --minutes 15",
    ]


def main(argv: list[str]) -> None:
    parser = argparse.ArgumentParser("python -m experiments.demo", description="The whole path on the built-in person.")
    parser.add_argument("out", type=Path, nargs="?", default=Path("out/demo"), help="folder (%(default)s)")
    out = parser.parse_args(argv).out
    out.mkdir(parents=True, exist_ok=True)
    print("\n" + "\n".join(summary(out, run_stages(stages(out)))))


if __name__ == "__main__":
    end_with(main)
