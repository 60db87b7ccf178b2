"""From YAML, JSON or plain data to a Scene; every mistake named by field, value and remedy."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from catalog_tools.documents import JsonObject, JsonValue, is_deeper
from pipeline.errors import BadInput, shorten
from pipeline.spec.dotted import NoFieldError, add_dotted, set_dotted
from pipeline.spec.scene import Scene
from pipeline.spec.wording import range_of, words_of
from pipeline.spec.yaml_text import read_yaml, write_yaml

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

Mistake = tuple[str, object, str]  # field as the user wrote it (dotted), value, what is allowed
MAX_BYTES = 1 << 20
MAX_DEPTH = 32


class InvalidScene(BadInput):
    """A scene with mistakes: `mistakes` holds (field, value, allowed) of each, first ones first."""

    def __init__(self, mistakes: list[Mistake]) -> None:
        self.mistakes = mistakes
        super().__init__(*mistakes[0])

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.mistakes,)

    def __str__(self) -> str:
        lines = [f"{f}: {shorten(v)} is not accepted; {a}" for f, v, a in self.mistakes[:20]]
        more = len(self.mistakes) - 20
        return "\n".join(lines + ([f"... and {more} more"] if more > 0 else []))


def load_scene(path: Path, overrides: Iterable[str] = ()) -> Scene:
    """Read a scene file (YAML or JSON), apply `a.b=value` overrides, check it.

    Relative paths inside the scene are taken from the scene file's folder.
    """
    if not path.is_file():
        raise BadInput("SCENE", str(path), "an existing scene file (YAML or JSON)")
    if path.stat().st_size > MAX_BYTES:
        raise BadInput("SCENE", str(path), f"a file of at most {MAX_BYTES} bytes")
    raw = path.read_bytes()
    if re.search(rb"(?m)^1 [\dA-Z ]{5}.{62}\s*\n2 [\dA-Z ]{5}.{62}\s*$", raw):
        allowed = "a scene; two-line elements stand in one, as `orbit: {kind: tle, line1, line2}`, "
        allowed += "and whole files of them as `populations` (docs/targets.md)"
        raise BadInput("SCENE", str(path), allowed)
    data = parse_text(raw, str(path))
    for override in overrides:
        apply_override(data, override)
    return parse_scene(data, base=path.parent)


def read_format_file(path: Path, field: str, what: str) -> JsonValue:
    """The plain data of a file of one of our formats (`sweep`, `study`)."""
    if not path.is_file():
        raise BadInput(field, str(path), f"an existing {what} file (YAML or JSON)")
    if path.stat().st_size > MAX_BYTES:
        raise BadInput(field, str(path), f"a file of at most {MAX_BYTES} bytes")
    return parse_text(path.read_bytes(), str(path))


def plain_mapping(data: object, what: str, keys: str) -> JsonObject:
    """Plain data of one of our formats, which is a mapping. BadInput for what is not."""
    if not isinstance(data, dict):
        raise BadInput(what, data, f"a mapping (schema, name, {keys}, ...)")
    return data


def parse_text(raw: bytes, name: str = "scene") -> JsonValue:
    """Plain data from YAML 1.2 or JSON text; duplicates, aliases and deep nesting are refused."""
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise BadInput(name, raw[:20], "UTF-8 text") from error
    return parse_yaml(text, name)


def parse_yaml(text: str, name: str = "scene") -> JsonValue:
    """YAML 1.2, or JSON as the subset of it: `1e5` is a number and `12:30:00` is text.

    Refused: duplicate keys, aliases, nesting beyond MAX_DEPTH, and a file that asks for YAML 1.1.
    """
    directive = re.search(r"(?m)^%YAML\s+(\S+)", text)
    if directive and directive[1] != "1.2":
        raise BadInput(name, f"%YAML {directive[1]}", "YAML 1.2")
    if text.lstrip()[:1] == "{":
        value = _parse_json(text)
        if value is not None:
            return value
    return read_yaml(text, name, MAX_DEPTH)


def _parse_json(text: str) -> JsonValue:
    """A JSON text as data (the quick way), or None where YAML has to read it or refuse it."""
    if text.count("{") + text.count("[") > 100_000:
        return None

    def pairs(items: list[tuple[str, object]]) -> JsonObject:
        if len({key for key, _ in items}) != len(items):
            raise ValueError("duplicate key")
        return dict(items)

    try:
        value = json.loads(text, object_pairs_hook=pairs)
    except (ValueError, RecursionError):
        return None
    return None if is_deeper(value, MAX_DEPTH) else value


def parse_scene(data: object, base: Path | None = None) -> Scene:
    """Check plain data against the scene format. Raises InvalidScene with every mistake."""
    if not isinstance(data, dict):
        raise BadInput("scene", data, "a mapping of sections (schema, name, epoch, observer, ...)")
    scene = _checked(data)
    return scene if base is None else resolve_paths(scene, base)


def _checked(data: JsonObject) -> Scene:
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        raise InvalidScene(mistakes_of(error, data)) from None
    except RecursionError:
        raise BadInput("scene", "nested too deeply", f"at most {MAX_DEPTH} levels") from None


def mistakes_of(error: ValidationError, data: JsonObject) -> list[Mistake]:
    """(field, value, allowed) of every mistake, one for each field."""
    found = error.errors()
    places = [e["loc"] for e in found]
    of_scene = error.title == "Scene"
    told = [(e, _mistake(e, data, of_scene)) for e in found if not _follows(e, places)]
    fields = [mistake[0] for _, mistake in told]
    return _merged([mistake for e, mistake in told if not _is_of_inside(e, mistake, fields)])


def _is_of_inside(error: ErrorDetails, mistake: Mistake, fields: list[str]) -> bool:
    """Whether a mapping or list is called of a wrong type for a mistake inside it alone: it is
    tried as each of the types that may stand there."""
    field, value, _ = mistake
    inside = any(f.startswith(f"{field}.") for f in fields)
    return inside and error["type"] in WRONG_TYPE and isinstance(value, dict | list | tuple)


def _follows(error: ErrorDetails, places: list[tuple[int | str, ...]]) -> bool:
    """Whether a list is called too short only because items in it are refused themselves."""
    at = error["loc"]
    return error["type"] == "too_short" and any(p[: len(at)] == at and p != at for p in places)


PATH_FIELDS = (
    ("stars", "catalogue"),
    ("stars", "colour_fit"),
    ("cosmic_rays", "path"),
    ("background", "stray_light", "pst", "path"),
    ("background", "stray_light", "earth_albedo"),
    ("sensor", "transmission"),
    ("sensor", "quantum_efficiency"),
    ("sensor", "gain_e_per_dn"),
    ("sensor", "bias_dn"),
    ("sensor", "flat"),
    ("sensor", "dark_e_per_s"),
    ("sensor", "read_noise_e"),
    ("sensor", "detector", "bad", "map"),
    ("sensor", "detector", "dead", "map"),
    ("sensor", "bandpass", "path"),
    ("sensor", "psf", "path"),
    ("sensor", "psf", "psfs", "*", "*", "path"),  # of each place of a field
    ("sensor", "distortion", "path"),
    ("observer", "orbit", "path"),
    ("pointing", "path"),
    ("pointing", "attitude", "jitter", "*", "path"),
    ("dwells", "*", "pointing", "path"),
    ("populations", "*", "path"),
    ("populations", "*", "sizes"),
    ("targets", "*", "orbit", "path"),  # of each target
    ("targets", "*", "body", "path"),
    ("targets", "*", "body", "surface", "path"),
    ("targets", "*", "body", "materials", "*", "path"),
    ("targets", "*", "body", "parts", "*", "path"),
    ("targets", "*", "body", "parts", "*", "surface", "path"),
    ("targets", "*", "body", "parts", "*", "materials", "*", "path"),
)
STUDY_SECTIONS = (  # of a study: where it holds sections of a scene
    ("catalogue", "populations"),
    ("cameras", "*", "sensor"),
    ("cameras", "*", "background"),
    ("sensors", "*", "observer"),
)


def _tree() -> JsonObject:
    """PATH_FIELDS as nested mappings; an empty one is a field that may name a file."""
    tree: JsonObject = {}
    of_studies = (
        at + names[1:] for at in STUDY_SECTIONS for names in PATH_FIELDS if names[0] == at[-1]
    )
    for names in (*PATH_FIELDS, *of_studies):
        inner = tree
        for name in names:
            inner = inner.setdefault(name, {})
    return tree


TREE = _tree()


def path_holders(data: object) -> Iterator[tuple[str, JsonObject, str]]:
    """(dotted field, the mapping that holds it, its key) of every field that may name a file."""
    return _holders(TREE, data, "")


def _holders(tree: JsonObject, holder: object, at: str) -> Iterator[tuple[str, JsonObject, str]]:
    """Those below a place in the data; * is everything that a list or mapping holds."""
    if "*" in tree and isinstance(holder, dict | list):
        items = holder.items() if isinstance(holder, dict) else enumerate(holder)
        for name, value in items:
            yield from _holders(tree["*"], value, f"{at}{name}.")
    if not isinstance(holder, dict):
        return
    for name, inner in tree.items():
        if not inner:
            yield at + name, holder, name
        elif holder.get(name) is not None:
            yield from _holders(inner, holder[name], f"{at}{name}.")


def resolve_paths(scene: Scene, base: Path) -> Scene:
    """The scene with the relative paths in it made absolute, from the folder `base`.

    URLs (`s3://...`) stay as they are.
    """
    data = scene.as_dict()
    place_paths(data, base)
    return _checked(data)


def place_paths(data: JsonObject, base: Path) -> None:
    """Make the relative paths in plain data absolute, in place, from the folder `base`."""
    for field, holder, key in path_holders(data):
        value = holder.get(key)
        if isinstance(value, list):
            holder[key] = [_absolute(path, base, field) for path in value]
        elif isinstance(value, str):
            holder[key] = _absolute(value, base, field)


def _absolute(path: object, base: Path, field: str) -> object:
    """A path from the folder `base`; what is no text stays, to be refused where it is parsed."""
    if not isinstance(path, str) or "://" in path:
        return path
    try:
        return str((base / Path(path).expanduser()).resolve())
    except (RuntimeError, ValueError, OSError) as error:  # of no such user, of a null byte, a loop
        raise BadInput(field, path, f"a path; {error}") from None


def apply_override(data: object, override: str) -> None:
    """Set one dotted key: `sensor.read_noise_e=3`; `accept+=sun` adds to a list."""
    key, sep, text = override.partition("=")
    key, adds = key.removesuffix("+"), key.endswith("+")
    if not sep or not re.fullmatch(r"[A-Za-z0-9_]+(\.[A-Za-z0-9_]+)*", key):
        raise BadInput("--set", override, "dotted.key=value")
    value = parse_yaml(text, f"--set {key}") if text.strip() else None
    try:
        if adds:
            add_dotted(data, key, value)
        else:
            set_dotted(data, key, value)
    except NoFieldError as missing:
        part = missing.args[0].rpartition(".")[2]
        raise BadInput("--set", override, f"a key that exists up to {part!r}") from None


def scene_yaml(scene: Scene) -> str:
    """A scene as YAML text, defaults filled in."""
    return _yaml_of(json.dumps(scene.as_dict()))


@lru_cache(maxsize=1)
def _yaml_of(text: str) -> str:
    """JSON as YAML; the last one is kept, as a product's beginning and its end write the same."""
    return write_yaml(json.loads(text))


