"""Designs: every point by its number alone, evenly spread, in an order that keeps light."""

from __future__ import annotations

import itertools
import json
import tracemalloc

import numpy as np
import pytest
from scipy.stats import qmc

from pipeline.errors import BadInput
from pipeline.spec.load import MAX_BYTES
from pipeline.spec.sweep_load import load_sweep, parse_sweep, read_sweep
from pipeline.sweep.dependence import AFTER_LIGHT
from pipeline.sweep.design import BLOCK, Design
from pipeline.sweep.points import later_seed


def design(axes, **rest) -> Design:
    head = {"schema": "nightglass/sweep/1", "name": "d", "scene": "s.yaml"}
    return Design(parse_sweep(head | {"axes": axes} | rest))


def test_grid_is_the_product_of_the_axes():
    made = design([
        {"field": "a", "values": [1, 2]}, {"field": "b", "values": ["x", None, True]},
        {"field": "c", "kind": "range", "start": 0, "stop": 1, "count": 3},
    ], seeds=2)  # fmt: skip
    found = [(*made.values(p).values(), made.seed_step(p)) for p in range(made.size)]
    assert found == list(itertools.product([1, 2], ["x", None, True], [0.0, 0.5, 1.0], [0, 1]))


@pytest.mark.parametrize("seed", [7, 7.0, "7"])
def test_every_seed_that_a_scene_takes_goes_on(seed):
    assert [later_seed(seed, step) for step in range(3)] == [7, 8, 9]
    assert [later_seed(wrong, 2) for wrong in (True, 7.5, "x", None)] == [True, 7.5, "x", None]


def test_zip_and_ranges():
    made = design([
        {"field": "a", "kind": "log_range", "start": 1, "stop": 1000, "count": 4},
        {"field": "b", "kind": "range", "start": 9, "stop": 0, "count": 4, "integer": True},
        {"kind": "table", "fields": ["c", "d"], "rows": [[i, -i] for i in range(4)]},
    ], design={"kind": "zip"})  # fmt: skip
    found = [made.values(p) for p in range(made.size)]
    assert [v["a"] for v in found] == pytest.approx([1, 10, 100, 1000], rel=1e-12)
    assert [v["b"] for v in found] == [9, 6, 3, 0]
    assert found[2]["c"] == -found[2]["d"] == 2


def test_grid_order_takes_detector_axes_last():
    made = design([
        {"field": "sensor.bias_dn", "values": [1, 2, 3]},
        {"field": "exposure.integration_s", "values": [1, 2]},
        {"field": "seed", "values": [5, 6]},
    ], seeds=2)  # fmt: skip
    order = list(made.order(frozenset(AFTER_LIGHT)))
    assert sorted(order) == list(range(made.size))
    times = [made.values(p)["exposure.integration_s"] for p in order]
    assert times == sorted(times)  # so the light changes once


@pytest.mark.parametrize("kind", ["sobol", "latin_hypercube"])
def test_quasi_random_points_are_even_and_stand_alone(kind):
    """Against scipy's discrepancy of random points; one point does not need those before it."""
    axes = [{"field": f, "kind": "range", "start": 0, "stop": 1} for f in "abc"]
    wish = {"kind": kind, "points": 512, "seed": 4}
    made = design(axes, design=wish)
    points = np.array([list(made.values(p).values()) for p in range(512)])
    random = np.random.default_rng(0).uniform(size=(512, 3))
    assert qmc.discrepancy(points) < 0.1 * qmc.discrepancy(random)
    assert list(design(axes, design=wish).values(300).values()) == points[300].tolist()
    other = design(axes, design=wish | {"seed": 5})
    assert list(other.values(300).values()) != points[300].tolist()


def test_sobol_blocks_join_seamlessly():
    """Scrambled blocks drawn apart are the sequence drawn at once."""
    span = {"field": "a", "kind": "range", "start": 0, "stop": 1}
    axes = [span, {"field": "b", "values": [1, 2, 3]}]
    made = design(axes, design={"kind": "sobol", "points": 3 * BLOCK})
    whole = qmc.Sobol(2, scramble=True, rng=np.random.default_rng(0)).random(4 * BLOCK)
    for point in (*range(20), BLOCK - 1, BLOCK, 2 * BLOCK + 17):
        assert made.values(point)["a"] == whole[point, 0]
        assert made.values(point)["b"] == [1, 2, 3][int(whole[point, 1] * 3)]


