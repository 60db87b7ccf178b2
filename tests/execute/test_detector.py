"""The detector's extras in products: right, the same in every tiling, absent unless asked for."""

from __future__ import annotations

import copy
import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.arrays import FrameStars, select
from pipeline.execute.detector import stream_place, tile_chain
from pipeline.execute.sources import drawing_order
from pipeline.physics.noise.chain import held_e, noise_e, to_dn
from pipeline.physics.noise.streams import stream_key
from pipeline.plan.optics.optics import clock_step_px
from pipeline.plan.tiles import Tile
from pipeline.route.draw import missing
from pipeline.route.prepare import plan_scene, prepare
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.spec.scene import CELL_PX
from pipeline.store.cube import open_cube
from pipeline.store.product import Begun
from tests.slow import slow

SIDE = 320
SCENE = {
    "schema": "nightglass/scene/1",
    "name": "detector",
    "epoch": "2019-07-20T09:00:00Z",
    "seed": 5,
    "accept": ["moon"],
    "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
    "sensor": {
        "shape": [SIDE, SIDE],
        "pixel_pitch_um": 9.0,
        "focal_length_m": 0.5,
        "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
        "full_well_e": 60000,
        "gain_e_per_dn": 2.0,
        "bias_dn": 100,
        "dark_e_per_s": 3.0,
        "read_noise_e": 4.0,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 5.0},
    "exposure": {"integration_s": 2.0},
    "background": {"uniform_e_per_s": 500.0},
    "targets": [
        {
            "name": "t",
            "orbit": {
                "kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3070, 0],
            },
            "body": {"kind": "sphere", "diameter_m": 1.0e5, "albedo": 0.5},
        }
    ],
    "output": {"layers": ["dn", "mean_e"]},
}  # fmt: skip
BRIGHT = {"pointing": {"mode": "target", "target": "t"}}
ALL_LAYERS = ["dn", "mean_e", "targets_e", "background_e", "dark_e", "lag_e", "calibrated_e"]


def scene(detector=None, **changes):
    data = copy.deepcopy(SCENE)
    for key, value in changes.items():
        *parents, last = key.split("__")
        holder = data
        for part in parents:
            holder = holder[part]
        holder[last] = value
    if detector is not None:
        data["sensor"]["detector"] = detector
    return parse_scene(data)


def frames(product) -> dict[str, np.ndarray]:
    cube = open_cube(product)
    return {str(n): cube[n].values for n in cube.data_vars if cube[n].dims == ("frame", "y", "x")}


def is_near(found: np.ndarray, expected: np.ndarray, rel: float, off: float) -> bool:
    return bool((np.abs(found - expected) <= np.maximum(rel * np.abs(expected), off)).all())


EXTRAS = {
    "bad": {"bad": {"pixels": [[3, 300]], "rows": [7, 259], "columns": [256], "fraction": 1e-3,
                    "reads_dn": 9}},
    "dead": {"dead": {"columns": [9], "fraction": 1e-2}},
    "hot": {"hot": {"pixels": [[300, 2, 5e3]], "fraction": 1e-2}},
    "prnu": {"prnu": 0.02},
    "polynomial": {"nonlinearity": {"kind": "polynomial", "coefficients": [-0.05, 0.01]}},
    "table": {"nonlinearity": {"kind": "table", "true_e": [0, 1e3, 6e4], "read_e": [0, 900, 5e4]}},
    "blooming": {"blooming": True},
    "lines": {"row_noise_e": 3.0, "column_noise_e": 5.0},
    "bias": {"bias_structure": {"row_rms_dn": 2.0, "column_rms_dn": 3.0, "pixel_rms_dn": 1.0,
                                "row_slope_dn": 20.0, "column_slope_dn": -7.0}},
    "amplifiers": {"amplifiers": [
        {"rows": [0, 320], "columns": [0, 160], "gain_e_per_dn": 1.5, "offset_dn": 30},
        {"rows": [0, 100], "columns": [160, 320], "read_noise_e": 12.0}]},
    "lag": {"lag": {"fraction": 0.05}},
    "smear": {"readout": {"kind": "frame_transfer", "transfer_s": 0.05}},
    "tdi": {"readout": {"kind": "tdi", "rows_per_s": 3.0}},
    "hot, none by chance": {"hot": {"pixels": [[300, 2, 5e3]]}},
}  # fmt: skip


