"""Orbits of every kind in a scene: what is accepted, and how mistakes are told."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from pipeline.spec.targets.orbit import Orbit

ADAPTER: TypeAdapter[Any] = TypeAdapter(Orbit)
KEPLER = {"kind": "keplerian", "perigee_radius_m": 7e6, "eccentricity": 0.1,
          "inclination_deg": 50.0, "true_anomaly_deg": 10.0}  # fmt: skip
STATE = {"kind": "numerical", "position_m": [7e6, 0, 0], "velocity_m_s": [0, 7500, 0]}
ELEMENTS = {"epoch": "2019-04-20T00:00:00Z", "mean_motion_rev_day": 15.0, "eccentricity": 0.001,
            "inclination_deg": 50, "raan_deg": 0, "argument_of_perigee_deg": 0,
            "mean_anomaly_deg": 0}  # fmt: skip
TABLE = {"kind": "table", "epoch": "2019-04-20T00:00:00Z",
         "rows": [[0, 7e6, 0, 0], [60, 7e6, 4e5, 0]]}  # fmt: skip


@pytest.mark.parametrize(
    "data",
    [
        KEPLER,
        KEPLER | {"eccentricity": 1.0},
        {**KEPLER, "perigee_radius_m": None, "semi_major_axis_m": -3e7, "eccentricity": 1.4},
        {**KEPLER, "true_anomaly_deg": None, "time_of_perigee": "2019-04-20T00:00:00Z"},
        STATE,
        STATE | {"third_bodies": ["sun", "moon"], "drag_m2_kg": 0.02, "shadow": "cylindrical"},
        {"kind": "omm", "elements": ELEMENTS},
        {"kind": "omm", "path": "gp.json", "object": "25544"},
        {"kind": "ephemeris", "path": "igs.sp3", "object": "G01"},
        TABLE,
    ],
)
def test_accepted_and_the_same_after_a_round_trip(data: dict[str, Any]) -> None:
    orbit = ADAPTER.validate_python(data)
    again = ADAPTER.validate_python(orbit.model_dump(mode="json"))
    assert again == orbit
    assert hash(orbit) == hash(again)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (KEPLER | {"semi_major_axis_m": 8e6}, "perigee_radius_m"),
        (KEPLER | {"mean_anomaly_deg": 8.0}, "mean_anomaly_deg"),
        ({**KEPLER, "true_anomaly_deg": None}, "time_of_perigee"),
        ({**KEPLER, "perigee_radius_m": None, "semi_major_axis_m": 3e7, "eccentricity": 1.4},
         "below 0 for a hyperbola"),
        ({**KEPLER, "true_anomaly_deg": None, "mean_anomaly_deg": 1.0, "eccentricity": 1.0},
         "parabola"),
        (KEPLER | {"eccentricity": float("nan")}, "finite"),
        (KEPLER | {"eccentricity": -0.1}, "greater than or equal to 0"),
        (KEPLER | {"frame": "teme"}, "gcrs"),
        (STATE | {"zonals": 1}, "0, 2, 3, 4, 5 or 6"),
        (STATE | {"position_m": [float("nan"), 0, 0]}, "finite"),
        (STATE | {"third_bodies": ["mars"]}, "moon"),
        ({"kind": "omm"}, "exactly one of path, elements"),
        ({"kind": "omm", "elements": ELEMENTS | {"eccentricity": 1.0}}, "less than 1"),
        ({"kind": "omm", "elements": ELEMENTS | {"mean_motion": 1}}, "mean_motion_rev_day"),
        (TABLE | {"rows": [[0, 7e6, 0, 0], [0, 7e6, 4e5, 0]]}, "increasing times"),
        (TABLE | {"rows": [[0, 7e6, 0, 0], [9, 7e6, 4e5]]}, "4 numbers in every row"),
        (TABLE | {"rows": [[0, 7e6, 0, float("inf")], [9, 7e6, 4e5, 0]]}, "finite"),
        (TABLE | {"rows": [[0, 7e6, 0, 0]]}, "at least 2"),
        ({"kind": "spiral"}, "'tle', 'state', 'omm'"),
        ({"kind": "omm", "elements": ELEMENTS | {"mean_motion_rev_day": 1e-9}}, "to 0.00000001"),
    ],
)  # fmt: skip
def test_refused_with_what_is_allowed(data: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError) as told:
        ADAPTER.validate_python(data)
    assert words in str(told.value)
