"""The design of a sweep: which values the axes take at each point, found from its number alone."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.arrays import Array
from pipeline.spec.study import Study
from pipeline.spec.sweep import (
    Grid,
    ListAxis,
    QuasiRandom,
    RangeAxis,
    Sweep,
    TableAxis,
    Zip,
    axis_length,
)

BLOCK = 4096  # points of a Sobol sequence that are drawn at once


class Design:
    """Points 0 to size - 1; a point is a place of the design and one of its seeds."""

    def __init__(self, sweep: Sweep | Study) -> None:
        self.sweep, self.axes, self.size = sweep, sweep.axes, sweep.points
        self._lengths = [axis_length(axis) for axis in sweep.axes]
        self._block = lru_cache(maxsize=4)(self._shares)

    def values(self, point: int) -> JsonObject:
        """Dotted field -> value at a point (without the seed)."""
        place = point // self.sweep.seeds
        out: JsonObject = {}
        for axis, value in zip(self.axes, self._axis_values(place), strict=True):
            out.update(zip(axis.fields, value, strict=True))
        return out

    def seed_step(self, point: int) -> int:
        """What a point adds to the scene's seed."""
        return point % self.sweep.seeds

    def extremes(self, name: str) -> list[object]:
        """The values of a field among which its least and largest are; none where it is no axis."""
        for axis in self.axes:
            if isinstance(axis, ListAxis) and axis.field == name:
                return list(axis.values)
            if isinstance(axis, TableAxis) and name in axis.fields:
                column = axis.fields.index(name)
                return [row[column] for row in axis.rows]
            if isinstance(axis, RangeAxis) and axis.field == name:
                return [axis.at(0.0), axis.at(1.0)]
        return []

    def order(self, last: frozenset[str]) -> Iterator[int]:
        """All points in the order of the work: of a grid, axes of the fields `last` change fastest.

        So points that share their light come one after the other, whatever the order of the axes.
        """
        if not isinstance(self.sweep.design, Grid):
            yield from range(self.size)
            return
        strides = [math.prod(self._lengths[i + 1 :]) for i in range(len(self.axes))]
        axes = sorted(range(len(self.axes)), key=lambda i: last.issuperset(self.axes[i].fields))
        steps = [range(0, self._lengths[i] * strides[i], strides[i]) for i in axes]
        for digits in itertools.product(*steps):
            first = sum(digits) * self.sweep.seeds
            yield from range(first, first + self.sweep.seeds)

    def _axis_values(self, place: int) -> list[tuple[object, ...]]:
        """Of each axis the values of its fields at a place."""
        if isinstance(self.sweep.design, QuasiRandom):
            shares = self._block(place // BLOCK)[place % BLOCK]
            return [_at_share(a, float(u)) for a, u in zip(self.axes, shares, strict=True)]
        if isinstance(self.sweep.design, Zip):
            return [_at(axis, place) for axis in self.axes]
        out = []
        for axis, length in zip(reversed(self.axes), reversed(self._lengths), strict=True):
            place, index = divmod(place, length)
            out.append(_at(axis, index))
        return out[::-1]

    def _shares(self, block: int) -> Array:
        """Shares (n, axes) in [0, 1) of a block of a quasi-random design."""
        design = self.sweep.design
        assert isinstance(design, QuasiRandom)
        if design.kind == "latin_hypercube":
            return self._latin()[block * BLOCK : (block + 1) * BLOCK]
        sequence = _qmc().Sobol(
            len(self.axes), scramble=True, rng=np.random.default_rng(design.seed)
        )
        if block:
            sequence.fast_forward(block * BLOCK)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # a number of points that is no power of 2
            return np.asarray(sequence.random(BLOCK))

    def _latin(self) -> Array:
        """The whole Latin hypercube (points, axes), drawn once."""
        if not hasattr(self, "_whole"):
            design = self.sweep.design
            assert isinstance(design, QuasiRandom)
            rng = np.random.default_rng(design.seed)
            cube = _qmc().LatinHypercube(len(self.axes), rng=rng)
            self._whole = np.asarray(cube.random(design.points))
        return self._whole


def _at(axis: ListAxis | TableAxis | RangeAxis, index: int) -> tuple[object, ...]:
    """The value or values number `index` of an axis."""
    if isinstance(axis, ListAxis):
        return (axis.values[index],)
    if isinstance(axis, TableAxis):
        return axis.rows[index]
    count = axis.count or 1
    return (axis.at(index / (count - 1) if count > 1 else 0.0),)


def _at_share(axis: ListAxis | TableAxis | RangeAxis, share: float) -> tuple[object, ...]:
    """The value or values of an axis a share of the way along it."""
    if isinstance(axis, RangeAxis):
        return (axis.at(share),)
    length = axis_length(axis)
    return _at(axis, min(int(share * length), length - 1))


def _qmc() -> Any:
    """scipy's quasi-random numbers; only designs of them load it."""
    from scipy.stats import qmc

    return qmc
