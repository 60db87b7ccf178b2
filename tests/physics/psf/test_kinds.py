"""What holds for every kind of point-spread function: light, bounds, drawing, diffusion."""

from __future__ import annotations

import pickle
from dataclasses import asdict

import numpy as np
import pytest
import scipy.fft
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import erf

from pipeline.physics.drawing.stamps import draw_stamps
from pipeline.physics.drawing.wings import (
    add_wings,
    convolve,
    spread,
    wing_error,
    wing_grid,
    wing_kernel,
)
from pipeline.physics.psf.aperture import Pupil, SpiderVanes
from pipeline.physics.psf.band import Mixture, band_wavelengths
from pipeline.physics.psf.pupil import (
    Airy,
    Blur,
    EllipticalGaussian,
    Gaussian,
    Optics,
    beyond_sum,
)
from pipeline.physics.psf.radial import light_beyond, mean_over_directions
from pipeline.physics.psf.response import (
    compact_core,
    core_spectrum,
    oversampling_for,
    phase_table,
    stamp_at,
    window,
)
from pipeline.physics.psf.sampled import sampled
from pipeline.physics.psf.seeing import Kolmogorov, Moffat

ZERO = np.zeros(1)


def name(optics: Optics) -> str:
    return f"{type(optics).__name__}-{optics.scale_px:.3g}px"


def band(q: float) -> Mixture:
    nodes, weights = band_wavelengths(np.array([400e-9, 900e-9]), np.ones(2), 4)
    return Mixture(tuple(Airy(q * w / 650e-9, 0.3) for w in nodes), tuple(map(float, weights)))


def table() -> Optics:
    at = (np.arange(257) - 128) / 16
    return sampled(Gaussian(0.8).intensity(np.hypot(at[:, None], at[None, :])), 1 / 16, "middle")


KINDS: list[Optics] = [
    Gaussian(0.05), Gaussian(1.0), Gaussian(50.0), EllipticalGaussian(3.0, 0.4, 1.0), Airy(0.1),
    Airy(1.0, 0.3), Airy(8.0, 0.95), Pupil(0.1, 0.3, SpiderVanes(4, 0.02)),
    Pupil(1.0, 0.0, SpiderVanes(3, 0.05), ((8, 0.1),)), Pupil(8.0, 0.95, None, ((4, 0.2),)),
    band(0.1),
    band(2.0), Moffat(0.5, 1.5), Moffat(3.0, 4.765), Moffat(100.0, 2.5), Kolmogorov(2.0),
    Kolmogorov(0.3, Airy(1.0, 0.3)), Kolmogorov(60.0, Airy(0.1)), table(),
]  # fmt: skip
WINGED: list[Optics] = [
    Pupil(0.8, 0.3, SpiderVanes(4, 0.03, 0.3), ((8, 0.06),)), band(1.0), Moffat(2.5, 2.2),
    Kolmogorov(2.5), Kolmogorov(1.0, Airy(0.8, 0.3)),
]  # fmt: skip


@pytest.mark.parametrize("optics", KINDS, ids=name)
def test_all_light_is_there_and_nothing_beyond_the_band(optics: Optics) -> None:
    for fill in (1.0, 0.3):
        blur = Blur(optics, 0.2, 0.1, fill)
        assert blur.transfer(ZERO, ZERO)[0].real == pytest.approx(fill, abs=2e-7)
    rng = np.random.default_rng(1)
    for floor in (1e-3, 1e-9):
        edge = optics.band_limit(floor)
        angle, f = rng.uniform(0, 2 * np.pi, 200), edge * rng.uniform(1.0 + 1e-9, 4.0, 200)
        assert np.abs(optics.transfer(f * np.sin(angle), f * np.cos(angle))).max() <= 1.01 * floor
    f = rng.uniform(-1, 1, (2, 300)) * optics.band_limit(1e-3)
    there, back = optics.transfer(*f), optics.transfer(*-f)
    assert np.abs(there - np.conj(back)).max() < 1e-12
    assert np.abs(there).max() <= 1.0 + 1e-3


@pytest.mark.parametrize("optics", KINDS, ids=name)
def test_kinds_are_keys_and_travel(optics: Optics) -> None:
    back = pickle.loads(pickle.dumps(optics))
    assert back == optics
    assert hash(back) == hash(optics)
    assert {Blur(optics): 1}[Blur(back)] == 1
    assert isinstance(asdict(optics), dict)
    f = np.linspace(-1.0, 1.0, 5)
    assert np.array_equal(back.transfer(f, f), optics.transfer(f, f))
    assert optics.transfer(f[:, None], f[None, :]).shape == (5, 5)


