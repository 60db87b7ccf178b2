"""FITS headers: provenance, times, site, sensor, and the two WCS of a frame."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import TYPE_CHECKING

import erfa
import numpy as np

from pipeline.export.times import exposure_of, fits_dates
from pipeline.physics.positions.apparent_wcs import LARGEST_RESIDUAL_PX, apparent_wcs_header
from pipeline.physics.positions.focal_plane import WcsFit, wcs_header
from pipeline.plan.pointing.geometry import camera_of
from pipeline.plan.sensor.detector import linearity
from pipeline.plan.timing import dwell_of, dwell_plans
from pipeline.spec.load import parse_scene, parse_yaml
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.sensor import Sensor

if TYPE_CHECKING:
    import xarray as xr

Cards = list[tuple[str, object, str]]

IAU_1976 = (6_378_140.0, 0.0033528131778969)  # radius [m], flattening: the ellipsoid of OBSGEO-B


def fits_header(cube: xr.Dataset, frame: int, layer: str) -> Cards:
    """FITS cards of a frame.

    Times follow FITS 4.0 section 9: DATE-OBS and DATE-BEG are the start, DATE-AVG the middle and
    DATE-END the end of the exposure, in UTC. The primary WCS is astrometric ICRS at the middle
    (where the catalogue's stars are drawn); the alternate `A` gives apparent directions: TAN about
    the boresight, written as TPV where the header has SIP terms or the camera a distortion.
    """
    one = cube.isel(frame=frame)
    scene = scene_of(cube)
    cards = [
        ("OBJECT", str(cube.attrs["title"])[:68], "scene"),
        ("CREATOR", str(cube.attrs["source"]), "software"),
        ("BUNIT", "adu" if layer == "dn" else "electron", cube[layer].attrs["long_name"]),
        ("FRAME", frame, "frame number, from 0"),
        ("SEED", int(cube.attrs["seed"]), "of all randomness"),
        ("SYNTHSTR", bool(cube.attrs["synthetic_stars"]), "stars are synthetic, none is real"),
    ]
    if cube.attrs.get("catalogue"):
        name = re.sub(r"[^ -~]", "?", str(cube.attrs["catalogue"]))  # a header holds ASCII alone
        cards.append(("CATALOG", name[:68], "star catalogue"))
        digest = str(cube.attrs["catalogue_digest"])
        cards.append(("CATDIG", digest[:16], "first digits of the catalogue's digest"))
    return [
        *cards,
        *_times(cube, frame, scene),
        *_site(scene),
        *_sensor(scene, layer, frame),
        *_astrometric_cards(one),
        *_apparent_cards(scene, one),
    ]


def scene_of(cube: xr.Dataset) -> Scene:
    """The scene that a product was made from, as the cube itself carries it."""
    return _parsed(str(cube.attrs["scene"]))


@lru_cache(maxsize=4)
def _parsed(text: str) -> Scene:
    return parse_scene(parse_yaml(text))


def _times(cube: xr.Dataset, frame: int, scene: Scene) -> Cards:
    times = exposure_of(cube, frame)
    iso, mjd = fits_dates(times, scene, frame), times.mjd()
    return [
        ("TIMESYS", "UTC", "time scale"),
        ("TIMEUNIT", "s", "of EXPTIME, XPOSURE and TELAPSE"),
        ("DATE-OBS", iso["start"], "start of the exposure"),
        ("DATE-BEG", iso["start"], "start of the exposure"),
        ("DATE-AVG", iso["middle"], "middle of the exposure (WCS, truth)"),
        ("DATE-END", iso["end"], "end of the exposure"),
        ("MJD-OBS", mjd["start"], "[d] start of the exposure, UTC"),
        ("MJD-BEG", mjd["start"], "[d] start of the exposure, UTC"),
        ("MJD-AVG", mjd["middle"], "[d] middle of the exposure, UTC"),
        ("MJD-END", mjd["end"], "[d] end of the exposure, UTC"),
        ("EXPTIME", times.seconds, "[s] integration time"),
        ("XPOSURE", times.seconds, "[s] integration time"),
        ("TELAPSE", times.seconds, "[s] from start to end"),
    ]


def _site(scene: Scene) -> Cards:
    """Where a ground observer stands (WGS 84), geodetic and geocentric."""
    o = scene.observer
    if o.kind != "ground":
        return [("OBSKIND", o.kind, "observer: its orbit or place is in the scene")]
    place = erfa.gd2gc(1, np.radians(o.longitude_deg), np.radians(o.latitude_deg), o.height_m)
    longitude, latitude, height = erfa.gc2gde(*IAU_1976, place)
    return [
        ("OBSKIND", o.kind, "observer"),
        ("SITELAT", o.latitude_deg, "[deg] geodetic latitude, WGS 84"),
        ("SITELONG", o.longitude_deg, "[deg] longitude, east positive"),
        ("SITEELEV", o.height_m, "[m] above the ellipsoid"),
        *(
            (f"OBSGEO-{axis}", round(float(v), 4), "[m] geocentric, ITRS")
            for axis, v in zip("XYZ", place, strict=True)
        ),
        ("OBSGEO-L", float(np.degrees(longitude)), "[deg] on FITS' ellipsoid, IAU 1976"),
        ("OBSGEO-B", float(np.degrees(latitude)), "[deg] on FITS' ellipsoid, IAU 1976"),
        ("OBSGEO-H", float(height), "[m] on FITS' ellipsoid, IAU 1976"),
    ]


def _sensor(scene: Scene, layer: str, frame: int) -> Cards:
    """What a photometry program asks for; terms that are not the same everywhere say so."""
    s, dwells = scene.sensor, dwell_plans(scene)
    dwell = dwells[int(dwell_of(dwells, np.array([frame]))[0])]
    pixel_arcsec = float(np.degrees(s.ifov_rad)) * 3600.0
    band = getattr(s.bandpass, "name", None) or s.bandpass.kind
    if s.bandpass.kind == "box":
        band = f"{s.bandpass.short_nm:g}-{s.bandpass.long_nm:g} nm"
    cards: Cards = [
        ("FILTER", str(band)[-68:], "bandpass"),
        ("APTDIA", 1e3 * s.aperture_m, "[mm] diameter of the entrance pupil"),
        ("FOCALLEN", 1e3 * s.focal_length_m, "[mm]"),
        ("XPIXSZ", s.pixel_pitch_um, "[um]"),
        ("YPIXSZ", s.pixel_pitch_um, "[um]"),
        ("SECPIX", pixel_arcsec, "[arcsec] a pixel at the boresight"),
        ("TRKMODE", dwell.pointing.mode, "what the sensor follows"),
    ]
    outputs, raw = _outputs(s), layer == "dn"
    cards += _terms(outputs, raw)
    level_dn = _saturation_dn(s, outputs) if raw else None
    if level_dn is not None:
        cards.append(("SATURATE", level_dn, "[adu] lowest level at which a pixel saturates"))
    return cards


def _terms(outputs: list[dict[str, float | str]], raw: bool) -> Cards:
    """What all outputs of the sensor have in common, for `dn` (raw) or a layer in electrons."""
    cards: Cards = []
    for key, name, unit, of_raw in (
        ("GAIN", "gain_e_per_dn", "[e-/adu]", True),
        ("RDNOISE", "read_noise_e", "[e-] rms", False),
        ("BIASLVL", "bias_dn", "[adu]", True),
        ("DARKCUR", "dark_e_per_s", "[e-/s] a pixel", False),
    ):
        if raw or not of_raw:
            values = {one[name] for one in outputs}
            cards.append((key, values.pop() if len(values) == 1 else "amplifiers", unit))
    if not raw:  # GAIN is of the header's own data: photometry takes its photon noise from it
        cards.append(("GAIN", 1.0, "[e-] a unit of this layer"))
    return cards


def _outputs(s: Sensor) -> list[dict[str, float | str]]:
    """Terms of each output of the sensor, amplifiers and the rest; `image` for those that are."""
    names = ("gain_e_per_dn", "read_noise_e", "bias_dn", "dark_e_per_s")
    given = {name: getattr(s, name) for name in names}
    rest = {k: "image" if isinstance(v, str) else v for k, v in given.items()}
    out, pixels = [], s.shape[0] * s.shape[1]
    for a in s.detector.amplifiers if s.detector else ():
        own = {"gain_e_per_dn": a.gain_e_per_dn, "read_noise_e": a.read_noise_e}
        if not isinstance(s.bias_dn, str):
            own["bias_dn"] = s.bias_dn + a.offset_dn
        out.append(rest | {k: v for k, v in own.items() if v is not None})
        pixels -= (a.rows[1] - a.rows[0]) * (a.columns[1] - a.columns[0])
    return [rest, *out] if pixels else out


def _saturation_dn(s: Sensor, outputs: list[dict[str, float | str]]) -> int | None:
    """The lowest level at which a pixel saturates, but for a bias pattern; None with images."""
    levels_dn = [2**s.adc_bits - 1]
    if s.full_well_e is None:
        return levels_dn[0]
    well_e = s.full_well_e
    if s.detector is not None and s.detector.nonlinearity is not None:
        well_e = float(np.interp(well_e, *linearity(s.detector, well_e)))
    for one in outputs:
        gain, bias = one["gain_e_per_dn"], one["bias_dn"]
        if isinstance(gain, str) or isinstance(bias, str):
            return None
        levels_dn.append(int(well_e / gain + bias))
    return min(levels_dn)


def _astrometric_cards(one: xr.Dataset) -> Cards:
    """Cards of the primary WCS of one frame: TAN, or TAN-SIP."""
    order = int(one["wcs_sip_order"])
    size = order + 1
    fit = WcsFit(
        one["wcs_crval_deg"].values,
        one["wcs_crpix_px"].values,
        one["wcs_cd_deg"].values,
        order,
        one["wcs_sip_a"].values[:size, :size],
        one["wcs_sip_b"].values[:size, :size],
        float(one["wcs_residual_px"]),
    )
    return [(key, value, "") for key, value in wcs_header(fit).items()]


def _apparent_cards(scene: Scene, one: xr.Dataset) -> Cards:
    """Cards of the alternate WCS `A`, or a comment that says why there is none."""
    has_sip = int(one["wcs_sip_order"]) > 0
    header = apparent_wcs_header(camera_of(scene), one["attitude"].values, has_sip)
    if header is None:
        reason = f"No WCS A: TPV terms leave over {LARGEST_RESIDUAL_PX:g} px of the distortion."
        return [("COMMENT", reason, "")]
    return [(f"{key}A", value, "") for key, value in header.items()]
