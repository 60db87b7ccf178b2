"""The pinned scenes: one base, and dotted changes of it for each; `@name` is a file of files.py."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.pins.files import DEC_DEG, GEO_PHASE_DEG, RA_DEG, attitude_rows, circle_rows, elements

Changes = dict[str, Any]
LAYERS = ["dn", "mean_e"]
LIGHTS = ["dn", "mean_e", "stars_e", "targets_e", "background_e", "dark_e"]
BASE: dict[str, Any] = {
    "schema": "nightglass/scene/1", "name": "pin", "epoch": "2019-12-01T08:00:00Z", "seed": 7,
    "observer": {"kind": "fixed", "position_au": [0.6, 0.8, 0.0], "velocity_m_s": [0, 0, 3e4]},
    "sensor": {
        "shape": [32, 32], "pixel_pitch_um": 9.0, "focal_length_m": 0.2, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 0.9}, "read_noise_e": 5.0, "gain_e_per_dn": 1.0,
        "bias_dn": 100,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": RA_DEG, "boresight_dec_deg": DEC_DEG},
    "exposure": {"integration_s": 1.0},
    "output": {"layers": LAYERS},
}  # fmt: skip
STARS: Changes = {"stars": {"catalogue": "@stars"}}
SITE = {
    "kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055.0,
}  # fmt: skip
PLACE_M, SPEED_M_S = [7131858.8, -812572.7, 0.0], [-117.404, -1030.438, 7379.381]
IN_ORBIT = {
    "kind": "orbit", "orbit": {"kind": "state", "position_m": PLACE_M, "velocity_m_s": SPEED_M_S},
}  # fmt: skip
HIGH = {
    "kind": "orbit",
    "orbit": {"kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3070, 0]},
}
SPHERE = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.3}
SPIN = {"kind": "spin", "rate_deg_s": 40.0, "axis": [0.3, 0.2, 1.0], "phase_deg": 20.0}
TILTED = [0.8, 0.3, 0.4, 0.2]
FOLLOW = {"mode": "target", "target": "t"}


def sky(ra_deg: float, dec_deg: float) -> Changes:
    """A look at a place of the sky."""
    return {"pointing.boresight_ra_deg": ra_deg, "pointing.boresight_dec_deg": dec_deg}


def ahead(body: Any, range_m: float = 4e6, name: str = "t", **more: Any) -> dict[str, Any]:
    """A target above IN_ORBIT, lit from its side, and with its speed."""
    ra, dec = np.radians([340.0, 10.0])
    u = [np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)]
    place = [float(round(p + range_m * v, 3)) for p, v in zip(PLACE_M, u, strict=True)]
    orbit = {"kind": "state", "position_m": place, "velocity_m_s": SPEED_M_S}
    return {"name": name, "orbit": orbit, "body": body} | more


def seen(body: Any, range_m: float = 4e6, **more: Any) -> Changes:
    """A satellite that follows one target of this body."""
    return {
        "observer": IN_ORBIT, "pointing": FOLLOW, "targets": [ahead(body, range_m, **more)],
        "background": {"uniform_e_per_s": 30.0},
    }  # fmt: skip


def orbits(observer: Any, target: Any, diameter_m: float) -> Changes:
    """A satellite that follows another, each on an orbit of its own."""
    body = SPHERE | {"diameter_m": diameter_m}
    return {
        "observer": {"kind": "orbit", "orbit": observer}, "pointing": FOLLOW,
        "targets": [{"name": "t", "orbit": target, "body": body, "eclipse": False}],
    }  # fmt: skip


def from_site(**more: Any) -> Changes:
    """The site, its dark sky, and stars."""
    return STARS | {"observer": SITE | more}


def pointed(mode: str, **more: Any) -> Changes:
    return {"pointing": {"mode": mode} | more}


def detector(**more: Any) -> Changes:
    """Light enough to see what a detector does to it."""
    return STARS | {"sensor.detector": more, "background": {"uniform_e_per_s": 200.0}}


def psf(kind: str, **more: Any) -> Changes:
    return STARS | {"sensor.psf": {"kind": kind} | more}


ROUGH: Changes = {"accuracy": {"noise_fraction": 0.5, "flux_fraction": 0.02}}
AT_FIELD = {"boresight_ra_deg": RA_DEG, "boresight_dec_deg": DEC_DEG}
GEO = dict(zip(("line1", "line2"), elements(100, GEO_PHASE_DEG), strict=True)) | {"kind": "tle"}
BEHIND = dict(zip(("line1", "line2"), elements(99, GEO_PHASE_DEG - 2.0), strict=True))
ELEMENTS = {
    "epoch": "2019-12-01T07:59:00Z", "mean_motion_rev_day": 14.3, "eccentricity": 0.001,
    "inclination_deg": 60.0, "raan_deg": 70.0, "argument_of_perigee_deg": 0.0,
    "mean_anomaly_deg": 10.0, "bstar": 1e-5,
}  # fmt: skip
KEPLER = {"kind": "keplerian", "eccentricity": 0.01, "inclination_deg": 60.0, "raan_deg": 70.0}
FORCED = {
    "kind": "numerical", "position_m": [7.1e6, 0, 0], "velocity_m_s": [0, 5000.0, 5600.0],
    "epoch": "2019-12-01T07:58:00Z",
}  # fmt: skip
CURVE = {"kind": "light_curve", "times_s": [-100.0, 0.0, 0.7, 100.0], "epoch": BASE["epoch"]}
MESH = {"kind": "mesh", "path": "@bus.obj", "unit": "m"}
FOIL = {"kind": "cook_torrance", "roughness": 0.4, "diffuse": 0.1, "normal_reflectance": 0.8}
PAINT = {"kind": "phong", "diffuse": 0.3, "specular": 0.4, "exponent": 20.0}
CELLS = {
    "kind": "ashikhmin_shirley", "diffuse": 0.05, "specular": 0.3, "exponent_u": 100.0,
    "exponent_v": 30.0, "grain": [1.0, 1.0, 0.0], "two_sided": True,
}  # fmt: skip

SCENES: dict[str, Changes] = {
    # Stars
    "nothing-but-noise": {"sensor.dark_e_per_s": 3.0, "accuracy.check_cells": 0},
    "stars": STARS | {"output": {"layers": LIGHTS, "compression": "none"}},
    "stars-without-effects": {
        "stars": {"catalogue": "@stars", "space_motion": False, "parallax": False,
                  "aberration": False, "deflection": False},
        "sensor.photon_noise": False, "sensor.fill_factor": 0.8, "pointing.roll_deg": 33.0,
        "accept": ["error", "sun", "moon", "daylight", "coverage"],
    },
    "stars-to-a-limit": {
        "stars": {"catalogue": "@stars", "faintest_g_mag": 13.5},
        "background": {"starlight": "all", "uniform_e_per_s": 3.0}, "output.layers": LIGHTS,
    },
    "stars-to-the-noise": {
        "stars": {"catalogue": "@stars", "faintest_g_mag": "auto"},
        "background": {"starlight": "auto", "uniform_mag_arcsec2": 17.0},
        "output": {"layers": LIGHTS, "compression": "zstd"},
    },
    "stars-limit-by-its-other-name": {
        "stars": {"catalogue": "@stars", "limit_from_noise": True},
        "background": {"starlight": "none", "uniform_mag_arcsec2": 16.0},
    },
    "stars-in-layers": {"stars": {"catalogue": ["@stars", "@layer"]}},
    "stars-streaked": STARS | pointed(
        "rate", **AT_FIELD, rate_ra_arcsec_s=90.0, rate_dec_arcsec_s=-60.0
    ),
    "stars-turning": STARS | pointed(
        "rate", **AT_FIELD, rate_ra_arcsec_s=-40.0, rate_dec_arcsec_s=10.0,
        acceleration_ra_arcsec_s2=30.0, acceleration_dec_arcsec_s2=-50.0, roll_deg=10.0,
        roll_rate_deg_s=8.0,
    ),
    # So slight a bend that bright stars' paths are a few long segments, which share their points.
    "stars-bright-and-bent": STARS | {
        "sensor.aperture_m": 0.3, "sensor.gain_e_per_dn": 40.0,
    } | pointed(
        "rate", **AT_FIELD, rate_ra_arcsec_s=-600.0, rate_dec_arcsec_s=700.0,
        acceleration_ra_arcsec_s2=0.02,
    ),
    "stars-streaked-in-wings": STARS | {
        "sensor.psf": {"kind": "airy"}, "sensor.shape": [48, 48],
        "accuracy": {"noise_fraction": 0.2, "flux_fraction": 0.01, "noise_floor_e": 4.0,
                     "check_cells": 1},
    } | pointed("rate", **AT_FIELD, rate_ra_arcsec_s=150.0, rate_dec_arcsec_s=40.0),
    "stars-crowded": {
        "stars": {"catalogue": "@crowd"}, "sensor.shape": [64, 64],
        "sensor.psf": {"kind": "moffat", "fwhm_px": 2.5, "beta": 3.0},
        "exposure.integration_s": 3.0,
    },
    "stars-crowded-and-streaked": {
        "stars": {"catalogue": "@crowd"}, "sensor.psf": {"kind": "airy"},
        "sensor.shape": [64, 64], "exposure.integration_s": 3.0,
    } | pointed("rate", **AT_FIELD, rate_ra_arcsec_s=30.0, rate_dec_arcsec_s=20.0),
    "stars-in-a-named-band": STARS | {
        "sensor.bandpass": {"kind": "named", "name": "bessell-B"}, "sensor.obscuration": 0.35,
        "exposure": {"integration_s": 1.0, "frames": 2, "cadence_s": 600.0},
    },
    "curves-from-tables": STARS | {
        "sensor.bandpass": {"kind": "table", "path": "@band.csv"},
        "sensor.transmission": "@mirrors.csv", "sensor.quantum_efficiency": "@qe.csv",
    },
    # Point-spread functions
    "gaussian-elliptical": psf("gaussian", sigma_px=1.4, sigma_minor_px=0.8, angle_deg=30.0,
                               jitter_px=0.3, charge_diffusion_px=0.2),
    "airy-with-vanes": psf(
        "airy", vanes={"count": 4, "width_m": 0.003, "angle_deg": 10.0}, wavelength_nm=600.0,
        aberrations=[{"noll": 7, "rms_nm": 40.0}, {"noll": 11, "rms_waves": -0.05}],
        defocus_um=8.0, oversampling=16,
    ) | {"sensor.obscuration": 0.3} | ROUGH,
    "airy-over-the-band": psf("airy", charge_diffusion_um=2.0, wavelengths=3, oversampling=64),
    "moffat": psf("moffat", fwhm_arcsec=20.0, oversampling=8),
    "kolmogorov": psf("kolmogorov", fwhm_arcsec=12.0, oversampling=128),
    "kolmogorov-alone": psf("kolmogorov", r0_m=0.01, reference_nm=550.0, diffraction=False),
    "kolmogorov-with-an-outer-scale": psf("kolmogorov", r0_m=0.01, outer_scale_m=0.8,
                                          wavelength_nm=600.0),
    "table-of-light": psf("table", path="@psf.npy", samples_per_px=4.0, centre="centroid",
                          light_fraction=0.97, flip_y=True),
    "table-from-a-listing": psf("table", path="@listing.txt", centre="file"),
    "table-of-pixels": psf("table", path="@collected.npy", samples_per_px=1.0, centre=[8.0, 8.0],
                           includes_pixel=True),
    "field-of-psfs": psf("field", rows_px=[0, 31], columns_px=[4, 27], psfs=[
        [{"kind": "gaussian", "sigma_px": 0.8}, {"kind": "moffat", "fwhm_px": 2.2}],
        [{"kind": "table", "path": "@even.npy", "sample_um": 3.0, "centre": "sample"},
         {"kind": "gaussian", "sigma_px": 1.1, "sigma_minor_px": 0.9}],
    ]) | ROUGH,
    "field-of-tables": psf("field", rows_px=[16], columns_px=[0, 16, 31], psfs=[
        [{"kind": "table", "path": "@even.npy", "sample_um": 3.0, "centre": "middle"},
         {"kind": "table", "path": "@psf.npy", "sample_um": 2.5, "centre": "peak"},
         {"kind": "airy", "wavelength_nm": 700.0, "jitter_px": 0.8}],
    ]) | ROUGH,
    # Distortion
    "distortion-sip": STARS | {"sensor.distortion": {
        "kind": "sip", "reference_px": [20.0, 10.0], "a": {"2_0": 1e-3, "0_3": 2e-5},
        "b": {"1_1": -2e-3},
    }},
    "distortion-tpv": STARS | {"sensor.distortion": {
        "kind": "tpv", "pv1": {"1": 1.01, "4": 0.3}, "pv2": {"7": 0.2},
        "cd_deg": [[-0.0026, 0.0], [0.0, 0.0026]],
    }},
    "distortion-radial": STARS | {"sensor.distortion": {
        "kind": "radial", "k1": 4e4, "k2": -3e9, "k3": 1e14, "p1": 0.5, "p2": -0.3,
    }},
    "distortion-from-a-file": STARS | {
        "sensor.distortion": {"kind": "file", "path": "@distorted.txt"}
    },
    # The detector
    "images-of-the-sensor": STARS | {
        "sensor.flat": "@flat.npy", "sensor.dark_e_per_s": "@dark.npy",
        "sensor.bias_dn": "@bias.npy", "sensor.gain_e_per_dn": "@gain.npy",
        "sensor.read_noise_e": "@read.npy", "background": {"uniform_e_per_s": 100.0},
        "output.layers": [*LIGHTS, "calibrated_e"],
    },
    "pixels-that-fail": detector(
        bad={"pixels": [[3, 4], [20, 21]], "rows": [9], "columns": [30], "fraction": 0.005,
             "map": "@bad.npy", "reads_dn": 77},
        dead={"pixels": [[5, 5]], "rows": [17], "columns": [2], "fraction": 0.01,
              "map": "@dead.npy"},
        hot={"pixels": [[11, 12, 900.0]], "fraction": 0.02, "median_e_per_s": 300.0,
             "sigma_dex": 0.6},
    ),
    "patterns": detector(
        prnu=0.02, row_noise_e=3.0, column_noise_e=2.0,
        bias_structure={"row_rms_dn": 2.0, "column_rms_dn": 3.0, "pixel_rms_dn": 1.0,
                        "row_slope_dn": 9.0, "column_slope_dn": -6.0},
        amplifiers=[
            {"rows": [0, 32], "columns": [0, 16], "gain_e_per_dn": 1.3, "offset_dn": 20.0,
             "read_noise_e": 8.0},
            {"rows": [0, 16], "columns": [16, 32], "offset_dn": -5.0},
        ],
    ) | {"sensor.adc_rounding": "floor", "sensor.flat": 0.9},
    "blooming": detector(
        blooming=True, nonlinearity={"kind": "polynomial", "coefficients": [-0.03, 0.01]}
    ) | {"sensor.full_well_e": 700.0, "sensor.adc_bits": 10, "sensor.gain_e_per_dn": 0.5},
    "bent-response-and-lag": detector(
        nonlinearity={"kind": "table", "true_e": [0, 500, 3000], "read_e": [0, 490, 2700]},
        lag={"fraction": 0.05},
    ) | {"sensor.full_well_e": 3000.0, "exposure": {"integration_s": 1.0, "frames": 3},
         "cosmic_rays": {"kind": "generated", "rate_per_cm2_s": 400.0},
         "output.layers": ["dn", "mean_e", "lag_e", "cosmic_rays_e"]},
    "frame-transfer": detector(
        readout={"kind": "frame_transfer", "transfer_s": 0.2, "towards": "low_rows",
                 "cleared": True}
    ),
    "frame-transfer-both-ways": detector(
        readout={"kind": "frame_transfer", "transfer_s": 0.1, "towards": "high_rows"}
    ) | {"sensor.full_well_e": 2000.0},
    "time-delay": detector(
        readout={"kind": "tdi", "rows_per_s": 6.0, "clock_phases": 4, "edges": "partial"}
    ) | pointed("rate", **AT_FIELD, rate_ra_arcsec_s=0.0, rate_dec_arcsec_s=-50.0),
    "time-delay-of-a-long-strip": detector(
        readout={"kind": "tdi", "rows_per_s": -4.0}
    ) | pointed("rate", **AT_FIELD, rate_ra_arcsec_s=2.0, rate_dec_arcsec_s=37.0),
    "rolling-shutter": detector(
        readout={"kind": "rolling", "line_s": 0.01, "first": "high_rows"}
    ) | pointed("rate", **AT_FIELD, rate_ra_arcsec_s=20.0, rate_dec_arcsec_s=15.0),
    "rolling-shutter-upwards": detector(
        readout={"kind": "rolling", "line_s": 0.004, "first": "low_rows"}
    ) | pointed("rate", **AT_FIELD, rate_ra_arcsec_s=-20.0, rate_dec_arcsec_s=15.0),
    "sixty-three-bits": STARS | {
        "sensor.adc_bits": 63, "sensor.gain_e_per_dn": 1e-9, "sensor.bias_dn": 1e17,
        "background": {"uniform_e_per_s": 2e8},
    },
    "behind-the-limb": STARS | {
        "observer": {"kind": "orbit", "orbit": {
            "kind": "state", "position_m": [-504910.0, -39678270.0, -14254220.0],
            "velocity_m_s": [3069.73, -40.77, 0.0],
        }},
        "exposure.integration_s": 2.0,
    },
    "in-the-umbra": {
        "observer": {"kind": "orbit", "orbit": {
            "kind": "state", "position_m": [3662780.0, 6010530.0, 2776260.0],
            "velocity_m_s": [-1062.63, -2480.5, 6772.15],
        }},
        "pointing": FOLLOW, "targets": [{
            "name": "t", "body": SPHERE, "orbit": {
                "kind": "state", "position_m": [2743570.0, 6404310.0, 2776260.0],
                "velocity_m_s": [-1062.63, -2480.5, 6772.15],
            },
        }],
    },
    "site-with-a-pole": from_site(polar_motion_arcsec=[0.3, -0.2]) | {
        "accept": ["sun", "moon", "daylight", "coverage", "error"],
    },
    "bias-frame": STARS | {"exposure.integration_s": 0.0, "sensor.dark_e_per_s": 40.0},
    "scaled-dark": {
        "sensor.dark_e_per_s": "@dark.npy", "sensor.dark_scale": 0.25,
        "sensor.pupil_projection": False, "sensor.sun_exclusion_deg": 10.0,
    },
    "two-tiles": STARS | {"sensor.shape": [16, 300], "output.tile_shape": [16, 256]},
    # Cosmic rays
    "rays-in-space": {
        "cosmic_rays": {"kind": "generated", "source": "space", "rate_per_cm2_s": 3000.0,
                        "thickness_um": 40.0, "diffusion_um": 2.0, "helium_share": 0.2,
                        "delta_electrons": False, "after_flat": True},
        "sensor.flat": 0.8, "sensor.shape": [48, 48], "output.layers": ["dn", "cosmic_rays_e"],
    },
    "rays-on-the-ground": {
        "cosmic_rays": {"kind": "generated", "source": "ground", "rate_per_cm2_s": 2000.0},
        "sensor.shape": [48, 48], "output.layers": ["dn", "cosmic_rays_e"],
    },
    "rays-of-a-library": {
        "cosmic_rays": {"kind": "library", "path": "@rays.fits", "rate_scale": 3.0,
                        "arrival": "poisson", "after_flat": True},
        "output.layers": ["dn", "cosmic_rays_e"], "sensor.flat": 0.7,
    },
    "rays-by-frames": {
        "cosmic_rays": {"kind": "library", "path": "@rays.fits", "arrival": "frames"},
        "output.layers": ["dn", "cosmic_rays_e"], "sensor.flat": 0.7, "sensor.shape": [40, 24],
    },
    # Pointing
    "attitude-of-a-table": STARS | pointed(
        "table", path="@attitude.csv", frame="icrs", interpolation="spline"
    ),
    "attitude-of-rows": STARS | pointed(
        "table", rows=[[t, w, -x, -y, -z] for t, x, y, z, w in attitude_rows()], scalar="first",
        frame="gcrs", rotation="sky_to_camera", epoch="2019-12-01T08:00:00Z",
        mounting=[1.0, 0.0, 0.0, 2e-4],
    ),
    "attitude-of-rows-scalar-last": STARS | pointed(
        "table", rows=attitude_rows(), scalar="last", frame="gcrs", interpolation="slerp",
        rotation="camera_to_sky",
    ),
    "attitude-that-wanders": STARS | {"pointing.attitude": {
        "drift": {"x_arcsec_s": 20.0, "y_arcsec_s": -10.0, "roll_arcsec_s": 3000.0},
        "jitter": [
            {"kind": "white", "rms_arcsec": 3.0, "low_hz": 0.5, "high_hz": 40.0},
            {"kind": "power_law", "rms_arcsec": 4.0, "exponent": 2.0, "low_hz": 0.1,
             "high_hz": 20.0},
            {"kind": "resonance", "rms_arcsec": 2.0, "frequency_hz": 3.0, "damping": 0.05},
            {"kind": "table", "path": "@jitter.csv"},
            {"kind": "table", "frequency_hz": [0.2, 2.0, 9.0], "arcsec2_per_hz": [4.0, 2.0, 0.1]},
        ],
    }, "exposure": {"integration_s": 1.0, "frames": 2, "cadence_s": 3.0}},
    "attitude-that-bends": STARS | {"pointing.attitude": {"modes": [
        {"kind": "oscillator", "axis": "x", "frequency_hz": 0.9, "damping": 0.02,
         "rms_arcsec": 5.0},
        {"kind": "oscillator", "axis": "y", "frequency_hz": 2.0, "damping": 0.1,
         "noise_arcsec_s2_rthz": 40.0},
        {"kind": "markov", "axis": "roll", "time_constant_s": 3.0, "rms_arcsec": 900.0},
        {"kind": "markov", "axis": "y", "time_constant_s": 2.0, "noise_arcsec_s_rthz": 3.0},
        {"kind": "random_walk", "axis": "x", "arcsec_rts": 3.0},
        {"kind": "rate_markov", "axis": "y", "time_constant_s": 5.0, "rms_arcsec_s": 4.0},
        {"kind": "system", "a": [[-1.0, 0.5], [-0.5, -1.0]], "b": [[3.0], [1.0]],
         "c": [[1.0, 0.0], [0.0, 1.0], [0.0, 5.0]]},
    ]}},
    "dwells": STARS | {"exposure": {"integration_s": 0.5, "frames": 1}, "dwells": [
        {"integration_s": [0.4, 0.8], "frames": 2, "cadence_s": 1.0},
        {"pointing": {"mode": "sidereal", "boresight_ra_deg": RA_DEG + 0.02,
                      "boresight_dec_deg": DEC_DEG, "roll_deg": 5.0,
                      "attitude": {"drift": {"x_arcsec_s": 9.0}}},
         "slew": {"duration_s": 4.0, "profile": "bang_bang"}, "start_s": 6.0,
         "settle": {"amplitude_arcsec": 30.0, "frequency_hz": 1.5, "damping": 0.1,
                    "direction_deg": 30.0}},
        {"pointing": {"mode": "sidereal", **AT_FIELD}, "wait_s": 0.5, "integration_s": 1.0,
         "slew": {"duration_s": 3.0, "profile": "minimum_jerk"}},
    ]},
    "held-to-a-site": pointed("local", azimuth_deg=120.0, elevation_deg=60.0, roll_deg=10.0) | {
        "observer": SITE, "background": {"zodiacal": True, "uniform_mag_arcsec2": 21.0},
        "output.layers": ["dn", "background_e"], "sensor.focal_length_m": 0.02,
    },
    "held-to-an-orbit": pointed("local", azimuth_deg=0.0, elevation_deg=50.0) | {
        "observer": IN_ORBIT, "observer.orbit.epoch": "2019-12-01T07:59:30Z",
        "background": {"galactic": {"share": 0.3}, "zodiacal": {}},
        "output.layers": ["dn", "background_e"], "sensor.focal_length_m": 0.02,
    },
    # The sky, the air
    "sky-of-space": sky(200.0, 10.0) | {
        "background": {"zodiacal": {"near_sun": "extrapolate"}, "galactic": True},
        "sensor.focal_length_m": 0.02, "exposure.integration_s": 0.5,
        "observer": {"kind": "fixed", "position_au": [0.35, 0.86, 0.37]},
        "output.layers": ["dn", "background_e"],
    },
    "stray-light-of-a-table": sky(190.0, 10.0) | {
        "observer": HIGH, "sensor.focal_length_m": 0.05, "epoch": "2019-04-20T03:00:00Z",
        "background": {"stray_light": {
            "pst": {"kind": "table", "path": "@pst.csv", "holds_transmission": False,
                    "beyond": "clip"},
            "earth_albedo": "@earth.npy", "inside": "clip", "exclusion_deg": 2.0,
        }}, "sensor.transmission": 0.7, "output.layers": ["dn", "background_e"],
    },
    "stray-light-of-mirrors": sky(190.0, 30.0) | {
        "observer": HIGH, "sensor.focal_length_m": 0.05, "epoch": "2019-04-20T03:00:00Z",
        "background": {"stray_light": {
            "pst": {"kind": "harvey", "b0_per_sr": 1e-4, "shoulder": 0.02, "slope": -1.8,
                    "mirrors": 2},
            "sun": True, "moon": False, "earth_albedo": 0.25, "inside": "extrapolate",
        }}, "output.layers": ["dn", "background_e"],
    },
    "stray-light-of-the-moon": sky(300.0, -12.0) | {
        "observer": HIGH, "exposure.integration_s": 100.0,
        "background": {"stray_light": {
            "pst": {"kind": "table", "path": "@pst.csv", "beyond": "zero"}, "sun": False,
            "earth": False, "inside": "refuse",
        }}, "output.layers": ["dn", "background_e"],
    },
    "stray-light-of-the-sun": sky(300.0, 0.0) | {
        "observer": {"kind": "fixed", "position_au": [0.6, 0.8, 0.0]},
        "background": {"stray_light": {
            "pst": {"kind": "table", "path": "@pst.csv", "beyond": "refuse"}, "moon": False,
            "earth": False,
        }}, "output.layers": ["dn", "background_e"],
    },
    "stars-through-air": from_site(atmosphere={
        "extinction": {"aerosol_mag": 0.2, "aerosol_slope": 1.1, "ozone_dobson": 280.0,
                       "diffuse_share": 0.4},
        "refraction": {"pressure_hpa": 700.0, "temperature_c": 5.0, "humidity": 0.2,
                       "wavelength_nm": 600.0},
    }) | {"background": {"airglow": {"solar_flux_sfu": 90.0}, "zodiacal": True},
          "output.layers": LIGHTS},
    "moonlight-and-twilight": sky(0.0, 25.0) | {
        "epoch": "2019-12-10T04:50:00Z",
        "observer": SITE | {"atmosphere": {"extinction": {"mag_per_airmass": 0.2}}},
        "background": {"airglow": True, "moonlight": True, "twilight": True},
        "sensor.focal_length_m": 0.03, "exposure.integration_s": 0.1,
        "output.layers": ["dn", "background_e"],
    },
    "refraction-alone": from_site(atmosphere={"refraction": True}) | {"pointing.roll_deg": -70.0},
    # Targets: orbits
    "orbits-of-elements": orbits({"kind": "tle"} | BEHIND, GEO, 0.3),
    "orbits-of-messages": orbits(
        {"kind": "omm", "elements": ELEMENTS},
        {"kind": "omm", "path": "@elements.json", "object": "TWO"}, 0.1,
    ),
    "orbits-of-kepler": orbits(
        KEPLER | {"semi_major_axis_m": 7.2e6, "true_anomaly_deg": 10.0,
                  "argument_of_perigee_deg": 5.0},
        KEPLER | {"perigee_radius_m": 7.13e6, "mean_anomaly_deg": 18.0, "frame": "gcrs",
                  "epoch": "2019-12-01T08:00:00Z"}, 0.1,
    ),
    "orbits-by-a-perigee": orbits(
        KEPLER | {"perigee_radius_m": 7.13e6, "time_of_perigee": "2019-12-01T07:58:00Z"},
        KEPLER | {"perigee_radius_m": 7.2e6, "time_of_perigee": "2019-12-01T07:57:30Z"}, 0.1,
    ),
    "orbits-by-forces": orbits(
        FORCED | {"zonals": 6, "third_bodies": ["sun", "moon"], "drag_m2_kg": 0.02,
                  "radiation_m2_kg": 0.03, "relative_tolerance": 1e-10},
        FORCED | {"position_m": [7.2e6, 2e4, 0], "zonals": 0, "shadow": "cylindrical"}, 0.02,
    ),
    "orbits-of-tables": orbits(
        {"kind": "ephemeris", "path": "@circle.csv", "frame": "gcrs",
         "epoch": "2019-12-01T08:00:00Z"},
        {"kind": "table", "epoch": "2019-12-01T08:00:00Z", "rows": circle_rows(0.03),
         "nodes": 8}, 0.04,
    ),
    "orbits-of-tables-in-other-axes": orbits(
        {"kind": "ephemeris", "path": "@circle.csv", "frame": "teme", "object": "circle",
         "epoch": "2019-12-01T08:00:00Z"},
        {"kind": "ephemeris", "path": "@ahead.csv", "frame": "eme2000",
         "epoch": "2019-12-01T08:00:00Z"}, 0.04,
    ) | {"pointing.roll_deg": 25.0},
    "orbits-of-tables-on-the-earth": orbits(
        {"kind": "ephemeris", "path": "@circle.csv", "frame": "itrf"},
        {"kind": "ephemeris", "path": "@ahead.csv", "frame": "itrf"}, 0.04,
    ),
    "orbits-by-fewer-forces": orbits(FORCED | {"zonals": 2}, FORCED, 0.02) | {"targets": [
        {"name": name, "body": SPHERE | {"diameter_m": 0.02}, "eclipse": False,
         "orbit": FORCED | {"position_m": [7.2e6, y_m, 0], "zonals": zonals}}
        for name, y_m, zonals in (("t", 2e4, 3), ("u", 2e4 + 100.0, 4), ("v", 2e4 - 90.0, 5))
    ]},
    # Targets: bodies, attitudes, lighting
    "sphere": seen(SPHERE, eclipse=True, lighting={
        "oblate_earth": True, "limb_darkening": 0.6, "moon": True, "earthshine_albedo": 0.3,
    }) | {"output.layers": LIGHTS},
    "sphere-of-some-size": seen(SPHERE | {"diameter_m": 40.0, "albedo": 2e-8}, 9e4),
    "plate": seen({"kind": "plate", "area_m2": 1.0, "two_sided": True,
                   "albedo": [[350, 0.2], [600, 0.5], [1000, 0.4]],
                   "attitude": {"kind": "sun", "quaternion": [0.8, 0.35, -0.35, 0.0]}}),
    "box-and-cube": seen({"kind": "composite", "attitude": {"kind": "nadir"}, "parts": [
        {"kind": "box", "size_m": [0.5, 0.7, 0.9], "albedo": 0.3},
        {"kind": "cube", "edge_m": 0.4, "albedo": 0.5, "attitude": {"kind": "velocity"}},
    ]}),
    "cylinder": seen({"kind": "cylinder", "diameter_m": 0.8, "length_m": 1.5, "albedo": 0.3,
                      "closed": "top", "attitude": SPIN | {"epoch": "2019-12-01T07:59:00Z"}}),
    "cone": seen({"kind": "cone", "diameter_m": 0.8, "length_m": 1.5, "albedo": 0.3,
                  "attitude": {"kind": "inertial", "quaternion": [0.6, 0.1, 0.7, 0.2]}}),
    "frustum": seen({"kind": "frustum", "base_diameter_m": 1.0, "top_diameter_m": 0.5,
                     "length_m": 1.2, "albedo": 0.3, "closed": "none",
                     "attitude": {"kind": "table", "times_s": [-10.0, 0.5, 10.0],
                                  "quaternions": [[1, 0, 0, 0], [0.9, 0.3, 0, 0.1],
                                                  [0.5, 0.5, 0.5, 0.5]],
                                  "epoch": "2019-12-01T08:00:00Z"}}),
    "composite": seen({"kind": "composite", "attitude": {"kind": "nadir"}, "parts": [
        SPHERE | {"diameter_m": 0.4},
        {"kind": "plate", "area_m2": 0.8, "albedo": 0.2,
         "attitude": {"kind": "sun_tracking", "bus": "nadir", "axis": [0, 1, 0]}},
        {"kind": "plate", "area_m2": 0.5, "albedo": 0.3,
         "attitude": {"kind": "sun_tracking", "bus": "velocity"}},
        {"kind": "plate", "area_m2": 0.5, "albedo": 0.3,
         "attitude": {"kind": "sun_tracking", "bus": "inertial", "quaternion": TILTED}},
        {"kind": "cylinder", "diameter_m": 0.3, "length_m": 1.0, "albedo": 0.3, "closed": "both"},
        {"kind": "cylinder", "diameter_m": 0.3, "length_m": 0.5, "albedo": 0.3, "closed": "base"},
        {"kind": "cylinder", "diameter_m": 0.2, "length_m": 0.5, "albedo": 0.3, "closed": "none"},
        {"kind": "cone", "diameter_m": 0.5, "length_m": 0.5, "albedo": 0.3, "closed": "none"},
        {"kind": "cone", "diameter_m": 0.5, "length_m": 0.5, "albedo": 0.3, "closed": "base"},
        *({"kind": "frustum", "base_diameter_m": 0.4, "top_diameter_m": 0.2, "length_m": 0.3,
           "albedo": 0.3, "closed": ends} for ends in ("both", "base", "top")),
    ]}),
    "light-curves": seen(
        CURVE | {"magnitudes": [6.0, 6.0, 7.5, 7.5], "range_m": 4e6, "sun_mag": -26.7,
                 "phase_law": "linear", "phase_deg": 20.0, "mag_per_deg": 0.02}
    ) | {"targets": [
        ahead(CURVE | {"magnitudes": [6.0, 6.0, 7.5, 7.5], "range_m": 4e6, "sun_mag": -26.7,
                       "phase_law": "linear", "phase_deg": 20.0, "mag_per_deg": 0.02}),
        ahead(CURVE | {"intensities_m2_sr": [0.1, 0.02, 0.05, 0.1], "phase_law": "lambert",
                       "phase_deg": 60.0, "period_s": 200.0}, 4.0002e6, "u"),
        ahead(CURVE | {"intensities_m2_sr": [0.1, 0.1, 0.05, 0.1], "phase_law": "as_given"},
              4.0004e6, "v"),
    ]},
    "mesh": seen(MESH | {
        "surface": FOIL, "materials": {"paint": PAINT, "cells": CELLS}, "error": 1e-4,
        "attitude": SPIN | {"rate_deg_s": 10.0},
        "parts": [{"name": "wing", "objects": ["Panel"], "place_m": [0.1, 0.0, 0.0],
                   "joint": {"kind": "sun_tracking", "axis": [1, 0, 0], "face": [0, 0, 1],
                             "pivot_m": [0, 0.5, 0.5], "angle_deg": 5.0}}],
    }, 7e6),
    "mesh-of-some-size": seen(MESH | {
        "unit": "ft", "attitude": {"kind": "sun", "quaternion": TILTED},
        "surface": {"kind": "lambert", "albedo": 0.1},
        "materials": {"foil": {"kind": "table", "path": "@brdf.csv", "scale": 0.3},
                      "paint": {"kind": "cook_torrance", "roughness": 0.3,
                                "refractive_index": [1.5, 2.0]}},
        "parts": [
            {"name": "arm", "path": "@bus.obj", "unit": "in", "objects": ["Bus"],
             "place_m": [0.0, 0.2, 1.0], "quaternion": TILTED,
             "joint": {"kind": "spin", "axis": [0, 0, 1], "rate_deg_s": 20.0},
             "surface": {"kind": "lambert", "albedo": 0.2}},
            {"name": "hand", "path": "@bus.obj", "unit": "mm", "on": "arm",
             "joint": {"kind": "fixed", "axis": [1, 0, 0], "angle_deg": 30.0},
             "materials": {"cells": {"kind": "phong", "diffuse": 0.3, "specular": 0.2,
                                     "exponent": 5.0}}},
            {"name": "foot", "path": "@bus.obj", "unit": "cm", "place_m": [0.0, -0.4, 0.0]},
        ],
    }, 3e3, lighting={"earthshine_albedo": 0.3}) | {
        "sensor.aperture_m": 1e-3, "exposure.integration_s": 1e-3, "sensor.gain_e_per_dn": 4.0,
        "sensor.psf": {"kind": "gaussian", "sigma_px": 0.7},
    },
    "mesh-in-many-frames": seen(MESH | {
        "surface": PAINT, "attitude": SPIN | {"rate_deg_s": 300.0}, "error": 1e-2,
    }, 7e6) | {"exposure": {"integration_s": 1.0, "frames": 6, "cadence_s": 5.0},
               "sensor.shape": [8, 8], "accuracy.flux_fraction": 0.02},
    "population": {
        "observer": SITE, "pointing": FOLLOW,
        "targets": [{"name": "t", "orbit": GEO, "body": SPHERE | {"diameter_m": 6.0}}],
        "populations": [
            {"name": "crowd", "path": "@population.tle", "sizes": "@sizes.csv", "eclipse": False,
             "rules": [{"name_contains": "DEB", "diameter_m": 9.0, "albedo": 0.6}],
             "body": SPHERE | {"diameter_m": 4.0}},
            {"name": "dim", "path": "@beside.tle", "body": SPHERE, "eclipse": True},
        ],
    },
}  # fmt: skip

# What else is made of a product: exports by format, and its calibrated copy.
AFTERWARDS: dict[str, tuple[str, ...]] = {
    "images-of-the-sensor": ("fits", "png", "calibrated"),
    "sphere": ("fits", "satnet", "coco", "masks"),
    "dwells": ("satnet", "gif"),
}

SWEEPS: dict[str, dict[str, Any]] = {
    "sweep-of-a-grid": {
        "scene": "sphere", "seeds": 2, "targets": ["t"], "cubes": [1],
        "detection": {"threshold_sigma": 4.0, "search_px": 2.0},
        "axes": [{"field": "sensor.read_noise_e", "values": [3.0, 9.0]},
                 {"field": "targets.0.body.albedo", "kind": "range", "start": 0.1, "stop": 0.3,
                  "count": 2, "integer": False}],
    },
    "sweep-in-step": {
        "scene": "stars", "design": {"kind": "zip"}, "cubes": "none",
        "axes": [{"kind": "table", "fields": ["sensor.aperture_m", "stars.faintest_g_mag"],
                  "rows": [[0.1, 15.0], [0.12, 14.0]]},
                 {"field": "exposure.integration_s", "kind": "log_range", "start": 0.5,
                  "stop": 2.0, "count": 2}],
    },
    "sweep-of-sobol": {
        "scene": "nothing-but-noise", "design": {"kind": "sobol", "points": 4, "seed": 3},
        "metrics": ["background", "saturation", "limiting_magnitude"], "cubes": "all",
        "axes": [{"field": "sensor.adc_bits", "kind": "range", "start": 8, "stop": 16,
                  "integer": True},
                 {"field": "sensor.gain_e_per_dn", "kind": "log_range", "start": 0.5,
                  "stop": 4.0}],
    },
    "sweep-of-a-latin-square": {
        "scene": "nothing-but-noise", "design": {"kind": "latin_hypercube", "points": 3},
        "metrics": ["snr", "detection", "background", "timing"],
        "axes": [{"field": "sensor.dark_e_per_s", "kind": "range", "start": 1.0, "stop": 9.0}],
    },
}  # fmt: skip

NAMES = (*SCENES, *SWEEPS)
