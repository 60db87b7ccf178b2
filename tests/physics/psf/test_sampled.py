"""Tables of light against direct transforms and the patterns that they were made from."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import erfc

from pipeline.errors import BadInput
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.psf.response import (
    compact_core,
    core_spectrum,
    phase_table,
    stamp_at,
    window,
)
from pipeline.physics.psf.sampled import (
    FINE_BAND,
    MOST_LEFT_OUT,
    READ_ERROR,
    Sampled,
    find_centre,
    sampled,
)

RNG = np.random.default_rng(4)


def gaussian_table(
    n: tuple[int, int], centre: tuple[float, float], sigma_samples: float
) -> np.ndarray:
    y, x = (np.arange(k) - c for k, c in zip(n, centre, strict=True))
    return np.exp(-0.5 * (y[:, None] ** 2 + x[None, :] ** 2) / sigma_samples**2)


@settings(max_examples=30)
@given(
    st.integers(3, 40), st.integers(3, 40), st.floats(0.02, 1.0), st.floats(0.0, 1.0),
    st.floats(0.0, 1.0), st.integers(0, 2**31),
)  # fmt: skip
def test_against_direct_fourier_sums(
    ny: int, nx: int, spacing: float, cy: float, cx: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    table = rng.uniform(0, 1, (ny, nx)) ** 4
    centre = (cy * (ny - 1), cx * (nx - 1))
    s = sampled(table, spacing, centre, 0.9)
    f = rng.uniform(-0.5 / spacing, 0.5 / spacing, (40, 2))
    f[:3] = np.array([[0.5, 0.5], [-0.5, 0.0], [0.0, 0.0]]) / spacing
    f = f[np.hypot(f[:, 0], f[:, 1]) < s.band.limit * (1.0 - 1e-9)]
    y, x = (np.arange(ny) - centre[0]) * spacing, (np.arange(nx) - centre[1]) * spacing
    down, along = (np.exp(-2j * np.pi * np.outer(a, b)) for a, b in ((f[:, 0], y), (f[:, 1], x)))
    direct = 0.9 * ((down @ (table / table.sum())) * along).sum(axis=1)
    assert np.abs(s.transfer(f[:, 0], f[:, 1]) - direct).max() < READ_ERROR
    beyond = np.array([0.6 / spacing])
    assert s.transfer(beyond, np.zeros(1))[0] == 0.0


def pixel_light(airy: Airy, dy: float, dx: float) -> float:
    """Light of a pattern in a pixel whose centre is (dy, dx) away, by Gauss-Legendre."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    at = (((np.arange(8)[:, None] + 0.5 + nodes / 2) / 8).ravel()) - 0.5
    w = np.tile(weights / 16, 8)
    return float(w @ airy.intensity(np.hypot(dx + at, dy + at[:, None])) @ w)


@pytest.mark.parametrize(("q", "n", "per_px"), [(0.5, 512, 32), (1.0, 511, 16), (2.0, 400, 8)])
def test_round_trip_of_an_airy_image(q: float, n: int, per_px: int) -> None:
    """A star drawn from the table against quadrature of the pattern: 1e-4 of the peak.

    The table ends where 1 - 2% of the light is still to come; it is told so, and loses as much.
    """
    airy, at = Airy(q, 0.3), (np.arange(n) - 0.5 * (n - 1)) / per_px
    image = airy.intensity(np.hypot(at[:, None], at[None, :]))
    held = float(image.sum()) / per_px**2
    s = sampled(image, 1.0 / per_px, "middle", held)
    core = compact_core(Blur(s), s.reach_px)
    half_y, half_x, *period = window(core, 0.0, 0.0)
    spectrum = core_spectrum(core, *period)
    half = int(0.4 * n / per_px)
    for y, x in ((0.0, 0.0), (0.3, 0.71), (0.5, 0.5)):
        row, column, stamp = stamp_at(
            core, spectrum, (half_y, half_x), (period[0], period[1]), y, x
        )
        for _ in range(25):
            r, c = RNG.integers(-half, half + 1, 2)
            off = stamp[r - row, c - column] - pixel_light(airy, r - y, c - x)
            assert abs(off) < 1e-4 * pixel_light(airy, 0.0, 0.0)
        assert stamp.sum() == pytest.approx(held, abs=1e-4)
    assert s.band.limit <= max(2.5 / q, FINE_BAND)  # the table's empty band is found
    assert s.band.left_out <= MOST_LEFT_OUT
    assert s.band.nyquist < 1e-3


