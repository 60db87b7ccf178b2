"""Candidates and observations: their columns by closed forms, and no edge of a window in them."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import astropy.coordinates as coord
import astropy.units as u
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from astropy.time import Time
from scipy.stats import binom, norm

from pipeline.capacity.candidates import ENDED, SCHEMA, _frames, find_candidates, path_of
from pipeline.capacity.course import make_course, moments
from pipeline.capacity.patterns import slots_of
from pipeline.capacity.run import StudyOptions, run_study
from pipeline.physics.vectors import from_angles, separation
from pipeline.spec.scene import Exposure

pytestmark = pytest.mark.usefixtures("coarse_signal")
ALONE = StudyOptions("synchronous")
Data = dict[str, Any]


def test_columns(data: Data, tmp_path: Path) -> None:
    """Elevation, phase, magnitude and chance of each candidate follow from its other columns."""
    air = {"extinction": {"mag_per_airmass": 0.12}, "refraction": True}
    data["sensors"] = data["sensors"][:1]
    data["sensors"][0]["observer"] = data["sensors"][0]["observer"] | {"atmosphere": air}
    data["detection"] = {"false_alarm_rate": 1e-4, "frames_needed": 2, "least_probability": 0.1}
    data["catalogue"]["synthetic"] |= {"objects": 200, "smallest_m": 0.05}
    course = make_course(data | {"duration_h": 6.0}, tmp_path)
    (tmp_path / "parts").mkdir()
    count = find_candidates(course, (0, 0))
    table = pq.read_table(path_of(tmp_path, (0, 0)))
    assert count == table.num_rows > 500
    row = {name: table[name].to_numpy() for name in table.column_names}
    assert (row["time_s"] == 60.0 * row["step"]).all()
    chance = norm.sf(norm.isf(1e-4) - row["snr"].astype(float))
    np.testing.assert_allclose(row["probability"], binom.sf(1, 3, chance), rtol=1e-4)
    assert 0.1 <= row["probability"].min() < 0.2
    watch = course.watchers[0].watch(row["time_s"])
    towards = np.stack([row[n] for n in "xyz"], axis=1).astype(float)
    up = np.einsum("nij,nj->ni", watch.to_gcrs, watch.up)
    height = 90.0 - np.degrees(separation(towards, up))
    np.testing.assert_allclose(row["elevation_deg"], height, atol=2e-4)
    here = np.einsum("nij,nj->ni", watch.to_gcrs, watch.observer_m)
    there = here + 1e3 * row["range_km"].astype(float)[:, None] * towards
    sun = coord.get_sun(Time("2019-04-20T06:00:00") + row["time_s"] * u.s)
    place = from_angles(sun.ra.rad, sun.dec.rad) * sun.distance.to_value(u.m)[:, None]
    phase = separation(place - there, here - there)
    np.testing.assert_allclose(row["phase_deg"], np.degrees(phase), atol=0.05)
    bracket = np.sin(phase) + (np.pi - phase) * np.cos(phase)
    e = course.elements.reflecting_m2[row["object"]]
    light = e / np.pi / 6.0 * bracket / (1e3 * row["range_km"].astype(float)) ** 2
    mag = -26.76 - 2.5 * np.log10(light / sun.distance.to_value(u.au) ** 2)
    off = row["v_mag"] - mag
    assert off.min() > -0.005  # the penumbra dims a few
    assert np.quantile(off, 0.9) < 0.005


@pytest.mark.parametrize("tracking", ["sidereal", "target"])
def test_frames_that_have_the_object(data: Data, tmp_path: Path, tracking: str) -> None:
    """What a camera does not follow counts while the middles of its frames, 10 s apart, find it
    within half the shorter side, 600 pixels of 13.5 um behind 0.3 m, of the field's middle."""
    camera = data["cameras"][0]
    camera["sensor"] = camera["sensor"] | {"focal_length_m": 0.3, "shape": [600, 1024]}
    exposure = {"integration_s": 2.0, "frames": 6, "cadence_s": 10.0}
    camera |= {"tracking": tracking, "exposure": exposure}
    data["detection"] = {"frames_needed": 2, "least_probability": 0.0}
    course = make_course(data | {"duration_h": 4.0}, tmp_path)
    (tmp_path / "parts").mkdir()
    find_candidates(course, (0, 0))
    table = pq.read_table(path_of(tmp_path, (0, 0)))
    rate = np.radians(table["rate_arcsec_s"].to_numpy().astype(float) / 3600.0)
    gone = rate[:, None] * (1.0 + 10.0 * np.arange(6))  # rad, at the middle of each frame
    inside = (gone <= np.arctan(300 * 13.5e-6 / 0.3)).sum(axis=1)
    frames = table["frames"].to_numpy()
    wanted = 6 if tracking == "target" else np.maximum(inside, 1)
    np.testing.assert_array_equal(frames, np.broadcast_to(wanted, len(frames)))
    assert len(set(inside.tolist())) > 3
    chance = norm.sf(course.threshold - table["snr"].to_numpy().astype(float))
    whole = binom.sf(1, frames, chance)
    np.testing.assert_allclose(table["probability"].to_numpy(), whole, rtol=1e-4, atol=1e-12)


