"""The effects that a scene can ask for: one line each, from which everything that names effects is read.

A line is a field of `Effects`: its type or its `Makes` names the settings of a file in player/effects/, its notes are
its rules and its documentation. A field of such a type is a table of the scene, None where it is not asked for.
Scene files, their schema and tables, `--effect NAME`, `--explain` and the window's panel follow from the fields. What
is not asked for is in no plan and costs nothing.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, NamedTuple

from avatar.baked_avatar import Avatar
from command.settings import OneOf, Setting, rule_of, settings, settings_of
from player.draw.plan import Absent, Canvas, Draft, Effect, Kept, Pass, Plan, Stage, close_all
from player.effects.antialiasing import BestAntialiasing, Fxaa, Msaa
from player.effects.avatar import VIEWS, Avatars
from player.effects.background import Background
from player.effects.contact import Contact
from player.effects.foot_lock import FootLock
from player.effects.grid import Grid
from player.effects.ground import Ground
from player.effects.lens import DepthOfField, MotionBlur
from player.effects.light import Light
from player.effects.outline import Outline
from player.effects.secondary_motion import SecondaryMotion

SKINNINGS = ("lbs", "dual_quaternion")
ANTIALIASINGS = ("auto", "none", "fxaa", "msaa")


class Makes(NamedTuple):
    """Words of a field that ask for an effect; the field's other words ask for none."""

    of: Mapping[str, type[Effect]]


@settings
class Effects:
    """How avatars are drawn."""

    view: Annotated[str, OneOf(("auto", *VIEWS)),
        "view dependence: off is the paper; auto picks by avatar and device"] = "auto"
    skinning: Annotated[str, OneOf(SKINNINGS),
        "linear blend, or dual quaternions, which keep volume where joints twist"] = "lbs"
    antialiasing: Annotated[str, OneOf(ANTIALIASINGS), Makes({"auto": BestAntialiasing, "fxaa": Fxaa, "msaa": Msaa}),
        "smooth outlines: fxaa filters them in the finished picture, msaa takes 4 samples a pixel; auto is msaa on a "
        "GPU and fxaa on a software rasteriser"] = "auto"
    light: Annotated[Light | None,
        "avatars lit anew, not in the colors they were filmed in: by the capture's light, none, or lamps"] = None
    ground: Annotated[Ground | None, "a floor to stand on, and the shadow on it"] = None
    contact: Annotated[Contact | None, "dark where feet touch the ground and limbs come near the body"] = None
    foot_lock: Annotated[FootLock | None, "feet of motions that slide are held where they stand"] = None
    grid: Annotated[Grid | None, "lines on the ground, every metre"] = None
    outline: Annotated[Outline | None, "a line round each avatar, and where its limbs pass before it"] = None
    motion_blur: Annotated[MotionBlur | None, "what moves is blurred, in films"] = None
    depth_of_field: Annotated[DepthOfField | None, "what is nearer or farther than the focus is blurred, in films"] = (
        None
    )
    secondary_motion: Annotated[SecondaryMotion | None,
        "hair, skirts and sleeves swing, where the avatar's file says what is loose"] = None

    def effects(self) -> Iterator[tuple[Setting, Stage, Effect | None]]:
        """Every field that can ask for an effect: where in a frame it draws, and what it asks for."""
        for setting in settings_of(Effects):
            value, makes = setting.value_in(self), rule_of(setting, Makes)
            if makes is not None:
                stage = next(iter(makes.of.values())).stage
                yield setting, stage, makes.of[value]() if value in makes.of else None
            elif setting.table is not None:
                yield setting, setting.table.stage, value


# where a scene says nothing
USUAL = Effects()
# nothing beside the avatars: what is measured
PLAIN = Effects(antialiasing="none")
# where a scene says nothing
STUDIO = Background()


def resolve(
    avatars: Sequence[Avatar], canvas: Canvas, effects: Effects,
    background: Background = Background("transparent"),  # noqa: B008  frozen
    detail: Sequence[int] = (), kept: Kept | None = None, faces: frozenset[int] = frozenset(),
) -> Plan:  # fmt: skip
    """The plan for drawing `avatars` with these effects, asked from the last in a frame to the first; each at its
    level of detail, the finest where none are named; `faces` are those whose face has moved. Makes no GL object; opens
    the background's file, unless `kept` (of an earlier plan) holds it.

    Raises:
        ValueError: a view mode that an avatar does not hold.
        AssetError: a file that cannot be read.
    """
    kept, levels = kept or {}, detail or [0] * len(avatars)
    wanted: list[tuple[Stage, Effect | Absent]] = [(Stage.BACKGROUND, background)]
    wanted.append((Stage.AVATARS, Avatars(effects.view)))
    for fact, stage, effect in effects.effects():
        wanted.append((stage, Absent(fact.name.replace("_", " ")) if effect is None else effect))
    wanted.sort(key=lambda one: one[0])
    draft = Draft(
        avatars, canvas, detail=levels, dual=effects.skinning == "dual_quaternion",
        effects=[one for _, one in wanted if not isinstance(one, Absent)], kept=kept, faces=faces,
    )  # fmt: skip
    stages: list[tuple[Stage, Sequence[Pass]]] = []
    try:
        for stage, one in reversed(wanted):
            stages.append((stage, [one] if isinstance(one, Absent) else one.passes(draft)))
    except BaseException:
        close_all([one for key, one in draft.kept.items() if key not in kept])
        raise
    return draft.result(stages[::-1])
