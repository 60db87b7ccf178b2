"""Random scenes for the fuzz tests: whole ones by a seed, and broken ones made from them."""

from __future__ import annotations

import copy
from typing import Any

from hypothesis import strategies as st

from tests.extremes.random_sensors import Data, Dice, sensor
from tests.extremes.random_targets import beside, orbit, target
from tests.extremes.stock import PLACES, Stock

LARGE_PX, SMALL_PX = 70, 24  # sides of the frames
EPOCHS = ("2019-07-20T09:00:00Z", "2019-07-20T20:30:00Z", "2019-04-20T11:00:00Z")
FAR_EPOCHS = ("2016-12-31T23:59:60Z", "1958-03-01T00:00:00Z", "2095-12-31T23:59:59.999999Z")


def random_scene(seed: int, stock: Stock, side_px: int = LARGE_PX) -> Data:
    """A scene that the schema accepts; what it describes may still be refused for its physics."""
    dice = Dice(seed)
    epoch = dice.pick(*FAR_EPOCHS) if dice.chance(0.1) else dice.pick(*EPOCHS)
    observer = _observer(dice, stock, epoch)
    targets = _targets(dice, stock, epoch)
    exposure = _exposure(dice)
    data: Data = {
        "schema": "nightglass/scene/1", "name": f"fuzz-{seed}", "epoch": epoch,
        "seed": dice.count(0, 2**62), "accuracy": _accuracy(dice), "observer": observer,
        "sensor": sensor(dice, stock, side_px), "exposure": exposure, "targets": targets,
        "pointing": _pointing(dice, stock, observer, targets, epoch),
        "background": _background(dice, stock, observer),
        "cosmic_rays": _cosmic_rays(dice, stock), "stars": _stars(dice, stock),
        "populations": _populations(dice, stock),
    }  # fmt: skip
    if dice.chance(0.12):
        data["dwells"] = _dwells(dice, data["pointing"])
    data["accept"] = ["sun", "moon", "daylight", "coverage", "error"] if dice.chance(0.8) else []
    data = {k: v for k, v in data.items() if v not in (None, [])}
    return data | {"output": {"layers": _layers(dice, data)}}


def _observer(dice: Dice, stock: Stock, epoch: str) -> Data:
    kind = dice.pick("ground", "ground", "orbit", "orbit", "fixed")
    if kind == "orbit":
        return {"kind": kind, "orbit": orbit(dice, stock, epoch)}
    if kind == "fixed":
        return dice.pick(
            {"kind": kind, "position_au": [0.9, 0.3, 0.1]},
            {"kind": kind, "position_au": [0.9, 0.3, 0.1], "velocity_m_s": [2.9e8, 0, 0]},
            {"kind": kind, "position_au": [-3.0, 40.0, 1.0]},
        )
    out: Data = {"kind": kind, "latitude_deg": dice.pick(20.7, 90, -45.0),
                 "longitude_deg": dice.even(-180, 180), "height_m": dice.pick(0, 3000)}  # fmt: skip
    if dice.chance(0.4):
        extinction = dice.pick(True, {"mag_per_airmass": 0.3}, {"aerosol_mag": 0.3})
        refraction = dice.pick(None, True, {"pressure_hpa": 700.0, "temperature_c": 0.0})
        out["atmosphere"] = {"extinction": extinction, "refraction": refraction}
    return out


def _targets(dice: Dice, stock: Stock, epoch: str) -> list[Data]:
    """None, one, or a few that may stand together."""
    count = dice.pick(0, 0, 1, 1, 2, 4)
    out: list[Data] = []
    for i in range(count):
        near = out and out[0]["orbit"]["kind"] == "state" and dice.chance(0.7)
        name = f"t{i}"
        out.append(beside(dice, out[0], stock, name) if near else target(dice, stock, epoch, name))
    return out


def _exposure(dice: Dice) -> Data:
    time_s = dice.spread(1e-6, 1e3) if dice.chance(0.3) else dice.spread(1e-2, 30)
    out: Data = {"integration_s": time_s, "frames": dice.pick(1, 1, 2, 3)}
    if dice.chance(0.2):
        out["cadence_s"] = time_s * dice.spread(1, 10)
    return out


def _accuracy(dice: Dice) -> Data:
    if dice.chance(0.3):
        return {}
    out: Data = {"noise_fraction": dice.spread(1e-3, 0.5), "check_cells": dice.count(0, 4)}
    if dice.chance(0.5):
        out["flux_fraction"] = dice.spread(1e-6, 0.1)
    return out


