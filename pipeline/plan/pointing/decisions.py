"""What the plan says of pointing and dwells: tables and their error, slews, several exposures."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pipeline.physics.constants import ARCSEC_RAD
from pipeline.plan.decision import Decision
from pipeline.plan.pointing.air import needs_air, terms_of
from pipeline.plan.pointing.attitude_motion import SHARPEST_PX, motion_plan
from pipeline.plan.pointing.geometry import bend_px
from pipeline.plan.rule import PlanBasis, Rule
from pipeline.plan.timing import dwell_plans, frame_count, integration_range_s
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.pointing.pointing import LocalPointing, Pointing, TablePointing
from pipeline.spec.scene import Scene

OVER_ROWS = 1.25  # more than left-out rows tell: motions with eight rows or more in a period


def _lift_arcsec(scene: Scene, p: LocalPointing) -> float | None:
    """By how much the air lifts a boresight, at most [arcsec]; 0 without refraction."""
    if not isinstance(scene.observer, GroundObserver) or not needs_air(scene):
        return 0.0
    if p.elevation_deg <= 0.0:
        return None
    return float(terms_of(scene)[0] / np.tan(np.radians(p.elevation_deg)) / ARCSEC_RAD)


def _dwells(basis: PlanBasis) -> list[Decision]:
    """Of several exposures; none for one dwell."""
    scene = basis.scene
    if scene.dwells is None:
        return []
    plans, (shortest, longest) = dwell_plans(scene), integration_range_s(scene)
    slews = sum(p.slew is not None for p in plans)
    return [
        Decision(
            "dwells",
            True,
            f"{len(plans)} dwells with {frame_count(scene)} frames of {shortest:g} to "
            f"{longest:g} s, {slews} slews; bounds are those of the shortest exposure's noise",
            bound=0.0,
            unit="e-",
        )
    ]


def _pointings(scene: Scene) -> Iterator[tuple[Pointing, str]]:
    """The pointing of each dwell, and where it stands in words."""
    for plan in dwell_plans(scene):
        yield plan.pointing, "" if scene.dwells is None else f" in dwell {plan.index}"


def _tables(basis: PlanBasis) -> list[Decision]:
    """Of tables of attitudes."""
    scene = basis.scene
    tables = [(p, where) for p, where in _pointings(scene) if isinstance(p, TablePointing)]
    if not tables:
        return []
    off_px = bend_px(scene, basis.frames, basis.resolved.dut1_s)
    return [_table_told(scene, p, where, off_px) for p, where in tables]


def _refraction(basis: PlanBasis) -> list[Decision]:
    """Of azimuth and elevation under a site's air."""
    return [
        Decision(
            "pointing_refraction",
            False,
            f"azimuth and elevation{where} are those of the sky without air: with the "
            "site's refraction the camera is held as much higher (60 arcsec at 45 degrees)",
            bound=_lift_arcsec(basis.scene, p),
            unit="arcsec",
        )
        for p, where in _pointings(basis.scene)
        if isinstance(p, LocalPointing)
    ]


def _table_told(scene: Scene, p: TablePointing, where: str, off_px: float) -> Decision:
    """What is known of the error between the rows of a table of attitudes.

    off_px : of straight lines between an exposure's nodes
    """
    told = "not known: too few rows"
    if p.error_arcsec is not None:
        px = p.error_arcsec * ARCSEC_RAD / scene.sensor.ifov_rad
        told = f"{p.error_arcsec:.2g} arcsec ({px:.2g} px), from every other row omitted"
    return Decision(
        "pointing_table",
        True,
        f"{len(p.rows or ())} rows{where}, {p.interpolation} between them; error "
        f"between rows {told}; straight lines between an exposure's nodes are off by at most "
        f"{off_px:.2g} px in the frames looked at"
        f"{'' if p.source is None else f'; {p.source}'}",
        bound=None if p.error_arcsec is None else OVER_ROWS * p.error_arcsec,
        unit="arcsec",
    )


def _random_motion(basis: PlanBasis) -> tuple[Decision, ...]:
    """What the plan says of random motion; nothing for a scene that has none."""
    scene = basis.scene
    plan, model = motion_plan(scene), scene.pointing.attitude
    if plan is None or model is None:
        return ()
    parts = f"{len(model.jitter)} spectra, {len(model.modes)} modes"
    more = ""
    if plan.uneven_px > 1e-4:
        more += f"; one axis has {plan.uneven_px:.2g} px rms more than the round blur"
    if plan.roll_px > 1e-4:
        more += f"; fast roll of {plan.roll_px:.2g} px rms in the corners is omitted"
    return (
        Decision(
            "pointing_motion",
            True,
            f"{parts}: below {plan.split_hz:.3g} Hz (in the longest exposure) a path of "
            f"{plan.nodes} nodes, {plan.path_px:.3g} px rms; the rest is a blur of "
            f"{plan.blur_px:.3g} px rms per axis. Omitted: how that blur moves an exposure's mean "
            f"and the path bends between nodes ({plan.left_px:.2g} px rms), and how the blur's "
            f"variance changes from exposure to exposure ({100 * plan.scatter:.2g}% rms){more}. "
            "The bound is four times these, in a pixel whose light equals the noise floor, for "
            f"images of {SHARPEST_PX:g} px rms or more",
            plan.error_sigma * basis.facts.light_floor_e,
            plan.error_sigma,
        ),
    )


RULES = (
    Rule(("dwells",), "where the scene has them", "tests/plan/test_dwells.py", _dwells),
    Rule(
        ("pointing_table",),
        "rows are interpolated; the error is measured by leaving rows out",
        "tests/inputs/test_pointing_tables.py",
        _tables,
    ),
    Rule(
        ("pointing_refraction",),
        "a pointing names the true place; the air lifts the camera",
        "tests/acceptance/test_site_with_air.py",
        _refraction,
    ),
    Rule(
        ("pointing_motion",),
        "jitter slower than the nodes of an exposure moves the path, faster one is blur; the bound "
        "is of what lies between",
        "tests/physics/motion/test_jitter.py",
        _random_motion,
    ),
)
