"""Probes of how light is drawn: responses, colours, streaks, crowds, wings, sky, stray light."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pipeline.studies.ledger.probe import Bench, ProbeResult, most, probe, stated, timed
from pipeline.studies.ledger.scenes import DEC_DEG, RA_DEG, SIDE, mean_e, scene, whole
from pipeline.studies.scenes.exact import choose_windows
from pipeline.studies.scenes.level import lights_e
from pipeline.studies.scenes.stage import light_by, mean_of, noise_of, open_stage
from pipeline.studies.scenes.switches import Switch, switches
from pipeline.studies.worst import worst_of

WINDOWS = 4
AIRY = {"kind": "airy", "jitter_px": 0.5, "wavelengths": 1}


def _switched(data: dict, wanted: tuple[str, ...], how: str) -> Iterator[ProbeResult]:
    """Approximations of a scene's plan, each switched off in windows of its frame."""
    stage = open_stage(data)
    tiles = (whole(stage),)
    windows = choose_windows(stage, tiles, WINDOWS)
    for s in switches(stage, tiles, windows):
        if s.component in wanted:
            yield _measured(stage, s, windows, how)


def _measured(stage, s: Switch, windows, how: str) -> ProbeResult:
    """One approximation: the worst of some windows, in units of the pixel's noise or in e-."""
    error, seconds = 0.0, [0.0, 0.0]
    for window in windows:
        s.on()(window), s.off()(window)  # tables of what is timed
        on_s, on = timed(lambda w=window: mean_of(stage, s.on()(w), w))  # type: ignore[misc]
        off_s, off = timed(lambda w=window: mean_of(stage, s.off()(w), w))  # type: ignore[misc]
        noise = 1.0 if s.of_light else noise_of(stage, off, window)
        error = worst_of(error, most((on - off) / noise))
        seconds = [seconds[0] + on_s, seconds[1] + off_s]
    sigma = 1.0 if s.of_light else stage.plan.facts.sigma_floor_e
    unit = "e-" if s.of_light else "sigma"
    return ProbeResult(s.component, how, s.bound_e / sigma, error, unit, *seconds)


@probe("phase_interpolation")
def engines(bench: Bench) -> Iterator[ProbeResult]:
    """Stars that streak, by the product's engines and one by one; a crowd by transforms."""
    stars = {"catalogue": bench.catalogue}
    turn = {
        "mode": "rate",
        "boresight_ra_deg": RA_DEG,
        "boresight_dec_deg": DEC_DEG,
        "rate_ra_arcsec_s": 72.0,
        "rate_dec_arcsec_s": 96.0,
        "roll_rate_deg_s": 0.01,
    }
    dim = {"sensor.aperture_m": 0.05}  # so that there are stars which share a streak
    streaks = scene(dim | {"stars": stars, "pointing": turn, "sensor.psf": AIRY})
    yield from _switched(
        streaks,
        ("phase_interpolation", "common_streak"),
        f"{SIDE} x {SIDE} px, stars streak by 65 px",
    )
    yield _crowd(bench)


def _crowd(bench: Bench) -> ProbeResult:
    """All stars of a frame by the transforms of crowds, and by stamps: the same plan otherwise."""
    stage = open_stage(
        scene({"stars": {"catalogue": bench.catalogue}, "background": {"uniform_e_per_s": 100.0}})
    )
    plan, tile = stage.plan, whole(stage)
    crowd, stamps = (
        replace(plan, responses=replace(plan.responses, spectral_from=n)) for n in (1, 0)
    )
    out_s, ours = timed(lambda: mean_of(stage, light_by(stage, crowd)(tile), tile), 2)
    in_s, true = timed(lambda: mean_of(stage, light_by(stage, stamps)(tile), tile), 2)
    noise = noise_of(stage, true, tile)
    bound = plan.responses.budget_e / plan.facts.sigma_floor_e
    return ProbeResult(
        "crowds_by_transforms",
        f"{len(stage.stars)} stars by transforms, beside stamps",
        bound,
        most((ours - true) / noise),
        "sigma",
        out_s,
        in_s,
    )


@probe("wings_on_a_coarse_grid")
def wings(bench: Bench) -> Iterator[ProbeResult]:
    """The diffraction wings of bright stars, on a grid of half the spacing, and farther out."""
    data = scene({"stars": {"catalogue": bench.catalogue}, "sensor.psf": AIRY})
    yield from _switched(
        data, ("wings_on_a_coarse_grid",), f"{SIDE} x {SIDE} px, diffraction, stars from G = 8"
    )
    coarse, fine = (
        scene(
            {"accuracy": {"noise_fraction": n, "flux_fraction": 0.02 * n, "check_cells": 0}}, data
        )
        for n in (0.5, 0.01)
    )
    near = open_stage(coarse, open_stage(fine).plan)
    windows = choose_windows(near, (whole(near),), WINDOWS)
    for s in switches(near, (whole(near),), windows):
        if s.component == "wings_cut_off":
            yield _measured(near, s, windows, "the same, wings as far as for a finer accuracy")


