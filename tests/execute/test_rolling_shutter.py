"""Rolling shutters: each row against its own exposure, the same in every tiling, and refusals."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import erf

from catalog_tools.ingest.ingest import ingest
from pipeline.errors import BadInput
from pipeline.execute.truth import target_magnitudes
from pipeline.physics.motion.rolling import exposed_longer, rolled, rolled_sources, row_delay_s
from pipeline.plan.pointing.geometry import camera_of, plan_geometry
from pipeline.plan.pointing.star_paths import excursions_px, star_paths
from pipeline.plan.timing import dwell_plans
from pipeline.resolve import resolve
from pipeline.route.prepare import plan_scene, prepare
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube
from tests.slow import slow

IFOV_DEG, SIDE, SIGMA, TIME_S, LINE_S = 2.0 / 3600.0, 300, 0.8, 2.0, 2e-3
RA_DEG, DEC_DEG = 80.0, 20.0
TARGET = {
    "name": "t",
    "orbit": {"kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3070, 0]},
    "body": {"kind": "sphere", "diameter_m": 0.3, "albedo": 0.5},
}
AT_TARGET = {"mode": "target", "target": "t"}


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: Any) -> str:
    """Some thirty stars over and around the frame."""
    folder = tmp_path_factory.mktemp("few")
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-0.6, 0.6, (2, 30)) * SIDE * IFOV_DEG
    dec = DEC_DEG + y
    ra = RA_DEG + x / np.cos(np.radians(dec))
    rows = ["source_id,ref_epoch,ra,dec,parallax,pmra,pmdec,radial_velocity,phot_g_mean_mag,"
            "phot_bp_mean_mag,phot_rp_mean_mag"]  # fmt: skip
    rows += [
        f"{i + 1},2015.5,{ra[i]:.12f},{dec[i]:.12f},0,0,0,,11.0,11.4,10.4"
        for i in range(30)
    ]
    (folder / "stars.csv").write_text("\n".join(rows) + "\n")
    return str(ingest([folder / "stars.csv"], folder / "catalogue").catalogue.path)


def scene(catalogue: str | None, rate_px_s: float, readout: Any = None, **more: Any) -> Any:
    data: dict[str, Any] = {
        "schema": "nightglass/scene/1", "name": "rolling", "epoch": "2019-12-01T08:00:00Z",
        "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
        "sensor": {
            "shape": [SIDE, SIDE], "pixel_pitch_um": 9.0,
            "focal_length_m": 9e-6 / np.radians(IFOV_DEG), "aperture_m": 0.08,
            "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
            "psf": {"kind": "gaussian", "sigma_px": SIGMA}, "read_noise_e": 5.0,
            "gain_e_per_dn": 1.0, "adc_bits": 20,
        },
        "pointing": {
            "mode": "rate", "boresight_ra_deg": RA_DEG, "boresight_dec_deg": DEC_DEG,
            "rate_ra_arcsec_s": 1.2 * rate_px_s, "rate_dec_arcsec_s": 1.6 * rate_px_s,
        },
        "exposure": {"integration_s": TIME_S, "frames": 1},
        "output": {"layers": ["dn", "stars_e", "targets_e"]},
    }  # fmt: skip
    if catalogue is not None:
        data["stars"] = {"catalogue": catalogue}
    if readout is not None:
        data["sensor"]["detector"] = {"readout": {"kind": "rolling"} | readout}
    return parse_scene(data | more)


def layer(made: Any, path: Path, name: str = "stars_e") -> np.ndarray:
    render(made, path, Options("synchronous"))
    return open_cube(path)[name].values[0].astype(float)


def row_by_row(x: Any, y: Any, at_s: Any, rate_e_s: Any, delay_s: np.ndarray) -> np.ndarray:
    """Electrons (ny, nx) of a Gaussian source: each row's own exposure in 100 steps."""
    image, cells = np.zeros((SIDE, SIDE)), np.arange(SIDE + 1) - 0.5
    steps = (np.arange(100) + 0.5) / 100 * TIME_S
    for row in range(SIDE):
        t = delay_s[row] + steps
        px, py, rate = (np.interp(t, at_s, v) for v in (x, y, rate_e_s))
        if np.abs(py - row).min() > 8.0:
            continue
        root = np.sqrt(2.0) * SIGMA
        tall = 0.5 * (erf((row + 0.5 - py) / root) - erf((row - 0.5 - py) / root))
        wide = 0.5 * np.diff(erf((cells[:, None] - px) / root), axis=0)
        image[row] += (wide * (tall * rate)).mean(axis=1) * TIME_S
    return image


