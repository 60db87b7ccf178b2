"""Values that many tasks of a cluster share are pickled once, and come out as they went in."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from typing import Any

import numpy as np

from catalog_tools.engine.cluster_scheduler import Once, Packed, _tried, _try


@dataclass(frozen=True)
class Table:
    """Some arrays."""

    x: np.ndarray
    name: str


def total(table: Table, more: int, other: Table, parts: list[int]) -> Any:
    return float(table.x.sum()) + more + float(other.x.sum()) + sum(parts)


def test_same_values_from_one_pickle() -> None:
    table, other, once = Table(np.arange(5.0), "a"), Table(np.ones(3), "b"), Once()
    tasks = [_tried((total, table, i, other, [1, 2]), once) for i in range(3)]
    assert [_try(*pickle.loads(pickle.dumps(task))[1:]) for task in tasks] == [16.0, 17.0, 18.0]
    packed = {id(part) for task in tasks for part in task if isinstance(part, Packed)}
    assert len(packed) == 2  # one for each table, however many tasks
    assert len({part.name for task in tasks for part in task if isinstance(part, Packed)}) == 2


def test_what_is_no_task_or_no_dataclass_stays() -> None:
    once = Once()
    assert _tried(("stars", 3), once) == ("stars", 3)
    assert once.pack(Table) is Table  # the class itself
    for value in (3, "x", [Table(np.ones(1), "c")], None):
        assert once.pack(value) is value
