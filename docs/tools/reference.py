"""Reference pages made from the product itself: fields of scene, sweep, study, and commands."""

from __future__ import annotations

import json
import re
from typing import Any

from pipeline.spec.keys import in_docstring

SCENE_HEAD = """# The scene file

Every field of a scene, made from the format itself (`nightglass schema` prints it as JSON Schema).
Units stand in the keys. Unknown keys are refused with the nearest known one. A section that is
absent is a component that is absent; *required* means within its section.
"""
SWEEP_HEAD = """# The sweep file

Every field of a sweep, made from the format itself. [Sweeps](../sweeps.md) explains how to use
it. Fields of a scene are in [The scene file](scene.md). Unknown keys are refused with the nearest
known one; *required* means within its section.
"""
STUDY_HEAD = """# The study file

Every field of a study of capacity, made from the format itself. [Studies](../studies.md) explains
how to use it. Sections that a scene or a sweep also has are linked to [The scene file](scene.md)
and [The sweep file](sweep.md). Unknown keys are refused with the nearest known one; *required*
means within its section.
"""
COMMAND_HEAD = """# Commands

Made from `nightglass --help`. All take `--help`.

| exit code | meaning |
| --- | --- |
| 0 | done |
| 1 | internal fault; of `selftest`, a failed case; of a server, its fault, or a job that failed |
| 2 | bad input, or a damaged file; of a server, a request that it refuses |
| 3 | incomplete, or the disk is full: `--resume` continues; of `check`, the product is not whole |
| 4 | try again later: a scheduler, database or server does not answer, or a lock is held |
| 5 | the product is finished, but its error is, or may be, larger than its plan stated |
| 130 | interrupted |
"""

Models = dict[str, Any]


def scene_page() -> str:
    """Markdown of every model of the scene format: a heading and a table each."""
    return _page(_scene(), SCENE_HEAD, {})


def sweep_page() -> str:
    """The same of the sweep format."""
    return _page(_sweep(), SWEEP_HEAD, {"scene.md": _scene()})


def study_page() -> str:
    """The same of the study format, without what stands on the other two pages."""
    return _page(_study(), STUDY_HEAD, {"scene.md": _scene(), "sweep.md": _sweep()})


def _scene() -> Models:
    from pipeline.spec.scene import Scene

    return _models(Scene)


def _sweep() -> Models:
    from pipeline.spec.sweep import Sweep

    return _models(Sweep)


def _study() -> Models:
    from pipeline.spec.study import Study

    return _models(Study)


def _models(root: Any) -> Models:
    """The schemas of a format by name, the whole file's first."""
    schema = root.model_json_schema(by_alias=True)
    return {root.__name__: {k: v for k, v in schema.items() if k != "$defs"}} | schema["$defs"]


def _page(models: Models, head: str, others: dict[str, Models]) -> str:
    """A heading and a table of every model that is on none of the other pages."""
    places = {n: f"#{n.lower()}" for n in models}
    for page, theirs in others.items():
        same = (n for n in models if theirs.get(n) == models[n])
        places |= {n: f"{page}#{n.lower()}" for n in same if places[n].startswith("#")}
    names = _order({n: m for n, m in models.items() if places[n].startswith("#")})
    return "\n".join([head, *(_section(name, models[name], places) for name in names)])


def _order(models: Models) -> list[str]:
    """Models as a reader meets them: each after the one that first names it."""
    order, waiting = [], [next(iter(models))]
    while waiting:
        name = waiting.pop(0)
        if name in order or name not in models:
            continue
        order.append(name)
        named = re.findall(r'"#/\$defs/([^"]+)"', json.dumps(models[name]))
        waiting = [n for n in dict.fromkeys(named) if n not in order] + waiting
    return order


def _section(name: str, model: dict[str, Any], places: dict[str, str]) -> str:
    fields = model.get("properties", {})
    prose, said = in_docstring(model.get("description") or "")
    values = {word: text for word, text in said.items() if word not in fields}
    lines = [f"## {name}", "", *(line for p in prose for line in (_escaped(p), ""))]
    if values:
        lines += [*(f"- `{word}`: {_escaped(text)}" for word, text in values.items()), ""]
    if not fields:
        return "\n".join([*lines, f"One of: {_type(model, places)}", ""])
    required = set(model.get("required", []))
    lines += ["| field | values | default | meaning |", "| --- | --- | --- | --- |"]
    for key, field in fields.items():
        default = "*required*" if key in required else _default(field)
        about = " ".join((field.get("description") or "").split())
        lines.append(f"| `{key}` | {_type(field, places)} | {default} | {_escaped(about)} |")
    return "\n".join([*lines, ""])


def _default(field: dict[str, Any]) -> str:
    if "default" not in field or field["default"] is None:
        return ""
    value = json.dumps(field["default"])
    mapping = isinstance(field["default"], dict)
    return "see its own defaults" if mapping and len(value) >= 60 else f"`{value}`"


def _type(field: dict[str, Any], places: dict[str, str]) -> str:
    """What a field takes, in words and links."""
    if "$ref" in field:
        name = field["$ref"].rsplit("/", 1)[1]
        return f"[{name}]({places[name]})"
    if "const" in field:
        return f"`{field['const']}`"
    if "enum" in field:
        return ", ".join(f"`{v}`" for v in field["enum"])
    for key in ("oneOf", "anyOf", "allOf"):
        if key in field:
            kinds = [_type(one, places) for one in field[key] if one.get("type") != "null"]
            return " or ".join(dict.fromkeys(kinds))
    kind = field.get("type", "any")
    if kind == "array":
        inner = field.get("items") or {}
        each = field.get("prefixItems")
        if each:
            return "[" + ", ".join(_type(one, places) for one in each) + "]"
        return f"list of {_type(inner, places)}" if inner else "list"
    if kind == "object" and isinstance(field.get("additionalProperties"), dict):
        return f"mapping to {_type(field['additionalProperties'], places)}"
    return {"integer": "whole number", "string": "text", "boolean": "true or false"}.get(
        str(kind), str(kind)
    ) + _bounds(field)


def _bounds(field: dict[str, Any]) -> str:
    names = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    limits = [f"{sign} {field[key]:g}" for key, sign in names.items() if key in field]
    return f" ({', '.join(limits)})" if limits else ""


def _escaped(text: str) -> str:
    """Text that Markdown leaves as it is; code between backticks stays."""
    parts = re.split(r"(`[^`]*`)", text)
    parts[::2] = [re.sub(r"([|<\[\]*_])", r"\\\1", plain) for plain in parts[::2]]
    return "".join(parts)


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
    about = " ".join((command.help or "").split())
    lines = [f"## {name}", "", _escaped(about), "", "| option | default | |", "| --- | --- | --- |"]
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
