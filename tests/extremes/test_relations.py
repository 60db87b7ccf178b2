"""Scenes whose frames must agree by what is known without any formula of the product."""

from __future__ import annotations

import pytest

from tests.extremes.relations import broken
from tests.extremes.stock import Stock

FEW, MANY = (148,), range(100)  # FEW: a quick one, for which all relations hold


def test_relations_hold(stock: Stock) -> None:
    looked_at: set[str] = set()
    for seed in FEW:
        held, wrong = broken(seed, stock)
        assert not wrong
        looked_at |= set(held)
    assert len(looked_at) == 8


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_relations_hold_in_many_scenes(stock: Stock) -> None:
    found = [broken(seed, stock) for seed in MANY]
    assert not [line for _, wrong in found for line in wrong]
    assert sum(len(held) for held, _ in found) > 300
