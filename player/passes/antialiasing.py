"""Smooth outlines in the way that suits the device."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from player.passes.fxaa import Fxaa
from player.passes.msaa import Msaa
from player.plan import SAMPLES, Draft, Pass, Stage


@dataclass(frozen=True)
class BestAntialiasing:
    """MSAA on a GPU; on a software rasteriser, where MSAA costs more than twice as much, FXAA."""

    stage: ClassVar[Stage] = Stage.PICTURE

    def passes(self, draft: Draft) -> Sequence[Pass]:
        canvas = draft.canvas
        return (Fxaa() if canvas.software or canvas.max_samples < SAMPLES else Msaa()).passes(draft)
