"""Tracks and their charge: geometry, statistics, conservation, the same bits in every tiling."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats

from pipeline.physics.cosmic_rays.deposit import _delta, add_tracks, spread_point, touching
from pipeline.physics.cosmic_rays.frame import charge_e, truth_columns
from pipeline.physics.cosmic_rays.straggling import (
    DELTA_LEAST_EV,
    PAIR_EV,
    electron_range_um,
    restricted_loss_ev_um,
    scale_ev,
)
from pipeline.physics.cosmic_rays.tracks import (
    Flux,
    Tracks,
    _azimuths,
    angle_table,
    draw_tracks,
    mean_count,
)
from pipeline.physics.noise.streams import stream_key

KEY = stream_key(1, "cosmic_rays")
WIDE = Flux(60_000, 60_000, 10.0, 100.0, 0.02, 500.0)  # its edges hardly matter


def test_mean_path_of_an_isotropic_flux():
    """2T / (1 + T / L) with paths capped at L, and cos^2 of the angle uniform."""
    t, cap = WIDE.thickness_um, WIDE.longest_um
    path = np.concatenate([draw_tracks(WIDE, k, KEY).path_um for k in range(4)])
    assert len(path) > 50_000
    assert path.max() <= cap
    error = path.std() / np.sqrt(len(path))
    assert path.mean() == pytest.approx(2 * t / (1 + t / cap), abs=5 * error)
    assert stats.kstest((t / path) ** 2, "uniform").pvalue > 1e-3


def test_paths_of_muons():
    """cos^(n+1) through a level plane: cos^4 uniform for n = 2."""
    flux = Flux(60_000, 60_000, 10.0, 100.0, 0.02, 500.0, zenith_power=2.0)
    tracks = draw_tracks(flux, 0, KEY)
    assert stats.kstest((flux.thickness_um / tracks.path_um) ** 4, "uniform").pvalue > 1e-3
    assert tracks.enters_back.all()


def test_entrance_area_against_quadrature():
    """Mean area where a track may enter: (rows + t |sin|) (columns + t |cos|), over directions."""
    flux = Flux(30, 50, 10.0, 100.0, 1.0, 1.0, diffusion_um=0.0)
    least = (flux.thickness_um / flux.longest_um) ** 2

    def area(phi, log_v):
        v = np.exp(log_v)
        t = flux.thickness_um / 10.0 * np.sqrt(1.0 / v - 1.0)
        return v * (30 + t * np.sin(phi)) * (50 + t * np.cos(phi)) / (np.pi / 2)

    total, _ = integrate.dblquad(area, np.log(least), 0.0, 0.0, np.pi / 2)
    assert angle_table(flux)[2] == pytest.approx(total / (1 - least), rel=1e-4)


def test_counts_are_poisson():
    flux = Flux(64, 64, 10.0, 15.0, 400.0, 1.0)
    counts = np.array([len(draw_tracks(flux, k, KEY)) for k in range(4000)])
    mean = mean_count(flux)
    assert counts.mean() == pytest.approx(mean, abs=5 * np.sqrt(mean / 4000))
    assert counts.var() / mean == pytest.approx(1.0, abs=5 * np.sqrt(2 / 4000))


def test_azimuths_and_places_are_even_in_a_wide_frame():
    tracks = draw_tracks(WIDE, 0, KEY)
    phi = np.arctan2(tracks.y_front - tracks.y_back, tracks.x_front - tracks.x_back)
    assert stats.kstest(phi / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3
    inside = (np.abs(tracks.x_back - 3e4) < 2e4) & (np.abs(tracks.y_back - 3e4) < 2e4)
    assert stats.kstest((tracks.x_back[inside] - 1e4) / 4e4, "uniform").pvalue > 1e-3


def test_azimuths_in_an_oblong_frame_against_quadrature():
    """Mean cos^2 of the azimuth where entrance areas (rows + t sin) (columns + t cos) weigh it."""
    rows, columns, t = 5.0, 400.0, 60.0
    phi = (np.arange(20_000) + 0.5) * (np.pi / 40_000)
    area = (rows + t * np.sin(phi)) * (columns + t * np.cos(phi))
    u, choice = np.random.default_rng(4).random((2, 40_000))
    dx, dy = _azimuths(np.full(40_000, t), rows, columns, u, choice)
    np.testing.assert_allclose(np.hypot(dx, dy), t)
    expected = float((area * np.cos(phi) ** 2).sum() / area.sum())
    assert np.mean((dx / t) ** 2) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(("rows", "columns", "helium"), [(300, 40, 0.0), (64, 64, 1.0)])
def test_mean_charge_of_a_frame(rows, columns, helium):
    """Rate x area x 2T x the restricted loss, also in frames where many tracks cross an edge."""
    flux = Flux(rows, columns, 10.0, 15.0, 4e5 / (rows * columns), 100.0, helium_share=helium,
                diffusion_um=2.0, delta_electrons=False)  # fmt: skip
    place = (0, 0, rows, columns)
    sums = np.array([add_tracks(None, draw_tracks(flux, k, KEY), flux, k, KEY, place).sum()
                     for k in range(12)])  # fmt: skip
    per_um = restricted_loss_ev_um(DELTA_LEAST_EV, 2 if helium else 1) / PAIR_EV
    cap = flux.longest_um / (flux.longest_um + flux.thickness_um)
    expected = 4e5 * 1e-6 * 100.0 * 2 * flux.thickness_um * cap * per_um
    error = sums.std() / np.sqrt(len(sums))
    assert sums.mean() == pytest.approx(expected, abs=5 * error + 0.03 * expected)


@settings(max_examples=60)
@given(st.floats(-3, 30), st.floats(-3, 30), st.floats(1e-3, 3))
def test_diffusion_conserves_charge(x, y, sigma):
    image, shares = np.zeros((70, 70)), np.empty(64)
    place = np.array([-20, -20, 70, 70])
    inside = spread_point(image, place, shares, x, y, sigma, 1e4)
    assert image.sum() == pytest.approx(1e4, rel=1e-13)
    assert inside == pytest.approx(1e4, rel=1e-13)
    i = np.indices(image.shape)[1] - 20
    assert (image * i).sum() / 1e4 == pytest.approx(x, abs=1e-4 if sigma > 0.8 else 0.5)


def test_diffusion_changes_no_charge_of_a_frame():
    """The same draws with and without diffusion leave the same charge, far from the edges."""
    sharp = Flux(400, 400, 10.0, 20.0, 50.0, 4.0, diffusion_um=0.0, delta_electrons=False)
    place = (-200, -200, 800, 800)
    tracks = draw_tracks(sharp, 0, KEY)
    blurred = Flux(400, 400, 10.0, 20.0, 50.0, 4.0, diffusion_um=6.0, delta_electrons=False)
    a, b = (add_tracks(None, tracks, f, 0, KEY, place) for f in (sharp, blurred))
    short = tracks.path_um < 500
    assert short.sum() > 20
    np.testing.assert_allclose(b[short], a[short], rtol=1e-12)


@pytest.mark.parametrize(
    ("thickness_um", "turn", "at"),
    [(10.0, 0.1, 0.5), (30.0, 0.6, 0.5), (1000.0, 0.3, 0.5), (30.0, 0.6, 0.9), (30.0, 0.6, 0.1)],
)
def test_an_electron_that_leaves_the_silicon_takes_its_energy_along(thickness_um, turn, at):
    """100 keV from a share of a track straight down: the part of its range that lies inside, as it
    goes on downwards.

    Its angle to the track is that of a collision with a heavy particle, cos^2 = T / (T + 2 m c^2).
    """
    energy_ev, pitch = 1e5, 10.0
    image, place = np.zeros((200, 200)), np.array([0, 0, 200, 200])
    line = (100.0, 100.0, 0.0, 0.0, thickness_um, pitch, 0.0)
    found = _delta(image, place, np.empty(64), line, at, energy_ev, turn)
    cosine = np.sqrt(energy_ev / (energy_ev + 2.0 * 510_998.95))
    whole_um = electron_range_um(energy_ev)
    path_um = min(whole_um, (1.0 - at) * thickness_um / cosine)
    assert found == pytest.approx(energy_ev / PAIR_EV * path_um / whole_um, rel=1e-5)
    y, x = np.indices(image.shape)
    away = np.hypot((image * x).sum() / found - 100.0, (image * y).sum() / found - 100.0)
    assert away == pytest.approx(0.5 * path_um * np.sqrt(1.0 - cosine**2) / pitch, abs=0.3)


def test_charge_from_the_far_side_spreads_most():
    """A level track, wide where it enters far from the electrodes: variance D^2 (1 - t) + 1/12."""
    flux = Flux(200, 200, 10.0, 100.0, 50.0, 4.0, diffusion_um=15.0, delta_electrons=False)
    one = {"x_back": 50.0, "y_back": 100.0, "x_front": 150.0, "y_front": 100.0}
    along = {"path_um": 1005.0, "charge_number": 1.0, "spread": 0.0}
    columns = {name: np.array([value]) for name, value in (one | along).items()}
    tracks = Tracks(event=np.array([0]), enters_back=np.array([True]), **columns)
    image = np.zeros((200, 200))
    add_tracks(image, tracks, flux, 0, KEY, (0, 0, 200, 200))
    x = np.arange(60, 141)
    off = np.arange(200.0)[:, None] - 100.0
    width = (image * off**2).sum(axis=0)[x] / image.sum(axis=0)[x]
    expected = 1.5**2 * (1.0 - (x - 50.0) / 100.0) + 1.0 / 12.0
    assert width[[0, 40, 80]] == pytest.approx(expected[[0, 40, 80]], rel=0.1)
    assert np.abs(width / expected - 1.0).mean() < 0.05


def test_charge_lies_on_exact_chords():
    """Without diffusion and deltas only the pixels that the line crosses hold charge."""
    flux = Flux(200, 200, 10.0, 50.0, 50.0, 10.0, diffusion_um=0.0, delta_electrons=False)
    tracks = draw_tracks(flux, 0, KEY)
    for n in range(20):
        one = tracks.taken(np.array([n]))
        image = np.zeros((200, 200))
        add_tracks(image, one, flux, 0, KEY, (0, 0, 200, 200))
        t = np.linspace(0, 1, 200_001)
        i = np.floor(one.x_back + t * (one.x_front - one.x_back) + 0.5).astype(int)
        j = np.floor(one.y_back + t * (one.y_front - one.y_back) + 0.5).astype(int)
        seen = (i >= 0) & (i < 200) & (j >= 0) & (j < 200)
        crossed = np.zeros((200, 200), bool)
        crossed[j[seen], i[seen]] = True
        assert not (image > 0)[~crossed].any()
        assert (image > 0).sum() >= crossed.sum() - 2  # corners shorter than the step of t


@pytest.mark.parametrize("zenith_power", [0.0, 2.0])
def test_same_bits_for_every_tiling(zenith_power):
    flux = Flux(300, 410, 10.0, 80.0, 30.0, 60.0, zenith_power, 0.1, 4.0)
    whole = charge_e(flux, 7, 3, 0, 0, 300, 410)
    assert (whole > 0).sum() > 1000
    for rows, columns in ((64, 410), (300, 100), (77, 31)):
        tiles = np.zeros_like(whole)
        for y in range(0, 300, rows):
            for x in range(0, 410, columns):
                part = charge_e(flux, 7, 3, y, x, min(rows, 300 - y), min(columns, 410 - x))
                tiles[y : y + rows, x : x + columns] = part
        np.testing.assert_array_equal(tiles, whole)
    assert not np.array_equal(charge_e(flux, 7, 4, 0, 0, 300, 410), whole)
    assert not np.array_equal(charge_e(flux, 8, 3, 0, 0, 300, 410), whole)


def test_truth_holds_all_charge():
    flux = Flux(300, 410, 10.0, 80.0, 30.0, 60.0, helium_share=0.3)
    truth = truth_columns(flux, 7, 3)
    assert truth["electrons"].sum() == pytest.approx(charge_e(flux, 7, 3, 0, 0, 300, 410).sum())
    assert (truth["electrons"] > 0).all()
    length = np.hypot(truth["x_out_px"] - truth["x_in_px"], truth["y_out_px"] - truth["y_in_px"])
    np.testing.assert_allclose(np.hypot(10 * length, 80), truth["length_um"])
    assert set(truth["kind"]) == {"proton", "helium"}
    assert {len(column) for column in truth.values()} == {len(truth["event"])}


def test_tiles_take_only_tracks_around_them():
    flux = Flux(4096, 4096, 10.0, 15.0, 5.0, 20.0)
    tracks = draw_tracks(flux, 0, KEY)
    assert touching(tracks, flux, 0, 0, 1024, 1024).mean() < 0.12


def test_limits_one_pixel_and_no_events():
    one = Flux(1, 1, 10.0, 15.0, 5.0, 100.0)
    assert charge_e(one, 1, 0, 0, 0, 1, 1).shape == (1, 1)
    rare = Flux(8, 8, 10.0, 15.0, 1e-9, 1.0)
    assert not charge_e(rare, 1, 0, 0, 0, 8, 8).any()
    assert len(truth_columns(rare, 1, 0)["event"]) == 0


def test_truth_tells_where_a_particle_came_in() -> None:
    """Muons come from above, through the far face; half of an isotropic flux from either side."""
    for power, share in ((2.0, 1.0), (0.0, 0.5)):
        flux = Flux(400, 300, 10.0, 80.0, 60.0, 60.0, zenith_power=power)
        tracks, truth = draw_tracks(flux, 3, KEY), truth_columns(flux, 1, 3)
        far = [(tracks.x_back, tracks.y_back), (tracks.x_front, tracks.y_front)]
        (x_in, y_in), (x_out, y_out) = ((x[truth["event"]], y[truth["event"]]) for x, y in far)
        back = truth["x_in_px"] == x_in
        assert np.mean(back) == pytest.approx(share, abs=0.06)
        assert set(truth["kind"]) == {"muon" if power else "proton"}
        for name, there, here in (("x_in", x_in, x_out), ("y_in", y_in, y_out),
                                  ("x_out", x_out, x_in), ("y_out", y_out, y_in)):  # fmt: skip
            np.testing.assert_array_equal(truth[f"{name}_px"], np.where(back, there, here))


def test_knocked_on_electrons_take_their_own_energy_along():
    """In thick silicon tracks of their own add xi ln(500 / 30) to the loss cut at 30 keV."""
    n, rng = 600, np.random.default_rng(5)
    y, ones = rng.uniform(190, 210, n), np.ones(n)
    path = 10.0 * np.hypot(300.0, 300.0)
    tracks = Tracks(np.arange(n), 100.0 * ones, y, 400.0 * ones, y, path * ones, ones,
                    ones > 0, 0.0 * ones)  # fmt: skip
    sums = []
    for deltas in (True, False):
        flux = Flux(400, 500, 10.0, 3000.0, 1.0, 1.0, diffusion_um=0.0, delta_electrons=deltas)
        sums.append(add_tracks(None, tracks, flux, 0, KEY, (0, 0, 400, 500)).mean())
    expected = scale_ev(path, 1.0) * np.log(500.0 / 30.0) / PAIR_EV
    assert sums[0] - sums[1] == pytest.approx(expected, rel=0.25)
    assert Flux(1, 1, 10.0, 15.0, 1.0, 1.0).longest_um == 300.0