def together(*names):
    """Several extras in one section."""
    return {k: v for n in names for k, v in EXTRAS[n].items()}


TOGETHER = {
    "pixel by pixel": together(
        "bad", "dead", "hot", "prnu", "table", "lines", "bias", "amplifiers"
    ),
    "columns": together("blooming", "smear", "polynomial"),
    "lag": together("lag"),
    "tdi": together("tdi", "prnu", "hot"),
}


@pytest.mark.parametrize("name", [slow(n) if n == "lag" else n for n in TOGETHER])
def test_same_bits_in_every_tiling(name, tmp_path):
    detector = TOGETHER[name]
    more = {"exposure": {"integration_s": 2.0, "frames": 2 if name == "lag" else 1}, **BRIGHT}
    one = scene(detector, **more, output={"layers": ALL_LAYERS})
    rows = SIDE if one.sensor.detector.whole_columns else 256
    tiled = {"layers": ALL_LAYERS, "tile_shape": [rows, 256]}
    render(one, tmp_path / "whole", Options("synchronous"))
    render(scene(detector, **more, output=tiled), tmp_path / "tiles", Options("threads", 2))
    whole, tiles = frames(tmp_path / "whole"), frames(tmp_path / "tiles")
    assert set(whole) == set(ALL_LAYERS)
    for layer in ALL_LAYERS:
        assert np.array_equal(whole[layer], tiles[layer], equal_nan=True), layer
    light = whole["targets_e"] + whole["background_e"] + whole["dark_e"] + whole["lag_e"]
    assert is_near(light, whole["mean_e"], rel=1e-5, off=1e-3)


