"""What the plan says of the catalogues: what is made up, which magnitudes are missing."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from catalog_tools.ingest.build import About, build
from catalog_tools.query.starlight import CountedLight
from pipeline.inputs.band.colour_fit import default_colour_error_mag, gather_colour_fit
from pipeline.inputs.band.curves import resolve_response
from pipeline.inputs.sky.starlight import gather_starlight
from pipeline.inputs.stars.catalogues import (
    catalogue_facts,
    catalogue_remarks,
    colour_sentences,
    gather_left_out,
    mean_light,
    undrawn_remarks,
)
from pipeline.physics.colour import ColourFit
from pipeline.plan.coverage import FieldCoverage
from pipeline.spec.load import parse_scene
from tests.plan.test_plan import facts_of
from tests.spec.test_limits import BASE


@pytest.fixture(scope="module")
def empty(tmp_path_factory):
    """A catalogue without a row, to say other things of."""
    about = About("empty", "", False, 2015.5, {})
    folder = tmp_path_factory.mktemp("empty") / "made"
    return build([], folder, about, rows_per_leaf=1000).catalogue


def catalogue(empty, name: str, brightest: float | None, faintest: float | None, **more):
    return replace(empty, name=name, brightest_g_mag=brightest, faintest_g_mag=faintest, **more)


def test_bright_end_takes_the_layers_into_account(empty):
    gaia, bright = catalogue(empty, "gaia", 3.2, 21.0), catalogue(empty, "hip", -1.4, 6.6)
    (told,) = catalogue_remarks([gaia], 20.0)
    assert told.startswith("the catalogue begins at G = 3.2: brighter real stars are missing")
    assert catalogue_remarks([gaia, bright], 20.0) == ()
    faint = catalogue(empty, "hip", 3.0, 6.6)
    (told,) = catalogue_remarks([gaia, faint], None)
    assert told.startswith("the catalogues begin at G = 3.0: brighter")
    assert catalogue_remarks([empty], 20.0) == catalogue_remarks([], None) == ()


def test_gaps_and_faint_end(empty):
    deep, bright = catalogue(empty, "deep", 9.0, 18.0), catalogue(empty, "hip", -1.4, 6.6)
    (gap,) = catalogue_remarks([deep, bright], None)
    assert gap == "no catalogue holds stars of G = 6.6 to 9.0"
    assert catalogue_remarks([deep, bright], 6.5) == ()
    assert catalogue_remarks([deep, bright, catalogue(empty, "more", 6.0, 9.4)], 18.2) == ()
    (end,) = catalogue_remarks([bright], 15.0)
    assert end == "the catalogue ends at G = 6.6, the scene asks for 15.0"
    assert "the catalogues end at G = 18.0" in catalogue_remarks([bright, deep], 20.0)[-1]


def test_what_is_made_up(empty):
    real, made = catalogue(empty, "real", -1.4, 21.0), catalogue(empty, "made", -1.4, 21.0)
    made = replace(made, synthetic=True)
    assert catalogue_remarks([made], None) == (
        "SYNTHETIC CATALOGUE: no star of this product is a real star",
    )
    assert catalogue_remarks([made, made], None) == catalogue_remarks([made], None)
    (told,) = catalogue_remarks([real, made], None)
    assert told == "SYNTHETIC CATALOGUE made: no star of it is a real star"


def test_facts_and_nothing_left_out_of_the_main_catalogue(empty):
    assert gather_left_out((), (), None) == ()
    (none,) = gather_left_out((empty,), (), None)
    assert (none.size, none.dtype) == (0, np.int64)
    both = gather_left_out((empty, empty), (), 5.0)
    assert [ids.size for ids in both] == [0, 0]
    (told,) = catalogue_facts((empty,), (np.array([3, 4]),))
    assert told == {
        "name": "empty",
        "digest": empty.digest,
        "synthetic": False,
        "ref_epoch_jyear": 2015.5,
        "left_out": 2,
        "rows": 0,
        "without_colour": 0,
    }


def test_stars_without_a_colour_are_counted_with_what_it_may_cost(empty):
    """Few are a remark, most of a catalogue a warning; an older catalogue did not count them."""
    fit = gather_colour_fit(*resolve_response({"kind": "named", "name": "bessell-V"}, 1, 1))
    counts = {0: (0, 0), 80: (0, 1), 600: (1, 0), None: (0, 1)}
    for count, (warned, remarked) in counts.items():
        held = replace(empty, rows=1000, without_colour=count)
        warnings, remarks = colour_sentences([held], fit)
        assert (len(warnings), len(remarks)) == (warned, remarked), count
    (warning,), _ = colour_sentences([replace(empty, rows=1000, without_colour=600)], fit)
    assert warning.startswith("600 of 1000 (60%) stars of empty have no colour")
    assert "mag rms" in warning


@pytest.mark.parametrize(
    ("asked", "deepest", "limit", "told"),
    [(None, 20.0, 15.0, True), (15.5, 20.0, 15.0, False), (15.6, 20.0, 15.0, True),
     (18.0, 15.4, 15.0, False), (0.0, 20.0, 15.0, False), (None, None, 15.0, False),
     (None, 20.0, None, False)],
)  # fmt: skip
def test_a_shallow_part_is_told_where_fainter_stars_are_drawn(asked, deepest, limit, told):
    """More than half a magnitude, of what both the scene and the catalogue reach elsewhere."""
    found = FieldCoverage("c", "a map", 1.0, 1.0, 0, limit).remark(asked, deepest)
    assert (found is not None) == told


def test_a_part_that_is_not_covered_is_a_warning():
    for worst, mean, words in (
        (0.99, 0.99, None), (0.98, 0.995, "covers 98% of frame 4 and 99.5% of all frames"),
        (0.0, 0.5, "covers nothing of frame 4 and 50% of all"),
    ):  # fmt: skip
        warning = FieldCoverage("c", "a map", worst, mean, 4).warning()
        assert warning is None if words is None else words in warning
    assert FieldCoverage("c", None, 0.0, 0.0, 4).warning() is None


@pytest.mark.parametrize(
    ("end", "wish", "limit", "noise", "spans"),
    [(18.0, "auto", 12.0, False, None), (18.0, "all", 12.0, False, [(12, 18), (18, 21)]),
     (18.0, "all", 18.0, False, [(18, 21)]), (18.0, "all", None, False, [(18, 21)]),
     (18.0, "auto", None, True, [(12, 18)]), (22.0, "all", 12.0, False, [(12, 21)]),
     (22.0, "all", None, False, None), (None, "all", 12.0, False, [(3, 21)]),
     (2.0, "all", None, False, [(3, 21)])],
)  # fmt: skip
def test_magnitudes_that_the_sky_has_where_stars_are_not_drawn(
    empty, end, wish, limit, noise, spans
):
    """From the limit (or the catalogue's end) on, of the counts, which end at 21: each once."""
    background = {"starlight": wish, "uniform_e_per_s": 0.0}
    stars = {"catalogue": "c", "faintest_g_mag": limit}
    scene = parse_scene(BASE | {"background": background, "stars": stars})
    found = gather_starlight(scene, (catalogue(empty, "c", 3.0, end),), noise)
    assert (found is None) == (spans is None)
    if found is not None:
        at = np.array([[0.6, 0.0, 0.8], [0.0, -1.0, 0.0]])
        told = found.fainter(12.0, at).g
        each = [CountedLight(float(a), float(b)).fainter(-99.0, at).g for a, b in spans]
        assert told == pytest.approx(np.sum(each, axis=0), rel=1e-9)
    alone = parse_scene(BASE | {"background": background})
    assert (gather_starlight(alone, (), False) is None) == (wish == "auto")


def test_a_layer_leaves_out_what_any_earlier_catalogue_holds(monkeypatch):
    """Of three, the last one also the stars of the second; each once."""
    common = {("a", "b"): [7, 5], ("a", "c"): [2, 3], ("b", "c"): [9, 3]}

    def already_in(main, layer, cones, faintest_g_mag):
        return np.array(common[main, layer])

    monkeypatch.setattr("catalog_tools.query.layers.already_in", already_in)
    found = gather_left_out(["a", "b", "c"], (), None)
    assert [ids.tolist() for ids in found] == [[], [5, 7], [2, 3, 9]]


def test_a_layer_within_the_reach_of_another_ends_nothing(empty):
    """A list of G 3 to 8 over a catalogue to 20."""
    both = [catalogue(empty, "deep", 1.5, 20.0), catalogue(empty, "list", 3.0, 8.0)]
    for catalogues in (both, both[::-1]):
        assert catalogue_remarks(catalogues, 19.0) == ()
        assert catalogue_remarks(catalogues, 21.0) == (
            "the catalogues end at G = 20.0, the scene asks for 21.0",
        )


@pytest.mark.parametrize("slope", [0.1, -0.1])
def test_what_the_default_colour_may_cost_either_way(slope):
    """At most at the reddest star, whether it is brighter or fainter in the band."""
    fit = ColourFit("b", np.array([0.0, slope]), (-1.0, 5.0), 0, 0, 0, 1.44, 0.5, 0, 1e10, "s", 1)
    assert default_colour_error_mag(fit)[1] == pytest.approx(0.1 * (4.09 - 1.44))


def test_light_beyond_a_limit_is_that_of_the_counts_the_sky_over():
    """The mean of what `CountedLight` has in directions that are even over the sky."""
    k = np.arange(3000) + 0.5
    z, turn = 1.0 - 2.0 * k / k.size, np.pi * (1.0 + 5.0**0.5) * k
    level = np.sqrt(1.0 - z**2)
    sky = np.stack([level * np.cos(turn), level * np.sin(turn), z], axis=1)
    for limit in (6.0, 12.0, 18.0, 21.0, 25.0):
        counted = CountedLight().fainter(limit, sky).g.mean()
        assert mean_light(limit) == pytest.approx(counted, rel=0.1)


def test_undrawn_light_is_told_of_the_longest_exposure():
    """Of 0.1 and 400 s: two hundred times that of 0.1 and 2 s."""
    fit = ColourFit("b", np.zeros(1), (0.0, 1.0), 0.0, 0.0, 0.0, 0.5, 0.1, 0.0, 1e10, "made up", 1)
    told = []
    for longest_s in (2.0, 400.0):
        scene = parse_scene(BASE | {
            "stars": {"catalogue": "c", "faintest_g_mag": 12.0},
            "dwells": [{"integration_s": [0.1, longest_s], "frames": 2}]})  # fmt: skip
        [remark] = undrawn_remarks(scene, 12.0, [], facts_of(scene), fit)
        told.append(float(re.search(r"in the sky: (\S+) e- per pixel", remark)[1]))
    assert told[1] / told[0] == pytest.approx(200.0, rel=0.02)


@pytest.mark.parametrize(("stars", "sky", "limit", "end", "told"), [
    ({"faintest_g_mag": 12.0}, None, 12.0, 17.0, "12 (stars.faintest_g_mag)"),
    ({"faintest_g_mag": 18.0}, None, 18.0, 11.0, "11 (where the catalogues end)"),
    ({"faintest_g_mag": "auto"}, None, 22.9, 12.0, "12 (where the catalogues end)"),
    ({"faintest_g_mag": "auto"}, "auto", 11.0, 12.0, "12 (where the catalogues end)"),
    ({"faintest_g_mag": "auto"}, "none", 11.0, 12.0, "11 (stars.faintest_g_mag)"),
    ({"faintest_g_mag": "auto"}, "none", 22.9, 12.0, "12 (where the catalogues end)"),
    ({"faintest_g_mag": "auto"}, "all", 22.9, 12.0, None),
    ({"faintest_g_mag": "auto"}, None, 22.9, None, None),
    ({}, None, None, 12.0, None),
])  # fmt: skip
def test_stars_that_nothing_draws_are_told_from_where_they_begin(stars, sky, limit, end, told):
    """Beyond a given limit; of one that the noise set, beyond what the catalogues hold, as the sky
    has the rest unless it is asked to have none."""
    fit = ColourFit("b", np.zeros(1), (0.0, 1.0), 0.0, 0.0, 0.0, 0.5, 0.1, 0.0, 1e10, "made up", 1)
    b = {"background": {"starlight": sky}} if sky else {}
    scene = parse_scene(BASE | {"stars": {"catalogue": "c"} | stars,
                                "exposure": {"integration_s": 400.0}} | b)  # fmt: skip
    made = SimpleNamespace(faintest_g_mag=end)
    found = undrawn_remarks(scene, limit, [made], facts_of(scene), fit)
    assert [one.split(" are neither")[0] for one in found] == (
        [f"stars beyond G = {told}"] if told else []
    )
