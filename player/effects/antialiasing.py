"""Smooth outlines in the way that suits the device."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from player.draw.plan import SAMPLES, Draft, Pass, Stage
from player.effects.fxaa import Fxaa
from player.effects.msaa import Msaa


@dataclass(frozen=True)
class BestAntialiasing:
    """MSAA on a GPU; on a software rasteriser, where MSAA costs more than twice as much, FXAA."""

    stage: ClassVar[Stage] = Stage.PICTURE

    def passes(self, draft: Draft) -> Sequence[Pass]:
        canvas = draft.canvas
        return (Fxaa() if canvas.software or canvas.max_samples < SAMPLES else Msaa()).passes(draft)
