"""Bundles: short tasks that one scheduler's task runs, each tile still with its own marker."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from catalog_tools.engine.ahead import Key, Tasks, Value
from pipeline.arrays import Geometry

MOST_TILES = 128  # of one bundle
TASKS_A_WORKER = 4  # at least, where there are as many tiles
PREFIX = "tiles_"


@dataclass(frozen=True)
class Ref:
    """Stands in a step for a value that comes from outside of the bundle."""

    index: int


@dataclass(frozen=True)
class BundleStep:
    """A step of a bundle: the key of its result, what is called, and its arguments, in which keys
    of earlier steps and Refs are exchanged for values; after it the results in `over` are let go.
    """

    key: Key
    function: Callable[..., Value]
    arguments: tuple[object, ...]
    over: tuple[Key, ...]


@dataclass(frozen=True)
class Bundle:
    """Steps in an order in which each finds what it needs, frame after frame."""

    steps: tuple[BundleStep, ...]


def tiles_a_bundle(tile_s: float, least_task_s: float, tiles: int, workers: int) -> int:
    """How many tiles one task draws: so many that it is worth being sent, and all are at work.

    tile_s : predicted CPU seconds of a tile; least_task_s : what a task should last;
    tiles : of the whole job
    """
    worth = math.ceil(least_task_s / max(tile_s, 1e-6))
    return max(1, min(worth, MOST_TILES, tiles // (TASKS_A_WORKER * max(1, workers))))


def tiles_done(kind: str) -> int:
    """How many tiles a finished task drew, told from the first part of its key."""
    return int(kind[len(PREFIX) :]) if kind.startswith(PREFIX) else int(kind == "tile")


def bundled(graph: Tasks, wanted: list[Key], size: int) -> tuple[Tasks, list[Key]]:
    """A graph whose tasks draw `size` tiles each, and the keys to compute.

    What only one bundle needs (places, blocks, charge, truth) is worked out in it and is nobody's
    task; what several need stays a task of its own.
    """
    groups = list(_groups(wanted, size))
    users = _users(graph, groups)
    out: Tasks = {key: graph[key] for key, count in users.items() if count > 1}
    keys = []
    for group in groups:
        inner = {key for key in _closure(graph, group) if users[key] == 1}
        tiles = sum(key[0] == "tile" for key in group)
        name = (f"{PREFIX}{tiles}", *group[0])
        out[name] = _bundle(graph, group, inner)
        keys.append(name)
    return out, keys


def run_bundle(bundle: Bundle, *values: object) -> int:
    """Task: run the steps one after the other; returns how many."""
    known: dict[Key, object] = {}
    for step in bundle.steps:
        known[step.key] = step.function(*(_filled(a, known, values) for a in step.arguments))
        for key in step.over:
            del known[key]
    return len(bundle.steps)


def _groups(wanted: list[Key], size: int) -> Iterator[list[Key]]:
    """Keys of each bundle: whole frames where they fit, else parts of a frame of even size.

    Truth goes with the last tiles of its frame.
    """
    frames: dict[int, list[Key]] = {}
    for key in wanted:
        frames.setdefault(key[1], []).append(key)
    group: list[Key] = []
    tiles = 0
    for keys in frames.values():
        count = sum(key[0] == "tile" for key in keys)
        if group and tiles + count > size:
            yield group
            group, tiles = [], 0
        if count > size:
            parts = math.ceil(count / size)
            ends = [count * (k + 1) // parts for k in range(parts)]
            ends[-1] = len(keys)
            for start, end in zip([0, *ends[:-1]], ends, strict=True):
                yield keys[start:end]
            continue
        group, tiles = group + keys, tiles + count
    if group:
        yield group


def _users(graph: Tasks, groups: Iterable[list[Key]]) -> Counter[Key]:
    """How many bundles need each key."""
    return Counter(key for group in groups for key in _closure(graph, group))


def _closure(graph: Tasks, keys: Iterable[Key]) -> dict[Key, None]:
    """Keys and all that they depend on, each after what it needs."""
    found: dict[Key, None] = {}
    for key in keys:
        for needed in _needed(graph[key]):
            if needed not in found:
                found |= _closure(graph, [needed])
        found[key] = None
    return found


def _needed(task: tuple[object, ...]) -> Iterator[Key]:
    """Keys that a task depends on: they stand in lists among its arguments."""
    for argument in task[1:]:
        if type(argument) is list:
            yield from argument


def _bundle(graph: Tasks, group: list[Key], inner: set[Key]) -> tuple[Value, ...]:
    """The task of a bundle; `inner` are the keys that are worked out in it."""
    order = [key for key in _closure(graph, group) if key in inner]
    last = {needed: key for key in order for needed in _needed(graph[key])}
    over: dict[Key, list[Key]] = {}
    for needed, key in last.items():
        if needed in inner:
            over.setdefault(key, []).append(needed)
    outside = _Outside(inner)
    steps = []
    for key in order:
        function, *arguments = graph[key]
        told = outside.told(arguments)
        steps.append(BundleStep(key, function, told, tuple(over.get(key, ()))))
    return (run_bundle, Bundle(tuple(steps)), *outside.values)


class _Outside:
    """The values that come from outside of a bundle, each once however many steps need it."""

    def __init__(self, inner: set[Key]) -> None:
        self.inner, self.values = inner, list[object]()
        self._places: dict[object, Ref] = {}

    def told(self, arguments: list[object]) -> tuple[Value, ...]:
        """Arguments as a step keeps them. What stands before the geometry goes to many tasks: the
        inputs and stars, or futures of them."""
        kinds = [isinstance(a, Geometry) for a in arguments]
        shared = kinds.index(True) if True in kinds else 0
        return tuple(
            [v if v in self.inner else self._refer(v, v) for v in a]
            if type(a) is list
            else self._refer(a, id(a))
            if i < shared
            else a
            for i, a in enumerate(arguments)
        )

    def _refer(self, value: object, name: object) -> Ref:
        if name not in self._places:
            self._places[name] = Ref(len(self.values))
            self.values.append(value)
        return self._places[name]


def _filled(argument: object, known: dict[Key, object], values: tuple[object, ...]) -> Value:
    if type(argument) is Ref:
        return values[argument.index]
    if type(argument) is list:
        return [values[a.index] if type(a) is Ref else known[a] for a in argument]
    return argument
