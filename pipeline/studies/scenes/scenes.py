"""The scenes of the report, from sparse fields to huge focal planes, as plain data."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput

# Fields of the catalogue that the report makes: right ascension, declination, radius [deg], limit.
SPARSE = (260.0, 60.0, 1.05, 16.5)
CROWDED = (276.0, -3.2, 0.42, 19.5)
TRACKED = (266.2, 0.0, 0.45, 16.5)
ALL_SKY_G_MAG, QUICK_ALL_SKY_G_MAG = 9.0, 8.5
QUICK_CROWDED_G_MAG, QUICK_CROWDED_DEG = 18.0, 0.2

SENSOR: JsonObject = {
    "pixel_pitch_um": 9.0,
    "focal_length_m": 0.4,
    "aperture_m": 0.2,
    "obscuration": 0.3,
    "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
    "transmission": 0.8,
    "quantum_efficiency": 0.85,
    "psf": {"kind": "airy", "jitter_px": 0.5, "charge_diffusion_um": 3.0},
    "full_well_e": 90000,
    "gain_e_per_dn": 1.5,
    "adc_bits": 16,
    "bias_dn": 500,
    "dark_e_per_s": 2.0,
    "read_noise_e": 6.0,
}
SITE = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055}
PLACE_M = (7131858.8, -812572.7, 0.0)
SPEED_M_S = (-117.404, -1030.438, 7379.381)
IN_ORBIT = {
    "kind": "orbit",
    "orbit": {"kind": "state", "position_m": PLACE_M, "velocity_m_s": SPEED_M_S},
}
GEO_M, GEO_M_S = (4407338.1, -41933021.2, 0.0), (3057.8229, 321.3901, 0.0)


@dataclass(frozen=True)
class ReportScene:
    """One scene of the report.

    title : for people; data : a scene as plain data, without the path of its catalogue
    share : (part, of how many) of its tiles that are drawn; the whole frame where it is (1, 1)
    """

    name: str
    title: str
    data: JsonObject
    share: tuple[int, int] = (1, 1)


def _scene(name: str, side: int, **sections: Any) -> JsonObject:
    sensor = SENSOR | {"shape": [side, side]} | sections.pop("sensor", {})
    return {
        "schema": "nightglass/scene/1",
        "name": name,
        "epoch": "2019-07-20T09:00:00Z",
        "seed": 7,
        "sensor": sensor,
        "output": {"layers": ["dn", "mean_e"]},
        **copy.deepcopy(sections),
    }


def _still(field: tuple[float, float, float, float]) -> JsonObject:
    return {"mode": "sidereal", "boresight_ra_deg": field[0], "boresight_dec_deg": field[1]}


def _pixel_arcsec(sensor: JsonObject) -> float:
    return math.degrees(1e-6 * sensor["pixel_pitch_um"] / sensor["focal_length_m"]) * 3600.0


def _sparse(quick: bool) -> ReportScene:
    return ReportScene(
        "sidereal-sparse",
        "sidereal, sparse",
        _scene(
            "sidereal-sparse",
            512 if quick else 1024,
            observer=SITE,
            pointing=_still(SPARSE),
            exposure={"integration_s": 5.0},
            stars={"faintest_g_mag": 16.5},
            background={"uniform_mag_arcsec2": 21.0},
        ),
    )


def _crowded(quick: bool) -> ReportScene:
    sharp = {"focal_length_m": 3.0, "aperture_m": 0.6, "psf": {"kind": "gaussian", "sigma_px": 0.9}}
    return ReportScene(
        "sidereal-crowded",
        "sidereal, crowded",
        _scene(
            "sidereal-crowded",
            512 if quick else 2048,
            observer=SITE,
            pointing=_still(CROWDED),
            exposure={"integration_s": 5.0},
            background={"uniform_mag_arcsec2": 21.0},
            sensor=sharp,
            stars={"faintest_g_mag": QUICK_CROWDED_G_MAG if quick else CROWDED[3]},
        ),
    )


def _rate_track(quick: bool) -> ReportScene:
    follow = {"mode": "target", "target": "geo-1"}
    target = _target("geo-1", GEO_M, GEO_M_S, 4.0)
    return ReportScene(
        "rate-track",
        "rate track, 300 px streaks",
        _scene(
            "rate-track",
            512 if quick else 1024,
            observer=IN_ORBIT,
            pointing=follow,
            epoch="2019-05-12T09:00:00Z",
            exposure={"integration_s": 8.6},
            targets=[target],
            sensor={"focal_length_m": 1.6, "aperture_m": 0.5},
            stars={"faintest_g_mag": TRACKED[3]},
            background={"zodiacal": True},
        ),
    )


def _wide(quick: bool) -> ReportScene:
    side = 512 if quick else 1024
    focal = 0.5e-6 * SENSOR["pixel_pitch_um"] * side / math.tan(math.radians(10.0))
    sensor = {
        "focal_length_m": focal,
        "aperture_m": 0.02,
        "psf": {"kind": "gaussian", "sigma_px": 0.8},
    }
    px = _pixel_arcsec(SENSOR | sensor)
    turn = {
        "mode": "rate",
        "boresight_ra_deg": TRACKED[0],
        "boresight_dec_deg": 20.0,
        "rate_ra_arcsec_s": 4.0 * px,
        "rate_dec_arcsec_s": 3.0 * px,
    }
    return ReportScene(
        "wide-field",
        "wide field, 20 degrees",
        _scene(
            "wide-field",
            side,
            observer=IN_ORBIT,
            pointing=turn,
            exposure={"integration_s": 8.0},
            sensor=sensor,
            stars={"faintest_g_mag": QUICK_ALL_SKY_G_MAG if quick else ALL_SKY_G_MAG},
            background={"zodiacal": True},
        ),
    )


def _limb(quick: bool) -> ReportScene:
    place, speed = [4.2164e7, 0, 0], [0, 3075, 0]
    high = {"kind": "orbit", "orbit": {"kind": "state", "position_m": place, "velocity_m_s": speed}}
    stray = {"pst": {"kind": "harvey", "b0_per_sr": 0.06, "shoulder": 0.02, "slope": -3.5}}
    at = {"mode": "sidereal", "boresight_ra_deg": 192, "boresight_dec_deg": 4}
    return ReportScene(
        "earth-limb",
        "Earth's limb, stray light",
        _scene(
            "earth-limb",
            512 if quick else 1024,
            observer=high,
            pointing=at,
            epoch="2019-04-20T03:00:00Z",
            exposure={"integration_s": 1.0},
            sensor={"focal_length_m": 0.1, "aperture_m": 0.05},
            stars={"faintest_g_mag": QUICK_ALL_SKY_G_MAG if quick else ALL_SKY_G_MAG},
            background={"zodiacal": True, "stray_light": stray},
        ),
    )


def _target(name: str, place: Any, speed: Any, diameter_m: float) -> JsonObject:
    return {
        "name": name,
        "orbit": {
            "kind": "state",
            "position_m": [float(v) for v in place],
            "velocity_m_s": [float(v) for v in speed],
        },
        "body": {"kind": "sphere", "diameter_m": float(diameter_m), "albedo": 0.2},
    }


def _many_targets(quick: bool) -> ReportScene:
    """Spheres around a followed one, and some so near the observer that their discs show."""
    rng = np.random.default_rng(11)
    count, close, side = (60, 4, 512) if quick else (400, 12, 1024)
    towards = np.subtract(GEO_M, PLACE_M)
    far = float(np.sqrt(towards @ towards))
    one = towards / far
    across = np.linalg.qr(np.stack([one, [1.0, 0, 0], [0, 0, 1.0]]).T)[0][:, 1:]
    half = 0.5 * side * 1e-6 * SENSOR["pixel_pitch_um"] / SENSOR["focal_length_m"]
    targets = [_target("geo-1", GEO_M, GEO_M_S, 4.0)]
    for i in range(count):
        off = across @ rng.uniform(-half, half, 2)
        place = np.add(GEO_M, far * off)
        speed = np.add(GEO_M_S, rng.normal(0.0, 20.0, 3))
        targets.append(_target(f"far-{i}", place, speed, rng.uniform(0.5, 6.0)))
    for i in range(close):
        off = one + across @ rng.uniform(-0.8 * half, 0.8 * half, 2)
        place = np.add(PLACE_M, 2e4 * off)
        targets.append(_target(f"near-{i}", place, SPEED_M_S, 10 ** rng.uniform(-2.0, 0.3)))
    return ReportScene(
        "many-targets",
        f"{len(targets)} targets",
        _scene(
            "many-targets",
            side,
            observer=IN_ORBIT,
            epoch="2019-05-12T09:00:00Z",
            pointing={"mode": "target", "target": "geo-1"},
            exposure={"integration_s": 2.0},
            targets=targets,
            background={"zodiacal": True},
        ),
    )


def _large(quick: bool) -> ReportScene:
    side, part = (12_000, (37, 72)) if quick else (30_000, (218, 450))
    sensor = {"focal_length_m": 0.93, "aperture_m": 0.4, "pixel_pitch_um": 9.0}
    return ReportScene(
        "large-focal-plane",
        f"{side:,} x {side:,} pixels, two tiles of it",
        _scene(
            "large-focal-plane",
            side,
            observer=SITE,
            pointing=_still(SPARSE),
            sensor=sensor,
            exposure={"integration_s": 5.0},
            stars={"faintest_g_mag": SPARSE[3]},
            background={"zodiacal": True},
        ),
        part,
    )


MAKERS: dict[str, Callable[[bool], ReportScene]] = {
    "sidereal-sparse": _sparse,
    "sidereal-crowded": _crowded,
    "rate-track": _rate_track,
    "wide-field": _wide,
    "earth-limb": _limb,
    "many-targets": _many_targets,
    "large-focal-plane": _large,
}


def requests(names: tuple[str, ...], quick: bool) -> list[ReportScene]:
    """The scenes of these names, all where none is given; BadInput for a name that is none."""
    for name in names:
        if name not in MAKERS:
            raise BadInput("--scene", name, ", ".join(MAKERS))
    return [MAKERS[name](quick) for name in dict.fromkeys(names or MAKERS)]


def with_accuracy(
    request: ReportScene, noise_fraction: float, flux_fraction: float, catalogue: str
) -> dict:
    """A scene at one level, its stars from a catalogue; the product makes no check of its own."""
    data = copy.deepcopy(request.data)
    data["accuracy"] = {
        "noise_fraction": noise_fraction,
        "flux_fraction": flux_fraction,
        "check_cells": 0,
    }
    if "stars" in data:
        data["stars"]["catalogue"] = catalogue
    return data


def deep_fields(names: tuple[str, ...], quick: bool) -> list[tuple[float, float, float, float]]:
    """Fields of the synthetic catalogue that these scenes look at, as deep as they ask."""
    crowded = (*CROWDED[:2], QUICK_CROWDED_DEG, QUICK_CROWDED_G_MAG) if quick else CROWDED
    near = {
        "sidereal-sparse": SPARSE,
        "large-focal-plane": SPARSE,
        "sidereal-crowded": crowded,
        "rate-track": TRACKED,
    }
    return list(dict.fromkeys(field for name, field in near.items() if name in names))
