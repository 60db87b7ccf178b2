"""Both ways of comparing find what they must: to the bit here, by value on another processor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.pins import compare
from tests.pins.compare import Pin, differences, kind_here, load, store
from tests.pins.draw import Drawn

SHAPE = (1, 100, 200)  # 20,000 pixels: two of them are one in ten thousand
ELSEWHERE = {"processor": "another"}


@pytest.fixture
def drawn() -> Drawn:
    rng = np.random.default_rng(1)
    mean = rng.uniform(0.0, 400.0, SHAPE).astype(np.float32)
    return Drawn(
        {
            "cube/dn": rng.poisson(mean + 100).astype(np.uint16), "cube/mean_e": mean,
            "cube/calibrated_e": rng.normal(0.0, 9.0, SHAPE).astype(np.float32),
            "cube/time_mid": np.array([1_575_187_200_000_000_000]),
            "truth/stars/x_px": rng.uniform(0, 99, 100), "truth/stars/electrons": mean[0, 0, :100],
            "truth/targets/name": np.array(["a", "b"]), "truth/targets/snr": np.array([np.nan, 3]),
        },
        {"noise_floor_e": 5.0, "decisions.adc.kept": True, "targets": 3}, 5.0, 1.0,
    )  # fmt: skip


@pytest.fixture(params=["here", "elsewhere"])
def pin(request: Any, drawn: Drawn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Pin:
    """A pin of this kind of processor, and one of another."""
    if request.param == "elsewhere":
        monkeypatch.setattr(compare, "kind_here", lambda: ELSEWHERE)
    store("one", drawn, tmp_path)
    return load("one", tmp_path)


def with_change(drawn: Drawn, name: str, change: Any) -> Drawn:
    """A copy in which one array is another; change : takes a copy of it, and may return a new."""
    value = drawn.arrays[name].copy()
    found = change(value)
    return replace(drawn, arrays=drawn.arrays | {name: value if found is None else found})


def named(pin: Pin, found: Drawn) -> set[str]:
    return {d.name for d in differences(pin, found, kind_here())}


def test_the_same_is_the_same(pin: Pin, drawn: Drawn) -> None:
    assert named(pin, drawn) == set()


def test_one_dn_in_more_than_one_of_ten_thousand_pixels(pin: Pin, drawn: Drawn) -> None:
    def add(value: np.ndarray) -> None:
        value[0, 0, [3, 50, 120]] += 1

    found = differences(pin, with_change(drawn, "cube/dn", add), kind_here())
    assert [d.name for d in found] == ["cube/dn"]
    assert "3 of 20000 differ, by up to 1" in found[0].how
    assert found[0].sigma == pytest.approx(0.2)


def test_one_dn_in_fewer_pixels_is_another_processors(pin: Pin, drawn: Drawn) -> None:
    def add(value: np.ndarray) -> None:
        value[0, 1, [7, 9]] -= 1

    few = named(pin, with_change(drawn, "cube/dn", add))
    assert few == ({"cube/dn"} if pin.kind == kind_here() else set())


def test_two_dn_in_one_pixel(pin: Pin, drawn: Drawn) -> None:
    def add(value: np.ndarray) -> None:
        value[0, 1, 7] += 2

    assert named(pin, with_change(drawn, "cube/dn", add)) == {"cube/dn"}


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_hundred_thousandth_of_the_noise_in_one_mean(pin: Pin, drawn: Drawn, sign: float) -> None:
    def add(value: np.ndarray) -> None:
        at = value[0, 2, 3]
        value[0, 2, 3] = at + sign * 1e-5 * np.hypot(5.0, np.sqrt(at))

    found = differences(pin, with_change(drawn, "cube/mean_e", add), kind_here())
    assert [d.name for d in found] == ["cube/mean_e"]
    assert 5e-6 < found[0].sigma < 2e-5


def test_the_last_bit_of_a_mean_is_another_processors(pin: Pin, drawn: Drawn) -> None:
    bit = with_change(drawn, "cube/mean_e", lambda v: np.nextafter(v, np.float32(np.inf)))
    assert named(pin, bit) == ({"cube/mean_e"} if pin.kind == kind_here() else set())


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("cube/time_mid", lambda v: v + 1),
        ("truth/stars/x_px", lambda v: v + 2e-6),
        ("truth/stars/electrons", lambda v: v * np.float32(1.00001)),
        ("truth/stars/electrons", lambda v: v[:-1]),
        ("truth/targets/name", lambda v: v[::-1]),
        ("truth/targets/snr", lambda v: np.nan_to_num(v)),
        ("cube/calibrated_e", lambda v: np.where(v > 20.0, v + np.float32(0.1), v)),
        ("cube/dn", lambda v: v.astype(np.int32)),
        ("cube/dn", lambda v: v[:, :-1]),
    ],
    ids=["time", "place", "light", "rows", "names", "nan", "calibrated", "type", "shape"],
)
def test_other_changes(pin: Pin, drawn: Drawn, name: str, change: Any) -> None:
    found = named(pin, with_change(drawn, name, change))
    assert any(name.startswith(one) for one in found)


def test_arrays_that_come_and_go(pin: Pin, drawn: Drawn) -> None:
    rest = {k: v for k, v in drawn.arrays.items() if k != "cube/dn"} | {"cube/new": np.zeros(2)}
    assert named(pin, replace(drawn, arrays=rest)) == {"cube/dn", "cube/new"}


@pytest.mark.parametrize(
    "plan", [{"noise_floor_e": 5.0001}, {"decisions.adc.kept": False}, {"targets": 4}, {"new": 1}]
)
def test_numbers_of_the_plan(pin: Pin, drawn: Drawn, plan: dict[str, Any]) -> None:
    found = named(pin, replace(drawn, plan=drawn.plan | plan))
    assert found == {f"plan {key}" for key in plan}


def test_rounding_of_the_plan_is_another_processors(pin: Pin, drawn: Drawn) -> None:
    found = named(pin, replace(drawn, plan=drawn.plan | {"noise_floor_e": 5.0 + 1e-12}))
    assert found == ({"plan noise_floor_e"} if pin.kind == kind_here() else set())


def test_whole_numbers_to_the_last_digit() -> None:
    """63 bits: a DN beyond what a float holds is not lost."""
    a = np.array([2**62 + 1], np.uint64)
    of = Drawn({}, {}, 5.0, 1.0)
    assert compare.difference("cube/dn", a, a + np.uint64(1), of, exactly=False)
    assert not compare.difference("cube/dn", a, a, of, exactly=False)


def test_the_kind_of_processor_is_named() -> None:
    kind = kind_here()
    assert kind == kind_here()
    assert {"processor", "numpy_extensions", "llvm_extensions", "python", "numpy", "numba",
            "scipy"} <= kind.keys()  # fmt: skip
    assert all(kind[k] for k in ("llvm_processor", "python", "numpy", "numba", "scipy"))
