"""What is said to the programs of other simulators, and how their answers are read."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.studies.accuracy.engines import EngineCase
from pipeline.studies.accuracy.external import PeerFailed, _run, run_skymaker
from pipeline.studies.accuracy.peers import external_settings, installed_peers, peer_settings
from pipeline.studies.accuracy.reference import AiryStar, GaussianStar, exact_pixels, straight

# Stands in for SkyMaker: a pixel for each star of the list, at FITS coordinates, by magnitude.
STAND_IN = """#!{python}
import sys
import numpy as np
from astropy.io import fits
words = sys.argv[2:]
said = dict(zip(words[::2], words[1::2]))
columns, rows = map(int, said["-IMAGE_SIZE"].split(","))
table = fits.getdata(said["-PSF_NAME"])
assert table.shape[0] % 2 == 1 and table.argmax() == table.size // 2
assert abs(table.sum() / int(said["-PSF_OVERSAMP"]) ** 2 - 1.0) < 1e-6
image = np.zeros((rows, columns), np.float32)
for line in open(sys.argv[1]):
    if line.strip():
        kind, x, y, mag = map(float, line.split())
        assert kind == 100
        light = 10 ** (0.4 * (float(said["-MAG_ZEROPOINT"]) - mag))
        image[round(y) - 1, round(x) - 1] += light
fits.writeto(said["-IMAGE_NAME"], image, overwrite=True)
"""


def test_skymaker_is_told_places_light_and_response(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "sky"
    program.write_text(STAND_IN.format(python=sys.executable))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    case = EngineCase(GaussianStar(0.8), straight(0.0, 0.0), 0.0, (300, 400))
    probes = np.array([10.2, 350.0]), np.array([20.0, 280.4])
    made = run_skymaker(case, probes, probes, oversampling=3)
    assert made.image.shape == (300, 400)
    assert made.image[20, 10] == pytest.approx(1.0, rel=1e-5)
    assert made.image[280, 350] == pytest.approx(1.0, rel=1e-5)
    assert made.image.sum() == pytest.approx(2.0, rel=1e-5)
    assert made.table_s > 0
    assert "SkyMaker" in {engine for engine, _, _ in external_settings(case, quick=True)}


def test_peers_that_are_missing_or_fail_are_named(tmp_path: Path) -> None:
    found = {p.name: p for p in installed_peers("/nowhere/python")}
    assert set(found) == {"GalSim", "photutils", "SatSim", "SkyMaker"}
    assert found["SatSim"].version is None
    assert all(p.cannot for p in found.values())
    with pytest.raises(PeerFailed, match="no such thing"):
        _run(["sh", "-c", "echo no such thing >&2; exit 3"], str(tmp_path))


@pytest.mark.parametrize("star", [GaussianStar(0.8), AiryStar(1.0, 0.3)])
@pytest.mark.parametrize(("engine", "streak_px"), [
    ("GalSim", 0.0), ("GalSim", 12.0), ("photutils", 0.0),
])  # fmt: skip
def test_peers_draw_what_is_asked_of_them(
    engine: str, streak_px: float, star: GaussianStar | AiryStar
) -> None:
    """At their finest: the star, its place, its light and its way, against the exact pixels."""
    pytest.importorskip(engine.lower(), reason=f"{engine} is not installed")
    case = EngineCase(star, straight(streak_px, 0.6435), streak_px, (48, 64))
    finest = [s for s in peer_settings(case, quick=False) if s.engine == engine][-1]
    made = finest.make(case).draw(np.array([30.3]), np.array([22.8]), np.array([5.0]))
    exact = exact_pixels(star, case.track, 30.3, 22.8, np.arange(64.0), np.arange(48.0))
    assert np.abs(made - 5.0 * exact).max() < 3e-4
