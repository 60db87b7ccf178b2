"""SatSim configurations (JSON) as scenes: zero point, fields of view, noise, straight lines."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf, erfinv

from catalog_tools.documents import JsonObject, is_deeper
from pipeline.errors import BadInput
from pipeline.importers.imported import Fields, Imported, Notes, read_bytes, scene_name
from pipeline.importers.placing import Wanted, astray, electrons_of_sunlight, far_observer, place
from pipeline.importers.satsim_values import Chance, settled
from pipeline.physics.positions.times import parse_utc
from pipeline.physics.targets.sphere import sphere_intensity_per_irradiance

Images = dict[str, NDArray[np.float32]]  # by the names of their files

PITCH_UM = 10.0
RA_DEG, DEC_DEG = 180.0, 0.0
SUN_MAG = -26.74  # SatSim's own, in its lambertian_sphere
BAND = {"kind": "named", "name": "bessell-V"}
ADC_BITS = {"uint8": 8, "uint16": 16, "uint32": 32}
# How SatSim computes and what it writes, not what it draws: keys of its `sim`.
COMPUTING = """
analytical_obs analytical_obs_frame apply_star_wrap_around calculate_snr czml_samples
enable_deflection enable_earth_shadow enable_fov_filter enable_light_transit enable_profiler
enable_shot_noise enable_stellar_aberration fits_compression fov_filter_radius mode
num_shot_noise_samples num_target_samples padding point_rendering psf_sample_frequency render_size
samples save_cloud_transmission save_czml save_ground_truth save_jpeg save_movie save_pickle
save_segmentation show_obs_boxes show_star_boxes spacial_osf spatial_osf star_annotation_threshold
star_catalog_query_mode star_render_mode temporal_osf velocity_units
epsf.batch_element_budget epsf.batch_size epsf.crop epsf.fallback_to_fft_for_models
epsf.$cache epsf.kernel_size epsf.normalize epsf.phase_oversample epsf.psf_generation_padding
epsf.psf_generation_size
"""
IGNORED = ("version", *(f"sim.{key}" for key in COMPUTING.split()))
TRUTH = ("mv_truth", "pe_truth")  # of an object: what comes out
DEEPEST = 64  # levels of lists and mappings in a file


def read_satsim(path: Path, epoch: str, catalogue: str | None = None, seed: int = 0) -> Imported:
    """A SatSim file as a scene.

    epoch : UTC of the first exposure, where the file has no geometry.time
    catalogue : for its stars
    seed : of what the file leaves to chance ($sample), drawn once
    Raises BadInput that names the key of the file.
    """
    try:
        raw = json.loads(read_bytes(path))
    except (ValueError, RecursionError) as error:
        raise BadInput("FILE", str(path), f"JSON ({error})") from None
    if is_deeper(raw, DEEPEST):
        raise BadInput("FILE", str(path), f"values that are nested {DEEPEST} deep at most")
    notes = Notes()
    chance = Chance(np.random.default_rng(seed))
    fields = Fields(settled(raw, chance))
    for name in IGNORED:
        fields.get(name)
    images: Images = {}
    sensor = _sensor(fields, notes, images, scene_name(path))
    exposure = _exposure(fields)
    epoch = _epoch(fields, epoch, notes)
    ra_deg, dec_deg = _boresight(fields, notes)
    data: JsonObject = {
        "schema": "nightglass/scene/1",
        "name": scene_name(path),
        "epoch": epoch,
        "seed": seed,
        "accept": ["sun"],
        "observer": far_observer(ra_deg, dec_deg),
        "sensor": sensor,
        "pointing": _pointing(fields, (ra_deg, dec_deg), sensor, notes),
        "exposure": exposure,
        "output": {"layers": ["dn", "mean_e", "targets_e"]},
    }
    zero = fields.number("fpa.zeropoint", -10, 60)
    sky = _background(fields, zero, sensor, notes)
    if sky is not None:
        data["background"] = sky
    _stars(fields, catalogue, data, notes)
    wanted = _targets(fields, sensor["shape"], zero, notes)
    notes.assumed += [
        f"epoch {epoch}; an observer {1e-3 * 1e9:.0f} km from the Earth that looks at RA "
        f"{ra_deg:g}, Dec {dec_deg:g} deg: the file places targets on pixels, not in space",
        f"a pixel pitch of {PITCH_UM:g} um, with the focal length that gives the field of view",
        "band bessell-V, with the aperture that gives the zero point to a star like the Sun",
        "accept sun: SatSim looks anywhere at any time",
    ]
    notes.assumed += chance.told
    notes.left_out += [f"{key}: no such thing in a scene" for key in fields.unused()]
    data = place(data, wanted)
    if (off_px := astray(data, wanted)) > 0.01:
        notes.left_out.append(
            f"lines: up to {off_px:.2g} px off between the first exposure and the last"
        )
    return Imported(f"SatSim {path.name}", data, images, notes)


def _sensor(f: Fields, notes: Notes, images: Images, name: str) -> JsonObject:
    rows, columns = f.whole("fpa.height", 1, 60_000), f.whole("fpa.width", 1, 60_000)
    y_deg, x_deg = (f.number(f"fpa.{a}_fov", 1e-6, 60) for a in "yx")
    ifov = math.radians(math.sqrt(y_deg / rows * x_deg / columns))
    arcsec = math.degrees(ifov) * 3600
    notes.converted.append(f"fields of {y_deg:g} x {x_deg:g} deg: pixels of {arcsec:.4g} arcsec")
    if not math.isclose(y_deg / rows, x_deg / columns, rel_tol=1e-3):
        notes.left_out.append(
            f"pixels of {3600 * y_deg / rows:.4g} x {3600 * x_deg / columns:.4g} arcsec: ours are "
            "square, of the same area; places and motions in pixels are kept, those of a "
            "catalogue's stars are not"
        )
    zero = f.number("fpa.zeropoint", -10, 60)
    sensor: JsonObject = {
        "shape": [rows, columns],
        "pixel_pitch_um": PITCH_UM,
        "focal_length_m": PITCH_UM * 1e-6 / ifov,
        "aperture_m": 1.0,
        "bandpass": BAND,
        "adc_rounding": "floor",
        "pupil_projection": False,  # its light is the same off axis
    }
    # A star like the Sun has V = -26.76 at 1 au: what the aperture must collect from it.
    wanted = 10.0 ** (0.4 * (zero + 26.76))
    sensor["aperture_m"] = math.sqrt(wanted / electrons_of_sunlight(sensor))
    notes.converted.append(
        f"zeropoint {zero:g} (1 e-/s): aperture {sensor['aperture_m']:.4g} m without losses"
    )
    eod = f.number("fpa.psf.eod", 1e-6, 1 - 1e-9)
    mode = f.get("fpa.psf.mode", "gaussian")
    if mode != "gaussian":
        raise BadInput("fpa.psf.mode", mode, "gaussian")
    sigma = 1.0 / (2.0 * math.sqrt(2.0) * float(erfinv(math.sqrt(eod))))
    sensor["psf"] = {"kind": "gaussian", "sigma_px": sigma}
    notes.converted.append(f"psf.eod {eod:.4g} (light on one pixel): sigma {sigma:.4g} px")
    noise = [f.number(f"fpa.noise.{k}", 0, 1e6, 0.0) for k in ("read", "electronic")]
    sensor["read_noise_e"] = math.hypot(*noise)
    notes.converted.append(
        f"noise read {noise[0]:g} and electronic {noise[1]:g} e-: {math.hypot(*noise):.4g} e- rms"
    )
    _tell_of_subpixels(f, sigma, notes)
    sensor |= _shot_noise(f, notes) | _digital(f)
    sensor |= _maps(f, (rows, columns), images, name, notes)
    top_dn = f.number("fpa.a2d.fwc", 1, 1e15) / sensor["gain_e_per_dn"]
    if sensor["read_noise_e"] and top_dn < 2 ** sensor["adc_bits"] - 1:
        notes.left_out.append(
            f"a2d.fwc: SatSim cuts off read noise, too, so that no pixel exceeds {top_dn:.6g} "
            "DN; here a full pixel has that with its read noise"
        )
    return sensor


def _subpixels(f: Fields) -> float:
    """How many subpixels SatSim draws a pixel with, along a row or column."""
    key = "sim.spatial_osf" if f.has("sim.spatial_osf") else "sim.spacial_osf"
    return f.number(key, 1, 1e3) if f.has(key) else math.inf


def _tell_of_subpixels(f: Fields, sigma_px: float, notes: Notes) -> None:
    """What drawing points on subpixels does to SatSim's images; ours are continuous."""
    n = _subpixels(f)
    if f.get("sim.mode") == "none":
        notes.left_out.append("sim.mode none: SatSim draws no image; a scene is drawn")
    if f.get("sim.mode") == "epsf":
        side = f.whole("sim.epsf.kernel_size", 1, 99_999)
        near, far = erf((side + np.array([-1.0, 1.0])) / (math.sqrt(8.0) * sigma_px))
        if (lost := 1.0 - (0.5 * (near + far)) ** 2) > 1e-3:  # between four pixels
            notes.left_out.append(
                f"sim.epsf.kernel_size {side}: SatSim draws no light beyond; up to "
                f"{100 * lost:.2g}%"
            )
    if f.get("sim.point_rendering") == "floor":
        notes.left_out.append(
            f"sim.point_rendering floor: SatSim's sources stand up to {1 / n:.2g} px up and left"
        )
        return
    # A point between two subpixels is shared by them, which adds up to 1/4 of a subpixel squared;
    # light is sampled at their middles, where a pixel's 1/12 would count each whole.
    wider = math.sqrt(1.0 + 1.0 / (6.0 * n**2 * (sigma_px**2 + 1.0 / 12.0))) - 1.0
    if wider > 0.005:
        notes.left_out.append(
            f"subpixels: SatSim draws points on {n:g} a pixel, which makes its images up to "
            f"{100 * wider:.2g}% wider"
        )


