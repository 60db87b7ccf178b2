"""The light that one source sends into the pixels: its response swept along its path."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.inputs.band.curves import resolve_response
from pipeline.inputs.sensor.psf_tables import gather_psf_table
from pipeline.physics.drawing.along import swept_spectrum
from pipeline.physics.motion.streak import Path, pieces
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.response import (
    TAPER_FROM,
    Core,
    compact_core,
    oversampling_for,
    stamp_at,
    window,
)
from pipeline.plan.facts import gather_facts
from pipeline.plan.optics.psf_field import PsfField
from pipeline.spec.scene import Scene

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

STEP_PX = 0.125  # paths and places are rounded to it, so that sources alike share their stamps
SEGMENTS = (8, 1024)  # of a bent path: the fewest, so that its speed is followed, and the most
TURN_RAD = math.radians(120.0)  # from one half of a path to the other, up to which it is an arc
LARGEST_PX = 128.0
LARGEST_SAMPLES = 1024  # radius times samples a pixel
KEPT = 512  # stamps


@dataclass
class SourceLight:
    """Draws single sources for masks and boxes, to STEP_PX / 2 in place and shape.

    blur : the response; of a field, the sharpest, and `psf_field` holds all of them
    """

    blur: Blur
    psf_field: PsfField | None = None
    _cores: dict[tuple[Blur, int], Core] = field(default_factory=dict)
    _swept: dict[object, tuple] = field(default_factory=dict)
    _stamps: dict[object, tuple] = field(default_factory=dict)

    def image(
        self, path: Path, x_px: float, y_px: float, light_e: float, least_e: float
    ) -> tuple[int, int, Array]:
        """(first row, first column, electrons in the pixels of a window).

        light_e : as in the truth, of what pixels collect. path : about (x_px, y_px). The window
        holds every pixel of `least_e` or more, up to LARGEST_PX from the path; light beyond is
        omitted.
        """
        out: list[tuple[int, int, Array]] = []
        light_e = light_e / self.blur.fill_factor  # what falls on the focal plane
        for blur, share in self._blurs(x_px, y_px):
            number = self._radius_number(blur, light_e * share, least_e)
            for x0, y0, piece, part in pieces(path):
                row, column, stamp = self._stamp(blur, number, piece, x_px + x0, y_px + y0)
                out.append((row, column, light_e * share * part * stamp))
        return _joined(out)

    def enclosing_px(self, fraction: float) -> float:
        """Radius about a point source that holds a fraction of all its light, up to LARGEST_PX."""
        number = 0
        while True:
            core = self._core(self.blur, number)
            half, per_px = core.samples.shape[0] // 2, core.oversampling
            at = np.arange(-half, half + 1) / per_px
            r = np.hypot(at[:, None], at[None, :]).ravel()
            order = np.argsort(r, kind="stable")
            light = np.cumsum(np.maximum(core.samples.ravel()[order], 0.0))
            last = np.searchsorted(light, fraction * per_px**2 * self.blur.fill_factor)
            radius = float(r[order[min(int(last), len(order) - 1)]])
            largest = self._radius_px(self.blur, number + 1) <= core.radius_px
            if largest or not self.blur.has_wings or radius <= TAPER_FROM * core.radius_px:
                return min(radius, core.radius_px)
            number += 1

    def _blurs(self, x_px: float, y_px: float) -> list[tuple[Blur, float]]:
        if self.psf_field is None:
            return [(self.blur, 1.0)]
        shares = self.psf_field.shares(np.array([x_px]), np.array([y_px]))
        return [(blur, float(share[0])) for blur, share in shares if share[0] > 0]

    def _radius_number(self, blur: Blur, light_e: float, least_e: float) -> int:
        """Which of the doubling radii holds the pixels of `least_e`: the ring tells."""
        number = 0
        while self._radius_px(blur, number + 1) > self._radius_px(blur, number):
            core = self._core(blur, number)
            half = core.samples.shape[0] // 2
            edge = min(half, int(0.7 * core.radius_px * core.oversampling))
            ring = max(abs(core.samples[half, half + edge]), abs(core.samples[half + edge, half]))
            if light_e * ring <= least_e:
                break
            number += 1
        return number

    def _radius_px(self, blur: Blur, number: int) -> float:
        largest = min(LARGEST_PX, LARGEST_SAMPLES / oversampling_for(blur))
        return min(largest, max(blur.core_px, 4.0) * 2.0**number)

    def _core(self, blur: Blur, number: int) -> Core:
        key = (blur, number)
        if key not in self._cores:
            self._cores[key] = compact_core(blur, self._radius_px(blur, number))
        return self._cores[key]

    def _stamp(
        self, blur: Blur, number: int, piece: Path, x_px: float, y_px: float
    ) -> tuple[int, int, Array]:
        """A stamp at a rounded phase; the latest ones are kept."""
        x, y = (round(v / STEP_PX) * STEP_PX for v in (x_px, y_px))
        whole_x, whole_y = math.floor(x), math.floor(y)
        key = (blur, number, piece, x - whole_x, y - whole_y)
        if key not in self._stamps:
            _make_room(self._stamps)
            swept = self._swept_core(blur, number, piece)
            core, spectrum, half, period = swept
            at = y - whole_y, x - whole_x
            self._stamps[key] = stamp_at(core, spectrum, half, period, *at)
        row, column, stamp = self._stamps[key]
        return row + whole_y, column + whole_x, stamp

    def _swept_core(self, blur: Blur, number: int, piece: Path) -> tuple:
        key = (blur, number, piece)
        if key not in self._swept:
            _make_room(self._swept)
            core = self._core(blur, number)
            reach = (float(np.abs(p).max()) for p in (piece.y_px, piece.x_px))
            half_y, half_x, *period = window(core, *reach)
            spectrum = swept_spectrum(core, piece, (period[0], period[1]))
            self._swept[key] = (core, spectrum, (half_y, half_x), tuple(period))
        return self._swept[key]


def source_light(scene: Scene) -> SourceLight:
    """What draws single sources of a scene: its optics, read anew (curves and tables)."""
    s = scene.sensor
    response, *_ = resolve_response(s.bandpass.model_dump(), s.transmission, s.quantum_efficiency)
    facts = gather_facts(scene, response, 0.0, 1.0, 1.0, gather_psf_table(scene))
    return SourceLight(facts.blur, facts.field)


def path_between(start: Array, middle: Array, end: Array) -> Path:
    """The arc (`arc_nodes`) through three places (x, y), about the middle one, evenly lit.

    Rounded to STEP_PX. What bends otherwise, or brightens while it is exposed, differs by that.
    """
    half = np.round(0.5 * (end - start) / STEP_PX) * STEP_PX
    bend = np.round((0.5 * (end + start) - middle) / STEP_PX) * STEP_PX
    before, after = (np.array([complex(*way)]) for way in (half - bend, half + bend))
    segments = arc_segments(float(np.hypot(*bend)))
    at = arc_nodes(before, after, segments)[0]
    return Path(at.real, at.imag, np.full(segments, 1.0 / segments))


def arc_segments(bend_px: float) -> int:
    """How many straight segments follow an arc to STEP_PX / 2; an even number, or one.

    bend_px : from the middle of its chord to its own
    """
    if bend_px == 0.0:
        return 1
    needed = 2 * math.ceil(0.5 * math.sqrt(2.0 * bend_px / STEP_PX))
    return int(min(max(needed, SEGMENTS[0]), SEGMENTS[1]))


def arc_nodes(before: Complex, after: Complex, segments: int) -> Complex:
    """Nodes (n, segments + 1), x + iy from the middle, at equal times along arcs of n sources.

    before, after : (n,) ways x + iy from start to middle and from there to the end, that take
    equal times. Motion turns and changes its speed by the ratio of the two in each half, evenly:
    along a circle where they are equally long, as stars about the pole; where little bends, a
    parabola. One that turns by more than TURN_RAD goes to and fro, and is a parabola as well.
    """
    if segments == 1:
        return np.stack([-before, after], axis=-1)
    t = np.linspace(-1.0, 1.0, segments + 1)
    half, bend = 0.5 * (after + before)[:, None], 0.5 * (after - before)[:, None]
    nodes = half * t + bend * t * t
    moves = (before != 0.0) & (after != 0.0)
    rate = np.log(np.divide(after, before, out=np.ones_like(after), where=moves))
    turns = (np.abs(rate.imag) <= TURN_RAD) & (np.abs(rate) > 1e-3)
    growth = np.expm1(rate[turns, None] * t) / np.expm1(rate[turns, None])
    nodes[turns] = after[turns, None] * growth
    return nodes


def _joined(stamps: list[tuple[int, int, Array]]) -> tuple[int, int, Array]:
    """Stamps added up in the window that holds them all."""
    y0 = min(row for row, _, _ in stamps)
    x0 = min(column for _, column, _ in stamps)
    y1 = max(row + stamp.shape[0] for row, _, stamp in stamps)
    x1 = max(column + stamp.shape[1] for _, column, stamp in stamps)
    whole = np.zeros((y1 - y0, x1 - x0))
    for row, column, stamp in stamps:
        at_y, at_x = slice(row - y0, row - y0 + stamp.shape[0]), column - x0
        whole[at_y, at_x : at_x + stamp.shape[1]] += stamp
    return y0, x0, whole


def _make_room(kept: dict[object, tuple]) -> None:
    while len(kept) >= KEPT:
        kept.pop(next(iter(kept)))
