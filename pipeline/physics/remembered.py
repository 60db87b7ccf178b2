"""Values of slow functions of time, each moment of which is worked out once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from threading import Lock

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Moment = tuple[float, float]

MOST = 32_768  # moments of a function that are remembered, in some 10 MB


class Remembered:
    """A function of dates in two parts that looks up the moments it was asked for before.

    function : dates (n,), (n,) to values (n, ...), each from its own moment alone: so its bits do
        not depend on what is remembered
    The steps that plan, draw and check an exposure ask for the same moments, one after the other.
    """

    def __init__(self, function: Callable[[Array, Array], Array]) -> None:
        self._function = function
        self._known: tuple[dict[Moment, int], Array] = {}, np.empty(0)
        self._learning = Lock()

    def __call__(self, part1: ArrayLike, part2: ArrayLike) -> Array:
        """Values (n, ...) at the dates part1 + part2, (n,) or one for all."""
        one, two = np.broadcast_arrays(np.atleast_1d(part1), np.atleast_1d(part2))
        if one.size > MOST:  # what is asked for twice is worked out once, here too
            dates, places = np.unique(one + 1j * two, return_inverse=True)
            few = dates.size <= MOST
            return (self if few else self._function)(dates.real.copy(), dates.imag.copy())[places]
        if not one.size:
            return self._function(one, two)
        moments = list(zip(one.tolist(), two.tolist(), strict=True))
        index, values = self._known
        found = [index.get(moment, -1) for moment in moments]
        if -1 in found:
            index, values = self._learnt(moments)
            found = [index[moment] for moment in moments]
        return values[found]

    def _learnt(self, moments: Sequence[Moment]) -> tuple[dict[Moment, int], Array]:
        """What is known once these moments are too; the others go where there is no room."""
        with self._learning:
            index, values = self._known
            new = dict.fromkeys(moment for moment in moments if moment not in index)
            if not new:  # another thread has learnt them meanwhile
                return index, values
            if len(index) + len(new) > MOST:
                index, new = {}, dict.fromkeys(moments)
            found = self._function(*np.array(list(new)).T)
            if not index:  # a new one with its values: threads may hold those of before
                index, values = {}, np.empty((MOST, *found.shape[1:]))
            first = len(index)
            values[first : first + len(new)] = found
            index.update(zip(new, range(first, first + len(new)), strict=True))
            self._known = index, values
            return index, values
