"""A field that the catalogue does not cover: refused, or told first with its size; never silent."""

from __future__ import annotations

import copy
import json
import math

import numpy as np
import pyarrow.parquet as pq
import pytest

from catalog_tools.catalogue import open_catalogue
from catalog_tools.coverage import Coverage, all_sky
from catalog_tools.ingest.build import About, build
from catalog_tools.ingest.ingest import ingest
from pipeline.errors import BadInput
from pipeline.route.prepare import plan_scene, prepare
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from tests.command import nightglass

IFOV_DEG = math.degrees(9e-6 / 0.5)
SCENE = {
    "schema": "nightglass/scene/1", "name": "covered", "epoch": "2019-10-20T05:42:30Z", "seed": 4,
    "observer": {"kind": "fixed", "position_au": [0.9, 0.4, 0.1], "velocity_m_s": [0, 2.9e4, 0]},
    "sensor": {
        "shape": [64, 64], "pixel_pitch_um": 9.0, "focal_length_m": 0.5, "aperture_m": 0.1,
        "bandpass": {"kind": "named", "name": "bessell-V"},
        "psf": {"kind": "gaussian", "sigma_px": 1.0}, "read_noise_e": 5.0, "bias_dn": 100,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 100.0, "boresight_dec_deg": 0.0},
    "exposure": {"integration_s": 1.0, "frames": 1},
    "accuracy": {"check_cells": 0},
}  # fmt: skip


def scene_of(catalogue, ra_deg: float, dec_deg: float = 0.0, **more):
    data = copy.deepcopy(SCENE) | more
    data["stars"] = {"catalogue": catalogue}
    data["pointing"] |= {"boresight_ra_deg": ra_deg, "boresight_dec_deg": dec_deg}
    return parse_scene(data)


@pytest.fixture(scope="module")
def cone(tmp_path_factory) -> str:
    """An empty catalogue that covers 1 deg about RA 100, Dec 0 to G = 14."""
    coverage = Coverage("a fetched cone", cones=np.array([[100.0, 0.0, 1.0, 14.0]]))
    about = About("cone", "", False, 2015.5, {}, coverage.to_json())
    path = tmp_path_factory.mktemp("cone") / "made"
    return build([], path, about, rows_per_leaf=1000).catalogue.path


def test_a_covered_field_has_no_warning(cone):
    plan = plan_scene(scene_of(cone, 100.5, 0.5))
    assert plan["warnings"] == []
    assert plan["coverage"] == {
        "catalogue": "cone", "source": "a fetched cone", "worst_frame_fraction": 1.0,
        "mean_fraction": 1.0, "worst_frame": 0, "complete_to_g_mag": 14.0,
    }  # fmt: skip


def test_the_fraction_is_that_of_the_frames_area(cone):
    """The cone's border, nearly straight across the frame, cuts a third of its columns off.

    Aberration moves the frame by up to 20 arcsec = 0.005 of its width: below the grid's 1/17.
    """
    third = (0.5 - 1.0 / 3.0) * 64 * IFOV_DEG
    plan = plan_scene(scene_of(cone, 101.0 - third, accept=[]))
    assert plan["coverage"]["worst_frame_fraction"] == pytest.approx(2.0 / 3.0, abs=0.06)
    (warning,) = plan["warnings"]
    assert "covers 6" in warning
    assert "no star" in warning


def test_a_field_outside_is_refused_unless_accepted(cone, tmp_path):
    with pytest.raises(BadInput) as caught:
        prepare(scene_of(cone, 103.0))
    assert caught.value.field == "stars.catalogue"
    assert "accept: [coverage]" in str(caught.value)
    assert "covers nothing of frame 0" in str(caught.value)
    product = tmp_path / "product"
    render(scene_of(cone, 103.0, accept=["coverage"]), product, Options("synchronous"))
    report = json.loads((product / "report.json").read_text())
    assert "covers nothing of frame 0" in report["warnings"][0]
    assert report["coverage"]["worst_frame_fraction"] == 0.0
    metadata = pq.read_schema(product / "truth" / "stars.parquet").metadata
    assert json.loads(metadata[b"nightglass:coverage"]) == report["coverage"]


@pytest.mark.parametrize(("frames", "worst"), [(5, 4), (41, 35)])
def test_of_several_frames_the_worst_is_named(cone, frames, worst):
    """A rate of 180 arcsec/s carries the field out of the cone: the last ones are not covered.

    By its own number, also where every fifth frame is looked at.
    """
    data = copy.deepcopy(SCENE)
    data["stars"] = {"catalogue": cone}
    data["pointing"] = {
        "mode": "rate", "boresight_ra_deg": 99.5, "boresight_dec_deg": 0.0,
        "rate_ra_arcsec_s": 180.0, "rate_dec_arcsec_s": 0.0,
    }  # fmt: skip
    cadence_s = 40.0 / (frames - 1)
    data["exposure"] = {"integration_s": 0.1, "frames": frames, "cadence_s": cadence_s}
    data["accept"] = ["coverage"]
    plan = plan_scene(parse_scene(data))
    assert plan["coverage"]["worst_frame"] == worst
    assert plan["coverage"]["worst_frame_fraction"] == 0.0
    assert 0.5 < plan["coverage"]["mean_fraction"] < 0.85


