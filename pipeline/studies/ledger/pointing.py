"""Probes of the camera's motion: tables between their rows, jitter, dwells, rolling shutters."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import erf

from catalog_tools.documents import JsonObject
from pipeline.arrays import Array, FrameStars
from pipeline.physics.constants import ARCSEC_RAD
from pipeline.plan.pointing.attitude_motion import SHARPEST_PX, motion_plan
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from pipeline.studies.ledger.probe import Bench, ProbeResult, most, probe, stated, timed
from pipeline.studies.ledger.scenes import DEC_DEG, ORBIT, RA_DEG, mean_e, scene
from pipeline.studies.scenes.stage import gather_stars, open_stage
from pipeline.studies.worst import worst_of

RUNS, FINE = 400, 4097
LINE_S, ROWS = 2e-3, 5


@probe("distortion")
def distortion(_: Bench) -> Iterator[ProbeResult]:
    """Places through SIP terms and back by the product, the terms summed by numpy's powers."""
    terms = {"2_0": 3e-5, "1_1": -2e-5, "0_2": 1e-5, "3_0": 4e-8, "1_2": -3e-8}
    request = {"kind": "sip", "a": terms, "b": {k: -0.7 * v for k, v in terms.items()}}
    plan = prepare(parse_scene(scene({"sensor.distortion": request}))).plan
    d = plan.camera.distortion
    assert d is not None
    half = 0.5 * (plan.camera.rows - 1)
    u, v = np.random.default_rng(8).uniform(-half, half, (2, 20_000))
    powers = [(int(k[0]), int(k[2]), t) for k, t in terms.items()]
    in_s, moved = timed(lambda: sum(t * u**p * v**q for p, q, t in powers), 3)
    out_s, found = timed(lambda: d.to_detector(u + moved, v - 0.7 * moved), 3)
    off = worst_of(most(found[0] - u), most(found[1] - v))
    bound, unit = stated(plan, "distortion")
    yield ProbeResult(
        "distortion",
        "20,000 places through SIP terms of up to 0.3 px, and back",
        bound,
        off,
        unit,
        out_s,
        in_s,
    )


@probe("dwells")
def dwells(bench: Bench) -> Iterator[ProbeResult]:
    """The first frame of a dwell, beside the same frame of a scene of its own."""
    plain = scene({"stars": {"catalogue": bench.catalogue}})
    parts = {
        "dwells": [
            {},
            {"pointing": plain["pointing"] | {"roll_deg": 30.0}, "slew": {"duration_s": 20.0}},
        ]
    }
    many = scene(parts, plain)
    out_s, a = timed(lambda: mean_e(plain), 2)
    in_s, b = timed(lambda: mean_e(many), 2)
    bound, unit = stated(open_stage(many).plan, "dwells")
    yield ProbeResult(
        "dwells",
        "the first of two dwells, beside a scene of its own",
        bound,
        most(a - b),
        unit,
        out_s,
        in_s,
    )


def _true_attitude(t: Array) -> Array:
    """Axes (n, 3, 3) of a smooth known motion: +x, +y, boresight in rows."""
    ra = np.radians(RA_DEG) + 2e-4 * np.sin(0.9 * t)
    dec = np.radians(DEC_DEG) + 2e-4 * np.cos(0.7 * t)
    z = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], -1)
    y = np.array([0.0, 0.0, 1.0]) - z[:, 2:] * z
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([np.cross(z, y), y, z], axis=1)  # x against the columns


@probe("pointing_table")
def table(_: Bench) -> Iterator[ProbeResult]:
    """Quaternions of a known motion every half second; the camera between them, at 200 moments."""
    at = np.arange(-5.0, 15.0, 0.5)
    quaternion = Rotation.from_matrix(_right_handed(_true_attitude(at)).transpose(0, 2, 1))
    rows = np.column_stack([at, quaternion.as_quat()]).tolist()
    for how in ("slerp", "spline"):
        pointing = {
            "mode": "table",
            "rows": rows,
            "scalar": "last",
            "frame": "gcrs",
            "interpolation": how,
        }
        parsed = parse_scene(
            scene(
                {
                    "pointing": pointing,
                    "exposure": {"integration_s": 0.04, "frames": 100, "cadence_s": 0.0777},
                }
            )
        )
        prepared = prepare(parsed)
        plan = prepared.plan
        frames = np.arange(100, dtype=np.int64)
        out_s, g = timed(partial(plan_geometry, plan.scene, frames, plan.dut1_s))
        moments = g.offset_s[:, g.middle]
        in_s, true = timed(lambda t=moments: _true_attitude(t)[:, 2])  # type: ignore[misc]
        told = g.attitude[:, g.middle, 2]
        off = most(np.linalg.norm(np.cross(true, told), axis=-1)) / ARCSEC_RAD
        bound, unit = stated(plan, "pointing_table")
        yield ProbeResult(
            "pointing_table",
            f"{how} of {len(rows)} rows of a known motion, 100 frames",
            bound,
            off,
            unit,
            out_s,
            in_s,
        )


def _right_handed(axes: Array) -> Array:
    """Axes with x so that they make a right-handed frame."""
    out = axes.copy()
    out[:, 0] = np.cross(axes[:, 1], axes[:, 2])
    return out