def _mistake(error: ErrorDetails, data: JsonValue, of_scene: bool) -> Mistake:
    """One mistake as (dotted field, value given, what is allowed), in the user's own names."""
    kind, context, value = error["type"], error.get("ctx", {}), error.get("input")
    names = _names(error["loc"], data, kind == "missing", value)
    if kind == "unknown_key":
        key = context["key"]
        return ".".join([*names, str(key)]), _under(key, value), str(context["allowed"])
    if kind == "missing":
        return ".".join(names), None, "it must be given"
    value = _pointed_at(names, value, context)
    if kind.startswith("union_tag"):
        tag = str(context["discriminator"]).strip("'")
        allowed = f"allowed: {context['expected_tags']}" if "tag" in context else "it must be given"
        names.append(tag)
        return ".".join(names), _under(tag, value), allowed
    if of_scene and (allowed := _of_type(kind, names)):
        return ".".join(names), value, allowed
    allowed = _allowed(error["msg"])[:400]
    if of_scene and kind in BEYOND:
        allowed += _ends_of(names)
    return ".".join(names) or "scene", value, allowed


def _under(key: str, value: object) -> object:
    """What a mapping holds under a key; any other value as it is."""
    return value.get(key) if isinstance(value, dict) else value


def _pointed_at(names: list[str], value: JsonValue, context: JsonObject) -> object:
    """The value that a mistake's context points at in another; its names are put to `names`."""
    if "index" in context:
        names[-1] += f"[{context['index']}]"
        value = value[context["index"]]
    if "field" in context:
        names.append(context["field"])
        for part in context["field"].split("."):
            if isinstance(value, list | tuple) and part.isdigit() and int(part) < len(value):
                value = value[int(part)]
            else:
                value = _under(part, value)
    return value


