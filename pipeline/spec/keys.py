"""What each key of the format means where its model does not say: for schema, page and reference.

A key of its own model (`Slew.duration_s`) comes before one of any model (`duration_s`).
"""

from __future__ import annotations

import re

from catalog_tools.documents import JsonObject

TOLD = {
    "schema": "which format this file has", "name": "letters, digits and . _ -",
    "seed": "of all random numbers: the same seed, the same bits",
    "accuracy": "how much error all approximations together may make",
    "observer": "who sees: a site, a satellite, or a fixed place",
    "sensor": "telescope and focal plane", "pointing": "where the camera looks",
    "Dwell.pointing": "of this dwell; default: the scene's",
    "exposure": "times of the frames", "stars": "absent: no star is drawn",
    "targets": "objects, each by orbit and body", "populations": "files of many objects' elements",
    "background": "light of the sky; absent: none",
    "cosmic_rays": "generated or recorded; absent: none", "output": "what is kept, and how",
    "kind": "which of the alternatives this is", "mode": "which of the ways of pointing this is",
    "path": "of the file", "frame": "axes of the file's places", "source": "where it is from",
    # optics and detector
    "noll": "number of the Zernike term: 4 is defocus", "rms_nm": "size of the term [nm]",
    "rms_waves": "size of the term [waves]", "vanes": "that hold the secondary mirror",
    "aberrations": "Zernike terms of the wavefront", "Vanes.count": "how many vanes",
    "width_m": "of each vane", "short_nm": "shortest wavelength", "long_nm": "longest wavelength",
    "NamedBand.name": "of the filter", "sigma_px": "standard deviation on each axis",
    "fwhm_px": "full width at half maximum", "fwhm_arcsec": "full width at half maximum",
    "diffraction": "of the aperture, beside the seeing",
    "columns_px": "columns of the grid of places, ascending",
    "samples_per_px": "of the image, along each side of a pixel",
    "shape": "rows and columns of the focal plane", "pixel_pitch_um": "from pixel to pixel",
    "focal_length_m": "with the pixel pitch it gives the field",
    "aperture_m": "diameter of the entrance pupil",
    "fill_factor": "share of a pixel's area that takes light",
    "bandpass": "filter: a box, a named one, or a table",
    "transmission": "of the optics: a number, or a CSV table over wavelength",
    "quantum_efficiency": "electrons a photon: a number, or a CSV table over wavelength",
    "psf": "how a point of light is spread", "distortion": "of the optics; absent: none",
    "full_well_e": "charge that a pixel holds at most; absent: no limit",
    "gain_e_per_dn": "electrons a digital number: a number or an image",
    "adc_bits": "of the converter", "adc_rounding": "how the converter rounds",
    "bias_dn": "digital number of no charge: a number or an image",
    "flat": "response of each pixel to light: a number or an image",
    "dark_e_per_s": "dark current: a number or an image",
    "read_noise_e": "rms of each reading: a number or an image",
    "photon_noise": "false: light and dark come without their own noise",
    "BadPixels.rows": "whole rows", "BadPixels.columns": "whole columns",
    "DeadPixels.rows": "whole rows", "DeadPixels.columns": "whole columns",
    "bad": "pixels that read a fixed number", "dead": "pixels that take no light",
    "hot": "pixels with more dark current",
    "nonlinearity": "what is measured of a charge", "bias_structure": "pattern of the bias",
    "amplifiers": "parts of the focal plane with outputs of their own",
    "lag": "charge that stays for the next frame", "readout": "charge that moves under the light",
    "towards": "where the store is", "RollingShutter.first": "where the exposure begins",
    "true_e": "charge, ascending from 0", "read_e": "what is measured of it",
    "k1": "radial, r^2", "k2": "radial, r^4", "k3": "radial, r^6", "p1": "tangential",
    "p2": "tangential", "SipDistortion.b": "coefficients B_p_q, as `a` for v",
    "pv2": "coefficients PV2_m, as `pv1` for the other axis",
    # pointing and its motion
    "boresight_ra_deg": "ICRS right ascension of the boresight",
    "boresight_dec_deg": "ICRS declination of the boresight",
    "rate_dec_arcsec_s": "towards the north",
    "roll_deg": "position angle of +y, north through east",
    "acceleration_ra_arcsec_s2": "towards the east, on the sky",
    "acceleration_dec_arcsec_s2": "towards the north",
    "azimuth_deg": "of the direction held", "elevation_deg": "of the direction held",
    "target": "name of the target that is followed", "interpolation": "between the rows",
    "drift": "a steady turn of the camera", "jitter": "random motion, by its spectra",
    "modes": "random motion, by linear systems", "axis": "about which it turns, or along",
    "time_constant_s": "tau: the correlation falls to 1/e in it",
    "rms_arcsec": "of the angle", "rms_arcsec_s": "of the rate",
    "frequency_hz": "of the undamped motion", "TableJitter.frequency_hz": "ascending",
    "arcsec2_per_hz": "one-sided power at each frequency",
    "PowerLawJitter.exponent": "how steeply the power falls", "low_hz": "where the band begins",
    "high_hz": "where the band ends", "SystemMode.a": "matrix A [1/s]",
    "SystemMode.b": "matrix B: the noise that drives each state",
    "SystemMode.c": "matrix C: x, y and roll of the states",
    "amplitude_arcsec": "of the oscillation", "damping": "share of the critical damping, zeta",
    "duration_s": "of the turn", "wait_s": "after the slew, before the first exposure",
    "slew": "the turn from the dwell before; absent: none", "settle": "oscillation after the slew",
    "frames": "how many exposures", "Dwell.frames": "how many; default: the scene's",
    # observers, orbits
    "latitude_deg": "geodetic, north positive", "height_m": "above the ellipsoid",
    "position_au": "from the barycentre", "velocity_m_s": "at the epoch",
    "FixedObserver.velocity_m_s": "relative to the barycentre", "position_m": "at the epoch",
    "orbit": "how it moves", "epoch": "UTC to which the rest belongs; default: the scene's",
    "semi_major_axis_m": "negative for a hyperbola", "perigee_radius_m": "from the Earth's centre",
    "eccentricity": "0 is a circle", "inclination_deg": "to the axes' equator",
    "raan_deg": "right ascension of the ascending node",
    "argument_of_perigee_deg": "from the ascending node", "true_anomaly_deg": "at the epoch",
    "mean_anomaly_deg": "at the epoch", "time_of_perigee": "UTC, instead of an anomaly",
    "mean_motion_rev_day": "revolutions a day", "elements": "the message's, in place of a file",
    "line1": "first line, 69 characters", "line2": "second line, 69 characters",
    "shadow": "of the Earth, for radiation pressure", "third_bodies": "whose pull is added",
    "relative_tolerance": "of the integration",
    # bodies
    "Target.name": "a name of its own", "body": "what it looks like",
    "Population.name": "of the file; its targets' names begin with it",
    "rules": "sizes by words in the objects' names", "sizes": "table of sizes and albedos",
    "screened": "what the program found in the file", "name_contains": "the words looked for",
    "SizeRule.diameter_m": "of the sphere", "dwell_s": "time of the scene that was looked through",
    "attitude": "how it stands in space", "size_m": "along x, y and z",
    "parts": "the shapes that it is made of",
    "diameter_m": "of the round part", "length_m": "along z", "closed": "false: ends are open",
    "edge_m": "length of an edge", "base_diameter_m": "at -z", "top_diameter_m": "at +z",
    "area_m2": "of one side", "two_sided": "false: the back is black",
    "surface": "how it reflects", "materials": "surfaces by the names in the file",
    "MeshPart.name": "by which other parts name it", "joint": "that turns it; absent: rigid",
    "pivot_m": "a place on the axis", "rate_deg_s": "right-handed", "phase_deg": "at the epoch",
    "range_m": "of the magnitudes", "sun_mag": "of the Sun in the magnitudes' band",
    "LightCurveBody.phase_deg": "at which the values hold", "mag_per_deg": "of the linear law",
    "face": "direction that is turned to the Sun", "times_s": "after the epoch, ascending",
    "quaternions": "one for each time", "albedo": "share of the light that is sent back",
    "diffuse": "albedo of the matt base", "specular": "share that the gloss sends back",
    "exponent": "larger is sharper", "normal_reflectance": "at normal incidence",
    # sky
    "stray_light": "of Sun, Moon and Earth; absent: none",
    "pst": "the curve: share of a lamp's light off axis", "sun": "the Sun's", "moon": "the Moon's",
    "ozone_dobson": "column of ozone", "aerosol_slope": "fall with wavelength",
    "pressure_hpa": "at the site", "temperature_c": "at the site",
    "b0_per_sr": "b0, at small angles", "mirrors": "N, how many",
    "space_motion": "to the epoch", "parallax": "annual, or of the orbit",
    "aberration": "of the observer's velocity", "deflection": "of light by the Sun",
    "layers": "of the cube; `dn` is the raw frame", "compression": "of the cube's chunks",
    # sweeps
    "axes": "what is changed, and how", "design": "how the axes are combined",
    "metrics": "what is measured of each point", "detection": "of the built-in matched filter",
    "threshold_sigma": "least statistic of a detection",
    "search_px": "how far from its place it is looked for", "field": "dotted key of the scene",
    "fields": "dotted keys of the scene", "values": "taken in turn",
    "TableAxis.rows": "a value for each field, taken in turn", "points": "how many of the design",
    "QuasiRandom.seed": "of the design", "start": "first value", "stop": "last value",
}  # fmt: skip


def describe(schema: JsonObject, model: type) -> None:
    """Add a description to each property of a model's JSON Schema that has none."""
    said = _in_docstring(model.__doc__ or "")
    for key, field in schema.get("properties", {}).items():
        text = said.get(key) or TOLD.get(f"{model.__name__}.{key}") or TOLD.get(key)
        if text and "description" not in field:
            field["description"] = text


def _in_docstring(text: str) -> dict[str, str]:
    """What a docstring says of keys: `key : text` and `one, other : text`, up to the next key."""
    parts = re.split(r"(?:^|(?<=\W))\s*((?:[a-z]\w*, )*[a-z]\w*) : ", " ".join(text.split()))
    told = zip(parts[1::2], parts[2::2], strict=True)
    return {
        key: re.sub(r";? or $", "", what).rstrip(" ;.")
        for names, what in told
        for key in names.split(", ")
    }