@pytest.mark.parametrize("optics", KINDS, ids=name)
def test_light_beyond_falls_and_bounds_what_is_there(optics: Optics) -> None:
    radii = optics.scale_px * np.geomspace(0.01, 1e4, 120)
    light = [min(1.0, optics.light_beyond(float(r))) for r in radii]
    assert light[0] > 0.9
    assert (np.diff(light) <= 0).all()
    band_px = optics.band_limit(1e-12 if not isinstance(optics, Airy | Pupil) else 0.5)
    for times in (5.0, 20.0):
        r = times * optics.scale_px
        exact = light_beyond(mean_over_directions(optics.transfer), band_px, r)
        assert exact <= 1.15 * optics.light_beyond(r) + 2e-5


@pytest.mark.parametrize("optics", [Moffat(2.0, 2.5), Kolmogorov(3.0), band(1.0),
                                    Pupil(1.0, 0.3, None, ((4, 0.1),))], ids=name)  # fmt: skip
def test_the_sum_of_two_blurs_is_bounded(optics: Optics) -> None:
    """Never less than is there; far out within 60%."""
    blur = Blur(optics, 1.2, 0.9)
    mtf = mean_over_directions(blur.image)
    for r in (2.0, 6.0, 20.0, 80.0):
        exact = light_beyond(mtf, blur.band_limit(1e-12), r)
        bound = blur.light_beyond(r)
        assert bound == beyond_sum(optics, Gaussian(1.5), r)
        assert exact <= 1.04 * bound
        if r > 40.0:
            assert bound < 1.6 * exact


@settings(max_examples=40)
@given(st.floats(0.05, 50.0), st.floats(0.05, 50.0), st.floats(-7.0, 7.0))
def test_elliptical_gaussians(major: float, minor: float, angle: float) -> None:
    major, minor = max(major, minor), min(major, minor)
    e = EllipticalGaussian(major, minor, angle)
    f = np.random.default_rng(3).uniform(-1, 1, (2, 50)) / major
    covariance = np.array([[np.sin(angle) ** 2, np.sin(angle) * np.cos(angle)],
                           [np.sin(angle) * np.cos(angle), np.cos(angle) ** 2]])  # fmt: skip
    covariance = minor**2 * np.eye(2) + (major**2 - minor**2) * covariance
    form = np.einsum("ik,ij,jk->k", f, covariance, f)
    assert e.transfer(*f) == pytest.approx(np.exp(-2 * np.pi**2 * form), rel=1e-9)
    round_one = EllipticalGaussian(major, major, angle).transfer(*f)
    assert round_one == pytest.approx(Gaussian(major).transfer(*f), rel=1e-9)


def stamper(blur: Blur, radius: float):  # type: ignore[no-untyped-def]
    core = compact_core(blur, radius)
    half_y, half_x, *period = window(core, 0.0, 0.0)
    return core, core_spectrum(core, *period), (half_y, half_x), (period[0], period[1])


def test_elliptical_gaussian_drawn_along_its_axes() -> None:
    """At 0 and 90 degrees it is a product of two error functions."""
    for angle, (sy, sx) in ((0.0, (0.5, 1.5)), (np.pi / 2, (1.5, 0.5))):
        swept = stamper(Blur(EllipticalGaussian(1.5, 0.5, angle)), 9.2)
        row, column, stamp = stamp_at(*swept, 0.3, -0.2)
        parts = []
        for first, place, sigma, n in ((row, 0.3, sy, 0), (column, -0.2, sx, 1)):
            edge = first - 0.5 + np.arange(stamp.shape[n] + 1) - place
            parts.append(0.5 * np.diff(erf(edge / (sigma * np.sqrt(2.0)))))
        assert np.abs(stamp - np.outer(*parts)).max() < 1e-6


@pytest.mark.parametrize("optics", KINDS, ids=name)
def test_diffusion_and_jitter_are_gaussian_transfers(optics: Optics) -> None:
    f = np.random.default_rng(2).uniform(-1, 1, (2, 100))
    whole = Blur(optics, 0.3, 0.4).transfer(*f)
    spread_out = np.exp(-2 * np.pi**2 * 0.25 * (f[0] ** 2 + f[1] ** 2))
    expected = optics.transfer(*f) * spread_out * np.sinc(f[0]) * np.sinc(f[1])
    assert np.abs(whole - expected).max() < 1e-14