@pytest.mark.parametrize("shape", [(64, 64), (65, 65), (64, 65)])
def test_half_a_sample_of_even_tables(shape: tuple[int, int]) -> None:
    """A pattern centred on sample n // 2 of an even table, and one centred between two samples.

    Read by the wrong rule the star moves by half a sample on each even axis; by the right one not
    at all. Odd tables have one middle, and both rules agree.
    """
    per_px, f = 4.0, np.array([0.01])
    zero = np.zeros(1)
    for rule, centre in (
        ("sample", tuple(float(n // 2) for n in shape)),
        ("middle", tuple(0.5 * (n - 1) for n in shape)),
    ):
        table = gaussian_table(shape, (centre[0], centre[1]), 5.0)
        for read in ("sample", "middle"):
            s = sampled(table, 1.0 / per_px, read)
            moved = [
                -float(np.angle(s.transfer(*at)[0])) / (2 * np.pi * 0.01)
                for at in ((f, zero), (zero, f))
            ]
            half = {"sample": -0.5, "middle": 0.5}[read] / per_px
            for axis in (0, 1):
                expected = 0.0 if rule == read or shape[axis] % 2 else half
                assert moved[axis] == pytest.approx(expected, abs=1e-6)
        for read in ("peak", "centroid"):
            row, column = find_centre(table, read)
            assert abs(row - centre[0]) < (0.6 if read == "peak" else 1e-6)
            assert abs(column - centre[1]) < (0.6 if read == "peak" else 1e-6)


@pytest.mark.parametrize("centre", ["middle", "sample"])
@pytest.mark.parametrize("n", [64, 63])
def test_the_drawn_star_stands_where_it_should(n: int, centre: str) -> None:
    place = 0.5 * (n - 1) if centre == "middle" else float(n // 2)
    s = sampled(gaussian_table((n, n), (place, place), 6.0), 0.125, centre)
    core = compact_core(Blur(s), s.reach_px)
    half_y, half_x, *period = window(core, 0.0, 0.0)
    spectrum = core_spectrum(core, *period)
    for y, x in ((20.0, 30.0), (20.25, 30.8)):
        row, column, stamp = stamp_at(
            core, spectrum, (half_y, half_x), (period[0], period[1]), y, x
        )
        rows, columns = stamp.sum(axis=1), stamp.sum(axis=0)
        assert rows @ (row + np.arange(rows.size)) / rows.sum() == pytest.approx(y, abs=2e-3)
        assert columns @ (column + np.arange(columns.size)) / columns.sum() == pytest.approx(
            x, abs=2e-3
        )


def test_phase_table_of_a_table_within_its_stated_errors() -> None:
    from pipeline.physics.drawing.stamps import draw_stamps

    at = (np.arange(512) - 255.5) / 32
    image = Airy(0.6, 0.3).intensity(np.hypot(at[:, None] - 0.2, 0.8 * at[None, :]))
    s = sampled(image, 1.0 / 32, "middle")
    core = compact_core(Blur(s, 0.1, 0.2), s.reach_px)
    half_y, half_x, *period = window(core, 0.0, 0.0)
    spectrum = core_spectrum(core, *period)
    table = phase_table(core, spectrum, (half_y, half_x), (period[0], period[1]), 32)
    for y, x in RNG.uniform(30, 31, (8, 2)):
        row, column, stamp = stamp_at(
            core, spectrum, (half_y, half_x), (period[0], period[1]), y, x
        )
        for cubic, bound in ((False, table.linear_error), (True, table.cubic_error)):
            drawn = np.zeros((61, 61))
            draw_stamps(drawn, (0, 0), table, *np.array([[x], [y], [1.0]]), np.array([cubic]))
            part = drawn[row : row + stamp.shape[0], column : column + stamp.shape[1]]
            assert np.abs(part - stamp).max() <= bound + 1.01e-8 * table.peak
    assert core.light == pytest.approx(1.0, abs=1e-4)


def test_a_coarse_table_says_so() -> None:
    """A sharp star sampled once a pixel: what it says at the highest frequency is not small."""
    sharp = sampled(gaussian_table((33, 33), (16.0, 16.0), 0.5), 1.0, "middle")
    assert sharp.band.nyquist > 0.1
    assert sharp.band_limit(1e-9) <= np.sqrt(0.5) + 1e-9
    fine = sampled(gaussian_table((129, 129), (64.0, 64.0), 8.0), 1.0 / 16, "middle")
    assert fine.band.nyquist < 1e-6
    f = np.linspace(0, 2, 9)
    assert np.abs(fine.transfer(f, f) - Gaussian(0.5).transfer(f, f)).max() < 1e-6


def test_light_beyond_counts_the_samples() -> None:
    table = np.zeros((9, 9))
    table[4, 4], table[4, 6], table[0, 4] = 2.0, 1.0, 1.0
    s = sampled(table, 0.5, "middle")
    assert s.light_beyond(0.0) == pytest.approx(0.5)
    assert s.light_beyond(0.99) == pytest.approx(0.5)
    assert s.light_beyond(1.0) == pytest.approx(0.25)
    assert s.light_beyond(2.0) == 0.0
    assert s.reach_px == 2.0
    assert not s.has_wings
    wide = sampled(np.ones((300, 300)), 0.5, "middle")
    assert wide.has_wings
    assert wide.core_px >= 12.0


def test_pixels_that_the_table_holds_are_not_applied_again() -> None:
    s = sampled(gaussian_table((33, 33), (16.0, 16.0), 4.0), 0.25, "middle", 0.8)
    f = np.array([0.3])
    zero = np.zeros(1)
    held = Blur(s, fill_factor=0.9, pixel_in_optics=True)
    assert held.transfer(f, zero) == pytest.approx(0.9 * s.transfer(f, zero))
    assert held.transfer(zero, zero)[0].real == pytest.approx(0.72)
    assert Blur(s).transfer(f, zero) == pytest.approx(np.sinc(0.3) * s.transfer(f, zero))


def test_tables_are_equal_by_content_and_travel() -> None:
    table = gaussian_table((16, 17), (8.0, 8.0), 2.0)
    one, same = sampled(table, 0.5, "centroid"), sampled(4.0 * table, 0.5, "centroid")
    other = sampled(table, 0.25, "centroid")
    assert one == same
    assert hash(one) == hash(same)
    assert one != other
    back: Sampled = pickle.loads(pickle.dumps(one))
    assert back == one
    f = np.linspace(-0.9, 0.9, 7)
    assert np.array_equal(back.transfer(f, f), one.transfer(f, f))


def test_everything_in_a_table_counts() -> None:
    """Caches hand out what is known of an equal one: each use has its own light, place, size."""
    table = gaussian_table((12, 13), (6.0, 6.0), 2.0)
    other = table + np.eye(12, 13)
    made = [
        sampled(table, 0.5, (6.0, 6.0)),
        sampled(table, 0.5, (6.0, 6.0), 0.8),
        sampled(table, 0.5, (6.0, 5.0)),
        sampled(table, 0.5, (5.0, 6.0)),
        sampled(table, 0.25, (6.0, 6.0)),
        sampled(table.reshape(13, 12), 0.5, (6.0, 6.0)),
        sampled(other, 0.5, (6.0, 6.0)),
    ]
    assert len(set(made)) == len({m.digest for m in made}) == len(made)
    zero = np.zeros(1)
    lights = [abs(m.transfer(zero, zero)[0]) for m in made]
    assert lights == pytest.approx([1.0, 0.8, 1.0, 1.0, 1.0, 1.0, 1.0], abs=1e-12)


@pytest.mark.parametrize(
    ("spoil", "what"),
    [
        (lambda t: np.where(t > 0.9, np.nan, t), "NaN"),
        (lambda t: np.where(t > 0.9, np.inf, t), "infinite"),
        (lambda t: t - 0.01, "negative"),
        (lambda t: 0.0 * t, "zeros"),
        (lambda t: t[:2], "shape"),
        (lambda t: t[0], "shape"),
        (lambda t: np.zeros((2049, 5)), "shape"),
    ],
)
def test_tables_that_are_none_are_refused(spoil, what: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(BadInput, match=what):
        sampled(spoil(gaussian_table((16, 16), (8.0, 8.0), 2.0)), 0.5, "middle")
    with pytest.raises(BadInput, match="centroid"):
        sampled(np.ones((5, 5)), 0.5, "corner")


@pytest.mark.parametrize("n", [3, 4, 1001])
def test_limits_of_size(n: int) -> None:
    table = np.zeros((n, n))
    table[n // 2, n // 2] = 1.0
    s = sampled(table, 1.0 / 32, "sample")
    f = np.array([0.0, 1.0, 15.0])
    assert np.abs(s.transfer(f, 0 * f) - 1.0).max() < 1e-6


@pytest.mark.parametrize(("sigma", "per_px"), [(0.6, 16), (1.0, 4), (1.0, 8)])
def test_a_table_of_a_gaussian_is_that_gaussian(sigma: float, per_px: int) -> None:
    """Against the error function: to 3e-14 of the light, for the brightest source is 2e12 e-."""
    half = int(8.5 * sigma * per_px)
    shape = (2 * half + 1, 2 * half + 1)
    s = sampled(gaussian_table(shape, (half, half), sigma * per_px), 1.0 / per_px, "middle")
    core = compact_core(Blur(s), s.reach_px)
    half_y, half_x, *period = window(core, 0.0, 0.0)
    spectrum = core_spectrum(core, *period)
    place = (half_y, half_x), (period[0], period[1]), 0.3, 0.7
    row, column, stamp = stamp_at(core, spectrum, *place)

    def side(first: int, count: int, at: float) -> np.ndarray:
        x = np.abs(first + np.arange(count) - at)
        return 0.5 * (erfc((x - 0.5) / sigma / 2**0.5) - erfc((x + 0.5) / sigma / 2**0.5))

    exact = np.outer(side(row, stamp.shape[0], 0.3), side(column, stamp.shape[1], 0.7))
    assert np.abs(stamp - exact).max() < 3e-14
    assert stamp.min() > -3e-14


def test_what_the_cut_band_leaves_out_is_measured() -> None:
    """A table with an edge has no end of its band: against all of it, drawn from its samples."""
    n, per_px = 96, 16
    at = (np.arange(n) - 0.5 * (n - 1)) / per_px
    image = np.exp(-0.5 * (at[:, None] ** 2 + at[None, :] ** 2) / 1.2**2)
    s = sampled(image, 1.0 / per_px, "middle")
    assert s.band.limit < 0.5 * per_px
    y, x = np.array([0.0, 2.9, -3.0, 1.7]), np.array([0.0, 2.1, 2.95, -3.03])
    f = np.linspace(-0.5 * per_px, 0.5 * per_px, 1024, endpoint=False)
    k = np.arange(n) - 0.5 * (n - 1)
    turns = np.exp(-2j * np.pi * np.outer(f, k / per_px))
    whole = (turns @ s.samples @ turns.T) * np.sinc(f)[:, None] * np.sinc(f)[None, :]
    beyond = whole * (np.hypot(f[:, None], f[None, :]) >= s.band.limit)
    step = (f[1] - f[0]) ** 2
    for a, b in zip(y, x, strict=True):
        back = np.exp(2j * np.pi * f * a) @ beyond @ np.exp(2j * np.pi * f * b)
        assert abs(back) * step <= s.band.left_out
    assert s.band.left_out < MOST_LEFT_OUT


def test_sizes_of_a_table_of_a_gaussian() -> None:
    """Half of the light within sigma sqrt(2 ln 2), 99% within sigma sqrt(2 ln 100)."""
    s = sampled(gaussian_table((401, 383), (190.0, 201.5), 24.0), 0.25, (190.0, 201.5))
    assert s.scale_px == pytest.approx(6.0 * np.sqrt(2.0 * np.log(2.0)), rel=5e-3)
    assert s.core_px == pytest.approx(1.2 * 6.0 * np.sqrt(2.0 * np.log(100.0)), rel=5e-3)


@pytest.mark.parametrize("floor", [0.5, 1e-2, 1e-4])
def test_the_band_limit_is_where_the_transfer_falls_to_a_floor(floor: float) -> None:
    """Of a Gaussian exp(-2 (pi sigma f)^2): not before, and at most two rings beyond."""
    sigma_px = 1.5
    s = sampled(gaussian_table((64, 48), (31.0, 24.0), 2.0 * sigma_px), 0.5, (31.0, 24.0))
    falls = np.sqrt(0.5 * np.log(1.0 / floor)) / (np.pi * sigma_px)
    assert falls <= s.band_limit(floor) <= falls + 2.0 * s.band.step
    assert s.band_limit(2.0) <= s.band.step  # nothing is above twice all light
