"""Finding what can be seen: the same as looking at every object at every moment."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import BadInput
from pipeline.physics.positions.orbit_screen import WHOLE, states_together
from pipeline.physics.positions.orbit_sgp4 import since_epochs_s
from pipeline.spec.load import load_scene
from pipeline.survey.elements import Elements
from pipeline.survey.find import FindOptions, find
from pipeline.survey.search import make_search
from pipeline.survey.sights import allowed, sights_of
from tests.survey.conftest import EPOCH, watcher

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("tracks", [True, False])
def test_against_brute_force(objects: Elements, tracks: bool) -> None:
    """Every object at every moment, without a screen: nothing missed, nothing more."""
    w = watcher(tracks, lowest_elevation_deg=15.0)
    at = 10.0 * np.arange(0, 720)
    found, failed = make_search(w, at, 5.0).of(objects)
    assert failed == 0
    watch, satellites = w.watch(at), objects.satellites()
    place, speed, codes = states_together(satellites, since_epochs_s(satellites, EPOCH), at)
    assert (codes == WHOLE).all()
    who, when = (i.ravel() for i in np.indices(place.shape[:2]))
    flat = place.reshape(-1, 3), speed.reshape(-1, 3)
    every = sights_of(w, watch, when, who, *flat, objects.reflecting_m2[who], objects.shaded[who])
    every = every.take(allowed(w, watch, every) & (every.snr >= 5.0))
    assert len(every) > 200
    wanted = set(zip(every.object.tolist(), every.moment.tolist(), strict=True))
    assert set(zip(found.object.tolist(), found.moment.tolist(), strict=True)) == wanted


def test_a_night_is_found_and_where_to_point() -> None:
    """The best object of a night stands in the middle of a frame that is pointed as told."""
    path = ROOT / "examples" / "population.yaml"
    found = find(load_scene(path), FindOptions(night=True, step_s=60.0))
    assert found.start == "2019-04-20T05:35:00Z"
    best = found.objects[0]
    assert [o["snr"] for o in found.objects] == sorted(o["snr"] for o in found.objects)[::-1]
    from pipeline.execute.truth import target_truth
    from pipeline.plan.pointing.geometry import plan_geometry
    from pipeline.route.prepare import prepare

    half = "2019-04-20T" + best["best"][11:-1]
    at = np.datetime64(half) - np.timedelta64(1, "s")  # the middle of a frame of 2 s
    turned = [
        f"epoch={at}Z",
        f"pointing.boresight_ra_deg={best['ra_deg']}",
        f"pointing.boresight_dec_deg={best['dec_deg']}",
        "exposure.frames=1",
        "accuracy.check_cells=0",
    ]
    plan = prepare(load_scene(path, turned)).plan
    truth = target_truth(plan, plan_geometry(plan.scene, np.array([0]), plan.dut1_s))
    i = truth["object_name"].index(best["name"])
    assert abs(truth["x_px"][i] - 255.5) < 0.05
    assert abs(truth["y_px"][i] - 255.5) < 0.05
    assert truth["v_mag"][i] == pytest.approx(best["v_mag"], abs=0.01)
    assert truth["electrons"][i] == pytest.approx(best["electrons"], rel=0.01)
    assert truth["snr"][i] == pytest.approx(best["snr"], rel=0.02)


def test_an_empty_field_says_where_to_look() -> None:
    from pipeline.route.prepare import plan_scene

    scene = load_scene(
        ROOT / "examples" / "population.yaml",
        ["sensor.focal_length_m=5.0", "exposure.frames=1", "accuracy.check_cells=0"],
    )
    told = [d["reason"] for d in plan_scene(scene)["decisions"] if "crowd" in d["component"]]
    assert "`nightglass find SCENE`" in told[0]


@pytest.mark.parametrize(
    ("wish", "text"),
    [
        (FindOptions(at="yesterday"), "--at: 'yesterday' is not accepted"),
        (FindOptions(hours=1e4), "--hours: 10000.0"),
        (FindOptions(hours=50.0, step_s=1.0), "--step: 1.0"),
    ],
)
def test_bad_input_is_one_line(wish: FindOptions, text: str) -> None:
    with pytest.raises(BadInput, match=text) as told:
        find(load_scene(ROOT / "examples" / "population.yaml"), wish)
    assert "\n" not in str(told.value)


def test_no_night_and_no_population_are_refused() -> None:
    path = ROOT / "examples" / "population.yaml"
    north = load_scene(path, ["observer.latitude_deg=80", "epoch=2019-06-21T00:00:00Z"])
    with pytest.raises(BadInput, match="--night: 'no darkness'"):
        find(north, FindOptions(night=True))
    with pytest.raises(BadInput, match="populations: 'none'"):
        find(load_scene(ROOT / "examples" / "site-at-night.yaml"), FindOptions())
