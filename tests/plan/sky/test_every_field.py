"""A sky is looked at in every field that a scene visits, and all through an exposure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import BadInput
from pipeline.plan.pointing.turns import turning_frames
from pipeline.route.prepare import plan_scene, prepare
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube
from tests.slow import slow

FAR = {"kind": "fixed", "position_au": [-0.65, -0.75, -0.33]}
HERE = {"mode": "sidereal", "boresight_ra_deg": 270.0, "boresight_dec_deg": 66.0}
THERE = {"mode": "sidereal", "boresight_ra_deg": 350.0, "boresight_dec_deg": -4.0}
LEO = {
    "kind": "orbit",
    "orbit": {
        "kind": "state", "position_m": [7131858.8, -812572.7, 0.0],
        "velocity_m_s": [-117.404, -1030.438, 7379.381],
    },
}  # fmt: skip


def scene(**more: Any) -> dict[str, Any]:
    return {
        "schema": "nightglass/scene/1", "name": "sky", "epoch": "2019-05-12T09:00:00Z", "seed": 7,
        "observer": FAR, "accept": ["moon"],
        "sensor": {
            "shape": [16, 16], "pixel_pitch_um": 20, "focal_length_m": 0.02, "aperture_m": 0.02,
            "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
            "psf": {"kind": "gaussian", "sigma_px": 0.8}, "read_noise_e": 6,
        },
        "pointing": HERE, "exposure": {"integration_s": 10.0},
        "background": {"zodiacal": True}, "output": {"layers": ["background_e"]},
    } | more  # fmt: skip


def sky(data: dict[str, Any], path: Path) -> np.ndarray:
    """Mean of the background of each frame."""
    render(parse_scene(data), path, Options("synchronous", replace=True))
    return np.asarray(open_cube(path)["background_e"].values.astype(float).mean(axis=(1, 2)))


@pytest.mark.parametrize("away", [slow(HERE), THERE | {"boresight_dec_deg": -9.0}])
def test_a_field_visited_once_among_many_dwells(away: dict[str, Any], tmp_path: Path) -> None:
    """From the other side of the sky, and from 5 degrees away."""
    dwells = [{"frames": 1, "pointing": THERE if k == 72 else away} for k in range(80)]
    found = sky(scene(dwells=dwells), tmp_path / "many")
    here, there = (sky(scene(pointing=p), tmp_path / "one")[0] for p in (away, THERE))
    assert there > 1.1 * here
    assert found[72] == pytest.approx(there, rel=1e-4)
    assert np.delete(found, 72) == pytest.approx(here, rel=1e-4)
    frames = turning_frames(parse_scene(scene(dwells=dwells)), 0.0)
    np.testing.assert_array_equal(frames, [0, 71, 72, 73, 79])


def test_of_too_many_fields_some_are_looked_at_from_the_first_to_the_last(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Of the five between which the view turns: the first, the middle one and the last."""
    dwells = [{"frames": 1, "pointing": THERE if k == 72 else HERE} for k in range(80)]
    monkeypatch.setattr("pipeline.plan.sky.sky.MOST_FIELDS", 3)
    found = sky(scene(dwells=dwells), tmp_path / "many")
    here, there = (sky(scene(pointing=p), tmp_path / "one")[0] for p in (HERE, THERE))
    assert found[[0, 72, 79]] == pytest.approx([here, there, here], rel=1e-4)


def test_a_dwell_near_the_sun_among_many_is_refused() -> None:
    sensor = scene()["sensor"] | {"sun_exclusion_deg": 30.0}
    to_sun = [np.degrees(np.arctan2(0.75, 0.65)), np.degrees(np.arcsin(0.33 / 1.05))]
    near = {"mode": "sidereal", "boresight_ra_deg": to_sun[0], "boresight_dec_deg": to_sun[1] + 20}
    dwells = [{"frames": 1, "pointing": near if k == 110 else HERE} for k in range(150)]
    with pytest.raises(BadInput, match="frame 110"):
        plan_scene(parse_scene(scene(dwells=dwells, sensor=sensor)))


