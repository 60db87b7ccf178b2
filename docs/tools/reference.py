"""Reference pages made from the product itself: the scene's fields, and the commands."""

from __future__ import annotations

import json
import re
from typing import Any

SCENE_HEAD = """# The scene file

Every field of a scene, made from the format itself (`nightglass schema` prints it as JSON Schema).
Units stand in the keys. Unknown keys are refused with the nearest known one. A section that is
absent is a component that is absent; *required* means within its section.
"""
COMMAND_HEAD = """# Commands

Made from `nightglass --help`. All take `--help`; exit codes are 0 done, 1 internal fault, 2 bad
input, 3 incomplete (`--resume` goes on), 130 interrupted.
"""


def scene_page() -> str:
    """Markdown of every model of the scene format: a heading and a table each."""
    from pipeline.spec.scene import Scene

    schema = Scene.model_json_schema(by_alias=True)
    models = {"Scene": {k: v for k, v in schema.items() if k != "$defs"}} | schema["$defs"]
    parts = [SCENE_HEAD]
    for name in _order(models):
        parts.append(_section(name, models[name], models))
    return "\n".join(parts)


def _order(models: dict[str, Any]) -> list[str]:
    """Models as a reader meets them: each after the one that first names it."""
    order, waiting = [], ["Scene"]
    while waiting:
        name = waiting.pop(0)
        if name in order:
            continue
        order.append(name)
        named = re.findall(r'"#/\$defs/([^"]+)"', json.dumps(models[name]))
        waiting = [n for n in dict.fromkeys(named) if n not in order] + waiting
    return order


def _section(name: str, model: dict[str, Any], models: dict[str, Any]) -> str:
    told = (model.get("description") or "").strip()
    told = re.sub(r"(?m)^ *([a-z][\w, ]*) : ", r"\n- \1: ", _escaped(told))
    lines = [f"## {name}", "", re.sub(r"\n(?=\n- )", "\n", told), ""]
    fields = model.get("properties", {})
    if not fields:
        return "\n".join([*lines, f"One of: {_type(model, models)}", ""])
    required = set(model.get("required", []))
    lines += ["| field | what | default | |", "| --- | --- | --- | --- |"]
    for key, field in fields.items():
        default = "*required*" if key in required else _default(field)
        about = _escaped(" ".join((field.get("description") or "").split()))
        lines.append(f"| `{key}` | {_type(field, models)} | {default} | {about} |")
    return "\n".join([*lines, ""])


def _default(field: dict[str, Any]) -> str:
    if "default" not in field or field["default"] is None:
        return ""
    value = json.dumps(field["default"])
    return f"`{value}`" if len(value) < 60 else "see its own defaults"


def _type(field: dict[str, Any], models: dict[str, Any]) -> str:
    """What a field takes, in words and links."""
    if "$ref" in field:
        name = field["$ref"].rsplit("/", 1)[1]
        return f"[{name}](#{name.lower()})"
    if "const" in field:
        return f"`{field['const']}`"
    if "enum" in field:
        return ", ".join(f"`{v}`" for v in field["enum"])
    for key in ("oneOf", "anyOf", "allOf"):
        if key in field:
            kinds = [_type(one, models) for one in field[key] if one.get("type") != "null"]
            return " or ".join(dict.fromkeys(kinds))
    kind = field.get("type", "any")
    if kind == "array":
        inner = field.get("items") or {}
        each = field.get("prefixItems")
        if each:
            return "[" + ", ".join(_type(one, models) for one in each) + "]"
        return f"list of {_type(inner, models)}" if inner else "list"
    if kind == "object" and isinstance(field.get("additionalProperties"), dict):
        return f"mapping to {_type(field['additionalProperties'], models)}"
    return {"integer": "whole number", "string": "text", "boolean": "true or false"}.get(
        str(kind), str(kind)
    ) + _bounds(field)


def _bounds(field: dict[str, Any]) -> str:
    names = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    told = [f"{sign} {field[key]:g}" for key, sign in names.items() if key in field]
    return f" ({', '.join(told)})" if told else ""


def _escaped(text: str) -> str:
    """Text that Markdown leaves as it is."""
    return re.sub(r"([|<\[\]*_])", r"\\\1", text) if text else ""


def command_page() -> str:
    """Markdown of every command with its options."""
    import typer.main

    from pipeline.cli import app

    parts = [COMMAND_HEAD]
    _commands(typer.main.get_command(app), "nightglass", parts)
    return "\n".join(parts)


def _commands(command: Any, name: str, parts: list[str]) -> None:
    inner = getattr(command, "commands", None)
    if inner:
        for key in sorted(inner):
            _commands(inner[key], f"{name} {key}", parts)
        return
    told = " ".join((command.help or "").split())
    lines = [f"## {name}", "", _escaped(told), "", "| option | default | |", "| --- | --- | --- |"]
    for option in command.params:
        shown = ", ".join(f"`{o}`" for o in option.opts)
        if option.param_type_name == "argument":
            shown = f"`{option.metavar or option.name.upper()}`"
        default = option.default
        plain = isinstance(default, str | int | float) and not isinstance(default, bool)
        value = f"`{default}`" if plain else ("*required*" if option.required else "")
        about = " ".join((getattr(option, "help", None) or "").split())
        lines.append(f"| {shown} | {value} | {_escaped(about)} |")
    parts.append("\n".join([*lines, ""]))
