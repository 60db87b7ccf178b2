"""Limiting cases of frames: tiny and huge focal planes, exposures, fluxes, widths, and the ADC."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.special import erf

from pipeline.errors import BadInput
from pipeline.execute.tile import TileSources, render_tile
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from pipeline.studies.selftest.case import CaseResult, case
from pipeline.studies.selftest.scenes import BODY, frames, scene, sky_only
from pipeline.studies.worst import worst_of

Array = np.ndarray


def _gaussian(shape: tuple[int, ...], x: float, y: float, sigma: float) -> Array:
    """Share of a Gaussian's light in each pixel: products of differences of erf."""

    def along(n: int, centre: float) -> Array:
        return np.diff(0.5 * erf((np.arange(n + 1) - 0.5 - centre) / (np.sqrt(2.0) * sigma)))

    return np.outer(along(shape[0], y), along(shape[1], x))


def _against_erf(folder: Path, **changes: object) -> tuple[float, float, float]:
    """Largest error of a pixel over the peak, over the noise of its pixel, and the electrons."""
    data = scene({f"{k}".replace("__", "."): v for k, v in changes.items()})
    found = frames(data, folder)
    truth = {k: v[0] for k, v in found.truth.items()}
    mean = found.layers["mean_e"][0].astype(float)
    sigma = data["sensor"]["psf"]["sigma_px"]
    right = truth["electrons"] * _gaussian(mean.shape, truth["x_px"], truth["y_px"], sigma)
    off = np.abs(mean - right)
    return (
        float(off.max() / right.max()),
        float((off / np.sqrt(right + 1.0)).max()),
        float(truth["electrons"]),
    )


@case(
    "frames/sigma",
    "a star's image 0.05, 0.3 and 50 px wide (sigma) at about 100,000 e-",
    "differences of erf",
    0.05,
    "sigma of the pixel's noise",
)
def widths(folder: Path) -> CaseResult:
    worst, said = 0.0, []
    for sigma, side in ((0.05, 64), (0.3, 64), (50.0, 700)):
        peak, noise, _ = _against_erf(
            folder / str(sigma),
            sensor__psf={"kind": "gaussian", "sigma_px": sigma},
            sensor__shape=[side, side],
            targets=[_body(0.5)],
        )
        worst = worst_of(worst, noise)
        said.append(f"{sigma}: {peak:.1g} of peak")
    return CaseResult("as erf", ", ".join(said), worst)


def _body(diameter_m: float) -> dict:
    return {**BODY, "body": {"kind": "sphere", "diameter_m": diameter_m, "albedo": 0.5}}


@case(
    "frames/flux",
    "bodies of 1e-12 to 1e15 e- (40 pm to 5 m before a 100 m aperture)",
    "light goes with the square of the size, and all of it falls on the frame",
    1e-6,
)
def fluxes(folder: Path) -> CaseResult:
    worst, said = 0.0, []
    big = {
        "sensor.aperture_m": 100.0,
        "sensor.focal_length_m": 1e-3,
        "sensor.adc_bits": 63,
        "exposure.integration_s": 1.0,
    }
    per_m2 = 0.0
    for size in (5.0, 1e-3, 1e-8, 1.8e-13):
        found = frames(scene({"targets": [_body(size)], **big}), folder / f"{size:g}")
        given = float(found.truth["electrons"][0])
        per_m2 = per_m2 or given / size**2
        total = float(found.layers["mean_e"].astype(float).sum())
        worst = worst_of(worst, abs(total / given - 1.0), abs(given / size**2 / per_m2 - 1.0))
        said.append(f"{given:.3g}")
    return CaseResult("sum = truth, truth ~ size^2", " ".join(said) + " e-", worst)


@case(
    "frames/exposure",
    "exposures of 1e-9 s and 1e4 s of a sky of 3 e-/s",
    "rate times time",
    1e-6,
)
def exposures(folder: Path) -> CaseResult:
    worst = 0.0
    for seconds in (1e-9, 1e4):
        sky = {"background": {"uniform_e_per_s": 3.0}, "exposure.integration_s": seconds}
        mean = frames(sky_only(sky), folder / f"{seconds:g}").layers["mean_e"]
        worst = worst_of(worst, np.abs(mean / (3.0 * seconds) - 1.0).max())
    return CaseResult("3e-9 and 3e4 e-", f"within {worst:.2g}", worst)