@pytest.mark.parametrize("name", EXTRAS)
def test_each_extra_changes_the_frame_and_stands_in_the_plan(name, tmp_path, plain):
    _, dn, before = plain
    one = scene(EXTRAS[name], **BRIGHT)
    render(one, tmp_path / "run")
    found = frames(tmp_path / "run")["dn"]
    assert not np.array_equal(found, dn)
    plan = plan_scene(one)
    named = [d for d in plan["decisions"] if d["component"] not in before | {"detector_extras"}]
    assert named
    assert all(d["kept"] and d["reason"] for d in named)
    json.dumps(plan, allow_nan=False)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The scene without extras: its layers, its frame, and the components of its plan."""
    path = tmp_path_factory.mktemp("plain") / "run"
    one = scene(None, **BRIGHT, output={"layers": ["dn", "mean_e", "targets_e"]})
    render(one, path)
    layers = frames(path)
    return layers, layers["dn"], {d["component"] for d in plan_scene(one)["decisions"]}


def test_errors_of_the_light_come_through_the_flat(tmp_path):
    """As far as pixels err by it: what is found, what is stated, and what drawing may err by; a
    column that takes no light errs by nothing."""
    same = {"accuracy": {"noise_floor_e": 0.01}}  # the same light at every flat
    image = np.full((320, 320), 40.0)
    image[:, 7] = 0.0
    np.save(tmp_path / "flat.npy", image)
    found = {}
    for flat in (1.0, 0.1, 40.0, str(tmp_path / "flat.npy")):
        s = scene(sensor__flat=flat, sensor__read_noise_e=1e4, **same)
        report = render(s, tmp_path / f"product-{len(found)}", Options("synchronous"))
        found[flat] = report["errors"]
    one = found[1.0]
    for flat, raised in ((0.1, 0.1), (40.0, 40.0), (str(tmp_path / "flat.npy"), 40.0)):
        errors = found[flat]
        assert errors["achieved_error_e"] == pytest.approx(one["achieved_error_e"], rel=1e-9)
        sigma = raised * one["achieved_error_sigma"]
        assert errors["achieved_error_sigma"] == pytest.approx(sigma, rel=2e-3)
        stated = max(1.0, raised) * one["bound_of_all_approximations_sigma"]
        assert errors["bound_of_all_approximations_sigma"] == pytest.approx(stated, rel=0.05)
    for flat in (1.0, 40.0):
        plan = prepare(scene(sensor__flat=flat, background={"uniform_mag_arcsec2": 18.0})).plan
        (grid,) = (d for d in plan.decisions if d.component == "background.grid")
        assert grid.error_bound_sigma == pytest.approx(
            grid.error_bound_e / plan.facts.light_floor_e, rel=0.01
        )
    budgets = [prepare(scene(sensor__flat=f)).plan.facts.budget_e for f in (0.2, 1.0, 40.0)]
    assert budgets == pytest.approx([budgets[1], budgets[1], budgets[1] / 40.0])


def test_nothing_of_it_unless_asked_for(tmp_path):
    """An empty section changes no bit; without one a single line of the plan tells so."""
    render(scene(), tmp_path / "none")
    render(scene({}), tmp_path / "empty")
    assert np.array_equal(frames(tmp_path / "none")["dn"], frames(tmp_path / "empty")["dn"])
    lines = [d for d in plan_scene(scene())["decisions"] if d["component"] == "detector_extras"]
    assert [d["kept"] for d in lines] == [False]
    assert prepare(scene({})).maps == prepare(scene()).maps


def test_bad_pixels_read_what_is_said(tmp_path):
    found = {"pixels": [[3, 300]], "rows": [7], "columns": [256], "reads_dn": 65535}
    np.save(tmp_path / "map.npy", np.eye(SIDE)[::-1])
    found["map"] = str(tmp_path / "map.npy")
    render(scene({"bad": found}), tmp_path / "run")
    dn = frames(tmp_path / "run")["dn"][0]
    bad = np.eye(SIDE)[::-1] != 0
    bad[7] = bad[:, 256] = bad[3, 300] = True
    assert np.array_equal(dn == 65535, bad)


def test_images_of_faults_in_every_format(tmp_path):
    import zarr
    from astropy.io import fits

    image = (np.random.default_rng(0).random((SIDE, SIDE)) < 0.01).astype(np.uint8)
    np.save(tmp_path / "a.npy", image)
    fits.PrimaryHDU(image).writeto(tmp_path / "a.fits")
    zarr.save_array(tmp_path / "a.zarr", image)
    for name in ("a.npy", "a.fits", "a.zarr"):
        maps = prepare(scene({"dead": {"map": str(tmp_path / name)}})).maps
        assert np.array_equal(maps.flat == 0, image != 0)


@pytest.mark.parametrize(("towards", "cleared"), [("high_rows", False), ("low_rows", True)])
def test_smear_against_brute_force(towards, cleared, tmp_path, plain):
    """Row by row: charge is moved a row at a time, and collects what falls there."""
    readout = {"kind": "frame_transfer", "transfer_s": 0.08, "towards": towards}
    detector = {"readout": readout | {"cleared": cleared}}
    render(scene(detector, **BRIGHT, output={"layers": ["dn", "targets_e"]}), tmp_path / "run")
    still = plain[0]["targets_e"][0].astype(float)
    expected, step, up = still.copy(), 0.08 / SIDE / 2.0, towards == "high_rows"
    for y in range(SIDE):
        passed = list(range(y + 1, SIDE)) if up else list(range(y))
        if not cleared:
            passed += list(range(y)) if up else list(range(y + 1, SIDE))
        expected[y] += step * still[passed].sum(axis=0)
    assert is_near(frames(tmp_path / "run")["targets_e"][0], expected, rel=1e-5, off=1e-6)


@pytest.mark.parametrize("count", [3, slow(5)])
def test_lag_against_frame_by_frame(count, tmp_path):
    """Reading frame after frame, of exposures long and short, keeping a share each time; also when
    only the last is redrawn."""
    target = copy.deepcopy(SCENE["targets"])
    more = {"dwells": [{"integration_s": [2.0, 0.5], "frames": count}], "targets": target}
    more["pointing"] = {"mode": "target", "target": "t"}
    more["cosmic_rays"] = {"kind": "generated", "rate_per_cm2_s": 40}
    layers = {"layers": ["dn", "mean_e", "lag_e", "cosmic_rays_e"]}
    render(scene(None, **more, output=layers), tmp_path / "still")
    render(scene({"lag": {"fraction": 0.05}}, **more, output=layers), tmp_path / "lag")
    still, lag = frames(tmp_path / "still"), frames(tmp_path / "lag")
    kept = np.zeros((SIDE, SIDE))
    for k in range(count):
        collected = np.minimum(still["mean_e"][k] + still["cosmic_rays_e"][k].astype(float), 60000)
        read = 0.95 * (still["mean_e"][k] + kept)
        assert is_near(lag["mean_e"][k], read, rel=1e-5, off=0.2)
        kept = 0.05 * (collected + kept)
    (tmp_path / "lag" / "_COMPLETE").unlink()
    for marker in (tmp_path / "lag" / "markers").glob(f"f{count - 1:06d}*"):
        marker.unlink()
    render(
        scene({"lag": {"fraction": 0.05}}, **more, output=layers), tmp_path / "lag",
        Options(resume=True),
    )  # fmt: skip
    again = frames(tmp_path / "lag")
    assert all(np.array_equal(again[n], lag[n]) for n in lag)


@pytest.mark.parametrize("coefficients", [[0.05], [-0.05, 0.01], [0.2, -0.1]])
def test_a_polynomial_bends_as_far_as_it_says(coefficients):
    """Read over collected, x + c2 x^2 + c3 x^3 of the full well: above it too."""
    bent = {"nonlinearity": {"kind": "polynomial", "coefficients": coefficients}}
    plan = prepare(scene(bent))
    collected, read = plan.maps.linearity
    full_e = plan.plan.scene.sensor.full_well_e
    x = collected / full_e
    wanted = x + sum(c * x ** (n + 2) for n, c in enumerate(coefficients))
    np.testing.assert_allclose(read / full_e, wanted, rtol=1e-12)
    assert collected[-1] == full_e


@pytest.mark.parametrize("edges", ["full", "partial"])
def test_tdi_meets_what_its_charge_passes(edges):
    """A hot pixel and one without response: in the rows whose charge passes them in the exposure,
    as often as it does; others know nothing of them."""
    faults = {"hot": {"pixels": [[200, 9, 2e4]]}, "dead": {"pixels": [[100, 9]]}}
    readout = {"kind": "tdi", "rows_per_s": 5.0, "edges": edges}
    one = scene(faults | {"readout": readout})
    maps, whole = prepare(one).maps, Tile(0, 0, 0, 0, SIDE, SIDE)
    chain = tile_chain(one, maps, whole, 2.0)
    part = tile_chain(one, maps, Tile(0, 0, 190, 4, 20, 8), 2.0, 2)
    assert np.array_equal(np.asarray(part.dark_e), np.asarray(chain.dark_e)[190:210:2, 4:12:2])
    assert np.array_equal(np.asarray(part.flat), np.asarray(chain.flat)[190:210:2, 4:12:2])
    dark, flat = np.asarray(chain.dark_e), np.asarray(chain.flat)
    met = np.clip(5.5 - np.abs(np.arange(SIDE) - 200), 0.0, 1.0)  # of the way of 10 rows
    assert dark[50:250, 9] == pytest.approx((6.0 + 4e3 * met)[50:250], rel=1e-12)
    met = np.clip(5.5 - np.abs(np.arange(SIDE) - 100), 0.0, 1.0)
    assert flat[50:250, 9] == pytest.approx((1.0 - 0.1 * met)[50:250], rel=1e-12)
    assert (flat[:, 20] < 1.0).any() == (edges == "partial")


def test_tdi_holds_an_image_that_moves_with_the_charge(tmp_path):
    """A drifting camera and charge that follows its image hold the image still."""
    from pipeline.plan.pointing.geometry import plan_geometry, star_paths

    drift = {"mode": "rate", "boresight_ra_deg": 10.0, "boresight_dec_deg": 5.0}
    pixel_arcsec = np.degrees(9e-6 / 0.5) * 3600
    rate = 40 * pixel_arcsec / 2.0
    pointing = drift | {"rate_ra_arcsec_s": 0.0, "rate_dec_arcsec_s": rate}
    moving = {"pointing": pointing, "targets": []}

    def path(detector):
        p = prepare(scene(detector, **moving)).plan
        g = plan_geometry(p.scene, np.zeros(1, np.int64), p.dut1_s)
        x, y = np.array([20.0, 159.5, 300.0]), np.array([20.0, 159.5, 300.0])
        return star_paths(p.camera, g, x, y)[:, :, 0]

    plain = path(None)
    speed = (plain[1, 1, -1] - plain[1, 1, 0]) / 2.0
    assert abs(speed) == pytest.approx(20.0, rel=1e-4)
    held = path({"readout": {"kind": "tdi", "rows_per_s": float(speed)}})
    assert np.ptp(held[1], axis=-1).max() < 0.01
    assert held[:, :, held.shape[2] // 2] == pytest.approx(plain[:, :, plain.shape[2] // 2])
    plan = plan_scene(scene({"readout": {"kind": "tdi", "rows_per_s": float(speed)}}, **moving))
    assert any("streaks" in d["reason"] for d in plan["decisions"] if d["component"] == "tdi")


def test_tdi_says_how_late_its_last_line_is():
    """Half of the rows over the clock's rate, on an array that is wider than high."""
    wide = scene({"readout": {"kind": "tdi", "rows_per_s": 5.0}}, **BRIGHT, sensor__shape=[80, 320])
    (told,) = [d for d in plan_scene(wide)["decisions"] if d["component"] == "tdi"]
    assert "targets up to 8 s earlier or later" in told["reason"]
    exposed_s = wide.exposure.integration_s
    assert f"the outer {5.0 * exposed_s / 80:.3g} of the rows" in told["reason"]


