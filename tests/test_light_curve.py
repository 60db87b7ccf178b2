"""Light curves of targets: against the geometry of frames, the law of distance, files, mistakes."""

from __future__ import annotations

import copy
import csv
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pyarrow.parquet as pq
import pytest
import trimesh
from matplotlib.figure import Figure

from pipeline.errors import BadInput
from pipeline.inputs.band.curves import solar_spectrum
from pipeline.light_curve import light_curve, light_curves, write_light_curves
from pipeline.physics.radiometry import ab_photon_rate, band_photon_irradiance_sun, box
from pipeline.plan.bodies import mesh_tables
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.resolve.files import read_files
from pipeline.spec.load import parse_scene
from tests.command import nightglass
from tests.physics.positions.test_orbit_skyfield import tle, with_checksum

ROOT = Path(__file__).parents[1]
BAND = box(400e-9, 900e-9)
LEO = {"kind": "state", "position_m": [6.9e6, 0, 0], "velocity_m_s": [0, 5374.0, 5374.0]}
SCENE: dict[str, Any] = {
    "schema": "nightglass/scene/1",
    "name": "curve",
    "epoch": "2019-07-20T09:00:00Z",
    "observer": {"kind": "orbit", "orbit": LEO | {"position_m": [6.95e6, 0, 0]}},
    "sensor": {
        "shape": [256, 256],
        "pixel_pitch_um": 9.0,
        "focal_length_m": 0.5,
        "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
    },
    "pointing": {"mode": "target", "target": "tube"},
    "exposure": {"integration_s": 2.0, "frames": 4, "cadence_s": 30.0},
    "targets": [
        {
            "name": "tube",
            "orbit": LEO | {"position_m": [6.9e6, 2e5, 0]},
            "body": {
                "kind": "cylinder", "diameter_m": 1.0, "length_m": 4.0, "albedo": 0.4,
                "attitude": {"kind": "spin", "rate_deg_s": 2.0, "axis": [1, 0, 0]},
            },
        },
        {
            "name": "ball", "orbit": LEO | {"position_m": [6.9e6, 1e5, 0]},
            "body": {"kind": "sphere", "diameter_m": 2.0, "albedo": [[300, 0.2], [1000, 0.2]]},
        },
    ],
}  # fmt: skip


