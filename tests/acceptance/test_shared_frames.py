"""Frames of a stare share one drawing of their stars: within its bound, and with the same bits."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

import pipeline.plan.scene_plan
from pipeline.route.prepare import prepare
from pipeline.route.run import Options, render
from pipeline.store.cube import open_cube
from pipeline.store.markers import place_of
from pipeline.store.product import check

FRAMES = 5
MANY = {"integration_s": 1.0, "frames": 4000, "cadence_s": 1.5}


@pytest.fixture(scope="module")
def scene(sidereal, geo_tle, build):
    """Real stars with wings over a turning site, and a satellite that goes past them."""
    still = {
        "sensor.shape": [640, 512],
        "sensor.aperture_m": 0.2,
        "sensor.psf": {"kind": "airy", "jitter_px": 0.4},
        "exposure": {"integration_s": 1.0, "frames": FRAMES, "cadence_s": 1.5},
        "output": {"layers": ["dn", "stars_e", "targets_e", "mean_e"]},
        "targets": [{
            "name": "amc-4",
            "orbit": {"kind": "tle", "line1": geo_tle[0], "line2": geo_tle[1]},
            "body": {"kind": "sphere", "diameter_m": 5.0, "albedo": 0.2},
        }],
    }  # fmt: skip
    return lambda more=None: build(sidereal, still | (more or {}))


@pytest.fixture(scope="module")
def shared(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("shared") / "run"
    return path, render(scene(), path, Options("synchronous"))


def layer(path, name):
    return open_cube(path)[name].values


def stated(plan):
    return next(d for d in plan.decisions if d.component == "shared_frames")


def test_stars_are_where_their_frame_has_them_within_the_bound(
    scene, shared, tmp_path, monkeypatch
):
    """Against each frame's stars drawn for itself."""
    plan = prepare(scene()).plan
    assert plan.shared_frames == FRAMES
    d = stated(plan)
    monkeypatch.setattr(pipeline.plan.scene_plan, "share_frames", lambda *_: (1, ()))
    apart = prepare(scene()).plan
    assert apart.shared_frames == 1
    assert not [one for one in apart.decisions if one.component == "shared_frames"]
    render(scene(), tmp_path / "run", Options("synchronous"))
    ours, theirs = layer(shared[0], "stars_e"), layer(tmp_path / "run", "stars_e")
    np.testing.assert_array_equal(ours[0], theirs[0])
    off_e = np.abs(ours.astype(float) - theirs)
    assert np.any(off_e[1:] > 0.0)
    rounding = 2.0**-23 * theirs.max()
    assert off_e.max() <= d.error_bound_e + rounding
    noise = np.sqrt(plan.facts.sigma_floor_e**2 + theirs)
    assert (off_e / noise).max() <= d.error_bound_sigma + rounding / noise.min()
    assert (off_e / noise).max() >= 0.01 * d.error_bound_sigma
    for name in ("targets_e",):
        np.testing.assert_array_equal(layer(shared[0], name), layer(tmp_path / "run", name))


def test_the_bound_is_of_the_sources_light_and_its_own_noise(scene):
    """Twice as far is twice as bad; none that stands still errs; a brighter one hides its own."""
    plan = prepare(scene()).plan
    bound = pipeline.plan.stars.shared_frames.bound_sigma
    assert bound(plan, 0.0) == 0.0
    assert bound(plan, 2e-7) == pytest.approx(2.0 * bound(plan, 1e-7), rel=1e-3)
    total = sum(d.error_bound_sigma or 0.0 for d in plan.decisions)
    assert total <= plan.scene.accuracy.noise_fraction


def test_of_stars_that_move_faster_and_faster_fewer_frames_share(scene, monkeypatch):
    """As over an orbit that begins where aberration stands still: the bound holds for all that
    share, and would for no group of twice as many."""
    shared_frames = pipeline.plan.stars.shared_frames
    plan, asked = prepare(scene({"exposure": MANY})).plan, []
    left = shared_frames.PART * plan.scene.accuracy.noise_fraction
    first_px = 1e-12 * left / shared_frames.bound_sigma(plan, 1e-9)

    def moved_px(_plan, _sampled, _own, together):
        asked.append(together)
        return first_px * (together - 1) ** 2

    monkeypatch.setattr(shared_frames, "_moved_px", moved_px)
    together, (decision,) = shared_frames.share_frames(plan, (), np.arange(9), None, 1.0)
    assert asked[:2] == [2, pytest.approx(1000, abs=1)]
    assert asked[2:] == [asked[1] >> k for k in range(1, 6)]
    least, most = (shared_frames.bound_sigma(plan, first_px * (n - 1) ** 2)
                   for n in (together, 2 * together))  # fmt: skip
    assert decision.error_bound_sigma == least <= left < most
    assert together == asked[-1]