def test_tdi_streaks_by_the_difference_and_by_its_clock(tmp_path):
    """The light along a column against a box of the streak and one of the clock's step."""
    detector = {"readout": {"kind": "tdi", "rows_per_s": 6.0, "clock_phases": 2}}
    render(scene(detector, **BRIGHT, output={"layers": ["dn", "targets_e"]}), tmp_path / "run")
    light = frames(tmp_path / "run")["targets_e"][0].astype(float)
    y, x = np.indices(light.shape)
    total = light.sum()
    row, column = (y * light).sum() / total, (x * light).sum() / total
    across = (((x - column) ** 2) * light).sum() / total
    along = (((y - row) ** 2) * light).sum() / total
    assert along - across == pytest.approx((12.0**2 + 0.5**2) / 12.0, rel=2e-3)


@pytest.mark.parametrize(
    ("rows_per_s", "box_px"), [(1e-6, 2e-6), (0.05, 0.1), (0.4, 0.8), (2.0, 1.0)]
)
def test_a_clock_blurs_by_no_more_than_the_charge_moves(rows_per_s, box_px):
    """In 2 s of less than one step of a row an image that keeps pace smears by its own motion."""
    detector = {"readout": {"kind": "tdi", "rows_per_s": rows_per_s, "clock_phases": 1}}
    assert clock_step_px(scene(detector)) == pytest.approx(box_px, rel=1e-12)


