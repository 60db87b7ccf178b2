"""Orbits: two-line elements through SGP4, and two-body motion of any eccentricity."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.errors import BadInput
from pipeline.physics.constants import (
    DAY_S,
    EARTH_EQUATORIAL_RADIUS_M,
    EARTH_FLATTENING,
    EARTH_GM_M3_S2,
)
from pipeline.physics.positions.earth import teme_to_gcrs
from pipeline.physics.positions.times import Instants, elapsed_s, format_utc

if TYPE_CHECKING:
    from sgp4.api import Satrec

Array = NDArray[np.float64]

_NUMBER = r"(?=.*\d)[ \d.+-]+"
# name, first and last column (1-based), what may stand there
_COLUMNS = {
    1: (
        ("satellite number", 3, 7, r" *[0-9A-Z]?\d+"),
        ("epoch", 19, 32, r"[ \d]\d[ \d]{2}\d\.\d+ *"),
        ("first derivative of the mean motion", 34, 43, _NUMBER),
        ("second derivative of the mean motion", 45, 52, _NUMBER),
        ("drag term", 54, 61, _NUMBER),
    ),
    2: (
        ("satellite number", 3, 7, r" *[0-9A-Z]?\d+"),
        ("inclination", 9, 16, r" *\d+\.\d+ *"),
        ("node", 18, 25, r" *\d+\.\d+ *"),
        ("eccentricity", 27, 33, r" *\d+ *"),
        ("argument of perigee", 35, 42, r" *\d+\.\d+ *"),
        ("mean anomaly", 44, 51, r" *\d+\.\d+ *"),
        ("mean motion", 53, 63, r" *\d+\.\d+ *"),
    ),
}


def tle_states(
    line1: str, line2: str, instants: Instants, field: str = "orbit"
) -> tuple[Array, Array]:
    """GCRS positions [m] and velocities [m/s] (n, 3) of a two-line element set.

    SGP4/SDP4 with WGS 72 (Vallado et al. 2006, AIAA 2006-6753), then `teme_to_gcrs`. The time since
    the elements' epoch is counted in SI seconds, so that a leap second in between does not move the
    satellite. Elements are good to about 1 km at their epoch and some km a day later.

    Raises BadInput for malformed lines and where SGP4 ends (decayed, eccentricity out of range...).
    """
    from sgp4.api import SGP4_ERRORS  # only scenes with two-line elements need it

    check_tle(line1, line2, field)
    satellite = _satellite(line1.rstrip(), line2.rstrip(), field)
    epoch = (satellite.jdsatepoch, satellite.jdsatepochF)
    days = elapsed_s(epoch, instants.utc1, instants.utc2) / DAY_S
    errors, position_km, velocity_km_s = satellite.sgp4_array(
        np.full_like(days, epoch[0]), epoch[1] + days
    )
    bad = (errors != 0) | ~np.all(np.isfinite(position_km), axis=-1)
    if np.any(bad):
        i = int(np.argmax(bad))
        meaning = SGP4_ERRORS.get(int(errors[i]), "the result is not finite")
        when = format_utc(instants.utc1[i], instants.utc2[i])
        raise BadInput(
            field,
            line1.rstrip(),
            f"elements that SGP4 can carry to {when}, {days[i]:.2f} days after their epoch "
            f"(SGP4 code {int(errors[i])}: {meaning})",
        )
    matrices = teme_to_gcrs(instants)
    # TEME turns against GCRS by precession alone (7.7e-12 rad/s): nothing is added to velocities
    return (
        np.einsum("nij,nj->ni", matrices, position_km) * 1e3,
        np.einsum("nij,nj->ni", matrices, velocity_km_s) * 1e3,
    )


def tle_states_teme(
    line1: str, line2: str, jd: ArrayLike, fr: ArrayLike
) -> tuple[Array, Array, NDArray[np.uint8]]:
    """TEME positions [km], velocities [km/s] (n, 3) and SGP4 codes (n,) at UTC days jd + fr.

    No check of the lines: for verification sets, which hold deliberately odd elements.
    """
    from sgp4.api import WGS72, Satrec  # only scenes with two-line elements need it

    satellite = Satrec.twoline2rv(line1, line2, WGS72)
    days, fraction = np.broadcast_arrays(np.atleast_1d(jd), np.atleast_1d(fr))
    errors, position_km, velocity_km_s = satellite.sgp4_array(
        np.ascontiguousarray(days, float), np.ascontiguousarray(fraction, float)
    )
    return position_km, velocity_km_s, errors


def _satellite(line1: str, line2: str, field: str) -> Satrec:
    from sgp4.api import WGS72, Satrec

    try:
        return Satrec.twoline2rv(line1, line2, WGS72)
    except ValueError as error:
        raise BadInput(field, line1, f"two-line elements that can be read ({error})") from error


def check_tle(line1: str, line2: str, field: str = "orbit") -> None:
    """BadInput, naming the line and what was expected, unless both lines are well formed."""
    for number, line in ((1, line1), (2, line2)):
        _check_line(number, line, f"{field}.line{number}")
    if line1[2:7] != line2[2:7]:
        raise BadInput(
            f"{field}.line2", line2[2:7], f"the satellite number of line 1, {line1[2:7]!r}"
        )


def _check_line(number: int, line: str, field: str) -> None:
    text = line.rstrip() if isinstance(line, str) else ""
    if not text.isascii():
        at = next(i for i, c in enumerate(text) if not c.isascii())
        raise BadInput(field, text[at], f"ASCII characters only; see column {at + 1}")
    if text[:2] != f"{number} ":
        raise BadInput(field, line, f"line {number} of two-line elements, starting '{number} '")
    if len(text) != 69:
        raise BadInput(field, line, f"69 characters (this has {len(text)})")
    expected = sum(int(c) if c.isdigit() else c == "-" for c in text[:68]) % 10
    if text[68] != str(expected):
        raise BadInput(field, text[68], f"checksum {expected} in column 69")
    for name, first, last, pattern in _COLUMNS[number]:
        part = text[first - 1 : last]
        if not re.fullmatch(pattern, part):
            raise BadInput(field, part, f"the {name} in columns {first} to {last}")


def check_above_earth(position_m: Array, field: str) -> None:
    """BadInput if any position (..., 3) lies inside the Earth's polar radius (6357 km)."""
    polar_radius_m = EARTH_EQUATORIAL_RADIUS_M * (1.0 - EARTH_FLATTENING)
    radius = np.sqrt(np.sum(np.square(np.atleast_2d(position_m)), axis=-1))
    lowest = float(np.min(radius))
    if not lowest >= polar_radius_m:
        raise BadInput(
            field,
            f"{lowest / 1e3:.1f} km from the Earth's centre",
            f"a position above the Earth's surface (over {polar_radius_m / 1e3:.1f} km)",
        )


