"""The plan of a scene: what each effect that it asks for needs, from the last in a frame to the first."""

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

from avatar.baked_avatar import Avatar
from player.draw.plan import Absent, Canvas, Draft, Effect, Pass, Plan, Stage, close_all
from player.effects.avatar import Avatars
from player.effects.background import Background
from player.scene.effects import Effects


def resolve(
    avatars: Sequence[Avatar],
    canvas: Canvas,
    effects: Effects,
    background: Background = Background("transparent"),  # noqa: B008  frozen
    detail: int | Sequence[int] = 0,
    kept: Mapping[Hashable, Any] | None = None,
) -> Plan:
    """The plan for drawing `avatars` with these effects, all at one level of detail or each at its own. Makes no GL
    object; opens the background's file, unless `kept` (of an earlier plan) holds it.

    Raises:
        ValueError: a view mode that an avatar does not hold.
        AssetError: a file that cannot be read.
    """
    kept, levels = kept or {}, [detail] * len(avatars) if isinstance(detail, int) else detail
    wanted: list[tuple[Stage, Effect | Absent]] = [
        (Stage.BACKGROUND, background),
        (Stage.AVATARS, Avatars(effects.view)),
    ]
    for fact, stage, effect in effects.effects():
        wanted.append((stage, Absent(fact.name.replace("_", " ")) if effect is None else effect))
    wanted.sort(key=lambda one: one[0])
    draft = Draft(
        avatars, canvas, detail=levels, dual=effects.skinning == "dual_quaternion",
        effects=[one for _, one in wanted if not isinstance(one, Absent)], kept=kept,
    )  # fmt: skip
    stages: list[tuple[Stage, Sequence[Pass]]] = []
    try:
        for stage, one in reversed(wanted):
            stages.append((stage, [one] if isinstance(one, Absent) else one.passes(draft)))
    except BaseException:
        close_all([one for key, one in draft.kept.items() if key not in kept])
        raise
    return draft.result(stages[::-1])
