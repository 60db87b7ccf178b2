"""Guards: cheap checks of what was drawn; they name frame and tile, and the source or layer."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pipeline.arrays import Array, FrameStars, Geometry
from pipeline.errors import BadInput, NightglassError
from pipeline.physics.drawing.quadrature import RELATIVE
from pipeline.physics.positions.focal_plane import deproject
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.vectors import separation
from pipeline.plan.accuracy import part_sigma
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.response.responses import rings_below, table_error
from pipeline.plan.tiles import Tile

NEGATIVE_FLOOR = 1e-3  # of the noise floor: ringing below it is set to zero, beyond it is a fault
PLACE_PX = 1e-3  # that a source's pixel and its direction may be apart
ROUNDING_RAD = 2e-15
FIELDS = {  # of the scene, by the layer that comes from it
    "stars_e": "stars",
    "targets_e": "targets",
    "background_e": "background",
    "dark_e": "sensor.dark_e_per_s",
    "cosmic_rays_e": "cosmic_rays",
    "lag_e": "sensor.detector.lag",
}
LOOKED_AT = 64  # sources of a task whose places are checked


def where(g: Geometry, tile: Tile) -> str:
    """A tile of a frame, for messages."""
    return f"frame {int(g.frame[0])}, tile at row {tile.y0}, column {tile.x0}"


def guard_stars(g: Geometry, tile: Tile, stars: FrameStars) -> None:
    """Raise for a star whose light or place is not finite."""
    good = np.isfinite(stars.light_e) & np.isfinite(stars.x_px) & np.isfinite(stars.y_px)
    if not good.all():
        k = int(np.argmin(good))
        raise NightglassError(
            f"{where(g, tile)}: star {int(stars.source_id[k])} has {stars.light_e[k]} e- at "
            f"({stars.x_px[k]}, {stars.y_px[k]}): its row of stars.catalogue is damaged"
        )


def guard_places(
    plan: ResolvedScene,
    attitude: Array,
    x_px: Array,
    y_px: Array,
    direction: Array,
    names: list[str],
) -> None:
    """Raise where a source's pixel (n,) is not where its observed direction (n, 3) is seen.

    Both ways through the optics must agree to PLACE_PX. names : of the sources, for the message
    """
    if not len(x_px):
        return
    apart = separation(deproject(plan.camera, attitude, x_px, y_px), direction)
    bad = ~(apart <= PLACE_PX * plan.facts.ifov_rad + ROUNDING_RAD)
    if bad.any():
        k = int(np.argmax(bad))
        raise NightglassError(
            f"{names[k]}: its pixel ({x_px[k]:.4f}, {y_px[k]:.4f}) is "
            f"{apart[k] / plan.facts.ifov_rad:.3g} px from its direction: sensor.distortion has no "
            "inverse there"
        )


def guard_brightness(plan: ResolvedScene, x_px: float, y_px: float, light_e: float) -> None:
    """Refuse a source of which the very rounding of a pixel would show in its noise."""
    most_e = (part_sigma(plan.scene) / RELATIVE) ** 2
    if light_e > most_e:
        raise BadInput(
            "accuracy.noise_fraction",
            f"a source of {light_e:.3g} e- at row {y_px:.1f}, column {x_px:.1f} with "
            f"{plan.scene.accuracy.noise_fraction:g}",
            f"sources of at most {most_e:.3g} e- in one exposure: a fainter one, a shorter "
            "exposure or more noise_fraction",
        )


def guard_light(
    plan: ResolvedScene,
    g: Geometry,
    tile: Tile,
    layer: str,
    image_e: Array,
    cores_e: float,
    light_e: Array,
    inside: np.ndarray,
) -> None:
    """Raise where a tile holds more light than its sources send, or less than those inside it do.

    image_e : light of the layer in the tile, cores_e : that without wings, which come from farther
    sources too; light_e : (n,) of every source whose core may reach it; inside : (n,) which of them
    send all but the light omitted into the tile. Pixels with gaps collect what the response's
    `collected_range` allows for.
    """
    r = plan.responses
    low, high = _collected_range(r.blurs)
    total, sent = float(image_e.sum()), float(light_e.sum())
    most = sent * high
    least = float(light_e[inside].sum()) * low * (1.0 - min(1.0, r.lost_light))
    allowed = plan.scene.accuracy.flux_fraction * sent + r.budget_e * np.sqrt(image_e.size)
    wings_e = abs(total - cores_e)  # of very bright sources elsewhere they may ring below zero
    if least - allowed <= cores_e + wings_e and cores_e <= most + allowed:
        return
    if not np.isfinite(total):
        return  # `guard_mean` says more
    raise NightglassError(
        f"{where(g, tile)}: {layer} holds {total:.8g} e- with cores of {cores_e:.8g} e-, where its "
        f"sources send {least:.8g} to {most:.8g} e-; drawn with sensor.psf to "
        f"accuracy.flux_fraction = {plan.scene.accuracy.flux_fraction:g}"
    )


@lru_cache(maxsize=8)
def _collected_range(blurs: tuple[Blur, ...]) -> tuple[float, float]:
    """Least and most of a source's light that pixels collect, over all responses of a field."""
    ranges = [blur.collected_range() for blur in blurs]
    return min(low for low, _ in ranges), max(high for _, high in ranges)