@pytest.mark.parametrize("first", [slow("low_rows"), "high_rows"])
def test_stars_against_each_rows_own_exposure(first: str, catalogue: str, tmp_path: Path) -> None:
    """Streaks at an angle, shifted by a few pixels from row to row of the frame, and longer."""
    speed = 12.0
    ours = layer(scene(catalogue, speed, {"line_s": LINE_S, "first": first}), tmp_path / "r")
    delay = LINE_S * (np.arange(SIDE) if first == "low_rows" else np.arange(SIDE)[::-1])
    whole_s = TIME_S + LINE_S * SIDE + 0.2
    exposure = {"integration_s": whole_s, "frames": 1}
    plain = scene(catalogue, speed, exposure=exposure)
    render(plain, tmp_path / "p")
    truth = pd.read_parquet(tmp_path / "p" / "truth" / "stars.parquet")
    p = prepare(plain).plan
    g = plan_geometry(p.scene, np.zeros(1, np.int64), p.dut1_s)
    paths = star_paths(p.camera, g, truth["x_px"].to_numpy(), truth["y_px"].to_numpy())[:, :, 0]
    expected = np.zeros((SIDE, SIDE))
    for k, e in enumerate(truth["electrons"]):
        level = np.full(g.nodes, e / whole_s)
        expected += row_by_row(paths[0, k], paths[1, k], g.offset_s[0], level, delay)
    still = layer(scene(catalogue, speed), tmp_path / "s")
    room = 0.02 * expected.max()
    assert np.abs(still - expected).max() > 5.0 * room
    assert np.abs(ours - expected).max() < room
    assert ours.sum() == pytest.approx(expected.sum(), rel=2e-3)
    rolling = prepare(scene(catalogue, speed, {"line_s": LINE_S, "first": first})).plan
    (told,) = (w for w in rolling.warnings if "as of one row" in w)
    told_e = float(re.search(r"up to ([\d.e+-]+) e-", told)[1])
    assert np.abs(ours - expected).max() < told_e < 10.0 * np.abs(ours - expected).max()


def test_a_target_against_each_rows_own_exposure(tmp_path: Path) -> None:
    orbit = {
        "kind": "orbit",
        "orbit": {"kind": "state", "position_m": [4.2e7, -4e5, 0], "velocity_m_s": [0, 3000, 30]},
    }
    pointing = {"mode": "sidereal", "boresight_ra_deg": 90.03, "boresight_dec_deg": 0.02}
    more = {"observer": orbit, "targets": [TARGET], "pointing": pointing}
    ours = layer(scene(None, 0.0, {"line_s": LINE_S}, **more), tmp_path / "r", "targets_e")
    whole_s = TIME_S + LINE_S * SIDE + 0.2
    plain = scene(None, 0.0, **more, exposure={"integration_s": whole_s, "frames": 1})
    p = prepare(plain).plan
    g = plan_geometry(p.scene, np.zeros(1, np.int64), p.dut1_s)
    rate = g.target_light[0, 0] * p.sun_rate_e_s_m2 * p.facts.area_m2
    x, y = g.target_x_px[0, 0], g.target_y_px[0, 0]
    assert np.hypot(x[-1] - x[0], y[-1] - y[0]) > 10.0
    expected = row_by_row(x, y, g.offset_s[0], rate, LINE_S * np.arange(SIDE))
    still = layer(scene(None, 0.0, **more), tmp_path / "s", "targets_e")
    assert expected.max() > 100.0
    assert np.abs(ours - expected).max() < 0.02 * expected.max()
    assert np.abs(still - expected).max() > 0.1 * expected.max()


