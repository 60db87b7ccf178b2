"""Responses over the field: shares of light, what the plan makes of them, error between places."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.physics.psf.aperture import Pupil
from pipeline.physics.psf.pupil import Blur, Gaussian
from pipeline.physics.psf.response import compact_core
from pipeline.physics.psf.sampled import sampled
from pipeline.physics.psf.zernike import defocus_rms
from pipeline.physics.radiometry import box
from pipeline.plan.facts import Facts, gather_facts
from pipeline.plan.optics.psf_field import PsfField, _along, _between
from pipeline.plan.pointing.geometry import camera_of, plan_geometry
from pipeline.plan.response.responses import ResponsePlan, plan_responses, point_curvature
from pipeline.spec.scene import Scene

Make = Callable[..., Scene]
B = [Blur(Gaussian(1.0 + 0.1 * k)) for k in range(6)]
FIELD = PsfField((0.0, 100.0), (0.0, 50.0, 200.0), tuple(B), tuple(range(6)))


def facts_of(s: Scene, **more: Any) -> Facts:
    return gather_facts(s, box(400e-9, 900e-9), 0.0, 5.0, 1.0, **more)


def responses_of(s: Scene) -> ResponsePlan:
    ends = plan_geometry(s, np.array([0, s.exposure.frames - 1]), 0.0)
    return plan_responses(s, facts_of(s), camera_of(s), ends)


def defocused(*um: float, rows: int = 1) -> dict[str, Any]:
    """A field over 768 columns with a defocus at equally spaced columns."""
    row = [{"kind": "airy", "wavelength_nm": 650.0, "defocus_um": d} for d in um]
    return {
        "kind": "field", "rows_px": [511.0 / 2 * k for k in range(rows)],
        "columns_px": list(np.linspace(0.0, 767.0, len(um))), "psfs": [row] * rows,
    }  # fmt: skip


PLACE = st.floats(-500.0, 700.0)


@given(st.lists(st.tuples(PLACE, PLACE), min_size=1, max_size=20))
def test_shares_are_positive_and_sum_to_one(places: list[tuple[float, float]]) -> None:
    x, y = np.array(places).T
    found = list(FIELD.shares(x, y))
    assert all((share >= 0).all() for _, share in found)
    np.testing.assert_allclose(sum(share for _, share in found), 1.0, rtol=0, atol=4e-16)
    assert (sum(np.sign(share) for _, share in found) <= 4).all()
    near = FIELD.near(y.min(), y.max(), x.min(), x.max())
    assert {blur for blur, _ in found} == set(near)
    light = np.geomspace(1.0, 1e6, len(x))
    total = np.zeros(len(x))
    for _, which, part in FIELD.parts(x, y, light):
        total[which] += part
    np.testing.assert_allclose(total, light, rtol=1e-15)


def test_shares_at_places_between_and_outside() -> None:
    def at(x: float, y: float) -> dict[int, float]:
        parts = FIELD.parts(np.array([x]), np.array([y]), np.ones(1))
        return {B.index(blur): float(part[0]) for blur, _, part in parts}

    assert at(50.0, 100.0) == {4: 1.0}
    assert at(-80.0, 1e4) == {3: 1.0}
    assert at(125.0, 50.0) == {1: 0.25, 2: 0.25, 4: 0.25, 5: 0.25}
    assert at(80.0, 0.0) == pytest.approx({1: 0.8, 2: 0.2})
    assert list(FIELD.parts(np.empty(0), np.empty(0), np.empty(0))) == []
    single = PsfField((7.0,), (3.0,), (B[0],), (0,))
    assert [len(which) for _, which, _ in single.parts(*np.ones((3, 5)))] == [5]


def test_alike_places_share_a_response(scene: Make) -> None:
    f = facts_of(scene({"sensor.psf": defocused(30.0, 0.0, 30.0, rows=2)}))
    assert f.field is not None
    assert f.field.which == (0, 1, 0, 0, 1, 0)
    assert len(f.field.blurs) == 2
    assert point_curvature(f.blur) == max(point_curvature(b) for b in f.field.blurs)
    assert f.blur == f.field.blurs[1]


def test_without_a_field_there_is_none(scene: Make) -> None:
    f = facts_of(scene())
    assert f.field is None
    r = responses_of(scene())
    assert r.blurs == (f.blur,)
    assert (r.field, r.table_mb) == (None, 0.0)
    light = np.ones(3)
    ((blur, which, part),) = r.parts(light, light, light)
    assert blur is r.blur
    assert which == slice(None)
    assert part is light


def test_the_worst_response_sets_radii_grid_and_reach(scene: Make) -> None:
    wide, sharp = (responses_of(scene({"sensor.psf": defocused(d)})) for d in (60.0, 0.0))
    both = responses_of(scene({"sensor.psf": defocused(60.0, 0.0)}))
    assert both.spacing_px == wide.spacing_px
    assert both.reach_px == max(wide.reach_px, sharp.reach_px)
    assert [c.radius_px for c in both.classes] == [c.radius_px for c in wide.classes]
    assert both.classes[0].wing_error >= wide.classes[0].wing_error
    assert 0 < both.table_mb < 200.0
    assert both.field is not None
    told = both.field.reason(both.table_mb)
    assert "2 point-spread function(s) at 1 x 2 places" in told
    assert "along rows and columns, only three places or more tell" in told


def test_many_places_keep_to_the_memory_for_tables(scene: Make) -> None:
    psfs = [
        [{"kind": "gaussian", "sigma_px": 3.0 + 0.01 * (9 * i + j), "oversampling": 128}
         for j in range(9)] for i in range(9)
    ]  # fmt: skip
    places = [50.0 * k for k in range(9)]
    psf = {"kind": "field", "rows_px": places, "columns_px": places, "psfs": psfs}
    r = responses_of(scene({"sensor.psf": psf}))
    assert len(r.blurs) == 81
    assert r.spacing_px == 0
    assert 8 <= r.classes[0].phases < 128
    assert r.table_mb <= 80.0


@pytest.mark.parametrize(("from_um", "to_um"), [(0.0, 40.0), (-20.0, 20.0), (10.0, 50.0)])
def test_error_between_places_falls_and_is_bounded(from_um: float, to_um: float) -> None:
    """A defocus that grows along the columns, against the true one in the middle of each cell."""
    errors, bounds = [], []
    for count in (2, 3, 5):
        um = np.linspace(from_um, to_um, count)
        at = np.linspace(0.0, 767.0, count)
        blurs = [defocus(float(d)) for d in um]
        error = _between((0.0,), tuple(at), blurs)
        field = PsfField((0.0,), tuple(at), tuple(blurs), tuple(range(count)), error)
        worst = 0.0
        for x, d in zip(0.5 * (at[1:] + at[:-1]), 0.5 * (um[1:] + um[:-1]), strict=True):
            mixed = field.parts(np.array([x]), np.zeros(1), np.ones(1))
            image = sum(part[0] * samples(blur) for blur, _, part in mixed)
            worst = max(worst, float(np.abs(image - samples(defocus(float(d)))).max()))
        errors.append(worst)
        bounds.append(error[1])
        assert error[0] is None
    assert bounds[0] is None
    assert errors[0] > 1.4 * errors[1] > 2.8 * errors[2] > 0.001
    assert 1.0 < bounds[1] / errors[1] < 5.0
    assert 1.0 < bounds[2] / errors[2] < 2.5


def defocus(um: float) -> Blur:
    """An f/2.5 telescope at 650 nm, Q 1.6, out of focus."""
    return Blur(Pupil(1.6, 0.3, None, ((4, defocus_rms(um * 1e-6, 2.5) / 650e-9),)))


def samples(blur: Blur) -> np.ndarray:
    return compact_core(blur, 40.0).samples


def test_error_along_rows_of_unequal_steps_is_that_of_a_parabola() -> None:
    """Second differences are exact for a response that is quadratic in its place."""
    places = (0.0, 30.0, 100.0)
    images = np.array([[[2.0 + 1e-4 * (y - 10.0) ** 2, -y]] for y in places])
    assert _along(places, images) == pytest.approx(3.0 * 2e-4 * 70.0**2 / 8.0)
    assert _along(places[:2], images[:2]) is None


def test_tables_of_light_stand_at_their_places(scene: Make) -> None:
    at = np.arange(-24, 25) / 8.0
    tables = [
        sampled(np.exp(-0.5 * (at[:, None] ** 2 + at**2) / s**2), 0.125, (24.0, 24.0), 1.0)
        for s in (0.6, 0.7)
    ]
    table = {"kind": "table", "path": "x.npy", "samples_per_px": 8.0}
    gauss = {"kind": "gaussian", "sigma_px": 1.0}
    psf = {"kind": "field", "rows_px": [0.0], "columns_px": [0.0, 100.0, 200.0],
           "psfs": [[table, gauss, table | {"path": "y.npy"}]]}  # fmt: skip
    f = facts_of(scene({"sensor.psf": psf}), table=(tables[0], None, tables[1]))
    assert f.field is not None
    assert [b.optics for b in f.field.blurs] == [tables[0], Gaussian(1.0), tables[1]]
    assert "3 point-spread" in f.field.reason(1.0)
    assert "along columns of its source's light" in f.field.reason(1.0)
    assert json.loads(json.dumps(f.field.describe()))["which"] == [0, 1, 2]


@pytest.mark.parametrize("first", [0, 1])
def test_the_band_that_errs_most_is_told(scene: Make, first: int) -> None:
    """Of a place resolved at one wavelength, and of one that takes its whole band."""
    psfs = [{"kind": "airy", "wavelength_nm": 650.0}, {"kind": "airy", "wavelengths": 2}]
    psf = {"kind": "field", "rows_px": [0.0], "columns_px": [0.0, 767.0],
           "psfs": [[psfs[first], psfs[1 - first]]]}  # fmt: skip
    band = facts_of(scene({"sensor.psf": psf})).band
    assert band is not None
    assert len(band.wavelengths_m) == 2
    assert band.error > 0.0
