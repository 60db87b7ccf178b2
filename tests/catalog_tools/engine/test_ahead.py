"""A bounded number of items ahead of whoever takes the results."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from catalog_tools.engine.ahead import ahead


@pytest.mark.parametrize("most", [1, 3, 11])
def test_no_more_items_are_begun_than_may_wait(most: int) -> None:
    """With the k-th result `most` - 1 more items have been taken, while there are any."""
    begun: list[int] = []

    def items() -> Iterator[int]:
        for item in range(1, 11):
            begun.append(item)
            yield item

    with ThreadPoolExecutor(2) as pool:
        for k, result in enumerate(ahead(pool, lambda item: item**2, items(), most), 1):
            assert result == k**2
            assert len(begun) == min(k + most - 1, 10)
    assert k == 10
