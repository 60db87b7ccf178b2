"""Point-spread functions over the field: a grid of responses, mixed bilinearly between its places.

A source's light is shared among the responses of the (at most four) places around it, so that its
light stays whole, no pixel turns negative, and nothing jumps where two cells of the grid meet.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.arrays import Array
from pipeline.errors import BadInput
from pipeline.physics.drawing.extended import point_error
from pipeline.physics.motion.streak import Path, cut_at, in_steps
from pipeline.physics.psf.band import BandOptics, NoiseLimit
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.response import compact_core
from pipeline.physics.psf.sampled import Sampled
from pipeline.physics.radiometry import ResponseCurve
from pipeline.plan.optics.optics import blur_of, describe
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.sensor import FieldPsf, OnePsf

CELL_STEPS = 64  # from one place to the next, of paths whose light rises along each step
SAMPLES = 2  # a pixel and axis at which responses are compared
SMALL_RADIUS_PX = 1e-2  # of a body whose error as a point tells which response is the sharpest
SAFETY, SAFE_FROM = (3.0, 2.0), 5  # over second differences: with fewer places, and from so many


@dataclass(frozen=True)
class PsfField:
    """Responses at a rectangular grid of places in the frame.

    rows_px, columns_px : increasing frame places; outside of them the nearest counts
    blurs : the different responses
    which : the number in `blurs` of each place's response, row by row
    error : along rows and columns, the largest error of a pixel between places, per unit light of
        its source, as `_between` tells from the places; None along an axis of fewer than 3
    """

    rows_px: tuple[float, ...]
    columns_px: tuple[float, ...]
    blurs: tuple[Blur, ...]
    which: tuple[int, ...]
    error: tuple[float | None, float | None] = (None, None)

    def shares(self, x_px: Array, y_px: Array) -> Iterator[tuple[Blur, Array]]:
        """Each response that takes part at some of the places (n,), and its shares (n,).

        Shares are at least 0 and sum to 1 over the responses, to rounding; at a place of the grid
        its own response has all.
        """
        if not len(x_px):
            return
        v, u = _index(self.rows_px, y_px), _index(self.columns_px, x_px)
        for k in self._numbers((v.min(), v.max()), (u.min(), u.max())):
            share = np.zeros(len(x_px))
            for node in np.flatnonzero(np.array(self.which) == k):
                i, j = divmod(int(node), len(self.columns_px))
                share += _hat(v - i) * _hat(u - j)
            yield self.blurs[k], share

    def parts(
        self, x_px: Array, y_px: Array, light: Array
    ) -> Iterator[tuple[Blur, NDArray[np.intp], Array]]:
        """(response, which of the sources have a part in it, that part of their light)."""
        for blur, share in self.shares(x_px, y_px):
            mine = np.flatnonzero(share > 0)
            if mine.size:
                yield blur, mine, light[mine] * share[mine]

    def along(
        self, path: Path, x_px: float, y_px: float, step_px: float
    ) -> Iterator[tuple[Blur, Path, float]]:
        """(response, path with its share of the light of each step, share of all of it) of each
        response that takes part along the path of a source; steps of at most so many px."""
        fine = in_steps(path, step_px)
        x, y = (at + 0.5 * (v[1:] + v[:-1]) for at, v in ((x_px, fine.x_px), (y_px, fine.y_px)))
        for blur, share in self.shares(x, y):
            light = fine.weight * share
            if (total := float(light.sum())) > 0.0:
                yield blur, replace(fine, weight=light / total), total

    def rising(
        self, path: Path, x_px: float, y_px: float
    ) -> Iterator[tuple[Blur, Path, Array, float]]:
        """The same, with the rise of each step's light (n,): steps end where the field has places,
        and along each of them a share is a straight line but for CELL_STEPS^-2 / 6 of it."""
        fine = self._in_cells(path, x_px, y_px)
        x, y = (_with_middles(at + v) for at, v in ((x_px, fine.x_px), (y_px, fine.y_px)))
        for blur, share in self.shares(x, y):
            first, middle, last = share[:-1:2], share[1::2], share[2::2]
            light = fine.weight * (first + 4.0 * middle + last) / 6.0
            if (total := float(light.sum())) > 0.0:
                rise = fine.weight * (last - first) / (2.0 * total)
                yield blur, replace(fine, weight=light / total), rise, total

    def _in_cells(self, path: Path, x_px: float, y_px: float) -> Path:
        """A path cut where it crosses a row or a column of places, and in even steps."""
        cuts, least_px = [], math.inf
        for at, places in ((x_px + path.x_px, self.columns_px), (y_px + path.y_px, self.rows_px)):
            with np.errstate(divide="ignore", invalid="ignore"):
                t = (np.array(places)[:, None] - at[:-1]) / np.diff(at)
            which, of = np.nonzero((t > 0.0) & (t < 1.0))
            cuts.append(of + t[which, of])
            least_px = min(least_px, np.diff(places).min(initial=math.inf))
        return in_steps(cut_at(path, np.concatenate(cuts)), least_px / CELL_STEPS)

    @cached_property
    def steepest(self) -> float:
        """By how much a response changes from pixel to pixel of the field and of its image, at
        most, per unit light: a step of s px that is drawn with the responses of its middle errs by
        s^2 / 12 of it."""
        found = 0.0
        for change in changes_of(self):
            slopes = (np.abs(np.diff(change, axis=axis)).max(initial=0.0) for axis in (-2, -1))
            found = math.hypot(found, SAMPLES * max(slopes))
        return found

    @cached_property
    def _changes(self) -> tuple[float, float, float]:
        """By how much a pixel changes from pixel to pixel of the field, and by how much the pixels
        of a line, and all of them, do together: at most, per unit light."""
        most = line = every = 0.0
        for change in map(np.abs, changes_of(self)):
            lines = max(change.sum(axis=axis).max(initial=0.0) for axis in (-2, -1))
            most = math.hypot(most, float(change.max(initial=0.0)))
            line = math.hypot(line, float(lines) / SAMPLES)
            whole = change.sum(axis=(-2, -1)).max(initial=0.0)
            every = math.hypot(every, float(whole) / SAMPLES**2)
        return most, line, every

    def end_change(self, length_px: float) -> float:
        """What a pixel errs by at the ends of a streak of L px that is drawn with the responses of
        its middle, per unit light F: there they are L/2 changes off; of F/L on each px of the
        streak a pixel sums F/2 of the changes along a line, or, of a short streak, F L/2 of the
        largest."""
        most, line, _ = self._changes
        return 0.5 * min(length_px * most, line)

    def edge_change(self, radius_px: Array, share_px: Array) -> Array:
        """The same (n,) at the edge of discs of R px, where responses are R changes off: of a share
        of the light on each px there a pixel sums half of all changes, which sum to nothing, or, of
        a small disc, R of the largest."""
        most, _, every = self._changes
        return radius_px * np.minimum(most, 0.5 * every * share_px)

    def near(self, y0_px: float, y1_px: float, x0_px: float, x1_px: float) -> tuple[Blur, ...]:
        """The responses that any source in a rectangle of places may have a part in."""
        v = _index(self.rows_px, np.array([y0_px, y1_px]))
        u = _index(self.columns_px, np.array([x0_px, x1_px]))
        return tuple(self.blurs[k] for k in self._numbers((v[0], v[1]), (u[0], u[1])))

    def reason(self, table_mb: float) -> str:
        """What the plan says of it: its grid, its tables [MB], its error between places."""
        errors = dict(zip(("rows", "columns"), self.error, strict=True))
        known = [f"{e:.2g} along {name}" for name, e in errors.items() if e is not None]
        unknown = [name for name, e in errors.items() if e is None]
        told = []
        if known:
            told += [
                f"between places a pixel differs by up to about {' and '.join(known)} of its "
                f"source's light ({SAFETY[1]:g} to {SAFETY[0]:g} times what its second differences "
                "tell)"
            ]
        if unknown:
            told += [f"by how much along {' and '.join(unknown)}, only three places or more tell"]
        return (
            f"{len(self.blurs)} point-spread function(s) at {len(self.rows_px)} x "
            f"{len(self.columns_px)} places, mixed bilinearly where each source stands, in tables "
            f"of up to {table_mb:.3g} MB; {'; '.join(told)}"
        )

    def describe(self) -> JsonObject:
        """The field as plain values, for the plan."""
        return {
            "rows_px": list(self.rows_px),
            "columns_px": list(self.columns_px),
            "optics": [describe(b.optics) for b in self.blurs],
            "which": list(self.which),
            "error_along_rows": self.error[0],
            "error_along_columns": self.error[1],
        }

    def _numbers(self, v: tuple[float, float], u: tuple[float, float]) -> list[int]:
        """Numbers of the responses with a share somewhere in a range of grid units."""
        found = {
            self.which[i * len(self.columns_px) + j]
            for i in range(int(np.floor(v[0])), int(np.ceil(v[1])) + 1)
            for j in range(int(np.floor(u[0])), int(np.ceil(u[1])) + 1)
        }
        return sorted(found)


def _index(places_px: tuple[float, ...], at_px: Array) -> Array:
    """Places (n,) in units of the grid, held to it."""
    return np.interp(at_px, places_px, np.arange(len(places_px), dtype=float))


def _with_middles(values: Array) -> Array:
    """Values (n,) with the mean of each two between them (2 n - 1,)."""
    return np.interp(np.arange(2 * len(values) - 1) / 2.0, np.arange(len(values)), values)


def _hat(t: Array) -> Array:
    """1 at 0, falling linearly to 0 at -1 and 1."""
    return np.maximum(0.0, 1.0 - np.abs(t))


def plan_psf_field(
    scene: Scene,
    psf: FieldPsf,
    response: ResponseCurve,
    mean_m: float,
    tables: tuple[Sampled | None, ...],
    limit: NoiseLimit | None = None,
) -> tuple[PsfField, Blur, BandOptics | None]:
    """The field's responses, the sharpest of them, and the band of the one that errs most by it.

    tables : of each place, row by row, its table of light where it names one
    limit : what the brightest source may err by where a band is resolved
    """
    every = [one for row in psf.psfs for one in row]
    given = tables or (None,) * len(every)
    made: dict[tuple[OnePsf, Sampled | None], tuple[Blur, BandOptics | None]] = {}
    sharpness: dict[Blur, float] = {}
    for node, key in enumerate(zip(every, given, strict=True)):
        if key in made:
            continue
        try:
            blur, band = made[key] = blur_of(scene, key[0], response, mean_m, key[1], limit)
            sharpness[blur] = point_error(blur, SMALL_RADIUS_PX)
        except BadInput as mistake:
            name = psf.name_of(mistake.field, node)
            raise BadInput(name, mistake.value, mistake.allowed) from None
    all_blurs = [made[key][0] for key in zip(every, given, strict=True)]
    blurs = tuple(dict.fromkeys(all_blurs))
    which = tuple(blurs.index(b) for b in all_blurs)
    error = _between(psf.rows_px, psf.columns_px, all_blurs)
    bands = [band for _, band in made.values() if band is not None]
    band = max(bands, key=lambda b: (b.error_sigma, b.error), default=None)
    sharpest = max(blurs, key=sharpness.__getitem__)
    return PsfField(psf.rows_px, psf.columns_px, blurs, which, error), sharpest, band


def _between(
    rows_px: tuple[float, ...], columns_px: tuple[float, ...], blurs: list[Blur]
) -> tuple[float | None, float | None]:
    """Error of bilinear mixtures along both axes, from the responses themselves.

    |R - mixture| <= h_y^2 / 8 max |d2R/dy2| + h_x^2 / 8 max |d2R/dx2| in a cell of h_y x h_x px
    (de Boor, A Practical Guide to Splines, ch. III, axis by axis). The second derivatives are the
    divided differences of three neighbours. They miss what is quicker than the grid and what peaks
    at its edge: with best focus there, the true error was measured at up to 2.7 times theirs with
    three places, 1.7 with five and 1.15 with nine; so SAFETY times theirs is told.
    """
    if max(len(rows_px), len(columns_px)) < 3:
        return None, None
    radius = max(b.core_px for b in blurs)
    images = {b: image_of(b, radius) for b in set(blurs)}
    grid = np.array([images[b] for b in blurs])
    grid = grid.reshape(len(rows_px), len(columns_px), -1)
    return _along(rows_px, grid), _along(columns_px, grid.swapaxes(0, 1))


def image_of(blur: Blur, radius_px: float) -> Array:
    """Light of a pixel at SAMPLES places a pixel around the source, (n, n)."""
    core = compact_core(blur, radius_px)
    step = core.oversampling // SAMPLES
    middle = len(core.samples) // 2
    count = int(radius_px) * SAMPLES
    at = middle + np.arange(-count, count + 1) * step
    return core.samples[np.ix_(at, at)]


@lru_cache(maxsize=1)
def images_of(field: PsfField) -> Array:
    """The light of all places of a field as `image_of` has it, (rows, columns, n, n)."""
    radius_px = max(b.core_px for b in field.blurs)
    images = np.array([image_of(b, radius_px) for b in field.blurs])[list(field.which)]
    return images.reshape(len(field.rows_px), len(field.columns_px), *images.shape[1:])


def changes_of(field: PsfField) -> list[Array]:
    """By how much the light changes from pixel to pixel of the field, per unit light, between
    neighbours along its rows and along its columns: (places - 1, others, n, n) each."""
    grid = images_of(field)
    return [
        np.diff(along, axis=0) / np.diff(places)[:, None, None, None]
        for places, along in ((field.rows_px, grid), (field.columns_px, grid.swapaxes(0, 1)))
        if len(places) > 1
    ]


def _along(places_px: tuple[float, ...], images: Array) -> float | None:
    """SAFETY h^2 / 8 max |d2R| along the first axis of (places, others, samples).

    Over each three neighbours the longer of their two steps counts. None for fewer than 3 places.
    """
    if len(places_px) < 3:
        return None
    safety = SAFETY[0] if len(places_px) < SAFE_FROM else SAFETY[1]
    worst = 0.0
    h = np.diff(places_px)
    for i in range(len(h) - 1):
        left, right = (images[i + k + 1] - images[i + k] for k in range(2))
        second = 2.0 * (right / h[i + 1] - left / h[i]) / (h[i] + h[i + 1])
        worst = max(worst, float(np.abs(second).max()) * max(h[i], h[i + 1]) ** 2 / 8.0)
    return safety * worst