def _shot_noise(f: Fields, notes: Notes) -> JsonObject:
    """Whether light has noise; as it does by default."""
    samples = f.get("sim.num_shot_noise_samples")
    if samples is not None:
        notes.left_out.append(f"sim.num_shot_noise_samples {samples}: the noise is of one exposure")
    on = f.get("sim.enable_shot_noise", True)
    if not isinstance(on, bool):
        raise BadInput("sim.enable_shot_noise", on, "true or false")
    return {} if on else {"photon_noise": False}


def _digital(f: Fields) -> JsonObject:
    if f.get("fpa.a2d.response", "linear") != "linear":
        raise BadInput("fpa.a2d.response", f.get("fpa.a2d.response"), "linear")
    kind = str(f.get("fpa.a2d.dtype", "uint16"))
    if kind not in ADC_BITS:
        raise BadInput("fpa.a2d.dtype", kind, ", ".join(ADC_BITS))
    return {
        "gain_e_per_dn": f.number("fpa.a2d.gain", 1e-9, 1e9),
        "adc_bits": ADC_BITS[kind],
    }


def _maps(
    f: Fields,
    shape: tuple[int, int],
    images: Images,
    name: str,
    notes: Notes,
) -> JsonObject:
    """Dark current, flat and bias, numbers or images written beside the scene; the full well."""
    gain = f.number("fpa.a2d.gain", 1e-9, 1e9)
    offset = f.number("fpa.a2d.bias", -1e9, 1e9, 0.0)
    bias = _level(f, "fpa.bias", 0.0)
    values = {
        "dark_e_per_s": _level(f, "fpa.dark_current", 0.0),
        "flat": _level(f, "fpa.gain", 1.0),
        "bias_dn": bias / gain + offset,
    }
    notes.converted.append(
        f"bias of {float(np.median(bias)):.4g} e- and a2d.bias of {offset:g} DN: "
        f"{float(np.median(values['bias_dn'])):.5g} DN"
    )
    out: JsonObject = {"full_well_e": _full_well(f, bias, offset * gain, notes)}
    for key, value in values.items():
        if isinstance(value, np.ndarray):
            if value.shape != shape:
                raise BadInput(f"fpa ({key})", list(value.shape), f"an image of {list(shape)}")
            if key != "bias_dn" and (below := int((value < 0.0).sum())):
                notes.left_out.append(f"{below} pixels of {key} below 0: they are 0")
                value = np.maximum(value, 0.0)
            images[f"{name}.{key}.npy"] = value.astype(np.float32)
            out[key] = f"{name}.{key}.npy"
        else:
            out[key] = value
    return out


