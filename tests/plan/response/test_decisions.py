"""How the plan's decisions about responses read."""

from __future__ import annotations

from pipeline.plan.response.decisions import _in_nm


def test_wavelengths_are_named_once_and_many_by_their_ends():
    assert _in_nm([406.8]) == "407"
    assert _in_nm([470.7, 471.2, 475.9, 482.0]) == "471, 476, 482"
    assert _in_nm([470.0 + k for k in range(20)]).count(",") == 19
    many = [470.6 + 0.5 * k for k in range(330)]
    assert _in_nm(many) == "330 wavelengths from 471 to 635"
