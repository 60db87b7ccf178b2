"""A library of recorded cosmic rays beside the generator: sizes, charges, rates, and a figure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.lazily import blank_figure
from pipeline.physics.cosmic_rays.deposit import add_tracks, reach_px
from pipeline.physics.cosmic_rays.library import Library
from pipeline.physics.cosmic_rays.tracks import Flux, draw_tracks, mean_count
from pipeline.physics.noise.streams import stream_key
from pipeline.spec.sensor.cosmic_rays import GROUND_RATE_PER_CM2_S, MUON_ZENITH_POWER

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

FRAME_PX = 1000  # side of the frames that the generator fills
THUMB_PX, THUMB_ROWS, THUMB_COLUMNS = 32, 3, 9  # sheets of single events
THUMB_LEAST_PX = 5  # with so many pixels or more
STRAIGHT_PX = 10  # extent from which charge over length is taken
COLOURS = {
    "recorded": "#000000",
    "muons (cos² of the angle to the normal)": "#0072B2",
    "isotropic": "#D55E00",
}


@dataclass(frozen=True)
class Events:
    """Measures of events above a threshold per pixel, (n,) each, and some of their images.

    pixels : above the threshold; extent_px : diagonal of their box between pixel centres;
    electrons : in them; rate_per_cm2_min : of all; images : some, in squares of THUMB_PX
    """

    pixels: Array
    extent_px: Array
    electrons: Array
    rate_per_cm2_min: float
    images: list[Array]


def compare_library(
    library: Library,
    pixel_pitch_um: float,
    thickness_um: float,
    diffusion_um: float,
    threshold_e: float,
    events: int = 3000,
) -> JsonObject:
    """A library and the generator's two fluxes, about `events` events each, with a summary."""
    area_cm2 = library.pixels * (pixel_pitch_um * 1e-4) ** 2
    found = {
        "recorded": _measured(
            _library_images(library), threshold_e, area_cm2 * library.exposure_s / 60.0
        )
    }
    flux = Flux(
        FRAME_PX,
        FRAME_PX,
        pixel_pitch_um,
        thickness_um,
        GROUND_RATE_PER_CM2_S,
        1.0,
        MUON_ZENITH_POWER,
        0.0,
        diffusion_um,
    )
    muons, isotropic = list(COLOURS)[1:]
    for name, power in ((muons, MUON_ZENITH_POWER), (isotropic, 0.0)):
        one = replace(flux, zenith_power=power)
        one = replace(one, integration_s=events / mean_count(one))
        area_min = (FRAME_PX * pixel_pitch_um * 1e-4) ** 2 * one.integration_s / 60.0
        found[name] = _measured(_track_images(one), threshold_e, area_min)
    path = {n: _charge_per_um(e, pixel_pitch_um, thickness_um) for n, e in found.items()}
    summary = {
        name: {
            "events": len(e.pixels),
            "rate_per_cm2_min": round(e.rate_per_cm2_min, 3),
            "pixels_5_50_95": _percentiles(e.pixels),
            "extent_px_5_50_95": _percentiles(e.extent_px),
            "electrons_5_50_95": _percentiles(e.electrons),
            "straight_e_per_um_peak": _peak(path[name]),
        }
        for name, e in found.items()
    }
    return {
        "events": found,
        "e_per_um": path,
        "summary": summary,
        "thickness_um": thickness_um,
        "pixel_pitch_um": pixel_pitch_um,
        "threshold_e": threshold_e,
    }


def _percentiles(values: Array) -> list[float]:
    return [round(float(v), 1) for v in np.percentile(values, [5, 50, 95])] if len(values) else []


def _library_images(library: Library) -> Iterator[Array]:
    left, right, top, bottom = library.boxes()
    for n in range(len(library)):
        part = slice(library.start[n], library.start[n + 1])
        image = np.zeros((bottom[n] - top[n] + 1, right[n] - left[n] + 1))
        image[library.y[part] - top[n], library.x[part] - left[n]] = library.electrons[part]
        yield image


def _track_images(flux: Flux) -> Iterator[Array]:
    """Each generated event in an image of its own, as far as it lies in the frame."""
    key, pad = stream_key(1, "comparison"), reach_px(flux)
    tracks = draw_tracks(flux, 0, key)
    for n in range(len(tracks)):
        one = tracks.taken(np.array([n]))
        low_x, low_y = (
            max(0, int(min(a[0], b[0]) - pad))
            for a, b in ((one.x_back, one.x_front), (one.y_back, one.y_front))
        )
        high_x, high_y = (
            min(FRAME_PX, int(max(a[0], b[0]) + pad) + 1)
            for a, b in ((one.x_back, one.x_front), (one.y_back, one.y_front))
        )
        if high_x > low_x and high_y > low_y:
            image = np.zeros((high_y - low_y, high_x - low_x))
            add_tracks(image, one, flux, 0, key, (low_y, low_x, *image.shape))
            yield image


def _measured(images: Iterable[Array], threshold_e: float, area_min: float) -> Events:
    rows: list[object] = []
    thumbs: list[Array] = []
    for image in images:
        y, x = np.nonzero(image >= threshold_e)
        if not len(y):
            continue
        extent = np.hypot(np.ptp(x), np.ptp(y))
        rows.append((len(y), extent, image[y, x].sum()))
        if len(y) >= THUMB_LEAST_PX and len(thumbs) < THUMB_ROWS * THUMB_COLUMNS:
            thumbs.append(_thumb(np.where(image >= threshold_e, image, 0.0)))
    table = np.array(rows, dtype=np.float64).reshape(-1, 3)
    return Events(table[:, 0], table[:, 1], table[:, 2], len(table) / area_min, thumbs)


