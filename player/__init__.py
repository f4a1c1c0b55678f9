"""Avatar file to pixels: contexts, shaders, the plan of passes, films and the window. Never imports torch.

The names below are the public ones of this package, each imported when it is asked for; docs/python.md shows them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from player.film.command import RenderCommand
    from player.film.render import render
    from player.scene.effects import Background, Effects
    from player.scene.motions import motion_for
    from player.scene.offscreen import OffscreenRenderer

_PUBLIC = {
    "motion_for": "player.scene.motions",
    "OffscreenRenderer": "player.scene.offscreen",
    "RenderCommand": "player.film.command",
    "render": "player.film.render",
    "Background": "player.scene.effects",
    "Effects": "player.scene.effects",
}
__all__ = ["Background", "Effects", "OffscreenRenderer", "RenderCommand", "motion_for", "render"]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
