"""SImSiT configurations (YAML) as scenes: one observation out of those that it draws at random."""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from scipy.interpolate import CubicSpline

from catalog_tools.documents import JsonObject, levels
from pipeline.errors import BadInput
from pipeline.importers.imported import Fields, Imported, Notes, read_bytes, scene_name
from pipeline.importers.passes import Pass, zenith_pass
from pipeline.inputs.band.curves import resolve_response
from pipeline.physics.radiometry import ab_photon_rate, collecting_area_m2

ARCSEC_RAD = math.radians(1 / 3600)
BAND = {"kind": "box", "short_nm": 691.0, "long_nm": 818.0}  # LSST i, of which its zero point is
LSST_E_S, LSST_MAG, LSST_M2 = 32.36, 24.0, 32.4  # electrons a second of that AB magnitude
# Latitude, longitude (east) [deg] and height [m], as observatories publish them.
SITES = {
    "apo": (32.78028, -105.82028, 2798.0),
    "ctio": (-30.16528, -70.81500, 2215.0),
    "haleakala": (20.70750, -156.25667, 3048.0),
    "kpno": (31.96333, -111.60000, 2120.0),
    "lapalma": (28.75833, -17.88000, 2327.0),
    "lick": (37.34139, -121.64278, 1283.0),
    "cerro pachon": (-30.24074, -70.73669, 2749.0),
    "palomar": (33.35600, -116.86300, 1706.0),
}
MOST_VALUES = 100_000  # that a file may hold, with what its anchors stand for
LARGEST_IMAGE_PX = 1 << 23  # vignetting is written as an image up to so many pixels


def read_simsit(
    path: Path, epoch: str, catalogue: str | None = None, seed: int | None = None
) -> Imported:
    """One observation of a SImSiT file as a scene.

    epoch : UTC of the exposure (SImSiT draws a night of 2010); catalogue : for its stars
    seed : of what the file gives as ranges; default: the file's own. The draws are uniform as in
        SImSiT but not in its order, so they are not those of its own first image
    Raises BadInput that names the key of the file.
    """
    f = Fields(_yaml(path))
    notes = Notes()
    chosen = f.whole("seed", 0, 2**62, 0) if seed is None else seed
    rng = np.random.default_rng(chosen)
    for key in ("seed", "meta", "outdir", "n_demo"):  # and names of files and contests
        f.get(key)
    images: dict[str, NDArray[np.float32]] = {}
    sensor = _sensor(f, rng, images, scene_name(path), notes)
    times = f.get("cadence.exptime")
    if not isinstance(times, list) or not times:
        raise BadInput("cadence.exptime", times, "a list of seconds")
    seconds = Fields({"exptime": times[int(rng.integers(len(times)))]}).number("exptime", 1e-6, 1e5)
    site = _site(f, rng)
    sky = _within(f, "conditions.sky_range", rng, -30, 40)
    height_m = 1e3 * rng.uniform(400.0, 800.0)
    heading = float(rng.uniform(0.0, 2.0 * math.pi))
    data: JsonObject = {
        "schema": "nightglass/scene/1",
        "name": scene_name(path),
        "epoch": epoch,
        "seed": chosen,
        "observer": site,
        "sensor": sensor,
        "exposure": {"integration_s": seconds},
        "background": {"uniform_mag_arcsec2": sky},
        "output": {"layers": ["dn", "mean_e", "targets_e"]},
    }
    notes.assumed += [
        f"drawn with seed {chosen}: exposure {seconds:g} s, sky {sky:.2f} mag/arcsec2 (AB), a "
        f"satellite {height_m / 1e3:.0f} km high, heading {math.degrees(heading):.0f} deg",
        f"epoch {epoch}, and the satellite at the zenith in the middle of the exposure",
        "32 bits: SImSiT stores electrons as real numbers, without bias, dark current, full well",
    ]
    if catalogue is not None:
        data["stars"] = {"catalogue": catalogue}
    request = Pass(height_m, heading, _magnitude(f, rng, notes), _tracks(f))
    _leave_out(f, notes, catalogue)
    data, lost = zenith_pass(data, request)
    notes.left_out += [lost] if lost else []
    return Imported(f"SImSiT {path.name}", data, images, notes)


def _yaml(path: Path) -> object:
    """Plain data; anchors are followed, as these files use them, and nothing else is run."""
    try:
        data = YAML(typ="safe", pure=True).load(BytesIO(read_bytes(path)))
        _check_extent(data)
        return data
    except (YAMLError, RecursionError, ValueError, UnicodeDecodeError) as error:
        problem = next(iter(str(error).splitlines()), "")
        raise BadInput("FILE", str(path), f"YAML ({problem})") from None


def _check_extent(data: object) -> None:
    """ValueError for more values than a file writes out: anchors within anchors."""
    values = 0
    for level in levels(data):
        values += sum(map(len, level))
        if values > MOST_VALUES:
            raise ValueError(f"more than {MOST_VALUES} values, with what its anchors stand for")