def _direction(dice: Dice) -> Data:
    ra, dec = dice.pick(*PLACES)
    return {"boresight_ra_deg": ra, "boresight_dec_deg": dec, "roll_deg": dice.even(-360, 360)}


def _pointing(dice: Dice, stock: Stock, observer: Data, targets: list[Data], epoch: str) -> Data:
    modes = ["sidereal", "sidereal", "rate", "table", "target", "target"]
    local = {"fixed": [], "orbit": ["local"], "ground": ["local"] * 12}[observer["kind"]]
    mode = dice.pick(*modes, *local)
    if mode == "target" and not targets:
        mode = "sidereal"
    rate = dice.spread(1e-3, 500)
    out: Data = {
        "sidereal": {"mode": mode, **_direction(dice)},
        "rate": {"mode": mode, **_direction(dice), "rate_ra_arcsec_s": rate,
                 "rate_dec_arcsec_s": dice.even(-1, 1) * rate,
                 "roll_rate_deg_s": dice.pick(0.0, 0.0, dice.even(-1, 1)),
                 "acceleration_ra_arcsec_s2": dice.pick(0.0, 0.1 * rate)},
        "target": {"mode": mode, "target": "t0", "roll_deg": dice.even(-180, 180)},
        "local": {"mode": mode, "azimuth_deg": dice.even(0, 360),
                  "elevation_deg": dice.even(20, 90)},
        "table": {"mode": mode, "frame": dice.pick("icrs", "gcrs"),
                  "interpolation": dice.pick("slerp", "spline"), **_attitudes(dice, stock, epoch)},
    }[mode]  # fmt: skip
    if dice.chance(0.2):
        out["attitude"] = _attitude_model(dice)
    return out


def _attitudes(dice: Dice, stock: Stock, epoch: str) -> Data:
    """From the file, or a few rows that turn slowly about the boresight."""
    if dice.chance(0.5):
        return {"path": stock.pointing, "epoch": epoch}
    turn = dice.spread(1e-9, 1e-4)
    rows = [[-50.0 + 150.0 * i, 0.0, 0.0, turn * i, 1.0] for i in range(30)]
    return {"scalar": "last", "rows": [[*r[:3], r[3] / n, 1.0 / n] for r in rows
                                       if (n := (1.0 + r[3] ** 2) ** 0.5)]}  # fmt: skip


def _attitude_model(dice: Dice) -> Data:
    rms = dice.spread(1e-3, 1e4)
    jitter = dice.pick(
        {"kind": "white", "rms_arcsec": rms, "low_hz": 0.1, "high_hz": dice.spread(1, 1e4)},
        {"kind": "power_law", "rms_arcsec": rms, "exponent": 2, "low_hz": 0.01, "high_hz": 100},
        {"kind": "resonance", "rms_arcsec": rms, "frequency_hz": 2.3, "damping": 0.01},
        {"kind": "table", "frequency_hz": [0.1, 1.0, 10.0], "arcsec2_per_hz": [rms, 1.0, 0.01]},
    )
    mode = dice.pick(
        {"kind": "oscillator", "axis": "y", "frequency_hz": 0.9, "damping": 0.005,
         "rms_arcsec": rms},
        {"kind": "markov", "axis": "roll", "time_constant_s": 20, "rms_arcsec": rms},
        {"kind": "random_walk", "axis": "x", "arcsec_rts": rms},
        {"kind": "rate_markov", "axis": "x", "time_constant_s": 5, "rms_arcsec_s": rms},
    )  # fmt: skip
    out: Data = {"drift": {"x_arcsec_s": dice.even(-10, 10), "roll_arcsec_s": dice.even(-5, 5)},
                 "jitter": [jitter], "modes": [mode]}  # fmt: skip
    kept = dice.pick("drift", "jitter", "modes")
    return {k: v for k, v in out.items() if k == kept or dice.chance(0.3)}


def _background(dice: Dice, stock: Stock, observer: Data) -> Data | None:
    """Nothing, a uniform sky, or parts of the real one."""
    if dice.chance(0.3):
        return None
    out: Data = {}
    if dice.chance(0.5):
        out |= dice.pick({"uniform_e_per_s": dice.spread(1e-6, 1e6)},
                         {"uniform_mag_arcsec2": dice.even(10, 28)})  # fmt: skip
    parts: Data = {
        "zodiacal": {"near_sun": "extrapolate"}, "galactic": True,
        "starlight": dice.pick("auto", "all", "none"), "stray_light": _stray_light(dice, stock),
    }  # fmt: skip
    if observer["kind"] == "ground":
        parts["airglow"] = True
        if observer.get("atmosphere", {}).get("extinction"):
            parts |= {"moonlight": True, "twilight": True}
    return out | {k: v for k, v in parts.items() if dice.chance(0.3)} or {"galactic": True}


