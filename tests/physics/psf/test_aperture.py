"""Vanes and wavefronts against brute-force pupils, closed forms and exact limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import BadInput
from pipeline.physics.psf.aperture import CELLS, STEEPEST, Pupil, SpiderVanes, lattice
from pipeline.physics.psf.pupil import Airy
from pipeline.physics.psf.radial import light_beyond, mean_over_directions
from pipeline.physics.psf.zernike import wavefront

ZERO = np.zeros(1)


def pattern(p: Pupil, y: np.ndarray, x: np.ndarray, step: float = 1 / 256) -> np.ndarray:
    """Light per px^2 at places in units of Q, per unit light: its transfer function summed.

    A trapezium rule with a frequency step of `step` / Q, good for places far inside Q / step.
    """
    one = Pupil(1.0, p.obscuration, p.vanes, p.waves)
    f = np.arange(-round(1 / step), round(1 / step) + 1) * step
    transfer = np.asarray(one.transfer(f[:, None], f[None, :]))
    down, along = np.exp(2j * np.pi * np.outer(y, f)), np.exp(2j * np.pi * np.outer(x, f))
    return ((down @ transfer) * along).sum(axis=1).real * step**2


def brute(p: Pupil, y: np.ndarray, x: np.ndarray, n: int = 2200) -> np.ndarray:
    """The same by the Fourier integral over a black and white pupil of n x n points."""
    at = (np.arange(n) + 0.5) / n - 0.5
    v, u = at[:, None], at[None, :]
    r = np.hypot(v, u)
    open_ = (r < 0.5) & (r >= 0.5 * p.obscuration)
    if p.vanes is not None:
        for k in range(p.vanes.count):
            a = p.vanes.angle_rad + 2 * np.pi * k / p.vanes.count
            along, across = np.cos(a) * u + np.sin(a) * v, np.cos(a) * v - np.sin(a) * u
            open_ &= ~((np.abs(across) < 0.5 * p.vanes.width) & (along > 0.0))
    field = open_ * np.exp(2j * np.pi * wavefront(p.waves, 2 * v, 2 * u))
    down, along = np.exp(-2j * np.pi * np.outer(y, at)), np.exp(-2j * np.pi * np.outer(x, at))
    amplitude = ((down @ field) * along).sum(axis=1) / n**2
    return np.abs(amplitude) ** 2 / (open_.sum() / n**2)


PUPILS = [
    Pupil(1.0, 0.3, SpiderVanes(4, 0.02, 0.3)),
    Pupil(1.0, 0.0, SpiderVanes(1, 0.1, 1.0)),
    Pupil(1.0, 0.5, SpiderVanes(3, 0.05, np.pi / 2), ((8, 0.1),)),
    Pupil(1.0, 0.2, None, ((4, 0.4), (5, -0.1), (7, 0.15), (11, 0.2))),
    Pupil(1.0, 0.95, SpiderVanes(2, 0.01)),
]


@pytest.mark.parametrize("p", PUPILS)
def test_against_brute_force_pupils(p: Pupil) -> None:
    rng = np.random.default_rng(2)
    places = np.concatenate(
        [[[0.0, 0.0]], rng.uniform(-4, 4, (12, 2)), rng.uniform(-12, 12, (6, 2))]
    )
    y, x = places.T
    exact = brute(p, y, x)
    # Per light, peak pi / 4: a part in 10^4 of an unaberrated peak, more for the thinnest ring.
    assert np.abs(pattern(p, y, x) - exact).max() < (1e-4 if p.obscuration < 0.9 else 5e-4)


@pytest.mark.parametrize("waves", [0.1, 0.5, 1.0, 2.3])
def test_against_closed_form_of_defocus_on_the_axis(waves: float) -> None:
    """sinc^2 of the path difference from centre to rim (Born and Wolf, 8.8), W20 = 2 sqrt 3 a4."""
    p = Pupil(1.0, 0.0, None, ((4, waves / (2.0 * np.sqrt(3.0))),))
    expected = np.pi / 4.0 * np.sinc(waves) ** 2
    assert pattern(p, ZERO, ZERO)[0] == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize("noll", [4, 5, 7, 11, 22, 37])
@pytest.mark.parametrize("rms", [0.02, 0.05])
def test_against_strehl_of_small_aberrations(noll: int, rms: float) -> None:
    """Peak exp(-(2 pi rms)^2) for small rms (Mahajan 1983, JOSA 73, 860), here at the axis."""
    p = Pupil(1.0, 0.0, None, ((noll, rms),))
    ratio = pattern(p, ZERO, ZERO)[0] / (np.pi / 4.0)
    sigma = 2.0 * np.pi * rms
    assert ratio == pytest.approx(np.exp(-(sigma**2)), abs=0.4 * sigma**4 + 1e-4)


@pytest.mark.parametrize(("noll", "moved"), [(2, "x"), (3, "y")])
def test_positive_tilt_moves_the_image_to_positive_x_and_y(noll: int, moved: str) -> None:
    """W = 2 a rho: 4 a waves over the diameter, 4 a Q pixels: the rays' slope times F."""
    p = Pupil(1.5, 0.3, None, ((noll, 0.2),))
    f = np.linspace(-0.5, 0.5, 21)
    zero = np.zeros_like(f)
    straight = Airy(1.5, 0.3).transfer(zero, f)
    turned = p.transfer(zero, f) if moved == "x" else p.transfer(f, zero)
    assert np.abs(turned - straight * np.exp(-2j * np.pi * f * 4 * 0.2 * 1.5)).max() < 1e-4
    other = p.transfer(f, zero) if moved == "x" else p.transfer(zero, f)
    assert np.abs(other - straight).max() < 1e-4


