"""Transfer functions against brute-force pupils, quadrature and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0, j1

from pipeline.physics.psf.pupil import Airy, Blur, Gaussian


def airy_intensity(r_px: np.ndarray, q_px: float, eps: float) -> np.ndarray:
    """Obscured Airy pattern per unit total flux, per px^2."""
    x = np.pi * np.maximum(r_px, 1e-9) / q_px
    inner = eps * 2.0 * j1(eps * x) / x if eps else 0.0
    return np.pi / (4.0 * q_px**2 * (1.0 - eps**2)) * (2.0 * j1(x) / x - inner) ** 2


def encircled(radius_px: float, q_px: float, eps: float) -> float:
    """Light inside a radius, by Gauss-Legendre quadrature over pieces of q / 4."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    edges = np.linspace(0.0, radius_px, int(np.ceil(4 * radius_px / q_px)) + 2)
    half = 0.5 * np.diff(edges)[:, None]
    r = 0.5 * (edges[1:] + edges[:-1])[:, None] + half * nodes
    return float((half * weights * 2.0 * np.pi * r * airy_intensity(r, q_px, eps)).sum())


@pytest.mark.parametrize("q", [0.12, 1.0, 4.0])
def test_against_closed_form_of_the_full_pupil(q: float) -> None:
    v = np.linspace(0.0, 1.0, 301)
    closed = 2.0 / np.pi * (np.arccos(v) - v * np.sqrt(1.0 - v * v))
    assert np.abs(Airy(q).transfer(v / q, np.zeros(301)) - closed).max() < 1e-14
    assert Airy(q).transfer(np.array(1.01 / q), np.array(0.0)) == 0.0


@pytest.mark.parametrize("eps", [0.0, 0.3, 0.7, 0.95])
def test_against_autocorrelation_of_a_sampled_pupil(eps: float) -> None:
    n, radius, sub = 1024, 200, 8
    at = (np.arange(-radius * sub - sub, radius * sub + sub) + 0.5) / sub
    r = np.hypot(at[:, None], at[None, :])
    fine = ((r < radius) & (r >= eps * radius)).astype(np.float32)
    side = fine.shape[0] // sub
    pupil = fine.reshape(side, sub, side, sub).mean(axis=(1, 3))
    spectrum = np.abs(np.fft.rfft2(pupil, s=(n, n))) ** 2
    overlap = np.fft.irfft2(spectrum, s=(n, n))
    overlap /= pupil.sum()  # not overlap[0, 0]: the grey edge pixels count whole in the area
    shift = np.arange(1, 2 * radius + 2)
    diagonal = np.arange(1, 283)
    airy = Airy(1.0, eps)
    along = airy.transfer(np.zeros(shift.size), shift / (2.0 * radius))
    across = airy.transfer(diagonal / (2.0 * radius), diagonal / (2.0 * radius))
    assert np.abs(overlap[0, shift] - along).max() < 1.5e-3 / (1.0 - eps)
    assert np.abs(overlap[diagonal, diagonal] - across).max() < 1.5e-3 / (1.0 - eps)


@pytest.mark.parametrize(("q", "eps"), [(1.0, 0.0), (1.0, 0.3), (0.25, 0.6), (3.0, 0.95)])
def test_against_hankel_transform_of_the_intensity(q: float, eps: float) -> None:
    radial = np.linspace(0.0, 1.0 / q, 20_001)
    mtf = Airy(q, eps).transfer(np.zeros_like(radial), radial)
    for r in np.array([0.0, 0.3, 0.61, 1.22, 2.7, 5.0]) * q:
        value = np.trapezoid(mtf * j0(2 * np.pi * radial * r) * 2 * np.pi * radial, radial)
        assert value == pytest.approx(float(airy_intensity(np.array(r), q, eps)), abs=1e-6 / q**2)


def test_against_encircled_energy_of_the_airy_disc() -> None:
    x = np.pi * 1.2196698912665045
    assert 1.0 - j0(x) ** 2 - j1(x) ** 2 == pytest.approx(0.8378, abs=5e-5)
    assert encircled(1.2196698912665045, 1.0, 0.0) == pytest.approx(0.8377850, abs=1e-6)
    radial = np.linspace(0.0, 1.0, 40_001)[1:]
    mtf = Airy(1.0).transfer(np.zeros_like(radial), radial)
    radius = 1.2196698912665045
    held = np.trapezoid(mtf * 2 * np.pi * radius * j1(2 * np.pi * radial * radius), radial)
    assert held == pytest.approx(0.8377850, abs=1e-4)


@pytest.mark.parametrize("eps", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("q", [0.12, 1.0, 4.0])
def test_against_quadrature_light_beyond(q: float, eps: float) -> None:
    for times in (20.0, 100.0):
        beyond = 1.0 - encircled(times * q, q, eps)
        assert Airy(q, eps).light_beyond(times * q) == pytest.approx(beyond, rel=1.0 / times)


def test_gaussian_light_beyond_and_band_limit() -> None:
    g = Gaussian(2.0)
    tail = quad(lambda r: r / 4.0 * np.exp(-r * r / 8.0), 5.0, np.inf)[0]
    assert g.light_beyond(5.0) == pytest.approx(tail, rel=1e-10)
    f = g.band_limit(1e-9)
    assert g.transfer(np.array(f), np.array(0.0)) == pytest.approx(1e-9, rel=1e-9)


@pytest.mark.parametrize("optics", [Gaussian(0.7), Airy(1.3, 0.3)])
def test_jitter_and_diffusion_add_in_quadrature(optics: Gaussian | Airy) -> None:
    f = np.linspace(-2, 2, 41)
    fy, fx = f[:, None], f[None, :]
    both = Blur(optics, 0.3, 0.4).transfer(fy, fx)
    assert np.allclose(both, Blur(optics, 0.5, 0.0).transfer(fy, fx), rtol=1e-13, atol=0)
    apart = optics.transfer(fy, fx) * np.exp(-2 * np.pi**2 * 0.25 * (fy**2 + fx**2))
    apart = apart * np.sinc(fy) * np.sinc(fx)
    assert np.allclose(both, apart, rtol=1e-12, atol=1e-16)


@pytest.mark.parametrize(("jitter", "diffusion"), [(3.0, 0.0), (0.0, 3.0), (4.0, 3.0)])
def test_light_beyond_counts_jitter_and_diffusion(jitter: float, diffusion: float) -> None:
    """A Gaussian blurred by Gaussians is a Gaussian of the summed variance."""
    blur = Blur(Gaussian(0.5), jitter, diffusion)
    sigma = np.sqrt(0.25 + jitter**2 + diffusion**2)
    for radius in (2.0, 10.0):
        assert blur.light_beyond(radius) == pytest.approx(
            np.exp(-0.5 * (radius / sigma) ** 2), rel=1e-9
        )
    assert Blur(Airy(0.5), jitter, diffusion).light_beyond(3.0) > 0.3


@pytest.mark.parametrize("fill", [1.0, 0.81, 0.25])
def test_fill_factor_is_the_light_collected(fill: float) -> None:
    zero = np.zeros(1)
    assert Blur(Airy(1.0, 0.3), fill_factor=fill).transfer(zero, zero)[0] == pytest.approx(
        fill, rel=1e-14
    )
    side = np.sqrt(fill)
    f = np.array(0.7)
    box = quad(lambda x: np.cos(2 * np.pi * 0.7 * x), -side / 2, side / 2)[0] * side
    value = Blur(Gaussian(0.05), fill_factor=fill).pixel(f, np.array(0.0))
    assert value == pytest.approx(box, rel=1e-12)
