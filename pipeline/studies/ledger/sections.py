"""Probes of sections and of terms of the detector: absent, neutral, rounded, bent, left behind."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction

import numpy as np
from scipy.stats import norm, poisson

from pipeline.arrays import Array
from pipeline.execute.tile import tile_light
from pipeline.physics.noise.chain import to_dn
from pipeline.physics.noise.joint import ABOVE_E, READ_E, joint_quantile
from pipeline.physics.noise.streams import poisson_image
from pipeline.physics.noise.terms import Chain, StreamPlace
from pipeline.physics.noise.transfer import lagged_e
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from pipeline.studies.ledger.probe import Bench, ProbeResult, most, probe, stated, timed
from pipeline.studies.ledger.scenes import SIDE, before, mean_e, scene, whole
from pipeline.studies.scenes.stage import blocks_by, open_stage

LARGE_MEAN_E = 1e8


@probe("stars")
def sections(bench: Bench) -> Iterator[ProbeResult]:
    """The stars' light of a scene that has only stars, beside the same among everything else."""
    stars = {"catalogue": bench.catalogue}
    alone = open_stage(scene({"stars": stars}))
    among = open_stage(
        scene(
            {
                "stars": stars,
                "background": {"zodiacal": True},
                "targets": [before([0.0, 0.9, 0.3], 1e6)],
            }
        )
    )
    tile = whole(alone)

    def light(stage, which: tuple[str, ...]) -> Array:
        blocks = blocks_by(stage, stage.plan)(tile)
        return tile_light(stage.plan, stage.g, tile, [stage.stars], blocks, which)["stars_e"]

    out_s, a = timed(lambda: light(alone, ("stars",)), 3)
    in_s, b = timed(lambda: light(among, ("stars", "targets", "sky")), 3)
    for name in ("targets", "background", "cosmic_rays"):
        bound, unit = stated(alone.plan, name)
        yield ProbeResult(
            name, "stars alone, and beside targets and a sky", bound, most(a - b), unit, out_s, in_s
        )


@probe("flat")
def neutral(_: Bench) -> Iterator[ProbeResult]:
    """Digital numbers of a chain of numbers, and of one with images of neutral values."""
    rng = np.random.default_rng(2)
    mean = rng.uniform(10.0, 1e4, (512, 512))
    ones, none = np.ones(mean.shape), np.zeros(mean.shape)
    place, nowhere = StreamPlace(0, 0, 0, (1, 2), (3, 4), (5, 6)), np.zeros(0, np.int64)
    plain = Chain(1.0, 0.0, None, 5.0, 1.5, 0.0, 32)
    full = Chain(ones, none, 1e300, 5.0 * ones, 1.5 * ones, none, 32, bad=(nowhere,) * 3)
    out_s, a = timed(lambda: to_dn(mean * plain.flat + plain.dark_e, plain, place), 3)
    in_s, b = timed(lambda: to_dn(mean * full.flat + full.dark_e, full, place), 3)
    plan = prepare(parse_scene(scene())).plan
    for name in ("flat", "dark", "full_well", "bias"):
        bound = stated(plan, name)[0]
        yield ProbeResult(
            name,
            "512 x 512 pixels, numbers beside images of neutral values",
            bound,
            most(a.astype(float) - b.astype(float)),
            "DN",
            out_s,
            in_s,
        )


@probe("adc")
def rounding(_: Bench) -> Iterator[ProbeResult]:
    """Whole numbers beside the charge over the gain, in exact fractions; 63 bits, no noise."""
    rng = np.random.default_rng(4)
    mean, gain = rng.uniform(0.0, 2.0**40, (64, 64)), 1.7
    for way in ("half_even", "floor"):
        plan = prepare(parse_scene(scene({"sensor.adc_rounding": way}))).plan
        chain = Chain(1.0, 0.0, None, 0.0, gain, 0.0, 63, rounding=way, photon_noise=False)
        place = StreamPlace(0, 0, 0, (0, 0), (0, 0), (0, 0))
        in_s, dn = timed(lambda chain=chain, place=place: to_dn(mean, chain, place), 3)  # type: ignore[misc]
        out_s = timed(lambda: mean / gain, 3)[0]
        exact = [Fraction(float(m)) / Fraction(gain) for m in mean.ravel()]
        off = max(abs(Fraction(int(n)) - e) for n, e in zip(dn.ravel(), exact, strict=True))
        bound, unit = stated(plan, "adc")
        yield ProbeResult(
            "adc", f"{way}, 63 bits, against exact fractions", bound, float(off), unit, out_s, in_s
        )