def test_limits_ten_million_points_take_no_memory():
    made = design([
        {"field": "a", "kind": "range", "start": 0, "stop": 1, "count": 1000},
        {"field": "b", "kind": "range", "start": 0, "stop": 1, "count": 10_000},
    ])  # fmt: skip
    tracemalloc.start()
    first = list(itertools.islice(made.order(frozenset()), 5000))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert made.size == 10_000_000
    assert first == list(range(5000))
    assert peak < 5e6


def test_a_sweep_file_is_there_and_no_larger_than_a_scene_may_be(tmp_path):
    large = tmp_path / "large.yaml"
    large.write_bytes(b"#" * (MAX_BYTES + 1))
    with pytest.raises(BadInput, match=f"at most {MAX_BYTES} bytes"):
        load_sweep(large)
    with pytest.raises(BadInput, match="an existing sweep file"):
        load_sweep(tmp_path / "none.yaml")


def test_keys_of_a_sweep_and_of_its_scene_are_set(tmp_path):
    """`scene.` sets them in the scene's file, whose paths are from its own folder."""
    axes = [{"field": "a", "values": [1, 2]}]
    sweep = {"schema": "nightglass/sweep/1", "name": "d", "axes": axes}
    (tmp_path / "scenes").mkdir()
    for name, stars in (("first", "dr2"), ("other", "made")):
        scene = {"stars": {"catalogue": stars}, "sensor": {"shape": [8, 8]}}
        (tmp_path / "scenes" / f"{name}.yaml").write_text(json.dumps(scene))
    file = tmp_path / "sweep.yaml"
    asked = {"seed": 1, "stars": {"catalogue": "made"}}
    for base in ("scenes/first.yaml", asked):
        file.write_text(json.dumps(sweep | {"scene": base}))
        assert read_sweep(file) == sweep | {"scene": base}
        assert read_sweep(file, ["scene.seed=3"])["scene"]["seed"] == 3
    file.write_text(json.dumps(sweep | {"scene": "scenes/first.yaml"}))
    overrides = ["seeds=4", "scene.sensor.shape=[9, 8]", "axes.0.values=[5]", "scene.seed=7"]
    scene = {"stars": {"catalogue": "dr2"}, "sensor": {"shape": [9, 8]}, "seed": 7}
    told = sweep | {"seeds": 4, "axes": [axes[0] | {"values": [5]}], "scene": scene}
    assert read_sweep(file, overrides, placed=False) == told
    scene["stars"]["catalogue"] = str(tmp_path / "scenes" / "dr2")
    assert read_sweep(file, overrides) == told
    assert load_sweep(file, overrides) == parse_sweep(told)
    other = read_sweep(file, ["scene.seed=2", "scene=scenes/other.yaml"])["scene"]
    assert other["stars"]["catalogue"] == str(tmp_path / "scenes" / "made")
    for override in ("scene.a=3", "scene.a+=3", "scene.a.b=3"):
        with pytest.raises(BadInput, match="a field that no axis of the sweep changes") as refused:
            load_sweep(file, ["scene.ab=7", override])
        assert (refused.value.field, refused.value.value) == ("--set", override)
    for override, words in (("scene=no.yaml", "an existing scene file"), ("name.a=3", "a key")):
        with pytest.raises(BadInput, match=words):
            read_sweep(file, [override])


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        ("a.b", "a.b", "twice: a.b"),
        ("a", "a.b", "hold none of the others; a.b does"),
        ("a.b", "a", "hold none of the others; a does"),
        ("a.b", "a.bc", None),
        ("a.bc", "a.b", None),
        ("a.b", "b", None),
    ],
)
def test_no_axis_changes_what_another_one_changes(first, second, words):
    axes = [{"field": name, "values": [1, 2]} for name in (first, second)]
    if words is None:
        assert list(design(axes).values(3)) == [first, second]
        return
    with pytest.raises(BadInput, match=words) as told:
        design(axes)
    assert told.value.field == "axes.1"
