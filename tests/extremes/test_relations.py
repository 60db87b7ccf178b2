"""Scenes whose frames must agree by what is known without any formula of the product."""

from __future__ import annotations

import numpy as np
import pytest

from tests.extremes.relations import brightened, broken, draw, halves, scene
from tests.extremes.stock import Stock

FEW, MANY = (148,), range(100)  # FEW: a quick one, for which all relations hold


def test_relations_hold(stock: Stock) -> None:
    looked_at: set[str] = set()
    for seed in FEW:
        held, wrong = broken(seed, stock)
        assert not wrong
        looked_at |= set(held)
    assert len(looked_at) == 8


@pytest.mark.parametrize(
    ("low", "high"), [(0.1, 0.4), (0.5, 3.0)], ids=["less than a wave", "some waves"]
)
def test_halves_of_a_wandering_exposure(stock: Stock, low: float, high: float) -> None:
    """Jitter of so many waves in the exposure, 1.5 px rms: two halves gather what the whole does,
    and it is not what a camera at rest does."""
    data = scene(FEW[0], stock)
    data = brightened(data, draw(data))
    sensor, time_s = data["sensor"], data["exposure"]["integration_s"]
    ifov_arcsec = np.degrees(1e-6 * sensor["pixel_pitch_um"] / sensor["focal_length_m"]) * 3600.0
    white = {"kind": "white", "rms_arcsec": 1.5 * ifov_arcsec,
             "low_hz": low / time_s, "high_hz": high / time_s}  # fmt: skip
    wanders = data | {"pointing": data["pointing"] | {"attitude": {"jitter": [white]}}}
    rests, one = draw(data), draw(wanders)
    assert (np.abs(rests.light_e - one.light_e) > 10.0 * one.allowed_e).any()
    ((own, other, allowed),) = halves(wanders, one)
    assert (np.abs(own - other) / allowed).max() <= 1.0


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_relations_hold_in_many_scenes(stock: Stock) -> None:
    found = [broken(seed, stock) for seed in MANY]
    assert not [line for _, wrong in found for line in wrong]
    assert sum(len(held) for held, _ in found) > 300
