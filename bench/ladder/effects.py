"""What each effect costs on this machine (`selfscan bench --effects`): alone and all together, beside a bare frame.

Each case and the bare scene draw the same frames of a walk in turn; `times_bare` is the median of the ratios of
neighbours, so that a slow stretch of a shared machine falls on both. `cpu_times_bare` is the same of processor time,
all threads together: of a software rasteriser it holds on a busy machine too. Nothing is read back.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from avatar.face import SHAPES, FaceFrame
from avatar.motion.clip import Motion
from bench.ladder.machine import Quiet, times_of
from bench.report.sheet import save_sheet, sheet
from bench.report.writer import Json, markdown_table
from command.settings import settings_of
from files.whole import whole_folder, write_json, write_text
from player.draw.plan import PassState
from player.effects.ground import Ground
from player.effects.light import Light
from player.film.exposure import View, exposures
from player.gl.context import Context, open_context
from player.scene.effects import PLAIN, STUDIO, Effects
from player.scene.framing import extent, fitted_camera
from player.scene.motions import motion_for
from player.scene.renderer import Renderer
from player.scene.track import Track

SIZE = (640, 640)
# a case draws these frames of the walk, a second and a bit, again and again
FRAMES = range(10, 50, 2)
# one that is shown
SHOWN = 33
# radians: from a little to the side and above, so that the ground is seen
SIDE, ABOVE = 0.45, 0.18


@dataclass(frozen=True)
class Case:
    name: str
    effects: Effects
    # the same frame again and again
    still: bool = False
    # how many shapes of the face move, beside the eyes; 0: it rests after it has moved; None: it never does
    shapes: int | None = None


def cases(avatar: Avatar) -> list[Case]:
    """Each effect alone, some in two ways, and all of them together; a face that moves, where the avatar has one."""
    out, everything = [], replace(PLAIN, view="off", skinning="dual_quaternion", antialiasing="fxaa")
    bare = replace(PLAIN, view="off")
    for setting in settings_of(Effects):
        if setting.table is None:
            continue
        # the capture's light lights nothing where the file holds none
        wish = Light("lamps") if setting.table is Light else setting.table()
        everything = replace(everything, **{setting.name: wish})
        out.append(Case(setting.name.replace("_", " "), replace(bare, **{setting.name: wish})))
    shadow = replace(bare, ground=Ground("shadow"))
    out += [
        Case("ground: the shadow alone", shadow),
        Case("ground: the shadow alone, at rest", shadow, still=True),
        Case("dual quaternions", replace(bare, skinning="dual_quaternion")),
        Case("antialiasing: fxaa", replace(bare, antialiasing="fxaa")),
        Case("antialiasing: msaa", replace(bare, antialiasing="msaa")),
        Case("all, but for films' own", replace(everything, motion_blur=None, depth_of_field=None)),
        Case("everything", everything),
    ]
    faces = [Case("a face at rest", bare, shapes=0), Case("a face: 8 shapes and gaze", bare, shapes=8)]
    return out + (faces if avatar.eyes is not None else [])


def face_at(shapes: int, frame: int) -> FaceFrame:
    """So many shapes, and both eyes, on their way."""
    weights, share = np.zeros(len(SHAPES)), 0.5 + 0.4 * np.sin(frame)
    weights[:: len(SHAPES) // max(shapes, 1)][:shapes] = share
    return FaceFrame(weights, np.full((2, 2), 0.2 * share * (shapes > 0)))


class Drawn:
    def __init__(self, context: Context, avatar: Avatar, motion: Motion, case: Case, camera: Camera):
        self.track = Track(motion, joints=avatar.joint_positions, foot_lock=case.effects.foot_lock)
        self.case, self.camera, self.seconds = case, camera, 0.0
        self.renderer = Renderer(context, [avatar], camera.size, effects=case.effects, background=STUDIO)
        if case.shapes == 0:
            self.renderer.draw([self.track.pose(0)._replace(face=face_at(1, 0))], camera)

    def views(self, frame: int) -> list[View]:
        """What is drawn for one frame of a film."""
        if self.case.still:
            frame = SHOWN
        rate = self.track.motion.rate

        def view_at(share: float) -> View:
            seconds = frame / rate
            pose = self.track.pose_beside(seconds, share / rate) if share else self.track.pose(seconds)
            face = None if self.case.shapes is None else face_at(self.case.shapes, frame)
            return [pose._replace(face=face)], self.camera

        return exposures(self.case.effects, view_at, self.renderer.posers)

    def ms(self, frame: int) -> tuple[float, float]:
        """Of posing and drawing a frame, without reading it back: passed, and spent by processors."""
        target = self.renderer.target
        assert target is not None

        def draw() -> None:
            views = self.views(frame)
            self.move(frame)
            for poses, camera in views:
                self.renderer.draw_into(target, poses, camera)

        return times_of(self.renderer.context, draw)

    def move(self, frame: int) -> None:
        """Loose parts go on by one frame of 60 a second, to the pose that is drawn."""
        if self.renderer.moves:
            self.seconds += 1 / 60
            seconds = (SHOWN if self.case.still else frame) / self.track.motion.rate
            self.renderer.move([self.track.pose(seconds)], self.seconds)

    def picture(self) -> Array:
        for frame in range(SHOWN + 1):
            self.move(frame)
        return self.renderer.expose(self.views(SHOWN))[..., :3].copy()

    def passes(self) -> list[str]:
        """Those that drew in the picture."""
        return [one.item.name for one in self.renderer.drawn if one.decision.state in (PassState.RUNS, PassState.KEPT)]


def bench_effects(avatar: Avatar, out: Path, *, rounds: int = 20, size: tuple[int, int] = SIZE) -> Json:
    """Time every case, write effects.json, effects.md and effects.png into folder `out`."""
    with open_context() as context:
        motion = motion_for(avatar, "walking")
        points = extent(avatar, motion.read(FRAMES.start, FRAMES.stop))
        camera = fitted_camera(points, SIDE, size, elevation=ABOVE)
        bare = Drawn(context, avatar, motion, Case("bare", replace(PLAIN, view="off")), camera)
        reference, rows, pictures = bare.picture(), [], []
        base, base_passes = [], bare.passes()
        with Quiet() as quiet:
            for case in cases(avatar):
                drawn = Drawn(context, avatar, motion, case, camera)
                bare_ms, with_it = timed_in_turns(bare, drawn, rounds)
                base += bare_ms[:, 0].tolist()
                times = np.median(with_it / bare_ms, axis=0)
                pictures.append(drawn.picture())
                ran = [name for name in drawn.passes() if name not in base_passes]
                rows.append(
                    {
                        "name": case.name,
                        "ms": round(float(np.median(with_it[:, 0])), 3),
                        "times_bare": round(float(times[0]), 3),
                        "cpu_times_bare": round(float(times[1]), 3),
                        "bytes": drawn.renderer.plan.bytes - bare.renderer.plan.bytes,
                        "passes": len(ran),
                        "ran": ran,
                    }
                )
                drawn.renderer.release()
    result = {
        "format": "selfscan-bench-effects",
        **quiet.facts(context),
        "avatar": avatar.name,
        "triangles": len(avatar.levels[0].faces),
        "size": list(size),
        "rounds": rounds,
        "bare_ms": round(float(np.median(base)), 3),
        "effects": rows,
    }
    with whole_folder(out) as folder:
        write_json(folder / "effects.json", result)
        write_text(folder / "effects.md", effects_markdown(result))
        # pairs: the bare scene, and the scene with the effect
        titles = [["bare", f"{row['name']}, {row['times_bare']:.2f} x"] for row in rows]
        pairs = [[reference, picture] for picture in pictures]
        save_sheet(folder / "effects.png", sheet(pairs, titles, f"effects of {avatar.name}", columns=4))
    return result


def timed_in_turns(bare: Drawn, drawn: Drawn, rounds: int) -> tuple[Float[Array, "rounds 2"], Float[Array, "rounds 2"]]:
    """Milliseconds of neighbouring frames, bare and with the effect: passed, and spent by processors."""
    drawn.ms(SHOWN)
    pairs = []
    for number in range(rounds):
        frame = FRAMES[number % len(FRAMES)]
        # each draws another frame first, untimed: the caches hold its own
        other = FRAMES[(number + 3) % len(FRAMES)]
        bare.ms(other)
        before = bare.ms(frame)
        drawn.ms(other)
        pairs.append((before, drawn.ms(frame)))
    bare_ms, with_it = (np.array(part) for part in zip(*pairs, strict=True))
    return bare_ms, with_it


def effects_markdown(result: Json) -> str:
    """The table, and where it was measured."""
    facts = result["machine"]
    lines = [
        "# What each effect costs",
        "",
        f"{result['avatar']}, {result['triangles']} triangles, {' x '.join(map(str, result['size']))} pixels; "
        f"{facts['renderer']}; {facts['cpu']}, {facts['cores']} cores; load {facts['load_average']:.1f}; commit "
        f"{facts['commit']}. A bare frame takes {result['bare_ms']:.2f} ms; `times` is the median over "
        f"{result['rounds']} pairs of neighbouring frames, bare and with the effect. Nothing is read back. Bytes are "
        "those of GL memory beyond the bare scene's.",
        "",
    ]
    rows = [
        [row["name"], f"{row['ms']:.2f}", f"{row['times_bare']:.2f}", f"{row['cpu_times_bare']:.2f}",
         f"{row['bytes'] / 1e6:.2f}", str(row["passes"]), ", ".join(row["ran"])]
        for row in result["effects"]
    ]  # fmt: skip
    lines += markdown_table(["effect", "ms", "times bare", "processor time, times bare", "MB", "passes", "which"], rows)
    if result["warning"]:
        lines += ["", result["warning"]]
    return "\n".join([*lines, "", "![each effect: without it, and with it](effects.png)", ""])