@pytest.mark.parametrize("sharpest", [0, 1])
def test_the_bound_is_of_the_sharpest_place_of_the_field(scene, sharpest):
    """A wide response and a sharp one, wherever it stands: as where all the field is sharp."""
    psfs = [[{"kind": "gaussian", "sigma_px": s} for s in (2.0, 2.0)]]
    psfs[0][sharpest]["sigma_px"] = 0.8
    of_field = {"kind": "field", "rows_px": [320.0], "columns_px": [0.0, 511.0], "psfs": psfs}
    bounds = []
    for psf in (of_field, {"kind": "gaussian", "sigma_px": 0.8}):
        bare = {"sensor.psf": psf, "sensor.photon_noise": False, "targets": []}
        plan = prepare(scene(bare)).plan
        plan = replace(plan, facts=replace(plan.facts, brightest_e=1e6, sigma_floor_e=10.0))
        bounds.append(pipeline.plan.stars.shared_frames.bound_sigma(plan, 1e-6))
    assert bounds[0] == pytest.approx(bounds[1], rel=1e-6)


@pytest.mark.parametrize(
    ("tiles", "scheduler"), [([256, 256], "threads"), ([640, 256], "synchronous")]
)
def test_same_bits_for_any_tile_and_scheduler(scene, shared, tmp_path, tiles, scheduler):
    cut = scene({"output": {"layers": ["dn", "stars_e", "targets_e"], "tile_shape": tiles}})
    render(cut, tmp_path / "run", Options(scheduler))
    for name in ("dn", "stars_e", "targets_e"):
        np.testing.assert_array_equal(layer(tmp_path / "run", name), layer(shared[0], name))


def test_same_bits_where_the_first_frame_is_there_already(scene, shared, tmp_path):
    """What is left of a product is drawn where the first frame's stars stand, not its own."""
    path = tmp_path / "run"
    shutil.copytree(shared[0], path)
    (path / "_COMPLETE").unlink()
    for marker in (path / "markers").iterdir():
        if place_of(marker)[0] in (1, 3):
            marker.unlink()
    again = render(scene(), path, Options("synchronous", resume=True))
    assert again["content_digest"] == shared[1]["content_digest"]
    assert check(path).whole
    for name in ("dn", "stars_e"):
        np.testing.assert_array_equal(layer(path, name), layer(shared[0], name))


def test_charge_that_stays_behind(scene, tmp_path):
    """Frames before a window give their charge with the stars of the frame that they share."""
    lag = {"sensor.detector": {"lag": {"fraction": 0.02}}, "sensor.full_well_e": 1e9}
    whole, rest = tmp_path / "whole", tmp_path / "rest"
    report = render(scene(lag), whole, Options("synchronous"))
    shutil.copytree(whole, rest)
    (rest / "_COMPLETE").unlink()
    for marker in (rest / "markers").iterdir():
        if place_of(marker)[0] == 4:
            marker.unlink()
    again = render(scene(lag), rest, Options("synchronous", resume=True))
    assert again["content_digest"] == report["content_digest"]


@pytest.mark.parametrize(
    "more",
    [
        {"exposure": {"integration_s": 1.0}},
        {"pointing": {"mode": "rate", "boresight_ra_deg": 0.7, "boresight_dec_deg": -0.45,
                      "rate_ra_arcsec_s": 2.0, "rate_dec_arcsec_s": 0.0}},
        {"observer.atmosphere": {"refraction": True}},
        {"exposure": {"integration_s": 1.0, "frames": 2, "cadence_s": 20_000.0}},
    ],
    ids=["one frame", "a streak", "air", "hours between"],
)  # fmt: skip
def test_frames_whose_stars_move_share_nothing(scene, more):
    plan = prepare(scene(more)).plan
    assert plan.shared_frames == 1
    assert not [d for d in plan.decisions if d.component == "shared_frames"]
