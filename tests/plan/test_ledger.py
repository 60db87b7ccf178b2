"""The ledger of omissions: each decision of a plan has a rule, and each rule a test that exists."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import numpy as np
import pytest

from catalog_tools.ingest.ingest import ingest
from pipeline.plan.ledger import LEDGER, page, rule_of
from pipeline.route.prepare import plan_scene
from pipeline.spec.load import load_scene, parse_scene

ROOT = Path(__file__).resolve().parents[2]
DEAR = "step-and-settle"  # to plan
SCENES = [*sorted((ROOT / "examples").glob("*.yaml")), ROOT / "pipeline" / "scenes" / "demo.yaml"]


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory) -> str:
    folder = tmp_path_factory.mktemp("ledger")
    (folder / "stars.csv").write_text("source_id,ra,dec,phot_g_mean_mag\n1,10.0,20.0,12.0\n")
    ingest([folder / "stars.csv"], folder / "catalogue", form="gaia_dr2", workers=1)
    return str(folder / "catalogue")


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, id=p.stem, marks=[pytest.mark.slow] * (p.stem == DEAR)) for p in SCENES],
)
def test_every_decision_has_a_rule(path, catalogue):
    data = load_scene(path).as_dict()
    if data.get("stars"):
        data["stars"]["catalogue"] = catalogue
    decisions = plan_scene(parse_scene(data))["decisions"]
    assert not [d["component"] for d in decisions if "rule" not in d]


@pytest.mark.parametrize("rule", LEDGER, ids=[r.components[0] for r in LEDGER])
def test_the_test_of_a_rule_exists(rule):
    name, _, function = rule.test.partition("::")
    source = ast.parse((ROOT / name).read_text())
    names = {node.name for node in ast.walk(source) if isinstance(node, ast.FunctionDef)}
    assert function in names if function else any(n.startswith("test_") for n in names)


def test_every_rule_has_a_measured_row_within_its_bound():
    """docs/measured.json: one run of `nightglass report ledger`, rule by rule."""
    rows = json.loads((ROOT / "docs" / "measured.json").read_text())["rules"]
    assert [row["rule"] for row in rows] == [rule.components[0] for rule in LEDGER]
    for row in rows:
        assert rule_of(row["component"]).components[0] == row["rule"]
        for one in row["all"]:
            assert one["holds"], one
            assert 0.0 <= one["error"] <= one["bound"], one
            assert np.isfinite(one["seconds_saved"])
            assert one["unit"]
            assert one["how"]


def test_page_and_unknown_names():
    assert page().count("\n| `") == len(LEDGER)
    told = page([{"rule": "stars", "component": "stars", "how": "s", "bound": 1.0, "error": 0.5,
                  "unit": "sigma", "seconds_saved": 2.0}])  # fmt: skip
    assert "| 1 sigma (`stars`) | 0.5 sigma | 2 |" in told
    assert "| `stars` | s | 1 sigma | 0.5 sigma | 2 |" in told
    assert rule_of("no such thing") is None


def test_rows_of_the_page_have_as_many_cells_as_their_head():
    """Of rules that were measured and of those that were not."""
    rows = json.loads((ROOT / "docs" / "measured.json").read_text())["rules"]
    for measured in ([], rows[:3]):
        tables = page(measured).split("| --- |\n")[1:]
        assert len(tables) == 1 + bool(measured)
        for table, cells in zip(tables, (6, 5), strict=False):
            lines = table.split("\n\n")[0].splitlines()
            assert {len(re.findall(r"(?<!\\)\|", line)) for line in lines} == {cells + 1}
