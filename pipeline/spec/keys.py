"""What each key of the format means where its model does not say: for schema, page and reference.

A key of its own model (`Slew.duration_s`) comes before one of any model (`duration_s`).
"""

from __future__ import annotations

import re

from catalog_tools.documents import JsonObject

DESCRIPTIONS = {
    "schema": "format and version of this file", "name": "name: letters, digits and . _ -",
    "seed": "seed of all random numbers: the same seed gives the same bits",
    "accuracy": "how much error all approximations together may make",
    "observer": "where the sensor is: a site, a satellite or a fixed place",
    "sensor": "telescope, detector and electronics", "pointing": "where the camera points",
    "Dwell.pointing": "where the camera points in this dwell; default: as the scene's pointing",
    "exposure": "exposure time, number and cadence of the frames",
    "stars": "star catalogue and effects on star places; absent: no star is drawn",
    "targets": "objects, each with an orbit and a body",
    "populations": "files of the elements of many objects",
    "background": "light of the sky; absent: a dark sky",
    "cosmic_rays": "cosmic rays, generated or recorded; absent: none",
    "output": "layers, tiles and compression of the product",
    "kind": "name of the alternative", "mode": "pointing mode", "path": "path of the file",
    "frame": "axes of the places in the file", "source": "where the values come from",
    # optics and detector
    "noll": "Noll's number of the Zernike term; 4 is defocus",
    "rms_nm": "coefficient of the term, with its sign: rms over the pupil [nm]",
    "rms_waves": "coefficient of the term, with its sign: rms over the pupil [waves]",
    "vanes": "vanes that hold the secondary mirror",
    "aberrations": "Zernike terms of the wavefront error", "Vanes.count": "number of vanes",
    "width_m": "width of each vane [m]", "short_nm": "shortest wavelength [nm]",
    "long_nm": "longest wavelength [nm]", "NamedBand.name": "name of the filter",
    "sigma_px": "standard deviation on each axis [px]",
    "fwhm_px": "full width at half maximum [px]",
    "fwhm_arcsec": "full width at half maximum [arcsec]",
    "diffraction": "whether the aperture's diffraction is added to the seeing",
    "columns_px": "columns of the grid of places, ascending [px]",
    "samples_per_px": "samples of the image along each side of a pixel",
    "shape": "rows and columns of the focal plane", "pixel_pitch_um": "pixel pitch [um]",
    "focal_length_m": "focal length [m]; with the pixel pitch it gives the field of view",
    "aperture_m": "diameter of the entrance pupil [m]",
    "fill_factor": "fraction of a pixel's area that is sensitive to light",
    "bandpass": "filter: a box, a named filter or a table",
    "transmission": "transmission of the optics: a number, or a CSV table over wavelength",
    "quantum_efficiency": "electrons per photon: a number, or a CSV table over wavelength",
    "psf": "point spread function", "distortion": "distortion of the optics; absent: none",
    "full_well_e": "full well: the most charge that a pixel holds [e-]; absent: no limit",
    "gain_e_per_dn": "electrons per digital number: a number or an image",
    "adc_bits": "bits of the converter", "adc_rounding": "how the converter rounds",
    "bias_dn": "digital number of a pixel without charge: a number or an image",
    "flat": "relative response of each pixel to light: a number or an image",
    "dark_e_per_s": "dark current [e-/s]: a number or an image",
    "read_noise_e": "read noise, rms [e-]: a number or an image",
    "photon_noise": "false: light and dark current have no Poisson noise",
    "BadPixels.rows": "whole rows that fail", "BadPixels.columns": "whole columns that fail",
    "DeadPixels.rows": "whole rows that fail", "DeadPixels.columns": "whole columns that fail",
    "bad": "pixels that read a fixed number", "dead": "pixels that are blind to light",
    "hot": "pixels with a larger dark current",
    "nonlinearity": "charge that is measured for a charge collected",
    "bias_structure": "fixed pattern of the bias",
    "amplifiers": "parts of the focal plane with output amplifiers of their own",
    "lag": "charge that stays behind for the next frame",
    "readout": "rolling shutter, frame transfer, or time delay and integration",
    "towards": "side on which the store is", "RollingShutter.first": "row that is exposed first",
    "true_e": "charge collected [e-], ascending from 0", "read_e": "charge measured for it [e-]",
    "k1": "radial coefficient of r^2", "k2": "radial coefficient of r^4",
    "k3": "radial coefficient of r^6", "p1": "first tangential coefficient",
    "p2": "second tangential coefficient",
    "SipDistortion.b": "coefficients B_p_q of the second axis, written as `a`",
    "pv2": "coefficients PV2_m of the second axis, written as `pv1`",
    # pointing and its motion
    "boresight_ra_deg": "ICRS right ascension of the boresight [deg]",
    "boresight_dec_deg": "ICRS declination of the boresight [deg]",
    "rate_dec_arcsec_s": "rate towards the north [arcsec/s]",
    "roll_deg": "position angle of +y, from north through east [deg]",
    "acceleration_ra_arcsec_s2": "acceleration towards the east, on the sky [arcsec/s^2]",
    "acceleration_dec_arcsec_s2": "acceleration towards the north [arcsec/s^2]",
    "azimuth_deg": "azimuth [deg]: at a site from north through east, on an orbit from the "
    "direction of flight to the right",
    "elevation_deg": "elevation above the horizon, or an orbit's local horizontal [deg]",
    "target": "name of the target that is followed",
    "interpolation": "how attitudes between the rows are found",
    "axis": "axis of the motion or rotation",
    "time_constant_s": "time in which the correlation falls to 1/e [s]",
    "rms_arcsec": "rms of the angle [arcsec]", "rms_arcsec_s": "rms of the rate [arcsec/s]",
    "frequency_hz": "frequency of the undamped motion [Hz]",
    "TableJitter.frequency_hz": "frequencies, ascending [Hz]",
    "arcsec2_per_hz": "one-sided power spectral density at each frequency [arcsec^2/Hz]",
    "PowerLawJitter.exponent": "exponent by which the power falls with frequency",
    "low_hz": "lowest frequency of the band [Hz]", "high_hz": "highest frequency of the band [Hz]",
    "SpinAttitude.axis": "axis of the spin, in the body's axes",
    "SystemMode.a": "system matrix A [1/s]",
    "SystemMode.b": "matrix B, by which noise drives each state",
    "SystemMode.c": "output matrix C: x, y and roll from the states",
    "amplitude_arcsec": "amplitude of the oscillation [arcsec]",
    "damping": "damping ratio zeta; 1 is critical",
    "duration_s": "duration of the slew [s]",
    "wait_s": "time after the slew, before the first exposure [s]",
    "slew": "slew from the dwell before; absent: none", "settle": "oscillation after the slew",
    "frames": "number of exposures",
    "Dwell.frames": "number of exposures; default: the scene's exposure.frames",
    # observers, orbits
    "latitude_deg": "geodetic latitude, north positive [deg]",
    "height_m": "height above the WGS 84 ellipsoid [m]",
    "position_au": "barycentric position, ICRS axes [au]",
    "position_m": "geocentric position at the epoch, GCRS axes [m]",
    "velocity_m_s": "geocentric velocity at the epoch, GCRS axes [m/s]",
    "FixedObserver.velocity_m_s": "barycentric velocity, ICRS axes [m/s]",
    "orbit": "orbit: elements, a state, an ephemeris or a table",
    "epoch": "UTC that the values hold for; default: the scene's epoch",
    "LightCurveBody.epoch": "zero of times_s, UTC; default: the scene's epoch",
    "TableAttitude.epoch": "zero of times_s, UTC; default: the scene's epoch",
    "MeanElements.epoch": "epoch of the elements, UTC",
    "TableOrbit.epoch": "zero of the times, UTC",
    "semi_major_axis_m": "semi-major axis [m]; negative for a hyperbola",
    "perigee_radius_m": "distance of the perigee from the Earth's centre [m]",
    "eccentricity": "eccentricity; 0 is a circle",
    "inclination_deg": "inclination to the equator of the frame [deg]",
    "raan_deg": "right ascension of the ascending node [deg]",
    "argument_of_perigee_deg": "argument of the perigee, from the ascending node [deg]",
    "true_anomaly_deg": "true anomaly at the epoch [deg]",
    "mean_anomaly_deg": "mean anomaly at the epoch [deg]",
    "time_of_perigee": "time of the perigee, UTC; instead of an anomaly",
    "mean_motion_rev_day": "mean motion [revolutions per day]",
    "KeplerianOrbit.frame": "axes that the elements refer to",
    "elements": "mean elements of the message, in place of a file",
    "line1": "first line, 69 characters", "line2": "second line, 69 characters",
    "shadow": "model of the Earth's shadow for radiation pressure",
    "third_bodies": "bodies beside the Earth whose gravity is added",
    "relative_tolerance": "relative tolerance of the integration",
    # bodies
    "Target.name": "unique name of the target", "body": "shape and surface",
    "Population.name": "name of the population; its targets' names begin with it",
    "rules": "sizes by words in the objects' names", "sizes": "CSV table of sizes and albedos",
    "screened": "what was found in the file when it was read (written by the program)",
    "name_contains": "text that the object's name contains, whatever its case",
    "PriorityRule.name_contains": "text that the object's name contains, whatever its case; "
    "without this and numbers the rule is for all objects",
    "SizeRule.diameter_m": "diameter of the sphere [m]",
    "attitude": "attitude law: how the body is oriented in space",
    "size_m": "edges along x, y and z [m]", "parts": "shapes that the body is made of",
    "MeshBody.parts": "meshes that move relative to the body",
    "diameter_m": "diameter [m]", "length_m": "length along z [m]",
    "ConeBody.closed": "whether the base at -z has a lid",
    "FrustumBody.closed": "ends with a lid: base at -z, top at +z",
    "edge_m": "edge [m]", "base_diameter_m": "diameter at -z [m]",
    "top_diameter_m": "diameter at +z [m]", "area_m2": "area of one side [m^2]",
    "two_sided": "whether both sides reflect; false: the back is black",
    "MeshPart.name": "name by which other parts refer to this one",
    "joint": "joint about which the part turns; absent: rigid",
    "pivot_m": "a point on the axis [m]", "rate_deg_s": "rate, right-handed [deg/s]",
    "Slewing.rate_deg_s": "slew rate [deg/s]", "phase_deg": "angle at the epoch [deg]",
    "range_m": "range that the magnitudes hold for [m]",
    "sun_mag": "magnitude of the Sun in the magnitudes' band",
    "LightCurveBody.phase_deg": "phase angle that the values hold for [deg]",
    "mag_per_deg": "slope of the linear phase law [mag/deg]",
    "face": "direction that is turned towards the Sun",
    "times_s": "times after the epoch, ascending [s]", "quaternions": "one quaternion per time",
    "albedo": "fraction of the light that is reflected", "diffuse": "albedo of the matt base",
    "specular": "fraction of the light that the gloss reflects",
    "exponent": "exponent of the gloss; larger is sharper",
    # sky
    "stray_light": "stray light of Sun, Moon and Earth; absent: none",
    "pst": "point-source transmittance: irradiance at the focal plane over that at the aperture",
    "sun": "whether the Sun's light is drawn", "moon": "whether the Moon's light is drawn",
    "ozone_dobson": "column of ozone [Dobson units]",
    "pressure_hpa": "pressure at the site [hPa]", "temperature_c": "temperature at the site [C]",
    "b0_per_sr": "b0, scatter at small angles [1/sr]", "mirrors": "number of mirrors, N",
    "space_motion": "whether stars move to the epoch",
    "parallax": "whether stars have parallax",
    "aberration": "whether places have the aberration of the observer's velocity",
    "deflection": "whether the Sun deflects light",
    "layers": "layers of the cube; `dn` is the raw frame",
    "compression": "codec of the cube's chunks",
    # sweeps
    "axes": "fields that are varied, and their values", "design": "how the axes are combined",
    "metrics": "what is measured at each point", "detection": "matched filter of the detection",
    "threshold_sigma": "least signal-to-noise ratio of a detection",
    "search_px": "radius about the true place within which a detection counts [px]",
    "field": "dotted key of the scene, or of the study",
    "fields": "dotted keys of the scene, or of the study",
    "values": "values, taken in turn", "TableAxis.rows": "rows of a value for each field",
    "points": "number of points of the design", "QuasiRandom.seed": "seed of the design",
    "start": "first value", "stop": "last value",
    # studies
    "duration_h": "length of the period [h]",
    "cameras": "cameras that the sensors have", "sensors": "sensors at sites or on orbits",
    "catalogue": "objects that are looked for",
    "tasking": "cued (sensors are sent to objects) or serendipitous (patterns of fields)",
    "CuedTasking.revisit_h": "time after which an object is wanted again [h]",
    "PriorityRule.revisit_h": "time after which the rule's objects are wanted again [h]; default: "
    "the tasking's revisit_h",
    "numbers": "catalogue numbers of the objects",
    "lowest_elevation_deg": "lowest elevation at a site, as refracted [deg]",
    "highest_elevation_deg": "highest elevation at a site, as refracted [deg]",
    "FieldOfRegard.sun_exclusion_deg": "least angle from the Sun [deg]",
    "moon_exclusion_deg": "least angle from the Moon [deg]",
    "earth_exclusion_deg": "of a satellite: least angle from the Earth's limb [deg]",
    "galactic_exclusion_deg": "least galactic latitude [deg]",
    "twilight_deg": "highest elevation of the Sun at a site [deg]",
    "clear_fraction": "fraction of the hours in which the sky of a site is clear",
    "weather_h": "length of clear and of cloudy spells, drawn by the seed [h]",
    "synthetic": "made-up objects", "objects": "number of objects",
    "Synthetic.seed": "seed of the made-up objects",
    "StudySensor.observer": "where the sensor is: a site or a satellite",
    "smallest_m": "smallest diameter [m]", "largest_m": "largest diameter [m]",
    "pattern": "fence, belt or strip",
    "SearchPattern.azimuth_deg": "azimuth of a fence, from north through east [deg]",
    "from_deg": "first elevation of a fence, longitude of a belt, or right ascension of a strip "
    "from the point opposite the Sun [deg]",
    "to_deg": "last elevation, longitude or right ascension, likewise [deg]",
    "declination_deg": "declination of a strip [deg]",
    "settle_s": "time to settle after a slew [s]",
    "tracking": "what the camera follows in an exposure: the target or the stars",
    "StudySensor.count": "number of equal sensors at this place",
    "field_of_regard": "where and when the sensor may look",
    "slewing": "time from one dwell to the next",
}  # fmt: skip


