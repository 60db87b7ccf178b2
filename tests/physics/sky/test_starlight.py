"""Summed light in the sensor's band against every star with its own colour."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.inputs.band.colour_fit import gather_colour_fit
from pipeline.inputs.band.curves import resolve_response
from pipeline.physics.colour import brightest_electrons, star_electron_rate
from pipeline.physics.sky.galactic import diffuse_light
from pipeline.physics.sky.starlight import band_light

BANDS = [
    ({"kind": "box", "short_nm": 400.0, "long_nm": 900.0}, 0.005),
    ({"kind": "named", "name": "bessell-V"}, 0.02),
    ({"kind": "named", "name": "bessell-I"}, 0.02),
    ({"kind": "named", "name": "bessell-B"}, 0.05),
    ({"kind": "box", "short_nm": 900.0, "long_nm": 1700.0}, 0.05),
]


@pytest.mark.parametrize(("band", "bound"), BANDS)
def test_against_each_star(shared_data, band, bound):
    """1000 real DR2 stars, some without a colour: within what the docstring says."""
    from astropy.io import fits

    rows = fits.getdata(shared_data / "gaia_dr2" / "full_schema_random" / "gdr2_sm.fits", 1)
    g, bp, rp = (
        np.array(rows[f"phot_{b}_mean_mag"], np.float64) for b in ("g", "bp", "rp")
    )  # fmt: skip
    fit = gather_colour_fit(*resolve_response(band, 1.0, 1.0))
    for limit in (12.0, 15.0, 17.0):
        kept = g > limit
        rate, _ = star_electron_rate(g[kept], bp[kept], rp[kept], fit)
        own, x = 10.0 ** (-0.4 * g[kept]), (bp - rp)[kept]
        has = np.isfinite(x)
        moments = tuple(np.array([(own[has] * x[has] ** k).sum()]) for k in range(3))
        got = band_light(moments, np.array([own[~has].sum()]), fit)
        assert got[0] == pytest.approx(rate.sum(), rel=bound)


def test_limits():
    fit = gather_colour_fit(*resolve_response(BANDS[0][0], 1.0, 1.0))
    none = np.zeros(3)
    np.testing.assert_array_equal(band_light((none, none, none), none, fit), 0.0)
    one = band_light((np.ones(1), np.full(1, 0.8), np.full(1, 0.64)), np.zeros(1), fit)
    rate, _ = star_electron_rate(np.zeros(1), np.full(1, 0.8), np.zeros(1), fit)
    assert one[0] == pytest.approx(rate[0], rel=1e-7)
    colours = np.linspace(*fit.colour_range, 50)
    rate, _ = star_electron_rate(np.zeros(50), colours, np.zeros(50), fit)
    assert brightest_electrons(fit, 1.0, 1.0) >= rate.max() * (1 - 1e-4)


def test_diffuse_light_is_its_share_of_the_sum():
    stars = np.array([10.0, 300.0])
    dust = diffuse_light(stars, 0.25)
    np.testing.assert_allclose(dust / (dust + stars), 0.25)


def test_two_stars_either_side_of_their_mean_are_exact():
    """A blue and a red one of one brightness: the sum of what each sends, far from twice one."""
    fit = gather_colour_fit(*resolve_response(BANDS[3][0], 1.0, 1.0))
    colours = np.array([0.2, 1.8])
    moments = tuple(np.array([(0.5 * colours**k).sum()]) for k in range(3))
    rate, _ = star_electron_rate(np.zeros(2), colours, np.zeros(2), fit)
    assert band_light(moments, np.zeros(1), fit)[0] == pytest.approx(rate.mean(), rel=1e-9)
