"""What the frames of a plan will show, before any is drawn: targets in view, the faintest star."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.arrays import Geometry
from pipeline.execute.blocks import target_class
from pipeline.execute.sources import FrameTarget, place_targets
from pipeline.execute.truth import brightest_pixel_e, matched_snr, snr_of, target_magnitudes
from pipeline.physics.drawing.quadrature import drawn_s
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.air import star_transmission
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.pointing.star_paths import star_paths
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.response.own_paths import paths_through

SNR_AT_LIMIT = 5.0
LIMIT_MERGE_PX = 1e-3  # that the path of a source at the limit may be off by
LOOKED_AT = 8  # frames, evenly through the scene
PLACED = 2000  # targets placed in all of them together, at most; one frame is always looked at
TOLD = 100  # targets that are told one by one


def outlook(plan: Plan) -> JsonObject:
    """Targets in view, the best seen first, and the faintest star that reaches SNR_AT_LIMIT.

    looked_at : the frames that this is of; in_view : how many targets any of them shows;
    targets : of up to TOLD of these the frames, magnitude and SNR where they are seen best;
    limiting_g_mag : None without stars, or where none reaches that SNR
    """
    most = min(LOOKED_AT, max(1, PLACED // max(1, len(plan.scene.targets))))
    frames = np.unique(np.linspace(0, plan.frames - 1, min(plan.frames, most)).astype(np.int64))
    names = tuple(t.name for t in plan.scene.targets)
    best: dict[str, JsonObject] = {}
    limits = []
    for frame in frames:
        g = plan_geometry(plan.scene, np.array([frame]), plan.dut1_s)
        seen = {name: snr for name, snr in target_snr(plan, g, names).items() if snr > 0.0}
        mags = dict(zip(names, target_magnitudes(plan, g)[0], strict=True)) if seen else {}
        for name, snr in seen.items():
            before = best.get(name, {"frames": 0, "snr": 0.0})
            now = {"name": name, "frame": int(frame), "v_mag": float(mags[name]), "snr": snr}
            kept = now if snr > before["snr"] else before
            best[name] = kept | {"frames": before["frames"] + 1}
        time_s = clear_time_s(plan, g)
        if plan.colour is not None and time_s > 0.0:  # a bias frame sees nothing
            limits.append(limiting_mag(plan, limiting_light_e(plan, g), time_s))
    return {
        "looked_at": frames.tolist(),
        "in_view": len(best),
        "targets": sorted(best.values(), key=lambda t: -t["snr"])[:TOLD],
        "limiting_g_mag": max((m for m in limits if m is not None), default=None),
    }


def full_warnings(plan: ResolvedScene, g: Geometry) -> list[str]:
    """The warning on targets that fill pixels, which hold less of their light than is told, in the
    frames of a geometry."""
    if not plan.scene.targets or not 0.0 < plan.full_e < math.inf:
        return []  # nothing fits: said of all pixels
    worst: dict[str, tuple[float, int]] = {}
    for name, found_e, frame in _brightest_pixels(plan, g):
        worst[name] = max(worst.get(name, (0.0, 0)), (found_e, frame))
    full = {name: found for name, found in worst.items() if found[0] > plan.full_e}
    if not full:
        return []
    name = max(full, key=full.__getitem__)
    more = f" ({len(full) - 1} more do)" if len(full) > 1 else ""
    times, frame = float(f"{full[name][0] / plan.full_e:.2g}"), full[name][1]
    return [
        f"targets: {name} fills pixels{more}: its brightest would hold {times:g} times the "
        f"{plan.full_e:.3g} e- that fit, in frame {frame}; light and SNR count it all"
    ]


def _brightest_pixels(plan: ResolvedScene, g: Geometry) -> Iterator[tuple[str, float, int]]:
    """Names of bright targets in frames, charge of their brightest pixel [e-], and the frame."""
    facts, full_e = plan.facts, plan.full_e
    for k, frame in enumerate(g.frame.tolist()):
        one, time_s = g.frame_slice(k), plan.integration_s(frame)
        brightest = float(one.target_light.max(initial=0.0))
        if facts.flat * plan.sun_rate_e_s_m2 * facts.area_m2 * time_s * brightest <= full_e:
            continue
        for t in place_targets(plan, one):
            if _is_inside(plan, t) and facts.flat * t.light_e > full_e:
                yield plan.scene.targets[t.index].name, brightest_pixel_e(plan, t, frame), frame


def _is_inside(plan: ResolvedScene, t: FrameTarget) -> bool:
    rows, columns = plan.scene.sensor.shape
    return -0.5 <= t.x_px < columns - 0.5 and -0.5 <= t.y_px < rows - 0.5


def quadrature_s(plan: Plan, g: Geometry) -> float:
    """CPU seconds a frame of the targets too bright for all core classes, in those of `g`."""
    r, pixels = plan.responses, math.prod(plan.scene.sensor.shape)
    seconds = 0.0
    for k in range(len(g.frame)):
        every = place_targets(plan, g.frame_slice(k))
        beyond = [t.path for t in every if target_class(plan, t) == len(r.classes)]
        seconds += sum(max(drawn_s(b, path, pixels) for b in r.blurs) for path in beyond)
    return seconds / len(g.frame)


def target_snr(plan: Plan, g: Geometry, names: tuple[str, ...]) -> dict[str, float]:
    """Matched-filter SNR that the plan's noise gives each target in a frame, 0 outside of it."""
    out = dict.fromkeys(names, 0.0)
    for t in place_targets(plan, g) if names else ():
        name = plan.scene.targets[t.index].name
        if name in out and _is_inside(plan, t):
            out[name] = snr_of(plan, t, int(g.frame[0]))
    return out


