"""A study's SNR and chance of detection against frames that are rendered for it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.capacity.candidates import find_candidates, path_of
from pipeline.capacity.course import StudyCourse, make_course
from pipeline.opened_product import Product
from pipeline.physics.positions.times import format_utc, instants
from pipeline.physics.vectors import to_angles
from pipeline.plan.resolved import ResolvedScene
from pipeline.resolve.resolve import resolve
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from tests.slow import slow

TIME_S = 1.0


def course_of(data: dict[str, Any], folder: Path) -> StudyCourse:
    """Two sites, one that tracks, under air that glows and scatters a bright Moon's light, one that
    does not; a satellite."""
    plain = data["cameras"][0]
    plain["sensor"] = plain["sensor"] | {"shape": [160, 160], "focal_length_m": 0.15}
    plain["exposure"] = {"integration_s": TIME_S}
    night = {"airglow": True, "moonlight": True, "uniform_mag_arcsec2": 22.5}
    tracks = plain | {"name": "tracks", "tracking": "target", "background": night}
    data["cameras"] = [plain | {"tracking": "sidereal"}, tracks]
    air = {"extinction": {"mag_per_airmass": 0.15}, "refraction": True}
    data["sensors"][0] |= {"camera": "tracks", "count": 1}
    data["sensors"][0]["observer"] = data["sensors"][0]["observer"] | {"atmosphere": air}
    orbit = {
        "kind": "keplerian", "semi_major_axis_m": 7.2e6, "eccentricity": 0.0,
        "inclination_deg": 98.0, "true_anomaly_deg": 10.0, "epoch": data["start"],
    }  # fmt: skip
    data["sensors"].append({"name": "satellite", "observer": {"kind": "orbit", "orbit": orbit}})
    made = {"objects": 400, "seed": 4, "smallest_m": 0.05, "largest_m": 4.0}
    data |= {"duration_h": 6.0, "catalogue": {"synthetic": made}}
    data["detection"] = {"least_probability": 0.0, "false_alarm_rate": 1e-6}
    return make_course(data, folder)


def frame_of(
    course: StudyCourse, data: dict[str, Any], row: dict[str, Any], out: Path
) -> tuple[Product, ResolvedScene]:
    """The frame of a candidate, exposed about its moment, its object in the middle; its scene."""
    e, watcher = course.elements.take(np.array([row["object"]])), course.watchers[row["sensor"]]
    at = instants(watcher.epoch, [row["time_s"] - 0.5 * TIME_S])
    bstar, ecc, argument, tilt, anomaly, motion, node = e.mean[0]
    born = format_utc(float(e.jd1[0]), float(e.jd2[0]))
    elements = {
        "epoch": born, "mean_motion_rev_day": motion * 720.0 / np.pi, "eccentricity": ecc,
        "inclination_deg": np.degrees(tilt), "raan_deg": np.degrees(node),
        "argument_of_perigee_deg": np.degrees(argument), "mean_anomaly_deg": np.degrees(anomaly),
        "bstar": bstar,
    }  # fmt: skip
    diameter = float(np.sqrt(e.reflecting_m2[0] / 0.175))
    body = {"kind": "sphere", "diameter_m": diameter, "albedo": 0.175}
    orbit = {"kind": "omm", "elements": elements}
    ra, dec = (float(np.degrees(a)) for a in to_angles(np.array([row[n] for n in "xyz"])))
    pointing: dict[str, Any] = {
        "mode": "sidereal",
        "boresight_ra_deg": ra,
        "boresight_dec_deg": dec,
    }
    if watcher.tracks:
        pointing = {"mode": "target", "target": "object"}
    named = data["sensors"][row["sensor"]].get("camera")
    camera = next(c for c in data["cameras"] if named in (None, c["name"]))
    scene = {
        "schema": "nightglass/scene/1", "name": "check", "seed": 1000 * row["step"] + row["object"],
        "epoch": format_utc(float(at.utc1[0]), float(at.utc2[0])), "sensor": camera["sensor"],
        "observer": data["sensors"][row["sensor"]]["observer"], "exposure": camera["exposure"],
        "background": camera["background"], "pointing": pointing,
        "targets": [{"name": "object", "orbit": orbit, "body": body}],
        "accept": ["moon", "daylight", "sun"], "accuracy": {"check_cells": 0},
        "output": {"layers": ["dn", "targets_e", "background_e"]},
    }  # fmt: skip
    render(parse_scene(scene), str(out), Options("synchronous"))
    return Product(out), resolve(parse_scene(scene)).scene


def compared(data: dict[str, Any], folder: Path, count: int) -> np.ndarray:
    """(count, 4): SNR of the study, of the frame's pixels, the filter's output, the chance; as many
    of each sensor."""
    course = course_of(data, folder)
    (folder / "parts").mkdir()
    find_candidates(course, (0, 0))
    rows = pq.read_table(path_of(folder, (0, 0))).to_pylist()
    rows = [r for r in rows if 1.0 < r["snr"] < 12.0 and r["streak_px"] < 120.0]
    sensor, rng = np.array([r["sensor"] for r in rows]), np.random.default_rng(1)
    each = [rng.permutation(np.flatnonzero(sensor == j))[: count // 3] for j in range(3)]
    chosen = np.concatenate(each)
    assert len(chosen) == count
    out = []
    for k in chosen:
        product, sensor = frame_of(course, data, rows[k], folder / f"frame-{k}")
        signal = np.asarray(product.cube["targets_e"][0], float)
        numbers = np.asarray(product.cube["dn"][0], float)
        gain, bias = sensor.scene.sensor.gain_e_per_dn, sensor.scene.sensor.bias_dn
        light_e = (numbers - bias) * gain - np.asarray(product.cube["background_e"][0], float)
        variance = sensor.snr_floor_e2(0, *np.zeros((2, 1))) + signal
        snr = np.sqrt(np.sum(signal**2 / variance))
        found = np.sum(signal * light_e / variance) / snr
        out.append((rows[k]["snr"], snr, found, rows[k]["probability"]))
        assert rows[k]["sky_e_s_px"] == pytest.approx(sensor.facts.background_e_s, rel=0.02)
    return np.array(out)


def judged(table: np.ndarray) -> dict[str, float]:
    """How far SNRs are apart, what was detected, and what was expected with its error."""
    apart = table[:, 0] / table[:, 1] - 1.0
    chance = table[:, 3]
    return {
        "least_percent": float(apart.min()) * 100.0,
        "most_percent": float(apart.max()) * 100.0,
        "detected": float((table[:, 2] >= 4.7534).sum()),
        "expected": float(chance.sum()),
        "sigma": float(np.sqrt(np.sum(chance * (1.0 - chance)))),
    }


@pytest.mark.parametrize("count", [6, slow(300)])
def test_against_rendered_frames(data: dict[str, Any], tmp_path: Path, count: int) -> None:
    table = compared(data, tmp_path, count)
    told = judged(table)
    print(told)
    assert told["least_percent"] > -1.5
    assert told["most_percent"] < 1.0
    assert abs(told["detected"] - told["expected"]) < 3.0 * max(told["sigma"], 1.0)
    pull = table[:, 2] - table[:, 0]  # of mean 0 and variance 1
    assert abs(pull.mean()) < 3.5 / np.sqrt(count)
    assert 0.3 < pull.std() < 1.7
