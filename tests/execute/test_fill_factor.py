"""Pixels with gaps under a sharp response: drawn, guarded, and one meaning of truth's electrons."""

from __future__ import annotations

import math

import numpy as np
import pyarrow as pa
import pytest
from scipy.special import erf

from pipeline.errors import NightglassError
from pipeline.execute import light as light_module
from pipeline.execute.truth import collected_e
from pipeline.physics.drawing import stamps
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.route.truths import _bounds
from tests.execute.test_engines import WHOLE, field, geometry_of, plan_of
from tests.execute.test_guards import render

LIGHT_E = 1e5


def collected(phase: float, sigma: float, fill: float) -> float:
    """Part of a Gaussian's light along one axis that squares of side sqrt(fill) catch."""
    k, half = np.arange(-20, 21), 0.5 * math.sqrt(fill)
    ends = [(k + s * half - phase) / (sigma * math.sqrt(2)) for s in (1.0, -1.0)]
    return float(np.sum(0.5 * (erf(ends[0]) - erf(ends[1]))))


@pytest.mark.parametrize("fill", [0.5, 0.25])
@pytest.mark.parametrize("sigma", [0.3, 0.5, 0.8])
def test_bound_on_what_pixels_collect(sigma, fill):
    """Every place within a pixel lies in the range, and middle and corner come near its ends."""
    low, high = Blur(Gaussian(sigma), fill_factor=fill).collected_range()
    phases = np.linspace(0.0, 0.5, 11)
    found = np.array([collected(p, sigma, fill) for p in phases])
    both = np.outer(found, found)
    assert low <= both.min() + 1e-9
    assert both.max() <= high + 1e-9
    assert both.max() - both.min() > 0.5 * (high - low) - 1e-6


def test_limits_of_the_bound():
    assert Blur(Airy(1.0, 0.3)).collected_range() == (1.0, 1.0)
    assert Blur(Gaussian(0.05), fill_factor=0.5).collected_range() == (0.0, 1.0)
    low, high = Blur(Gaussian(5.0), fill_factor=0.5).collected_range()
    assert low == pytest.approx(0.5, abs=1e-12) == high


@pytest.mark.parametrize("at", [60.0, 60.5, 60.25])
def test_drawn_wherever_it_stands(at):
    """A source on a corner between pixels was refused: it sends less than the fill factor there."""
    plan = plan_of({"kind": "gaussian", "sigma_px": 0.5}, 0.0, 0.0, fill=0.5)
    stars = field(np.array([at]), np.array([at]), np.array([LIGHT_E]))
    g = geometry_of(plan)
    drawn = float(light_module.draw_stars(plan, g, WHOLE, [stars], []).sum())
    part = collected(at % 1.0, 0.5, 0.5) ** 2
    assert drawn == pytest.approx(LIGHT_E * part, rel=2e-3)


def test_electrons_of_the_truth_are_the_mean_over_places():
    plan = plan_of({"kind": "gaussian", "sigma_px": 0.5}, 0.0, 0.0, fill=0.5)
    phases = (np.arange(16) + 0.5) / 16.0
    mean = np.mean([collected(p, 0.5, 0.5) for p in phases]) ** 2
    assert collected_e(plan, np.array([LIGHT_E]))[0] == pytest.approx(LIGHT_E * mean, rel=1e-9)


@pytest.mark.parametrize("kind", ["stars", "targets"])
@pytest.mark.parametrize("fill", [1.0, 0.5])
def test_bounds_are_of_the_light_that_falls_not_of_what_truth_says_is_collected(fill, kind):
    """The brightest source is as bright at every fill factor."""
    plan = plan_of({"kind": "gaussian", "sigma_px": 0.8}, 0.0, 0.0, fill=fill)
    light_e = collected_e(plan, np.array([0.1 * LIGHT_E, LIGHT_E]))
    places = ("x_px", "y_px", "x_start_px", "y_start_px", "x_end_px", "y_end_px")
    columns = {name: np.array([60.0, 70.0]) for name in places}
    columns |= {"frame": np.zeros(2, int), "electrons": light_e}
    columns |= {"radius_px": np.zeros(2), "extended": np.zeros(2, bool)}
    assert _bounds(plan, kind, pa.table(columns)).brightest_e == pytest.approx(LIGHT_E, rel=1e-6)


@pytest.mark.parametrize("factor", [0.6, 2.1])
def test_light_lost_or_made_is_seen_with_gaps(factor, monkeypatch):
    def wrong(image, origin, table, x, y, light, cubic):
        stamps.draw_stamps(image, origin, table, x, y, factor * light, cubic)

    monkeypatch.setattr(light_module, "draw_stamps", wrong)
    plan = plan_of({"kind": "gaussian", "sigma_px": 0.8}, 0.0, 0.0, fill=0.5)
    stars = field(np.array([60.2, 90.7]), np.array([70.7, 70.1]), np.array([1e5, 2e5]))
    with pytest.raises(NightglassError, match="stars_e holds"):
        render(plan, stars)