def test_streams_of_the_chain_are_named_and_independent():
    """Each part of the noise draws from the stream of its own name, and no two go together."""
    one = scene({"row_noise_e": 1.0, "column_noise_e": 1.0}, sensor__full_well_e=None)
    place = stream_place(one, Tile(0, 0, 0, 0, SIDE, SIDE), 0)
    keys = {
        "photon_noise": place.photon_key, "read_noise": place.read_key,
        "row_noise": place.row_key, "column_noise": place.column_key,
    }  # fmt: skip
    assert keys == {name: stream_key(5, name) for name in keys}
    assert len(set(keys.values())) == 4


def test_read_noise_is_not_the_photon_noise_again():
    """Drawn apart, the two are uncorrelated; variances of the whole chain add up."""
    mean = np.full((SIDE, SIDE), 1e4)
    fine = {"sensor__gain_e_per_dn": 0.01, "sensor__adc_bits": 32, "sensor__full_well_e": None}

    def drawn(read_noise_e, photon_noise):
        made = scene(
            sensor__read_noise_e=read_noise_e, sensor__photon_noise=photon_noise, **fine
        )
        tile = Tile(0, 0, 0, 0, SIDE, SIDE)
        chain = tile_chain(made, prepare(made).maps, tile, 2.0)
        dn = to_dn(mean, chain, stream_place(made, tile, 0)).astype(float).ravel()
        return 0.01 * (dn - 100.0) - 1e4

    photons, read, both = drawn(0.0, True), drawn(100.0, False), drawn(100.0, True)
    assert photons.std() == pytest.approx(100.0, rel=0.02)
    assert read.std() == pytest.approx(100.0, rel=0.02)
    assert abs(np.corrcoef(photons, read)[0, 1]) < 4.0 / SIDE  # its own scatter is 1 / SIDE
    assert both.var() == pytest.approx(2e4, rel=4.0 * np.sqrt(2.0) / SIDE)


