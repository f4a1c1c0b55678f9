"""Scenes as data: scene.toml, effects and backgrounds; nothing here draws."""
