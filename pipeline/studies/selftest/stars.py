"""Limiting cases of stars: streaks of any length, edges, a faint neighbour of a bright star."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.special import erf

from catalog_tools.documents import JsonObject
from catalog_tools.ingest.ingest import ingest
from pipeline.studies.selftest.case import CaseResult, case
from pipeline.studies.selftest.scenes import Frames, frames, sky_only
from pipeline.studies.worst import worst_of

Array = np.ndarray
PIXEL_ARCSEC = np.degrees(1e-3) * 3600.0
STILL = {"space_motion": False, "parallax": False, "aberration": False, "deflection": False}


def _catalogue(folder: Path, ra_deg: Array, dec_deg: Array, g_mag: Array) -> str:
    """A catalogue of a few stars, made by the product's own ingest."""
    folder.mkdir(parents=True, exist_ok=True)
    columns = (ra_deg.tolist(), dec_deg.tolist(), g_mag.tolist())
    rows = [f"{i + 1},{r!r},{d!r},{g!r}" for i, (r, d, g) in enumerate(zip(*columns, strict=True))]
    csv = folder / "stars.csv"
    csv.write_text("\n".join(["source_id,ra,dec,phot_g_mean_mag", *rows]) + "\n")
    catalogue = folder / "catalogue"
    if not catalogue.exists():
        ingest([csv], catalogue, form="gaia_dr2", workers=1)
    return str(catalogue)


def _sky(x_px: Array, y_px: Array, side: int) -> tuple[Array, Array]:
    """Right ascension and declination [deg] of pixels of a frame that looks at (180, 0) deg."""
    xi, eta = -1e-3 * (x_px - 0.5 * (side - 1)), 1e-3 * (y_px - 0.5 * (side - 1))
    ra = 180.0 + np.degrees(np.arctan(xi))
    dec = np.degrees(np.arctan2(eta, np.hypot(1.0, xi)))
    return ra, dec


def _stars(folder: Path, x: Array, y: Array, g: Array, changes: JsonObject) -> Frames:
    side = changes.get("sensor.shape", [64, 64])[0]
    catalogue = _catalogue(folder / "made", *_sky(x, y, side), g)
    data = sky_only({"stars": {"catalogue": catalogue, **STILL}, "sensor.adc_bits": 63, **changes})
    return frames(data, folder, "stars")


def _rate(length_px: float) -> JsonObject:
    """Pointing that leaves streaks of a length along rows, and starts so that they are centred."""
    shift_deg = 0.5 * length_px * PIXEL_ARCSEC / 3600.0
    return {
        "pointing": {
            "mode": "rate",
            "boresight_ra_deg": 180.0 - shift_deg,
            "boresight_dec_deg": 0.0,
            "rate_ra_arcsec_s": length_px * PIXEL_ARCSEC,
            "rate_dec_arcsec_s": 0.0,
        },
        "exposure.integration_s": 1.0,
    }


def _swept(shape: tuple[int, int], t: dict[str, Array], sigma: float) -> Array:
    """A Gaussian swept along a straight line, by Gauss's rule on 100 pieces: (rows, columns)."""
    nodes, weights = np.polynomial.legendre.leggauss(16)
    s = ((np.arange(100)[:, None] + 0.5 * (nodes + 1.0)) / 100.0).ravel()
    share = np.tile(weights / 200.0, 100)
    x = t["x_start_px"] + s * (t["x_end_px"] - t["x_start_px"])
    y = t["y_start_px"] + s * (t["y_end_px"] - t["y_start_px"])

    def along(n: int, centre: Array) -> Array:
        edges = (np.arange(n + 1) - 0.5)[:, None] - centre
        return np.diff(0.5 * erf(edges / (np.sqrt(2.0) * sigma)), axis=0)

    return (along(shape[0], y) * share) @ along(shape[1], x).T


def _all_stars(shape: tuple[int, int], truth: dict[str, Array]) -> Array:
    """The sum of all stars of a truth table, 0.8 px wide (sigma)."""
    image = np.zeros(shape)
    for i, electrons in enumerate(truth["electrons"]):
        image += electrons * _swept(shape, {k: v[i] for k, v in truth.items()}, 0.8)
    return image