def test_same_as_the_frames_of_the_scene() -> None:
    data = SCENE | {"targets": SCENE["targets"][:1], "pointing": {
        "mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 5.0}}  # fmt: skip
    scene = parse_scene(data)
    g = plan_geometry(scene, np.arange(4), 0.0)
    curve = light_curve(scene, "tube", BAND, points=93)  # a point each second
    at = np.array([0, 30, 60, 90])
    wavelength, sun, _, _ = solar_spectrum()
    rate = g.target_light[0, :, 0] * band_photon_irradiance_sun(wavelength, sun, BAND)
    np.testing.assert_allclose(curve.irradiance_e_s_m2[at], rate, rtol=1e-6)
    np.testing.assert_allclose(curve.range_m[at], g.target_range_m[0, :, 0], rtol=1e-9)
    lit = rate > 0
    magnitude = -2.5 * np.log10(rate[lit] / ab_photon_rate(0.0, BAND))
    np.testing.assert_allclose(curve.mag_ab[at][lit], magnitude, atol=1e-6)


def test_an_orbit_passes_through_the_shadow(tmp_path) -> None:
    scene = parse_scene(SCENE)
    curve = light_curve(scene, "ball", BAND, stop_s=6000.0, points=1201)
    dark = curve.sunlit == 0
    assert 0.2 < dark.mean() < 0.5
    assert np.all(np.isinf(curve.mag_ab[dark]))
    assert curve.above_horizon.all()
    table, plot = tmp_path / "ball.parquet", tmp_path / "ball.png"
    assert write_light_curves(iter([("ball", curve)]), table, plot) == 1
    read = pq.read_table(table)
    assert read.num_rows == 1201
    assert np.isnan(read["mag_ab"].to_numpy()[dark]).all()
    assert read["utc"][0].as_py().startswith("2019-07-20T09:00:00")
    columns = {
        "time_s": curve.time_s, "range_m": curve.range_m, "sunlit_fraction": curve.sunlit,
        "phase_deg": np.degrees(curve.phase_rad), "above_horizon": curve.above_horizon,
        "irradiance_e_s_m2": curve.irradiance_e_s_m2,
    }  # fmt: skip
    for name, wanted in columns.items():
        np.testing.assert_allclose(read[name].to_numpy(), wanted, rtol=1e-12, err_msg=name)
    assert plot.read_bytes()[:4] == b"\x89PNG"


def test_the_plot_tells_what_the_earth_hides(tmp_path: Path, monkeypatch) -> None:
    """A target that is behind the Earth some of the time: in grey, with a legend."""
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    far = SCENE["targets"][1] | {"orbit": LEO | {"position_m": [-6.9e6, 0, 0]}}
    scene = parse_scene(SCENE | {"targets": [far]} | {"pointing": {
        "mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 5.0}})  # fmt: skip
    curve = light_curve(scene, "ball", BAND, stop_s=6000.0, points=61)
    hidden = ~curve.above_horizon
    assert 5 < hidden.sum() < 55
    write_light_curves(iter([("ball", curve)]), tmp_path / "a.csv", tmp_path / "a.png")
    (figure,) = drawn
    seen, behind = figure.axes[0].lines
    assert [t.get_text() for t in figure.axes[0].get_legend().get_texts()] == [
        "seen", "behind the Earth"]  # fmt: skip
    lit = np.isfinite(curve.mag_ab)
    np.testing.assert_array_equal(np.isfinite(behind.get_ydata()), hidden & lit)
    np.testing.assert_array_equal(np.isfinite(seen.get_ydata()), ~hidden & lit)


def test_a_table_is_of_the_form_that_its_ending_names(tmp_path: Path) -> None:
    """CSV as the standard library reads it, with nothing where there is no light; no other form."""
    curves = list(light_curves(parse_scene(SCENE), [], BAND, 0.0, 6000.0, 61))
    for name in ("a.parquet", "a.csv"):
        write_light_curves(iter(curves), tmp_path / name)
    kept = pq.read_table(tmp_path / "a.parquet").to_pylist()
    with (tmp_path / "a.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(r["target"], r["utc"]) for r in rows] == [(r["target"], r["utc"]) for r in kept]
    for name in ("tube", "ball"):
        dark = {r["mag_ab"] for r in rows if r["target"] == name} - {str(r["mag_ab"]) for r in kept}
        assert dark == {""}
    for ours, wanted in zip(rows, kept, strict=True):
        assert float(ours["mag_ab"] or "nan") == pytest.approx(wanted["mag_ab"], nan_ok=True)
        assert float(ours["range_m"]) == wanted["range_m"]
    scene = tmp_path / "scene.json"
    scene.write_text("{}")  # the ending is looked at before it
    for name in ("a.json", "a.fits", "a"):
        with pytest.raises(BadInput, match=r"-o: .* ends in \.parquet, \.csv"):
            write_light_curves(iter(curves), tmp_path / name)
        told = nightglass("light-curve", str(scene), "-o", str(tmp_path / name))
        assert (told.returncode, "ends in .parquet, .csv" in told.stderr) == (2, True)
        assert not (tmp_path / name).exists()


def test_many_together_are_each_as_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Targets and members of a population, in one table; the same as one by one."""
    population = {"name": "crowd", "path": str(ROOT / "examples" / "population.tle"),
                  "body": {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}}  # fmt: skip
    scene = parse_scene(SCENE | {"populations": [population]})
    count = write_light_curves(light_curves(scene, [], BAND, points=20), tmp_path / "all.parquet")
    monkeypatch.setattr("pipeline.light_curve.ROWS", 70)  # few at a time
    write_light_curves(light_curves(scene, [], BAND, points=20), tmp_path / "few.parquet")
    few, whole = (pq.read_table(tmp_path / f"{name}.parquet") for name in ("few", "all"))
    for name in whole.column_names:
        np.testing.assert_array_equal(few[name].to_numpy(), whole[name].to_numpy())
    read = pq.read_table(tmp_path / "all.parquet")
    names = read["target"].to_pylist()[::20]
    assert names[:2] == ["tube", "ball"]
    assert count == len(set(names)) == 602
    for name in ("tube", "ball", names[300]):
        alone = light_curve(scene, name, BAND, points=20)
        own = slice(20 * names.index(name), 20 * names.index(name) + 20)
        for column in ("irradiance_e_s_m2", "range_m"):
            found = read[column].to_numpy()[own]
            np.testing.assert_allclose(found, getattr(alone, column), rtol=1e-13)


def test_of_several_sets_the_one_nearest_to_the_times_of_the_curve_counts(tmp_path: Path) -> None:
    """Not to the scene's epoch: one is of 91 days before that, the other of 30 after it."""
    old = tle(7, 51.6, 10.0, 0.001, 20.0, 30.0, 15.2)
    new = with_checksum(old[0].replace("19110.", "19231.")), tle(7, 51.6, 20.0, 0.0, 0, 0, 15.0)[1]
    ranges = {}
    for name, sets in (("both", (new, old)), ("old", (old,)), ("new", (new,))):
        (tmp_path / name).write_text("\n".join(line for lines in sets for line in lines) + "\n")
        crowd = {"name": "crowd", "path": str(tmp_path / name),
                 "body": {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}}  # fmt: skip
        scene = parse_scene(SCENE | {"populations": [crowd]})
        for day in (-90, 0, 30):
            curve = light_curve(scene, "crowd-7", BAND, 86400.0 * day, 86400.0 * day + 60.0, 2)
            ranges[name, day] = curve.range_m.tolist()
    for day, nearest in ((-90, "old"), (0, "new"), (30, "new")):
        assert ranges["both", day] == ranges[nearest, day]
    assert ranges["old", -90] != ranges["new", -90]


def test_curves_come_as_they_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the order of the names, whatever is worked out together; to the last exposure's end."""
    scene = parse_scene(SCENE)
    names = ["ball", "tube"]
    alone = {name: light_curve(scene, name, BAND, points=30) for name in names}
    monkeypatch.setattr("pipeline.plan.bodies.paths.TOGETHER", 1)
    for wanted in (names, names[::-1]):
        found = list(light_curves(scene, wanted, BAND, points=30))
        assert [name for name, _ in found] == wanted
        for name, curve in found:
            own = alone[name].irradiance_e_s_m2
            np.testing.assert_allclose(curve.irradiance_e_s_m2, own, rtol=1e-13)
    assert alone["ball"].time_s[[0, -1]].tolist() == [0.0, 92.0]  # four of 2 s, 30 s apart


def test_a_table_of_light_is_of_its_own_mesh(tmp_path: Path) -> None:
    """Two boxes among other bodies: asked for with a part of them, in any order."""
    (tmp_path / "box.stl").write_bytes(trimesh.creation.box((1, 2, 1.5)).export(file_type="stl"))
    solid = {"kind": "mesh", "path": str(tmp_path / "box.stl"), "unit": "m",
             "surface": {"kind": "lambert", "albedo": 0.5},
             "attitude": {"kind": "nadir", "quaternion": [-0.5, 0.5, 0.3, 0.8]}}  # fmt: skip
    orbit = LEO | {"position_m": [6.9e6, 3e5, 0]}
    turned = solid | {"attitude": {"kind": "nadir", "quaternion": [0.5, 0.5, 0.3, 0.8]}}
    boxes = [{"name": name, "orbit": orbit, "body": body}
              for name, body in (("box", solid), ("other", turned))]  # fmt: skip
    scene = read_files(parse_scene(SCENE | {"targets": [SCENE["targets"][0], *boxes]}))
    span = {"start_s": 2000.0, "stop_s": 2400.0, "points": 2000}
    alone = {n: light_curve(scene, n, BAND, **span) for n in ("tube", "box", "other")}
    lit, also = (alone[n].irradiance_e_s_m2 for n in ("box", "other"))
    assert np.abs(lit - also).max() > 0.1 * lit.max() > 0.0
    assert any(table is not None for table in mesh_tables.KEPT.values())
    for names in (["box", "other"], ["other", "box"], ["other", "tube"]):
        for name, curve in light_curves(scene, names, BAND, **span):
            found, own = curve.irradiance_e_s_m2, alone[name].irradiance_e_s_m2
            np.testing.assert_allclose(found, own, rtol=1e-12, atol=0.0, err_msg=f"{name}, {names}")


def test_a_sphere_by_closed_form() -> None:
    """AB, electrons and phase of the ball: Lambert's sphere in sunlight at its distances."""
    curve = light_curve(parse_scene(SCENE), "ball", BAND, points=10)
    wavelength, sun, _, _ = solar_spectrum()
    full = band_photon_irradiance_sun(wavelength, sun, BAND)
    a = curve.phase_rad
    bracket = np.sin(a) + (np.pi - a) * np.cos(a)
    light = 0.2 / np.pi * (2.0 / 3.0) * bracket / curve.range_m**2
    wanted = light * full * curve.sunlit / 1.016**2  # au, in July
    np.testing.assert_allclose(curve.irradiance_e_s_m2, wanted, rtol=2e-3)
    lit = wanted > 0.0
    assert lit.any()
    mag = -2.5 * np.log10(wanted[lit] / ab_photon_rate(0.0, BAND))
    np.testing.assert_allclose(curve.mag_ab[lit], mag, atol=2e-3)


def test_no_plot_of_many(tmp_path: Path) -> None:
    curves = light_curves(parse_scene(SCENE), [], BAND, points=5)
    with pytest.raises(BadInput, match=r"^--plot: .* one --target"):
        write_light_curves(curves, tmp_path / "a.parquet", tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


def test_a_plot_of_no_known_form_is_refused(tmp_path: Path) -> None:
    curves = light_curves(parse_scene(SCENE), ["ball"], BAND, points=5)
    with pytest.raises(BadInput, match=r"^--plot: 'a\.foo' .* \.png, \.svg, \.pdf"):
        write_light_curves(curves, tmp_path / "a.parquet", tmp_path / "a.foo")
    assert not list(tmp_path.iterdir())


def test_a_table_that_cannot_be_written_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pq.ParquetWriter, "write_table", Mock(side_effect=OSError(5, "lost")))
    curves = light_curves(parse_scene(SCENE), [], BAND, points=5)
    with pytest.raises(BadInput) as caught:
        write_light_curves(curves, tmp_path / "a.parquet")
    assert (caught.value.field, caught.value.allowed) == ("-o", "a file that can be written; lost")
    assert not list(tmp_path.iterdir())


def test_the_earth_in_between() -> None:
    ground = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055.0}
    site = light_curve(parse_scene(SCENE | {"observer": ground}), "ball", BAND, 0.0, 86400.0, 500)
    assert 0 < site.above_horizon.mean() < 0.2
    assert site.range_m[site.above_horizon].max() < 3.5e6
    far = {"kind": "fixed", "position_au": [-0.2, 0.5, 0.1]}
    moonlike = light_curve(parse_scene(SCENE | {"observer": far}), "ball", BAND, 0.0, 12000.0, 500)
    assert 0.5 < moonlike.above_horizon.mean() < 0.8


@pytest.mark.parametrize(
    ("name", "times", "message"),
    [
        ("cube", (0.0, 10.0, 10), "--target: 'cube' .*tube, ball"),
        ("ball", (10.0, 5.0, 10), "--stop"),
        ("ball", (0.0, float("nan"), 10), "--stop"),
        ("ball", (0.0, 10.0, 1), "--points"),
        ("ball", (5.0, 5.0, 10), "--stop"),
        ("ball", (float("nan"), 10.0, 10), "--start"),
        ("ball", (-1e10, 10.0, 10), "--start: '-1e\\+10 s after the epoch'"),
        ("ball", (0.0, 1e300, 10), "--stop: '1e\\+300 s after the epoch'"),
    ],
)
def test_mistakes(name, times, message) -> None:
    with pytest.raises(BadInput, match=message):
        light_curve(parse_scene(SCENE), name, BAND, *times)


def test_earthshine_is_the_same_however_many_moments_are_lit_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All of them took 110 kB each."""
    lit = copy.deepcopy(SCENE)
    for target in lit["targets"]:
        target["lighting"] = {"earthshine_albedo": 0.3}
    whole = light_curve(parse_scene(lit), "tube", BAND, points=40)
    monkeypatch.setattr("pipeline.plan.bodies.bodies.TOGETHER", 7)
    cut = light_curve(parse_scene(lit), "tube", BAND, points=40)
    np.testing.assert_array_equal(cut.irradiance_e_s_m2, whole.irradiance_e_s_m2)
    plain = light_curve(parse_scene(SCENE), "tube", BAND, points=40)
    assert (whole.irradiance_e_s_m2 > plain.irradiance_e_s_m2).any()
