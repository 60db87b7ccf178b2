"""What all approximations of a scene may err together: the part of each, and the judgement."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.plan.acceptance import accept_or_refuse
from pipeline.plan.decision import Decision
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.sensor import Chromatic, GaussianPsf

SMALL = 0.25  # of a part: what is refined until it errs by little, at no cost
INSTEAD = ("crowds_by_transforms",)  # of phase_interpolation, whose bound is counted
BESIDE_BRIGHTEST = ("few_wavelengths", "monochromatic_psf")  # as its light
ROUNDING = 1.0 + 1e-9
FEW_CELLS, FULL = 1 << 16, 16  # cells of a crowd that are summed in place, and for each star
PILED = 4.0  # bright sources of one pixel whose errors may add up where no noise hides them
UNSEEN = 1e-3  # of an approximation's part: what a star of a crowd may err by unseen


def parts(scene: Scene) -> float:
    """How many parts the error that a scene asks for is divided into.

    One for each approximation that its drawing may take: sub-pixel phases, the grid and the end of
    wings, common streaks, the wavelengths of a band, bodies as points (spheres, and meshes), the
    limit of faint stars, motion as blur; SMALL for the grid of the sky, for charge that stays from
    earlier frames, and for stars that are drawn for several frames.
    """
    sources = bool(scene.stars or scene.targets or scene.populations)
    winged = not all(isinstance(psf, GaussianPsf) for psf in scene.sensor.every_psf)
    bodies = [t.body.kind for t in scene.targets] + [p.body.kind for p in scene.populations]
    drawn = [
        True,  # sub-pixel phases
        *(2 * [winged]),  # the wings' grid, and their end
        scene.stars is not None,  # common streaks
        by_wavelength(scene),
        bool(scene.targets or scene.populations),  # bodies as points
        {"sphere", "mesh"} <= set(bodies),  # both kinds of them
        scene.stars is not None and scene.stars.limit_from_noise,
        scene.pointing.attitude is not None and scene.pointing.attitude.random,
    ]
    detector = scene.sensor.detector
    small = [
        scene.background is not None,
        detector is not None and detector.lag is not None,
        may_share_frames(scene),
    ]
    return max(1.0, sources * sum(drawn) + SMALL * sum(small))


def may_share_frames(scene: Scene) -> bool:
    """Whether a scene's stars could stand still from frame to frame: a sidereal pointing without
    motion of its own, no air before it, and all rows exposed together."""
    detector, site = scene.sensor.detector, scene.observer
    return (
        scene.stars is not None
        and scene.dwells is None
        and scene.exposure.frames > 1
        and scene.pointing.mode == "sidereal"
        and scene.pointing.attitude is None
        and getattr(site, "atmosphere", None) is None
        and (detector is None or detector.readout is None)
    )


def by_wavelength(scene: Scene) -> bool:
    """Whether the response follows the wavelength, over a band that the plan resolves."""
    return any(
        isinstance(one, Chromatic) and one.wavelength_nm is None and one.wavelengths is None
        for one in scene.sensor.every_psf
    )


def part_sigma(scene: Scene) -> float:
    """Error that one approximation may make in a pixel, in units of the pixel's noise.

    More of several bright sources in one pixel, as they raise its noise; where light has no noise
    of its own, each of PILED sources has its share of the part.
    """
    piled = 1.0 if scene.sensor.photon_noise else PILED
    return scene.accuracy.noise_fraction / (parts(scene) * piled)


def total_sigma(decisions: Iterable[Decision]) -> float:
    """Sum of the bounds of all approximations, in units of the noise of a pixel."""
    return math.fsum(_counted(d, d.error_bound_sigma) for d in decisions)


def total_e(decisions: Iterable[Decision]) -> float:
    """Sum of the bounds of all approximations [e-]."""
    return math.fsum(_counted(d, d.error_bound_e) for d in decisions)


def for_sources(
    decisions: Iterable[Decision], bounds_e: Mapping[str, float], floor_e: float, brighter: float
) -> list[Decision]:
    """Decisions with their bounds for the sources that were drawn.

    bounds_e : by component [e-]; floor_e : noise of a pixel without sources
    brighter : how many times as bright the brightest source is as the plan took it to be, which
        raises what is a share of its light
    """
    out = []
    for d in decisions:
        bound_e, sigma = d.error_bound_e, d.error_bound_sigma
        if bound_e is not None and d.component in bounds_e:
            bound_e = bounds_e[d.component]
            sigma = bound_e / floor_e
        elif bound_e is not None and sigma is not None and d.component in BESIDE_BRIGHTEST:
            bound_e, sigma = (v * max(1.0, brighter) for v in (bound_e, sigma))
        out.append(replace(d, error_bound_e=bound_e, error_bound_sigma=sigma))
    return out


def _counted(d: Decision, bound: float | None) -> float:
    return 0.0 if not bound or d.component in INSTEAD else bound


def judge(scene: Scene, decisions: tuple[Decision, ...]) -> list[str]:
    """The warning that bounds sum to more than was asked and accepted; none where they do not.

    Raises
    ------
    BadInput : where they do and the scene does not accept it (`accept: [error]`)
    """
    asked, total = scene.accuracy.noise_fraction, total_sigma(decisions)
    if total <= asked * ROUNDING:
        return []
    largest = sorted(decisions, key=lambda d: -_counted(d, d.error_bound_sigma))[:3]
    named = ", ".join(
        f"{d.component} {d.error_bound_sigma:.3g}" for d in largest if d.error_bound_sigma
    )
    least = math.ceil(total * 1e3) / 1e3
    allowed = f"at least {least:g}" if least <= 1.0 else f"none: at most 1, and {least:g} is needed"
    return [
        accept_or_refuse(
            scene,
            "error",
            "accuracy.noise_fraction",
            asked,
            f"{allowed}, the sum of this scene's bounds in units of a pixel's noise ({named})",
            f"pixels may err by {total:.3g} of their noise where {asked:g} was asked ({named})",
        )
    ]


def crowd_error_e(
    frame: Array, x_px: Array, y_px: Array, error_e: Array, cell_px: float, box_px: float
) -> float:
    """What stars (n,) err by together in one pixel, where each alone errs by `error_e` [e-].

    Errors of a grid turn with a star's place in it. Those of stars in one cell, half the grid's
    spacing wide, add up; those of cells as errors without relation do, within a box as wide as a
    wing's error reaches. The largest of all boxes; 0 without stars.
    """
    return max(
        (_crowded_e(x_px[one], y_px[one], error_e[one], cell_px, box_px) for one in _runs(frame)),
        default=0.0,
    )


def _runs(frame: Array) -> list[slice | NDArray[np.intp]]:
    """Where each frame's stars stand among those of all (n,)."""
    if not len(frame) or (frame[1:] < frame[:-1]).any():
        return [np.flatnonzero(frame == f) for f in np.unique(frame)]
    ends = [0, *(np.flatnonzero(np.diff(frame)) + 1), len(frame)]
    return [slice(a, b) for a, b in pairwise(ends)]