@case(
    "stars/streaks",
    "streaks of 0, 1e-9, 0.1 and 40 px: every pixel of a star of 10,000 e-",
    "erf swept by quadrature along the truth's line",
    0.05,
    "sigma of the pixel's noise",
)
def streaks(folder: Path) -> CaseResult:
    worst, said = 0.0, []
    at = np.array([31.3])
    for length in (0.0, 1e-9, 0.1, 40.0):
        found = _stars(folder / f"{length:g}", at, at, np.array([8.0]), _rate(length))
        t = {k: v[0] for k, v in found.truth.items() if v.dtype.kind == "f"}
        mean = found.layers["mean_e"][0].astype(float)
        right = t["electrons"] * _swept(mean.shape, t, 0.8)
        off = float((np.abs(mean - right) / np.sqrt(right + 1.0)).max())
        worst = worst_of(worst, off)
        said.append(f"{length:g} px: {off:.2g}")
    return CaseResult("as swept", ", ".join(said), worst)


@case(
    "stars/long-streak",
    "a streak of 3000 px: light per pixel in the middle of the frame",
    "the star's light over rate and time",
    1e-4,
)
def long_streak(folder: Path) -> CaseResult:
    found = _stars(
        folder,
        np.array([31.3]),
        np.array([31.3]),
        np.array([4.0]),
        {
            **_rate(3000.0),
            "sensor.focal_length_m": 0.2,
            "sensor.pupil_projection": False,  # its light is even along the streak
            "pointing.boresight_ra_deg": 180.0 - 4.2967,
            "pointing.rate_ra_arcsec_s": 3000.0 * PIXEL_ARCSEC / 20.0,
        },
    )
    t = {k: v[0] for k, v in found.truth.items() if v.dtype.kind == "f"}
    length = 3000.0  # px of 5e-5 rad: the rate is exact on the axis, and the frame's 64 px near it
    per_px = found.layers["mean_e"][0].astype(float).sum(axis=0)[20:44]
    error = float(np.abs(per_px * length / t["electrons"] - 1.0).max())
    return CaseResult(f"{t['electrons'] / length:.6g} e-/px", f"{per_px.mean():.6g} e-/px", error)


@case(
    "stars/neighbour",
    "one star of 1e9 e- and one of about 1 e- 12 px away",
    "the sum of both by erf",
    0.05,
    "e-",
)
def neighbour(folder: Path) -> CaseResult:
    x, y, g = np.array([20.3, 32.3]), np.array([31.7, 31.7]), np.array([-4.5, 18.0])
    found = _stars(folder, x, y, g, {"exposure.integration_s": 1.0})
    mean = found.layers["mean_e"][0].astype(float)
    t = found.truth
    right = _all_stars(mean.shape, t)
    box = np.s_[28:36, 29:37]
    off = float(np.abs(mean[box] - right[box]).max())
    return CaseResult(f"{right[box].sum():.6f} e- in 8 x 8 px", f"{mean[box].sum():.6f} e-", off)


@case(
    "stars/edges",
    "stars on corners, edges and tile borders, and three stamps outside",
    "erf",
    0.05,
    "sigma of the pixel's noise",
)
def edges(folder: Path) -> CaseResult:
    x, y = (
        v.ravel()
        for v in np.meshgrid(
            [-40.0, -0.5, 0.0, 255.5, 256.0, 511.49, 551.0], [-40.0, -0.5, 255.5, 511.5, 551.0]
        )
    )
    found = _stars(
        folder,
        x,
        y,
        np.full(x.size, 7.0),
        {
            "sensor.shape": [512, 512],
            "output.tile_shape": [256, 256],
        },
    )
    mean, t = found.layers["mean_e"][0].astype(float), found.truth
    right = _all_stars(mean.shape, t)
    off = float((np.abs(mean - right) / np.sqrt(right + 1.0)).max())
    return CaseResult("as erf", f"{t['electrons'].size} stars in the truth", off)


@case(
    "stars/magnitudes",
    "stars of magnitude 30 and of magnitude -20 in one frame",
    "finite and not negative",
    0.0,
    "pixels",
)
def ends_of_magnitude(folder: Path) -> CaseResult:
    at = np.array([20.0, 40.0])
    mean = _stars(folder, at, at, np.array([30.0, -20.0]), {}).layers["mean_e"]
    bad = int(np.count_nonzero(~np.isfinite(mean) | (mean < 0)))
    return CaseResult("0 bad pixels", f"{bad}; brightest {mean.max():.3g} e-", float(bad))