@pytest.mark.parametrize(
    "more",
    [
        # Light of the Earth, strayed, as the limb rises.
        {
            "observer": LEO, "exposure": {"integration_s": 400.0},
            "pointing": HERE | {"boresight_ra_deg": 353.0, "boresight_dec_deg": -20.0},
            "background": {
                "stray_light": {"pst": {"kind": "table"}, "moon": False, "sun": False}
            },
        },
        # A scan across the ecliptic.
        {
            "pointing": {"mode": "rate", "boresight_ra_deg": 350.0, "boresight_dec_deg": -11.5,
                         "rate_ra_arcsec_s": 0.0, "rate_dec_arcsec_s": 900.0},
            "exposure": {"integration_s": 60.0},
        },
        # Stars that set, behind ever more air.
        {
            "observer": {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3,
                         "atmosphere": {"extinction": True}},
            "pointing": HERE | {"boresight_ra_deg": 141.0, "boresight_dec_deg": 0.0},
            "exposure": {"integration_s": 2400.0},
        },
    ],
    ids=["stray light", "scan", "setting"],
)  # fmt: skip
def test_an_exposure_is_the_sum_of_short_ones(more: dict[str, Any], tmp_path: Path) -> None:
    data = scene(**more)
    if stray := data["background"].get("stray_light"):
        pst = tmp_path / "pst.csv"
        pst.write_text("angle_deg,pst\n1,1e-3\n3,1e-4\n10,1e-5\n30,1e-6\n90,1e-8\n")
        stray["pst"]["path"] = str(pst)
    time_s = data["exposure"]["integration_s"]
    short = {"integration_s": time_s / 30.0, "frames": 30}
    one, many = (
        sky(d, tmp_path / str(k)) for k, d in enumerate((data, data | {"exposure": short}))
    )
    assert np.ptp(many) > 0.1 * many.mean()
    noise_e = np.sqrt(many.sum())
    assert abs(one[0] - many.sum()) < 0.05 * noise_e
    stated = {d.component: d for d in prepare(parse_scene(data)).plan.decisions}
    assert stated["background.grid"].error_bound_sigma <= 0.05


def test_even_turns_are_followed_step_by_step() -> None:
    """Of a slow drift some frames, of 100,000 still ones a few, without aiming each of them."""
    drift = {"mode": "rate", "boresight_ra_deg": 350.0, "boresight_dec_deg": -4.0,
             "rate_ra_arcsec_s": 0.0, "rate_dec_arcsec_s": 36.0}  # fmt: skip
    exposure = {"integration_s": 1.0, "frames": 1000, "cadence_s": 1.0}
    frames = turning_frames(parse_scene(scene(pointing=drift, exposure=exposure)), 0.0)
    assert 18 <= len(frames) <= 24
    assert np.diff(frames[::2]).max() <= 140  # 100 s to turn by a degree, and a step of 30 s
    still = parse_scene(scene(exposure=exposure | {"frames": 100_000, "cadence_s": 1.0}))
    assert len(turning_frames(still, 0.0)) <= 8  # the Earth turns around the far observer


def test_a_turn_that_quickens_is_followed_in_ever_shorter_steps() -> None:
    """From rest at 0.5 arcsec/s2: 500 arcsec/s in the end, a degree in 7 s."""
    quickens = {"mode": "rate", "boresight_ra_deg": 350.0, "boresight_dec_deg": -4.0,
                "rate_ra_arcsec_s": 0.0, "rate_dec_arcsec_s": 0.0,
                "acceleration_dec_arcsec_s2": 0.5}  # fmt: skip
    exposure = {"integration_s": 1.0, "frames": 1000, "cadence_s": 1.0}
    frames = turning_frames(parse_scene(scene(pointing=quickens, exposure=exposure)), 0.0)
    assert np.diff(frames)[-12:].max() <= 8