def _ends_of(names: list[str]) -> str:
    whole = range_of(names)
    return whole and f" ({whole})"


def _of_type(kind: str, names: list[str]) -> str:
    """What is allowed where a value is of a wrong type altogether; empty elsewhere."""
    words = words_of(names) if kind in WRONG_TYPE else ""
    but = ", not true or false" if kind == "boolean" else ""
    return words and f"allowed: {words[:380]}{but}"


# Values of a wrong type altogether: what the format takes there is told instead of how it failed.
WRONG_TYPE = {
    "boolean",
    "bool_parsing",
    "bool_type",
    "dict_type",
    "float_parsing",
    "float_type",
    "int_from_float",
    "int_parsing",
    "int_parsing_size",
    "int_type",
    "list_type",
    "literal_error",
    "model_attributes_type",
    "model_type",
    "string_type",
    "tuple_type",
}

# Values beyond one end of a range: both ends are told.
BEYOND = {"greater_than", "greater_than_equal", "less_than", "less_than_equal"}


WORDING = (  # pydantic's words, and ours
    (r", (?:unable to parse|unable to interpret|got a number with a frac).*", ""),
    (r"^Input should be ", "allowed: "),
    (r"^(?:String|Tuple|List|Dictionary|Value) should ", "allowed: to "),
    (r" after validation, not \d+$", ""),
    (r"a valid (?:tuple|list)\b", "a list"),
    (r"a valid string\b", "text"),
    (r"a valid dictionary(?: or (?:instance of \w+|object to extract fields from))?", "a mapping"),
    (r"a valid integer", "a whole number"),
    (r"a valid boolean", "true or false"),
    (r"a valid ", "a "),
)