def _level(f: Fields, key: str, default: float) -> float | NDArray[np.float64]:
    """A number, or an image that is left to chance."""
    value = f.get(key, default)
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadInput(key, value, "a number or $sample")
    return f.number(key, -1e15, 1e15, default)


def _full_well(
    f: Fields, bias_e: float | NDArray[np.float64], offset_e: float, notes: Notes
) -> float:
    """Charge that fills a pixel: SatSim cuts off at `fwc` what it has added both biases to."""
    most = f.number("fpa.a2d.fwc", 1, 1e15)
    added = float(np.median(bias_e)) + offset_e
    if added >= most:
        raise BadInput("fpa.a2d.fwc", most, f"more than the biases of {added:g} e-, which it holds")
    notes.converted.append(f"a2d.fwc {most:g} e- with the biases: {most - added:g} e- of charge")
    return most - added


def _exposure(f: Fields) -> JsonObject:
    seconds = f.number("fpa.time.exposure", 1e-9, 1e5)
    gap = f.number("fpa.time.gap", 0, 1e6, 0.0)
    frames = f.whole("fpa.num_frames", 1, 100_000)
    return {"integration_s": seconds, "frames": frames, "cadence_s": seconds + gap}


def _epoch(f: Fields, epoch: str, notes: Notes) -> str:
    """UTC of the first exposure: the file's [year, month, day, hour, minute, second], if any."""
    if not f.has("geometry.time"):
        return epoch
    *whole, seconds = f.pair("geometry.time", 6)
    if any(value % 1 for value in whole):
        raise BadInput("geometry.time", whole, "whole numbers but for the seconds")
    year, month, day, hour, minute = map(int, whole)
    text = f"{year:04d}-{month:02d}-{day:02d}T{hour:02d}:{minute:02d}:{seconds:09.6f}Z"
    parse_utc(text, "geometry.time")
    notes.converted.append(f"geometry.time: epoch {text}")
    return text


