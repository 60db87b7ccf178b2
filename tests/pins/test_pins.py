"""What is drawn is what is pinned: to the bit on the pins' kind of processor, else by value."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.pins.compare import differences, kind_here, load
from tests.pins.draw import draw
from tests.pins.scenes import NAMES, SCENES


@pytest.mark.parametrize("name", NAMES)
def test_as_pinned(name: str, files: Path, tmp_path: Path) -> None:
    """On purpose otherwise: `make pins`, and a line in CHANGELOG.md (docs/pins.md)."""
    found = differences(load(name), draw(name, files, tmp_path), kind_here())
    assert not found, "\n".join(map(str, found))


@pytest.mark.parametrize("kind", [kind_here(), {"processor": "another"}], ids=["here", "elsewhere"])
@pytest.mark.parametrize("dark_e_per_s", [3.0, 3.0001])
def test_either_way_of_comparing(
    kind: dict[str, str], dark_e_per_s: float, files: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """The scene passes on either kind of processor; 2e-5 of the noise more light fails on both."""
    changes = SCENES["nothing-but-noise"] | {"sensor.dark_e_per_s": dark_e_per_s}
    monkeypatch.setitem(SCENES, "nothing-but-noise", changes)
    drawn = draw("nothing-but-noise", files, tmp_path)
    found = differences(load("nothing-but-noise"), drawn, kind)
    light = [d.sigma for d in found if d.name == "cube/mean_e"]
    assert light == ([] if dark_e_per_s == 3.0 else [pytest.approx(1e-4 / 5.3, rel=0.05)])
    assert bool(found) == bool(light)
