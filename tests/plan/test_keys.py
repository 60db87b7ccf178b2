"""Every key under which something is kept names all that it follows from."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline import kept as store
from pipeline.execute import tables
from pipeline.physics.drawing.wings import WingGrid
from pipeline.physics.motion.streak import Path
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.radiometry import ResponseCurve, box
from pipeline.plan.facts import gather_facts
from pipeline.plan.optics import optics
from pipeline.plan.response import responses
from pipeline.resolve.resolve import resolve
from pipeline.survey import signal

BLUR, OTHER = Blur(Gaussian(0.8)), Blur(Airy(2.0, 0.0))
PIECE = Path(np.array([-2.0, 2.0]), np.array([0.0, 1.0]), np.ones(1))
LONGER = Path(np.array([-3.0, 3.0]), np.array([0.0, 1.0]), np.ones(1))
FAR = Path(np.array([-40.0, 40.0]), np.array([0.0, 9.0]), np.ones(1))
GRID = WingGrid(40, 50, 2, 0.0, 0.0)


class Asked(Exception):
    """Ends what is looked at once its key is known."""


@contextmanager
def keys(monkeypatch: pytest.MonkeyPatch, module: Any, name: str) -> Iterator[list[str]]:
    """Digests of the keys that a module asks what is kept by; nothing is made."""
    found: list[str] = []

    def ask(content: tuple[object, ...], _: Callable[[], Any]) -> Any:
        found.append(store._digest(content))
        raise Asked

    with monkeypatch.context() as here:
        here.setattr(module, name, ask)
        yield found


def digests(monkeypatch: Any, module: Any, name: str, calls: list[Callable[[], Any]]) -> list[str]:
    with keys(monkeypatch, module, name) as found:
        for call in calls:
            with suppress(Asked):
                call()
    assert len(found) == len(calls)
    return found


@pytest.mark.parametrize(
    ("module", "name", "function", "first", "changes"),
    [
        (responses, "kept_number", responses._measured_wing_error.__wrapped__,
         (BLUR, 5.0, 2, PIECE), (OTHER, 6.0, 4, LONGER)),
        (responses, "kept_number", responses._measured_wing_slope.__wrapped__,
         (BLUR, 5.0), (OTHER, 6.0)),
        (responses, "kept_number", responses.point_curvature.__wrapped__, (BLUR,), (OTHER,)),
        (responses, "kept_number", responses.point_slope.__wrapped__, (BLUR,), (OTHER,)),
        (tables, "kept_array", tables.kernel_of, (BLUR, 5.25, GRID, 31.0),
         (OTHER, 6.0, replace(GRID, rows=41), 32.0)),
        (tables, "kept_array", tables.kernel_of, (BLUR, 5.25, GRID, 31.0),
         (OTHER, 6.0, replace(GRID, columns=41), 32.0)),
        (tables, "kept_array", tables.kernel_of, (BLUR, 5.25, GRID, 31.0),
         (OTHER, 6.0, replace(GRID, spacing_px=4), 32.0)),
    ],
)  # fmt: skip
def test_each_argument_is_in_the_key(
    module: Any, name: str, function: Any, first: tuple[Any, ...], changes: tuple[Any, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    calls = [lambda: function(*first)]
    for i, change in enumerate(changes):
        other = (*first[:i], change, *first[i + 1 :])
        calls.append(lambda other=other: function(*other))
    found = digests(monkeypatch, module, name, calls)
    assert len(set(found)) == len(calls)


@pytest.mark.parametrize(
    ("function", "first", "changes"),
    [
        (tables.swept_core, (BLUR, 5.0, PIECE), (OTHER, 6.0, LONGER)),
        (tables.still_core, (BLUR, 5.0, PIECE), (OTHER, 6.0, FAR)),
        (tables.table_of, (BLUR, 5.0, PIECE, 8), (OTHER, 6.0, LONGER, 16)),
        (tables.spectral_plan_of, (BLUR, 5.0, PIECE, (64, 80), 100, 1e-4),
         (OTHER, 6.0, FAR, (80, 64), 100_000, 1e-5)),
    ],
)  # fmt: skip
def test_each_argument_is_in_the_key_in_memory(
    function: Any, first: tuple[Any, ...], changes: tuple[Any, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    found: list[Hashable] = []

    def get(key: Any, make: Callable[[], Any], _: Any) -> Any:
        if key[0] == "core" and function is not tables.core_of:
            return make()
        found.append(key)
        raise Asked

    monkeypatch.setattr(tables, "_CACHE", SimpleNamespace(get=get))
    for i, change in enumerate((first[0], *changes), start=-1):
        with suppress(Asked):
            function(*first[: max(i, 0)], change, *first[max(i, 0) + 1 :])
    assert len(found) == len(set(found)) == len(changes) + 1


def test_curvature_and_slope_are_kept_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    both = [lambda: responses.point_curvature.__wrapped__(BLUR),
            lambda: responses.point_slope.__wrapped__(BLUR)]  # fmt: skip
    assert len(set(digests(monkeypatch, responses, "kept_number", both))) == 2


def test_wavelengths_are_kept_by_all_that_chooses_them(
    scene: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The band's shape between the same ends; telescope, jitter, accuracy, and the light there."""
    flat = box(400e-9, 900e-9)
    slope = ResponseCurve(flat.wavelength_m, flat.value * np.linspace(1.0, 0.2, len(flat.value)))
    airy: dict[str, Any] = {"sensor.psf": {"kind": "airy"}}
    asked = [
        (airy, flat, {}), (airy, slope, {}), (airy, box(400e-9, 850e-9), {}),
        (airy, box(420e-9, 900e-9), {}), (airy, flat, {"brightest_e": 1e6}),
        (airy, flat, {"brightest_e": 1e7}), (airy | {"sensor.obscuration": 0.4}, flat, {}),
        (airy | {"sensor.focal_length_m": 2.0}, flat, {}),
        (airy | {"accuracy": {"flux_fraction": 1e-2}}, flat, {}),
        (airy | {"sensor.fill_factor": 0.9}, flat, {}),
        ({"sensor.psf": {"kind": "airy", "wavelengths": 3}}, flat, {}),
        ({"sensor.psf": {"kind": "airy", "defocus_um": 9.0}}, flat, {}),
        ({"sensor.psf": {"kind": "kolmogorov", "fwhm_arcsec": 1.0}}, flat, {}),
        ({"sensor.psf": {"kind": "kolmogorov", "fwhm_arcsec": 1.1}}, flat, {}),
    ]  # fmt: skip
    calls = [
        lambda c=changes, r=response, m=more: gather_facts(scene(c), r, 0.0, 5.0, 1.0, **m)
        for changes, response, more in asked
    ]
    found = digests(monkeypatch, optics, "kept", calls)
    assert len(set(found)) == len(asked)


