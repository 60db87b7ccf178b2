"""Jitter and modes of a scene, in arcsec there: as much in radians, on the axis that was named."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter
from scipy.linalg import expm

from pipeline.plan.pointing.attitude_motion import farthest_rad, motion_plan, random_motion_rad
from pipeline.plan.pointing.motion_runs import jitter_bins, mode_of
from pipeline.spec.load import parse_scene
from pipeline.spec.pointing import attitude
from tests.spec.test_limits import BASE

ARCSEC = math.pi / 648_000
HZ = [1.0, 2.0, 5.0, 11.0]


@pytest.mark.parametrize(
    ("part", "arcsec2"),
    [
        ({"kind": "white", "rms_arcsec": 3.0, "low_hz": 0.1, "high_hz": 20.0}, 9.0),
        ({"kind": "power_law", "rms_arcsec": 0.5, "low_hz": 0.1, "high_hz": 20.0}, 0.25),
        ({"kind": "resonance", "rms_arcsec": 2.0, "frequency_hz": 7.0, "damping": 0.02}, 4.0),
        ({"kind": "table", "frequency_hz": HZ, "arcsec2_per_hz": [0.3] * 4}, 0.3 * 10.0),
        ({"kind": "table", "frequency_hz": HZ, "arcsec2_per_hz": [6.0 / f for f in HZ]},
         6.0 * math.log(11.0)),
    ],
)  # fmt: skip
def test_variance_of_a_spectrum(part: dict[str, Any], arcsec2: float) -> None:
    bins = jitter_bins(TypeAdapter(attitude.Jitter).validate_python(part), 3.0)
    assert bins.variance.sum() / ARCSEC**2 == pytest.approx(arcsec2, rel=1e-4)
    assert np.isclose(bins.edge_hz, 3.0, rtol=1e-12).any()


def test_half_the_power_of_a_resonance_lies_within_its_damping_of_its_frequency() -> None:
    """Of a Lorentzian, to terms of the damping; the bins follow a peak so narrow."""
    f, damping = 7.0, 1e-4
    part = attitude.ResonanceJitter(
        kind="resonance", rms_arcsec=2.0, frequency_hz=f, damping=damping
    )
    bins = jitter_bins(part, 3.0)
    near = np.abs(bins.middle_hz / f - 1.0) < damping
    edges = bins.edge_hz[:-1][near].min(), bins.edge_hz[1:][near].max()
    low, high = ((edge / f - 1.0) / damping for edge in edges)
    expected = (math.atan(high) - math.atan(low)) / math.pi
    assert expected == pytest.approx(0.5, abs=0.1)
    assert bins.variance[near].sum() / bins.variance.sum() == pytest.approx(expected, rel=1e-3)


def spread(mode: dict[str, Any], seconds: float) -> np.ndarray:
    """Covariance (3, 3) [arcsec^2] of what a mode moves, so long after the epoch (Van Loan)."""
    made = mode_of(TypeAdapter(attitude.Mode).validate_python(mode), 0)
    n = len(made.a)
    block = np.block([[-made.a, made.b @ made.b.T], [np.zeros((n, n)), made.a.T]])
    whole = expm(block * seconds)
    phi = whole[n:, n:].T
    x = phi @ made.start @ phi.T + phi @ whole[:n, n:]
    return made.c @ x @ made.c.T / ARCSEC**2


W = 2.0 * math.pi * 0.3
MODES: dict[str, tuple[dict[str, Any], Any]] = {
    "oscillator": (
        {"kind": "oscillator", "frequency_hz": 0.3, "damping": 0.1, "rms_arcsec": 3.0},
        lambda t: 9.0,
    ),
    "oscillator's noise": (
        {"kind": "oscillator", "frequency_hz": 0.3, "damping": 0.1, "noise_arcsec_s2_rthz": 2.0},
        lambda t: 4.0 / (4.0 * 0.1 * W**3),
    ),
    "markov": (
        {"kind": "markov", "time_constant_s": 5.0, "rms_arcsec": 3.0},
        lambda t: 9.0,
    ),
    "markov's noise": (
        {"kind": "markov", "time_constant_s": 5.0, "noise_arcsec_s_rthz": 2.0},
        lambda t: 4.0 * 5.0 / 2.0,
    ),
    "random walk": (
        {"kind": "random_walk", "arcsec_rts": 0.2},
        lambda t: 0.04 * t,
    ),
    "rate": (  # twice the integral of (t - s) times the rate's covariance at lag s
        {"kind": "rate_markov", "time_constant_s": 5.0, "rms_arcsec_s": 0.7},
        lambda t: 2.0 * (0.7 * 5.0) ** 2 * (t / 5.0 - 1.0 + math.exp(-t / 5.0)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("axis", ["x", "y", "roll"])
@pytest.mark.parametrize("name", MODES)
def test_variance_of_a_mode_on_its_axis(name: str, axis: str) -> None:
    mode, arcsec2 = MODES[name]
    for seconds in (0.5, 4.0):
        expected = np.zeros((3, 3))
        k = ("x", "y", "roll").index(axis)
        expected[k, k] = arcsec2(seconds)
        found = spread(mode | {"axis": axis}, seconds)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_variance_of_a_system() -> None:
    """Two processes that settle, one on each of two axes, and one that walks from zero."""
    c = [[3.0, 0.0], [0.0, 0.0], [0.0, 0.5]]
    settled = {"kind": "system", "a": [[-0.5, 0.0], [0.0, -2.0]], "b": [[1.0, 0.0], [0.0, 1.0]],
               "c": c}  # fmt: skip
    np.testing.assert_allclose(spread(settled, 4.0), np.diag([9.0, 0.0, 0.25 / 4.0]), atol=1e-12)
    walks = settled | {"a": [[0.0, 0.0], [0.0, 0.0]]}
    np.testing.assert_allclose(spread(walks, 4.0), np.diag([36.0, 0.0, 1.0]), atol=1e-12)


def test_how_far_a_path_goes_is_found_in_little_time_of_any_many_frames() -> None:
    """All frames of few; of 100,000 twice as far as in some that are spread over them."""
    wanders = {"modes": [{"kind": "markov", "axis": "x", "time_constant_s": 50.0,
                          "rms_arcsec": 600.0}]}  # fmt: skip
    found = []
    for frames in (40, 100_000):
        data = BASE | {"exposure": {"integration_s": 1.0, "frames": frames}}
        s = parse_scene(data | {"pointing": BASE["pointing"] | {"attitude": wanders}})
        found.append(farthest_rad(s))
    plan = motion_plan(s)
    assert plan is not None
    few = random_motion_rad(s, np.arange(0, 100_000, 101), plan.nodes)
    seen = np.hypot(few[..., 0], few[..., 1]).max()
    assert found[1] >= seen
    assert 0.0 < found[0] < found[1] < 12.0 * np.radians(600.0 / 3600.0)
    assert farthest_rad(parse_scene(BASE)) == 0.0
