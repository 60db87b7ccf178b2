"""Limiting cases of number and nearness: very many satellites, and a body that flies by closely."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.special import erf
from sgp4.api import WGS72, Satrec, SatrecArray

from pipeline.physics.positions.earth import site_state, teme_to_gcrs
from pipeline.physics.positions.orbit_screen import screen_cone
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.physics.vectors import unit
from pipeline.studies.selftest.case import CaseResult, case
from pipeline.studies.selftest.scenes import BODY, frames, scene
from pipeline.studies.worst import worst_of

Array = np.ndarray

EPOCH = "2019-04-20T03:00:00Z"
DWELL_S, FIELD_RAD, STEP_S = 20.0, np.radians(30.0), 2.0
SELFTEST_COUNT = 10_000  # of the million that tests/extremes/test_million.py takes
SITE = (np.radians(20.7), np.radians(-156.3), 3055.0)


def satellites(count: int, seed: int) -> list[Satrec]:
    """Low, medium and geostationary orbits at random, as SGP4 takes them."""
    rng = np.random.default_rng(seed)
    day = sum(parse_utc(EPOCH)) - 2_433_281.5
    motion = rng.choice([15.0, 13.0, 2.0, 1.0], count, p=[0.5, 0.3, 0.1, 0.1])
    motion *= rng.uniform(0.95, 1.0, count) * 2.0 * np.pi / 1440.0
    angles = rng.uniform(0.0, 2.0 * np.pi, (count, 3))
    tilt, oval = rng.uniform(0.0, 1.8, count), rng.uniform(0.0, 0.01, count)
    out = []
    for i in range(count):
        one = Satrec()
        one.sgp4init(
            WGS72,
            "i",
            i % 99_999,
            day,
            1e-5,
            0.0,
            0.0,
            oval[i],
            angles[i, 0],
            tilt[i],
            angles[i, 1],
            motion[i],
            angles[i, 2],
        )
        out.append(one)
    return out


def screened(count: int, seed: int = 3) -> tuple[int, int, int]:
    """How many of very many satellites a screen keeps, are in the field at moments, it missed.

    The field stands over a site. Judged by every satellite's place at moments STEP_S apart, without
    light time and aberration: those are in a rim of a hundredth of the field, which is not judged.
    """
    epoch = parse_utc(EPOCH)
    many = satellites(count, seed)
    place0, _ = site_state(*SITE, instants(epoch, [0.0]))
    axis = unit(place0[0])

    def observer(at_s: Array) -> tuple[Array, Array]:
        return site_state(*SITE, instants(epoch, at_s))

    kept = screen_cone(
        many, epoch, DWELL_S, observer, lambda at: np.broadcast_to(axis, (len(at), 3)), FIELD_RAD
    ).inside
    at = np.arange(0.0, DWELL_S + 0.5 * STEP_S, STEP_S)
    jd = np.full(at.size, epoch[0]), epoch[1] + at / 86_400.0
    errors, places, _ = SatrecArray(many).sgp4(*jd)
    turn, here = teme_to_gcrs(instants(epoch, at)), observer(at)[0]
    seen = np.einsum("kij,nkj->nki", turn, 1e3 * places) - here
    apart = np.arccos(np.clip(unit(seen) @ axis, -1.0, 1.0))
    inside = ((apart < 0.99 * FIELD_RAD) & (errors == 0)).any(axis=1)
    missed = np.setdiff1d(np.flatnonzero(inside), kept).size
    return len(kept), int(inside.sum()), missed


@case(
    "many/population",
    f"a field over a site among {SELFTEST_COUNT:,} satellites",
    "every satellite's place by SGP4, moment by moment",
    0.0,
    "missed",
)
def population(_: Path) -> CaseResult:
    kept, inside, missed = screened(SELFTEST_COUNT)
    empty = 0.0 if inside else np.inf
    return CaseResult(f"{inside} in the field", f"{kept} kept, {missed} missed", missed + empty)


@case(
    "many/fly-by-drawn",
    "a body that passes at 1 km with 10 km/s, drawn: an exposure of 1 ms",
    "10 m at 1 km, swept evenly: erf along a line of 10 px",
    0.05,
    "sigma of the pixel's noise",
)
def fly_by_drawn(folder: Path) -> CaseResult:
    body = BODY | {
        "orbit": {
            "kind": "state",
            "position_m": [-7.001e6, -5.0, 0.0],
            "velocity_m_s": [0.0, 1e4, 0.0],
        },
        "body": {"kind": "sphere", "diameter_m": 0.01, "albedo": 0.5},
    }
    still = {"mode": "sidereal", "boresight_ra_deg": 180.0, "boresight_dec_deg": 0.0}
    found = frames(
        scene(
            {
                "targets": [body],
                "pointing": still,
                "exposure.integration_s": 1e-3,
            }
        ),
        folder,
    )
    t = {k: v[0] for k, v in found.truth.items() if v.dtype.kind == "f"}
    mean = found.layers["mean_e"][0].astype(float)
    length = float(np.hypot(t["x_end_px"] - t["x_start_px"], t["y_end_px"] - t["y_start_px"]))
    node, weight = np.polynomial.legendre.leggauss(200)
    across = 0.5 * (t["x_start_px"] + t["x_end_px"]) + 5.0 * node  # 10 px along the row

    def along(n: int, centre: Array) -> Array:
        edges = (np.arange(n + 1) - 0.5)[:, None] - centre
        return np.diff(0.5 * erf(edges / (np.sqrt(2.0) * 0.8)), axis=0)

    row = np.full(1, 0.5 * (t["y_start_px"] + t["y_end_px"]))
    right = (
        t["electrons"] * along(mean.shape[0], row) * (along(mean.shape[1], across) @ (0.5 * weight))
    )
    off = float((np.abs(mean - right) / np.sqrt(right + 1.0)).max())
    apart = worst_of(abs(length - 10.0) / 0.01, abs(t["range_m"] - 1000.0) / 0.1)
    said = f"{length:.4f} px, {t['range_m']:.2f} m, {t['electrons']:.4g} e-, {off:.2g} sigma"
    return CaseResult("10 px, 1000 m", said, off if apart <= 1.0 else np.inf)
