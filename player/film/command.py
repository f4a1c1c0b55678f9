"""`selfscan render`: avatars and a motion become a picture, frames or a film."""

from dataclasses import dataclass, field
from typing import Annotated

from command.command_line import Help, Option, parse
from command.settings import AtLeast, AtMost, OneOf
from player.budget.ladder import parse_budget
from player.effects.background import Background
from player.film.film import film_kind
from player.scene import arguments
from player.scene.arguments import CAMERA, FILM, LOOKS, MACHINE, QUALITIES, TIME, WHO
from player.scene.scene import FILM_RATES, TURNS

EXAMPLES = """examples
  selfscan render me.glb --motion counting -o counting.mp4
  selfscan render me.glb --motion walk.bvh --camera orbit --size 1280x720 -o walk.mp4
  selfscan render me.glb --motion walk.npz --frames 100:200 --background transparent -o frames/
  selfscan render me.glb --motion walk.npz --frame 12 --explain -o frame.png
  selfscan render me.glb --camera turntable --seconds 4 -o me.gif
  selfscan render --scene two.toml -o two.mp4
  selfscan render me.glb --motion counting --budget 8ms -o fast.mp4     the best that takes 8 ms a frame here
  selfscan render me.glb --motion long.npz -o long.mp4 --resume         goes on after a stop
  selfscan render me.glb --motion long.npz -o long.mp4 --workers 4      or tcp://SCHEDULER:8786

OUT is .png (one frame), .mp4, .webm, .mov, .gif, .webp, or a folder for PNG frames."""


@dataclass(frozen=True)
class RenderCommand:
    """`selfscan render`.

    Raises:
        ValueError: settings that exclude each other, or an output of an unknown kind.
    """

    output: Annotated[str, Option(("-o", "--output"), "OUT"), "picture, film or folder to write"]
    avatar: Annotated[tuple[str, ...], Option(positional=True, metavar="AVATAR", several=True),
        "avatar file (.glb), or builtin; several stand side by side"] = ()
    scene: Annotated[str | None, WHO, Option(metavar="FILE"), "scene file (.toml) instead of AVATAR, --motion"] = None
    motion: Annotated[str | None, WHO, Option(metavar="FILE"),
        "pose file (.npz, .pkl, .bvh, .glb, .json ...), folder of frames, or: counting, walking (default: "
        "T-pose)"] = None
    life: Annotated[int | None, WHO, AtLeast(0), Option(metavar="SEED", const=1),
        "it blinks, looks at the camera and breathes where nothing else moves its face; another number, other "
        "moments"] = None
    speech: Annotated[str | None, WHO, Option(metavar="FILE.wav"),
        "a voice that moves its mouth; the film stays silent"] = None
    frame: Annotated[int | None, FILM, AtLeast(0), Option(exclusive="which"),
        "only this frame; with a turntable, the one that is shown from all sides"] = None
    frames: Annotated[
        tuple[int | None, int | None] | None, FILM, "draw frames A to B-1",
        Option(metavar="A:B", parse=arguments.parse_frames, exclusive="which")
    ] = None
    camera: Annotated[str | None, CAMERA, Option(metavar="front|orbit|turntable|FILE"),
        "fitted to the avatar (default: front); a camera or a camera path (.json); cameras.npz or the folder of a "
        "capture, CAPTURE:head for its head video"] = None
    seconds: Annotated[float | None, CAMERA.rare, AtLeast(TURNS[0]), AtMost(TURNS[1]), Option(metavar="S"),
        "one turn of orbit (default: the film) or turntable (6)"] = None
    size: Annotated[tuple[int, int] | None, FILM, AtLeast(1), Option(metavar="WxH", parse=arguments.parse_size),
        "pixels (default: the camera file's, else 640x640)"] = None
    background: Annotated[
        Background | None, LOOKS, Option(metavar="#rrggbb|transparent|FILE", parse=arguments.parse_background),
        "colour (default #2b2d33), nothing, a picture, film or panorama (.hdr)"
    ] = None
    rate: Annotated[float | None, FILM.rare, AtLeast(FILM_RATES[0]), AtMost(FILM_RATES[1]), Option(metavar="HZ"),
        "frames a second of the film (default: the motion's, halved, cut to a third ... where that is above 60)"] = None
    effects: arguments.EffectsOption = field(default_factory=dict)
    quality: Annotated[str, TIME, OneOf(QUALITIES),
        "draft: level 2, paper colours, jagged edges, small file; best: the avatar's own view model per pixel, MSAA, "
        "large file; single options go before it"] = "good"
    budget: Annotated[float | None, TIME, Option(metavar="8ms", parse=parse_budget),
        "view mode and mesh are the most exact whose frames take no longer (p95), as measured on this machine once and "
        "kept; or 120fps"] = None
    level: Annotated[int | None, TIME.rare, AtLeast(0), AtMost(99), "level of detail, 0 the finest"] = None
    body: Annotated[arguments.BodyOption, WHO.rare] = None
    hands: Annotated[arguments.HandsOption, WHO.rare] = "file"
    ground: Annotated[arguments.GroundOption, WHO.rare] = "auto"
    resume: Annotated[bool, FILM.rare, "go on with the parts that an earlier run of this film left"] = False
    workers: Annotated[str | None, FILM.rare, Option(metavar="ADDRESS|N", parse=arguments.parse_workers),
        "draw on a Dask cluster, or on N processes of this machine"] = None
    context: Annotated[str, MACHINE.rare, OneOf(("auto", "egl", "osmesa")), "how to reach OpenGL"] = "auto"
    gpu: Annotated[int | str | None, MACHINE.rare, Option(metavar="N|NODE", parse=arguments.parse_gpu),
        "this GPU only, counted as CUDA counts, or its DRM node, as /dev/dri/renderD128"] = None
    explain: Annotated[bool, TIME, "print which passes ran, why, and what each costs"] = False
    json: Annotated[str | None, TIME.rare, Option(metavar="FILE"), "write what --explain prints to a file"] = None

    def __post_init__(self):
        picture = film_kind(self.output) == ".png"
        own = self.motion or self.body or self.speech or (self.hands, self.ground, self.life) != ("file", "auto", None)
        refusals = {
            "give --budget or --quality": self.budget is not None and self.quality != "good",
            "--budget asks this machine: for several, give --view and --level": self.budget and self.workers,
            "--json writes what --explain finds: give both": self.json and not self.explain,
            "a .png holds one frame: give --frame N, or another OUT": picture and self.frames,
            "--rate is of a film; a .png holds one frame": picture and self.rate,
            "--workers share the frames of a film; a .png holds one": picture and self.workers,
            "--explain asks the context that drew: leave --workers out": self.explain and self.workers,
            "give AVATAR or --scene, one of them": bool(self.scene) == bool(self.avatar),
            "--motion, --life, --speech, --body, --hands and --ground are in the scene file": self.scene and own,
        }  # fmt: skip
        for why, refused in refusals.items():
            if refused:
                raise ValueError(why)


DRAWS = "Draw an avatar in motion: a picture, frames or a film. Needs no GPU and no display."
RENDER = Help("selfscan render", DRAWS, EXAMPLES)


def render_main(argv: list[str]) -> int:
    """Draw a picture, frames or a film."""
    command = parse(RenderCommand, argv, RENDER)
    from player.film.render import render

    render(command)
    return 0
