"""Watchers for the tests of what sensors can see: a site with a camera, and made-up objects."""

from __future__ import annotations

from typing import Any

import pytest

from pipeline.physics.positions.times import parse_utc
from pipeline.spec.study import FieldOfRegard, Synthetic
from pipeline.survey.elements import Elements, synthetic_elements
from pipeline.survey.watch import Watcher, make_watcher

EPOCH = parse_utc("2019-04-20T06:00:00Z")
CAMERA: dict[str, Any] = {
    "shape": [1024, 1024],
    "pixel_pitch_um": 13.5,
    "focal_length_m": 1.0,
    "aperture_m": 0.4,
    "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
    "quantum_efficiency": 0.8,
    "psf": {"kind": "gaussian", "sigma_px": 0.9},
    "read_noise_e": 5.0,
}


def sections(refraction: bool = False, **more: Any) -> dict[str, Any]:
    """A site on a mountain that extinction dims."""
    air: dict[str, Any] = {"extinction": {"mag_per_airmass": 0.12}, "refraction": refraction}
    site = {"latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055}
    return {
        "observer": {"kind": "ground", **site, "atmosphere": air},
        "sensor": CAMERA,
        "exposure": {"integration_s": 1.0},
        "background": {"uniform_mag_arcsec2": 21.0},
    } | more


def watcher(
    tracks: bool = False, refraction: bool = False, pole: Any = None, **regard: Any
) -> Watcher:
    """A watcher at that site; `pole` : polar motion [arcsec]."""
    asked = sections(refraction)
    asked["observer"]["polar_motion_arcsec"] = pole
    return make_watcher(asked, FieldOfRegard(**regard), EPOCH, tracks, "sensors.0")


@pytest.fixture
def coarse_signal(monkeypatch: pytest.MonkeyPatch) -> None:
    """SNR at fewer lengths of streaks: it is most of what a sensor takes to make."""
    monkeypatch.setattr("pipeline.survey.signal.LENGTHS", 24)


@pytest.fixture(scope="session")
def objects() -> Elements:
    return synthetic_elements(Synthetic(objects=150, seed=5), EPOCH)