def run_rows(data: Data, out: Path) -> list[dict[str, Any]]:
    run_study(data, out.parent, out, ALONE)
    files = sorted((out / "observations").glob("*.parquet"))
    return list(pa.concat_tables([pq.read_table(f) for f in files]).to_pylist())


@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize("pattern", [None, "strip"])
def test_windows_and_batches_change_nothing(
    data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pattern: str | None
) -> None:
    """Every observation is there once, whatever windows and batches the work is cut into."""
    data |= {"duration_h": 4.0, "detection": {"least_probability": 0.01}}
    data["tasking"]["revisit_h"] = 0.3
    data["catalogue"]["synthetic"] |= {"objects": 120}
    if pattern is not None:
        data["cameras"][0] |= {"tracking": "sidereal"}
        data["cameras"][0]["sensor"] = data["cameras"][0]["sensor"] | {"focal_length_m": 0.05}
        data["tasking"] = {"kind": "serendipitous", "pattern": pattern, "from_deg": -40,
                           "to_deg": 40}  # fmt: skip
    whole = run_rows(data, tmp_path / "whole")
    assert len(whole) >= 30
    monkeypatch.setattr("pipeline.capacity.course.STEPS", 37)
    for place in ("course", "candidates"):
        monkeypatch.setattr(f"pipeline.capacity.{place}.BATCH", 19)
    for kept in (moments, slots_of):  # of the windows as they were
        kept.cache_clear()
    cut = run_rows(data, tmp_path / "cut")
    assert len(cut) == len(whole)

    def key(r: dict[str, Any]) -> tuple[Any, ...]:
        return r["step"], r["object"], r["unit"], r["time_s"]

    for kept in (moments, slots_of):
        kept.cache_clear()
    for a, b in zip(sorted(whole, key=key), sorted(cut, key=key), strict=True):
        assert key(a)[:3] == key(b)[:3]
        assert (a["detected"], a["frames"]) == (b["detected"], b["frames"])
        for name in ("time_s", "busy_s", "x", "y", "z", "snr", "range_km"):
            assert a[name] == pytest.approx(b[name], rel=1e-6, abs=1e-6)


def test_steps_of_windows_follow_each_other(
    data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The moment after a window is the next one's."""
    monkeypatch.setattr("pipeline.capacity.course.STEPS", 30)
    data["catalogue"]["synthetic"]["seed"] = 6  # a study that no other test has
    course = make_course(data | {"duration_h": 1.0}, tmp_path)
    (tmp_path / "parts").mkdir()
    for window in (0, 1):
        find_candidates(course, (window, 0))
        steps = set(pq.read_table(path_of(tmp_path, (window, 0)))["step"].to_pylist())
        assert steps == set(range(30 * window, 30 * window + 30))


def test_what_sgp4_ends_is_told_in_later_batches(
    data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in ("course", "candidates"):
        monkeypatch.setattr(f"pipeline.capacity.{place}.BATCH", 25)
    course = make_course(data | {"duration_h": 1.0}, tmp_path)
    course.elements.mean[41, 1] = 0.9  # a perigee inside the Earth
    (tmp_path / "parts").mkdir()
    find_candidates(course, (0, 1))
    table = pq.read_table(path_of(tmp_path, (0, 1)))
    assert json.loads(table.schema.metadata[ENDED]) == [41]
    assert set(table["object"].to_pylist()) <= set(range(25, 50)) - {41}


def test_columns_hold_the_most_frames_that_a_dwell_may_have() -> None:
    most = max(m.le for m in Exposure.model_fields["frames"].metadata if hasattr(m, "le"))
    assert np.array(most).astype(SCHEMA.field("frames").type.to_pandas_dtype()) == most


def test_a_frame_whose_middle_finds_its_object_gone_does_not_count() -> None:
    """Of a camera that does not track: by half its shorter side from where the object was first."""
    exposure = SimpleNamespace(frames=3, integration_s=4.0, step_s=5.0)
    watcher = SimpleNamespace(tracks=False, resolved=SimpleNamespace(
        scene=SimpleNamespace(exposure=exposure),
        camera=SimpleNamespace(rows=512, columns=600, pixel_pitch_m=1e-5, focal_length_m=1.0),
        facts=SimpleNamespace(ifov_rad=1e-5)))  # fmt: skip
    half = float(np.arctan(2.56e-3))
    rate = half / np.array([1.9, 2.1, 6.9, 7.1, 1e6])  # gone after so many seconds
    assert _frames(watcher, SimpleNamespace(rate=rate)).tolist() == [0, 1, 1, 2, 3]  # type: ignore[arg-type]
