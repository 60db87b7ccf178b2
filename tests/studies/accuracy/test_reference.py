"""The reference against closed forms, GalSim and itself with more nodes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from pipeline.physics.psf.pupil import Airy
from pipeline.studies.accuracy.engines import arc
from pipeline.studies.accuracy.reference import (
    AiryStar,
    GaussianStar,
    Track,
    airy_intensity,
    annulus_transfer,
    curved,
    exact_pixels,
    straight,
)

AT = np.arange(-3.0, 4.0)
NODE, SHARE = np.polynomial.legendre.leggauss(16)
AIRIES = (AiryStar(1.0, 0.3), AiryStar(0.4, 0.0), AiryStar(2.5, 0.6))


def by_intensity(star: AiryStar, track: Track, x: float, y: float, column: float, row: float):
    """One pixel from the closed form of the intensity: quadrature over the pixel and the path."""
    length = float(np.hypot(np.diff(track.x_px), np.diff(track.y_px))[0, 0])
    panels = max(1, int(np.ceil(4.0 * length)))
    t = ((np.arange(panels)[:, None] + 0.5 * (NODE + 1.0)) / panels).ravel()
    weight = np.tile(0.5 * SHARE / panels, panels)
    px = track.x_px[0, 0] + t * np.diff(track.x_px)[0]
    py = track.y_px[0, 0] + t * np.diff(track.y_px)[0]
    total = 0.0
    for part_y in (-0.25, 0.25):
        for part_x in (-0.25, 0.25):
            dx = column + part_x - x - px[:, None, None] + 0.25 * NODE[None, None, :]
            dy = row + part_y - y - py[:, None, None] + 0.25 * NODE[None, :, None]
            light = airy_intensity(star, np.hypot(dx, dy))
            total += 0.0625 * float(np.einsum("t,i,j,tij->", weight, SHARE, SHARE, light))
    return total


@pytest.mark.parametrize("star", AIRIES)
def test_against_closed_form_airy(star: AiryStar) -> None:
    made = exact_pixels(star, straight(0.0, 0.0), 0.31, -0.22, AT, AT)
    for row, column in ((3, 3), (2, 4), (6, 0)):
        closed = by_intensity(star, straight(0.0, 0.0), 0.31, -0.22, AT[column], AT[row])
        assert made[row, column] == pytest.approx(closed, abs=1e-12)


def test_against_closed_form_airy_streak() -> None:
    star, track = AIRIES[0], straight(40.0, 0.7)
    end = np.array([15.0, 16.0]), np.array([13.0, 25.0])
    made = exact_pixels(star, track, 0.4, 0.1, *end)
    for i, row in enumerate(end[1]):
        for j, column in enumerate(end[0]):
            closed = by_intensity(star, track, 0.4, 0.1, column, row)
            assert made[i, j] == pytest.approx(closed, abs=1e-12)


def test_against_closed_form_gaussian_streak() -> None:
    """Along x the average of the Gaussian's distribution function has a closed form."""
    s, length, x, y = 0.8, 23.0, 0.3, -0.4

    def integral(u):
        z = u / s
        return u * ndtr(z) + s * np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)

    def averaged(u):
        return (integral(u + 0.5 * length) - integral(u - 0.5 * length)) / length

    at = np.arange(-20.0, 21.0)
    across = averaged(at + 0.5 - x) - averaged(at - 0.5 - x)
    down = ndtr((at + 0.5 - y) / s) - ndtr((at - 0.5 - y) / s)
    made = exact_pixels(GaussianStar(s), straight(length, 0.0), x, y, at, at)
    assert np.abs(made - down[:, None] * across).max() < 1e-14


@pytest.mark.parametrize("star", [GaussianStar(0.8), AIRIES[0]])
def test_against_galsim(star: GaussianStar | AiryStar) -> None:
    """GalSim's own profiles, integrated over pixels; its FFT is good to about 1e-7 here."""
    galsim = pytest.importorskip("galsim", reason="galsim is not installed")
    if isinstance(star, GaussianStar):
        profile = galsim.Gaussian(sigma=star.sigma_px)
    else:
        profile = galsim.Airy(lam_over_diam=star.q_px, obscuration=star.obscuration)
    made = exact_pixels(star, straight(0.0, 0.0), 0.31, -0.22, AT, AT)
    for row, column in ((3, 3), (2, 4), (6, 0)):
        total = 0.0
        for a, wa in zip(NODE, SHARE, strict=True):
            for b, wb in zip(NODE, SHARE, strict=True):
                place = galsim.PositionD(AT[column] - 0.31 + 0.5 * a, AT[row] + 0.22 + 0.5 * b)
                total += 0.25 * wa * wb * profile.xValue(place)
        assert made[row, column] == pytest.approx(total, abs=1e-10)


@pytest.mark.parametrize("star", AIRIES)
def test_against_the_products_transfer_function(star: AiryStar) -> None:
    """Two ways of overlapping circles, written apart (the product loses 5e-9 where they touch)."""
    d = np.linspace(0.0, 2.0, 378)
    product = Airy(star.q_px, star.obscuration).radial(0.5 * d / star.q_px)
    assert np.abs(annulus_transfer(d, star.obscuration) - product).max() < 1e-13


@pytest.mark.parametrize("star", [GaussianStar(0.8), *AIRIES])
def test_same_light_by_one_square_or_many_pixels(star: GaussianStar | AiryStar) -> None:
    track, at = straight(9.0, 0.4), np.arange(-12.0, 13.0)
    middle = np.zeros(1)
    whole = exact_pixels(star, track, 0.2, 0.3, middle, middle, width=25.0)[0, 0]
    assert exact_pixels(star, track, 0.2, 0.3, at, at).sum() == pytest.approx(whole, abs=1e-12)
    if isinstance(star, GaussianStar):
        assert whole == pytest.approx(1.0, abs=1e-12)
    else:
        assert 0.8 < whole < 1.0


@settings(max_examples=10, deadline=None)
@given(
    st.floats(0.3, 3.0), st.floats(0.0, 0.8), st.floats(0.0, 20.0), st.floats(0.0, 6.3),
    st.floats(-0.5, 0.5),
)  # fmt: skip
def test_same_with_more_nodes(q: float, e: float, length: float, angle: float, x: float) -> None:
    star, track = AiryStar(q, e), straight(length, angle)
    at = np.array([-9.0, 0.0, 1.0, 14.0])
    one = exact_pixels(star, track, x, 0.1, at, at)
    assert np.abs(one - exact_pixels(star, track, x, 0.1, at, at, finer=1.5)).max() < 1e-11


def test_same_curve_by_points_or_short_parts() -> None:
    """A curve by Gauss-Legendre points is the limit of its chords, which err as parts^-2."""
    smooth = curved(lambda t: arc(20.0, t), 20)
    at = np.arange(-14.0, 15.0)
    exact = exact_pixels(GaussianStar(0.8), smooth, 0.1, 0.2, at, at)
    errors = []
    for parts in (64, 128):
        x, y = arc(20.0, np.linspace(0.0, 1.0, parts + 1))
        ends = [np.stack([a[:-1], a[1:]], axis=1) for a in (x, y)]
        chords = Track(*ends, np.full(parts, 1.0 / parts))
        made = exact_pixels(GaussianStar(0.8), chords, 0.1, 0.2, at, at)
        errors.append(np.abs(made - exact).max())
    assert errors[1] < 1e-5
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)
