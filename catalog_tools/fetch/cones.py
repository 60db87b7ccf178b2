"""Cones on the sky as a user asks for them: RA,DEC,RADIUS[,G]."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import BadInput

FORM = "RA,DEC,RADIUS[,G] in degrees and mag, such as 56.75,24.1,1.0,16"


@dataclass(frozen=True)
class FetchCone:
    """A cone about an ICRS place at the release's epoch, down to a G magnitude (None: to any).

    Raises BadInput naming the part that is out of range.
    """

    ra_deg: float
    dec_deg: float
    radius_deg: float
    faintest_g_mag: float | None = None

    def __post_init__(self) -> None:
        g_mag = self.faintest_g_mag
        checks = (
            ("ra_deg", self.ra_deg, -360.0 <= self.ra_deg <= 360.0, "-360 to 360 degrees"),
            ("dec_deg", self.dec_deg, -90.0 <= self.dec_deg <= 90.0, "-90 to 90 degrees"),
            (
                "radius_deg",
                self.radius_deg,
                0.0 < self.radius_deg <= 180.0,
                "above 0, up to 180 degrees",
            ),
            ("faintest_g_mag", g_mag, g_mag is None or math.isfinite(g_mag), "a magnitude"),
        )
        for field, value, fine, allowed in checks:
            if not fine:
                raise BadInput(f"cone {field}", value, allowed)
            if value is not None:
                object.__setattr__(self, field, float(value))  # not NumPy's: it is written out

    def __str__(self) -> str:
        """As `parse_cone` reads it."""
        given = (self.ra_deg, self.dec_deg, self.radius_deg, self.faintest_g_mag)
        return ",".join(f"{number:g}" for number in given if number is not None)


def parse_cone(text: str) -> FetchCone:
    """The cone that `RA,DEC,RADIUS[,G]` means; BadInput for anything else."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, 4):
        raise BadInput("cone", text, FORM)
    return FetchCone(*numbers)