def _allowed(message: str) -> str:
    """What is allowed, in our words."""
    for theirs, ours in WORDING:
        message = re.sub(theirs, ours, message)
    return message


def _merged(mistakes: list[Mistake]) -> list[Mistake]:
    """One mistake per field: the alternatives of a union are joined by "or"."""
    by_field: dict[str, Mistake] = {}
    for field, value, allowed in mistakes:
        if field in by_field and allowed not in by_field[field][2]:
            also = allowed.removeprefix("allowed: ").removeprefix("to ")
            allowed = f"{by_field[field][2]}, or {also}"
        if field not in by_field or by_field[field][2] in allowed:
            by_field[field] = (field, value, allowed)
    return list(by_field.values())


def _names(loc: tuple[int | str, ...], data: object, missing: bool, value: object) -> list[str]:
    """The path of an error without the tags that pydantic puts in for unions.

    A tag may be a key as well (`mode: target` and `target`).
    """
    names: list[str] = []
    holder = data
    for i, part in enumerate(loc):
        rest = loc[i + 1 :]
        if isinstance(holder, dict):
            if part in holder and not _is_tag(holder, part, rest, missing, value):
                holder = holder[part]
            elif part in holder or rest or not missing:
                continue
        elif isinstance(holder, list | tuple) and isinstance(part, int):
            holder = dict(enumerate(holder)).get(part)
        else:
            continue
        names.append(str(part))
    return names


def _is_tag(
    holder: dict[JsonValue, JsonValue],
    key: int | str,
    rest: tuple[int | str, ...],
    missing: bool,
    value: object,
) -> bool:
    """Whether a part of an error's path that is a key is the tag of the mapping that holds it: the
    path goes on in that mapping, or ends at it."""
    if isinstance(holder[key], dict | list):
        return False
    return (rest[0] in holder or (missing and len(rest) == 1)) if rest else value is holder
