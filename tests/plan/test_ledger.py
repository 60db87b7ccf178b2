"""The ledger of omissions: each decision of a plan has a rule, and each rule a test that exists."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from catalog_tools.ingest import ingest
from pipeline.plan.ledger import LEDGER, page, rule_of
from pipeline.run import plan_scene
from pipeline.spec.load import load_scene, parse_scene

ROOT = Path(__file__).resolve().parents[2]
SCENES = [*sorted((ROOT / "examples").glob("*.yaml")), ROOT / "pipeline" / "scenes" / "demo.yaml"]


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory) -> str:
    folder = tmp_path_factory.mktemp("ledger")
    (folder / "stars.csv").write_text("source_id,ra,dec,phot_g_mean_mag\n1,10.0,20.0,12.0\n")
    ingest([folder / "stars.csv"], folder / "catalogue", form="gaia_dr2", workers=1)
    return str(folder / "catalogue")


@pytest.mark.parametrize("path", SCENES, ids=[p.stem for p in SCENES])
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


def test_page_and_unknown_names():
    assert page().count("\n| `") == len(LEDGER)
    assert rule_of("no such thing") is None