def test_magnitudes_are_those_of_the_body_whatever_the_shutter() -> None:
    """Rows that follow a target for longer collect more of it; it is no brighter."""
    orbit = {
        "kind": "orbit",
        "orbit": {"kind": "state", "position_m": [4.2e7, -4e5, 0], "velocity_m_s": [0, 3000, 30]},
    }
    pointing = {"mode": "sidereal", "boresight_ra_deg": 90.03, "boresight_dec_deg": 0.02}
    more = {"observer": orbit, "targets": [TARGET], "pointing": pointing}
    told, light = [], []
    for readout in (None, {"line_s": LINE_S}, {"line_s": LINE_S, "first": "high_rows"}):
        p = prepare(scene(None, 0.0, readout, **more)).plan
        g = plan_geometry(p.scene, np.zeros(1, np.int64), p.dut1_s)
        told.append(np.array(target_magnitudes(p, g))[:, 0])
        light.append(g.target_light[0, 0].mean())
    assert abs(light[1] / light[2] - 1.0) > 0.01
    np.testing.assert_allclose(told[1:], told[:1] * np.ones((2, 1)), atol=1e-3)


def test_same_bits_in_every_tiling_and_truth(catalogue: str, tmp_path: Path) -> None:
    readout = {"line_s": LINE_S}
    whole = scene(catalogue, 12.0, readout)
    tiled = scene(catalogue, 12.0, readout, output={
        "layers": ["dn", "stars_e"], "tile_shape": [256, 256]})  # fmt: skip
    a = layer(whole, tmp_path / "a")
    render(tiled, tmp_path / "b", Options("threads", 2))
    assert np.array_equal(a, open_cube(tmp_path / "b")["stars_e"].values[0])
    one, two = (pd.read_parquet(tmp_path / n / "truth" / "stars.parquet") for n in ("a", "b"))
    pd.testing.assert_frame_equal(one, two)
    longer = one["electrons"] / one["electrons"].min()  # all stars are alike
    assert longer.max() == pytest.approx(1.0, abs=1e-3)
    (line,) = (d for d in plan_scene(whole)["decisions"] if d["component"] == "rolling_shutter")
    assert "of its own row" in line["reason"]


def test_nothing_changes_where_nothing_moves(catalogue: str, tmp_path: Path) -> None:
    still = layer(scene(catalogue, 0.0), tmp_path / "a")
    rolling = layer(scene(catalogue, 0.0, {"line_s": LINE_S}), tmp_path / "b")
    assert (np.abs(rolling - still) <= np.maximum(1e-3, 1e-6 * still)).all()


@given(st.floats(-15, 15), st.floats(-15, 15), st.floats(-0.3, 0.3), st.floats(-50, 350))
def test_each_node_is_in_its_own_rows_time(vx: float, vy: float, bend: float, y0: float) -> None:
    t = np.linspace(0.0, TIME_S, 9)
    x, y = 100.0 + vx * t + bend * t**2, y0 + vy * t - bend * t**2
    for line in (LINE_S, -LINE_S):
        rx, ry, delay = rolled(x, y, t, line, SIDE)
        late = t + row_delay_s(ry, line, SIDE)
        np.testing.assert_allclose(late, t + delay, atol=1e-9)
        np.testing.assert_allclose(rx, 100.0 + vx * late + bend * late**2, atol=1e-6)
        np.testing.assert_allclose(ry, y0 + vy * late - bend * late**2, atol=1e-6)
        if bend == 0.0:
            np.testing.assert_allclose(exposed_longer(delay, t), 1.0 / (1.0 - line * vy))


@pytest.mark.parametrize("first", ["low_rows", "high_rows"])
def test_stars_come_from_as_far_whichever_row_is_first(first: str) -> None:
    """Half of its streak, and what it goes from the first row's time to that of the last one."""
    made = scene(None, 30.0, {"line_s": 0.005, "first": first})
    g, camera = plan_geometry(made, np.arange(1), 0.0), camera_of(made)
    speed_px_s = np.hypot(1.2, 1.6) * 30.0 / (IFOV_DEG * 3600.0)
    (far,) = excursions_px(camera, g)
    assert far >= speed_px_s * (0.5 * TIME_S + 0.005 * SIDE)


