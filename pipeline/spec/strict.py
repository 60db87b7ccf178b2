"""The base of all models: frozen, finite, unknown keys refused with the nearest known one."""

from __future__ import annotations

import difflib
from functools import cache
from typing import Annotated, Any, get_args

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from catalog_tools.documents import JsonObject
from pipeline.spec.keys import describe

# Keys that belong elsewhere in the scene, and where.
NOT_YET = {
    "pst": "a point-source transmittance belongs to background.stray_light.pst",
}

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
MAX_PATH = 1024
FilePath = Annotated[str, Field(min_length=1, max_length=MAX_PATH)]


class Strict(BaseModel):
    """A model that takes no unknown key, no true for 1, and no value that is not finite."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        str_strip_whitespace=True,
        json_schema_extra=describe,
    )

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, data: object) -> Any:
        if isinstance(data, dict):
            known, not_bool = _keys(cls)
            _check_schema(cls, data)
            for key in data:
                if key not in known:
                    raise unknown_key(str(key), sorted(known))
            for key in not_bool:
                if key in data and _holds_bool(data[key]):
                    raise PydanticCustomError(
                        "boolean", "allowed: what is neither true nor false", {"field": key}
                    )
        return data


def _check_schema(model: type[Strict], data: JsonObject) -> None:
    """A file of another kind is told by its `schema`, not by the first key that it has more."""
    field = model.model_fields.get("schema_")
    given = data.get("schema")
    if field is None or not isinstance(given, str):
        return
    (own,) = get_args(field.annotation)
    if given == own:
        return
    allowed, kind = f"allowed: {own!r}", given.partition("/")[2].partition("/")[0]
    if kind in {"scene", "sweep", "study"} - {own.split("/")[1]}:
        allowed += f"; this is a {kind}"
    raise PydanticCustomError("schema", "{allowed}", {"allowed": allowed, "field": "schema"})


@cache
def _keys(model: type[Strict]) -> tuple[frozenset[str], tuple[str, ...]]:
    """The keys of a model, and in its order those that take no true or false."""
    named = [(f.alias or name, f.annotation) for name, f in model.model_fields.items()]
    not_bool = tuple(key for key, annotation in named if not _takes_bool(annotation))
    return frozenset(key for key, _ in named), not_bool


def _takes_bool(annotation: object) -> bool:
    """True where a type is bool, anything, or a choice or list that has one of them."""
    return annotation in (bool, Any) or any(_takes_bool(a) for a in get_args(annotation))


def _holds_bool(value: object) -> bool:
    """True for true and false, which Python would take for the numbers 1 and 0; also in lists."""
    if isinstance(value, list | tuple):
        return any(map(_holds_bool, value))
    return isinstance(value, bool)


def unknown_key(key: str, known: list[str]) -> PydanticCustomError:
    """The error for a key that is not in the format."""
    if key in NOT_YET:
        allowed = NOT_YET[key]
    else:
        near = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
        near = near or [k for k in known if len(key) > 2 and k.startswith(key)]
        hint = f"did you mean {near[0]!r}? " if near else ""
        allowed = f"{hint}known keys: {', '.join(known)}"
    return PydanticCustomError(
        "unknown_key", "unknown key; {allowed}", {"key": key, "allowed": allowed}
    )