def two_body(
    position_m: Array,
    velocity_m_s: Array,
    dt_s: ArrayLike,
    gm_m3_s2: float = EARTH_GM_M3_S2,
) -> tuple[Array, Array]:
    """Two-body motion from one state (3,), (3,) by times dt (n,): positions, velocities (n, 3).

    Universal variable and Stumpff functions (Battin 1999, section 4.5; Goodyear 1965): one form for
    ellipse, parabola and hyperbola. Kepler's equation rises monotonically in the variable (its
    slope is the radius), so Newton's method inside a bracket cannot fail. Ellipses are reduced by
    whole periods first. Perturbations are left out.
    """
    r0, v0 = np.asarray(position_m, float), np.asarray(velocity_m_s, float)
    length = float(np.sqrt(r0 @ r0))
    second = float(np.sqrt(length**3 / gm_m3_s2))
    # lengths in |r0|, times in sqrt(|r0|^3/GM): GM = |r0| = 1
    r0, v0 = r0 / length, v0 * (second / length)
    time = np.atleast_1d(np.asarray(dt_s, float)) / second
    radial = float(r0 @ v0)
    alpha = 2.0 - float(v0 @ v0)  # 1/a
    if alpha > 0.0:
        period = 2.0 * np.pi / alpha**1.5
        if np.isfinite(period):
            time = time - period * np.round(time / period)
    s = _universal_anomaly(time, radial, alpha)
    u0, u1, u2, _ = _universal_functions(s, alpha)
    radius = u0 + radial * u1 + u2
    f, g = 1.0 - u2, u1 + radial * u2  # g = t - u3, in the form without a difference
    f_dot, g_dot = -u1 / radius, 1.0 - u2 / radius
    position = f[:, None] * r0 + g[:, None] * v0
    velocity = f_dot[:, None] * r0 + g_dot[:, None] * v0
    return position * length, velocity * (length / second)


