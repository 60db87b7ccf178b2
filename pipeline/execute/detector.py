"""The detector in one tile: its terms, and its place in the random streams."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import Array, SensorMaps
from pipeline.physics.noise.streams import stream_key
from pipeline.physics.noise.terms import Chain, StreamPlace
from pipeline.physics.noise.transfer import Smear, exposed_share, passed_means
from pipeline.plan.tiles import Tile
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.detector import Detector, FrameTransfer, TimeDelay

NONE = Detector()


def tile_chain(
    scene: Scene, maps: SensorMaps, tile: Tile, integration_s: float, step: int = 1
) -> Chain:
    """The detector's terms for an exposure, with the tile's part of each image: of every `step`-th
    pixel of both axes."""
    rows, columns = tile.y0 + tile.rows, tile.x0 + tile.columns
    part = np.s_[tile.y0 : rows : step, tile.x0 : columns : step]
    s = scene.sensor
    d = s.detector or NONE

    def cut(value: float | Array) -> float | Array:
        return value[part] if isinstance(value, np.ndarray) else value

    flat, dark_e = cut(maps.flat), cut(maps.dark_e_per_s) * integration_s
    if isinstance(d.readout, TimeDelay):
        way = s.shape[0], d.readout, integration_s
        flat, dark_e_s = (_passed(v, part, *way) for v in (maps.flat, maps.dark_e_per_s))
        dark_e = dark_e_s * integration_s
    return Chain(
        flat=flat,
        dark_e=dark_e,
        full_well_e=s.full_well_e,
        read_noise_e=cut(maps.read_noise_e),
        gain_e_per_dn=cut(maps.gain_e_per_dn),
        bias_dn=cut(maps.bias_dn),
        adc_bits=s.adc_bits,
        rounding=s.adc_rounding,
        photon_noise=s.photon_noise,
        linearity=maps.linearity,
        blooming=d.blooming,
        row_noise_e=d.row_noise_e,
        column_noise_e=d.column_noise_e,
        bad=_bad_in(maps, tile, step),
        smear=_smear(d, integration_s),
        lag=0.0 if d.lag is None else d.lag.fraction,
    )


def _passed(
    value: float | Array, part: tuple[slice, slice], rows: int, r: TimeDelay, integration_s: float
) -> float | Array:
    """What charge that moves meets of a term in a part of the frame: the mean along its way; where
    it is exposed in part, that share of it."""
    if isinstance(value, np.ndarray):
        value = passed_means(value[:, part[1]], r.rows_per_s, integration_s)[part[0]]
    if r.edges == "full":
        return value
    columns = len(range(part[1].start, part[1].stop, part[1].step))
    share = exposed_share(rows, r.rows_per_s, integration_s)[part[0], None]
    return value * share * np.ones((1, columns))


def _smear(d: Detector, integration_s: float) -> Smear | None:
    readout = d.readout
    if not isinstance(readout, FrameTransfer):
        return None
    to_high = readout.towards == "high_rows"
    return Smear(integration_s, readout.transfer_s, to_high, readout.cleared)


def _bad_in(
    maps: SensorMaps, tile: Tile, step: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    if maps.bad is None:
        return None
    y, x, dn = maps.bad
    inside = (y >= tile.y0) & (y < tile.y0 + tile.rows)
    inside &= (x >= tile.x0) & (x < tile.x0 + tile.columns)
    inside &= ((y - tile.y0) % step == 0) & ((x - tile.x0) % step == 0)
    return (y[inside] - tile.y0) // step, (x[inside] - tile.x0) // step, dn[inside]


def stream_place(scene: Scene, tile: Tile, frame: int) -> StreamPlace:
    """Where a tile of a frame stands in the scene's random streams."""
    d, seed = scene.sensor.detector or NONE, scene.seed
    return StreamPlace(
        tile.y0,
        tile.x0,
        frame,
        stream_key(seed, "photon_noise"),
        stream_key(seed, "read_noise"),
        stream_key(seed, "photon_and_read_noise"),
        stream_key(seed, "row_noise") if d.row_noise_e > 0 else None,
        stream_key(seed, "column_noise") if d.column_noise_e > 0 else None,
    )
