"""The summed light of a catalogue's stars by direction and magnitude, so that no light is lost.

A scene that draws stars to a limiting magnitude adds the light of the fainter ones as a smooth sky.
The map is made once from the catalogue itself and lies beside it as STARLIGHT_NAME: for each nested
HEALPix pixel and each half magnitude of G, the light in G of the stars that have a colour, its
first and second moment in BP-RP (from which the light in any band follows to 5%, where the ratio of
summed BP to RP light would err by 15 to 35% in blue and infrared bands), and the light of the stars
without a colour. Light is in units of a star of G = 0. Without a map, `CountedLight` takes the
published star counts instead.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..catalogue import Catalogue
from ..columns import HEALPIX_ORDER
from ..engine.schedulers import TASKS_PER_WINDOW, LocalScheduler, Scheduler
from ..errors import NO_ROOM, BadInput, Damaged, DiskFull
from ..geometry.healpix_interpolation import neighbours
from ..star_counts import EDGES_G_MAG, all_sky_count, interval_density
from ..storage.durable import MAKE_ROOM, whole_file
from ..storage.stores import LocalStore, Unreachable
from .query import read_leaf

Floats = NDArray[np.float64]
Progress = Callable[[str, int, int], None]  # stage, done, total

STARLIGHT_NAME = "nightglass/starlight.npz"
FORMAT, VERSION = "nightglass/starlight", 1
BIN_EDGES_G_MAG = np.arange(3.0, 22.01, 0.5)  # with an open bin at either end: 40 bins
BINS = BIN_EDGES_G_MAG.size + 1
KINDS = ("g", "g_colour", "g_colour_squared", "g_without_colour")
LEAST_COLOUR_MAG, LARGEST_COLOUR_MAG = -1.0, 6.0  # no star is beyond: its colour is a mistake
COARSE_ORDER, FINE_ORDER, FINE_ROWS = 6, 7, 100_000_000
PART_ROWS = 200_000  # read together
COLUMNS = ("_healpix_29", "phot_g_mean_mag", "phot_bp_mean_mag", "phot_rp_mean_mag")
DEG2_SR = (np.pi / 180.0) ** 2

# (G, mean and scatter of BP-RP, weighted by light) of 5300 real DR2 stars: all that have a colour
# in the complete 2.5 deg2 at RA 0.7, Dec -1 (galactic latitude -61; dust reddens the plane more).
COUNTED_COLOURS_MAG = (
    (8.5, 0.91, 0.27),
    (11.5, 0.96, 0.29),
    (14.5, 1.06, 0.34),
    (17.0, 1.40, 0.56),
    (19.5, 1.70, 0.65),
)
COUNTED_ERROR = 0.35  # of the counts' densities (star_counts)


@dataclass(frozen=True)
class SummedStarlight:
    """Summed light of stars per steradian, in n directions; a star of G = 0 is 1.

    g, g_colour, g_colour_squared : (n,) of stars with a colour: their light, times BP-RP, times its
        square; g_without_colour : (n,) of the others
    g_squared : (n,) sum of the squares of G light: what their graininess rests on
    g_error : (n,) how far g + g_without_colour may be off, as `StarlightMap.fainter` says
    """

    g: Floats
    g_colour: Floats
    g_colour_squared: Floats
    g_without_colour: Floats
    g_squared: Floats
    g_error: Floats


class Starlight(Protocol):
    """Where the light of stars that are not drawn comes from."""

    @property
    def source(self) -> str: ...
    def fainter(self, limit_g_mag: float, directions: Floats) -> SummedStarlight: ...


@dataclass(frozen=True)
class StarlightMap:
    """The light of one catalogue: float32 (BINS, 4 of KINDS, 12 4**order), per pixel."""

    order: int
    light: NDArray[np.float32]
    catalogue_digest: str

    @property
    def source(self) -> str:
        return f"the catalogue's own map of order {self.order}"

    def fainter(self, limit_g_mag: float, directions: Floats) -> SummedStarlight:
        """Light per sr of the catalogue's stars of G above a limit, at unit vectors (n, 3).

        Between pixel centres it is interpolated (bilinear). A limit on an edge of
        BIN_EDGES_G_MAG is exact; inside a bin the light is taken as even in magnitude, and
        `g_error` is what a slope like that to the neighbouring bins would change, and twice the
        scatter of a cut through so few stars (it is 0 on an edge, and beyond the edges all or
        nothing is taken). The pixels' own size is an error that this does not hold: the light is
        as smooth as their 0.9 deg (order 6) or 0.5 deg (order 7).
        """
        pixels, weights = neighbours(self.order, directions)
        sr = 4.0 * np.pi / self.light.shape[-1]
        first, share = _shares(limit_g_mag)
        few, place = np.unique(pixels, return_inverse=True)
        bins = self.light[max(first - 1, 0) :, :, few].astype(float) / sr
        white = bins[:, 0] + bins[:, 3]
        here = min(first, 1)  # the limit's bin among these
        cut = share[0] * (1.0 - share[0])
        own = _typical_light()[first:]
        error = 2.0 * np.sqrt(cut * white[here] * own[0] / sr)
        error += np.abs(white[0] - white[min(here + 1, len(white) - 1)]) * cut / 4.0
        sums = np.vstack(
            [
                np.tensordot(share, bins[here:], axes=(0, 0)),
                np.tensordot(share * own, white[here:], axes=(0, 0))[None],
                error[None],
            ]
        )
        place = place.reshape(pixels.shape)
        return SummedStarlight(*(np.sum(row[place] * weights, axis=0) for row in sums))


@dataclass(frozen=True)
class CountedLight:
    """Light from the published star counts, between two magnitudes: at most 3 and 21.

    Clusters, galaxies and single dust clouds are not in it. in_no_catalogue : they are stars that
    cannot be drawn, whatever the limit; they then have no graininess that drawing could keep.
    """

    brightest_g_mag: float = float(EDGES_G_MAG[0])
    faintest_g_mag: float = float(EDGES_G_MAG[-1])
    in_no_catalogue: bool = False

    @property
    def source(self) -> str:
        return (
            f"published star counts of G {self.brightest_g_mag:.1f} to {self.faintest_g_mag:.1f} "
            "(densities good to 35%, no clusters)"
        )

    def fainter(self, limit_g_mag: float, directions: Floats) -> SummedStarlight:
        """As `StarlightMap.fainter`; densities are good to 35%, which is its `g_error`."""
        limit = self.brightest_g_mag
        if not self.in_no_catalogue:
            limit = max(limit, limit_g_mag)
        g, first_moment, second_moment, squared = np.zeros((4, len(directions)))
        for i, (bright, faint) in enumerate(pairwise(EDGES_G_MAG)):
            if faint > limit and bright < self.faintest_g_mag:
                density = interval_density(i, directions) / DEG2_SR
                span = (max(limit, float(bright)), min(self.faintest_g_mag, float(faint)))
                one, two = _mean_light(float(bright), float(faint), *span)
                at, mean, scatter = np.transpose(COUNTED_COLOURS_MAG)
                colour = np.interp(0.5 * (bright + faint), at, mean)
                spread = np.interp(0.5 * (bright + faint), at, scatter)
                g, squared = g + density * one, squared + density * two
                first_moment += density * one * colour
                second_moment += density * one * (colour**2 + spread**2)
        none = np.zeros_like(g)
        squared = none if self.in_no_catalogue else squared
        return SummedStarlight(g, first_moment, second_moment, none, squared, COUNTED_ERROR * g)


@dataclass(frozen=True)
class AddedLight:
    """The sum of several sources of light that hold no star in common."""

    parts: tuple[Starlight, ...]

    @property
    def source(self) -> str:
        return " and ".join(part.source for part in self.parts)

    def fainter(self, limit_g_mag: float, directions: Floats) -> SummedStarlight:
        lights = [part.fainter(limit_g_mag, directions) for part in self.parts]
        names = SummedStarlight.__dataclass_fields__
        return SummedStarlight(
            **{name: np.sum([getattr(x, name) for x in lights], axis=0) for name in names}
        )


def make_starlight(
    catalogue: Catalogue,
    *,
    order: int | None = None,
    scheduler: Scheduler | None = None,
    progress: Progress | None = None,
) -> StarlightMap:
    """Sum the light of all stars of a catalogue, and put the map beside it.

    order : of the pixels; by default 6, or 7 from 100 million rows. scheduler : of `schedulers`
    (default: two threads). Memory: the map, and some 20 MB a worker. Raises BadInput for a
    catalogue that is not in a local folder or cannot be written to, Damaged for a damaged one.
    """
    if not isinstance(catalogue.store, LocalStore):
        allowed = "a catalogue in a local folder (a map that lies beside it is copied with it)"
        raise BadInput("catalogue", catalogue.path, allowed)
    if order is None:
        order = FINE_ORDER if catalogue.rows >= FINE_ROWS else COARSE_ORDER
    if not 0 <= order <= 9:
        raise BadInput("order", order, "0 to 9")
    scheduler = scheduler or LocalScheduler("threads", 2)
    shared = scheduler.share(catalogue)
    state = {"done": 0}

    def done(kind: str) -> None:
        state["done"] += 1
        if progress is not None:
            progress(kind, state["done"], catalogue.leaf_table.size)

    light = np.zeros((BINS, len(KINDS), 12 * 4**order), np.float32)
    for start in range(0, catalogue.leaf_table.size, TASKS_PER_WINDOW):
        leaves = range(start, min(start + TASKS_PER_WINDOW, catalogue.leaf_table.size))
        graph = {("starlight", i): (leaf_light, shared, i, order) for i in leaves}
        for first, found in scheduler.run(graph, list(graph), done):
            light[..., first : first + found.shape[-1]] += found
    made = StarlightMap(order, light, catalogue.digest)
    _write(Path(catalogue.path) / STARLIGHT_NAME, made)
    return made


def leaf_light(catalogue: Catalogue, index: int, order: int) -> tuple[int, NDArray[np.float32]]:
    """The light of one leaf's stars: its first pixel of an order, and (BINS, 4, pixels)."""
    leaf = catalogue.leaf(index)
    below = 2 * (order - leaf.order)
    first = leaf.pixel << below if below >= 0 else leaf.pixel >> -below
    pixels = 1 << max(below, 0)
    sums = np.zeros(BINS * len(KINDS) * pixels)
    groups = leaf.row_groups
    ends = np.cumsum([group.rows for group in groups]) // PART_ROWS
    for part in np.unique(ends):
        some = tuple(g for g, at in zip(groups, ends, strict=True) if at == part)
        rows = read_leaf(catalogue, leaf._replace(row_groups=some), columns=COLUMNS)
        place, g, bp, rp = (rows[name].to_numpy(zero_copy_only=False) for name in COLUMNS)
        if not np.isfinite(g).all():
            raise Damaged(f"{catalogue.path}/{leaf.path}", "holds a star without a G magnitude")
        pixel = (place >> (2 * (HEALPIX_ORDER - order))) - first
        bins = np.searchsorted(BIN_EDGES_G_MAG, g.astype(float), side="left")
        coloured = np.isfinite(bp) & np.isfinite(rp)
        own = 10.0 ** (-0.4 * g.astype(float))
        colour = np.clip(bp.astype(float) - rp, LEAST_COLOUR_MAG, LARGEST_COLOUR_MAG)
        one = np.ones_like(own)
        for kind, (factor, which) in enumerate(
            ((one, coloured), (colour, coloured), (colour**2, coloured), (one, ~coloured))
        ):
            at = (bins[which] * len(KINDS) + kind) * pixels + pixel[which]
            sums += np.bincount(at, (own * factor)[which], sums.size)
    return first, sums.reshape(BINS, len(KINDS), pixels).astype(np.float32)


