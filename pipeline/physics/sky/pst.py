"""Point-source transmittance: how much of a lamp's light off axis reaches the focal plane.

PST(angle) is the irradiance on the focal plane over the irradiance that a distant point source
makes on the entrance pupil, held perpendicular to its rays; the angle is that between the source
and the line of sight of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Inside = Literal["refuse", "extrapolate", "clip"]

SIDE_RAD = 0.5 * np.pi  # light from farther off axis cannot enter the pupil


@dataclass(frozen=True, eq=False)
class PstTable:
    """A curve through (angle, PST) pairs, straight between them in ln(angle), ln(PST).

    angle_rad : (n,) ascending, above 0; pst : (n,) above 0
    exclusion_rad : nearer to a source the curve is clipped there (`clip`), or goes on with the
        slope of its first two rows (else)
    beyond : past its last row it is `zero`, keeps its last value (`clip`), or is not known
        (`refuse`): the caller asks `end_rad` first
    """

    angle_rad: Array
    pst: Array
    exclusion_rad: float
    inside: Inside
    beyond: Literal["refuse", "zero", "clip"]

    def value(self, angle_rad: Array) -> Array:
        """PST (...) at angles (...) [rad]."""
        angle = np.asarray(angle_rad, float)
        least = self.exclusion_rad if self.inside == "clip" else 1e-12
        x = np.log(np.maximum(angle, least))
        nodes, values = np.log(self.angle_rad), np.log(self.pst)
        slope = (values[1] - values[0]) / (nodes[1] - nodes[0])
        ln = np.interp(x, nodes, values) + slope * np.minimum(x - nodes[0], 0.0)
        found = np.exp(ln)
        return np.where(angle > self.end_rad, 0.0, found)

    @property
    def end_rad(self) -> float:
        """Largest angle that it is told for."""
        return float(np.pi) if self.beyond == "clip" else float(self.angle_rad[-1])

    @property
    def breaks_rad(self) -> Array:
        """Angles (k,) where its slope jumps; of a long table some of them."""
        step = max(1, len(self.angle_rad) // 48)
        return np.append(self.angle_rad[::step], [self.exclusion_rad, self.end_rad])


@dataclass(frozen=True)
class PstHarvey:
    """Scatter by mirrors that a source lights directly, each with a Harvey BSDF.

    PST = N pi / (4 F^2) cos(angle) b0 [1 + (sin(angle) / l)^2]^(s/2) up to 90 degrees, else 0: each
    of N mirrors sends b0 [...] (Harvey 1976; Harvey, Choi, Krywonos & Marcen 2009, Proc. SPIE 7426)
    of the light on it per sr towards the focal plane, which sees the pupil under pi / (4 F^2) sr
    (Fest 2013, Stray Light Analysis and Control, chapters 5 and 6). All mirrors are taken to be as
    large as the pupil and lit as it is; baffles, ghosts, edges and second bounces are omitted.

    b0_per_sr : BSDF at the specular direction; shoulder : l, in sines; slope : s, below 0
    f_number : focal length over aperture; mirrors : N
    """

    b0_per_sr: float
    shoulder: float
    slope: float
    mirrors: int
    f_number: float
    exclusion_rad: float
    inside: Inside

    def value(self, angle_rad: Array) -> Array:
        """PST (...) at angles (...) [rad]."""
        least = self.exclusion_rad if self.inside == "clip" else 0.0
        angle = np.maximum(np.asarray(angle_rad, float), least)
        sine, cosine = np.sin(angle), np.cos(angle)
        bsdf = self.b0_per_sr * (1.0 + (sine / self.shoulder) ** 2) ** (0.5 * self.slope)
        solid = 0.25 * np.pi / self.f_number**2
        return np.where(angle < SIDE_RAD, self.mirrors * solid * np.maximum(cosine, 0.0) * bsdf, 0)

    @property
    def end_rad(self) -> float:
        """Largest angle that it is told for."""
        return float(np.pi)

    @property
    def breaks_rad(self) -> Array:
        """Angles (k,) where its slope jumps."""
        return np.array([max(self.exclusion_rad, 1e-12), SIDE_RAD])


Pst = PstTable | PstHarvey
