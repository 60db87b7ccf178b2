"""Real DR2 rows as a catalogue, and products rendered from them, for the acceptance tests."""

from __future__ import annotations

import copy
import importlib.util
from pathlib import Path

import pytest

from catalog_tools.ingest.ingest import ingest
from pipeline.spec.load import parse_scene

SITE = {"kind": "ground", "latitude_deg": 1.0, "longitude_deg": -113.16, "height_m": 10}
SENSOR = {
    "shape": [2048, 2048],
    "pixel_pitch_um": 9.0,
    "focal_length_m": 2.0,
    "aperture_m": 0.8,
    "obscuration": 0.3,
    "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
    "transmission": 0.8,
    "quantum_efficiency": 0.9,
    "psf": {"kind": "gaussian", "sigma_px": 1.1},
    "gain_e_per_dn": 1.5,
    "adc_bits": 24,
    "bias_dn": 500,
    "dark_e_per_s": 0.1,
    "read_noise_e": 5.0,
}
GEO_TLE = (
    "1 00001U 19001A   19099.72314174  .00000000  00000-0  00000-0 0  9999",
    "2 00001   0.0300 100.0000 0002500 265.0000 318.0950  1.00272800    14",
)
# Every star of DR2 with G < 18 around it is in tests/data; those of the four level-7 trixels 131072
# to 131075, in which it lies, in `wide_catalogue`.
FIELD = {"boresight_ra_deg": 0.70, "boresight_dec_deg": -0.45}


@pytest.fixture(scope="session")
def real_catalogue(published, tmp_path_factory) -> Path:
    """The real stars of the field (tests/data/SOURCE.txt), in shards of at most 100 rows."""
    folder = tmp_path_factory.mktemp("real")
    field = published / "gaia_dr2_field.csv"
    report = ingest([field], folder / "gaia_dr2", form="gaia_dr2", rows_per_leaf=100)
    assert report.rows_in == 359 == report.catalogue.rows + sum(report.rejected.values())
    return folder / "gaia_dr2"


@pytest.fixture(scope="session")
def wide_catalogue(shared_data, tmp_path_factory) -> Path:
    """The eight complete HTM trixels of DR2 around it, ingested in shards of at most 500 rows."""
    folder = tmp_path_factory.mktemp("wide")
    csv = folder / "trixels.csv.gz"
    rows = _lsst_refcat().convert(shared_data / "gaia_dr2" / "lsst_refcat_htm7", csv)
    report = ingest([csv], folder / "gaia_dr2", name="gaia_dr2_trixels", rows_per_leaf=500)
    assert report.rows_in == rows == report.catalogue.rows + sum(report.rejected.values())
    return folder / "gaia_dr2"


def _lsst_refcat():
    path = Path(__file__).parents[1] / "catalog_tools" / "lsst_refcat.py"
    spec = importlib.util.spec_from_file_location("lsst_refcat", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def sidereal(real_catalogue) -> dict:
    """A sidereal frame on the real field, as plain data to vary."""
    return {
        "schema": "nightglass/scene/1",
        "name": "real-sidereal",
        "epoch": "2019-10-20T05:42:30Z",
        "seed": 11,
        "observer": copy.deepcopy(SITE),
        "sensor": copy.deepcopy(SENSOR),
        "pointing": {"mode": "sidereal", **FIELD, "roll_deg": 20.0},
        "exposure": {"integration_s": 10.0},
        "stars": {"catalogue": str(real_catalogue)},
        "background": {"uniform_mag_arcsec2": 21.5},
        "output": {"layers": ["dn", "mean_e"]},
    }


@pytest.fixture(scope="session")
def geo_tle() -> tuple[str, str]:
    """A made-up geostationary satellite, before the field at the epoch for the site below it."""
    return GEO_TLE


@pytest.fixture(scope="session")
def rate_track(sidereal, geo_tle) -> dict:
    """The same sensor following a GEO satellite across the field."""
    scene = copy.deepcopy(sidereal)
    scene["name"] = "real-rate-track"
    scene["pointing"] = {"mode": "target", "target": "amc-4"}
    scene["exposure"] = {"integration_s": 3.0}
    scene["targets"] = [
        {
            "name": "amc-4",
            "orbit": {"kind": "tle", "line1": geo_tle[0], "line2": geo_tle[1]},
            "body": {"kind": "sphere", "diameter_m": 5.0, "albedo": 0.2},
        }
    ]
    return scene


@pytest.fixture(scope="session")
def build():
    """Plain data to a Scene, with dotted changes: build(data, **{"sensor.adc_bits": 12})."""

    def make(data: dict, changes: dict | None = None):
        data = copy.deepcopy(data)
        for key, value in (changes or {}).items():
            *parents, last = key.split(".")
            holder = data
            for part in parents:
                holder = holder.setdefault(part, {})
            holder[last] = value
        return parse_scene(data)

    return make
