"""What a background may ask for, and how mistakes are told."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from pipeline.spec.sky.background import Background, Galactic, Zodiacal


def test_switches_stand_for_defaults():
    b = Background.model_validate({"zodiacal": True, "galactic": True, "starlight": True})
    assert b.zodiacal == Zodiacal(near_sun="refuse")
    assert b.galactic == Galactic(share=0.25)
    assert b.starlight == "all"
    b = Background.model_validate({"zodiacal": False, "uniform_e_per_s": 1.0, "starlight": False})
    assert b.zodiacal is None
    assert (b.starlight, b.varies) == ("none", False)
    assert Background(uniform_e_per_s=1.0).starlight == "auto"


def test_parts_add_up_and_survive_a_round_trip():
    b = Background.model_validate(
        {"zodiacal": {"near_sun": "extrapolate"}, "uniform_mag_arcsec2": 22.0}
    )
    assert b.varies
    assert Background.model_validate(b.model_dump(mode="json")) == b


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({}, "exactly one"),
        ({"uniform_mag_arcsec2": 20.0, "uniform_e_per_s": 1.0}, "exactly one"),
        ({"zodiacal": True, "uniform_mag_arcsec2": 20.0, "uniform_e_per_s": 1.0}, "exactly one"),
        ({"zodiacal": {"near_sun": "guess"}}, "extrapolate"),
        ({"zodical": True}, "did you mean 'zodiacal'"),
        ({"galactic": {"share": 0.9}}, "0.5"),
        ({"starlight": "some"}, "auto"),
        ({"zodiacal": 3}, "zodiacal"),
    ],
)
def test_mistakes(data, said):
    with pytest.raises(ValidationError, match=said):
        Background.model_validate(data)