def _within(f: Fields, key: str, rng: np.random.Generator, low: float, high: float) -> float:
    """A value drawn evenly from a range of the file."""
    ends = f.pair(key, 2)
    if not low <= ends[0] <= ends[1] <= high:
        raise BadInput(key, ends, f"two ascending numbers from {low:g} to {high:g}")
    return float(rng.uniform(ends[0], ends[1]))


def _sensor(
    f: Fields,
    rng: np.random.Generator,
    images: dict[str, NDArray[np.float32]],
    name: str,
    notes: Notes,
) -> JsonObject:
    shape = f.pair("instrument.image_shape", 2, 60_000)
    columns, rows = map(int, shape)
    if (columns, rows) != tuple(shape) or min(columns, rows) < 1:
        raise BadInput("instrument.image_shape", shape, "two whole numbers from 1 to 60000")
    pitch = f.number("instrument.pixel_scale", 0.05, 1000)
    th, scale = _table(f, "instrument.distortion", "dthdr", 1e-6, 1e6)
    focal_m = 1e-6 / (scale[0] * ARCSEC_RAD)
    sensor: JsonObject = {
        "shape": [rows, columns],
        "pixel_pitch_um": pitch,
        "focal_length_m": float(focal_m),
        "aperture_m": f.number("instrument.aperture", 1e-4, 100),
        "obscuration": f.number("instrument.obscuration", 0, 0.999, 0.0),
        "bandpass": BAND,
        "gain_e_per_dn": f.number("instrument.gain", 1e-9, 1e9),
        "read_noise_e": f.number("instrument.read_noise", 0, 1e9),
        "adc_bits": 32,
    }
    notes.converted.append(
        f"plate scale {scale[0]:.6g} arcsec/um on the axis: focal length {focal_m:.5g} m"
    )
    corner = math.hypot(rows, columns) / 2 * pitch * scale.max() / 3600
    if np.ptp(scale) > 0:
        terms, error_px = radial_terms(th, scale, 1.1 * corner, pitch)
        sensor["distortion"] = {"kind": "radial", **terms}
        notes.converted.append(
            f"distortion.dthdr: radial terms k1 {terms['k1']:.5g}, k2 {terms['k2']:.5g}, "
            f"k3 {terms['k3']:.5g}, within {error_px:.2g} px of the table"
        )
    offset = _within(f, "conditions.zp_range", rng, -10, 10)
    sensor["transmission"] = _throughput(sensor, offset, notes)
    fwhm = _within(f, "conditions.psf_fwhm_range", rng, 0.01, 100)
    sensor["psf"] = {
        "kind": "kolmogorov",
        "fwhm_arcsec": fwhm,
        "reference_nm": 754.5,
        "diffraction": False,
        "wavelength_nm": 754.5,
    }
    notes.assumed.append(f"drawn: seeing of {fwhm:.3g} arcsec, a zero point {offset:.3g} mag up")
    _vignetting(f, sensor, images, name, float(scale[0]), notes)
    return sensor


def _throughput(sensor: JsonObject, offset_mag: float, notes: Notes) -> float:
    """Transmission that gives SImSiT's zero point, scaled from LSST's i band by area alone."""
    area = collecting_area_m2(sensor["aperture_m"], sensor["obscuration"])
    zero = LSST_MAG + 2.5 * math.log10(LSST_E_S * area / LSST_M2) + offset_mag
    response, *_ = resolve_response(BAND, 1.0, 1.0)
    share = 1.0 / (ab_photon_rate(zero, response) * area)
    if share > 1.0:
        raise BadInput("conditions.zp_range", offset_mag, f"up to {-2.5 * math.log10(share):.3g}")
    notes.converted.append(
        f"zero point {zero:.4g} mag (AB, 1 e-/s): transmission {share:.4g} over 691 to 818 nm"
    )
    return share