def _universal_anomaly(time: Array, radial: float, alpha: float) -> Array:
    """Root s of U1 + radial U2 + U3 = time (units GM = |r0| = 1), by bracketed Newton: (n,)."""
    edge = _outer_edge(time, radial, alpha)
    low, high = np.where(time < 0, -edge, 0.0), np.where(time < 0, 0.0, edge)
    s = np.clip(time, low, high)
    for _ in range(200):
        u0, u1, u2, u3 = _universal_functions(s, alpha)
        excess = u1 + radial * u2 + u3 - time
        low, high = np.where(excess < 0, s, low), np.where(excess > 0, s, high)
        slope = np.maximum(u0 + radial * u1 + u2, 1e-300)
        newton = s - excess / slope
        inside = (newton > low) & (newton < high)
        following = np.where(excess == 0, s, np.where(inside, newton, 0.5 * (low + high)))
        moved = np.abs(following - s)
        s = following
        if np.all(moved <= 4e-16 * np.abs(s)):
            break
    return s


def _outer_edge(time: Array, radial: float, alpha: float) -> Array:
    """|s| on the far side of the root for every time (n,), by growth; one turn at the most."""
    turn = 2.0 * np.pi / np.sqrt(alpha) if alpha > 0.0 else np.inf
    edge = np.full_like(time, min(1e-3, turn))
    sign = np.where(time < 0, -1.0, 1.0)
    for _ in range(1000):
        _, u1, u2, u3 = _universal_functions(sign * edge, alpha)
        short = (np.abs(u1 + radial * u2 + u3) <= np.abs(time)) & (edge < turn)
        if not np.any(short):
            break
        edge = np.where(short, np.minimum(1.5 * edge, turn), edge)
    return edge


def _universal_functions(s: Array, alpha: float) -> tuple[Array, Array, Array, Array]:
    """Battin's U0 to U3 of s for the reciprocal semi-major axis alpha: each (n,).

    U_k = s^k c_k(alpha s^2). Trigonometric or hyperbolic in half arguments away from zero, power
    series within |alpha s^2| < 1, so that no digits are lost near the parabola.
    """
    psi = alpha * s * s
    root = np.sqrt(np.abs(psi))
    c2, c3 = np.empty_like(s), np.empty_like(s)
    near = np.abs(psi) < 1.0
    c2[near], c3[near] = _series(psi[near], 2), _series(psi[near], 3)
    bound, free = ~near & (psi > 0), ~near & (psi < 0)
    x = root[bound]
    c2[bound], c3[bound] = 2.0 * np.sin(x / 2) ** 2 / x**2, (x - np.sin(x)) / x**3
    x = root[free]
    c2[free], c3[free] = 2.0 * np.sinh(x / 2) ** 2 / x**2, (np.sinh(x) - x) / x**3
    return 1.0 - psi * c2, s * (1.0 - psi * c3), s * s * c2, s * s * s * c3


def _series(psi: Array, k: int) -> Array:
    """Stumpff's c_k(psi) = sum (-psi)^j / (k + 2j)! for |psi| < 1."""
    term = np.full_like(psi, 0.5 if k == 2 else 1.0 / 6.0)
    total = term.copy()
    for j in range(1, 10):
        term = term * (-psi) / ((k + 2 * j - 1) * (k + 2 * j))
        total += term
    return total