def _crowded_e(x_px: Array, y_px: Array, error_e: Array, cell_px: float, box_px: float) -> float:
    """The same of one frame."""
    column, row = (np.floor(v / cell_px) for v in (x_px, y_px))
    column, row, sums = _summed(column, row, error_e)
    wide = cell_px / box_px
    *_, squares = _summed(np.floor(column * wide), np.floor(row * wide), sums**2)
    return math.sqrt(squares.max(initial=0.0))


def _summed(column: Array, row: Array, values: Array) -> tuple[Array, Array, Any]:
    """Sums of values (n,) over each different pair of whole numbers: (columns, rows, sums)."""
    first_column, first_row = column.min(initial=0.0), row.min(initial=0.0)
    rows = int(row.max(initial=0.0) - first_row) + 1
    number = (column - first_column).astype(np.int64) * rows + (row - first_row).astype(np.int64)
    if number.max(initial=0) < FEW_CELLS + FULL * len(number):
        sums = np.bincount(number, weights=values)
        found = np.flatnonzero(sums)
        sums = sums[found]
    else:
        found, of = np.unique(number, return_inverse=True)
        sums = np.bincount(of, weights=values)
    across, down = np.divmod(found, rows)
    return across + first_column, down + first_row, sums


def doubts_of(stated: float, achieved: float | None) -> list[str]:
    """What a finished product says first where its error is not the one that was stated.

    stated, achieved : errors in units of a pixel's noise: the sum of all bounds for the sources
        that were drawn, and what drawing small windows again found (None where none was drawn)
    """
    if achieved is None or achieved <= stated * ROUNDING:
        return []
    return [
        f"pixels were found to err by {achieved:.3g} of their noise where at most "
        f"{stated:.3g} was stated"
    ]


def doubts_of_light(promised: float, stated: float) -> list[str]:
    """The same where the sources that were drawn are brighter than the plan took them to be.

    promised, stated : sums of all bounds: what was asked, or the plan's own where it was accepted
        above that; and for the sources that were drawn
    """
    if stated <= promised * ROUNDING:
        return []
    return [
        f"the brightest source or the densest crowd drawn is brighter than the plan knew: pixels "
        f"there may err by {stated:.3g} of their noise, not by the {promised:g} that was asked or "
        "accepted"
    ]
