"""A million satellites are screened: none in the field is missed (and what it costs in memory)."""

from __future__ import annotations

import pytest

from pipeline.studies.selftest.many import screened


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_a_million_satellites():
    """In shares of 50,000, each of them new: as a population's file is read, batch by batch."""
    inside = 0
    for seed in range(20):
        kept, found, missed = screened(50_000, seed)
        assert missed == 0
        assert kept >= found
        inside += found
    assert inside > 500
