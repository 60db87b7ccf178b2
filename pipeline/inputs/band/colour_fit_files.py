"""Colour fits in files: written by `nightglass color-fit -o`, named by `stars.colour_fit`."""

from __future__ import annotations

import hashlib
import json
import math
import sys
from dataclasses import replace
from pathlib import Path

from catalog_tools.documents import JsonObject, JsonValue
from catalog_tools.storage.durable import write_atomically
from pipeline.errors import BadInput, check_new
from pipeline.inputs.band.colour_fit import fit_of, gather_colour_fit, plain_fit
from pipeline.physics.colour import ColourFit
from pipeline.physics.radiometry import ResponseCurve
from pipeline.spec.scene import Scene

FORMAT = "nightglass/colour-fit-file/2"
FIELD = "stars.colour_fit"
LARGEST_BYTES = 1 << 20
MOST_COEFFICIENTS = 16
WIDEST_MAG = (-5.0, 15.0)  # of BP-RP: bluer than any star, redder than any
LARGEST_MAG = 30.0  # of the correction anywhere in the fit's range


def colour_fit_of(scene: Scene, response: ResponseCurve, band: str, digest: str) -> ColourFit:
    """The colour fit of a scene: of the file that it names, else fitted to the stellar library."""
    named = None if scene.stars is None else scene.stars.colour_fit
    if named is None:
        return gather_colour_fit(response, band, digest)
    return read_colour_fit(Path(named), band, digest)


def write_colour_fit(path: Path, fit: ColourFit, digest: str) -> None:
    """Write a fit with the digest of the response that it belongs to; no file is replaced."""
    check_new(path)
    if path.suffix != ".json":
        raise BadInput("-o", str(path), "a path ending in .json")
    content = plain_fit(fit)
    stored = {"format": FORMAT, "response": digest, "sha256": _checksum(content), "fit": content}
    try:
        write_atomically(path, json.dumps(stored, indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise BadInput("-o", str(path), f"a path to write; {error.strerror}") from None


def read_colour_fit(path: Path, band: str, digest: str) -> ColourFit:
    """The fit of a file, with the file's SHA-256, checked against the scene's band and response.

    `response` may be null in a file edited by hand: then the band's name alone is compared.
    `sha256` may be null, too; else it must be that of the fit.
    """
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_BYTES + 1)
    except OSError as error:
        allowed = f"a file written by `nightglass color-fit SCENE -o FILE`; {error.strerror}"
        raise BadInput(FIELD, str(path), allowed) from None
    stored = _stored(path, content)
    fit = _checked(path, stored["fit"])
    if fit.band_name != band:
        raise BadInput(FIELD, f"{path}: band {fit.band_name}", f"a fit of the scene's band {band}")
    of = stored.get("response")
    if of is not None and of != digest:
        raise BadInput(
            FIELD,
            f"{path}: response {str(of)[:12]}",
            f"a fit of this sensor's response {digest[:12]} (bandpass, transmission, "
            "quantum_efficiency)",
        )
    own = hashlib.sha256(content).hexdigest()
    return replace(fit, source=f"{path.name}: {fit.source}", digest=own)


def _stored(path: Path, content: bytes) -> JsonObject:
    """What a file holds, if it is one of ours and has not been changed unawares."""
    try:
        stored = json.loads(content) if len(content) <= LARGEST_BYTES else None
    except (ValueError, RecursionError):
        stored = None
    if not isinstance(stored, dict) or stored.get("format") != FORMAT:
        raise BadInput(FIELD, str(path), f"a JSON file of format {FORMAT}")
    if not isinstance(stored.get("fit"), dict):
        raise BadInput(FIELD, f"{path}: fit", "the mapping that color-fit writes")
    told = stored.get("sha256")
    if told is not None and told != _checksum(stored["fit"]):
        allowed = "as color-fit wrote it; sha256: null after a change by hand"
        raise BadInput(FIELD, f"{path}: sha256", allowed)
    return stored


def _checksum(content: JsonObject) -> str:
    """SHA-256 of a fit's plain data."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _checked(path: Path, content: JsonObject) -> ColourFit:
    """The fit of a file's mapping. BadInput names what is missing or out of range in it."""

    def refuse(name: str, allowed: str) -> BadInput:
        return BadInput(FIELD, f"{path}: fit.{name} = {content.get(name)!r}", allowed)

    numbers = {
        "residual_rms_mag": (0.0, LARGEST_MAG),
        "residual_max_mag": (0.0, LARGEST_MAG),
        "redder_error_mag": (0.0, LARGEST_MAG),
        "default_colour": WIDEST_MAG,
        "default_colour_scatter": (0.0, LARGEST_MAG),
        "default_error_mag": (0.0, LARGEST_MAG),
        "zero_electrons_s_m2": (1e-30, 1e30),
        "spectra_count": (0, 10**9),
    }
    for name, (low, high) in numbers.items():
        if not _is_number(content.get(name), low, high):
            raise refuse(name, f"a number from {low:g} to {high:g}")
    for name in ("band_name", "source"):
        if not isinstance(content.get(name), str):
            raise refuse(name, "text")
    ends: JsonValue = content.get("colour_range")
    low, high = WIDEST_MAG
    if not _numbers(ends, 2, 2) or not low <= ends[0] < ends[1] <= high:
        raise refuse("colour_range", f"two increasing numbers from {low:g} to {high:g}")
    terms: JsonValue = content.get("coefficients")
    if not _numbers(terms, 1, MOST_COEFFICIENTS):
        raise refuse("coefficients", f"1 to {MOST_COEFFICIENTS} numbers")
    largest = max(map(abs, ends))
    if sum(abs(c) * largest**k for k, c in enumerate(terms)) > 1e3 * LARGEST_MAG:
        raise refuse("coefficients", f"corrections of at most {LARGEST_MAG:g} mag in colour_range")
    return fit_of(content)


def _numbers(values: JsonValue, least: int, most: int) -> bool:
    right = isinstance(values, list) and least <= len(values) <= most
    return right and all(_is_number(v) for v in values)


def _is_number(value: JsonValue, low: float = -math.inf, high: float = math.inf) -> bool:
    right = isinstance(value, int | float) and not isinstance(value, bool)
    return right and abs(value) <= sys.float_info.max and low <= value <= high