def _table(
    f: Fields, key: str, column: str, low: float, high: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A table of values from low to high against the field angle [deg] of the file."""
    lists = [f.get(f"{key}.{name}") for name in ("th", column)]
    try:
        th, value = (np.array(v, float) for v in lists)
    except (TypeError, ValueError, OverflowError):
        raise BadInput(f"{key}.{column}", lists[1], "lists of numbers") from None
    bad = not th.ndim == 1 < th.size or th.shape != value.shape
    if bad or th[0] != 0 or not th[-1] <= 180 or not (np.diff(th) > 0).all():
        raise BadInput(f"{key}.th", lists[0], f"ascending from 0 to 180, as many as {column}")
    if not (np.clip(value, low, high) == value).all():
        raise BadInput(f"{key}.{column}", lists[1], f"numbers from {low:g} to {high:g}")
    return th, value


def radial_terms(
    th_deg: NDArray[np.float64], arcsec_um: NDArray[np.float64], most_deg: float, pitch_um: float
) -> tuple[dict[str, float], float]:
    """Brown-Conrady terms of a table of plate scales, and the largest misfit [px] to `most_deg`.

    The radius on the detector is the integral of d theta over the scale (cubic between the
    table's points); k1 to k3 fit radius / (f tan theta) - 1.
    """
    spline = CubicSpline(th_deg, 1.0 / arcsec_um)
    at = np.linspace(0.0, min(most_deg, th_deg[-1]), 400)[1:]
    radius_um = np.array([spline.integrate(0.0, t) for t in at]) * 3600.0
    t = np.tan(np.radians(at))
    focal_um = 1.0 / (arcsec_um[0] * ARCSEC_RAD)
    bend = radius_um / (focal_um * t) - 1.0
    powers = np.stack([(t / t[-1]) ** n for n in (2, 4, 6)], axis=-1) * t[:, None]
    k = np.linalg.lstsq(powers, bend * t, rcond=None)[0]
    misfit = np.abs(powers @ k - bend * t).max() * focal_um / pitch_um
    names = {"k1": 2, "k2": 4, "k3": 6}
    return {n: float(v / t[-1] ** p) for (n, p), v in zip(names.items(), k, strict=True)}, float(
        misfit
    )


def _vignetting(
    f: Fields,
    sensor: JsonObject,
    images: dict[str, NDArray[np.float32]],
    name: str,
    arcsec_um: float,
    notes: Notes,
) -> None:
    if not f.has("instrument.vignetting"):
        return
    th, share = _table(f, "instrument.vignetting", "unvig", 0.0, 10.0)
    rows, columns = sensor["shape"]
    if rows * columns > LARGEST_IMAGE_PX:
        notes.left_out.append(
            f"instrument.vignetting: an image of {rows} x {columns} pixels would be written"
        )
        return
    y, x = np.ogrid[:rows, :columns]
    step_deg = sensor["pixel_pitch_um"] * arcsec_um / 3600
    angle = np.hypot(y - (rows - 1) / 2, x - (columns - 1) / 2) * step_deg
    images[f"{name}.flat.npy"] = np.clip(np.interp(angle, th, share), 0, None).astype(np.float32)
    sensor["flat"] = f"{name}.flat.npy"
    notes.converted.append("instrument.vignetting: the image of the flat, linear in the table")


def _site(f: Fields, rng: np.random.Generator) -> JsonObject:
    names = f.get("sites")
    if not isinstance(names, list) or not names:
        raise BadInput("sites", names, "a list of names")
    name = str(names[int(rng.integers(len(names)))])
    if name.lower() not in SITES:
        raise BadInput("sites", name, ", ".join(SITES))
    latitude, longitude, height = SITES[name.lower()]
    return {
        "kind": "ground",
        "latitude_deg": latitude,
        "longitude_deg": longitude,
        "height_m": height,
    }


def _magnitude(f: Fields, rng: np.random.Generator, notes: Notes) -> float | None:
    """AB magnitude of the satellite; None for one that sends no light."""
    if f.get("sat.mag_range") is None:
        notes.converted.append("sat.mag_range null: a satellite that sends no light")
        return None
    mag = _within(f, "sat.mag_range", rng, -30, 60)
    notes.assumed.append(f"drawn: a satellite of {mag:.3f} mag (AB)")
    return mag


def _tracks(f: Fields) -> bool:
    kind = f.get("tracker.type")
    if kind not in ("orbit", "sidereal"):
        raise BadInput("tracker.type", kind, "orbit or sidereal")
    f.number("tracker.rot_sky_pos0", 0, 0, 0.0)
    return bool(kind == "orbit")


def _leave_out(f: Fields, notes: Notes, catalogue: str | None) -> None:
    """What a scene does not have, or SImSiT itself does not use."""
    told = {
        "n_obs": "one scene is one observation; import it again with other --seed values",
        "n_sat": "one satellite",
        "filter": "SImSiT's zero point is that of LSST's i band whatever it says",
        "tracker.error": "the pointing is exact",
        "tracker.jitter": "SImSiT reads it and does not apply it; set sensor.psf.jitter_px",
        "sat.size_range": "the magnitude is given",
        "sat.albedo_range": "the magnitude is given",
        "catalog": "its stars; give a --catalogue" if catalogue is None else "as given",
    }
    notes.left_out.append(
        "noise of one second of sky that SImSiT draws beside that of the exposure's own sky"
    )
    gain = f.number("instrument.gain", 1e-9, 1e9)
    if gain != 1.0:
        notes.left_out.append(
            f"instrument.gain {gain:g}: SImSiT's numbers are the zero point's electrons, not over "
            f"the gain, and {gain:g} times ours; their noise is that of {gain:g} times the light"
        )
    for key, why in told.items():
        if f.has(key):
            value = f.get(key)
            if key == "n_sat" and value == 1:
                continue
            shown = "" if isinstance(value, dict) else f" {value}"
            notes.left_out.append(f"{key}{shown}: {why}")
    notes.left_out += [f"{key}: no such thing in a scene" for key in f.unused()]
