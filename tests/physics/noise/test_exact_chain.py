"""Mean and variance of every chain against exact sums, and the photon-transfer curve."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from math import floor

import numpy as np
import pytest
from scipy import stats

from pipeline.physics.noise.chain import to_dn
from pipeline.physics.noise.streams import stream_key
from pipeline.physics.noise.terms import Chain, StreamPlace

KEYS = [stream_key(1, name) for name in ("photon_noise", "read_noise", "both")]
PLACE = StreamPlace(0, 0, 0, *KEYS)
MEAN_E, READ_E, GAIN = 23.0, 2.5, 0.75
CHAINS = list(product([True, False], [True, False], ["floor", "half_even"]))


def levels_of(bias: float, photon: bool, read: bool, rounding: str, top: int) -> dict[int, float]:
    """Probability of each digital number: sums over electrons, normal integrals between steps."""
    electrons = {int(MEAN_E): 1.0}
    if photon:
        electrons = {n: float(stats.poisson.pmf(n, MEAN_E)) for n in range(120)}
    out: dict[int, float] = {}

    def add(level: int, share: float) -> None:
        held = min(max(level, 0), top)
        out[held] = out.get(held, 0.0) + share

    for n, share in electrons.items():
        if not read:
            exact = Fraction(n / GAIN) + Fraction(bias)
            add(round(exact) if rounding == "half_even" else floor(exact), share)
            continue
        base = floor(Fraction(n / GAIN) + Fraction(bias))
        offset = float(Fraction(n / GAIN) + Fraction(bias) - base)  # of the mean, from `base`
        shift = 0.5 if rounding == "half_even" else 0.0
        steps = np.arange(-40, 42) - shift
        shares = np.diff(stats.norm.cdf(steps, offset, READ_E / GAIN))
        for k, part in zip(range(-40, 41), shares, strict=True):
            add(base + k, share * float(part))
    return out


@pytest.mark.parametrize("bits", range(1, 64))
def test_against_exact_sums(bits: int) -> None:
    """All eight chains: mean and variance within 4.5 of their own standard errors."""
    top = 2**bits - 1
    n = 96 * 96
    for photon, read, rounding in CHAINS:
        bias = max(0.0, float(2 ** (bits - 1)) - MEAN_E / GAIN) + 0.3
        chain = Chain(
            1.0, 0.0, None, READ_E if read else 0.0, GAIN, bias, bits, rounding, photon
        )
        dn = to_dn(np.full((96, 96), MEAN_E), chain, PLACE)
        law = levels_of(bias, photon, read, rounding, top)
        origin = min(law)
        level = np.array([k - origin for k in law], float)
        share = np.array(list(law.values()))
        mean = float(level @ share)
        second, fourth = (float((level - mean) ** m @ share) for m in (2, 4))
        seen = (dn.astype(np.int64) - origin).astype(float)
        assert share.sum() == pytest.approx(1.0, abs=1e-9)
        assert abs(seen.mean() - mean) <= 4.5 * np.sqrt(second / n) + 1e-9
        assert abs(((seen - mean) ** 2).mean() - second) <= (
            4.5 * np.sqrt(max(fourth - second**2, 0.0) / n) + 1e-9
        )


def test_photon_transfer_curve() -> None:
    """Pairs of flats at rising light give back gain, read noise and full well."""
    gain, read_e, full_well_e, side = 1.7, 6.0, 40_000.0, 256
    chain = Chain(1.0, 5.0, full_well_e, read_e, gain, 300.0, 16)
    light = np.concatenate([[0.0], np.geomspace(20, 30_000, 12), [60_000.0]])
    mean, variance = np.empty((2, light.size))
    for i, electrons in enumerate(light):
        a, b = (
            to_dn(
                np.full((side, side), electrons + 5.0), chain,
                StreamPlace(0, 0, 2 * i + k, *KEYS),
            ).astype(float)
            for k in (0, 1)
        )  # fmt: skip
        mean[i] = 0.5 * (a.mean() + b.mean()) - 300.0
        variance[i] = 0.5 * (a - b).var()
    sigma = variance * np.sqrt(2.0 / side**2)
    use = slice(0, -1)
    (slope, floor_), covariance = np.polyfit(
        mean[use], variance[use], 1, w=1 / sigma[use], cov="unscaled"
    )
    assert abs(slope - 1 / gain) < 4 * np.sqrt(covariance[0, 0])
    assert abs(floor_ - (read_e / gain) ** 2 - 1 / 12) < 4 * np.sqrt(covariance[1, 1])
    assert 1 / slope == pytest.approx(gain, rel=0.01)
    read = gain * np.sqrt(floor_ - 1 / 12)
    assert read == pytest.approx(read_e, rel=0.02)
    assert mean[-1] * gain == pytest.approx(full_well_e, abs=4 * read_e / side)
    assert variance[-1] == pytest.approx((read_e / gain) ** 2 + 1 / 12, rel=0.03)
