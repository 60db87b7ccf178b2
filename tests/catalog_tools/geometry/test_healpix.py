"""Our HEALPix pixels are healpy's, at every order, at poles, wraps and on the borders of bases."""

from __future__ import annotations

import healpy
import numpy as np
import pytest

from catalog_tools.geometry.healpix import centres_of, neighbours_of, pixels_of


def healpy_pixels(order, ra, dec):
    return healpy.ang2pix(1 << order, ra, dec, nest=True, lonlat=True)


@pytest.mark.parametrize("order", [0, 1, 2, 5, 9, 12, 18, 25, 29])
def test_random_directions(order):
    rng = np.random.default_rng(order)
    ra = rng.uniform(0.0, 360.0, 200_000)
    dec = np.degrees(np.arcsin(rng.uniform(-1.0, 1.0, ra.size)))
    ours, theirs = pixels_of(order, ra, dec), healpy_pixels(order, ra, dec)
    differ = ours != theirs
    assert differ.mean() < 1e-5  # rounding on a border, at the finest orders
    assert _apart_rad(order, ours[differ], theirs[differ]) < 3.0 * healpy.nside2resol(1 << order)


def test_close_to_the_poles():
    rng = np.random.default_rng(3)
    ra = rng.uniform(0.0, 360.0, 50_000)
    dec = (90.0 - 10.0 ** rng.uniform(-7, 1, ra.size)) * rng.choice([-1.0, 1.0], ra.size)
    for order in (0, 9, 29):
        ours, theirs = pixels_of(order, ra, dec), healpy_pixels(order, ra, dec)
        differ = ours != theirs
        assert differ.mean() < 1e-3
        assert _apart_rad(order, ours[differ], theirs[differ]) < 3.0 * healpy.nside2resol(
            1 << order
        )


def test_borders_and_corners():
    border = np.degrees(np.arcsin(2.0 / 3.0))
    ra = np.array([0, 45, 90, 135, 180, 225, 270, 315, 359.9999999999, 360, -1e-20, -90, 720.0])
    for dec in (-90.0, -border, -41.0, 0.0, 1e-300, border, 42.0, 90.0):
        for order in (0, 3, 29):
            where = np.full(ra.size, dec)
            ours, theirs = pixels_of(order, ra, where), healpy_pixels(order, ra, where)
            assert (ours >= 0).all()
            assert (ours < 12 * 4**order).all()
            differ = ours != theirs
            apart = _apart_rad(order, ours[differ], theirs[differ])
            assert apart < 3.0 * healpy.nside2resol(1 << order)


def test_no_directions():
    assert pixels_of(29, [], []).shape == (0,)


def _apart_rad(order, ours, theirs):
    """The largest distance between the centres of two sets of pixels."""
    if not ours.size:
        return 0.0
    one, two = (np.array(healpy.pix2vec(1 << order, p, nest=True)) for p in (ours, theirs))
    return float(np.sqrt(((one - two) ** 2).sum(axis=0)).max())


@pytest.mark.parametrize("order", [0, 1, 2, 3, 6, 12, 29])
def test_centres_and_neighbours(order):
    count = 12 * 4**order
    pixels = np.arange(count) if count < 50_000 else np.random.default_rng(order).integers(
        0, count, 50_000
    )  # fmt: skip
    ra, dec = healpy.pix2ang(1 << order, pixels, nest=True, lonlat=True)
    ours_ra, ours_dec = centres_of(order, pixels)
    assert np.abs((ours_ra - ra + 180.0) % 360.0 - 180.0).max() < 1e-12
    assert np.abs(ours_dec - dec).max() < 1e-12
    theirs = healpy.get_all_neighbours(1 << order, pixels, nest=True)
    assert (np.sort(neighbours_of(order, pixels), axis=0) == np.sort(theirs, axis=0)).all()
