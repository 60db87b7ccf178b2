"""Values that a SatSim file leaves to chance or to small programs: drawn once, worked out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
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
OLD = ("sample", "pipeline")  # as SatSim wrote them before 0.8.2, and still reads them
Node = JsonObject  # of a SatSim file
MOST = 100_000_000
OF_ITEM = 1000  # numbers that an item of a drawn list counts as: it takes as long
DEPTH = 32


@dataclass
class Chance:
    """What is left to chance, as it is drawn.

    told : a line for each draw
    left : numbers that may still be drawn: lists within lists are short to write
    """

    rng: np.random.Generator
    told: list[str] = field(default_factory=list)
    left: int = MOST

    def count(self, numbers: int, where: str) -> None:
        """Count what is to be drawn; BadInput where it is too much."""
        self.left -= numbers
        if self.left < 0:
            allowed = f"up to {MOST} numbers in all, an item of a list counting as {OF_ITEM}"
            raise BadInput(where[:60], "more left to chance", allowed)


def settled(value: object, chance: Chance, where: str = "") -> object:
    """The value with every `$sample` drawn and every `$pipeline` worked out.

    BadInput for a sampler or step that is not known.
    """
    if where.count(".") > DEPTH:
        raise BadInput(where[:60], "nested too deeply", f"at most {DEPTH} levels")
    if isinstance(value, list):
        return _items(value, chance, where)
    if not isinstance(value, dict):
        return value
    value = _renamed(value)
    if "$sample" in value:
        return _drawn(value, chance, where)
    if "$pipeline" in value:
        return _worked_out(value["$pipeline"], where)
    for key in value:
        if str(key).startswith("$"):
            raise BadInput(f"{where}.{key}", value[key], "$sample or $pipeline")
    before = f"{where}." * bool(where)
    return {k: settled(v, chance, f"{before}{k}") for k, v in value.items()}


def _items(values: list[object], chance: Chance, where: str) -> list[object]:
    """A list's items; what draws a list stands for the items of that."""
    out: list[object] = []
    for i, value in enumerate(values):
        one = settled(value, chance, f"{where}.{i}")
        out += one if isinstance(one, list) and isinstance(value, dict) else [one]
    return out


def _renamed(value: Node) -> Node:
    """A mapping with the names that are OLD as they are now."""
    return {f"${k}" if k in OLD else k: v for k, v in value.items()}


def _drawn(value: Node, chance: Chance, where: str) -> object:
    kind = str(value["$sample"]).removeprefix("random.")
    if kind not in SAMPLERS:
        allowed = ", ".join(f"random.{k}" for k in SAMPLERS)
        raise BadInput(f"{where}.$sample", value["$sample"], allowed)
    drawn = SAMPLERS[kind](kind, value, chance, where)
    if not isinstance(drawn, dict | list):
        chance.told.append(f"{where} drawn at random by {value['$sample']}: {_shown(drawn)}")
    return drawn


def _shown(drawn: object) -> str:
    if isinstance(drawn, np.ndarray):
        return f"image, median {np.median(drawn):.4g}"
    return f"{drawn:.6g}" if isinstance(drawn, int | float) else str(drawn)


def _of_seed(value: Node, where: str) -> np.random.RandomState | None:
    """What SatSim draws with where the file has a seed: the same value for all time."""
    seed = value.get("seed")
    try:
        return None if seed is None else np.random.RandomState(seed)
    except (ValueError, TypeError) as error:
        raise BadInput(where, seed, str(error)) from None


def _seeded(value: object, own: np.random.RandomState | None) -> Any:
    """The value with a seed for each `$sample` in it that has none, drawn in SatSim's order."""
    if own is None or not isinstance(value, dict | list):
        return value
    if isinstance(value, list):
        return [_seeded(v, own) for v in value]
    out = _renamed(value)
    if "$sample" in out and out.get("seed") is None:
        out["seed"] = int(own.randint(0, 2**32, dtype=np.int64))
    return {k: v if k == "seed" else _seeded(v, own) for k, v in out.items()}


def _list(_: str, value: Node, chance: Chance, where: str) -> object:
    own = _of_seed(value, where)
    length = settled(_seeded(value.get("length"), own), chance, f"{where}.length")
    if not isinstance(length, int | np.integer) or not 0 <= length <= 10_000:
        raise BadInput(f"{where}.length", length, "a whole number up to 10000")
    chance.count(OF_ITEM * int(length), where)
    each = value.get("value")
    return [settled(_seeded(each, own), chance, f"{where}.{i}") for i in range(length)]


def _choice(_: str, value: Node, chance: Chance, where: str) -> object:
    choices = value.get("choices")
    if not isinstance(choices, list) or not choices:
        raise BadInput(f"{where}.choices", choices, "a list of values")
    share, own = value.get("probabilities"), _of_seed(value, where)
    try:
        n = len(choices)
        k = int(chance.rng.choice(n, p=share)) if own is None else int(own.randint(0, n))
    except (ValueError, TypeError) as error:
        raise BadInput(f"{where}.probabilities", share, str(error)) from None
    chance.told.append(f"{where} chosen at random: number {k + 1} of {len(choices)}")
    return settled(_seeded(choices[k], own), chance, where)


def _numbers(kind: str, value: Node, chance: Chance, where: str) -> Any:
    value = _seeded(value, _of_seed(value, where))
    given = [settled(value.get(k), chance, f"{where}.{k}") for k in KNOWN[kind]]
    size = value.get("size")
    chance.count(_checked_size(size, f"{where}.size"), where)
    own = _of_seed(value, where)
    opposite = _is_negated(value, own or chance.rng, where)
    try:
        name = "integers" if kind == "randint" and own is None else kind
        out = getattr(own or chance.rng, name)(*given, size=size)
    except (ValueError, TypeError, OverflowError) as error:
        raise BadInput(where, given, str(error)) from None
    out = -out if opposite else out
    return np.asarray(out, np.float32) if np.ndim(out) else np.asarray(out).item()


def _is_negated(value: Node, rng: np.random.Generator | np.random.RandomState, where: str) -> bool:
    """Whether the sample changes its sign, which it does with the probability `negate`."""
    share = value.get("negate", 0.0)
    if isinstance(share, bool) or not isinstance(share, int | float):
        raise BadInput(f"{where}.negate", share, "a number from 0 to 1")
    return share > 0.0 and bool(rng.uniform(0.0, 1.0) < share)


def _checked_size(size: object, field: str) -> int:
    """How many numbers a sample of that size has."""
    each = size if isinstance(size, list) else [1 if size is None else size]
    if not all(type(n) is int and n > 0 for n in each) or math.prod(each) > MOST:
        raise BadInput(field, size, f"whole numbers, up to {MOST} in all")
    return math.prod(each)


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
        except (KeyError, TypeError, ValueError, OverflowError):
            raise BadInput(f"{where}.$pipeline", kwargs, f"what {name} takes") from None
    return value
