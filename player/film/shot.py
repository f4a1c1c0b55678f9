"""Which frames to draw and all that decides them, as plain data that can be sent to another machine.

Every machine that opens a shot draws the same frames: cameras fitted to the whole film are part of it.
"""

import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from avatar.camera import Camera
from command.errors import AssetError
from command.interrupt import deferred_stop
from command.settings import with_files
from files.input_file import JsonObject
from player.budget.rung import Rung
from player.draw.drawing import Pose
from player.film.exposure import exposures
from player.film.film import Film, Frame
from player.film.stage import Fit, Stage
from player.gl.context import Context, open_context
from player.scene.renderer import Renderer
from player.scene.scene import Scene

FULL = Rung("as the file is", "auto")


@dataclass(frozen=True)
class Shot:
    """Frames start .. stop - 1 of a scene."""

    scene: Scene
    start: int
    stop: int
    size: tuple[int, int]
    rate: float
    # what fitted cameras look at
    fit: Fit | None
    hold: float | None = None  # the moment that a turntable holds still, seconds
    # what is drawn of the avatars: level of detail, textures, joints
    rung: Rung = FULL
    quality: str = "good"
    context: str = "auto"
    gpu: int | str | None = None

    def files(self) -> list[str]:
        names: list[str] = []
        with_files(replace(self.scene, cameras=self.scene.cameras[:1]), lambda name: names.append(name) or name)
        return sorted({name for name in names if Path(name).exists()})

    def identity(self) -> JsonObject:
        """This film's identity; parts of two films with one identity may be joined."""
        import av

        from player.film.parts import fingerprint

        return {
            "scene": asdict(self.scene),
            "files": {name: fingerprint(name) for name in self.files()},
            "size": self.size,
            "rate": self.rate,
            "hold": self.hold,
            "rung": [self.rung.level, self.rung.halvings, self.rung.joints],
            "encoder": f"PyAV {av.__version__}",
            "quality": self.quality,
        }


def with_whole_paths(scene: Scene) -> Scene:
    """The scene with absolute paths: a worker stands in another folder."""
    return with_files(scene, lambda name: str(Path(name).absolute()) if Path(name).exists() else name)


class ShotRenderer:
    """Draws the frames of a shot: its files are open and its renderer is made. It owns the context."""

    def __init__(self, shot: Shot, stage: Stage | None = None, context: Context | None = None):
        self.shot = shot
        if stage is None:
            stage = Stage(shot.scene, shot.rung.level + 1)
            if shot.hold is not None:
                stage.hold(shot.hold)
        self.stage = stage
        # the film's frame up to which loose parts have moved
        self._moved: int | None = None
        self.drawing = 0.0  # seconds spent in drawing frames of films
        self.camera_at = stage.camera_at(shot.fit, shot.start, shot.stop, shot.size)
        self.context: Context = open_context(shot.context, shot.gpu) if context is None else context
        self.context.warms = shot.stop - shot.start > 1
        try:
            with deferred_stop(patience=0) as stop:
                self.renderer = Renderer(
                    self.context, shot.rung.prepared(stage.avatars), shot.size, effects=shot.scene.effects,
                    background=shot.scene.background, level=shot.rung.level,
                )  # fmt: skip
            stop.check()
        except ValueError as error:
            self.context.release()
            raise AssetError(str(error)) from None
        except BaseException:
            self.context.release()
            raise

    def draw(self, frame: int, out: Frame | None = None) -> UInt8[np.ndarray, "height width 4"]:
        """A frame of the film.

        Raises:
            AssetError: its pose holds a number that is not finite.
        """
        effects, seconds = self.shot.scene.effects, frame / self.shot.rate
        self._move(frame)
        if effects.motion_blur is None and effects.depth_of_field is None:
            poses = self.stage.poses(frame)
            camera = self.camera_at(frame, poses[0].root)
            return self.renderer.draw(self.stage.faced(poses, frame, camera), camera, out, seconds=seconds)

        def view_at(share: float) -> tuple[list[Pose], Camera]:
            poses = self.stage.poses_beside(frame, share) if share else self.stage.poses(frame)
            at = frame + share if share else frame
            camera = self.camera_at(at, poses[0].root)
            return self.stage.faced(poses, at, camera), camera

        return self.renderer.expose(exposures(effects, view_at, self.renderer.posers), out, seconds=seconds)

    def _move(self, frame: int) -> None:
        """Loose parts move from the scene's first frame on, whichever frames are drawn: so a frame follows from its
        number, and a film in shares is the film. Frames that are passed over are simulated, not drawn."""
        if not self.renderer.moves:
            return
        first = 0 if self._moved is None or frame < self._moved else self._moved + 1
        for number in range(first, frame + 1):
            self.renderer.move(self.stage.poses(number), number / self.shot.rate)
        self._moved = frame

    def film(self, path: Path, frames: Iterable[int], pieces: Sequence[tuple[Path, int]] = ()) -> Film:
        """Draw these frames into a film, or into pieces of one; the film, written."""
        shot = self.shot
        with deferred_stop(patience=0) as stop, Film(
            path, shot.rate, transparent=shot.scene.background.transparent, quality=shot.quality, pieces=pieces
        ) as film:  # fmt: skip
            for frame in frames:
                canvas = film.canvas(shot.size)
                began = time.perf_counter()
                image = self.draw(frame, canvas)
                self.drawing += time.perf_counter() - began
                film.add(image)
                stop.check()
        # notes that arose while the film was finished
        stop.check()
        return film

    def __enter__(self) -> "ShotRenderer":
        return self

    def __exit__(self, *_error: object) -> None:
        self.release()

    def release(self) -> None:
        self.renderer.release()
        self.context.release()
