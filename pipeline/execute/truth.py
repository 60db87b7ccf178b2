"""Truth of one frame: what was drawn, where, how bright, at what signal-to-noise."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, FrameStars, Geometry
from pipeline.execute.body_pixels import body_pixels
from pipeline.execute.sources import (
    FrameTarget,
    place_targets,
    reaching,
    setting_stars,
    streaks,
    zone_of,
)
from pipeline.execute.tables import swept_core
from pipeline.lazily import arrow
from pipeline.physics.motion.points import in_fewer_points
from pipeline.physics.motion.rolling import row_delay_s
from pipeline.physics.motion.streak import Path, piece_counts, pieces
from pipeline.physics.positions.apparent import proper_to_astrometric
from pipeline.physics.positions.focal_plane import deproject
from pipeline.physics.positions.refraction import unrefract
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.response import stamp_at
from pipeline.physics.targets.disc import Appearance
from pipeline.physics.vectors import to_angles
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.occultation import hidden_by, targets_seen
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.response.own_paths import offsets_in_parts
from pipeline.plan.response.streaks import Streak

Columns = dict[str, Any]

ROW = 1 << 32  # from a pixel's number to that of the one above it
MOST_PIECES = 256  # of a path whose SNR counts each of its pixels once
MOST_VALUES = 1 << 22  # of a streak's pixels at several lights, held at a time
ZONES_PX = 2e-4  # that paths may be off where truth tells them from their zones
LENGTHS, ALIKE = 9, 0.01  # of streaks, by whose arcsinh SNR is tabulated where it differs by more


def star_truth(plan: Plan, g: Geometry, stars: FrameStars) -> Columns:
    """Columns of truth/stars.parquet for one frame; `stars` in `truth_order`.

    x_px, y_px at mid-exposure (pixel (0, 0) is the centre of the first), start and end of its own
    path, x_light_px, y_light_px the centroid of its light (without what an uneven response moves
    all light by), ra/dec astrometric (what the WCS gives), electrons that pixels collect
    (`collected_e`), matched-filter SNR of the isolated source; catalogue is 0 for the main one,
    then counts the layers.
    """
    paths = streaks(plan, g)
    zones = zone_of(plan, stars.x_px, stars.y_px)
    ends, light = _followed(plan, g, paths, zones, stars)
    snr = _star_snr(plan, paths, zones, stars, int(g.frame[0]))
    light[:, stars.visible_fraction <= 0.0] = np.nan
    for star in setting_stars(plan, g, stars):
        i, path = star.index, star.path
        ends[:, i] = path.x_px[0], path.y_px[0], path.x_px[-1], path.y_px[-1]
        light[:, i] = np.array(_centroid(star)) - (star.x_px, star.y_px)
        snr[i] = snr_of(plan, star, int(g.frame[0]))
    rows, columns = plan.camera.rows, plan.camera.columns
    inside = (np.abs(stars.x_px - (columns - 1) / 2) <= columns / 2) & (
        np.abs(stars.y_px - (rows - 1) / 2) <= rows / 2
    )
    return {
        "frame": np.full(len(stars), g.frame[0], np.int32),
        "source_id": stars.source_id,
        "x_px": stars.x_px,
        "y_px": stars.y_px,
        "x_start_px": stars.x_px + ends[0],
        "y_start_px": stars.y_px + ends[1],
        "x_end_px": stars.x_px + ends[2],
        "y_end_px": stars.y_px + ends[3],
        "x_light_px": stars.x_px + light[0],
        "y_light_px": stars.y_px + light[1],
        "ra_deg": np.degrees(stars.ra_rad),
        "dec_deg": np.degrees(stars.dec_rad),
        "g_mag": stars.g_mag,
        "electrons": collected_e(plan, stars.light_e),
        "snr": snr,
        "colour_flag": stars.colour_flag,
        "in_frame": inside,
        "catalogue": stars.catalogue,
        **_hidden(plan, stars.visible_fraction),
    }


def _followed(
    plan: Plan, g: Geometry, paths: list[Streak], zones: NDArray[np.intp], stars: FrameStars
) -> tuple[Array, Array]:
    """Start and end (4, n) of the paths of stars and the centroid of their light (2, n), from
    their places at mid-exposure: interpolated across their zones, or each by itself where that
    would be off. What interpolation errs by in a zone grows beside it like u (u^2 - 1)."""
    ends, light = np.zeros((4, len(stars))), np.zeros((2, len(stars)))
    alone, own_px = np.zeros(len(stars), bool), plan.responses.streaks.own_px
    for zone in np.unique(zones):
        mine, s = zones == zone, paths[zone]
        x, y = stars.x_px[mine], stars.y_px[mine]
        ends[:, mine] = [*s.at(s.start, x, y), *s.at(s.end, x, y)]
        light[:, mine] = sum(p.share * np.array(s.at(p.centre, x, y)) for p in s.pieces)
        beyond = np.abs(s.zone.uv(x, y)).max(axis=0)
        alone[mine] = own_px * np.maximum(1.0, 2.6 * beyond * (beyond**2 - 1.0)) > ZONES_PX
    which = np.flatnonzero(alone)
    aberration, changes = plan.scene.star_effects["aberration"], plan.responses.streaks.light
    places = stars.x_px[which], stars.y_px[which]
    for some, offsets in offsets_in_parts(plan.camera, g, *places, aberration, changes):
        ends[:, which[some]] = *offsets[..., 0], *offsets[..., -1]
        light[:, which[some]] = 0.5 * (offsets[..., 1:] + offsets[..., :-1]).mean(axis=-1)
    return ends, light


def _star_snr(
    plan: Plan, paths: list[Streak], zones: NDArray[np.intp], stars: FrameStars, frame: int
) -> Array:
    """Matched-filter SNR of stars (n,) in zones (n,), each of the length of its own streak.

    Where all are as long, to ALIKE, along that in the middle; else along the longest of the zones'
    middles, scaled to LENGTHS lengths, between which the logarithm is interpolated.
    """
    sources, known = (stars.light_e, stars.x_px, stars.y_px), plan.responses.streaks
    if math.asinh(known.longest_px) - math.asinh(known.shortest_px) <= ALIKE:
        return matched_snr(plan, paths[len(paths) // 2].path, *sources, frame)
    length_px = np.zeros(len(stars))
    for zone in np.unique(zones):
        mine = zones == zone
        length_px[mine] = paths[zone].lengths_px(stars.x_px[mine], stars.y_px[mine])
    scale = np.arcsinh(length_px)
    if not len(scale) or np.ptp(scale) <= ALIKE:
        return matched_snr(plan, paths[len(paths) // 2].path, *sources, frame)
    path, whole_px = _scaled_path(paths, zones, stars, length_px)
    nodes = np.linspace(scale.min(), scale.max(), LENGTHS)
    found = np.array([
        matched_snr(plan, path.scaled(math.sinh(node) / whole_px), *sources, frame)
        for node in nodes
    ])  # fmt: skip
    at = (scale - nodes[0]) / (nodes[1] - nodes[0])
    low = np.minimum(at.astype(np.intp), LENGTHS - 2)
    which = np.arange(len(scale))
    share, lit = at - low, stars.light_e > 0.0
    one, other = (
        np.log(found[k, which], where=lit, out=np.zeros(len(lit))) for k in (low, low + 1)
    )
    return np.where(lit, np.exp((1.0 - share) * one + share * other), 0.0)


def _scaled_path(
    paths: list[Streak], zones: NDArray[np.intp], stars: FrameStars, length_px: Array
) -> tuple[Path, float]:
    """The path that stands for all lengths, and its own: the longest of the zones' middles, or in a
    field that turns about one of them that of the star (n,) with the longest."""
    longest = max(paths, key=lambda s: s.path.length_px)
    whole_px = float(longest.lengths_px(*longest.zone.places(np.zeros(1), np.zeros(1)))[0])
    i = int(np.argmax(length_px))
    if 2.0 * whole_px >= length_px[i]:
        return longest.path, whole_px
    x, y = paths[zones[i]].places_px(stars.x_px[[i]], stars.y_px[[i]])[:, :, 0].T
    return Path(x, y, np.full(len(x) - 1, 1.0 / (len(x) - 1))), float(length_px[i])


def _hidden(plan: ResolvedScene, seen: Array) -> Columns:
    """Columns of what the Earth hides: what stands before sources (n,), and how much is seen."""
    pa = arrow()
    index = pa.array(np.zeros(len(seen), np.int8), mask=seen >= 1.0)
    names = pa.array([hidden_by(plan.scene)])
    return {
        "hidden_by": pa.DictionaryArray.from_arrays(index, names),
        "visible_fraction": seen.astype(np.float32),
    }


def collected_e(plan: ResolvedScene, light_e: Array) -> Array:
    """Truth's electrons (n,) of the light (n,) that falls on an unbounded focal plane [e-].

    What its pixels collect: the fill factor of the light, the mean over places within a pixel (of a
    response as sharp as the gaps between pixels a single place collects more or less). Before the
    flat, dead pixels and the full well.
    """
    return light_e * plan.responses.blur.fill_factor


def target_truth(plan: ResolvedScene, g: Geometry, everywhere: bool = True) -> Columns:
    """Columns of truth/targets.parquet for one frame: every target, also those not in view.

    everywhere : with the light of those that send none onto the frame

    x_px, y_px is the body's centre at mid-exposure, x_light_px, y_light_px the centroid of its
    light over the exposure (NaN where none is drawn): they differ where a body of visible size is
    lit from a side, and where it brightens, turns or bends while it is exposed. snr is that of all
    its light, as if the focal plane had no end; 0 where none of it can reach the frame. hidden_by
    and visible_fraction as of stars; the path of one that the Earth hides for a part of the
    exposure begins and ends where it is seen. v_mag, mag_ab : see `target_magnitudes`;
    object_name : what a catalogue calls it, or its name.
    """
    middle, count = g.middle, len(plan.scene.targets)
    drawn = {t.index: t for t in place_targets(plan, g, everywhere)}
    shown = [drawn.get(i) for i in range(count)]
    effects = plan.scene.star_effects
    proper = unrefract(g.target_direction[:, 0], g.air_at(0, middle))
    direction = proper_to_astrometric(proper, g.observer_at(0, middle), **effects)
    ra, dec = to_angles(direction)
    apparent_ra, apparent_dec = to_angles(g.target_direction[:, 0])
    near, frame = set(reaching(plan, g)), int(g.frame[0])
    snr = _each(shown, lambda t: snr_of(plan, t, frame) if t.index in near else 0.0)
    centroid = np.array([_centroid(t) for t in shown]).reshape(-1, 2)
    v_mag, mag_ab = target_magnitudes(plan, g)
    x, y = g.target_x_px[:, 0], g.target_y_px[:, 0]
    ends = np.stack([x[:, 0], y[:, 0], x[:, -1], y[:, -1]])
    visible = targets_seen(g)
    for i, t in drawn.items():
        if 0.0 < visible[i] < 1.0:
            px, py = x[i, middle] + t.path.x_px, y[i, middle] + t.path.y_px
            ends[:, i] = px[0], py[0], px[-1], py[-1]
    with np.errstate(invalid="ignore"):
        inside = np.abs(x[:, middle] - (plan.camera.columns - 1) / 2) <= plan.camera.columns / 2
        inside &= np.abs(y[:, middle] - (plan.camera.rows - 1) / 2) <= plan.camera.rows / 2
    return {
        "frame": np.full(count, g.frame[0], np.int32),
        "name": [t.name for t in plan.scene.targets],
        "object_name": [t.object_name or t.name for t in plan.scene.targets],
        "x_px": x[:, middle],
        "y_px": y[:, middle],
        "x_start_px": ends[0],
        "y_start_px": ends[1],
        "x_end_px": ends[2],
        "y_end_px": ends[3],
        "x_light_px": centroid[:, 0],
        "y_light_px": centroid[:, 1],
        "ra_deg": np.degrees(ra),
        "dec_deg": np.degrees(dec),
        "apparent_ra_deg": np.degrees(apparent_ra),
        "apparent_dec_deg": np.degrees(apparent_dec),
        "range_m": g.target_range_m[:, 0, middle],
        "phase_deg": np.degrees(g.target_phase_rad[:, 0, middle]),
        "sunlit_fraction": g.target_sunlit[:, 0, middle],
        "electrons": collected_e(plan, _each(shown, lambda t: t.light_e)),
        "v_mag": v_mag,
        "mag_ab": mag_ab,
        "radius_px": _each(shown, lambda t: t.radius_px),
        "extended": _each(shown, lambda t: t.body is not None, False),
        "snr": snr,
        "in_frame": inside,
        **_hidden(plan, visible),
    }


def _each(
    targets: list[FrameTarget | None], value: Callable[[FrameTarget], Any], absent: Any = 0.0
) -> Array:
    """A value of each target (n,), and what stands for it where a target is not drawn."""
    return np.array([absent if t is None else value(t) for t in targets])


def target_magnitudes(plan: ResolvedScene, g: Geometry) -> tuple[Array, Array]:
    """V (Vega) and AB in the sensor's band (n,) of targets, above the air, mean of the exposure.

    The light that arrives is a fraction of the Sun's at 1 au, all through the band: V is that of
    sunlight (-26.76) dimmed by it, so of a body whose albedo in V is that in the band; AB is of the
    electrons that the band makes of it. NaN where no light is sent.
    """
    light = g.target_light[:, 0]
    mean = 0.5 * (light[:, :-1] + light[:, 1:]).mean(axis=-1)
    if plan.camera.line_s:  # their rows followed them for longer, or for less: that is no magnitude
        y = g.target_y_px[:, 0][:, [0, -1]]
        late_s = np.diff(row_delay_s(y, plan.camera.line_s, plan.camera.rows))[:, 0]
        took_s = float(g.offset_s[0, -1] - g.offset_s[0, 0]) or math.inf
        mean = mean / (1.0 + np.nan_to_num(late_s) / took_s)
    with np.errstate(divide="ignore", invalid="ignore"):
        dim = np.where(mean > 0.0, -2.5 * np.log10(mean), np.nan)
        sun_ab = -2.5 * np.log10(plan.sun_rate_e_s_m2 / plan.facts.ab_rate_e_s_m2)
    from pipeline.physics.sky.moon import SUN_V_MAG  # no sky is loaded for stars alone

    return SUN_V_MAG + dim, sun_ab + dim


def _centroid(t: FrameTarget | None) -> tuple[float, float]:
    """Where the middle of a target's drawn light is [px]; NaN for one that is not drawn."""
    if t is None:
        return math.nan, math.nan
    path, total = t.path, float(t.path.weight.sum())
    at = [
        float(np.sum(0.5 * (n[1:] + n[:-1]) * path.weight)) / total for n in (path.x_px, path.y_px)
    ]
    off_x, off_y = 0.0, 0.0
    if t.body is not None:
        y0, y1, x0, x1 = t.body.box
        y, x, share = t.body.points(1.0 / max(y1 - y0, x1 - x0, 1.0))
        off_x, off_y = float(share @ x), float(share @ y)
    return t.x_px + at[0] + off_x, t.y_px + at[1] + off_y