def test_a_layer_does_not_cover(cone, tmp_path):
    about = About("bright", "", False, 1991.25, {}, all_sky("all of it").to_json())
    build([], tmp_path / "bright", about, rows_per_leaf=1000)
    with pytest.raises(BadInput, match="covers nothing"):
        prepare(scene_of([cone, str(tmp_path / "bright")], 103.0))
    plan = plan_scene(scene_of([str(tmp_path / "bright"), cone], 103.0))
    assert plan["coverage"]["source"] == "all of it"


def test_too_few_rows_to_tell_is_a_remark(tmp_path):
    rows = [f"{i + 1},{100 + 0.001 * i},0.0,9.0" for i in range(20)]
    (tmp_path / "s.csv").write_text("\n".join(["source_id,ra,dec,phot_g_mean_mag", *rows]) + "\n")
    ingest([tmp_path / "s.csv"], tmp_path / "few", form="gaia_dr2")
    plan = plan_scene(scene_of(str(tmp_path / "few"), 250.0))
    assert not any("covers" in warning for warning in plan["warnings"])
    assert plan["coverage"]["worst_frame_fraction"] is None
    assert any("cannot be found" in remark for remark in plan["remarks"])


def test_a_shallower_part_of_the_field_is_remarked(tmp_path):
    coverage = all_sky("a made-up sky", 9.0, [(10.0, 0.0, 0.03, 15.0)])
    about = About("deep", "", False, 2015.5, {}, coverage.to_json())
    build([], tmp_path / "made", about, rows_per_leaf=1000)
    deep = open_catalogue(tmp_path / "made")
    from dataclasses import replace

    from pipeline.inputs.stars.coverage import coverage_sentences, gather_coverage
    from pipeline.plan.pointing.geometry import plan_geometry

    scene = scene_of(deep.path, 10.0)
    g = plan_geometry(scene, np.zeros(1, np.int64), 0.0)
    found = gather_coverage(scene, replace(deep, faintest_g_mag=15.0), g)
    _, (remark,) = coverage_sentences(scene, replace(deep, faintest_g_mag=15.0), found)
    assert "to G = 9 only" in remark


def test_a_real_cluster_and_a_field_beside_it(shared_data, tmp_path):
    """M67 (0.667 deg about RA 132.85, Dec 11.81): drawn there, refused two degrees off."""
    source = shared_data / "gaia_dr2" / "m67_field" / "M67_data.csv"
    ingest([source], tmp_path / "m67")
    inside = plan_scene(scene_of(str(tmp_path / "m67"), 132.85, 11.81))
    assert inside["coverage"]["worst_frame_fraction"] == 1.0
    scene = tmp_path / "scene.json"
    data = copy.deepcopy(SCENE) | {"stars": {"catalogue": str(tmp_path / "m67")}}
    data["pointing"] |= {"boresight_ra_deg": 134.85, "boresight_dec_deg": 11.81}
    scene.write_text(json.dumps(data))
    done = nightglass("plan", str(scene))
    assert done.returncode == 2
    assert "stars.catalogue" in done.stderr
    assert "accept: [coverage]" in done.stderr


def test_a_frame_just_past_the_last_row_is_told_to_hold_no_star(tmp_path):
    """Rows of an unnamed region, 16 x 16 a tenth of a degree apart: beyond the last of them nobody
    knows; between them a frame as empty is told of as well, for the same reason."""
    places = [(100 + 0.1 * i, 0.1 * j) for i in range(16) for j in range(16)]
    rows = [f"{n + 1},{ra:.6f},{dec:.6f},9.0" for n, (ra, dec) in enumerate(places)]
    (tmp_path / "s.csv").write_text("\n".join(["source_id,ra,dec,phot_g_mean_mag", *rows]) + "\n")
    ingest([tmp_path / "s.csv"], tmp_path / "grid", form="gaia_dr2")

    def told(ra_deg: float, dec_deg: float, **more) -> list[str]:
        plan = plan_scene(scene_of(str(tmp_path / "grid"), ra_deg, dec_deg, **more))
        assert plan["coverage"]["worst_frame_fraction"] == 1.0
        return [each for each in plan["warnings"] if "no star of" in each]

    for place in ((101.57, 0.7), (101.05, 0.75)):
        (warning,) = told(*place)
        assert "judged from the rows around alone" in warning
        assert told(*place, exposure={"integration_s": 0.0, "frames": 1}) == []
    assert told(101.0, 0.7) == []