def test_coma_throws_its_tail_where_the_rays_go() -> None:
    """Z8 ~ (3 rho^3 - 2 rho) cos: its mean slope is sqrt 8 times a diameter, along +x."""
    p = Pupil(1.0, 0.0, None, ((8, 0.1),))
    f = np.array([1e-3, 2e-3])
    phase = np.angle(p.transfer(np.zeros(2), f))
    centroid = -phase / (2 * np.pi * f)
    assert centroid == pytest.approx(2 * np.sqrt(8) * 0.1 * np.ones(2), rel=0.02)


@pytest.mark.parametrize(("q", "eps"), [(0.1, 0.0), (1.0, 0.3), (8.0, 0.95)])
def test_same_as_airy_without_vanes_and_wavefront(q: float, eps: float) -> None:
    f = np.linspace(-1.1 / q, 1.1 / q, 61)
    plain = Airy(q, eps).transfer(f[:, None], f[None, :])
    assert np.array_equal(Pupil(q, eps).transfer(f[:, None], f[None, :]), plain)
    flat = Pupil(q, eps, None, ((11, 0.0),)).transfer(f[:, None], f[None, :])
    assert np.abs(flat - plain).max() < 1e-14
    faint = Pupil(q, eps, SpiderVanes(4, 1e-7)).transfer(f[:, None], f[None, :])
    assert np.abs(faint - plain).max() < 1e-4


@settings(max_examples=25)
@given(
    st.floats(0.1, 8.0), st.floats(0.0, 0.95), st.integers(1, 6), st.floats(0.002, 0.1),
    st.floats(-7.0, 7.0), st.floats(-0.3, 0.3), st.sampled_from([4, 6, 7, 8, 11, 13]),
)  # fmt: skip
def test_transfer_is_hermitian_bounded_and_one_at_zero(
    q: float, eps: float, count: int, width: float, angle: float, rms: float, noll: int
) -> None:
    p = Pupil(q, eps, SpiderVanes(count, width, angle), ((noll, rms),))
    rng = np.random.default_rng(5)
    f = rng.uniform(-1.2 / q, 1.2 / q, (400, 2))
    there, back = p.transfer(f[:, 0], f[:, 1]), p.transfer(-f[:, 0], -f[:, 1])
    assert np.abs(there - np.conj(back)).max() < 1e-12
    assert np.abs(there).max() <= 1.0 + 1e-3
    assert np.abs(there[np.hypot(f[:, 0], f[:, 1]) >= 1.0 / q]).max(initial=0.0) < 1e-9
    assert p.transfer(ZERO, ZERO)[0] == pytest.approx(1.0, abs=1e-12)