def _stray_light(dice: Dice, stock: Stock) -> Data:
    pst = dice.pick(
        {"kind": "table", "path": stock.pst, "beyond": "clip"},
        {"kind": "harvey", "b0_per_sr": 0.1, "shoulder": 0.01, "slope": -1.5},
    )
    return {"pst": pst, "earth_albedo": dice.pick(*[0.3] * 9, stock.albedo_map),
            "inside": dice.pick("clip", "extrapolate", "refuse")}  # fmt: skip


def _cosmic_rays(dice: Dice, stock: Stock) -> Data | None:
    if dice.chance(0.7):
        return None
    return dice.pick(
        {"kind": "generated", "rate_per_cm2_s": dice.spread(0.1, 100)},
        {"kind": "generated", "source": "ground", "thickness_um": 200.0},
        {"kind": "library", "path": stock.cosmic_rays, "rate_scale": dice.spread(0.1, 10),
         "arrival": dice.pick("poisson", "frames")},
    )  # fmt: skip


def _stars(dice: Dice, stock: Stock) -> Data | None:
    if dice.chance(0.35):
        return None
    out: Data = {"catalogue": stock.catalogue, "faintest_g_mag": dice.pick(None, 9.0, 13.0, "auto")}
    return out | {k: False for k in ("aberration", "deflection", "parallax") if dice.chance(0.1)}


def _populations(dice: Dice, stock: Stock) -> list[Data]:
    if dice.chance(0.92):
        return []
    return [{"name": "crowd", "path": stock.population, "eclipse": dice.chance(0.5),
             "body": {"kind": "sphere", "diameter_m": 2.0, "albedo": 0.2},
             "rules": [{"name_contains": "DEB", "diameter_m": 0.2}]}]  # fmt: skip


def _dwells(dice: Dice, pointing: Data) -> list[Data]:
    """A stare, then a step with its slew and settling."""
    step = {"pointing": {k: v for k, v in pointing.items() if k != "attitude"},
            "slew": {"duration_s": dice.spread(1, 30),
                     "profile": dice.pick("minimum_jerk", "bang_bang")},
            "settle": {"amplitude_arcsec": dice.spread(0.1, 300),
                       "frequency_hz": dice.spread(0.1, 30)}}  # fmt: skip
    return [{"integration_s": [dice.spread(0.1, 5), 0.1], "frames": 2}, {**step, "frames": 1}]


def _layers(dice: Dice, data: Data) -> list[str]:
    """All that a check of the sums needs, and some of the others."""
    present = {"stars_e": "stars", "targets_e": "targets", "background_e": "background"}
    out = ["dn", "mean_e", "dark_e", *(k for k, part in present.items() if data.get(part))]
    if "targets_e" not in out and data.get("populations"):
        out.append("targets_e")
    if data.get("cosmic_rays") and dice.chance(0.7):
        out.append("cosmic_rays_e")
    if data["sensor"].get("detector", {}).get("lag"):
        out.append("lag_e")
    return out + (["calibrated_e"] if dice.chance(0.3) else [])


WRONG = (None, "", "x", -1, 0, 1e400, float("nan"), -1e30, 2**70, [], {}, [[]], True, "\ud800")


@st.composite
def broken(draw: st.DrawFn, stock: Stock, side_px: int = LARGE_PX) -> dict[str, Any]:
    """A scene with one to three of its values replaced, removed, or unknown ones added."""
    data = copy.deepcopy(random_scene(draw(st.integers(0, 2**32)), stock, side_px))
    for _ in range(draw(st.integers(1, 3))):
        holder: Any = data
        while True:
            keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
            if not keys:
                break
            key = draw(st.sampled_from(keys))
            if isinstance(holder[key], dict | list) and draw(st.integers(0, 3)):
                holder = holder[key]
                continue
            how = draw(st.integers(0, 9))
            if how == 0:
                del holder[key]
            elif how == 1 and isinstance(holder, dict):
                holder["unheard_of"] = 1
            else:
                holder[key] = copy.deepcopy(draw(st.sampled_from(WRONG)))
            break
    return data
