"""docs/scene.schema.json and the tables of docs/scenes.md, written from the dataclasses:
`python -m player.scenes.scene_schema`.

A test holds the files against this module, so they cannot fall behind what is read.
"""

import json
import re
from dataclasses import MISSING
from pathlib import Path
from typing import Any, get_args, get_origin

from avatar.files import whole_file
from avatar.settings import Above, AtLeast, Color, OneOf, Setting, settings_of
from player.passes.background import Background
from player.scenes.effects import STUDIO, Effects
from player.scenes.scene import SceneAvatar, SceneCamera, keys_outside_tables

DOCS = Path(__file__).parents[2] / "docs"
TABLES = {"avatar": SceneAvatar, "camera": SceneCamera, "background": Background, "effects": Effects}
HEADINGS = {
    "avatar": "[[avatar]]",
    "camera": "[[camera]]",
    "background": "[background]",
    "effects": "[effects]",
}
JSON_TYPES = {str: "string", float: "number", int: "integer", bool: "boolean"}
WORDS = {str: "string", float: "number", int: "whole number", bool: "true, false"}


def scene_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a scene file, as editors read it."""
    properties = {setting.name: _property(setting) for setting in keys_outside_tables()}
    for name, record in TABLES.items():
        one = _table(record)
        several = {"type": "array", "items": one}
        if name == "avatar":
            several["minItems"] = 1
        properties[name] = several if HEADINGS[name].startswith("[[") else one
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A scene of selfscan",
        "type": "object",
        "properties": properties,
        "required": ["avatar"],
        "additionalProperties": False,
    }


def _table(record: type) -> dict[str, Any]:
    needed = [setting.name for setting in settings_of(record) if setting.default is MISSING]
    properties = {setting.name: _property(setting) for setting in settings_of(record)}
    return {"type": "object", "properties": properties, "additionalProperties": False} | (
        {"required": needed} if needed else {}
    )


def _property(setting: Setting) -> dict[str, Any]:
    out: dict[str, Any] = {"description": setting.means}
    if setting.table is not None:
        return _table(setting.table) | out
    if any(isinstance(rule, Color) for rule in setting.rules):
        return out | {"type": "string", "pattern": "^#[0-9a-fA-F]{6}([0-9a-fA-F]{2})?$", "default": _color(setting)}
    limits: dict[str, Any] = {}
    for rule in setting.rules:
        if isinstance(rule, OneOf):
            limits["enum"] = list(rule.values)
        elif isinstance(rule, Above):
            limits["exclusiveMinimum"] = rule.least
        elif isinstance(rule, AtLeast):
            limits["minimum"] = rule.least
    if get_origin(setting.type) is tuple:
        each = get_args(setting.type)
        one = {"type": JSON_TYPES[each[0]], **limits}
        out |= {"type": "array", "items": one, "minItems": len(each), "maxItems": len(each)}
    else:
        out |= {"type": JSON_TYPES[setting.type], **limits}
    if setting.default is not MISSING and setting.default is not None:
        out["default"] = list(setting.default) if isinstance(setting.default, tuple) else setting.default
    return out


def _color(setting: Setting) -> str:
    """The default of a color; what is transparent in memory is the studio's in a file."""
    color = setting.default if setting.default[3] else STUDIO.color
    return "#" + "".join(f"{round(255 * share):02x}" for share in color[:3])


def scene_table(name: str) -> str:
    """Keys of one table of the file, or with "" those outside all tables, as Markdown."""
    rows = ["| key | value | default | |", "|---|---|---|---|"]
    for setting in settings_of(TABLES[name]) if name else keys_outside_tables():
        rows.append(f"| `{setting.name}` | {_values(setting)} | {_default(setting)} | {setting.means} |")
        for inner in settings_of(setting.table) if setting.table is not None else ():
            key = f"{setting.name}.{inner.name}"
            rows.append(f"| `{key}` | {_values(inner)} | {_default(inner)} | {inner.means} |")
    return "\n".join(rows)


def _values(setting: Setting) -> str:
    if setting.table is not None:
        return "table"
    for rule in setting.rules:
        if isinstance(rule, OneOf):
            return ", ".join(rule.values)
        if isinstance(rule, Color):
            return "`#rrggbb`, `#rrggbbaa`"
    if get_origin(setting.type) is tuple:
        each = get_args(setting.type)
        return f"{len(each)} {WORDS[each[0]]}s in brackets"
    return WORDS[setting.type]


def _default(setting: Setting) -> str:
    if any(isinstance(rule, Color) for rule in setting.rules):
        return f"`{_color(setting)}`"
    if setting.default is MISSING:
        return "needed"
    if setting.default is None:
        return ""
    if isinstance(setting.default, bool):
        return f"`{str(setting.default).lower()}`"
    if isinstance(setting.default, tuple):
        return f"`[{', '.join(f'{value:g}' for value in setting.default)}]`"
    return f"`{setting.default:g}`" if isinstance(setting.default, float) else f"`{setting.default}`"


def with_tables(page: str) -> str:
    """The page with the table after each `<!-- keys of NAME -->` written anew."""
    pattern = re.compile(r"(<!-- keys of (\w*) -->\n)(?:\|[^\n]*\n)*")
    return pattern.sub(lambda match: match[1] + scene_table(match[2] if match[2] != "scene" else "") + "\n", page)


def main() -> None:
    """Write both files."""
    page = DOCS / "scenes.md"
    text = with_tables(page.read_text("utf-8"))
    with whole_file(page, "w") as file:
        file.write(text)
    with whole_file(DOCS / "scene.schema.json", "w") as file:
        file.write(json.dumps(scene_schema(), indent=1) + "\n")


if __name__ == "__main__":
    main()
