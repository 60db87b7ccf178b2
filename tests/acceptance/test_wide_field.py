"""Light across a wide field: a pixel's solid angle, and the pupil seen from off axis."""

from __future__ import annotations

import copy
from itertools import product
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from catalog_tools.ingest.ingest import ingest
from pipeline.execute.sources import place_targets
from pipeline.physics.positions.focal_plane import deproject
from pipeline.plan.optics.pupil import mean_pupil_fraction, pupil_along
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.pointing.star_paths import star_paths
from pipeline.route.prepare import plan_scene, prepare
from pipeline.route.run import render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube

SIDE = 512
IFOV = 2.0 * np.tan(np.radians(10.0)) / SIDE  # 20 x 20 degrees
SCENE = {
    "schema": "nightglass/scene/1", "name": "wide", "epoch": "2019-07-20T09:00:00Z",
    "observer": {"kind": "fixed", "position_au": [1.0, 0.1, 0.0]},
    "sensor": {
        "shape": [SIDE, SIDE], "pixel_pitch_um": 10.0, "focal_length_m": 1e-5 / IFOV,
        "aperture_m": 0.01, "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0}, "read_noise_e": 5.0, "adc_bits": 24,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 300.0, "boresight_dec_deg": 0.0},
    "exposure": {"integration_s": 1.0},
    "accuracy": {"check_cells": 0},
    "output": {"layers": ["dn", "background_e"]},
}  # fmt: skip
SKY = {"background": {"uniform_mag_arcsec2": 18.0}}


def with_sensor(scene: dict, **more) -> dict:
    scene = copy.deepcopy(scene)
    scene["sensor"] |= more
    return scene


def layer(scene: dict, path: Path, name: str) -> np.ndarray:
    render(parse_scene(scene), path)
    return np.asarray(open_cube(path)[name][0], float)


def cosines(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Of the angles off axis, from vectors."""
    u = np.stack([(x - 255.5) * IFOV, (y - 255.5) * IFOV, np.ones(np.shape(x))], -1)
    return u[..., 2] / np.linalg.norm(u, axis=-1)


@pytest.mark.parametrize(("pupil", "power", "corner"), [(False, 3, 0.914), (True, 4, 0.887)])
def test_a_uniform_sky_falls_with_the_cosine(tmp_path, pupil, power, corner):
    """The drawn layer of a 20-degree field: cos^3 by the solid angle, cos^4 with the pupil."""
    scene = with_sensor(SCENE | SKY, pupil_projection=pupil)
    drawn = layer(scene, tmp_path / "run", "background_e")
    middle = drawn[255:257, 255:257].mean()
    assert drawn[0, 0] / middle == pytest.approx(corner, abs=1e-3)
    y, x = np.mgrid[:SIDE, :SIDE].astype(float)
    wanted = cosines(x, y) ** power
    grid = next(d for d in plan_scene(parse_scene(scene))["decisions"]
                if d["component"] == "background.grid")  # fmt: skip
    assert np.abs(drawn - middle * wanted).max() <= 1.1 * grid["error_bound_e"] + 1e-5 * middle
    assert grid["error_bound_sigma"] < 0.01
    assert "above target" not in grid["reason"]


def test_one_way_for_a_rate_of_each_pixel_and_for_narrow_fields(tmp_path):
    """A rate per pixel is the same in all; a narrow field has one value within the accuracy."""
    rate = SCENE | {"background": {"uniform_e_per_s": 100.0}}
    assert np.ptp(layer(rate, tmp_path / "rate", "background_e")) == 0.0
    assert prepare(parse_scene(rate)).plan.sky.even
    narrow = prepare(parse_scene(with_sensor(SCENE | SKY, focal_length_m=1.0))).plan
    assert narrow.sky.even
    assert narrow.sky.error_e < 0.05 * narrow.facts.sigma_floor_e / 4 / 8


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory) -> str:
    """Equal stars: on the axis, and 5, 9 and 9.5 degrees off on both axes."""
    folder = tmp_path_factory.mktemp("equal")
    offsets = [(0.0, 0.0), *product((-5.0, 9.5), (5.0, -9.0))]
    lines = ["source_id,ref_epoch,ra,dec,pmra,pmdec,phot_g_mean_mag"]
    lines += [f"{i + 1},2015.5,{300.0 + a},{d},0,0,6.0" for i, (a, d) in enumerate(offsets)]
    (folder / "stars.csv").write_text("\n".join(lines) + "\n")
    return str(ingest([folder / "stars.csv"], folder / "catalogue").catalogue.path)


def test_stars_fall_with_the_cosine(tmp_path, catalogue):
    """The truth's electrons, and the light that was drawn, against the axial star's."""
    scene = SCENE | {"stars": {"catalogue": catalogue}, "output": {"layers": ["dn", "stars_e"]}}
    drawn = layer(scene, tmp_path / "run", "stars_e")
    truth = pq.read_table(tmp_path / "run" / "truth" / "stars.parquet").to_pydict()
    x, y, light = (np.array(truth[k]) for k in ("x_px", "y_px", "electrons"))
    expected = cosines(x, y)
    assert expected.min() < 0.975
    np.testing.assert_allclose(light / light[0], expected / expected[0], rtol=1e-9)
    for i in range(len(x)):
        r, c = round(float(y[i])), round(float(x[i]))
        around = drawn[max(r - 9, 0) : r + 10, max(c - 9, 0) : c + 10]
        assert around.sum() == pytest.approx(light[i], rel=1e-4)
    plain = with_sensor(scene, pupil_projection=False)
    render(parse_scene(plain), tmp_path / "plain")
    same = pq.read_table(tmp_path / "plain" / "truth" / "stars.parquet").to_pydict()["electrons"]
    np.testing.assert_array_equal(same, same[0])


def test_streaks_fall_with_the_cosine_along_their_path(catalogue):
    """Light along a path of some degrees, with the pupil at each of its places, and its mean; under
    a rolling shutter that of mid-exposure, within its bound."""
    turning = {"mode": "rate", "boresight_ra_deg": 300.0, "boresight_dec_deg": 0.0,
               "rate_ra_arcsec_s": 7200.0, "rate_dec_arcsec_s": 3600.0}  # fmt: skip
    scene = SCENE | {"stars": {"catalogue": catalogue}, "pointing": turning}
    plan = prepare(parse_scene(scene)).plan
    said = next(d for d in plan.decisions if d.component == "pupil_projection")
    g = plan_geometry(plan.scene, np.zeros(1, np.int64), plan.dut1_s)
    ends = np.array([0.0, 100.0, 511.0])
    x, y = (v.ravel() for v in np.meshgrid(ends, ends))
    paths = star_paths(plan.camera, g, x, y)[:, :, 0]
    along = cosines(*paths)
    found = pupil_along(plan.scene, plan.camera, g.offset_s[0], *paths)
    np.testing.assert_allclose(found, along, rtol=1e-9)
    assert np.abs(along / along[:, [g.middle]] - 1.0).max() > 1e-3
    light = plan.responses.streaks.light.along(g, x, y)[:, 0]
    np.testing.assert_allclose(light, along, rtol=2e-5)
    seen = deproject(plan.camera, g.attitude[0, g.middle], x, y)
    mean = 0.5 * (along[:, 1:] + along[:, :-1]).mean(axis=1)
    np.testing.assert_allclose(mean_pupil_fraction(plan.scene, g, seen), mean, rtol=2e-5)
    assert said.bound == 0.0
    readout = {"kind": "rolling", "line_s": 1e-7}
    rolling = prepare(parse_scene(with_sensor(scene, detector={"readout": readout}))).plan
    said = next(d for d in rolling.decisions if d.component == "pupil_projection")
    off = np.abs(along / along[:, [g.middle]] - 1.0).max()
    assert off <= 1.0001 * said.bound < 1.2 * off


def test_targets_fall_with_the_cosine_along_their_path():
    """Light with and without the pupil: the mean of the cosine over the nodes of the path."""
    far = np.array([np.cos(np.radians(-52.0)), np.sin(np.radians(-52.0)), 0.14])
    place = [float(v) for v in 7.5e10 * far]
    target = {"name": "t", "body": {"kind": "sphere", "diameter_m": 1e6, "albedo": 0.5},
              "orbit": {"kind": "state", "position_m": place, "velocity_m_s": [0, 0, 0]}}
    scene = SCENE | {"targets": [target], "accept": ["sun", "moon"]}
    found = []
    for pupil in (True, False):
        plan = prepare(parse_scene(with_sensor(scene, pupil_projection=pupil))).plan
        g = plan_geometry(plan.scene, np.zeros(1, np.int64), plan.dut1_s)
        found.append(place_targets(plan, g, everywhere=True)[0])
    expected = cosines(np.array([found[0].x_px]), np.array([found[0].y_px]))[0]
    assert expected < 0.999
    assert found[0].light_e / found[1].light_e == pytest.approx(expected, rel=1e-6)


def test_a_flat_image_holds_the_pupil(tmp_path):
    """Off by default where flat is an image, said with its size; an explicit value wins."""
    np.save(tmp_path / "flat.npy", np.ones((SIDE, SIDE), np.float32))
    imaged = with_sensor(SCENE, flat=str(tmp_path / "flat.npy"))
    assert parse_scene(SCENE).sensor.pupil_projection
    assert not parse_scene(imaged).sensor.pupil_projection
    assert parse_scene(with_sensor(imaged, pupil_projection=True)).sensor.pupil_projection
    said = {d["component"]: d for d in plan_scene(parse_scene(imaged | SKY))["decisions"]}
    assert not said["pupil_projection"]["kept"]
    corner = 1.0 - cosines(np.array([-0.5]), np.array([-0.5]))[0]
    assert said["pupil_projection"]["bound"] == pytest.approx(corner, rel=1e-9)


def test_truth_follows_each_star_of_a_fast_wide_field(tmp_path):
    """Start and end of streaks against the places of the stars at these moments, in a field of 20
    degrees that turns by 20 degrees, with a roll: interpolation across it was 6e-3 px off."""
    rng = np.random.default_rng(8)
    ra, dec = 300.0 + rng.uniform(-14.0, 14.0, 300), rng.uniform(-12.0, 12.0, 300)
    rows = "".join(f"{i + 1},{ra[i]:.9f},{dec[i]:.9f},9.0\n" for i in range(300))
    (tmp_path / "stars.csv").write_text("source_id,ra,dec,phot_g_mean_mag\n" + rows)
    stars = str(ingest([tmp_path / "stars.csv"], tmp_path / "catalogue").catalogue.path)
    rate = SCENE["pointing"] | {"mode": "rate", "roll_rate_deg_s": 3.0}
    rate |= {"rate_ra_arcsec_s": 7200.0, "rate_dec_arcsec_s": 0.0}
    moving = SCENE | {"stars": {"catalogue": stars}, "pointing": rate}
    tables = []
    for name, seconds, frames in (("whole", 10.0, 1), ("ends", 1e-6, 2)):
        times = {"integration_s": seconds, "frames": frames, "cadence_s": 10.0}
        render(parse_scene(moving | {"exposure": times}), tmp_path / name)
        tables.append(pq.read_table(tmp_path / name / "truth" / "stars.parquet").to_pandas())
    whole, ends = tables
    for frame, which in enumerate(("start", "end")):
        found = whole.merge(ends[ends.frame == frame], on="source_id", suffixes=("", "_then"))
        assert len(found) > 30
        for axis in "xy":
            off_px = found[f"{axis}_{which}_px"] - found[f"{axis}_px_then"]
            assert np.abs(off_px).max() < 1e-4
