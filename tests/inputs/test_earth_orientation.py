"""UT1 - UTC against astropy's own reading of the same tables."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.inputs.earth_orientation import gather_dut1_s


@pytest.fixture(scope="module")
def table():
    from astropy.utils import iers

    with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("auto_max_age", None):
        yield iers.IERS_Auto.open()


def test_against_astropy(table):
    """Within 1 ms (15 mas of hour angle: in 1973 the tables themselves differ by that)."""
    days = [2442000.2, 2450000.3, 2457753.5, 2457753.99, 2457754.5, 2458593.625, 2461365.2]
    for jd in days:
        value, remark = gather_dut1_s(jd, 0.0)
        assert remark is None
        assert value == pytest.approx(table.ut1_utc(jd, 0.0).to_value("s"), abs=1e-3)


def test_two_part_dates_agree():
    assert gather_dut1_s(2458593.5, 0.125) == gather_dut1_s(2458593.625, 0.0)


@pytest.mark.parametrize("jd", [2433282.5, 2440000.5, 2488069.5])
def test_limits_dates_beyond_the_tables_are_said(jd):
    value, remark = gather_dut1_s(jd, 0.0)
    assert value == 0.0
    assert "UT1 = UTC" in remark


def test_limits_stay_within_a_second():
    values = [gather_dut1_s(jd, 0.0)[0] for jd in np.arange(2442000.5, 2461000.5, 977.3)]
    assert np.abs(values).max() < 0.9
