"""Zernike polynomials: Noll's table, orthonormality, defocus from a shift of the detector."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.physics.psf.zernike import defocus_rms, noll_orders, wavefront, zernike

NOLL_TABLE_1 = [  # Noll 1976, JOSA 66, 207: (n, m) of j = 1 ... 22, m < 0 for sines
    (0, 0), (1, 1), (1, -1), (2, 0), (2, -2), (2, 2), (3, -1), (3, 1), (3, -3), (3, 3), (4, 0),
    (4, 2), (4, -2), (4, 4), (4, -4), (5, 1), (5, -1), (5, 3), (5, -3), (5, 5), (5, -5), (6, 0),
]  # fmt: skip


def disc() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Quadrature of the unit disc: radii, angles, weights that sum to 1."""
    x, w = np.polynomial.legendre.leggauss(24)
    rho, weight = 0.5 * (x + 1.0), 0.5 * w
    theta = 2 * np.pi * np.arange(48) / 48
    both = (2.0 * rho * weight)[:, None] * np.full(48, 1.0 / 48)[None, :]
    return np.repeat(rho, 48), np.tile(theta, 24), both.ravel()


def test_against_nolls_table() -> None:
    assert [noll_orders(j) for j in range(1, 23)] == NOLL_TABLE_1
    rho, theta = np.array([0.0, 0.5, 1.0]), np.array([0.3, 0.3, 0.3])
    assert zernike(4, rho, theta) == pytest.approx(np.sqrt(3) * (2 * rho**2 - 1))
    assert zernike(8, rho, theta) == pytest.approx(
        np.sqrt(8) * (3 * rho**3 - 2 * rho) * np.cos(0.3)
    )
    assert zernike(11, rho, theta) == pytest.approx(np.sqrt(5) * (6 * rho**4 - 6 * rho**2 + 1))


def test_orthonormal_over_the_disc() -> None:
    rho, theta, weight = disc()
    values = np.array([zernike(j, rho, theta) for j in range(1, 67)])
    assert np.abs((values * weight) @ values.T - np.eye(66)).max() < 1e-12


def test_rms_of_a_wavefront_is_the_root_of_squares() -> None:
    rho, theta, weight = disc()
    y, x = rho * np.sin(theta), rho * np.cos(theta)
    w = wavefront(((4, 0.3), (7, -0.4), (37, 1.2)), y, x)
    assert np.sqrt(weight @ w**2) == pytest.approx(1.3, rel=1e-12)


def test_defocus_of_a_shifted_detector() -> None:
    """A sphere about a focus `shift` further on, against the nominal one, over an f/8 pupil."""
    focal, aperture, shift = 8.0, 1.0, 1e-3
    h = np.linspace(0.0, 0.5 * aperture, 4001)
    path = np.hypot(h, focal) - np.hypot(h, focal + shift)
    mass = np.gradient(h**2)
    path -= path @ mass / mass.sum()
    rms = np.sqrt(path**2 @ mass / mass.sum())
    assert abs(defocus_rms(shift, focal / aperture)) == pytest.approx(rms, rel=1e-2)


def test_even_terms_lie_along_x() -> None:
    """Noll counts the angle from +x: Z2 is 2 x, Z6 the astigmatism of x^2 - y^2, Z8 coma in x."""
    y, x = np.array([0.1, -0.4, 0.7]), np.array([0.3, 0.5, -0.2])
    r2 = x**2 + y**2
    for j, expected in (
        (2, 2.0 * x),
        (3, 2.0 * y),
        (5, np.sqrt(6.0) * 2.0 * x * y),
        (6, np.sqrt(6.0) * (x**2 - y**2)),
        (7, np.sqrt(8.0) * (3.0 * r2 - 2.0) * y),
        (8, np.sqrt(8.0) * (3.0 * r2 - 2.0) * x),
    ):
        np.testing.assert_allclose(wavefront(((j, 1.0),), y, x), expected, atol=1e-14)
