"""A film of two scenes side by side: one that calls for nothing, and one that calls for every effect.

    python -m experiments.effects_film AVATAR -o out/effects_film

docs/scenes/nothing.toml and everything.toml with AVATAR, which walks, then counts, while the camera goes once round:
OUT/effects.mp4, OUT/effects.png (one frame of it) and OUT/explain.md, what `selfscan render --explain` says of that
frame. A frame of the second scene is the mean of --samples (motion blur, depth of field).
"""

import argparse
import json
from pathlib import Path

import numpy as np
from PIL import Image

from avatar.motion.amass import write_amass
from avatar.motion.clip import Clip
from avatar.motion.read import builtin_motion
from avatar.rotation import axis_angle_from_quaternion, quaternion_from_axis_angle, slerp
from files.input_file import open_film
from files.whole import write_text
from player.film.command import render_main
from player.film.film import Film
from player.scene.arguments import parse_size

SCENES = ("nothing", "everything")
FOLDER = Path(__file__).parent.parent / "docs" / "scenes"
# seconds from the walk to the counting
BETWEEN = 2.0
# of the film: the frame that is shown and explained
SHOWN = 0.33


def walk_and_count() -> Clip:
    """Both built-in motions, with a slow change of pose between them where the walk ends."""
    walk, count = (builtin_motion(name).read() for name in ("walking", "counting"))
    share = np.linspace(0, 1, round(BETWEEN * walk.rate) + 2)[1:-1]
    share = share * share * (3 - 2 * share)
    first, last = (quaternion_from_axis_angle(pose) for pose in (walk.axis_angle[-1], count.axis_angle[0]))
    turns = slerp(np.broadcast_to(first, (len(share), 52, 4)), np.broadcast_to(last, (len(share), 52, 4)),
                  np.broadcast_to(share[:, None], (len(share), 52)))  # fmt: skip
    # the counting goes on where the walk ended, at its own height
    there = count.root + np.array([1.0, 0.0, 1.0]) * (walk.root[-1] - count.root[0])
    roots = walk.root[-1] + share[:, None] * (there[0] - walk.root[-1])
    poses = np.concatenate([walk.axis_angle, axis_angle_from_quaternion(turns), count.axis_angle])
    return Clip(poses, np.concatenate([walk.root, roots, there]), walk.rate)


def scene_text(name: str, avatar: Path, size: tuple[int, int], rate: float, samples: int) -> str:
    """A scene of docs/scenes with this avatar and motion, the camera going round it."""
    text = (FOLDER / f"{name}.toml").read_text("utf-8")
    text = text.replace('"mannequin"', json.dumps(str(avatar.resolve()))).replace('"walking"', '"motion.npz"')
    text = text.replace('"sky.hdr"', json.dumps(str(FOLDER / "sky.hdr")))
    text = text.replace("size = [640, 640]", f"size = [{size[0]}, {size[1]}]\nrate = {rate:g}")
    text = text.replace("[effects.motion_blur]", f"[effects.motion_blur]\nsamples = {samples}")
    text = text.replace("[effects.depth_of_field]", f"[effects.depth_of_field]\nsamples = {samples}")
    camera = '[[camera]]\nkind = "orbit"\n'
    return text.replace('[[camera]]\nkind = "front"\n', camera) if "[[camera]]" in text else f"{text}\n{camera}"


def frames_of(film: Path) -> list[np.ndarray]:
    with open_film(film) as container:
        return [frame.to_ndarray(format="rgba") for frame in container.decode(video=0)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("avatar", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--size", type=parse_size, default=(400, 480), help="pixels of each scene")
    parser.add_argument("--rate", type=float, default=24.0, help="frames a second")
    parser.add_argument("--samples", type=int, default=8, help="of motion blur and depth of field")
    asked = parser.parse_args()
    out = asked.out
    out.mkdir(parents=True, exist_ok=True)
    clip = walk_and_count()
    write_amass(out / "motion.npz", clip, up="y")
    shown = round(SHOWN * len(clip.root) / clip.rate * asked.rate)
    tables = []
    for name in SCENES:
        scene, film = out / f"{name}.toml", out / f"{name}.mp4"
        write_text(scene, scene_text(name, asked.avatar, asked.size, asked.rate, asked.samples))
        if not film.exists():
            render_main(["--scene", str(scene), "-o", str(film)])
        passes = out / f"{name}.json"
        one = ["--frame", str(shown), "--explain", "--json", str(passes), "-o", str(out / f"{name}.png")]
        render_main(["--scene", str(scene), *one])
        rows = json.loads(passes.read_text("utf-8"))["passes"]
        tables += [f"`{name}.toml`:", "", *(f"    {r['name']:30} {r['state']:14} {r['why']}" for r in rows), ""]
    write_text(out / "explain.md", "\n".join(tables))
    beside = [
        np.concatenate(pair, 1) for pair in zip(*(frames_of(out / f"{name}.mp4") for name in SCENES), strict=True)
    ]
    with Film(out / "effects.mp4", asked.rate, quality="draft") as film:
        for frame in beside:
            film.add(np.ascontiguousarray(frame))
    Image.fromarray(beside[shown][..., :3]).save(out / "effects.png")
    print(f"wrote {out / 'effects.mp4'}: {len(beside) / asked.rate:.1f} s")


if __name__ == "__main__":
    main()