def snr_of(plan: ResolvedScene, t: FrameTarget, frame: int) -> float:
    """Signal-to-noise of one target, of a body by the pixels of its picture."""
    at = np.array([t.light_e]), np.array([t.x_px]), np.array([t.y_px])
    return float(matched_snr(plan, t.path, *at, frame, t.body)[0])


def matched_snr(
    plan: ResolvedScene,
    path: Path,
    light_e: Array,
    x_px: Array,
    y_px: Array,
    frame: int = 0,
    body: Appearance | None = None,
) -> Array:
    """Signal-to-noise of isolated sources under a matched filter, (n,); places in frame pixels.

    SNR^2 = sum (F p)^2 / (sigma0^2 + F p) over the pixels of the source's own response p, spread
    over its picture where it is a body that shows its size; F light,
    sigma0 the noise of a pixel without it, with the frame's own integration time and its sky at the
    source's place; light and sky after the typical flat, the detector's noise and dark those of a
    typical pixel; without photon noise sigma0 alone. Evaluated on a grid of log F / sigma0^2 and
    interpolated (error < 1e-3). Over a field, that of the responses around is interpolated, which
    is an upper bound.
    """
    snr, lit = np.zeros(len(light_e)), np.flatnonzero(plan.facts.flat * light_e > 0.0)
    if not len(lit):
        return snr
    light, x, y = light_e[lit], x_px[lit], y_px[lit]
    floor_e2 = plan.snr_floor_e2(frame, x, y)
    for blur, which, share in plan.responses.parts(x, y, np.ones(len(lit))):
        seen = _response_at_centre(plan, blur, path, body)
        snr[lit[which]] += share * _matched_snr(plan, seen, light[which], floor_e2[which])
    return snr


