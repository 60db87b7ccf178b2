"""What is told of a sensor's band."""

from __future__ import annotations

import pytest

from pipeline.inputs.band.response import gather_band_light, gather_response
from pipeline.spec.load import parse_scene

SPACE = {"kind": "fixed", "position_au": [1.0, 0.0, 0.0]}
SITE = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3}
AIR = SITE | {"atmosphere": {"extinction": True}}


def scene_of(name, observer, more, **sensor):
    return parse_scene({
        "schema": "nightglass/scene/1", "name": "t", "epoch": "2019-04-20T11:00:00Z",
        "observer": observer, "exposure": {"integration_s": 1.0},
        "pointing": {"mode": "sidereal", "boresight_ra_deg": 100.0, "boresight_dec_deg": 40.0},
        "sensor": {"shape": [8, 8], "pixel_pitch_um": 9, "focal_length_m": 0.5, "aperture_m": 0.2,
                   "bandpass": {"kind": "named", "name": name},
                   "psf": {"kind": "gaussian", "sigma_px": 1.0}} | sensor,
    } | more)  # fmt: skip


def said(name, observer, **sensor):
    scene = scene_of(name, observer, {}, **sensor)
    return gather_band_light(scene, *gather_response(scene)).remarks


@pytest.mark.parametrize(
    ("name", "observer", "sensor", "words"),
    [
        ("sdss2010-g", AIR, {}, ["1.3 air masses; extinction dims all light once more"]),
        ("lsst2023-r", SPACE, {}, ["1.2 air masses; the observer is above it"]),
        ("sdss2010-g", SITE, {}, []),
        ("sdss2010noatm-g", AIR, {}, []),
        ("gaiadr2-G", SPACE, {"quantum_efficiency": 0.6}, ["at most 0.71; transmission and"]),
        ("bessell-V", AIR, {"quantum_efficiency": 0.6, "transmission": 0.5}, []),
    ],
)
def test_what_a_published_band_holds_already(name, observer, sensor, words):
    told = said(name, observer, **sensor)
    assert len(told) == len(words)
    assert all(word in sentence for word, sentence in zip(words, told, strict=True))


def test_sunlight_is_there_for_targets_and_for_populations_alone():
    ball = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}
    orbit = {"kind": "state", "position_m": [7e6, 0, 0], "velocity_m_s": [0, 7500, 0]}
    several = {"populations": [{"name": "p", "path": "a.tle", "body": ball}]}
    none, few, many = (
        gather_band_light(scene, *gather_response(scene)).sun_rate_e_s_m2
        for more in ({}, {"targets": [{"name": "t", "orbit": orbit, "body": ball}]}, several)
        for scene in [scene_of("bessell-V", SPACE, more)]
    )
    assert none == 0.0
    assert few == many > 0.0