def limiting_light_e(plan: Plan, g: Geometry) -> float:
    """Light of a point source in the middle of the field whose matched-filter SNR is 5 [e-].

    It moves as a star there does, whether the scene has stars or not. Infinite where no light
    reaches that SNR, where a star leaves the sky before the camera in one exposure, or where the
    scene has neither stars nor targets and so no response.
    """
    if not plan.responses.classes:
        return math.inf
    rows, columns = plan.scene.sensor.shape
    x, y = np.array([(columns - 1) / 2]), np.array([(rows - 1) / 2])
    places = star_paths(plan.camera, g, x, y, plan.scene.star_effects["aberration"])[:, :, 0]
    if not np.isfinite(places).all():
        return math.inf
    [path] = paths_through(places - places[..., [g.middle]], np.array([LIMIT_MERGE_PX]))
    light = np.geomspace(1e-3, 1e12, 601)
    snr = matched_snr(plan, path, light, x.repeat(601), y.repeat(601), int(g.frame[0]))
    if snr[-1] < SNR_AT_LIMIT:
        return math.inf
    return float(np.exp(np.interp(math.log(SNR_AT_LIMIT), np.log(snr), np.log(light))))


def clear_time_s(plan: Plan, g: Geometry) -> float:
    """Time in which a star in the middle of the field would send above the air what it sends
    through it in the one frame of `g` [s]; 0 for a bias frame."""
    time_s = plan.integration_s(int(g.frame[0]))
    if plan.extinction is None:
        return time_s
    axis = g.attitude[0, [g.middle], 2]
    return time_s * float(star_transmission(plan.extinction, plan.camera, g, axis)[0])


def limiting_mag(plan: Plan, light_e: float, time_s: float) -> float | None:
    """Gaia's G of a star of no colour that sends so much light in a time above the air, if any
    does."""
    if plan.colour is None or not light_e < math.inf:
        return None
    zero_e = plan.colour.zero_electrons_s_m2 * plan.facts.area_m2 * time_s
    return -2.5 * math.log10(light_e / zero_e)