KEY = re.compile(r"(?:^|(?<=\W))((?:[a-z]\w*, )*[a-z]\w*) : ")  # `key : ` and `one, other : `


def describe(schema: JsonObject, model: type) -> None:
    """Add a description to each property of a model's JSON Schema that has none: what the docstring
    of the model says, or of one that it extends; else DESCRIPTIONS."""
    said: dict[str, str] = {}
    for one in reversed(model.__mro__):
        if one.__module__.startswith("pipeline."):
            said |= in_docstring(one.__doc__ or "")[1]
    for key, field in schema.get("properties", {}).items():
        text = said.get(key)
        text = text or DESCRIPTIONS.get(f"{model.__name__}.{key}") or DESCRIPTIONS.get(key)
        if text and "description" not in field:
            field["description"] = text


def in_docstring(text: str) -> tuple[list[str], dict[str, str]]:
    """Paragraphs of a docstring, and what it says of keys: `key : text` and `one, other : text`, up
    to the next key or the end of the paragraph."""
    prose: list[str] = []
    said: dict[str, str] = {}
    for paragraph in re.split(r"\n\s*\n", text):
        first, *rest = KEY.split(" ".join(paragraph.split()))
        if first.strip():
            prose.append(first.strip())
        for names, about in zip(rest[::2], rest[1::2], strict=True):
            cut = re.sub(r";? or$", "", about.strip()).rstrip(" ;.")
            said |= dict.fromkeys(names.split(", "), cut)
    return prose, said