def brightest_pixel_e(plan: ResolvedScene, t: FrameTarget, frame: int) -> float:
    """Charge [e-] that a target leaves in its brightest pixel, with what is there without it: as if
    pixels held any charge. At one phase of its response, as its SNR."""
    at = np.array([t.light_e]), np.array([t.x_px]), np.array([t.y_px])
    peak_e = float(plan.empty_e(plan.sky_e_s(frame, *at[1:]), frame)[0])
    for blur, _, share in plan.responses.parts(at[1], at[2], plan.facts.flat * at[0]):
        peak_e += float(share[0]) * float(_response_at_centre(plan, blur, t.path, t.body)[0].max())
    return peak_e


def _matched_snr(
    plan: ResolvedScene,
    seen: tuple[Array, Array | float],
    light_e: Array,
    floor_e2: Array,
) -> Array:
    """Signal-to-noise (n,) of sources that shine, before noise of these variances.

    seen : the values of one response's pixels, and how often each of them occurs

    That of light F before sigma0 is sigma0 times that of F / sigma0^2 before 1: one curve for all.
    """
    response, times = seen
    at = np.log(plan.facts.flat * light_e / floor_e2)
    low, high = at.min(), at.max()
    grid = np.linspace(low, high, 128 if high > low else 1)
    snr = np.zeros(len(grid))
    rows = max(1, MOST_VALUES // max(1, response.size))
    for first in range(0, len(grid), rows):
        part = slice(first, first + rows)
        signal = np.exp(grid[part])[:, None] * response[None, :]
        own = signal if plan.scene.sensor.photon_noise else 0.0
        snr[part] = np.sqrt(np.sum(times * signal**2 / (1.0 + own), axis=1))
    return np.asarray(np.sqrt(floor_e2) * np.exp(np.interp(at, grid, np.log(snr))))


def _response_at_centre(
    plan: ResolvedScene, blur: Blur, path: Path, body: Appearance | None = None
) -> tuple[Array, Array | float]:
    """Pixel values (m,) of the core response for a source swept along a path, at one phase, and
    how often each of them occurs.

    Of a path of more than MOST_PIECES pieces each different one is drawn once, by itself: their
    ends, where two of them share pixels, are a small part of it, and so is the size of a body.
    """
    radius, path = plan.responses.usual_px, in_fewer_points(path, plan.responses.band)
    counts = piece_counts(path)
    if sum(count for *_, count in counts) > MOST_PIECES:
        values = [share * _kept(blur, radius, piece)[2] for piece, share, _ in counts]
        times = [np.full(len(v), float(n)) for v, (*_, n) in zip(values, counts, strict=True)]
        return np.concatenate(values), np.concatenate(times)
    number, value = lit_pixels(plan, blur, path)
    return (value, 1.0) if body is None else body_pixels(body, *rows_and_columns(number), value)


def lit_pixels(
    plan: ResolvedScene, blur: Blur, path: Path, x_px: float = 0.0, y_px: float = 0.0
) -> tuple[NDArray[np.int64], Array]:
    """Numbers (m,) of the pixels that a source lights along a path, and their values (m,).

    x_px, y_px : of the path's reference point
    """
    places, values = [], []
    for x0, y0, piece, share in pieces(path):
        row, column, value = _kept(blur, plan.responses.usual_px, piece, y_px + y0, x_px + x0)
        places.append(row.astype(np.int64) * ROW + column)
        values.append(share * value)
    number, index = np.unique(np.concatenate(places), return_inverse=True)
    return number, np.bincount(index, weights=np.concatenate(values)).astype(np.float64)


def rows_and_columns(number: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns (m,) of the numbers of pixels that `lit_pixels` gives."""
    row = (number + ROW // 2) // ROW
    return row, number - row * ROW


def _kept(
    blur: Blur, radius_px: float, piece: Path, y0: float = 0.0, x0: float = 0.0
) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Rows, columns and values (m,) of the pixels that a piece lights."""
    row, column, stamp = stamp_at(*swept_core(blur, radius_px, piece), y0, x0)
    r, c = np.nonzero(stamp > 1e-7 * stamp.max())
    return row + r, column + c, stamp[r, c]


def world_of(plan: ResolvedScene, g: Geometry, index: int = 0) -> Any:
    """Function from pixels (x, y) to astrometric directions (n, 3) of frame `index` of `g`."""
    middle, effects = g.middle, plan.scene.star_effects
    observer = g.observer_at(index, middle)

    def to_world(x_px: Array, y_px: Array) -> Array:
        observed = deproject(plan.camera, g.attitude[index, middle], x_px, y_px)
        proper = unrefract(observed, g.air_at(index, middle))
        return proper_to_astrometric(proper, observer, **effects)

    return to_world
