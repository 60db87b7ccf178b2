"""Both WCS of one FITS header as astropy reads them: wide fields, air, distortion."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from astropy.io.fits import Header
from astropy.wcs import WCS, FITSFixedWarning

from pipeline.physics.constants import SPEED_OF_LIGHT_M_S
from pipeline.physics.motion.pointing import boresight_frame, proper_attitude
from pipeline.physics.positions.apparent import aberrate, unaberrate
from pipeline.physics.positions.apparent_wcs import apparent_wcs_header
from pipeline.physics.positions.distortion import distortion_of
from pipeline.physics.positions.focal_plane import (
    Camera,
    deproject,
    fit_wcs,
    ifov_rad,
    wcs_header,
)
from pipeline.physics.positions.refraction import refraction_terms, unrefract
from pipeline.physics.vectors import from_angles, to_angles, unit

BETA = np.array([0.6, -0.7, 0.3]) * 30.5e3 / SPEED_OF_LIGHT_M_S
SIDE = 2048
RADIAL = {"kind": "radial", "k1": -0.3, "k2": 0.1, "k3": 0.0, "p1": 1e-3, "p2": 0.0}
SIP = {"kind": "sip", "a": {"2_0": 3e-6, "1_2": -6e-10}, "b": {"1_1": 2e-6, "0_3": -5e-10}}
ODD = {"kind": "tpv", "pv1": {1: 1.002, 3: 1e-4, 11: 1e-3}, "pv2": {3: 1e-4, 11: 1e-3}}


def camera_of(field_deg: float, distortion: dict | None = None) -> Camera:
    camera = Camera(SIDE, SIDE, 1e-5, 1e-5 * SIDE / (2 * np.tan(np.radians(0.5 * field_deg))))
    if distortion is None:
        return camera
    wish = {"reference_px": None, "cd_deg": None} | distortion
    return replace(camera, distortion=distortion_of(wish, SIDE, SIDE, ifov_rad(camera)))


def look(zenith_distance_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """An attitude, and the air of a site that sees its boresight at a zenith distance."""
    sought = boresight_frame(from_angles(*np.radians([40.0, 55.0])), 0.4)
    attitude = proper_attitude(sought, aberrate(sought[2], BETA))
    z = np.radians(zenith_distance_deg)
    zenith = np.cos(z) * attitude[2] + np.sin(z) * unit(attitude[0] + 0.3 * attitude[1])
    return attitude, np.array([*zenith, *refraction_terms(1010.0, 10.0, 0.5, 6e-7)])


def errors_px(camera: Camera, attitude: np.ndarray, air: np.ndarray | None) -> tuple[float, float]:
    """Largest error of astropy's reading of the primary and of the alternate WCS [px]."""

    def to_world(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return unaberrate(unrefract(deproject(camera, attitude, x, y), air), BETA)

    fit = fit_wcs(camera, to_world)
    apparent = apparent_wcs_header(camera, attitude, fit.sip_order > 0)
    assert apparent is not None
    header = Header(wcs_header(fit) | {f"{k}A": v for k, v in apparent.items()})
    x, y = np.random.default_rng(5).uniform(-0.5, SIDE - 0.5, (2, 400))
    found = []
    for key, u in ((" ", to_world(x, y)), ("A", deproject(camera, attitude, x, y))):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FITSFixedWarning)
            wcs = WCS(header, key=key)
        lon, lat = np.degrees(to_angles(u))
        there = np.stack(wcs.all_world2pix(lon, lat, 0, tolerance=1e-7))
        seen = from_angles(*np.radians(wcs.all_pix2world(x, y, 0)))
        back_px = float(np.abs(seen - u).max()) / ifov_rad(camera)
        found.append(max(back_px, float(np.hypot(*(there - [x, y])).max())))
    return found[0], found[1]


@pytest.mark.parametrize("field_deg", [0.2, 5.9, 20.0])
@pytest.mark.parametrize("zenith_distance_deg", [None, 45.0])
def test_against_astropy_wide_fields(field_deg, zenith_distance_deg):
    """Sharing the primary's SIP terms, the alternate was 0.015 px off at 5.9 degrees."""
    attitude, air = look(zenith_distance_deg or 0.0)
    air = None if zenith_distance_deg is None else air
    primary, alternate = errors_px(camera_of(field_deg), attitude, air)
    assert primary < (1e-3 if air is not None else 1e-5)
    assert alternate < 1e-6


@pytest.mark.parametrize(
    ("field_deg", "distortion", "air"),
    [(2.0, SIP, True), (5.9, RADIAL, False), (20.0, RADIAL, True), (20.0, SIP, False)],
)
def test_against_astropy_with_distortion(field_deg, distortion, air):
    attitude, bends = look(45.0)
    camera = camera_of(field_deg, distortion)
    primary, alternate = errors_px(camera, attitude, bends if air else None)
    assert primary < 1e-3
    assert alternate < 1e-3


def test_against_astropy_odd_terms():
    """Odd powers of r, which SIP cannot hold, are exact in TPV."""
    camera = camera_of(2.0, ODD)
    attitude, _ = look(0.0)
    _, alternate = errors_px(camera, attitude, None)
    assert alternate < 1e-6


def test_limits_a_distortion_beyond_degree_7_has_none():
    strong = {"kind": "radial", "k1": -0.8, "k2": 0.6, "k3": -0.1, "p1": 1e-3, "p2": 0.0}
    attitude, _ = look(0.0)
    assert apparent_wcs_header(camera_of(40.0, strong), attitude, True) is None