def test_noise_of_pixels_is_what_frames_scatter_by():
    """Photons, reading, lines and rounding: told for the check, and measured over frames."""
    made = scene(
        {"row_noise_e": 6.0, "column_noise_e": 8.0}, sensor__gain_e_per_dn=30.0,
        sensor__full_well_e=None, sensor__shape=[64, 64],
    )
    tile = Tile(0, 0, 0, 0, 64, 64)
    chain = tile_chain(made, prepare(made).maps, tile, 2.0)
    mean = np.broadcast_to(np.linspace(10.0, 400.0, 64), (64, 64)).copy()
    drawn = np.array([to_dn(mean, chain, stream_place(made, tile, k)) for k in range(400)])
    measured = 30.0 * drawn.astype(float).std(axis=0)
    told = noise_e(mean, chain, np.s_[:, 8:])
    assert (measured[:, 8:].mean(axis=0) / told.mean(axis=0)).mean() == pytest.approx(1.0, abs=0.01)
    quiet = tile_chain(scene(sensor__photon_noise=False), prepare(made).maps, tile, 2.0)
    assert noise_e(mean, quiet, np.s_[:2, :2]) == pytest.approx(np.hypot(4.0, 30.0 / 12**0.5))


def test_charge_that_lags_is_what_the_well_holds():
    """Frames after one see its charge, cosmic rays included, up to the full well."""
    made = scene({"lag": {"fraction": 0.05}}, sensor__full_well_e=5e3)
    mean, rays = np.array([[10.0, 4e3, 9e3]]), np.array([[0.0, 2e3, 1.0]])
    chain = tile_chain(made, prepare(made).maps, Tile(0, 0, 0, 0, SIDE, SIDE), 2.0)
    assert chain.lag == 0.05
    assert held_e(mean, rays, chain).tolist() == [[10.0, 5e3, 5e3]]
    assert held_e(mean, None, chain).tolist() == [[10.0, 4e3, 5e3]]
    endless = replace(chain, full_well_e=None)
    assert held_e(mean, rays, endless).tolist() == [[10.0, 6e3, 9001.0]]


def test_frames_of_several_lengths_have_rays_of_their_own_time(tmp_path):
    """Cosmic rays of a dwell go with each frame's exposure, in the layer and in the truth."""
    dwells = [{"frames": 2, "integration_s": [2.0, 40.0]}]
    rays = {"kind": "generated", "rate_per_cm2_s": 30.0}
    made = scene(
        dwells=dwells, cosmic_rays=rays, output={"layers": ["dn", "cosmic_rays_e"]}, targets=[]
    )
    render(made, tmp_path / "run")
    charge = frames(tmp_path / "run")["cosmic_rays_e"].astype(float).sum(axis=(1, 2))
    table = pq.read_table(tmp_path / "run" / "truth" / "cosmic_rays.parquet").to_pandas()
    told = table.groupby("frame")["electrons"].sum()
    assert charge == pytest.approx(told.to_numpy(), rel=1e-4)
    area_cm2 = (SIDE * 9e-4) ** 2
    for k, seconds in enumerate((2.0, 40.0)):
        count = np.sum((table["frame"] == k) & (table["electrons"] > 500.0))
        assert abs(count - 30.0 * area_cm2 * seconds) < 0.3 * 30.0 * area_cm2 * seconds + 9.0


def test_a_window_brings_all_frames_that_lag_into_it():
    """Frames 5 and 6 of ten, nothing drawn yet: placed from as many frames before as the plan says.

    With a tenth of the charge left each time, one frame before is not enough.
    """
    exposure = {"integration_s": 2.0, "frames": 10}
    plan = prepare(scene({"lag": {"fraction": 0.1}}, exposure=exposure)).plan
    begun = Begun(Path(), None, frozenset(), frozenset(), ())
    assert plan.lag_frames >= 2
    work = missing(plan, begun, np.array([5, 6]))
    first = max(0, 5 - plan.lag_frames)
    assert work.geometry.frame.tolist() == list(range(first, 7))
    assert {int(work.geometry.frame[i]) for i, _ in work.tiles} == {5, 6}
    assert [int(work.geometry.frame[i]) for i in work.target_truth] == [5, 6]


def test_amplifiers_read_their_rows_and_columns():
    """A frame wider than high, with an amplifier at its right and one in a corner."""
    amplifiers = [
        {"rows": [0, 100], "columns": [200, 300], "gain_e_per_dn": 1.5, "offset_dn": 30},
        {"rows": [90, 100], "columns": [0, 20], "read_noise_e": 12.0},
    ]
    maps = prepare(scene({"amplifiers": amplifiers}, sensor__shape=[100, 300])).maps
    row, column = np.indices((100, 300))
    right, corner = column >= 200, (row >= 90) & (column < 20)
    assert np.array_equal(maps.gain_e_per_dn, np.where(right, 1.5, 2.0))
    assert np.array_equal(maps.bias_dn, np.where(right, 130.0, 100.0))
    assert np.array_equal(maps.read_noise_e, np.where(corner, 12.0, 4.0))


