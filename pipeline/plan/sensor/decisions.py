"""The detector in the plan: what it adds beyond the plain chain, and what that leaves out."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import Geometry
from pipeline.plan.decision import Decision
from pipeline.plan.facts import Facts
from pipeline.plan.pointing.geometry import camera_of
from pipeline.plan.pointing.star_paths import star_paths
from pipeline.plan.rule import PlanBasis, Rule
from pipeline.plan.sensor.detector import lag_depth
from pipeline.plan.sensor.rolling import rolling_shutter
from pipeline.plan.timing import integration_range_s
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.detector import (
    Detector,
    Failing,
    FrameTransfer,
    PolynomialResponse,
    RollingShutter,
    TimeDelay,
)

LISTED = "; each pixel is in truth/pixels.parquet"
EXTRAS = (
    *("detector_extras", "bad_pixels", "dead_pixels", "hot_pixels", "prnu", "bias_structure"),
    *("amplifiers", "row_noise", "column_noise", "blooming", "nonlinearity", "lag"),
    *("frame_transfer", "tdi"),
)


def _extras(basis: PlanBasis) -> list[Decision]:
    """Every extra of the detector that is asked for; one line where none is."""
    scene, d = basis.scene, basis.scene.sensor.detector
    if d is None:
        why = "no bad or hot pixels, patterns, bent response, blooming, lag, smear or TDI asked for"
        return [Decision("detector_extras", False, why, 0.0, 0.0)]
    kept = [*_faults(d), *_patterns(d), *_charge(scene, d, basis.facts)]
    kept += _moving(scene, d, basis.frames)
    return [Decision(name, True, reason, *bound) for name, reason, *bound in kept]


def _rolling(basis: PlanBasis) -> list[Decision]:
    """Rows that are read one after another."""
    d = basis.scene.sensor.detector
    if d is None or not isinstance(d.readout, RollingShutter):
        return []
    told, off_px = rolling_shutter(basis.scene, d.readout, basis.frames, basis.resolved.dut1_s)
    return [Decision("rolling_shutter", True, told, bound=off_px, unit="px")]


def _faults(d: Detector) -> list[tuple]:
    out: list[tuple] = []
    if d.bad is not None:
        out.append(("bad_pixels", f"{_listed(d.bad)}; reads {d.bad.reads_dn} DN always{LISTED}"))
    if d.dead is not None:
        out.append(("dead_pixels", f"{_listed(d.dead)}; no light; dark and noise stay{LISTED}"))
    if d.hot is not None:
        hot = f"{len(d.hot.pixels)} listed"
        if d.hot.fraction > 0:
            hot += (
                f", and {d.hot.fraction:g} of all with a log-normal dark current about "
                f"{d.hot.median_e_per_s:g} e-/s ({d.hot.sigma_dex:g} dex)"
            )
        out.append(("hot_pixels", f"{hot}; steady: no blinking ones{LISTED}"))
    return out


def _listed(found: Failing) -> str:
    """Which pixels have a fault, in words."""
    parts = [
        f"{len(v)} {name}"
        for name, v in (("pixels", found.pixels), ("rows", found.rows), ("columns", found.columns))
        if v
    ]
    parts += ["those of an image"] if found.map is not None else []
    parts += [f"{found.fraction:g} of all by chance"] if found.fraction else []
    return ", ".join(parts) or "none listed"


def _patterns(d: Detector) -> list[tuple]:
    out: list[tuple] = []
    if d.prnu > 0:
        out.append(("prnu", f"a flat of {d.prnu:g} rms, normal, white from pixel to pixel"))
    if d.bias_structure is not None:
        out.append(("bias_structure", "of rows, columns and pixels, the same in all frames"))
    if d.amplifiers:
        out.append(("amplifiers", f"{len(d.amplifiers)}, without crosstalk between them"))
    for name, value in (("row_noise", d.row_noise_e), ("column_noise", d.column_noise_e)):
        if value > 0:
            out.append((name, f"{value:g} e- rms, white from line to line and frame to frame"))
    return out


def _charge(scene: Scene, d: Detector, facts: Facts) -> list[tuple]:
    """What happens to charge in the well."""
    out: list[tuple] = []
    full_well_e = float(scene.sensor.full_well_e or 0.0)
    if d.blooming:
        out.append(
            (
                "blooming",
                "half of the charge above the full well runs each way along its column and "
                "fills what room it meets; what reaches an end leaves the array. It holds after "
                "photon noise; none crosses to other columns",
            )
        )
    if d.nonlinearity is not None:
        bound: tuple[float, ...] = ()
        how = f"a table of {len(getattr(d.nonlinearity, 'true_e', ()))} points"
        if isinstance(d.nonlinearity, PolynomialResponse):
            how, error_e = "a polynomial, on 4097 points", _chord_error_e(d, full_well_e)
            bound = (error_e, error_e / facts.sigma_floor_e)
        out.append(("nonlinearity", f"{how}; of the charge before read noise", *bound))
    if d.lag is not None:
        n = lag_depth(scene, facts.sigma_floor_e)
        rest_e = d.lag.fraction ** (n + 1) * full_well_e
        out.append(
            (
                "lag",
                f"{d.lag.fraction:g} of a pixel's charge stays for the next frame: the means of "
                f"{n} frames before are drawn again for each (no frame waits for another); before "
                "the first there was none. Photon noise of what stayed behind is drawn anew",
                rest_e,
                rest_e / facts.sigma_floor_e,
            )
        )
    return out


def _chord_error_e(d: Detector, full_well_e: float) -> float:
    """Farthest that straight lines between the points of a polynomial are from it: h^2 f'' / 8."""
    assert isinstance(d.nonlinearity, PolynomialResponse)
    x = np.linspace(0.0, 1.0, 257)
    bend = np.polynomial.Polynomial([0.0, 1.0, *d.nonlinearity.coefficients]).deriv(2)
    return float(1.05 * np.abs(bend(x)).max() * full_well_e / 8.0 / 4096**2)


def _moving(scene: Scene, d: Detector, ends: Geometry) -> list[tuple]:
    """Charge that moves under the light."""
    if isinstance(d.readout, FrameTransfer):
        r, t = d.readout, integration_range_s(scene)[0]
        passes = "the rows ahead of it" if r.cleared else "all other rows of its column"
        return [
            (
                "frame_transfer",
                f"charge passes {passes}, {r.transfer_s / scene.sensor.shape[0]:.3g} "
                f"s in each: {r.transfer_s / t:.3g} of a column's mean light. Sources send what "
                "they send on average over the exposure, from where they are drawn: of one that "
                "moves, its streak's smear stands for that of its last place",
            )
        ]
    if isinstance(d.readout, TimeDelay):
        return [("tdi", _time_delay(scene, d.readout, ends))]
    return []


def _edges(scene: Scene, r: TimeDelay) -> str:
    """What becomes of charge that comes in or leaves during a TDI exposure."""
    rows, times = scene.sensor.shape[0], integration_range_s(scene)
    part = min(1.0, abs(r.rows_per_s) * times[1] / rows)
    if r.edges == "full":
        return (
            "charge that comes in at an edge is as full as any, as in a long strip: of a single "
            f"exposure the outer {part:.3g} of the rows would hold less, down to half of the light"
            " (`edges: partial` draws that)"
        )
    rays = (
        "; cosmic rays there are as many as elsewhere and leave that fraction of their charge, not "
        "fewer with all of it"
    )
    return (
        f"the outer {part:.3g} of the rows are exposed while their charge is on the array, as a "
        "fraction of all their light and dark: right for the sky and for images that keep pace; "
        "of one that streaks through such rows the fraction stands for its own time there. The "
        f"truth's electrons are those of the whole exposure{rays if scene.cosmic_rays else ''}"
    )


def _time_delay(scene: Scene, r: TimeDelay, ends: Geometry) -> str:
    """What TDI does to a scene: the image's own motion against the charge's, and what is left."""
    camera = camera_of(scene)
    x, y = (np.array([c]) for c in camera.centre_px)
    path = star_paths(camera, ends, x, y, scene.star_effects["aberration"])
    took = ends.offset_s[:, -1] - ends.offset_s[:, 0]
    per_s = np.divide(1.0, took, out=np.zeros_like(took), where=took > 0.0)  # 0: bias frames
    left = (path[1, 0, :, -1] - path[1, 0, :, 0]) * per_s
    across = np.abs(path[0, 0, :, -1] - path[0, 0, :, 0]).max()
    worst = left[np.argmax(np.abs(left))]
    text = (
        f"charge moves {r.rows_per_s:g} rows/s in {r.clock_phases} steps a row; a star in the "
        f"centre moves {worst + r.rows_per_s:.5g} rows/s, so that it streaks "
        f"{abs(worst) * took[0]:.3g} px along and {across:.3g} px across. Flat and dark are means "
        "of what the charge passes. All rows share the exposure's start and end; "
        f"{_edges(scene, r)}"
    )
    if not scene.targets or r.rows_per_s == 0:
        return text
    with np.errstate(invalid="ignore"):
        length = (
            np.hypot(
                ends.target_x_px[..., -1] - ends.target_x_px[..., 0],
                ends.target_y_px[..., -1] - ends.target_y_px[..., 0],
            )
            * per_s
        )
    speed = float(np.nanmax(length, initial=0.0))
    late_s = 0.5 * scene.sensor.shape[0] / abs(r.rows_per_s)
    return text + (
        f"; lines recorded one after the other would see targets up to {late_s:.3g} s earlier or "
        f"later, and so up to {speed * late_s:.3g} px elsewhere"
    )


RULES = (
    Rule(
        EXTRAS,
        "each where the scene asks for it; nothing is computed or loaded otherwise",
        "tests/execute/test_detector.py::test_nothing_of_it_unless_asked_for",
        _extras,
    ),
    Rule(
        ("rolling_shutter",),
        "where the detector's readout asks for it; refused where its bounds do not hold",
        "tests/execute/test_rolling_shutter.py::test_stars_against_each_rows_own_exposure",
        _rolling,
    ),
)