def _boresight(f: Fields, notes: Notes) -> tuple[float, float]:
    """Where SatSim looks in its star catalogue [deg]; elsewhere a place of ours."""
    if f.get("geometry.site") is not None:
        notes.left_out.append("geometry.site: the focal plane alone; give it observer and pointing")
        return RA_DEG, DEC_DEG
    if f.get("geometry.stars.mode") not in ("sstr7", "csv"):
        return RA_DEG, DEC_DEG
    ra_deg = f.number("geometry.stars.ra", -360, 360, 0.0) % 360.0
    dec_deg = f.number("geometry.stars.dec", -90, 90, 0.0)
    notes.converted.append(
        f"stars about RA {ra_deg:g}, Dec {dec_deg:g} deg: the boresight, in the middle; SatSim's "
        f"stars stand half a subpixel, {0.5 / _subpixels(f):.2g} px, further down and right"
    )
    turn = f.number("geometry.stars.rotation", -360, 360, 0.0)
    if f.get("fpa.flip_left_right"):
        if turn:
            notes.left_out.append(f"geometry.stars.rotation {turn:g} deg: +y is north")
    else:
        notes.left_out.append(
            f"geometry.stars.rotation {turn:g} deg: +y is north; SatSim's columns grow with right "
            "ascension unless it flips them, a scene's against it"
        )
    return ra_deg, dec_deg


