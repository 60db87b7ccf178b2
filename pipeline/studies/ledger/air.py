"""Probes of the air above a site: rays traced through it, and what a pointing names."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pipeline.arrays import Array
from pipeline.physics.constants import ARCSEC_RAD
from pipeline.physics.positions.refraction import refraction_terms
from pipeline.plan.pointing.air import frame_sines, weather_of
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from pipeline.studies.ledger.probe import Bench, ProbeResult, most, probe, stated, timed
from pipeline.studies.ledger.scenes import SITE, scene

EARTH_M, TOP_M, TROPOPAUSE_M = 6.371e6, 80_000.0, 11_000.0
GAS_J_KG_K, GRAVITY_M_S2, LAPSE_K_M = 287.05, 9.80665, 6.5e-3
SATELLITE_M = 5e5


def _scene(elevation_deg: float) -> dict:
    return scene(
        {
            "observer": SITE | {"atmosphere": {"refraction": True}},
            "sensor.focal_length_m": 1.0,
            "pointing": {"mode": "local", "azimuth_deg": 90.0, "elevation_deg": elevation_deg},
            "targets": [
                {
                    "name": "t",
                    "orbit": {
                        "kind": "state",
                        "position_m": [7e6, 0, 0],
                        "velocity_m_s": [0, 7.5e3, 0],
                    },
                    "body": {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.3},
                }
            ],
        }
    )


def refractivity(wavelength_m: float, pressure_hpa: float, kelvin: float) -> float:
    """n - 1 of dry air (Ciddor 1996 at 15 C and 1013.25 hPa, scaled by density)."""
    s = (1e-6 / wavelength_m) ** 2
    standard = 1e-8 * (5_792_105.0 / (238.0185 - s) + 167_917.0 / (57.362 - s))
    return standard * (pressure_hpa / 1013.25) * (288.15 / kelvin)


def trace(n0: float, height_m: float, kelvin: float, sine: float) -> tuple[float, float, float]:
    """A ray from the ground upwards at an observed elevation, through spherical shells.

    n0 : refractivity at the ground. Returns the bending [rad], and how far the straight line beyond
    the air, carried back, passes from the observer [m], and the seconds of arc that it has at
    SATELLITE_M of height from there.
    """
    h = np.concatenate(
        [np.linspace(height_m, TROPOPAUSE_M, 3001), np.linspace(TROPOPAUSE_M, TOP_M, 3001)[1:]]
    )
    low = np.minimum(h, TROPOPAUSE_M)
    t = kelvin - LAPSE_K_M * (low - height_m)
    power = GRAVITY_M_S2 / (GAS_J_KG_K * LAPSE_K_M) - 1.0
    density = (t / kelvin) ** power
    top = t[-1]
    density *= np.exp(-np.maximum(h - TROPOPAUSE_M, 0.0) * GRAVITY_M_S2 / (GAS_J_KG_K * top))
    n, r = 1.0 + n0 * density, EARTH_M + h
    across = n[0] * r[0] * np.sqrt(1.0 - sine**2)  # Bouguer: n r sin z stays
    angle = np.arcsin(across / (n * r))
    middle = np.tan(0.5 * (angle[1:] + angle[:-1]))
    bending = -float(np.sum(np.diff(np.log(n)) * middle))
    line_m = across - n[0] * 0.0  # distance of the outer line from the Earth's middle
    z = np.arccos(sine) + bending
    passes = line_m / np.sin(z) - r[0]
    return bending, passes * np.sin(z), np.degrees(z)


@probe("atmosphere")
def rays(_: Bench) -> Iterator[ProbeResult]:
    """Refraction, its spread over colours, and the shift of near things, against traced rays."""
    for elevation in (20.0, 45.0):
        parsed = parse_scene(_scene(elevation))
        prepared = prepare(parsed)
        plan = prepared.plan
        pressure, celsius, _humidity = weather_of(plan.scene)
        kelvin, height = celsius + 273.15, float(SITE["height_m"])
        g = plan_geometry(plan.scene, np.zeros(1, np.int64), plan.dut1_s)
        air = g.air[0, [g.middle]]
        sine = float(frame_sines(plan.camera, g.attitude[0, [g.middle]], air[:, :3]).min())
        tangent = np.sqrt(1.0 - sine**2) / sine

        def traced(m: float, at=(pressure, kelvin, height, sine)) -> tuple[float, float, float]:
            p, k, h, s = at
            return trace(refractivity(m, p, k), h, k, s)

        def told(m: float, at=(pressure, celsius, tangent)) -> float:
            p, c, t = at
            a, b = refraction_terms(p, c, 0.0, m)
            return a * t + b * t**3

        mean = plan.facts.mean_wavelength_m
        trace_s, exact = timed(lambda t=traced, m=mean: t(m))  # type: ignore[misc]
        told_s, ours = timed(lambda t=told, m=mean: t(m), 3)  # type: ignore[misc]
        how = f"{np.degrees(np.arcsin(sine)):.1f} deg up, against a ray through 6000 shells"
        bound, unit = stated(plan, "atmosphere.refraction")
        off = abs(exact[0] - ours) / ARCSEC_RAD
        yield ProbeResult("atmosphere.refraction", how, bound, off, unit, told_s, trace_s)
        colours = np.array([traced(m)[0] for m in (*plan.facts.ends_m, mean)])
        bound, unit = stated(plan, "atmosphere.dispersion")
        off = float(np.ptp(colours)) / ARCSEC_RAD
        yield ProbeResult("atmosphere.dispersion", how, bound, off, unit, told_s, 3.0 * trace_s)
        bound, unit = stated(plan, "atmosphere.finite_distance")
        yield ProbeResult(
            "atmosphere.finite_distance", how, bound, abs(exact[1]), unit, told_s, trace_s
        )


@probe("pointing_refraction")
def lifted(_: Bench) -> Iterator[ProbeResult]:
    """The camera of a pointing by azimuth and elevation, with the site's air and without."""
    for elevation in (20.0, 60.0):
        data = _scene(elevation)
        bare = scene({"observer.atmosphere": None}, data)
        frame = np.zeros(1, np.int64)

        def boresight(d: dict, frame=frame) -> tuple[Array, object]:
            plan = prepare(parse_scene(d)).plan
            g = plan_geometry(plan.scene, frame, plan.dut1_s)
            return g.attitude[0, g.middle, 2], plan

        in_s, (held, plan) = timed(lambda d=data, b=boresight: b(d))  # type: ignore[misc]
        out_s, (named, _p) = timed(lambda d=bare, b=boresight: b(d))  # type: ignore[misc]
        off = most(np.arctan2(np.linalg.norm(np.cross(held, named)), held @ named)) / ARCSEC_RAD
        bound, unit = stated(plan, "pointing_refraction")
        yield ProbeResult(
            "pointing_refraction",
            f"{elevation:g} deg up, the camera with and without air",
            bound,
            off,
            unit,
            out_s,
            in_s,
        )