def inside_tile(
    plan: ResolvedScene, tile: Tile, x_px: Array, y_px: Array, sweep_px: float
) -> np.ndarray:
    """Which places (n,) are so far inside a tile that their light stays in it."""
    margin = plan.responses.reach_px + sweep_px + 2.0
    x0, y0 = tile.x0 + margin, tile.y0 + margin
    x1, y1 = tile.x0 + tile.columns - margin, tile.y0 + tile.rows - margin
    return np.asarray((x_px > x0) & (x_px < x1) & (y_px > y0) & (y_px < y1))


def guard_mean(
    plan: ResolvedScene,
    g: Geometry,
    tile: Tile,
    mean_e: Array,
    layers: dict[str, Array],
    wing_error_e: float,
) -> Array:
    """The mean with the errors of the transforms clipped at zero; a larger fault is refused.

    wing_error_e : what wings may err by, which is more beside crowds and sources brighter than the
    plan's bounds hold for; a table's cut band rings in proportion to the light
    """
    low = float(mean_e.min(initial=0.0))
    if not np.isfinite(low) or not np.isfinite(mean_e.max(initial=0.0)):
        raise NightglassError(f"{where(g, tile)}: {_not_finite(layers)}")
    if low < 0.0:
        allowed = NEGATIVE_FLOOR * plan.facts.sigma_floor_e + 1e-6 * float(mean_e.max())
        allowed += plan.facts.budget_e
        light_e = float(np.maximum(mean_e, 0.0).sum())
        cut = max(table_error(b) for b in plan.responses.blurs)
        allowed += 2.0 * wing_error_e + cut * light_e
        if low < -allowed and low < -allowed - rings_below(plan.responses) * light_e:
            lowest = min(layers, key=lambda name: float(layers[name].min()))
            raise NightglassError(
                f"{where(g, tile)}: a pixel's mean is {low:.3g} e-, below zero by more than "
                f"rounding; lowest is {lowest} ({FIELDS.get(lowest, 'sensor')})"
            )
        return np.maximum(mean_e, 0.0)
    return mean_e


def _not_finite(layers: dict[str, Array]) -> str:
    """Which layer and pixel are at fault."""
    for name, layer in layers.items():
        if not np.isfinite(layer).all():
            row, column = np.argwhere(~np.isfinite(layer))[0]
            field = FIELDS.get(name, "sensor")
            return f"{name} ({field}) is not finite at row {row}, column {column} of it"
    return f"a pixel's mean is not finite: too much light in {' and '.join(layers)}"