def _pointing(
    f: Fields, boresight_deg: tuple[float, float], sensor: JsonObject, notes: Notes
) -> JsonObject:
    """Stars that move by so many pixels a second are a boresight that moves the other way."""
    step = math.degrees(sensor["pixel_pitch_um"] * 1e-6 / sensor["focal_length_m"]) * 3600
    at = dict(zip(("boresight_ra_deg", "boresight_dec_deg"), boresight_deg, strict=True))
    if not f.has("geometry.stars.motion") or f.get("geometry.site") is not None:
        return {"mode": "sidereal", **at}  # of a site, stars move as its track has it
    mode = f.get("geometry.stars.motion.mode")
    if mode not in ("affine", "affine-polar", "none"):
        raise BadInput("geometry.stars.motion.mode", mode, "affine, affine-polar or none")
    if mode == "none":
        return {"mode": "sidereal", **at}
    rotation = f.number("geometry.stars.motion.rotation", -1e3, 1e3, 0.0)
    if rotation:
        notes.left_out.append(
            f"geometry.stars.motion.rotation {rotation:.4g} rad/s: the boresight does not turn"
        )
    if not f.has("geometry.stars.motion.translation"):
        return {"mode": "sidereal", **at}
    row, column = _motion(
        f, "geometry.stars.motion.translation", mode == "affine-polar", _speed_units(f)
    )
    notes.converted.append(
        f"stars move by ({row:.4g}, {column:.4g}) px/s (row, column): the boresight by "
        f"({column * step:.5g}, {-row * step:.5g}) arcsec/s in RA and Dec"
    )
    streak_px = math.hypot(row, column) * f.number("fpa.time.exposure", 1e-9, 1e5)
    steps = f.get("sim.temporal_osf", "auto")
    if isinstance(steps, int | float) and streak_px > 0.5 * max(steps - 1, 0):
        notes.left_out.append(
            f"sim.temporal_osf {steps:g}: SatSim draws a star so often from the start to the "
            f"end of its streak of {streak_px:.4g} px (once: at the start); here it is continuous"
        )
    return {
        "mode": "rate",
        **at,
        "rate_ra_arcsec_s": column * step,
        "rate_dec_arcsec_s": -row * step,
    }


def _speed_units(f: Fields) -> tuple[float, float]:
    """What a pixel is in the file's unit of speeds, down a column and along a row."""
    units = f.get("sim.velocity_units", "pixel")
    if units not in ("pixel", "arcsec"):
        raise BadInput("sim.velocity_units", units, "pixel or arcsec")
    if units == "pixel":
        return 1.0, 1.0
    return (
        3600 * f.number("fpa.y_fov", 1e-6, 60) / f.whole("fpa.height", 1, 60_000),
        3600 * f.number("fpa.x_fov", 1e-6, 60) / f.whole("fpa.width", 1, 60_000),
    )


def _motion(
    f: Fields, key: str, polar: bool, units_a_pixel: tuple[float, float]
) -> tuple[float, float]:
    """Rows and columns [px/s] that something moves by.

    polar : the file has an angle [deg] and a speed; rows (down) take its sine, columns its cosine
    units_a_pixel : of `_speed_units`
    """
    down, right = f.pair(key, 2, 1e6)
    if polar:
        angle_rad, speed = math.radians(down), right
        down, right = speed * math.sin(angle_rad), speed * math.cos(angle_rad)
    return down / units_a_pixel[0], right / units_a_pixel[1]


def _background(f: Fields, zero: float, sensor: JsonObject, notes: Notes) -> JsonObject | None:
    rate = _stray(f, notes)
    if f.has("background.galactic"):
        mag = f.number("background.galactic", -30, 60)
        step = math.degrees(sensor["pixel_pitch_um"] * 1e-6 / sensor["focal_length_m"]) * 3600
        galactic = 10.0 ** (-0.4 * (mag - zero)) * step**2
        notes.converted.append(f"background {mag:g} mag/arcsec2: {galactic:.5g} e-/s a pixel")
        rate += galactic
    return {"uniform_e_per_s": rate} if rate else None


def _stray(f: Fields, notes: Notes) -> float:
    """Stray light [e-/s] of every pixel; what differs between pixels is told of."""
    stray = f.get("background.stray", 0.0)
    if isinstance(stray, int | float):
        return f.number("background.stray", 0, 1e12, 0.0)
    kind = "that differs between pixels"
    if isinstance(stray, dict):
        kind = stray.get("mode", kind)
    if kind != "none":
        notes.left_out.append(f"background.stray {kind}")
    return 0.0