@case(
    "frames/63-bits",
    "an ADC of 63 bits at 1e18 DN and at its top; no noise",
    "whole numbers counted by hand",
    0.0,
    "DN",
)
def adc_63(folder: Path) -> CaseResult:
    low = {
        "background": {"uniform_e_per_s": 1e9},
        "exposure.integration_s": 1.0,
        "sensor.gain_e_per_dn": 1.0,
        "sensor.bias_dn": 1e18,
        "sensor.adc_bits": 63,
        "sensor.read_noise_e": 0.0,
        "sensor.shape": [4, 4],
    }
    dn = frames(sky_only(low), folder / "low").layers["dn"]
    top = frames(sky_only({**low, "sensor.bias_dn": 1e19}), folder / "top").layers["dn"]
    off = [abs(int(v) - (10**18 + 10**9)) for v in dn.ravel()]
    off += [abs(int(v) - (2**63 - 1)) for v in top.ravel()]
    return CaseResult(
        "10^18 + 10^9; 2^63 - 1", f"{int(dn.flat[0])}; {int(top.flat[0])}", worst_of(*off)
    )


@case(
    "frames/saturated",
    "a frame far beyond full well, and one beyond the ADC",
    "full well over gain; 2^N - 1",
    0.0,
    "DN",
)
def saturated(folder: Path) -> CaseResult:
    sky = {
        "background": {"uniform_e_per_s": 1e9},
        "sensor.full_well_e": 1000.0,
        "sensor.read_noise_e": 0.0,
        "sensor.gain_e_per_dn": 2.0,
    }
    well = frames(sky_only(sky), folder / "well").layers["dn"]
    adc = frames(sky_only({**sky, "sensor.adc_bits": 8}), folder / "adc").layers["dn"]
    off = worst_of(np.abs(well.astype(float) - 500).max(), np.abs(adc.astype(float) - 255).max())
    return CaseResult("500; 255", f"{well.min()} to {well.max()}; {adc.min()} to {adc.max()}", off)


@case("frames/one-pixel", "a focal plane of one pixel with a body on it", "erf", 0.05, "sigma")
def one_pixel(folder: Path) -> CaseResult:
    peak, noise, e = _against_erf(folder, sensor__shape=[1, 1], targets=[_body(0.2)])
    return CaseResult("as erf", f"{peak:.1g} of {e:.3g} e-", noise)


@case(
    "frames/no-light",
    "a sensor that detects nothing (quantum efficiency 0)",
    "refused: no frame could be told from a fault",
    0.0,
    "frames drawn",
)
def no_light(folder: Path) -> CaseResult:
    try:
        frames(scene({"sensor.quantum_efficiency": 0.0}), folder)
    except BadInput as e:
        return CaseResult("a message that names the field", str(e), 0.0)
    return CaseResult("a message that names the field", "a frame", 1.0)


@case(
    "frames/huge",
    "a tile in the corner of 30,000 x 30,000 pixels, without drawing the others",
    "the sky's rate in every pixel",
    1e-6,
)
def huge(_: Path) -> CaseResult:
    sky = {
        "background": {"uniform_e_per_s": 3.0},
        "sensor.shape": [30_000, 30_000],
        "sensor.pixel_pitch_um": 1.0,
        "exposure.integration_s": 1.0,
    }
    prepared = prepare(parse_scene(sky_only(sky)))
    plan = prepared.plan
    g = plan_geometry(plan.scene, np.array([0]), plan.dut1_s)
    tile = plan.tiles[-1]
    layers, _checks = render_tile(plan, prepared.maps, g, tile, TileSources([], []))
    off = float(np.abs(layers["mean_e"] / 3.0 - 1.0).max())
    return CaseResult("3 e-", f"{tile.rows} x {tile.columns} of {len(plan.tiles)} tiles", off)
