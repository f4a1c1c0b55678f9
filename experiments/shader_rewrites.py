"""Every shader rewritten in ways that change nothing (glsl_rewrites.py): the picture must stay within 1/255.

    python -m experiments.shader_rewrites [WORD ...] [--rounds 3] [--seed 0] [--context egl|osmesa] [-o out/rewrites]

Each drawing below is drawn as it is, then with each rewrite at each seed, and with all ten one after the other. What
differs is kept under OUT: both stages as they were rewritten. Exit code 1: a picture changed, or a shader is in no
drawing. WORDs choose drawings.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from unittest.mock import patch

import moderngl
import numpy as np

import player.gl.shader
from avatar.baked_avatar import Avatar
from avatar.camera import Camera, orbit_camera
from avatar.light import CaptureLight, Lamp
from experiments.glsl_rewrites import REWRITES, Plan, rewriting
from player.draw.raster import Rasteriser
from player.effects.background import Background
from player.effects.contact import Contact
from player.effects.grid import Grid
from player.effects.ground import Ground
from player.effects.light import Light
from player.effects.outline import Outline
from player.effects.secondary_motion import SecondaryMotion
from player.gl.context import Context, open_context
from player.gl.shader import compile_program, set_uniforms
from player.scene.effects import PLAIN, Effects
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer
from player.window.picture import PictureLayer
from tests.faced_avatar import doing, faced
from tests.loose_avatar import dance, dressed

SIZE = (160, 160)
CAMERA = orbit_camera((0.2, 0.85, 0), 3.0, 0.5, 0.3, SIZE)
SKY = Path(__file__).parents[1] / "docs" / "scenes" / "sky.hdr"
SHADERS = Path(__file__).parents[1] / "shaders"
WHITE = (1.0, 1.0, 1.0, 1.0)
EVERYTHING = Effects(
    "network", "dual_quaternion", "fxaa", ground=Ground("checker"), contact=Contact(), grid=Grid(),
    outline=Outline(), secondary_motion=SecondaryMotion(), light=Light("lamps", highlight=0.3),
)  # fmt: skip
LAMPS = CaptureLight(0.5, (Lamp((0.48, -0.6, -0.64), 0.7),), gloss=0.2, exponent=20.0, gamma=2.2)

Drawing = Callable[[Context], np.ndarray]


@cache
def people() -> tuple[Avatar, Avatar]:
    """One in a skirt and with long hair, whose colours have a light; one with a face."""
    return replace(dressed(), light=LAMPS), faced()


def scene(effects: Effects, background: Background | tuple[float, ...] = WHITE) -> Drawing:
    """Both people, one dancing, the other with an open mouth."""

    def draw(context: Context) -> np.ndarray:
        renderer = Renderer(context, people(), SIZE, effects=effects, background=background)
        for frame in range(20):
            poses = _poses(frame / 30)
            renderer.move(poses, frame / 30)
        picture = renderer.draw(poses, CAMERA, seconds=0.6)
        renderer.release()
        return picture

    return draw


def _poses(seconds: float) -> list:
    axis_angle, root = dance(seconds)
    return [(axis_angle, root), (0.4 * axis_angle, root + [0.9, 0.0, -0.3], doing(jawOpen=0.8, eyeBlinkLeft=0.5))]


def measured(context: Context) -> np.ndarray:
    """The measuring rasteriser: bits of triangle, barycentric coordinates and depth, as bytes."""
    person = mannequin()
    rasteriser = Rasteriser(context)
    level, camera = person.levels[0], orbit_camera((0, 0, 0), 2.5, 0.4, 0.1, SIZE)
    found = rasteriser.draw(level.positions.astype(float), level.faces.astype(np.int64), camera)
    rasteriser.release()
    near = np.where(np.isfinite(found.depth), found.depth, 0)[..., None]
    return np.round(255 * np.concatenate([found.barycentric, near / 4, found.face[..., None] % 2], -1)).astype(np.uint8)


def drawn_on(context: Context, draw: Callable[[], None]) -> np.ndarray:
    """What a drawing leaves on a transparent image."""
    colors = context.gl.renderbuffer(SIZE, 4)
    image = context.gl.framebuffer([colors])
    image.use()
    image.clear()
    draw()
    pixels = np.frombuffer(image.read(components=4), np.uint8).reshape(*SIZE[::-1], 4).copy()
    context.leave_framebuffer()
    image.release()
    colors.release()
    return pixels


def pattern() -> np.ndarray:
    y, x = np.mgrid[:64, :64]
    return np.stack([4 * x, 4 * y, 128 + 100 * np.sin(0.2 * x) * np.cos(0.3 * y)], -1).astype(np.uint8)


def filmed(context: Context) -> np.ndarray:
    """A picture of the window, its lens undone, and a box of one colour."""
    layer = PictureLayer(context)
    K = np.array([[60.0, 0.5, 31], [0, 62, 33], [0, 0, 1]])
    layer.show(pattern(), Camera(K, np.eye(4), (64, 64), np.array([-0.2, 0.05, 0.01, -0.02, 0.01])))

    def draw() -> None:
        layer.draw((5, 5, 110, 120), SIZE)
        layer.fill((0.2, 0.5, 0.7), (100, 90, 50, 60), SIZE)

    pixels = drawn_on(context, draw)
    layer.release()
    return pixels


def panels(context: Context) -> np.ndarray:
    """Triangles as the panels draw them."""
    gl = context.gl
    program = compile_program(gl, "gui.vert", "gui.frag")
    set_uniforms(program, window=(3.0, 5.0, 120.0, 110.0), picture=0)
    corners = np.array([[10, 10, 0, 0, 1, 0.5, 1, 0.9], [115, 20, 1, 0, 0.3, 1, 1, 0.6], [50, 105, 0.5, 1, 1, 1, 0, 1]])
    texture, buffer = gl.texture((64, 64), 3, pattern().tobytes()), gl.buffer(corners.astype("f4").tobytes())
    array = gl.vertex_array(program, [(buffer, "2f4 2f4 4f4", "position", "uv", "color")])

    def draw() -> None:
        gl.enable_only(0)
        texture.use(0)
        array.render(moderngl.TRIANGLES)

    pixels = drawn_on(context, draw)
    for one in (array, buffer, texture, program):
        one.release()
    return pixels


DRAWINGS: dict[str, Drawing] = {
    "bare": scene(replace(PLAIN, view="off")),
    "view linear": scene(replace(PLAIN, view="linear")),
    "view vertex": scene(replace(PLAIN, view="vertex")),
    "view network": scene(replace(PLAIN, view="network")),
    "everything": scene(EVERYTHING, Background("hdr", path=str(SKY))),
    "soft light": scene(replace(PLAIN, view="off", light=Light("lamps"), ground=Ground(), contact=Contact())),
    "capture's light": scene(replace(PLAIN, view="vertex", light=Light(), skinning="dual_quaternion")),
    "rasteriser": measured,
    "picture": filmed,
    "panels": panels,
}


@contextmanager
def noted() -> Iterator[tuple[set[str], list[tuple[str, str]]]]:
    """Names of the shader files that are read in this block, and the stages that are compiled."""
    names: set[str] = set()
    stages: list[tuple[str, str]] = []
    read, program = player.gl.shader.shader_source, moderngl.Context.program

    def shader_source(name, generated=None):
        names.add(name)
        return read(name, generated)

    def compiled(self, *, vertex_shader, fragment_shader, **more):
        stages.append((vertex_shader, fragment_shader))
        return program(self, vertex_shader=vertex_shader, fragment_shader=fragment_shader, **more)

    with (patch.object(player.gl.shader, "shader_source", shader_source),
          patch.object(moderngl.Context, "program", compiled)):  # fmt: skip
        yield names, stages


def difference(context: Context, name: str, plan: Plan, plain: np.ndarray) -> np.ndarray:
    """Of a drawing whose shaders are rewritten from `plain`, the larger of its channels, in levels."""
    with rewriting(plan):
        drawn = DRAWINGS[name](context)
    return np.abs(drawn.astype(int) - plain).max(-1)


def kept(out: Path, name: str, plan: Plan, stages: Sequence[tuple[str, str]]) -> None:
    """The stages of a drawing that changed, as they were compiled."""
    folder = out / f"{name} {'+'.join(plan.names)} {plan.seed}".replace(" ", "-")
    folder.mkdir(parents=True, exist_ok=True)
    for number, (vertex, fragment) in enumerate(stages):
        (folder / f"{number}.vert").write_text(vertex)
        (folder / f"{number}.frag").write_text(fragment)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*")
    parser.add_argument("--rounds", type=int, default=3, help="seeds")
    parser.add_argument("--seed", type=int, default=0, help="the first")
    parser.add_argument("--context", default="auto")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/rewrites"))
    asked = parser.parse_args()
    chosen = [name for name in DRAWINGS if not asked.words or any(word in name for word in asked.words)]
    changed, seen = 0, set()
    rows = {name: (name,) for name in REWRITES} | {"all ten": tuple(REWRITES)}
    with open_context(asked.context) as context:
        with noted() as (names, _):
            plain = {name: DRAWINGS[name](context) for name in chosen}
            seen |= names
        print(f"{context.renderer} ({context.kind}), {len(chosen)} drawings, {asked.rounds} seeds")
        for row, rewrites in rows.items():
            worst, beyond, sites = 0, 0.0, 0
            for name in chosen:
                for seed in range(asked.seed, asked.seed + asked.rounds):
                    plan = Plan(rewrites, seed)
                    with noted() as (_, stages):
                        apart = difference(context, name, plan, plain[name])
                    worst, sites = max(worst, int(apart.max())), sites + plan.sites
                    beyond = max(beyond, float((apart > 1).mean()))
                    if apart.max() > 1:
                        changed += 1
                        kept(asked.out, name, plan, stages)
                        print(f"  {name}, seed {seed}: {apart.max()}/255, {100 * (apart > 1).mean():.3f} % of pixels")
            print(f"{row}: {sites} places, worst {worst}/255, {100 * beyond:.3f} % of pixels beyond 1", flush=True)
    missing = sorted({path.name for kind in ("glsl", "vert", "frag") for path in SHADERS.glob(f"*.{kind}")} - seen)
    if missing and not asked.words:
        print(f"in no drawing: {missing}")
    return int(changed > 0 or (bool(missing) and not asked.words))


if __name__ == "__main__":
    sys.exit(main())