@probe("monochromatic_psf")
def colours(bench: Bench) -> Iterator[ProbeResult]:
    """Diffraction at one wavelength and at a few, beside twelve."""
    stars = {"catalogue": bench.catalogue}
    data = scene(
        {
            "stars": stars,
            "sensor.aperture_m": 0.02,
            "sensor.psf.kind": "airy",
            "sensor.psf.sigma_px": None,
        }
    )
    yield from _switched(
        data,
        ("monochromatic_psf", "few_wavelengths"),
        "diffraction over 400 to 900 nm, beside 12 wavelengths",
    )


@probe("one_psf")
def over_the_field(bench: Bench) -> Iterator[ProbeResult]:
    """Responses at five places, beside those of the places half way between them, too."""
    rows = np.linspace(0.0, SIDE - 1.0, 5)

    def sigma(y: float) -> float:
        return 0.9 + 0.5 * ((y - 60.0) / SIDE) ** 2

    def psf(places) -> dict:
        return {
            "kind": "field",
            "rows_px": [float(r) for r in places],
            "columns_px": [63.5],
            "psfs": [[{"kind": "gaussian", "sigma_px": sigma(float(r))}] for r in places],
        }

    data = scene({"stars": {"catalogue": bench.catalogue}, "sensor.psf": psf(rows)})
    finer = scene({"sensor.psf": psf(np.linspace(0.0, SIDE - 1.0, 9))}, data)
    few = open_stage(data)
    out_s, a = timed(lambda: mean_e(few))
    many = open_stage(finer)
    in_s, b = timed(lambda: mean_e(many))
    field = few.plan.responses.field
    assert field is not None
    bound = sum(e for e in field.error if e is not None) * max(lights_e(few))
    yield ProbeResult(
        "psf_over_the_field",
        "a Gaussian that widens along the rows, at 5 places and at 9",
        bound,
        most(a - b),
        "e-",
        out_s,
        in_s,
    )


@probe("background.*")
def skies(_: Bench) -> Iterator[ProbeResult]:
    """Grids for a uniform sky of a wide field and for the zodiacal light; each pixel's own."""
    wide = {"sensor.focal_length_m": 0.02}
    even = open_stage(scene(wide | {"background": {"uniform_mag_arcsec2": 18.0}}))
    varying = open_stage(scene(wide | {"background": {"zodiacal": True, "galactic": True}}))
    for stage, what in ((even, "a uniform sky"), (varying, "zodiacal and galactic light")):
        for s in switches(stage, (whole(stage),), (whole(stage),)):
            if s.component == "background.grid":
                how = f"{what} in a field of 3 degrees, {SIDE} x {SIDE}"
                yield _measured(stage, s, (whole(stage),), how)


@probe("pupil_projection")
def pupil(_: Bench) -> Iterator[ProbeResult]:
    """A uniform sky of a wide field, with the pupil seen from off axis and without."""
    wide = {"sensor.focal_length_m": 0.004, "background": {"uniform_mag_arcsec2": 18.0}}
    data = scene(wide | {"sensor.pupil_projection": False})
    stage = open_stage(data)
    out_s, without = timed(lambda: mean_e(data))
    in_s, full = timed(lambda: mean_e(scene(wide)))
    bound, unit = stated(stage.plan, "pupil_projection")
    yield ProbeResult(
        "pupil_projection",
        f"a field of 16 degrees, {SIDE} x {SIDE}",
        bound,
        most(1.0 - full / without),
        unit,
        out_s,
        in_s,
    )


@probe("stray_light.*")
def stray(_: Bench) -> Iterator[ProbeResult]:
    """The light of each body in a frame with it and without."""
    high = {
        "kind": "orbit",
        "orbit": {"kind": "state", "position_m": [4.2164e7, 0, 0], "velocity_m_s": [0, 3075, 0]},
    }
    pst = {"kind": "harvey", "b0_per_sr": 0.06, "shoulder": 0.02, "slope": -3.5}
    data = scene(
        {
            "observer": high,
            "epoch": "2019-04-20T03:00:00Z",
            "pointing": {"mode": "sidereal", "boresight_ra_deg": 192, "boresight_dec_deg": 4},
            "background": {"stray_light": {"pst": pst}},
            "sensor.focal_length_m": 0.1,
            "exposure.integration_s": 1.0,
        }
    )
    stage = open_stage(data)
    in_s, every = timed(lambda: mean_e(data))
    for body in ("sun", "moon", "earth"):
        less = scene({f"background.stray_light.{body}": False}, data)
        out_s, without = timed(lambda d=less: mean_e(d))  # type: ignore[misc]
        bound, unit = stated(stage.plan, f"stray_light.{body}")
        yield ProbeResult(
            f"stray_light.{body}",
            "a frame near the Earth's limb, with it and without",
            bound,
            most(every - without),
            unit,
            out_s,
            in_s,
        )
