"""Effects in plain words: looks that set light, floor, edges and background at once, and the choices of each effect.

What stands behind a word is the effect's own record of settings; a panel that unfolds shows the numbers.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from command.settings import RGBA, Setting, color_of
from player.effects.background import Background
from player.effects.contact import Contact
from player.effects.foot_lock import FootLock
from player.effects.ground import Ground
from player.effects.lens import DepthOfField, MotionBlur
from player.effects.light import Light
from player.effects.outline import Outline
from player.effects.secondary_motion import SecondaryMotion
from player.scene.effects import STUDIO, Effects


def color(text: str) -> RGBA:
    """#rrggbb."""
    found = color_of(text)
    assert found is not None, text
    return found


class Look(NamedTuple):
    """What is set at once; all other effects stay."""

    means: str
    background: Background
    light: Light | None
    ground: Ground
    contact: Contact = Contact()

    def of(self, effects: Effects, background: Background) -> tuple[Effects, Background]:
        """Effects and background with this look. A panorama stays, and lights what was to be lit outdoors."""
        light, ground, behind = self.light, self.ground, self.background
        if background.kind == "hdr" and self is LOOKS["Outdoors"]:
            light, ground, behind = Light(by="panorama"), replace(ground, kind="shadow"), background
        changed = replace(effects, light=light, ground=ground, contact=self.contact, antialiasing="auto", outline=None)
        return changed, behind


SOFT = Light(by="lamps", ambient=0.72, direction=(0.5, 0.7, 0.6), strength=0.38)
LOW_SUN = Light(
    by="lamps", ambient=0.42, direction=(0.85, 0.38, 0.45), strength=0.8, second_direction=(-0.8, 0.3, -0.3),
    second_strength=0.2,
)  # fmt: skip
DAYLIGHT = Light(
    by="lamps", ambient=0.6, direction=(0.4, 0.85, 0.45), strength=0.6, second_direction=(0.0, 1.0, 0.0),
    second_strength=0.15,
)  # fmt: skip
SPOTLIGHT = Light(
    by="lamps", ambient=0.48, direction=(0.25, 0.75, 0.6), strength=0.7, second_direction=(-0.6, 0.5, -0.65),
    second_strength=0.45, highlight=0.08,
)  # fmt: skip
EARTH = Ground(color=color("#6b5450"), strength=0.75, softness=1.0)
STONE = Ground(color=color("#a09d90"), radius=20.0, strength=0.55)
BOARDS = Ground(color=color("#3a3436"), radius=3.0, strength=0.85, softness=3.0)
LOOKS = {
    "Studio": Look("A grey room; people as they were filmed.", STUDIO, None, Ground()),
    "Evening": Look("A low sun from the side and long shadows.", Background(color=color("#2a2230")), LOW_SUN, EARTH),
    "Outdoors": Look(
        "Daylight under an open sky; a panorama that was opened stays, and is the light.",
        Background(color=color("#b4cbe0")), DAYLIGHT, STONE,
    ),
    "Stage": Look("A spotlight in the dark.", Background(color=color("#0a0a0d")), SPOTLIGHT, BOARDS),
}  # fmt: skip

# what the window calls an effect, where its field has another name
LABELS = {
    "view": "shine", "skinning": "joints", "antialiasing": "edges", "ground": "floor", "contact": "contact shadow",
    "foot_lock": "feet", "secondary_motion": "hair and cloth",
}  # fmt: skip
# the choices of an effect: a word and what it stands for; None is off
CHOICES: Mapping[str, Mapping[str, object]] = {
    "view": {
        "auto": "auto", "matte": "off", "quick shine": "vertex", "fine shine": "linear", "finest shine": "network",
    },
    "skinning": {"usual": "lbs", "keep volume": "dual_quaternion"},
    "antialiasing": {"auto": "auto", "rough": "none", "smooth": "fxaa", "smoothest": "msaa"},
    "light": {
        "as filmed": None, "soft": SOFT, "low sun": LOW_SUN, "daylight": DAYLIGHT, "spotlight": SPOTLIGHT,
        "filming room's": Light(), "panorama's": Light(by="panorama"), "bare colors": Light(by="albedo"),
    },
    "ground": {
        "none": None, "grey": Ground(), "checks": Ground(kind="checker"), "earth": EARTH, "stone": STONE,
        "boards": BOARDS, "shadow alone": Ground(kind="shadow"),
    },
    "contact": {"none": None, "soft": Contact(strength=0.4), "strong": Contact()},
    "foot_lock": {"as they move": None, "held": FootLock(), "held firmly": FootLock(speed=0.7, farthest=0.3)},
    "outline": {"none": None, "thin": Outline(width=1.0), "usual": Outline(), "thick": Outline(width=4.0)},
    "motion_blur": {"none": None, "usual": MotionBlur(), "long": MotionBlur(shutter=1.0)},
    "depth_of_field": {"all sharp": None, "usual": DepthOfField(), "shallow": DepthOfField(lens=0.05)},
    "secondary_motion": {"stiff": None, "swing": SecondaryMotion(), "swing softly": SecondaryMotion(frequency=1.0)},
}  # fmt: skip
OWN = "own numbers"


def label_of(setting: Setting) -> str:
    """What the window calls an effect or a number of it."""
    return LABELS.get(setting.name, setting.name.replace("_", " "))


def choices_of(setting: Setting, value: object) -> tuple[list[str], list[object], int]:
    """Words, what they stand for, and which is chosen; a new effect is off or on, and has its usual settings."""
    table = setting.table
    known = dict(CHOICES.get(setting.name) or {"off": None, "on": None if table is None else table()})
    if value not in known.values():
        known[OWN] = value
    return [*known], [*known.values()], [*known.values()].index(value)
