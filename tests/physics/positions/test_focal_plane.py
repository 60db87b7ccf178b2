"""The camera against astropy.wcs, for small and wide fields, at the poles and at RA 0."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.io.fits import Header
from astropy.wcs import WCS
from hypothesis import given
from hypothesis import strategies as st

from pipeline.physics.constants import SPEED_OF_LIGHT_M_S
from pipeline.physics.motion.pointing import boresight_frame, proper_attitude
from pipeline.physics.positions.apparent import aberrate, unaberrate
from pipeline.physics.positions.apparent_wcs import apparent_wcs_header
from pipeline.physics.positions.focal_plane import (
    Camera,
    corner_radius,
    deproject,
    fit_wcs,
    ifov_rad,
    project,
    wcs_header,
)
from pipeline.physics.vectors import from_angles, separation, to_angles, unit

NARROW = Camera(rows=2048, columns=2048, pixel_pitch_m=13.5e-6, focal_length_m=1.0)
WIDE = Camera(rows=3000, columns=4096, pixel_pitch_m=10e-6, focal_length_m=0.116)  # 20 degrees
BETA = np.array([0.6, -0.7, 0.3]) * 30.5e3 / SPEED_OF_LIGHT_M_S
PLACES = [(10.0, 20.0), (0.0, 0.0), (359.99999, -45.0), (123.0, 90.0), (77.0, -90.0),
          (30.0, 89.999), (200.0, -89.5)]  # fmt: skip


def look(ra_deg: float, dec_deg: float, roll: float = 0.0) -> np.ndarray:
    return boresight_frame(from_angles(*np.radians([ra_deg, dec_deg])), roll)


def random_pixels(camera: Camera, n: int = 300) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.Generator(np.random.SFC64(8))
    return rng.uniform(-0.5, camera.columns - 0.5, n), rng.uniform(-0.5, camera.rows - 0.5, n)


def seen_by_astropy(header: dict, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    wcs = WCS(Header(header))
    return from_angles(*np.radians(wcs.all_pix2world(x, y, 0)))


@given(st.floats(0, 360), st.floats(-90, 90), st.floats(0, 6.28))
def test_same_pixel_there_and_back(ra: float, dec: float, roll: float) -> None:
    for camera in (NARROW, WIDE):
        attitude = look(ra, dec, roll)
        x, y = random_pixels(camera, 20)
        u = deproject(camera, attitude, x, y)
        assert np.allclose(np.sum(u * u, -1), 1, atol=1e-14)
        back = project(camera, attitude, u)
        assert np.max(np.abs(back[0] - x)) < 2e-9
        assert np.max(np.abs(back[1] - y)) < 2e-9


def test_orientation_centre_and_scale() -> None:
    attitude = look(30.0, 40.0)
    step = ifov_rad(NARROW)
    ra, dec = np.radians([30.0, 40.0])
    north = from_angles(np.array([ra]), np.array([dec + step]))
    east = from_angles(np.array([ra + step / np.cos(dec)]), np.array([dec]))
    assert np.allclose(project(NARROW, attitude, north), [[1023.5], [1024.5]], atol=1e-4)
    assert np.allclose(project(NARROW, attitude, east), [[1022.5], [1023.5]], atol=1e-4)
    centre = deproject(NARROW, attitude, np.array([1023.5]), np.array([1023.5]))
    assert separation(centre, attitude[2])[0] < 1e-15
    corner = deproject(NARROW, attitude, np.array([-0.5]), np.array([-0.5]))
    assert separation(corner, attitude[2])[0] == pytest.approx(corner_radius(NARROW), abs=1e-14)


def test_limits_behind_the_camera_is_nan() -> None:
    attitude = look(30.0, 40.0)
    b = attitude[2]
    u = np.stack([-b, attitude[0], unit(attitude[0] - 0.1 * b), b])
    x, y = project(NARROW, attitude, u)
    assert np.isnan(x[[0, 2]]).all()
    assert np.isnan(y[[0, 2]]).all()
    assert x[3] == pytest.approx(1023.5, abs=1e-9)
    assert not np.any(np.abs(x[1:2]) < 1e12)  # at 90 degrees: NaN or far away


def test_same_pixel_alone_and_among_others() -> None:
    attitude = look(30.0, 40.0, 0.2)
    u = deproject(NARROW, attitude, *random_pixels(NARROW, 1001))
    x, y = project(NARROW, attitude, u)
    for i in (0, 1, 500, 1000):
        one = project(NARROW, attitude, u[i : i + 1])
        assert (one[0][0], one[1][0]) == (x[i], y[i])


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("camera", [NARROW, WIDE], ids=["narrow", "wide"])
def test_against_astropy_exact_tan(camera: Camera, place: tuple[float, float]) -> None:
    attitude = look(*place, roll=0.5)
    x, y = random_pixels(camera)
    for header in (
        apparent_wcs_header(camera, attitude),
        wcs_header(fit_wcs(camera, lambda a, b: deproject(camera, attitude, a, b))),
    ):
        assert header["CTYPE1"] == "RA---TAN"
        there = seen_by_astropy(header, x, y)
        assert np.max(separation(there, deproject(camera, attitude, x, y))) < 1e-13 + 2e-14


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("camera", [NARROW, WIDE], ids=["narrow", "wide"])
def test_against_astropy_with_aberration(camera: Camera, place: tuple[float, float]) -> None:
    """Catalogue direction -> WCS pixel equals the drawn pixel, to 1e-5 px over 20 degrees."""
    sought = look(*place, roll=-0.8)
    attitude = proper_attitude(sought, aberrate(sought[2], BETA))

    def to_world(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return unaberrate(deproject(camera, attitude, x, y), BETA)

    fit = fit_wcs(camera, to_world)
    x, y = random_pixels(camera)
    wcs = WCS(Header(wcs_header(fit)))
    lon, lat = to_angles(to_world(x, y))
    px = np.array(wcs.all_world2pix(np.degrees(lon), np.degrees(lat), 0, tolerance=1e-9))
    assert np.max(np.hypot(px[0] - x, px[1] - y)) < 2e-5
    assert np.max(np.hypot(px[0] - x, px[1] - y)) < 1.5 * fit.residual_px + 1e-7
    centre = fit.crval_deg
    here = from_angles(*np.radians(centre))
    assert separation(here, sought[2]) < 1e-14
    if camera is WIDE:
        assert fit.sip_order >= 2


def test_fit_takes_up_a_distortion() -> None:
    attitude = look(100.0, -30.0)

    def to_world(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        u, v = x - 1023.5, y - 1023.5
        r2 = (u * u + v * v) / 1023.5**2
        return deproject(
            NARROW, attitude, 1023.5 + u * (1 + 1e-3 * r2), 1023.5 + v * (1 + 1e-3 * r2)
        )

    fit = fit_wcs(NARROW, to_world)
    assert fit.sip_order == 3
    assert fit.residual_px < 1e-5
    x, y = random_pixels(NARROW)
    there = seen_by_astropy(wcs_header(fit), x, y)
    assert np.max(separation(there, to_world(x, y))) / ifov_rad(NARROW) < 1e-5


def test_limits_one_pixel_camera() -> None:
    camera = Camera(1, 1, 1e-5, 1.0)
    attitude = look(0.0, 0.0)
    fit = fit_wcs(camera, lambda a, b: deproject(camera, attitude, a, b))
    assert fit.sip_order == 0
    assert fit.residual_px < 1e-9