def _stars(f: Fields, catalogue: str | None, data: JsonObject, notes: Notes) -> None:
    mode, density = f.get("geometry.stars.mode"), f.get("geometry.stars.mv.density", [])
    for key in ("mv", "motion", "pad", "path"):
        f.get(f"geometry.stars.{key}")
    if catalogue is not None:
        data["stars"] = {"catalogue": catalogue}
        notes.assumed.append(f"stars of {catalogue}")
    elif mode in ("sstr7", "csv"):
        notes.left_out.append(f"geometry.stars: those of mode {mode}; give a --catalogue")
    if mode == "bins":
        if not isinstance(density, list):
            raise BadInput("geometry.stars.mv.density", density, "a list of numbers")
        count = sum(v for v in density if isinstance(v, int | float))
        notes.left_out.append(
            f"geometry.stars: {count:.4g} stars a square degree at random places; give a "
            "--catalogue for stars"
        )


def _targets(f: Fields, shape: list[int], zero: float, notes: Notes) -> list[Wanted]:
    """The straight lines of the file; what moves or shines otherwise is told of."""
    listed = f.get("geometry.obs.list", [])
    if not isinstance(listed, list):
        raise BadInput("geometry.obs.list", listed, "a list")
    f.get("geometry.obs.mode")
    out = []
    for i, one in enumerate(listed):
        o = Fields(one, f"geometry.obs.list.{i}")
        mode = o.get("mode")
        if mode == "none":
            continue
        if mode not in ("line", "line-polar"):
            notes.left_out.append(f"geometry.obs.list.{i}: of mode {mode}; give it an orbit")
            continue
        row, column = o.pair("origin", 2, 1e3)
        down, right = _motion(o, "velocity", mode == "line-polar", _speed_units(f))
        rate = _rate(o, zero, i, notes)
        for name in TRUTH:
            o.get(name)
        notes.left_out += [f"{key}: no such thing in a scene" for key in o.unused()]
        out.append(
            Wanted(f"obs-{i}", column * shape[1] - 0.5, row * shape[0] - 0.5, right, down, rate)
        )
    if out:
        notes.converted.append(
            f"{len(out)} lines on the focal plane: targets on straight paths that cross the same "
            "pixels, with the same electrons a second"
        )
    return out


def _rate(o: Fields, zero: float, i: int, notes: Notes) -> float:
    """Electrons a second of one object: its model's, else by `mv`, else by `pe`, as SatSim does."""
    mode, mag, rate_e_s = (o.get(key) for key in ("model.mode", "mv", "pe"))
    if mode in (None, "sprite") and mag is not None:
        return 10.0 ** (-0.4 * (o.number("mv", -60, 60) - zero))
    if mode in (None, "sprite") and rate_e_s is not None:
        return o.number("pe", 0, 1e15)
    if mode != "lambertian_sphere":
        raise BadInput(f"geometry.obs.list.{i}.model.mode", mode, "mv, pe or lambertian_sphere")
    mag = sphere_mag(
        o.number("model.diameter", 1e-6, 1e9),
        o.number("model.albedo", 0, 1),
        math.radians(o.number("model.phase_angle", 0, 180)),
        o.number("model.distance", 1e-3, 1e12),
    )
    notes.converted.append(f"obs-{i}: a sphere of V = {mag:.4f} (the Sun {SUN_MAG})")
    return 10.0 ** (-0.4 * (mag - zero))


def sphere_mag(diameter_m: float, albedo: float, phase_rad: float, range_km: float) -> float:
    """Magnitude of a diffuse sphere in sunlight, by SatSim's magnitude of the Sun."""
    of_sunlight_m2 = float(sphere_intensity_per_irradiance(phase_rad, diameter_m, albedo))
    return SUN_MAG - 2.5 * math.log10(max(of_sunlight_m2 / (1e3 * range_km) ** 2, 1e-60))