def _thumb(image: Array) -> Array:
    """The middle of an event's box, in a square."""
    y, x = np.nonzero(image)
    top, left = ((v.min() + v.max() + 1 - THUMB_PX) // 2 for v in (y, x))
    square = np.zeros((THUMB_PX, THUMB_PX))
    inside = (y >= top) & (y < top + THUMB_PX) & (x >= left) & (x < left + THUMB_PX)
    square[y[inside] - top, x[inside] - left] = image[y[inside], x[inside]]
    return square


def _charge_per_um(e: Events, pixel_pitch_um: float, thickness_um: float) -> Array:
    """Charge over path of the long events, taken for straight tracks through the whole slab."""
    long = e.extent_px >= STRAIGHT_PX
    return e.electrons[long] / np.hypot(e.extent_px[long] * pixel_pitch_um, thickness_um)


def _peak(e_per_um: Array) -> float | None:
    """The most common charge per length, by the half-sample mode [e-/um]; None without any."""
    v = np.sort(e_per_um)
    while len(v) > 4:
        half = (len(v) + 1) // 2
        first = int(np.argmin(v[half - 1 :] - v[: len(v) - half + 1]))
        v = v[first : first + half]
    return round(float(v.mean()), 1) if len(v) else None


def draw_comparison(study: JsonObject, path: Path) -> None:
    """Write the figure of a comparison (PNG or SVG); Missing where matplotlib is not installed."""
    figure = blank_figure((13.5, 8.2), layout="constrained")
    axes = figure.subplots(2, 3)
    events = study["events"]
    _histogram(axes[0][0], events, "pixels", np.geomspace(1, 400, 22), "pixels above threshold")
    _histogram(
        axes[0][1],
        {n: replace(e, extent_px=e.extent_px + 1) for n, e in events.items()},
        "extent_px",
        np.geomspace(1, 400, 22),
        "extent + 1 [px]",
    )
    _histogram(axes[0][2], events, "electrons", np.geomspace(30, 2e6, 30), "charge [e-]")
    bins_e_per_um = np.linspace(0, 250, 40)
    for name, values in study["e_per_um"].items():
        if np.any(values <= bins_e_per_um[-1]):
            axes[1][0].hist(
                values,
                bins=bins_e_per_um,
                density=True,
                histtype="step",
                color=COLOURS[name],
                linewidth=1.6,
            )
    axes[1][0].set_xlabel(f"charge per length, extent of {STRAIGHT_PX} px or more [e-/um]")
    axes[1][0].set_ylabel("fraction per e-/um")
    for name, e in events.items():
        charge = np.sort(e.electrons)[::-1]
        rate = e.rate_per_cm2_min * np.arange(1, len(charge) + 1) / len(charge)
        axes[1][1].loglog(charge, rate, color=COLOURS[name], linewidth=1.6)
    axes[1][1].set_xlabel("charge [e-]")
    axes[1][1].set_ylabel("events above it per cm² and minute")
    muons = list(COLOURS)[1]
    _sheet(axes[1][2], events["recorded"].images, events[muons].images)
    for ax in axes.ravel()[:5]:
        ax.grid(True, color="#DDDDDD", linewidth=0.6)
        ax.set_axisbelow(True)
    axes[0][0].legend(fontsize=8)
    figure.suptitle(
        f"Recorded events and the generator: {study['thickness_um']:g} um of silicon, pixels of "
        f"{study['pixel_pitch_um']:g} um, pixels above {study['threshold_e']:g} e-",
        fontsize=12,
    )
    figure.savefig(path)


def _histogram(ax: Axes, events: dict[str, Events], field: str, bins: Array, label: str) -> None:
    """Events per cm2, minute and bin."""
    for name, e in events.items():
        values = getattr(e, field)
        weight = np.full(len(values), e.rate_per_cm2_min / max(len(values), 1))
        ax.hist(
            values,
            bins=list(bins),
            weights=weight,
            histtype="step",
            color=COLOURS[name],
            linewidth=1.6,
            label=name,
        )
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel(label)
    ax.set_ylabel("events per cm², minute and bin")


def _sheet(ax: Axes, recorded: list[Array], generated: list[Array]) -> None:
    """Images of single events: recorded ones above, generated ones below."""
    height, width = THUMB_ROWS * THUMB_PX, THUMB_COLUMNS * THUMB_PX
    sheet = np.full((2 * height + 6, width), np.nan)
    for offset, images in ((0, recorded), (height + 6, generated)):
        sheet[offset : offset + height] = 0.0
        for n, image in enumerate(images):
            y, x = offset + n // THUMB_COLUMNS * THUMB_PX, n % THUMB_COLUMNS * THUMB_PX
            sheet[y : y + THUMB_PX, x : x + THUMB_PX] = image
    ax.imshow(np.log10(np.maximum(sheet, 30.0)), cmap="magma", vmin=1.5, vmax=3.8)
    ax.set_title(f"recorded above, muons below; squares of {THUMB_PX} px", fontsize=9)
    ax.set_xticks([])
    ax.set_yticks([])
