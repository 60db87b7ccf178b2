"""The distortion of a FITS header: SIP or TPV terms, taken from the WCS of a file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.lazily import fits, open_fits
from pipeline.spec.load import parse_scene
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.distortion import HIGHEST_ORDER, FileDistortion

if TYPE_CHECKING:
    from astropy.io.fits import Header

FIELD = "sensor.distortion.path"
LARGEST_TEXT = 1 << 20


def gather_distortion(scene: Scene) -> Scene:
    """The scene with the distortion that it names as a file written out in its terms.

    So the product knows the terms themselves: nothing later depends on the file. Any other scene
    comes back as it is. BadInput where the file holds no SIP or TPV distortion.
    """
    request = scene.sensor.distortion
    if not isinstance(request, FileDistortion):
        return scene
    data = scene.as_dict()
    data["sensor"]["distortion"] = read_distortion(Path(request.path))
    return parse_scene(data)


def read_distortion(path: Path) -> JsonObject:
    """Plain data of `sensor.distortion` (kind sip or tpv) from the first distorted WCS of a file.

    Kept are the terms, the reference pixel and, for TPV, the CD matrix; TAN with PV2 terms is taken
    for TPV, as SCAMP writes it. Lookup tables beside them are refused.
    """
    if not path.is_file():
        raise BadInput(FIELD, str(path), "an existing FITS file, or a FITS header as text")
    try:
        for header in _headers(path):
            found = _terms(header, path)
            if found is not None:
                return found
    except (TypeError, ValueError, KeyError, fits().VerifyError) as error:
        raise BadInput(FIELD, str(path), f"a WCS with numbers in its cards; {error}") from None
    raise BadInput(FIELD, str(path), "a file with a SIP (A_ORDER, B_ORDER) or TPV distortion")


def _terms(header: Header, path: Path) -> JsonObject | None:
    """The distortion of one header; None where it has none."""
    is_tpv = _is_tpv(header)
    if not is_tpv and not {"A_ORDER", "B_ORDER"}.intersection(header):
        return None
    if any(k.startswith(("CPDIS", "CQDIS")) for k in header):
        raise BadInput(FIELD, str(path), "a WCS without lookup tables (CPDIS, CQDIS)")
    reference = [float(header.get(name, 0.0)) - 1.0 for name in ("CRPIX1", "CRPIX2")]
    return _tpv(header, reference) if is_tpv else _sip(header, path, reference)


def _is_tpv(header: Header) -> bool:
    ctype = str(header.get("CTYPE1", ""))
    scamp = ctype.endswith("-TAN") and any(f"PV2_{k}" in header for k in range(1, 40))
    return ctype.endswith("-TPV") or scamp


def _headers(path: Path) -> list[Header]:
    """Headers of a FITS file, or the one that a text file spells out."""
    with path.open("rb") as file:
        start = file.read(30)
    try:
        whole = start.startswith(b"SIMPLE  =") and path.stat().st_size % 2880 == 0
        if whole or path.suffix == ".gz":
            with open_fits(path) as hdus:
                return [hdu.header for hdu in hdus]
        if path.stat().st_size > LARGEST_TEXT:
            raise BadInput(
                FIELD, str(path), f"a FITS file, or text of at most {LARGEST_TEXT} bytes"
            )
        text = path.read_text("latin-1")
        separator = "\n" if "\n" in text else ""
        return [fits().Header.fromstring(text, sep=separator)]
    except (OSError, ValueError, fits().VerifyError) as error:
        raise BadInput(FIELD, str(path), f"a readable FITS file or header; {error}") from None


def _sip(header: Header, path: Path, reference: list[float]) -> JsonObject:
    orders = [int(header.get(f"{name}_ORDER", 0)) for name in "AB"]
    if max(orders) > HIGHEST_ORDER:
        raise BadInput(FIELD, str(path), f"SIP terms up to order {HIGHEST_ORDER}")
    a, b = (
        {
            f"{p}_{q}": float(header[f"{name}_{p}_{q}"])
            for p in range(order + 1)
            for q in range(order + 1 - p)
            if f"{name}_{p}_{q}" in header
        }
        for name, order in zip("AB", orders, strict=True)
    )
    return {"kind": "sip", "a": a, "b": b, "reference_px": reference}


def _tpv(header: Header, reference: list[float]) -> JsonObject:
    pv1, pv2 = (
        {k: float(header[f"PV{i}_{k}"]) for k in range(40) if f"PV{i}_{k}" in header}
        for i in (1, 2)
    )
    return {
        "kind": "tpv",
        "pv1": pv1,
        "pv2": pv2,
        "cd_deg": _cd_deg(header),
        "reference_px": reference,
    }


def _cd_deg(header: Header) -> list[list[float]]:
    """The CD matrix, or what CDELT makes of PC or, without it, of the older CROTA2 [deg]."""
    cd, pc = _matrix(header, "CD", 0.0), _matrix(header, "PC", 1.0)
    if cd is not None:
        return cd
    x, y = (float(header.get(f"CDELT{i}", 1.0)) for i in (1, 2))
    if pc is not None:
        return [[x * value for value in pc[0]], [y * value for value in pc[1]]]
    turn = math.radians(float(header.get("CROTA2", 0.0)))
    c, s = math.cos(turn), math.sin(turn)
    return [[x * c, -y * s], [x * s, y * c]]


def _matrix(header: Header, name: str, diagonal: float) -> list[list[float]] | None:
    """The 2 x 2 matrix of the cards of a name, as CD1_1; None where there is no such card."""
    cards = [[f"{name}{i}_{j}" for j in (1, 2)] for i in (1, 2)]
    if not any(card in header for row in cards for card in row):
        return None
    plain = ((diagonal, 0.0), (0.0, diagonal))
    return [[float(header.get(cards[i][j], plain[i][j])) for j in (0, 1)] for i in (0, 1)]