def test_symmetric_pupils_have_real_transfer_functions() -> None:
    f = np.linspace(-1, 1, 9)
    even = Pupil(1.0, 0.3, SpiderVanes(4, 0.03, 0.2), ((4, 0.2), (6, 0.1), (11, 0.1)))
    assert even.transfer(f, f).dtype == np.float64
    assert Pupil(1.0, 0.3, None, ((7, 0.1),)).transfer(f, f).dtype == np.complex128


@pytest.mark.parametrize("p", PUPILS)
def test_twice_the_cells_change_little(p: Pupil) -> None:
    """What sampling leaves: rms below 5e-5 of the transfer function, at most 1e-3 at its kinks."""
    rough = lattice(p.obscuration, p.vanes, p.waves, CELLS // 2).values
    fine = lattice(p.obscuration, p.vanes, p.waves, CELLS).values[::2, ::2]
    off = np.abs(fine - rough)
    assert off.max() < 2e-3
    assert np.sqrt(np.mean(off**2)) < 1e-4


@pytest.mark.parametrize(
    ("count", "width", "eps"), [(4, 0.02, 0.3), (3, 0.1, 0.0), (6, 0.005, 0.6)]
)
def test_vanes_cover_their_area(count: int, width: float, eps: float) -> None:
    """Strips of the vanes' width from rim to rim; at the centre of a full pupil they overlap."""
    p = Pupil(1.0, eps, SpiderVanes(count, width, 0.4))
    strips = count * width * 0.5 * (1.0 - eps)
    share = strips / (np.pi / 4.0 * (1.0 - eps**2))
    overlap = count * width**2 / (np.pi / 4.0) if eps == 0 else width**2
    assert 1.0 - p.open_fraction == pytest.approx(share, abs=1e-4 + overlap)


@pytest.mark.parametrize("p", PUPILS)
def test_against_quadrature_light_beyond(p: Pupil) -> None:
    mtf = mean_over_directions(p.transfer)
    radii = (0.5, 2.0, 7.0, 25.0, 90.0)
    for r in radii:
        assert p.light_beyond(r) == pytest.approx(light_beyond(mtf, 1.0, r), rel=6e-2)
    scaled = Pupil(3.0, p.obscuration, p.vanes, p.waves)
    assert scaled.light_beyond(21.0) == pytest.approx(p.light_beyond(7.0), rel=1e-12)
    far = [p.light_beyond(r) for r in np.geomspace(0.01, 1e5, 300)]
    assert (np.diff(far) <= 0).all()
    assert p.light_beyond(3000.0) == pytest.approx(
        p.light_beyond(300.0) / 10.0, rel=1e-9
    )  # the edges alone


@pytest.mark.parametrize("coma", [7, 8])
def test_a_wavefront_too_steep_along_one_axis_is_refused(coma: int) -> None:
    """sqrt(8) (3 r^2 - 2) y rises by up to 7 sqrt(8) along y, and by 3 sqrt(8) along x."""
    rms = STEEPEST * CELLS / 2.0 / (5.0 * math.sqrt(8.0))
    with pytest.raises(BadInput, match="waves a diameter"):
        Pupil(1.0, 0.0, None, ((coma, rms),)).transfer(ZERO, ZERO)


def test_limits_of_vanes_and_wavefronts_are_refused_by_name() -> None:
    with pytest.raises(BadInput, match="aberrations") as error:
        Pupil(1.0, 0.3, None, ((37, 5.0),)).transfer(ZERO, ZERO)
    assert "waves a diameter" in str(error.value)
    with pytest.raises(BadInput, match="vanes"):
        Pupil(1.0, 0.3, SpiderVanes(12, 0.5)).transfer(ZERO, ZERO)
    strong = Pupil(1.0, 0.3, None, ((4, 8.0),))
    assert abs(strong.transfer(ZERO, np.array([0.5]))[0]) < 0.05
    assert strong.core_px > strong.blur_px > 100.0


@pytest.mark.parametrize("p", PUPILS[:3])
def test_far_light_comes_from_rims_and_vanes(p: Pupil) -> None:
    """The law of the edges goes on where the table from the transfer function ends, at 200 Q."""
    assert p.light_beyond(215.0) == pytest.approx(p.light_beyond(185.0) * 185 / 215, rel=0.12)