def test_each_cell_is_checked_once_in_its_own_frame(tmp_path):
    """The achieved error of a product has records, one or two, of each cell that the plan chose."""
    made = scene(**BRIGHT, exposure={"integration_s": 2.0, "frames": 3})
    records = render(made, tmp_path / "run")["errors"]["checked"]
    cells = prepare(made).plan.checks
    assert 0 < len(cells) <= len(records) <= 2 * len(cells)
    found = {(r["frame"], r["y0"] // CELL_PX, r["x0"] // CELL_PX) for r in records}
    assert found == {(c.frame, c.row, c.column) for c in cells}


def test_stars_of_one_id_are_drawn_in_one_order():
    """Two catalogues use an id for two stars in one square: the main one's first, however read."""
    n = np.arange(4.0)
    stars = FrameStars(
        np.array([7, 5, 7, 5]), 10.0 + n, 20.0 + n, 100.0 + n, n, n, n, np.zeros(4, np.uint8),
        np.array([1, 0, 0, 1], np.uint8), np.ones(4),
    )  # fmt: skip
    for order in itertools.permutations(range(4)):
        found = drawing_order(select(stars, np.array(order)))
        assert found.light_e.tolist() == [101.0, 103.0, 102.0, 100.0]


@pytest.mark.parametrize(("row", "column"), [(3.0, 4.0), (5.0, 0.0), (0.0, 5.0)])
def test_the_plans_noise_holds_that_of_rows_and_columns(row, column):
    """12 e- of a pixel, with 5 e- of its lines: 13 in quadrature, however they are shared."""
    s = scene({"row_noise_e": row, "column_noise_e": column}, sensor__read_noise_e=12.0)
    assert prepare(s).plan.facts.read_noise_e == pytest.approx(13.0)


@pytest.mark.parametrize("coefficients", [[-0.05], [0.05], [-0.05, 0.01], [0.02, -0.08]])
def test_points_of_a_polynomial_err_by_what_the_plan_says(coefficients):
    """Straight lines between 4097 points, against the polynomial half way between them."""
    bent = {"nonlinearity": {"kind": "polynomial", "coefficients": coefficients}}
    plan = prepare(scene(bent)).plan
    (told,) = (d for d in plan.decisions if d.component == "nonlinearity")
    curve = np.polynomial.Polynomial([0.0, 1.0, *coefficients])
    x = np.linspace(0.0, 1.0, 4097)
    between = 0.5 * (curve(x[1:]) + curve(x[:-1])) - curve(0.5 * (x[1:] + x[:-1]))
    off_e = np.abs(between).max() * SCENE["sensor"]["full_well_e"]
    assert off_e <= told.error_bound_e <= 1.1 * off_e


def test_drawing_is_planned_for_the_quietest_amplifier():
    """Bounds are in units of its noise, the SNR of sources in that of a typical pixel."""
    half = SCENE["sensor"]["shape"][1] // 2
    one = {"rows": [0, SCENE["sensor"]["shape"][0]], "columns": [0, half], "read_noise_e": 3.0}
    told = {"sensor__read_noise_e": 30.0, "sensor__dark_e_per_s": 0.0, "sensor__gain_e_per_dn": 2.0}
    quiet = prepare(scene({"amplifiers": [one]}, **told)).plan
    loud = prepare(scene({}, **told)).plan
    sky_e2 = loud.facts.sigma_floor_e**2 - 900.0
    assert quiet.facts.sigma_floor_e**2 == pytest.approx(9.0 + sky_e2, rel=1e-9)
    typical = quiet.facts.read_noise_e
    assert quiet.floor_e(0) ** 2 == pytest.approx(typical**2 + sky_e2, rel=1e-9)
    assert loud.facts.quieter_e2 == 0.0
    ratio = loud.facts.sigma_floor_e / quiet.facts.sigma_floor_e
    assert loud.facts.budget_e == pytest.approx(ratio * quiet.facts.budget_e, rel=1e-9)
