"""Random scenes over the whole schema: a product within its bounds and forecasts, or one line."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.errors import BadInput
from pipeline.route.prepare import plan_scene
from pipeline.spec.load import parse_scene
from tests.extremes import fuzz
from tests.extremes.scenes import LARGE_PX, SMALL_PX, broken, random_scene
from tests.extremes.stock import Stock

FEW, MANY, ALL = 25, 1000, 300
SEEDS = tuple(np.random.default_rng(0).permutation(ALL)[:4].tolist())
CALM = [HealthCheck.too_slow, HealthCheck.data_too_large]


def judged(seeds: Sequence[int], stock: Stock, side_px: int, workers: int) -> None:
    """Every scene is as it should be; those that are not are printed, to be rendered again."""
    wrong = [v for v in fuzz.run(seeds, stock, side_px, workers) if v.wrong]
    told = io.StringIO()
    for verdict in wrong:
        told.write(f"\n# {verdict}\n{verdict.answer.get('trace', '')}\n")
        fuzz.write_yaml(verdict.scene, told)
    assert not wrong, told.getvalue()


def test_random_scenes(stock):
    judged(SEEDS, stock, SMALL_PX, 1)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_all_random_scenes(stock):
    judged(range(ALL), stock, LARGE_PX, 2)


def test_same_scene_for_the_same_seed(stock):
    assert random_scene(7, stock) == random_scene(7, stock) != random_scene(8, stock)


@pytest.mark.parametrize(
    ("answer", "wrong"),
    [
        ({"end": "fault", "message": "KeyError: 1", "cpu_s": 0.1, "growth_mb": 1.0}, "fault"),
        ({"end": "ended", "message": "after 150 CPU s", "cpu_s": 150.0}, "ended"),
        ({"end": "refused", "message": "a\nb", "cpu_s": 0.1, "growth_mb": 1.0}, "a refusal of 2"),
        ({"end": "refused", "message": "a", "cpu_s": 9.0, "growth_mb": 1.0},
         "forecast: 11.0 CPU s"),
        ({"end": "refused", "message": "a", "cpu_s": 1.0, "growth_mb": 2e3}, "forecast: 2180.0 MB"),
        ({"end": "product", "cpu_s": 29.0, "growth_mb": 1.0,
          "predicted": {"cpu_s": 10.0, "worker_memory_mb": 100.0}}, "forecast: 31.0 CPU s"),
        ({"end": "product", "cpu_s": 27.0, "growth_mb": 1.0,
          "predicted": {"cpu_s": 10.0, "worker_memory_mb": 100.0}}, None),
    ],
)  # fmt: skip
def test_verdicts(answer, wrong):
    """The judge itself: what it must object to, and what not."""
    said = fuzz.judge(answer)
    assert (wrong is None and not said) or said[0].startswith(wrong)


def told(refusal: BadInput) -> None:
    """A refusal names its field, is short, and can be printed."""
    assert refusal.field
    assert len(str(refusal).encode()) < 1000


def refused_or_planned(data) -> None:
    """A broken scene is refused by name of the field, or is no broken one and can be planned."""
    try:
        plan_scene(parse_scene(data))
    except BadInput as refusal:
        told(refusal)


def _broken(stock: Stock, count: int, side_px: int) -> None:
    run = settings(max_examples=count, deadline=None, suppress_health_check=CALM)(
        given(st.deferred(lambda: broken(stock, side_px)))(refused_or_planned)
    )
    run()


def test_broken_scenes(stock):
    _broken(stock, FEW, SMALL_PX)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_many_broken_scenes(stock):
    _broken(stock, MANY, LARGE_PX)
