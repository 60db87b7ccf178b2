"""The noise chain: its order, its moments, and the converter at every width."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from math import floor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.physics.noise.chain import calibrated_e, layers_e, to_dn
from pipeline.physics.noise.converter import digitise, dn_type
from pipeline.physics.noise.joint import REACH, serves
from pipeline.physics.noise.streams import poisson_image, standard_normals, stream_key
from pipeline.physics.noise.terms import Chain, StreamPlace

KEYS = [stream_key(1, name) for name in ("photon_noise", "read_noise", "both")]
PLACE = StreamPlace(0, 0, 0, *KEYS)


def mean_electrons(light_e: np.ndarray, of: Chain) -> np.ndarray:
    """The sum of the layers: of the light, and of the dark current."""
    return sum(layers_e({"stars_e": light_e}, of, light_e.shape).values(), np.zeros(light_e.shape))


def chain(**changes: object) -> Chain:
    """A chain without noise or limits, but for `changes`."""
    plain: dict = {
        "flat": 1.0, "dark_e": 0.0, "full_well_e": None, "read_noise_e": 0.0,
        "gain_e_per_dn": 1.0, "bias_dn": 0.0, "adc_bits": 32, "photon_noise": False,
    }  # fmt: skip
    return Chain(**{**plain, **changes})


def converted(signal: float, bias: float, bits: int, rounding: str) -> int:
    """What the converter gives, in exact arithmetic of whole numbers and fractions."""
    exact = Fraction(signal) + Fraction(bias)
    level = round(exact) if rounding == "half_even" else floor(exact)
    return min(max(level, 0), 2**bits - 1)


@pytest.mark.parametrize("bits", range(1, 64))
@pytest.mark.parametrize("rounding", ["half_even", "floor"])
def test_against_integers_every_width(bits: int, rounding: str) -> None:
    top = 2**bits - 1
    values = [-1e300, -1e19, -7.0, -0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.5, 3.5, 100.25]
    values += [float(top) * s for s in (0.25, 0.5, 1.0, 1.5, 4.0)] + [top - 2.0**k for k in (0, 10)]
    values += [1e19, 9.3e18, 1e300]
    for bias in (0.0, 500.0, -3.0, 0.5, 100.25, -0.75, -1e6):
        out = digitise(np.array(values), bias, bits, rounding)
        assert out.dtype == dn_type(bits)
        expected = [converted(v, bias, bits, rounding) for v in values]
        for v, got, want in zip(values, out.tolist(), expected, strict=True):
            # Up to 53 bits the sum itself is a float64, as is one of 2^63 and more.
            rounded = abs(v) + abs(bias) > 2**50 if bits <= 53 else v >= 2**63
            room = max(1.0, np.spacing(min(abs(v), 2.0**62))) if rounded else 0.0
            assert abs(got - want) <= room, (v, bias, got, want)


def test_limits_63_bits_do_not_wrap() -> None:
    top = 2**63 - 1
    huge = np.array([9.3e18, 1e30, np.inf, -1e30, -np.inf, 2.0**63, 2.0**62])
    assert digitise(huge, 0.0, 63).tolist() == [top, top, top, 0, 0, top, 2**62]
    assert digitise(huge, 1e18, 63).tolist()[:5] == [top, top, top, 0, 0]
    assert digitise(huge, -500.0, 63).tolist()[3:5] == [0, 0]
    assert digitise(huge, -1e19, 63).tolist()[3:5] == [0, 0]
    assert digitise(np.zeros(1), 9.3e18, 63).tolist() == [top]
    assert digitise(np.zeros(1), 9.3e18, 60).tolist() == [2**60 - 1]


@settings(max_examples=300, deadline=None)
@given(
    st.floats(-1e6, 1e17, allow_nan=False),
    st.integers(-(2**20), 2**60),
    st.integers(54, 63),
    st.sampled_from(["half_even", "floor"]),
)
def test_against_fractions_above_53_bits(signal: float, bias: int, bits: int, rule: str) -> None:
    signal = np.rint(signal * 2**20) / 2**20 if signal < 2**30 else signal
    got = int(digitise(np.array([signal]), float(bias), bits, rule)[0])
    assert got == converted(signal, float(bias), bits, rule)


@settings(max_examples=200, deadline=None)
@given(
    st.floats(-10, 1e6), st.floats(-10, 1e6), st.integers(54, 63),
    st.sampled_from(["half_even", "floor"]),
)  # fmt: skip
def test_same_levels_on_both_sides_of_53_bits(s: float, b: float, bits: int, rule: str) -> None:
    """Fractions of signal and bias are added before they are rounded, at every width."""
    exact = Fraction(s) + Fraction(b)
    if abs(exact * 2 - round(exact * 2)) < Fraction(1, 2**30):
        return  # too near to a step for float64
    wide = int(digitise(np.array([s]), b, bits, rule)[0])
    assert wide == int(digitise(np.array([s]), b, 32, rule)[0]) == converted(s, b, bits, rule)


def test_dn_type_is_the_smallest() -> None:
    widths = {b: dn_type(b).itemsize * 8 for b in range(1, 64)}
    assert [widths[b] for b in (1, 8, 9, 16, 17, 32, 33, 63)] == [8, 8, 16, 16, 32, 32, 64, 64]


@pytest.mark.parametrize("bad", [np.nan, -1e-12, -1.0, np.inf])
def test_refuses_means_that_are_no_means(bad: float) -> None:
    mean = np.full((3, 3), 5.0)
    mean[1, 1] = bad
    with pytest.raises(ValueError, match="finite and not negative"):
        to_dn(mean, chain(), PLACE)


def test_order_of_the_paper() -> None:
    """flat on light only, + dark, Poisson, full well, + read noise, / gain, + bias, convert."""
    rng = np.random.default_rng(4)
    light, flat = rng.uniform(0, 900, (30, 40)), rng.uniform(0.8, 1.2, (30, 40))
    full = chain(
        flat=flat, dark_e=12.0, full_well_e=700.0, read_noise_e=1.4, gain_e_per_dn=1.7,
        bias_dn=90.4, adc_bits=12, photon_noise=True,
    )  # fmt: skip
    mean = mean_electrons(light, full)
    assert (mean == light * flat + 12.0).all()
    charge = np.minimum(poisson_image(mean, 0, 0, 0, *PLACE.photon_key), 700.0)
    read = standard_normals(30, 40, 0, 0, 0, *PLACE.read_key) * 1.4
    expected = np.clip(np.round((charge + read) / 1.7 + 90.4), 0, 4095)
    assert (to_dn(mean, full, PLACE) == expected).all()


def test_full_well_is_clipped_before_read_noise() -> None:
    saturated = chain(full_well_e=1000.0, read_noise_e=10.0, photon_noise=True)
    out = to_dn(np.full((200, 200), 1e6), saturated, PLACE).astype(float)
    assert out.mean() == pytest.approx(1000.0, abs=4 * 10 / 200)
    assert out.std() == pytest.approx(10.0, rel=0.02)


def test_saturation_at_both_ends_and_negative_bias() -> None:
    eight = chain(adc_bits=8, bias_dn=-20.0)
    out = to_dn(np.array([[0.0, 20.0, 25.0, 275.0, 276.0, 1e9]]), eight, PLACE)
    assert out.tolist() == [[0, 0, 5, 255, 255, 255]]
    assert out.dtype == np.uint8


def test_rounding_rules() -> None:
    mean = np.array([[0.5, 1.5, 2.5, 2.4999, 2.9999]])
    assert to_dn(mean, chain(), PLACE).tolist() == [[0, 2, 2, 2, 3]]
    assert to_dn(mean, chain(rounding="floor"), PLACE).tolist() == [[0, 1, 2, 2, 2]]


@pytest.mark.parametrize(
    ("mean", "read", "gain", "bias"), [(3.0, 4.0, 1.5, 300.0), (80.0, 0.5, 0.4, 100.25)]
)
@pytest.mark.parametrize(("rounding", "shift"), [("half_even", 0.0), ("floor", -0.5)])
def test_against_exact_moments(
    mean: float, read: float, gain: float, bias: float, rounding: str, shift: float
) -> None:
    """Mean (m + dark) / gain + bias, variance (m + dark + read^2) / gain^2 + 1/12 DN^2."""
    noisy = chain(
        dark_e=2.0, read_noise_e=read, gain_e_per_dn=gain, bias_dn=bias, photon_noise=True,
        rounding=rounding,
    )  # fmt: skip
    out = to_dn(mean_electrons(np.full((700, 700), mean), noisy), noisy, PLACE).astype(float)
    variance = (mean + 2.0 + read**2) / gain**2 + 1 / 12
    assert out.mean() == pytest.approx(
        (mean + 2.0) / gain + bias + shift, abs=4 * np.sqrt(variance) / 700
    )
    assert out.var() == pytest.approx(variance, rel=4 * np.sqrt(2.3) / 700)


def test_images_and_numbers_mean_the_same() -> None:
    mean = np.full((20, 30), 50.0)
    one = chain(flat=0.9, read_noise_e=3.0, gain_e_per_dn=2.0, bias_dn=7.0, photon_noise=True)
    grid = {k: np.full((20, 30), getattr(one, k)) for k in ("flat", "read_noise_e")}
    grid |= {k: np.full((20, 30), getattr(one, k)) for k in ("gain_e_per_dn", "bias_dn")}
    other = chain(**grid, photon_noise=True)
    assert (to_dn(mean, one, PLACE) == to_dn(mean, other, PLACE)).all()


def test_every_pixel_spills_over_at_its_own_well() -> None:
    """A map of full wells, one shallow column among deep ones: only there charge moves on."""
    mean, wells = np.full((9, 3), 10.0), np.full((9, 3), 1000.0)
    mean[4], wells[:, 1] = 100.0, 40.0
    measured = to_dn(mean, chain(blooming=True, full_well_e=wells), PLACE)
    assert measured[:, ::2].tolist() == mean[:, ::2].tolist()
    assert measured[:, 1].tolist() == [10, 10, 10, 40, 40, 40, 10, 10, 10]


def test_same_draws_when_another_component_is_switched() -> None:
    """Photon noise on or off leaves the read noise as it was, and the reverse, where each has a
    draw of its own; where both share one, what else is switched leaves it as it was."""
    mean = np.full((30, 30), 400.0)
    fine = {"gain_e_per_dn": 1e-6, "adc_bits": 40}
    both = to_dn(mean, chain(read_noise_e=1.4, photon_noise=True, **fine), PLACE).astype(float)
    photon = to_dn(mean, chain(photon_noise=True, **fine), PLACE).astype(float)
    read = to_dn(mean, chain(read_noise_e=1.4, bias_dn=1e9, **fine), PLACE).astype(float)
    assert np.abs(both - photon - (read - 400e6 - 1e9)).max() <= 2.0
    joint = chain(read_noise_e=5.0, photon_noise=True, **fine)
    plain = to_dn(mean, joint, PLACE).astype(float)
    with_well = to_dn(mean, replace(joint, full_well_e=700.0), PLACE)
    assert np.array_equal(plain, with_well)
    rays = to_dn(mean, joint, PLACE, np.full((30, 30), 64.0)).astype(float)
    assert np.abs(rays - plain - 64e6).max() <= 1.0
    keys = {"row_key": stream_key(1, "row"), "column_key": stream_key(1, "column")}
    lines = to_dn(
        mean, replace(joint, row_noise_e=2.0, column_noise_e=3.0), replace(PLACE, **keys)
    ).astype(float) - plain
    assert np.abs(lines - lines[:1] - lines[:, :1] + lines[0, 0]).max() <= 4.0


def test_same_bits_in_every_rectangle() -> None:
    rng = np.random.default_rng(0)
    mean, flat = rng.uniform(0, 1e4, (64, 96)), rng.uniform(1, 2, (64, 96))
    whole = to_dn(mean, chain(gain_e_per_dn=flat, read_noise_e=3.0, photon_noise=True), PLACE)
    part = np.s_[17:40, 50:96]
    place = StreamPlace(17, 50, 0, *KEYS)
    piece = to_dn(
        mean[part], chain(gain_e_per_dn=flat[part], read_noise_e=3.0, photon_noise=True), place
    )
    assert (piece == whole[part]).all()


@pytest.mark.parametrize("images", [False, True])
@pytest.mark.parametrize(("low", "high"), [(0.0, 40.0), (9.0, 3000.0)])
def test_pixels_that_no_one_draw_serves_take_two(images: bool, low: float, high: float) -> None:
    """Of few electrons, of little read noise or near the full well: as a chain that is bent by a
    straight line, which takes two draws everywhere. Rays that were drawn join before the well."""
    rng = np.random.default_rng(6)
    mean, rays = rng.uniform(low, high, (90, 600)), 900.0 * (rng.uniform(size=(90, 600)) > 0.97)
    terms: dict = {"read_noise_e": 1.7, "gain_e_per_dn": 1.7, "bias_dn": 90.4}
    terms["full_well_e"] = 1500.0
    if images:
        terms = {k: v * rng.uniform(0.5, 1.5, (180, 1200)) for k, v in terms.items()}
        terms = {k: v[20:110, 40:640] for k, v in terms.items()}  # as a tile sees its part
    straight = np.array([0.0, 1.0]), np.array([0.0, 1.0])
    plain = chain(**terms, adc_bits=16, photon_noise=True)
    place = replace(PLACE, x0=7)
    one = to_dn(mean, plain, place, rays)
    two = to_dn(mean, replace(plain, linearity=straight), place, rays)
    read_e, top = terms["read_noise_e"], terms["full_well_e"]
    shared = serves(mean, read_e + 0 * mean)
    shared &= mean + rays + REACH * np.hypot(np.sqrt(mean), read_e) < top
    assert 500 < shared.sum() < shared.size - 500
    assert np.array_equal(one[~shared], two[~shared])
    assert (one != two)[shared].mean() > 0.5


@pytest.mark.parametrize("rounding", ["half_even", "floor"])
@pytest.mark.parametrize("bent", [False, True])
def test_calibrated_frames_have_the_light_on_average(rounding: str, bent: bool) -> None:
    """Through the chain and back: 40 e- of light by either converter (half a DN is 1.25 e-)."""
    table = (np.array([0.0, 100.0, 1e4]), np.array([0.0, 95.0, 9e3])) if bent else None
    noisy = chain(
        flat=0.8, dark_e=2.0, read_noise_e=8.0, gain_e_per_dn=2.0, bias_dn=100.3,
        photon_noise=True, rounding=rounding, linearity=table,
    )  # fmt: skip
    dn = to_dn(mean_electrons(np.full((900, 900), 40.0), noisy), noisy, PLACE)
    scatter = np.sqrt((34.0 + 64.0 / 0.95**2 + 4.0 / 12.0) / 0.64) / 900
    assert calibrated_e(dn, noisy).mean() == pytest.approx(40.0, abs=4.0 * scatter)


def test_charge_runs_along_whole_columns() -> None:
    """In a frame that is read in bands of rows: a pixel of 200 wells fills 200 of its column, half
    of them on each side, across the bands."""
    light = np.zeros((400, 512))
    light[150, 7] = 200 * 1000.0
    out = to_dn(light, chain(full_well_e=1000.0, blooming=True), PLACE)
    full = np.flatnonzero(out[:, 7] == 1000)
    assert out.sum() == 200_000
    assert 199 <= len(full) <= 200
    assert abs(full.mean() - 150.0) <= 1.0
