"""Effects on stars in the plan: on directions and light; the turn of a site with the Earth."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pipeline.physics.constants import (
    ARCSEC_RAD,
    BOLTZMANN_J_K,
    PLANCK_J_S,
    SPEED_OF_LIGHT_M_S,
)
from pipeline.physics.positions.focal_plane import corner_radius
from pipeline.plan.decision import Decision
from pipeline.plan.pointing.geometry import camera_of
from pipeline.plan.rule import PlanBasis, Rule
from pipeline.spec.pointing.observer import FixedObserver, GroundObserver
from pipeline.spec.scene import Scene

FASTEST_ARCSEC_YR, NEAREST_ARCSEC = 10.4, 0.77  # Barnard's star, Proxima
LIMB_ARCSEC = 1.75  # deflection at the Sun's limb, seen from 1 au
USUAL_M_S = 38e3  # the Earth's speed and a low satellite's
FARTHEST_AU = 1.02  # of the Earth and what orbits it
COOLEST_K = 2500.0
POLE_ARCSEC = 0.65  # farthest of the pole in the series since 1962 (IERS EOP C04): 0.62
POLE_DRIFT_ARCSEC = 0.08  # in two weeks, or of predictions of a year (IERS Bulletin A)
EARTH_RADIUS_M = 6.378e6


def _directions(basis: PlanBasis) -> Iterator[Decision]:
    """What becomes of the directions of stars."""
    scene = basis.scene
    if scene.stars is None:
        return
    for name, (size, bound, unit) in _sizes(scene).items():
        kept = getattr(scene.stars, name)
        reason = "applied to each star" if kept else f"switched off in the scene: {size}"
        yield Decision(f"stars.{name}", kept, reason, bound=bound, unit=unit)


def _doppler(basis: PlanBasis) -> Iterator[Decision]:
    """What the observer's motion does to the light of stars."""
    if basis.scene.stars is None:
        return
    speed = _speed_m_s(basis.scene)
    share = doppler_share(speed, basis.facts.mean_wavelength_m)
    yield Decision(
        "stars.doppler",
        False,
        "the observer's motion changes directions but neither brightness nor colour: about "
        f"{3.0 * speed / SPEED_OF_LIGHT_M_S:.1g} of a star's light at {speed:.3g} m/s, up "
        f"to {share:.2g} of that of a black body of {COOLEST_K:g} K",
        bound=share,
        unit="of a star's light",
    )


def _earths_turn(basis: PlanBasis) -> Iterator[Decision]:
    """How a site turns with the Earth."""
    observer = basis.scene.observer
    if not isinstance(observer, GroundObserver):
        return
    yield Decision(
        "precession_nutation",
        True,
        "IAU 2006/2000A turns the site into the stars' frame; the stars of an image whose "
        "boresight is given in ICRS do not move by it",
    )
    yield _polar_motion(observer.polar_motion_arcsec)


def _polar_motion(pole_arcsec: tuple[float, float] | None) -> Decision:
    """Where the pole is taken to be, and what that leaves out of a site's place."""
    off = POLE_ARCSEC if pole_arcsec is None else POLE_DRIFT_ARCSEC
    moved_m = off * ARCSEC_RAD * EARTH_RADIUS_M
    near = f"a satellite at 1000 km by {moved_m / 1e6 / ARCSEC_RAD:.1g} arcsec"
    if pole_arcsec is None:
        return Decision(
            "polar_motion",
            False,
            "no table of the Earth's rotation covers the epoch: the pole is taken at the origin, "
            f"up to {off:g} arcsec off ({moved_m:.0f} m of the site's place): it moves no star, "
            f"and {near}",
            bound=moved_m,
            unit="m",
        )
    x, y = pole_arcsec
    return Decision(
        "polar_motion",
        True,
        f"the pole at x = {x:.4f}, y = {y:.4f} arcsec, that of the epoch, in all frames: it moves "
        f"by up to 6 mas a day, so that in two weeks, or where it is a prediction of a year, it is "
        f"up to {off:g} arcsec off: {moved_m:.2g} m of the site's place, {near}",
        bound=moved_m,
        unit="m",
    )


def doppler_share(speed_m_s: float, mean_m: float) -> float:
    """By how much of a star's light its electrons change with the observer's speed, at most.

    Photons per wavelength change by D^2 F(D l) / F(l), D the Doppler factor: D^(2 + a) where F goes
    as l^a; of a black body a = x / (1 - e^-x) - 4, x = h c / (k T l) (Rybicki & Lightman 1979,
    4.9), largest for the coolest stars at the blue end: COOLEST_K, a fifth below the mean.
    """
    beta = min(speed_m_s / SPEED_OF_LIGHT_M_S, 1.0 - 1e-12)
    factor = math.sqrt((1.0 + beta) / (1.0 - beta))
    x = PLANCK_J_S * SPEED_OF_LIGHT_M_S / (BOLTZMANN_J_K * COOLEST_K * 0.8 * mean_m)
    return math.expm1(max(x / -math.expm1(-x) - 2.0, 1.0) * math.log(factor))


def _speed_m_s(scene: Scene) -> float:
    if isinstance(scene.observer, FixedObserver):
        return math.hypot(*scene.observer.velocity_m_s)
    return USUAL_M_S


def _sizes(scene: Scene) -> dict[str, tuple[str, float, str]]:
    """Of each effect: how large it is in words, at most, and in which unit.

    Aberration as it is seen in the field: angles grow at most by the Doppler factor, a tenth more
    for the tangent plane; what it does to all of the field alike goes with the boresight.
    """
    o = scene.observer
    far = math.hypot(*o.position_au) if isinstance(o, FixedObserver) else FARTHEST_AU
    beta = min(_speed_m_s(scene) / SPEED_OF_LIGHT_M_S, 1.0 - 1e-12)
    grows = 1.1 * (math.sqrt((1.0 + beta) / (1.0 - beta)) - 1.0)
    field = corner_radius(camera_of(scene)) / ARCSEC_RAD
    return {
        "space_motion": (
            "up to 10.4 arcsec a year (Barnard's star)",
            FASTEST_ARCSEC_YR,
            "arcsec a year",
        ),
        "parallax": (
            "up to 0.77 arcsec (Proxima) for an observer near 1 au",
            NEAREST_ARCSEC * far,
            "arcsec",
        ),
        "aberration": (
            "common 20.5 arcsec stay with the boresight; differences in the field go",
            grows * field,
            "arcsec",
        ),
        "deflection": (
            "4 mas at 90 deg from the Sun, 1.75 arcsec at its limb",
            LIMB_ARCSEC / max(min(far, 1.0), 1e-3),
            "arcsec",
        ),
    }


RULES = (
    Rule(
        ("stars.space_motion", "stars.parallax", "stars.aberration", "stars.deflection"),
        "switched in the scene; on by default",
        "tests/physics/positions/test_apparent.py",
        _directions,
    ),
    Rule(
        ("stars.doppler",),
        "never: brightness and colour are those of an observer at rest",
        "tests/physics/positions/test_apparent.py",
        _doppler,
    ),
    Rule(
        ("precession_nutation", "polar_motion"),
        "IAU 2006/2000A always; the pole of the epoch where the IERS tables cover it, else the "
        "origin (10 m)",
        "tests/inputs/test_earth_orientation.py::test_a_scenes_site_against_astropy",
        _earths_turn,
    ),
)
