"""A scene: avatars with their motions, cameras, background and effects. Read from scene.toml, or made of options.

docs/scenes.md documents the file. Fields here are keys there, `avatars` as [[avatar]], `cameras` as [[camera]].
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

from avatar.camera import FARTHEST
from avatar.gltf.avatar_file import BUILTIN
from avatar.motion.hands import HANDS
from avatar.motion.read import BUILTIN_MOTIONS
from command.settings import AtLeast, AtMost, FilePlace, OneOf, Rows, settings
from player.effects.background import Background
from player.scene.address import FACE_SENDERS, PORTS, parse_address
from player.scene.effects import STUDIO, USUAL, Effects

# where the ground of a motion is: avatar/motion/ground.py
GROUNDS = ("auto", "find", "keep")
# cameras that are fitted to the avatars, or placed by `eye` and `target`
FITTED = ("front", "follow", "orbit", "turntable")
CAMERAS = (*FITTED, "file", "path", "capture")
# a film's frames per second and a round's seconds: beyond them containers of films count wrong
FILM_RATES, TURNS = (0.01, 1000.0), (0.01, 86_400.0)
MOST_AVATARS = 256
SPACING = 1.0  # metres between several avatars, side by side
# that travel with the program: a person as `make demo` makes him, and the free body without one
MANNEQUINS = ("mannequin", "mannequin:female")
BUILTIN_AVATARS = (BUILTIN, *MANNEQUINS)


@settings
class SceneAvatar:
    """One avatar on stage."""

    path: Annotated[str, FilePlace(BUILTIN_AVATARS),
        "avatar file (.glb); builtin: a person that travels with the program; mannequin, mannequin:female: a body"]
    motion: Annotated[str | None, FilePlace(BUILTIN_MOTIONS),
        "pose file, folder of frames, counting or walking; none: T-pose"] = None
    live: Annotated[str | None,
        "vmc:PORT, udp:PORT or ws:PORT, instead of a motion (play only); a face alone, also beside one: "
        "ifacialmocap:PORT, livelinkface:PORT, openseeface:PORT"] = None
    at: Annotated[tuple[float, float, float], AtLeast(-FARTHEST), AtMost(FARTHEST),
        "metres, added to where the motion puts it"] = (0.0, 0.0, 0.0)
    turn_deg: Annotated[float, "about the vertical through the world's origin, before `at`"] = 0.0
    hands: Annotated[str, OneOf(HANDS), "the motion's hands; mean needs `body`"] = "file"
    ground: Annotated[str, OneOf(GROUNDS),
        "find: the motion is moved so that the soles touch the ground; keep: the file's heights; auto: keep before "
        "cameras that were measured (file, capture), else find"] = "auto"
    body: Annotated[str | None, FilePlace(), "SMPL+H model (.npz, .pkl) that the pose file was made for"] = None
    start: Annotated[float, AtLeast(0), AtMost(1e9), "seconds into the motion at which the scene begins"] = 0.0
    life: Annotated[int | None, AtLeast(0),
        "it blinks, looks at the camera and breathes where nothing else moves its face; a number picks when"] = None
    speech: Annotated[str | None, FilePlace(), "a voice (.wav) that moves its mouth; the film stays silent"] = None

    def __post_init__(self):
        kind = None
        if self.live is not None:
            try:
                kind = parse_address(self.live, tuple(PORTS)).kind
            except ValueError as error:
                raise ValueError(f"live: {error}") from None
        if self.motion is not None and kind is not None and kind not in FACE_SENDERS:
            raise ValueError("motion and live: expected one of them, found both")


def side_by_side(
    paths: Sequence[str],
    motions: Sequence[str | None],
    places: Sequence[tuple[float, float, float, float]] = (),
    *,
    like: SceneAvatar,
) -> tuple[SceneAvatar, ...]:
    """Avatars like one, beside one another, or each at its x, y, z and turned by degrees; one motion for all or one
    for each."""
    left = -0.5 * SPACING * (len(paths) - 1)
    places = places or [(left + SPACING * k, 0.0, 0.0, 0.0) for k in range(len(paths))]
    motions = motions if len(motions) > 1 else [motions[0]] * len(paths)
    return tuple(
        replace(
            like, path=path, motion=motion, at=(x, y, z), turn_deg=turn,
            life=None if like.life is None else like.life + k,
        )
        for k, (path, motion, (x, y, z, turn)) in enumerate(zip(paths, motions, places, strict=True))
    )


@settings
class SceneCamera:
    """One camera. Render uses the first, play switches between them."""

    kind: Annotated[str, OneOf(CAMERAS),
        "front, follow (along with the first avatar), orbit (and round it) and turntable are fitted to the avatars; "
        "the others need a path"] = "front"
    path: Annotated[str | None, FilePlace(),
        "of file: a camera; of path: keys of a camera path; of capture: its folder"] = None
    name: Annotated[str | None, "what the window calls it; of capture, the part: body, head, hand_left, hand_right"] = (
        None
    )
    seconds: Annotated[float | None, AtLeast(TURNS[0]), AtMost(TURNS[1]),
        "of orbit and turntable: one round; none: the length of the motion"] = None
    fov_deg: Annotated[float | None, AtLeast(0.01), AtMost(175),
        "of the fitted cameras: vertical field of view; none: 35"] = None
    eye: Annotated[tuple[float, float, float] | None,
        "instead of fitting: where the camera stands when the scene begins, metres; with `target`"] = None
    target: Annotated[tuple[float, float, float] | None, "and what it looks at"] = None

    def __post_init__(self):
        needs_file = self.kind in ("file", "path", "capture")
        if needs_file != (self.path is not None):
            need = "needs a path" if needs_file else f"takes no path, has {self.path!r}"
            raise ValueError(f"camera {self.kind} {need}")
        if (self.eye is None) != (self.target is None) or (needs_file and self.eye is not None):
            raise ValueError("eye: expected with target, for a camera without a path")
        if self.eye is not None and self.eye == self.target:
            raise ValueError(f"eye: expected another place than target, found {self.eye}")


@settings
class Scene:
    """Everything that render and play show."""

    avatars: Annotated[tuple[SceneAvatar, ...], Rows("avatar", 1, MOST_AVATARS), "who is on stage, one [[avatar]] each"]
    cameras: Annotated[tuple[SceneCamera, ...], Rows("camera", 0, MOST_AVATARS),
        "where from, one [[camera]] each; none: front"] = (SceneCamera(),)
    background: Annotated[Background, "what is behind them"] = STUDIO
    effects: Annotated[Effects, "how they are drawn"] = USUAL
    size: Annotated[tuple[int, int] | None, AtLeast(1),
        "width and height, pixels; none: the camera file's, else 640 x 640"] = None
    rate: Annotated[float | None, AtLeast(FILM_RATES[0]), AtMost(FILM_RATES[1]),
        "frames per second; none: the first motion's"] = None
