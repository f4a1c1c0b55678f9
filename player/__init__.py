"""Avatar file to pixels: contexts, shaders, the plan of passes, films and the window. Never imports torch.

The names below are the public ones of this package, each imported when it is asked for; docs/python.md shows them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from player.filming.render import render
    from player.motions import motion_for
    from player.offscreen import OffscreenRenderer
    from player.render_command import RenderCommand
    from player.scenes.effects import Background, Effects

_PUBLIC = {
    "motion_for": "player.motions",
    "OffscreenRenderer": "player.offscreen",
    "RenderCommand": "player.render_command",
    "render": "player.filming.render",
    "Background": "player.scenes.effects",
    "Effects": "player.scenes.effects",
}
__all__ = ["Background", "Effects", "OffscreenRenderer", "RenderCommand", "motion_for", "render"]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
