"""One avatar under inspection: what its sections share, and what they give."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from avatar.baked_avatar import Avatar, Level
from bench.inspect.drawing import Studio
from bench.inspect.page import Check, Section
from bench.inspect.views import standard_views
from player.context import Context


@dataclass
class Measured:
    """Distances to what only a run or a capture knows; None where they were not given."""

    field: Float[np.ndarray, "faces"] | None  # millimetres, signed, per triangle
    truth: Float[np.ndarray, "vertices"] | None  # millimetres, per vertex


@dataclass
class Inspection:
    """What the page shows and what the JSON holds."""

    checks: list[Check]
    sections: list[Section]
    facts: dict[str, Any]


class Inspector:
    """One avatar, drawn topic by topic; `size` is the side of the large views in pixels."""

    def __init__(self, avatar: Avatar, path: Path, context: Context, measured: Measured, size: int):
        self.avatar, self.path, self.context, self.measured = avatar, path, context, measured
        self.level, self.size = avatar.levels[0], size
        self.views = standard_views(avatar, size)
        self.studio: Studio | None = None
        self.checks: list[Check] = []
        self.facts: dict[str, Any] = {"format": "selfscan-inspection", "version": 1, "avatar": path.name}

    def draw(self, colors: UInt8[np.ndarray, "n 3"], level: Level | None = None, **lines: Any) -> np.ndarray:
        level = self.level if level is None else level
        if self.studio is None:
            self.studio = Studio(self.views, self.context.kind)
        return self.studio.draw(level.positions.astype(np.float64), level.faces.astype(np.int64), colors, **lines)

    def check(self, what: str, value: str, expected: str, good: bool | None) -> None:
        self.checks.append(Check(what, value, expected, good))

    def release(self) -> None:
        if self.studio is not None:
            self.studio.release()
