"""The distortion of the optics: SIP, TPV or radial terms, or a file that holds a distorted WCS."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field
from pydantic_core import PydanticCustomError

from pipeline.spec.strict import FilePath, Strict

HIGHEST_ORDER = 9
HIGHEST_TPV = 39

Coefficient = Annotated[float, Field(ge=-1e30, le=1e30)]
Place = Annotated[float, Field(ge=-1e6, le=1e6)]
CdElement = Annotated[float, Field(ge=-10, le=10)]
Row = tuple[CdElement, CdElement]


def _sip_terms(data: object) -> object:
    """Keys as 2_0, also from A_2_0 and B_2_0; a bare 2_0 is the number 20 in YAML."""
    if not isinstance(data, dict):
        return data
    out = {}
    for key, value in data.items():
        found = re.fullmatch(r"(?:[AB]_)?(\d)_(\d)", key) if isinstance(key, str) else None
        name = f"{found[1]}_{found[2]}" if found else None
        if found is None or int(found[1]) + int(found[2]) > HIGHEST_ORDER or name in out:
            raise _not_a_term(
                key,
                "allowed: each power once, as '2_0' in quotes or A_2_0, of order 0 to "
                f"{HIGHEST_ORDER} in all",
            )
        out[name] = _number(key, value)
    return out


def _tpv_terms(data: object) -> object:
    """Keys as whole numbers, also from text and from PV1_4."""
    if not isinstance(data, dict):
        return data
    out = {}
    for key, value in data.items():
        found = re.fullmatch(r"(?:PV[12]_)?(\d{1,2})", str(key))
        number = int(found[1]) if found else -1
        if isinstance(key, bool) or not 0 <= number <= HIGHEST_TPV or number in out:
            raise _not_a_term(key, f"allowed: each term once, 0 to {HIGHEST_TPV}")
        out[number] = _number(key, value)
    return out


def _number(key: object, value: object) -> object:
    if isinstance(value, bool):
        raise _not_a_term(key, "allowed: a number, not true or false")
    return value


def _not_a_term(key: object, allowed: str) -> PydanticCustomError:
    return PydanticCustomError("term", "{key}: {allowed}", {"key": str(key), "allowed": allowed})


SipTerms = Annotated[dict[str, Coefficient], BeforeValidator(_sip_terms)]
TpvTerms = Annotated[dict[int, Coefficient], BeforeValidator(_tpv_terms)]


class Placed(Strict):
    """What all polynomials have. The boresight keeps its pixel: what they say there is taken off.

    Beyond the frame and a margin the displacement stays that of the margin's edge.
    """

    reference_px: tuple[Place, Place] | None = Field(
        None,
        description="[x, y] of the pixel that offsets count from; pixel [0, 0] is the centre of "
        "the first; default: the middle of the frame",
    )


class SipDistortion(Placed):
    """FITS SIP: from pixel offsets (u, v) to undistorted ones, u + sum A_p_q u^p v^q [px]."""

    kind: Literal["sip"]
    a: SipTerms = Field(default_factory=dict, description="such as {'2_0': 1e-6, A_1_1: 2e-7}")
    b: SipTerms = Field(default_factory=dict)


class TpvDistortion(Placed):
    """FITS TPV: polynomials of degree 7 with odd powers of r, in degrees on the tangent plane."""

    kind: Literal["tpv"]
    pv1: TpvTerms = Field(default_factory=dict, description="terms 0 to 39; term 1 is 1 if absent")
    pv2: TpvTerms = Field(default_factory=dict)
    cd_deg: tuple[Row, Row] | None = Field(
        None,
        description="matrix from pixel offsets to (xi, eta); default: the sensor's own at roll 0, "
        "where xi points to -x and eta to +y",
    )


class RadialDistortion(Placed):
    """Brown-Conrady, from the direction to the pixel, in tangents of the angles from the axis."""

    kind: Literal["radial"]
    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    k3: Coefficient = 0.0
    p1: Coefficient = 0.0
    p2: Coefficient = 0.0


class FileDistortion(Strict):
    """A FITS file, or a FITS header as text, with a SIP or TPV WCS; its pointing is not used."""

    kind: Literal["file"]
    path: FilePath


Distortion = Annotated[
    SipDistortion | TpvDistortion | RadialDistortion | FileDistortion, Field(discriminator="kind")
]
