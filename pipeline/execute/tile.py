"""One tile of one frame: light, layers, noise, digital numbers. Pure: same input, same bits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, FrameStars, Geometry, SensorMaps
from pipeline.errors import NightglassError
from pipeline.execute.blocks import Block
from pipeline.execute.check import check_tile
from pipeline.execute.light import draw_stars, draw_targets
from pipeline.physics.noise.chain import Chain, StreamPlace, to_dn
from pipeline.physics.noise.streams import stream_key
from pipeline.plan.scene_plan import Plan
from pipeline.plan.tiles import Tile

if TYPE_CHECKING:
    from pipeline.physics.cosmic_rays.frame import CosmicRays

NEGATIVE_FLOOR = 1e-3  # of the noise floor: ringing below it is set to zero, beyond it is a fault


def render_tile(
    plan: Plan,
    maps: SensorMaps,
    g: Geometry,
    tile: Tile,
    parts: list[FrameStars],
    blocks: list[Block],
    rays: CosmicRays | None = None,
) -> tuple[dict[str, NDArray], list[dict[str, Any]]]:
    """The layers of a tile that the scene asks for, and what the reference path found in it.

    The layers are `dn`, and the noise-free ones in float32. The light layers are what the pixels
    collect (after the flat), so that with the dark they sum to `mean_e`, the mean of the noisy
    frame before full well and ADC. `cosmic_rays_e` is drawn charge and not in it.
    """
    frame = int(g.frame[0])
    chain = _chain(plan, maps, tile, frame)
    light: dict[str, Array] = {}
    if plan.scene.stars is not None:
        light["stars_e"] = draw_stars(plan, g, tile, parts, blocks)
    if plan.scene.targets:
        light["targets_e"] = draw_targets(plan, g, tile, blocks)
    layers: dict[str, Array] = {name: image * chain.flat for name, image in light.items()}
    shape = (tile.rows, tile.columns)
    if plan.sky is not None:
        from pipeline.plan.sky import sky_tile

        light_e_s = sky_tile(plan.sky, int(g.frame[0]), tile)
        layers["background_e"] = light_e_s * plan.integration_s(frame) * chain.flat
    elif plan.facts.background_e > 0:
        background_e = plan.facts.background_e_s * plan.integration_s(frame)
        layers["background_e"] = np.broadcast_to(background_e * chain.flat, shape)
    if np.any(chain.dark_e):
        layers["dark_e"] = np.broadcast_to(chain.dark_e, shape)
    mean = np.zeros(shape)
    for layer in layers.values():
        mean += layer
    mean = _not_negative(plan, mean, max((b.brightest_e for b in blocks), default=0.0))
    place = StreamPlace(
        tile.y0, tile.x0, int(g.frame[0]), stream_key(plan.scene.seed, "photon_noise"),
        stream_key(plan.scene.seed, "read_noise"),
    )  # fmt: skip
    drawn = None if rays is None else _cosmic_rays_e(plan, rays, chain, g, tile)
    out: dict[str, NDArray] = {"dn": to_dn(mean, chain, place, drawn)}
    if drawn is not None:
        layers["cosmic_rays_e"] = drawn
    for name in plan.scene.output.layers:
        if name != "dn":
            value = mean if name == "mean_e" else layers.get(name, np.zeros(shape))
            out[name] = value.astype(np.float32)
    return out, check_tile(
        plan, g, tile, parts, list(light.values()), lambda part: _noise_e(mean, chain, part)
    )


def _cosmic_rays_e(plan: Plan, rays: CosmicRays, chain: Chain, g: Geometry, tile: Tile) -> Array:
    """Charge of cosmic rays in a tile; before the flat, as in the paper, or after it."""
    from pipeline.physics.cosmic_rays.frame import charge_e, exposed_for

    assert plan.scene.cosmic_rays is not None
    place = (tile.y0, tile.x0, tile.rows, tile.columns)
    frame = int(g.frame[0])
    rays = exposed_for(rays, plan.integration_s(frame))
    charge = charge_e(rays, plan.scene.seed, frame, *place)
    return charge if plan.scene.cosmic_rays.after_flat else charge * chain.flat


def _noise_e(mean_e: Array, chain: Chain, part: tuple[slice, slice]) -> Array:
    """Noise of some pixels of a tile: of photons, of reading, of rounding [e-]."""

    def squared(value: float | Array) -> float | Array:
        return np.square(value[part] if isinstance(value, np.ndarray) else value)

    photons = mean_e[part] if chain.photon_noise else 0.0
    floor = squared(chain.read_noise_e) + squared(chain.gain_e_per_dn) / 12.0
    return np.sqrt(photons + floor)


def _chain(plan: Plan, maps: SensorMaps, tile: Tile, frame: int) -> Chain:
    """The noise chain of a frame with the tile's part of each image."""
    part = np.s_[tile.y0 : tile.y0 + tile.rows, tile.x0 : tile.x0 + tile.columns]
    s = plan.scene.sensor

    def cut(value: float | Array) -> float | Array:
        return value[part] if isinstance(value, np.ndarray) else value

    dark = cut(maps.dark_e_per_s) * plan.integration_s(frame)
    return Chain(
        flat=cut(maps.flat),
        dark_e=dark,
        full_well_e=s.full_well_e,
        read_noise_e=cut(maps.read_noise_e),
        gain_e_per_dn=cut(maps.gain_e_per_dn),
        bias_dn=cut(maps.bias_dn),
        adc_bits=s.adc_bits,
        rounding=s.adc_rounding,
        photon_noise=s.photon_noise,
    )


def _not_negative(plan: Plan, mean_e: Array, brightest_e: float) -> Array:
    """The mean with the errors of the transforms clipped at zero; a larger fault is refused.

    Beside a source brighter than the plan's bounds hold for, its wings err in proportion to it.
    """
    low = float(mean_e.min(initial=0.0))
    if not np.isfinite(low) or not np.isfinite(mean_e).all():
        raise NightglassError("a pixel's mean is not finite: a source or sensor image is damaged")
    if low < 0.0:
        peak = float(mean_e.max())
        allowed = NEGATIVE_FLOOR * plan.facts.sigma_floor_e + 1e-6 * peak + plan.facts.budget_e
        allowed += 2.0 * plan.responses.classes[-1].wing_error * brightest_e
        if low < -allowed:
            raise NightglassError(
                f"a pixel's mean is {low:.3g} e-, below zero by more than rounding"
            )
        return np.maximum(mean_e, 0.0)
    return mean_e