@pytest.mark.parametrize("first", ["low_rows", "high_rows"])
def test_the_plan_tells_how_far_a_target_is_off_its_parabola(first: str) -> None:
    """In a field that turns, whichever row is first: the parabola of a frame without a rolling
    shutter, against another such frame that begins when the last row does."""
    g = plan_geometry(scene(None, 0.0, targets=[TARGET], pointing=AT_TARGET), np.arange(1), 0.0)
    x, y, z = g.attitude[0, 0, 2]
    beside = {
        "mode": "rate", "rate_ra_arcsec_s": 0.0, "rate_dec_arcsec_s": 0.0, "roll_rate_deg_s": 2.3,
        "boresight_ra_deg": float(np.degrees(np.arctan2(y, x))) % 360.0 + 0.02,
        "boresight_dec_deg": float(np.degrees(np.arcsin(z))) - 0.05,
    }  # fmt: skip
    late_s = 0.01 * (SIDE - 1)
    exposure = {"integration_s": 0.5, "frames": 2, "cadence_s": late_s}
    more: Any = {"targets": [TARGET], "pointing": beside, "exposure": exposure, "accept": ["moon"]}
    now, late = (plan_geometry(scene(None, 0.0, **more), np.array([k]), 0.0) for k in (0, 1))
    time_s, some, apart = now.offset_s[0], [0, now.nodes // 2, -1], []
    for name in ("target_x_px", "target_y_px"):
        parabola = np.polyfit(time_s[some], getattr(now, name)[0, 0, some], 2)
        apart.append(np.polyval(parabola, late.offset_s[0]) - getattr(late, name)[0, 0])
    exposure["frames"] = 1
    made = scene(None, 0.0, {"line_s": 0.01, "first": first}, **more)
    told = [d for d in plan_scene(made)["decisions"] if d["component"] == "rolling_shutter"]
    assert told[0]["bound"] == pytest.approx(np.abs(apart).max(), rel=1e-3)


def test_limits_light_and_what_is_not_there() -> None:
    t, zero = np.linspace(0.0, 1.0, 5), np.zeros(5)
    x, y, light, clear = rolled_sources(
        zero, zero + 50.0, 1.0 + t, 2.0 + 0.99 * t, 2.0 - t, t, 1e-2, 100
    )
    np.testing.assert_allclose((x, y), (zero, zero + 50.0))
    np.testing.assert_allclose(light, 1.5 + t)  # the last row's exposure ends 0.99 s later
    np.testing.assert_allclose(clear, 1.5 - t)  # goes on beyond the last node
    gone = np.array([0.0, 1.0, np.nan, 3.0, 4.0])
    x, y, delay = rolled(gone, gone, t, 1e-2, 100)
    np.testing.assert_array_equal(x, gone)
    assert not delay.any()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"line_s": 0.5}, "0.05 px from row to row"),
        ({"line_s": LINE_S, "jitter": True}, "without random motion"),
    ],
)
def test_refusals(
    change: dict[str, Any], words: str, catalogue: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = scene(catalogue, 12.0, {"line_s": change["line_s"]})
    if "jitter" in change:
        data = made.model_dump(mode="json", exclude_none=True, by_alias=True)
        data["pointing"]["attitude"] = {
            "jitter": [{"kind": "white", "rms_arcsec": 1.0, "low_hz": 0.01, "high_hz": 1.0}]
        }
        made = parse_scene(data)
        monkeypatch.setattr(resolve, "plan_geometry", None)  # refused before paths are followed
    with pytest.raises(BadInput, match=words):
        plan_scene(made)


@pytest.mark.parametrize(("shape", "rows"), [([SIDE, 40], SIDE), ([40, SIDE], 40)])
def test_the_readout_takes_a_line_for_each_row(shape: Any, rows: int, catalogue: str) -> None:
    data = scene(catalogue, 1.0, {"line_s": LINE_S}).as_dict()
    data["sensor"]["shape"] = shape
    told = [d["reason"] for d in plan_scene(parse_scene(data))["decisions"]]
    assert sum(f"row by row in {(rows - 1) * LINE_S:.4g} s" in reason for reason in told) == 1


def curve(drop_s: float) -> dict[str, Any]:
    """A target that falls from magnitude 5 to 12 in 10 ms, seen from 4.2e7 m away."""
    body = {"kind": "light_curve", "times_s": [-99.0, drop_s, drop_s + 0.01, 99.0]}
    return TARGET | {"body": body | {"magnitudes": [5.0, 5.0, 12.0, 12.0]}}


@pytest.mark.parametrize("air", [{}, {"atmosphere": {"refraction": True}}], ids=["", "air"])
def test_light_after_the_first_rows_exposure_is_that_of_its_own_row(
    air: dict[str, Any], tmp_path: Path
) -> None:
    """The target's row, in the middle, is exposed after the light has fallen."""
    delay_s = LINE_S * (SIDE - 1) / 2
    short = {"exposure": {"integration_s": 0.1, "frames": 1}}
    observer = {"kind": "ground", "latitude_deg": 0.0, "longitude_deg": 170.0} | air

    def electrons(name: str, readout: Any, **more: Any) -> float:
        made = scene(
            None, 0.0, readout, targets=[curve(0.0)], pointing=AT_TARGET, observer=observer,
            accept=["daylight", "sun", "moon"], **(short | more),
        )  # fmt: skip
        render(made, tmp_path / name, Options("synchronous"))
        return float(pd.read_parquet(tmp_path / name / "truth" / "targets.parquet").electrons[0])

    rolling = electrons("rolling", {"line_s": LINE_S})
    shifted = {"dwells": [{"frames": 1, "start_s": delay_s, "integration_s": 0.1}]}
    assert rolling == pytest.approx(electrons("shifted", None, **shifted), rel=1e-3)
    assert rolling < 0.1 * electrons("plain", None)


def test_a_slew_starts_when_the_last_row_is_exposed() -> None:
    dwells = [{"frames": 2}, {"frames": 1, "slew": {"duration_s": 3.0}}, {"frames": 1}]
    plain, rolling = (
        dwell_plans(scene(None, 0.0, readout, dwells=dwells))
        for readout in (None, {"line_s": LINE_S})
    )
    late_s = LINE_S * (SIDE - 1)
    assert plain[1].slew_s == pytest.approx((2 * TIME_S, 2 * TIME_S + 3.0))
    assert rolling[1].slew_s == pytest.approx((2 * TIME_S + late_s, 2 * TIME_S + late_s + 3.0))
    assert rolling[2].start_s == pytest.approx(plain[2].start_s + late_s)


def test_a_target_off_its_parabola_is_refused() -> None:
    """One that comes near beside the boresight, the faster the nearer."""
    orbit = {"kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3070, 0]}
    past = TARGET | {"orbit": orbit | {"position_m": [4.2e7 + 4e4, 4e4, 0],
                                       "velocity_m_s": [-700, 3070, 0]}}  # fmt: skip
    observer = {"kind": "orbit", "orbit": orbit}
    ahead = {"mode": "sidereal", "boresight_ra_deg": 0.0, "boresight_dec_deg": 0.0}
    wide = scene(None, 0.0, {"line_s": 0.02}).as_dict()["sensor"] | {"focal_length_m": 1e-3}
    with pytest.raises(BadInput, match=r"a shorter readout: in 5\.98 s a source comes .* px off"):
        plan_scene(scene(None, 0.0, observer=observer, sensor=wide, targets=[past],
                         pointing=ahead))  # fmt: skip


def test_a_fast_dwell_is_refused_however_many_there_are() -> None:
    fast = {"mode": "rate", "boresight_ra_deg": RA_DEG, "boresight_dec_deg": DEC_DEG,
            "rate_ra_arcsec_s": 300.0, "rate_dec_arcsec_s": 0.0}  # fmt: skip
    dwells = [{"frames": 1, "pointing": fast} if k == 70 else {"frames": 1} for k in range(80)]
    with pytest.raises(BadInput, match="px from row to row"):
        plan_scene(scene(None, 0.0, {"line_s": LINE_S}, dwells=dwells))