def read_starlight(catalogue: Catalogue) -> StarlightMap | None:
    """The map that lies beside a catalogue, proved by its digests; None where there is none.

    Raises Damaged for a map that is not as it was written, or belongs to other stars.
    """
    where = f"{catalogue.path}/{STARLIGHT_NAME}"
    again = "make it again with `nightglass catalog starlight CATALOGUE`"
    try:
        data = catalogue.store.read(STARLIGHT_NAME)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except Unreachable as error:
        raise BadInput("catalogue", catalogue.path, f"a place that can be read ({error})") from None
    except OSError as error:
        raise Damaged(where, f"cannot be read ({error}); {again}") from None
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            about = json.loads(arrays["about"].tobytes())
            light = arrays["light"]
    except (zipfile.BadZipFile, KeyError, ValueError, OSError, EOFError) as error:
        raise Damaged(where, f"is no map of starlight ({error}); {again}") from None
    if (about.get("format"), about.get("version")) != (FORMAT, VERSION):
        raise Damaged(where, f"is of another format; {again}")
    if about["catalogue"] != catalogue.digest:
        raise Damaged(where, f"was made from other stars than the catalogue's; {again}")
    shape = (BINS, len(KINDS), 12 * 4 ** int(about["order"]))
    if light.shape != shape or hashlib.sha256(light.tobytes()).hexdigest() != about["sha256"]:
        raise Damaged(where, f"its content does not match its digest; {again}")
    return StarlightMap(int(about["order"]), light, catalogue.digest)