@pytest.mark.parametrize("optics", WINGED, ids=name)
def test_core_and_wings_together_against_the_whole_response(optics: Optics) -> None:
    """Drawn with a core and a coarse grid; against one large transform of the whole response."""
    blur = Blur(optics, 0.1, 0.15)
    radius, size, reach = blur.core_px, 81, 320.0
    spacing = int(2 ** max(1, np.floor(np.log2(radius / 5.0))))
    swept = stamper(blur, radius)
    grid = wing_grid((size, size), (0, 0), spacing, reach)
    kernel = wing_kernel(blur, swept[0], grid, reach)
    stated = wing_error(blur, swept[0], spacing)
    os, period = 4, 800
    n = os * period
    fy, fx = scipy.fft.fftfreq(n, 1 / os)[:, None], scipy.fft.rfftfreq(n, 1 / os)[None, :]
    whole = scipy.fft.irfft2(blur.transfer(fy, fx), s=(n, n)) * os**2
    for y, x in ((40.0, 40.0), (40.25, 39.5), (39.75, 40.5)):
        place = (np.array([x]), np.array([y]), np.ones(1))
        image = np.zeros((size, size))
        field = convolve(scipy.fft.rfft2(spread(grid, *place)) * kernel, grid)
        add_wings(image, (0, 0), grid, field)
        row, column, stamp = stamp_at(*swept, y, x)
        image[row : row + stamp.shape[0], column : column + stamp.shape[1]] += stamp
        rows = (np.round((np.arange(size) - y) * os).astype(int)) % n
        columns = (np.round((np.arange(size) - x) * os).astype(int)) % n
        exact = whole[np.ix_(rows, columns)]
        # A uniform part comes from the light beyond the large transform's own period.
        far = blur.light_beyond(period / 2.0) / period**2
        assert np.abs(image - exact).max() < 1.3 * stated + 4.0 * far + 2e-6
    total = swept[0].light + float(kernel[0, 0].real) * spacing**2
    lost = 1.0 - total
    assert 0.5 * blur.light_beyond(reach) < lost < 1.3 * blur.light_beyond(0.9 * reach) + 1e-6


@pytest.mark.parametrize("optics", [Pupil(1.0, 0.3, SpiderVanes(3, 0.05)),
                                    Pupil(1.0, 0.3, SpiderVanes(4, 0.02)), band(1.0), Moffat(2.0,
                                    2.5),
                                    Kolmogorov(1.0, Airy(1.0))], ids=name)  # fmt: skip
def test_wings_fall_at_least_as_said(optics: Optics) -> None:
    blur = Blur(optics)
    radius = blur.core_px
    spacing = int(2 ** max(1, np.floor(np.log2(radius / 5.0))))
    first, second = (wing_error(blur, compact_core(blur, radius * k), spacing) for k in (1.0, 2.0))
    assert second <= first / optics.wing_fall(radius)


@pytest.mark.parametrize("optics", [*WINGED, EllipticalGaussian(1.2, 0.5, 0.4), table()], ids=name)
def test_phase_tables_hold_their_stated_errors(optics: Optics) -> None:
    blur = Blur(optics)
    swept = stamper(blur, blur.core_px)
    response = phase_table(*swept, 32)
    worst = {False: 0.0, True: 0.0}
    for y, x in np.random.default_rng(9).uniform(60, 61, (8, 2)):
        row, column, stamp = stamp_at(*swept, y, x)
        for cubic in worst:
            image = np.zeros((121, 121))
            draw_stamps(image, (0, 0), response, *np.array([[x], [y], [1.0]]), np.array([cubic]))
            part = image[row : row + stamp.shape[0], column : column + stamp.shape[1]]
            worst[cubic] = max(worst[cubic], float(np.abs(part - stamp).max()))
    cut = 1.01e-8 * response.peak
    assert worst[False] <= response.linear_error + cut
    assert worst[True] <= response.cubic_error + cut
    assert response.linear_error < 2e-3


@pytest.mark.parametrize("optics", KINDS, ids=name)
def test_limits_of_sampling_are_kept(optics: Optics) -> None:
    """Samples a pixel are bounded, and enough for all but the sharpest."""
    os = oversampling_for(Blur(optics))
    assert 2 <= os <= 128
    edge = np.full(1, os / 2.0)
    assert np.abs(Blur(optics).image(edge, ZERO)).max() < 1e-8