@probe("pointing_motion")
def jitter(_: Bench) -> Iterator[ProbeResult]:
    """Jitter followed wave by wave, beside a path of few nodes and blur: a star of the floor."""
    rms_arcsec, low, high = 3.0, 0.5, 400.0
    attitude = {
        "jitter": [{"kind": "white", "rms_arcsec": rms_arcsec, "low_hz": low, "high_hz": high}]
    }
    data = scene({"pointing.attitude": attitude, "exposure.integration_s": 1.0})
    plan = prepare(parse_scene(data)).plan
    motion = motion_plan(plan.scene)
    assert motion is not None
    rms_px = rms_arcsec * ARCSEC_RAD / plan.facts.ifov_rad
    rng, t = np.random.default_rng(6), np.linspace(0.0, 1.0, FINE)
    hz = rng.uniform(low, high, (RUNS, 2, 300))
    phase = rng.uniform(0.0, 2.0 * np.pi, hz.shape)
    fast = hz > motion.split_hz
    nodes = np.linspace(0.0, 1.0, motion.nodes)
    x, y = (v.ravel() for v in np.meshgrid(np.arange(-5.0, 6.0), np.arange(-5.0, 6.0)))

    def image(px: Array, py: Array, sigma: float) -> Array:
        def share(c: Array, p: Array) -> Array:
            edges = (c[:, None] + np.array([-0.5, 0.5])[:, None, None] - p) / (np.sqrt(2) * sigma)
            return 0.5 * (erf(edges[1]) - erf(edges[0]))

        return np.asarray((share(x, px) * share(y, py)).mean(axis=-1))

    worst, spent = [], [0.0, 0.0]
    blurred = np.hypot(SHARPEST_PX, motion.blur_px)
    for k in range(RUNS // 10):
        waves = rms_px * np.sqrt(2.0 / 300.0)
        every = waves * np.sin(2 * np.pi * hz[k, ..., None] * t + phase[k, ..., None])
        slow = np.where(fast[k, ..., None], 0.0, every)
        path = [np.interp(t, nodes, s[:: (FINE - 1) // (motion.nodes - 1)]) for s in slow.sum(1)]
        true_x, true_y = every.sum(1)[:, ::8]
        in_s, exact = timed(partial(image, true_x, true_y, SHARPEST_PX))
        out_s, told = timed(partial(image, path[0][::64], path[1][::64], blurred))
        worst.append(most(exact - told) / float(exact.max()))
        spent = [spent[0] + out_s, spent[1] + in_s]
    bound = stated(plan, "pointing_motion")[0] / plan.facts.sigma_floor_e
    count = len(worst)
    yield ProbeResult(
        "pointing_motion",
        f"{count} exposures of white jitter followed wave by wave, a "
        "star as bright as the noise floor",
        bound,
        worst_of(*worst),
        "sigma",
        spent[0] / count,
        spent[1] / count,
    )


@probe("rolling_shutter")
def rolling(bench: Bench) -> Iterator[ProbeResult]:
    """Where the product has stars, and where they are in the exposure of their own row."""
    data = scene(
        {
            "observer": ORBIT,
            "stars": {"catalogue": bench.catalogue},
            "pointing": {
                "mode": "rate",
                "boresight_ra_deg": RA_DEG,
                "boresight_dec_deg": DEC_DEG,
                "rate_ra_arcsec_s": 20.0,
                "rate_dec_arcsec_s": 30.0,
                "acceleration_ra_arcsec_s2": 2.0,
            },
            "exposure.integration_s": 0.01,
        }
    )
    out_s, stage = timed(
        lambda: open_stage(
            scene({"sensor.detector.readout": {"kind": "rolling", "line_s": LINE_S}}, data)
        )
    )
    stars, camera = stage.stars, stage.plan.camera
    inside = np.flatnonzero(
        (stars.y_px > 5)
        & (stars.y_px < camera.rows - 5)
        & (np.abs(stars.x_px - camera.columns / 2) < camera.columns / 2)
    )
    worst, spent = 0.0, 0.0
    chosen = inside[np.argsort(stars.y_px[inside])][:: max(1, len(inside) // ROWS)]
    for i in chosen:
        late = scene({"exposure.frames": 2, "exposure.cadence_s": LINE_S * stars.y_px[i]}, data)
        in_s, own = timed(lambda d=late: _second_frame(d))  # type: ignore[misc]
        k = int(np.flatnonzero(own.source_id == stars.source_id[i])[0])
        off = own.x_px[k] - stars.x_px[i], own.y_px[k] - stars.y_px[i]
        worst, spent = worst_of(worst, np.hypot(*off)), spent + in_s
    bound, unit = stated(stage.plan, "rolling_shutter")
    yield ProbeResult(
        "rolling_shutter",
        f"{len(chosen)} stars before a camera that turns faster and "
        "faster, each beside a frame of its own row's time",
        bound,
        worst,
        unit,
        out_s,
        spent / max(1, len(chosen)),
    )


def _second_frame(data: JsonObject) -> FrameStars:
    """The stars of a scene's second frame."""
    prepared = prepare(parse_scene(data))
    g = plan_geometry(prepared.plan.scene, np.ones(1, np.int64), prepared.plan.dut1_s)
    return gather_stars(prepared, prepared.plan, g)[0]