@probe("gaussian_for_poisson")
def large_means(_: Bench) -> Iterator[ProbeResult]:
    """The rounded Gaussian for a Poisson number of a mean of 1e8: their distribution functions."""
    sigma = np.sqrt(LARGE_MEAN_E)
    k = np.round(LARGE_MEAN_E + sigma * np.linspace(-6.0, 6.0, 4001))
    off = most(poisson.cdf(k, LARGE_MEAN_E) - norm.cdf((k + 0.5 - LARGE_MEAN_E) / sigma))
    mean = np.full((512, 512), 2.0 * LARGE_MEAN_E)
    out_s, _x = timed(lambda: poisson_image(mean, 0, 0, 0, 1, 2), 3)
    rng = np.random.default_rng(3)
    in_s, _x = timed(lambda: rng.poisson(mean), 3)
    bound, unit = stated(prepare(parse_scene(scene())).plan, "gaussian_for_poisson")
    yield ProbeResult(
        "gaussian_for_poisson",
        "a mean of 1e8, against scipy's Poisson",
        bound,
        off,
        unit,
        out_s,
        in_s,
    )


@probe("one_noise_draw")
def one_draw(_: Bench) -> Iterator[ProbeResult]:
    """The quantile that photon and read noise share, at the limits of its use."""
    z, n = np.linspace(-6.0, 6.0, 4001), np.arange(0.0, 400.0)
    quantiles = [joint_quantile(float(v), ABOVE_E, READ_E) for v in z]
    exact = poisson.pmf(n, ABOVE_E) @ norm.cdf((np.array(quantiles) - n[:, None]) / READ_E)
    mean = np.full((512, 512), ABOVE_E)
    place = StreamPlace(0, 0, 0, (1, 2), (3, 4), (5, 6))
    one = Chain(1.0, 0.0, None, READ_E, 1.0, 100.0, 16)
    two = replace(one, linearity=(np.array([0.0, 1.0]), np.array([0.0, 1.0])))
    out_s, _x = timed(lambda: to_dn(mean, one, place), 3)
    in_s, _x = timed(lambda: to_dn(mean, two, place), 3)
    bound, unit = stated(prepare(parse_scene(scene())).plan, "one_noise_draw")
    yield ProbeResult(
        "one_noise_draw",
        "10 e- and 1.5 e- of read noise, against sums of normal integrals",
        bound,
        most(exact - norm.cdf(z)),
        unit,
        out_s,
        in_s,
    )


@probe("detector_extras")
def extras(bench: Bench) -> Iterator[ProbeResult]:
    """Frames without extras and with neutral ones; a bent response; charge left behind."""
    stars = {"catalogue": bench.catalogue}
    plain = open_stage(scene({"stars": stars}))
    neutral = open_stage(
        scene(
            {
                "stars": stars,
                "sensor.full_well_e": 1e12,
                "sensor.detector": {
                    "prnu": 0.0,
                    "row_noise_e": 0.0,
                    "column_noise_e": 0.0,
                    "blooming": False,
                },
            }
        )
    )
    out_s, a = timed(lambda: mean_e(plain), 2)
    in_s, b = timed(lambda: mean_e(neutral), 2)
    bound, unit = stated(plain.plan, "detector_extras")
    yield ProbeResult(
        "detector_extras",
        "no detector section, and one of neutral values",
        bound,
        most(a - b),
        unit,
        out_s,
        in_s,
    )
    yield _bent()
    yield _left_behind()


def _bent() -> ProbeResult:
    """A polynomial response by the table that the product makes of it, and by itself."""
    coefficients, full_e = [-0.03, 0.02], 1e5
    prepared = prepare(
        parse_scene(
            scene(
                {
                    "sensor.full_well_e": full_e,
                    "sensor.detector.nonlinearity": {
                        "kind": "polynomial",
                        "coefficients": coefficients,
                    },
                }
            )
        )
    )
    table = prepared.maps.linearity
    assert table is not None
    true_e = np.random.default_rng(5).uniform(0.0, full_e, (512, 512))
    bend = np.polynomial.Polynomial([1.0, *coefficients])
    out_s, told = timed(lambda: np.interp(true_e, *table), 3)
    in_s, exact = timed(lambda: true_e * bend(true_e / full_e), 3)
    bound, unit = stated(prepared.plan, "nonlinearity")
    return ProbeResult(
        "nonlinearity",
        "a polynomial on 4097 points, against itself",
        bound,
        most(told - exact),
        unit,
        out_s,
        in_s,
    )


def _left_behind() -> ProbeResult:
    """Charge left by all frames before, beside that of as many as are drawn: a full frame each."""
    share, full_e = 0.05, 1e5
    plan = prepare(
        parse_scene(
            scene(
                {
                    "sensor.full_well_e": full_e,
                    "exposure.frames": 40,
                    "exposure.cadence_s": 6.0,
                    "sensor.detector.lag": {"fraction": share},
                }
            )
        )
    )
    n = plan.plan.lag_frames
    frame = np.full((SIDE, SIDE), full_e)
    out_s, few = timed(lambda: lagged_e([frame] * (n + 1), share), 3)
    in_s, every = timed(lambda: lagged_e([frame] * 61, share), 3)
    bound, unit = stated(plan.plan, "lag")
    return ProbeResult(
        "lag",
        f"full wells, {n} frames before beside 60",
        bound,
        most(few - every),
        unit,
        out_s,
        in_s,
    )
