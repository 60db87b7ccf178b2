"""Measured magnitudes of Starlink satellites: geometry, models, the documented figures."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from benchmarks import satellite_brightness as made
from pipeline.physics.meshes.brdf import lambert

DOCS = Path(__file__).resolve().parents[1] / "docs"


@pytest.fixture(scope="module")
def folder(shared_data: Path) -> Path:
    found = shared_data / "satellite_brightness" / "starlink_v15_pomenis"
    if not found.is_dir():
        pytest.skip("no measured magnitudes of satellites beside the repository")
    return found


@pytest.fixture(scope="module")
def seen(folder: Path) -> made.Sightings:
    return made.read_sightings(folder)


@pytest.fixture(scope="module")
def predicted(folder: Path, seen: made.Sightings) -> dict[str, np.ndarray]:
    return made.predictions(folder, seen)


def test_against_astropy(folder, seen) -> None:
    """The Sun, and the satellites as seen from the site, in astropy's horizon; heights as given."""
    from astropy import units as u
    from astropy.coordinates import GCRS, ITRS, AltAz, EarthLocation, get_sun
    from astropy.time import Time
    from astropy.utils import iers

    lines = (folder / "pomenis_observations.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines if line.startswith("20")][::97]
    km, elevation, azimuth = np.array([r[1:4] for r in rows], float).T
    lat, lon, height = made.SITE_DEG_M
    site = EarthLocation.from_geodetic(lon * u.deg, lat * u.deg, height * u.m)
    place = seen.view.place_m[0, ::97].T * u.m
    with iers.conf.set_temp("auto_download", False):
        times = Time([r[0] for r in rows])
        sun = get_sun(times).transform_to(AltAz(obstime=times, location=site))
        fixed = GCRS(*place, obstime=times, representation_type="cartesian").transform_to(
            ITRS(obstime=times)
        )
    assert np.degrees(seen.sun_elevation_rad)[::97] == pytest.approx(sun.alt.deg, abs=0.01)
    assert fixed.earth_location.height.to_value(u.km) == pytest.approx(km, abs=0.01)
    sight = fixed.cartesian.xyz.to_value(u.m).T - [v.to_value(u.m) for v in site.geocentric]
    b, l = np.radians([lat, lon])  # noqa: E741
    north = np.array([-np.sin(b) * np.cos(l), -np.sin(b) * np.sin(l), np.cos(b)])
    up = np.array([np.cos(b) * np.cos(l), np.cos(b) * np.sin(l), np.sin(b)])
    y, x = sight @ np.cross(north, up), sight @ north
    turn = (np.degrees(np.arctan2(y, x)) - azimuth + 180.0) % 360.0 - 180.0
    assert turn * np.cos(np.radians(elevation)) == pytest.approx(0.0, abs=0.02)
    assert np.degrees(np.arctan2(sight @ up, np.hypot(x, y))) == pytest.approx(elevation, abs=0.02)


def test_limits_sights_lie_on_the_scans_side_towards_the_light(seen) -> None:
    """Where Sun and observer stand before a facet, backward of the mirror's direction."""
    sun, observer = seen.view.sun[0], seen.view.observer[0]
    for n in seen.normals:
        lit, faced = np.sum(n * sun, -1), np.sum(n * observer, -1)
        across = sun - lit[:, None] * n
        offset = np.sum((observer - faced[:, None] * n + across) * across, -1)
        assert np.all(offset[(lit > 0.0) & (faced > 0.0)] > 0.0)


def test_same_matt_plates_as_composite_and_as_facets(seen) -> None:
    """The product's composite body and the sum over two facets are one, earthshine included."""
    chassis, array = (
        made.Facet(area, partial(lambert, albedo=albedo))
        for area, albedo in ((made.CHASSIS_M2, 0.3), (made.ARRAY_M2, 0.1))
    )
    facets = made.surface_magnitudes((chassis, array), seen)
    assert facets == pytest.approx(made.body_magnitudes(made.plates(0.3, 0.1), seen), abs=1e-9)


@pytest.mark.parametrize("name", ["chassis", "solar_array"])
def test_against_the_laboratory_scans(folder, name) -> None:
    """The side towards the light comes back but for the average with the mirror image."""
    path = folder / f"{name}_brdf.csv"
    brdf = made.laboratory_brdf(path)
    for angle, scan in made.laboratory_rows(path).items():
        near = scan[scan[:, 0] <= angle - made.MIRROR_DEG]
        out, value = np.radians(near[:, 0]), near[:, 1]
        azimuth = np.where(out > 0.0, np.pi, 0.0)
        ratio = brdf.at(np.radians(angle), np.abs(out), azimuth) / value
        assert np.median(np.abs(np.log(ratio))) < 0.2


def test_limits_mirrored_ground(seen) -> None:
    """Straight down the Sun stands as high as over the place below; upwards there is no ground."""
    down = seen.normals[0]
    sun = seen.view.sun_m[0] / np.linalg.norm(seen.view.sun_m[0], axis=-1, keepdims=True)
    below = np.maximum(-np.sum(down * sun, -1), 0.0)
    assert made.sun_on_ground(seen, down) == pytest.approx(below, abs=1e-12)
    assert not made.sun_on_ground(seen, -down).any()


def test_against_the_published_correlations(seen, predicted) -> None:
    """Fankhauser et al. 2023: r = 0.69, 0.68 and 0.47; the sphere's rms 1.178 with 0.649 m2."""
    fit = {name: made.scatter(values, seen.magnitude) for name, values in predicted.items()}
    assert fit["the same, no earthshine"].r == pytest.approx(0.69, abs=0.04)
    assert fit["published fit (Phong)"].r == pytest.approx(0.68, abs=0.04)
    assert fit["diffuse sphere"].r == pytest.approx(0.47, abs=0.02)
    assert fit["diffuse sphere"].rms == pytest.approx(1.178, abs=0.03)
    # theirs: 1360 W/m2 at 532 nm as AB, -27.06
    theirs = 0.649 * 10.0 ** (0.4 * (27.06 + made.SUN_V_MAG))
    assert made.sphere_area_m2(seen) == pytest.approx(theirs, rel=0.03)


def test_same_figures_as_documented(seen, predicted) -> None:
    text = (DOCS / "satellite_brightness.md").read_text().splitlines()
    for lines in made.report(seen, predicted):
        assert all(line in text for line in lines)
