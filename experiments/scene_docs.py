"""docs/scene.schema.json and the tables of docs/scenes.md, written from the dataclasses:
`python -m experiments.scene_docs`.

A test holds the files against this module, so they cannot fall behind what is read.
"""

import json
import re
from dataclasses import MISSING
from pathlib import Path
from typing import Any, get_args, get_origin

from command.settings import Above, AtLeast, AtMost, Color, OneOf, Rows, Setting, rule_of, settings_of
from files.whole import write_text
from player.scene.scene import Scene

DOCS = Path(__file__).parents[1] / "docs"
JSON_TYPES = {str: "string", float: "number", int: "integer", bool: "boolean"}
WORDS = {str: "string", float: "number", int: "whole number", bool: "true, false"}


def scene_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a scene file, as editors read it."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A scene of selfscan",
        **_table(Scene),
    }


def _table(record: type) -> dict[str, Any]:
    needed = [setting.key for setting in settings_of(record) if setting.default is MISSING]
    properties = {setting.key: _property(setting) for setting in settings_of(record)}
    return {"type": "object", "properties": properties, "additionalProperties": False} | (
        {"required": needed} if needed else {}
    )


def _property(setting: Setting) -> dict[str, Any]:
    out: dict[str, Any] = {"description": setting.means}
    if setting.table is not None:
        return _table(setting.table) | out
    rows = rule_of(setting, Rows)
    if rows is not None:
        limits = {"minItems": rows.least, "maxItems": rows.most}
        return out | {"type": "array", "items": _table(get_args(setting.type)[0]), **limits}
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
        elif isinstance(rule, AtMost):
            limits["maximum"] = rule.most
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
    return "#" + "".join(f"{round(255 * share):02x}" for share in setting.default[:3])


def scene_table(name: str) -> str:
    """Keys of one table of the file, or with "" those outside all tables, as Markdown."""
    rows = ["| key | value | default | |", "|---|---|---|---|"]
    tables = {s.key: s.table or get_args(s.type)[0] for s in settings_of(Scene) if _is_table(s)}
    for setting in settings_of(tables[name]) if name else [s for s in settings_of(Scene) if not _is_table(s)]:
        rows.append(f"| `{setting.name}` | {_values(setting)} | {_default(setting)} | {setting.means} |")
        for inner in settings_of(setting.table) if setting.table is not None else ():
            key = f"{setting.name}.{inner.name}"
            rows.append(f"| `{key}` | {_values(inner)} | {_default(inner)} | {inner.means} |")
    return "\n".join(rows)


def _is_table(setting: Setting) -> bool:
    return setting.table is not None or rule_of(setting, Rows) is not None


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
    write_text(page, text)
    write_text(DOCS / "scene.schema.json", json.dumps(scene_schema(), indent=1) + "\n")


if __name__ == "__main__":
    main()