def _write(path: Path, made: StarlightMap) -> None:
    """The file appears whole under its name, or not at all."""
    about = {
        "format": FORMAT,
        "version": VERSION,
        "catalogue": made.catalogue_digest,
        "order": made.order,
        "sha256": hashlib.sha256(made.light.tobytes()).hexdigest(),
        "kinds": KINDS,
        "bin_edges_g_mag": BIN_EDGES_G_MAG.tolist(),
    }
    text = np.frombuffer(json.dumps(about, sort_keys=True).encode(), np.uint8)
    try:
        with whole_file(path) as part, part.open("wb") as file:
            np.savez_compressed(file, about=text, light=made.light)
    except OSError as error:
        if error.errno in NO_ROOM:
            raise DiskFull(str(path), error.errno, MAKE_ROOM) from error
        raise BadInput("catalogue", str(path.parent), f"a folder to write to ({error})") from None


def _shares(limit_g_mag: float) -> tuple[int, Floats]:
    """The bin that holds a limit, and the share of its and each later bin's light that is fainter.

    A limit in an open bin takes all of the bright one, and nothing of the faint one.
    """
    first = int(np.searchsorted(BIN_EDGES_G_MAG, limit_g_mag, side="left"))
    share = np.ones(BINS - first)
    if limit_g_mag >= BIN_EDGES_G_MAG[-1]:
        return BINS - 1, np.full(1, float(limit_g_mag == BIN_EDGES_G_MAG[-1]))
    if first > 0:
        low, high = BIN_EDGES_G_MAG[first - 1 : first + 1]
        share[0] = (high - limit_g_mag) / (high - low)
    return first, share


def _typical_light() -> Floats:
    """G light (BINS,) of a star in the middle of each bin; of its edge where it is open."""
    middles = 0.5 * (BIN_EDGES_G_MAG[1:] + BIN_EDGES_G_MAG[:-1])
    return 10.0 ** (-0.4 * np.concatenate([BIN_EDGES_G_MAG[:1], middles, BIN_EDGES_G_MAG[-1:]]))


def _mean_light(bright: float, faint: float, low: float, high: float) -> tuple[float, float]:
    """Light, and its square, of the stars between two magnitudes inside an interval, per star of
    the whole interval; they grow in number as over the whole sky."""
    counts = np.log(all_sky_count([bright, faint]))
    slope = float(counts[1] - counts[0]) / (faint - bright)
    m = np.linspace(low, high, 65)
    growth = np.exp(slope * (m - bright))
    light = 10.0 ** (-0.4 * m)
    number = np.expm1(slope * (faint - bright)) / slope
    return (
        float(np.trapezoid(growth * light, m)) / number,
        float(np.trapezoid(growth * light**2, m)) / number,
    )
