"""Random targets over the whole schema: orbits, bodies, attitudes and light curves."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.extremes.random_sensors import Data, Dice
from tests.extremes.stock import Stock

LINES = {
    "line1": "1 25544U 98067A   19200.50000000  .00000500  00000-0  15000-4 0  9990",
    "line2": "2 25544  51.6400 150.0000 0007000  80.0000  10.0000 15.51000000180000",
}
MU = 3.986004418e14


def checked_line(line: str) -> str:
    """A line of two-line elements with its checksum."""
    total = sum(int(c) if c.isdigit() else c == "-" for c in line[:68])
    return line[:68] + str(total % 10)


def orbit(dice: Dice, stock: Stock, epoch: str) -> Data:
    """An orbit of any kind around the Earth."""
    kind = dice.pick("state", "state", "keplerian", "tle", "omm", "numerical", "ephemeris", "table")
    if kind == "tle":
        return {"kind": kind} | {k: checked_line(v) for k, v in LINES.items()}
    if kind == "omm":
        return {"kind": kind, "elements": {
            "epoch": "2019-07-19T12:00:00Z", "mean_motion_rev_day": dice.pick(15.5, 2.0, 1.0027),
            "eccentricity": dice.pick(0.0, 0.1), "inclination_deg": dice.even(0, 180),
            "raan_deg": dice.even(0, 360), "argument_of_perigee_deg": 0.0,
            "mean_anomaly_deg": dice.even(0, 360),
        }}  # fmt: skip
    if kind == "keplerian":
        return {
            "kind": kind, "perigee_radius_m": dice.spread(6.7e6, 5e7),
            "eccentricity": dice.pick(0.0, 0.3, 1.0, 1.5), "inclination_deg": dice.even(0, 180),
            "raan_deg": dice.even(0, 360), "true_anomaly_deg": dice.even(-60, 60),
        }  # fmt: skip
    if kind == "ephemeris":
        return {"kind": kind, "path": stock.ephemeris, "frame": "gcrs", "epoch": epoch}
    place, speed = state(dice)
    if kind == "table":
        times = np.arange(-3000.0, 3000.0, 60.0)
        rows = [[float(t), *(np.array(place) + np.array(speed) * t)] for t in times]
        return {"kind": kind, "epoch": epoch, "rows": [[float(v) for v in r] for r in rows]}
    out: Data = {"kind": kind, "position_m": place, "velocity_m_s": speed}
    if kind == "numerical":
        out |= {"zonals": dice.pick(0, 2, 6), "drag_m2_kg": dice.pick(0.0, 0.02),
                "radiation_m2_kg": dice.pick(0.0, 0.02)}  # fmt: skip
    return out


def state(dice: Dice) -> tuple[list[float], list[float]]:
    """A place between low orbit and beyond GEO, on a nearly circular way."""
    along, across = (dice.rng.normal(size=3) for _ in range(2))
    along /= np.linalg.norm(along)
    across -= along * (across @ along)
    across /= np.linalg.norm(across)
    radius = dice.spread(6.8e6, 4e8)
    speed = np.sqrt(MU / radius) * dice.pick(1.0, 1.0, 0.9)
    return [float(v) for v in radius * along], [float(v) for v in speed * across]


def body(dice: Dice, stock: Stock) -> Data:
    """A body of any kind."""
    kind = dice.pick("sphere", "sphere", "plate", "box", "cube", "cylinder", "cone", "frustum",
                     "composite", "light_curve", "mesh")  # fmt: skip
    if kind == "composite":
        parts = [_shape(dice, dice.pick("sphere", "plate", "box", "cone")) for _ in range(3)]
        return {"kind": kind, "parts": parts, "attitude": _attitude(dice)}
    if kind == "light_curve":
        return _light_curve(dice)
    if kind == "mesh":
        return {"kind": kind, "path": stock.mesh, "unit": dice.pick("m", "cm"),
                "surface": _surface(dice), "attitude": _attitude(dice)}  # fmt: skip
    return _shape(dice, kind)


def _shape(dice: Dice, kind: str) -> Data:
    size = dice.spread(1e-3, 1e4) if dice.chance(0.2) else dice.spread(0.1, 30)
    sizes: Data = {
        "sphere": {"diameter_m": size}, "plate": {"area_m2": size**2, "two_sided": True},
        "box": {"size_m": [size, 2 * size, 0.5 * size]}, "cube": {"edge_m": size},
        "cylinder": {"diameter_m": size, "length_m": 3 * size},
        "cone": {"diameter_m": size, "length_m": 2 * size},
        "frustum": {"base_diameter_m": size, "top_diameter_m": 0.5 * size, "length_m": size},
    }[kind]  # fmt: skip
    albedo = dice.pick(0.0, 0.3, 1.0, [[300.0, 0.1], [1300.0, 0.5]])
    out = {"kind": kind, "albedo": albedo, **sizes}
    return out if kind == "sphere" else out | {"attitude": _attitude(dice)}


def _attitude(dice: Dice) -> Data:
    return dice.pick(
        {"kind": "inertial", "quaternion": [float(v) for v in dice.rng.normal(size=4)]},
        {"kind": "sun"}, {"kind": "velocity"}, {"kind": "nadir"},
        {"kind": "spin", "rate_deg_s": dice.pick(0.01, 1.0, 360.0, -3e3), "axis": [1, 0, 0.3]},
        {"kind": "sun_tracking"},
        {"kind": "table", "times_s": [-1000.0, 5000.0],
         "quaternions": [[1, 0, 0, 0], [0, 1, 0, 0]]},
    )  # fmt: skip


def _surface(dice: Dice) -> Data:
    return dice.pick(
        {"kind": "lambert", "albedo": 0.4},
        {"kind": "phong", "diffuse": 0.3, "specular": 0.4, "exponent": 30},
        {"kind": "cook_torrance", "diffuse": 0.1, "roughness": 0.2, "normal_reflectance": 0.6},
        {"kind": "ashikhmin_shirley", "specular": 0.5, "exponent_u": 100, "exponent_v": 10},
    )


def _light_curve(dice: Dice) -> Data:
    times = np.linspace(0.0, dice.spread(0.1, 100), dice.count(2, 50))
    out: Data = {"kind": "light_curve", "times_s": [float(t) for t in times],
                 "range_m": 1e6, "period_s": float(times[-1]) * 1.1}  # fmt: skip
    values = [float(v) for v in dice.rng.uniform(4, 12, len(times))]
    if dice.chance(0.3):
        return out | {"intensities_m2_sr": values, "phase_law": "lambert", "phase_deg": 30.0}
    return out | {"magnitudes": values}


def lighting(dice: Dice) -> Data | None:
    if dice.chance(0.85):
        return None
    return {"oblate_earth": True, "limb_darkening": 0.6, "moon": dice.chance(0.5),
            "earthshine_albedo": dice.pick(None, 0.3)}  # fmt: skip


def target(dice: Dice, stock: Stock, epoch: str, name: str) -> Data:
    out: Data = {"name": name, "orbit": orbit(dice, stock, epoch), "body": body(dice, stock),
                 "lighting": lighting(dice), "eclipse": dice.chance(0.7)}  # fmt: skip
    return {k: v for k, v in out.items() if v is not None}


def beside(dice: Dice, one: Data, stock: Stock, name: str) -> Data:
    """Another target near one whose orbit is a state."""
    place, speed = (np.array(one["orbit"][k]) for k in ("position_m", "velocity_m_s"))
    off = dice.rng.normal(size=3) * np.linalg.norm(place) * dice.spread(1e-7, 1e-2)
    orbit_: dict[str, Any] = {
        "kind": "state", "position_m": [float(v) for v in place + off],
        "velocity_m_s": [float(v) for v in speed * (1 + 1e-3 * dice.even(-1, 1))],
    }  # fmt: skip
    return {"name": name, "orbit": orbit_, "body": body(dice, stock), "eclipse": dice.chance(0.5)}
