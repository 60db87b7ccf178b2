"""Random scenes for the fuzz tests: whole ones by hypothesis, and broken ones made from them."""

from __future__ import annotations

import copy
import math
from typing import Any

from hypothesis import strategies as st


def spread(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers spread evenly in their logarithm."""
    return st.floats(math.log(low), math.log(high)).map(math.exp)


def _psfs() -> st.SearchStrategy[dict[str, Any]]:
    blur = {
        "jitter_px": st.sampled_from([0.0, 0.3]),
        "charge_diffusion_px": st.sampled_from([0.0, 0.2]),
    }
    return st.one_of(
        st.fixed_dictionaries({"kind": st.just("gaussian"), "sigma_px": spread(0.05, 8), **blur}),
        st.fixed_dictionaries({"kind": st.just("airy"), "wavelengths": st.integers(1, 2), **blur}),
        st.fixed_dictionaries({"kind": st.just("moffat"), "fwhm_px": spread(0.5, 6), **blur}),
    )


LARGE_PX, SMALL_PX = 70, 24  # sides of the frames
SENSORS = st.fixed_dictionaries({
    "pixel_pitch_um": spread(3, 30), "focal_length_m": spread(0.02, 5),
    "aperture_m": spread(0.01, 1), "obscuration": st.sampled_from([0.0, 0.3]),
    "fill_factor": st.sampled_from([1.0, 0.6]),
    "bandpass": st.just({"kind": "box", "short_nm": 450, "long_nm": 750}), "psf": _psfs(),
    "full_well_e": st.one_of(st.none(), spread(1, 1e7)), "gain_e_per_dn": spread(1e-3, 1e3),
    "adc_bits": st.integers(1, 63), "adc_rounding": st.sampled_from(["half_even", "floor"]),
    "bias_dn": st.sampled_from([0.0, 100.0, 1e17]), "flat": st.sampled_from([1.0, 0.9]),
    "dark_e_per_s": st.one_of(st.just(0.0), spread(1e-6, 1e6)),
    "read_noise_e": st.one_of(st.just(0.0), spread(1e-3, 1e3)), "photon_noise": st.booleans(),
}).map(lambda s: s | {"bias_dn": min(s["bias_dn"], 2.0 ** (s["adc_bits"] + 1))})  # fmt: skip
OBSERVERS = st.sampled_from([
    {"kind": "fixed", "position_au": [0.9, 0.3, 0.1]},
    {"kind": "fixed", "position_au": [0.9, 0.3, 0.1], "velocity_m_s": [2.9e8, 0, 0]},
    {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3000},
    {"kind": "ground", "latitude_deg": 90, "longitude_deg": 0},
    {"kind": "orbit", "orbit": {"kind": "state", "position_m": [7e6, 0, 0],
                                "velocity_m_s": [0, 7546.0, 0]}},
])  # fmt: skip
BODIES = st.sampled_from([
    {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.3},
    {"kind": "sphere", "diameter_m": 1e-6, "albedo": 0.0},
    {"kind": "sphere", "diameter_m": 2e4, "albedo": 1.0},
])  # fmt: skip
TARGETS = st.fixed_dictionaries({
    "orbit": st.fixed_dictionaries({
        "kind": st.just("state"),
        "position_m": st.tuples(*[st.sampled_from([-4.2e7, -8e6, 0.0, 9e6, 3e7])] * 3).map(list),
        "velocity_m_s": st.tuples(*[st.floats(-8e3, 8e3)] * 3).map(list),
    }),
    "body": BODIES, "eclipse": st.booleans(),
})  # fmt: skip
RA, DEC = st.sampled_from([0.0, 359.999999, 123.4]), st.sampled_from([-90.0, -5.0, 60.0, 90.0])
POINTINGS = st.one_of(
    st.fixed_dictionaries({"mode": st.just("sidereal"), "boresight_ra_deg": RA,
                           "boresight_dec_deg": DEC, "roll_deg": st.floats(-360, 360)}),
    st.fixed_dictionaries({"mode": st.just("rate"), "boresight_ra_deg": RA,
                           "boresight_dec_deg": DEC, "rate_ra_arcsec_s": st.floats(-500, 500),
                           "rate_dec_arcsec_s": st.floats(-500, 500)}),
    st.just({"mode": "target", "target": "t0"}),
)  # fmt: skip
BACKGROUNDS = st.one_of(
    st.none(),
    st.fixed_dictionaries({"uniform_e_per_s": spread(1e-6, 1e6)}),
    st.fixed_dictionaries({"uniform_mag_arcsec2": st.floats(5, 30)}),
    st.just({"zodiacal": {"near_sun": "extrapolate"}, "galactic": True}),
)
COSMIC_RAYS = st.sampled_from([None, None, {"kind": "generated", "rate_per_cm2_s": 5.0}])


@st.composite
def scenes(draw: st.DrawFn, catalogue: str, side_px: int = LARGE_PX) -> dict[str, Any]:
    """A scene that the schema accepts; what it describes may still be refused for its physics."""
    shape = [draw(st.integers(1, side_px)), draw(st.integers(1, side_px))]
    targets = draw(st.lists(TARGETS, max_size=3))
    pointing = draw(POINTINGS)
    if pointing["mode"] == "target" and not targets:
        targets = [draw(TARGETS)]
    data: dict[str, Any] = {
        "schema": "nightglass/scene/1", "name": "fuzz", "epoch": draw(st.sampled_from([
            "2019-07-20T09:00:00Z", "2016-12-31T23:59:60Z", "1958-03-01T00:00:00Z",
            "2095-12-31T23:59:59.999999Z",
        ])),
        "seed": draw(st.integers(0, 2**63 - 1)), "observer": draw(OBSERVERS),
        "sensor": {"shape": shape, **draw(SENSORS)}, "pointing": pointing,
        "exposure": {"integration_s": draw(spread(1e-9, 1e3)), "frames": draw(st.integers(1, 2))},
        "targets": [{"name": f"t{i}", **t} for i, t in enumerate(targets)],
        "background": draw(BACKGROUNDS), "cosmic_rays": draw(COSMIC_RAYS),
        "output": {"layers": ["dn", "mean_e", "dark_e"]},
    }  # fmt: skip
    if draw(st.booleans()):
        data["stars"] = {"catalogue": catalogue, "faintest_g_mag": draw(
            st.sampled_from([None, 9.0, "auto"]))}  # fmt: skip
    present = [("stars_e", data.get("stars")), ("targets_e", targets),
               ("background_e", data["background"])]  # fmt: skip
    data["output"]["layers"] += [name for name, part in present if part]
    return {k: v for k, v in data.items() if v is not None}


WRONG = (None, "", "x", -1, 0, 1e400, float("nan"), -1e30, 2**70, [], {}, [[]], True, "\ud800")


@st.composite
def broken(draw: st.DrawFn, catalogue: str, side_px: int = LARGE_PX) -> dict[str, Any]:
    """A scene with one to three of its values replaced, removed, or unknown ones added."""
    data = copy.deepcopy(draw(scenes(catalogue, side_px)))
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
