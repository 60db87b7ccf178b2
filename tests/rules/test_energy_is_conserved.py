"""Energy is conserved: what is drawn of a source is all of its light, wherever it stands.

The electrons drawn for a source, summed over an unbounded focal plane, are its photo-electrons in
the band to within the accuracy asked for: for any phase in its pixel, any streak, any response and
any border between tiles.
"""

# Deeper, elsewhere: tests/physics/drawing (each way of drawing: test_stamps.py, test_wings.py,
# test_spectral.py, test_extended.py), tests/execute/test_engines.py, test_fill_factor.py,
# test_psf_field.py, test_bright_sources.py, tests/execute/test_truth_magnitudes.py and
# tests/physics/test_radiometry.py (electrons of a source), tests/execute/test_guards.py (light that
# is lost or made stops a render).

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pipeline.execute.blocks import render_block
from pipeline.execute.light import draw_stars
from pipeline.plan.tiles import Tile
from pipeline.route.run import Options, render
from pipeline.studies.accuracy.reference import AiryStar, GaussianStar, exact_pixels, straight
from tests.execute.test_engines import field, geometry_of, plan_of
from tests.rules.conftest import layers, truth

SIDE, LIGHT_E = 400, 1e4
WHOLE = Tile(0, 0, 0, 0, SIDE, SIDE)
FLUX_FRACTION = 1e-3
SHAPES = {
    "gaussian": ({"kind": "gaussian", "sigma_px": 0.4}, GaussianStar(0.4)),
    "wide": ({"kind": "gaussian", "sigma_px": 3.0}, GaussianStar(3.0)),
    "airy": ({"kind": "airy", "wavelength_nm": 650.0}, AiryStar(1.0, 0.3)),
}


def cut(row: int, column: int) -> tuple[Tile, ...]:
    """Four tiles that cover the frame, with their common corner at a pixel."""
    spans = [((0, n), (n, SIDE - n)) for n in (row, column)]
    return tuple(
        Tile(i, j, y0, x0, rows, columns)
        for i, (y0, rows) in enumerate(spans[0]) for j, (x0, columns) in enumerate(spans[1])
    )  # fmt: skip


def blocks_of(plan: Any, stars: Any) -> list[Any]:
    """The light far from the stars, of all of the frame."""
    if not plan.responses.spacing_px:
        return []
    return [render_block(plan, geometry_of(plan), WHOLE, [stars])]


def in_tiles(plan: Any, stars: Any, blocks: list[Any], tiles: tuple[Tile, ...]) -> float:
    """Light of all tiles together [e-]."""
    g = geometry_of(plan)
    return float(sum(draw_stars(plan, g, tile, [stars], blocks).sum() for tile in tiles))


@given(
    name=st.sampled_from(list(SHAPES)), x=st.floats(0.0, 1.0), y=st.floats(0.0, 1.0),
    dx=st.floats(-60.0, 60.0), dy=st.floats(-60.0, 60.0), moving=st.booleans(),
    row=st.integers(170, 230), column=st.integers(170, 230),
)  # fmt: skip
@example("airy", 0.5, 0.5, 0.0, 0.0, False, 200, 200)
@example("airy", 0.0, 0.5, 55.0, -3.0, True, 200, 201)
@settings(max_examples=16)
def test_all_light_of_a_source_is_drawn(name, x, y, dx, dy, moving, row, column):
    """The frame holds what it catches of the response, by quadrature over it as one square: all but
    what falls beside it, however far that reaches. Four tiles meet beside the source."""
    psf, shape = SHAPES[name]
    dx, dy = (dx, dy) if moving else (0.0, 0.0)
    plan = plan_of(psf, dx, dy, SIDE)
    at = 200.0 + x, 200.0 + y
    stars = field(np.array([at[0]]), np.array([at[1]]), np.array([LIGHT_E]))
    drawn = in_tiles(plan, stars, blocks_of(plan, stars), cut(row, column))
    track = straight(float(np.hypot(dx, dy)), float(np.arctan2(dy, dx)))
    middle = np.array([0.5 * (SIDE - 1)])
    caught = exact_pixels(shape, track, *at, middle, middle, width=float(SIDE))[0, 0]
    assert 0.99 < caught < 1.0 + 1e-9
    assert drawn == pytest.approx(LIGHT_E * caught, rel=FLUX_FRACTION)


@pytest.fixture(scope="module")
def crowd():
    """Streaked sources all over the frame, and beside it, and their light without any border."""
    plan, rng = plan_of(SHAPES["airy"][0], 21.0, -13.0, SIDE), np.random.default_rng(4)
    x, y = rng.uniform(-30.0, SIDE + 30.0, (2, 60))
    stars = field(x, y, 10.0 ** rng.uniform(2.0, 4.0, 60))
    blocks = blocks_of(plan, stars)
    return plan, stars, blocks, in_tiles(plan, stars, blocks, (WHOLE,))


@given(row=st.integers(1, SIDE - 1), column=st.integers(1, SIDE - 1))
@example(200, 200)
@settings(max_examples=6)
def test_no_border_takes_light_or_makes_it(crowd, row, column):
    """Wherever four tiles meet."""
    plan, stars, blocks, whole_e = crowd
    assert in_tiles(plan, stars, blocks, cut(row, column)) == pytest.approx(whole_e, rel=1e-12)


AB_RATE = 3.631e-23 / 6.62607015e-34  # photons a second and m2 of AB = 0, per ln(wavelength)


@pytest.mark.parametrize("psf", [SHAPES["wide"][0], {"kind": "moffat", "fwhm_px": 2.1}], ids=str)
def test_a_products_light_is_that_of_its_band(scene, tmp_path, psf):
    """A target on the corner of four tiles: photons of its AB magnitude through band, pupil, optics
    and detector; drawn are all of them, but for what a response sends beyond the frame."""
    sensor = {"sensor.shape": [512, 512], "sensor.psf": psf, "stars": None, "background": None,
              "cosmic_rays": None, "exposure": {"integration_s": 2.0}}  # fmt: skip
    wish = scene(sensor | {"output": {"layers": ["dn", "targets_e"], "tile_shape": [256, 256]}})
    render(wish, tmp_path / "run", Options("synchronous"))
    target, s = truth(tmp_path / "run", "targets"), wish.sensor
    assert np.abs(np.array([target["x_px"][0], target["y_px"][0]]) - 255.5).max() < 0.1
    pupil_m2 = 0.25 * np.pi * s.aperture_m**2 * (1.0 - s.obscuration**2)
    photons = AB_RATE * np.log(900.0 / 400.0) * 10.0 ** (-0.4 * target["mag_ab"][0]) * pupil_m2
    electrons = 2.0 * photons * s.transmission * s.quantum_efficiency
    assert target["electrons"][0] == pytest.approx(electrons, rel=1e-4)
    drawn = float(layers(tmp_path / "run")["targets_e"].astype(float).sum())
    assert drawn == pytest.approx(electrons, rel=2.0 * FLUX_FRACTION)