def test_signal_tables_are_kept_by_all_that_they_follow_from(
    scene: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The response, the noise, the light that is lost, the frame's size, the table's own; another
    seed, place or name is no other table."""
    base = {
        "stars": None, "background": {"uniform_e_per_s": 3.0}, "sensor.flat": 0.9,
        "sensor.psf": {"kind": "gaussian", "sigma_px": 0.9}, "exposure": {"integration_s": 2.0},
    }  # fmt: skip
    asked: list[dict[str, Any]] = [
        {}, {"sensor.psf": {"kind": "gaussian", "sigma_px": 1.0}}, {"sensor.read_noise_e": 6.0},
        {"sensor.photon_noise": False}, {"sensor.flat": 0.8}, {"sensor.shape": [511, 768]},
        {"exposure": {"integration_s": 2.5}}, {"background": {"uniform_e_per_s": 3.5}},
        {"sensor.dark_e_per_s": 1.0}, {"sensor.fill_factor": 0.9},
    ]  # fmt: skip
    same: list[dict[str, Any]] = [
        {"seed": 5}, {"name": "other"}, {"pointing.boresight_ra_deg": 50.0},
        {"sensor.full_well_e": 9e4},
    ]  # fmt: skip
    calls = [
        lambda of=resolve(scene(base | change)).scene: signal.signal_table(of)
        for change in (*same, *asked)
    ]
    found = digests(monkeypatch, signal, "kept", calls)
    assert len(set(found)) == len(asked)
    assert len(set(found[: len(same) + 1])) == 1
    monkeypatch.setattr(signal, "LENGTHS", 24)
    [coarse] = digests(monkeypatch, signal, "kept", calls[:1])
    assert coarse not in found
