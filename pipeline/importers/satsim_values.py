"""Values that a SatSim file leaves to chance or to small programs: drawn once, worked out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput

KNOWN = {
    "uniform": ("low", "high"),
    "normal": ("loc", "scale"),
    "lognormal": ("mean", "sigma"),
    "randint": ("low", "high"),
    "poisson": ("lam",),
    "exponential": ("scale",),
}
Node = JsonObject  # of a SatSim file
MOST = 100_000_000
DEPTH = 32


def settled(value: object, rng: np.random.Generator, told: list[str], where: str = "") -> object:
    """The value with every `$sample` drawn and every `$pipeline` worked out.

    told : gets a line for each draw. BadInput for a sampler or step that is not known.
    """
    if where.count(".") > DEPTH:
        raise BadInput(where[:60], "nested too deeply", f"at most {DEPTH} levels")
    if isinstance(value, list):
        return [settled(v, rng, told, f"{where}.{i}") for i, v in enumerate(value)]
    if not isinstance(value, dict):
        return value
    if "$sample" in value:
        return _drawn(value, rng, told, where)
    if "$pipeline" in value:
        return _worked_out(value["$pipeline"], where)
    for key in value:
        if str(key).startswith("$"):
            raise BadInput(f"{where}.{key}", value[key], "$sample or $pipeline")
    before = f"{where}." * bool(where)
    return {k: settled(v, rng, told, f"{before}{k}") for k, v in value.items()}


def _drawn(value: Node, rng: np.random.Generator, told: list[str], where: str) -> object:
    kind = str(value["$sample"]).removeprefix("random.")
    if kind not in SAMPLERS:
        allowed = ", ".join(f"random.{k}" for k in SAMPLERS)
        raise BadInput(f"{where}.$sample", value["$sample"], allowed)
    drawn = SAMPLERS[kind](kind, value, rng, told, where)
    if not isinstance(drawn, dict | list):
        told.append(f"{where} drawn at random by {value['$sample']}: {_shown(drawn)}")
    return drawn


def _shown(drawn: object) -> str:
    if isinstance(drawn, np.ndarray):
        return f"image, median {np.median(drawn):.4g}"
    return f"{drawn:.6g}" if isinstance(drawn, int | float) else str(drawn)


def _list(_: str, value: Node, rng: np.random.Generator, told: list[str], where: str) -> object:
    length = settled(value.get("length"), rng, told, f"{where}.length")
    if not isinstance(length, int | np.integer) or not 0 <= length <= 10_000:
        raise BadInput(f"{where}.length", length, "a whole number up to 10000")
    return [settled(value.get("value"), rng, told, f"{where}.{i}") for i in range(length)]


def _choice(_: str, value: Node, rng: np.random.Generator, told: list[str], where: str) -> object:
    choices = value.get("choices")
    if not isinstance(choices, list) or not choices:
        raise BadInput(f"{where}.choices", choices, "a list of values")
    share = value.get("probabilities")
    try:
        k = int(rng.choice(len(choices), p=share))
    except (ValueError, TypeError) as error:
        raise BadInput(f"{where}.probabilities", share, str(error)) from None
    told.append(f"{where} chosen at random: number {k + 1} of {len(choices)}")
    return settled(choices[k], rng, told, where)


def _numbers(kind: str, value: Node, rng: np.random.Generator, told: list[str], where: str) -> Any:
    given = [settled(value.get(k), rng, told, f"{where}.{k}") for k in KNOWN[kind]]
    size = value.get("size")
    _check_size(size, f"{where}.size")
    try:
        if "seed" in value:
            rng = np.random.default_rng(value["seed"])
        out = getattr(rng, "integers" if kind == "randint" else kind)(*given, size=size)
    except (ValueError, TypeError) as error:
        raise BadInput(where, given, str(error)) from None
    return np.asarray(out, np.float32) if np.ndim(out) else np.asarray(out).item()


def _check_size(size: object, field: str) -> None:
    each = size if isinstance(size, list) else [1 if size is None else size]
    if not all(type(n) is int and n > 0 for n in each) or math.prod(each) > MOST:
        raise BadInput(field, size, f"whole numbers, up to {MOST} in all")


SAMPLERS = {**dict.fromkeys(KNOWN, _numbers), "choice": _choice, "list": _list}


def _worked_out(steps: object, where: str) -> float:
    """A number through the steps that a scene may hold: `constant` and `poly`."""
    value = 0.0
    for step in steps if isinstance(steps, list) else [steps]:
        name = step.get("function") if isinstance(step, dict) else step
        kwargs = step.get("kwargs", {}) if isinstance(step, dict) else {}
        try:
            if name == "constant":
                value = float(kwargs["value"])
            elif name == "poly":
                value = float(np.polyval(kwargs["coef"], value))
            else:
                raise BadInput(f"{where}.$pipeline", name, "constant or poly")
        except (KeyError, TypeError, ValueError):
            raise BadInput(f"{where}.$pipeline", kwargs, f"what {name} takes") from None
    return value
