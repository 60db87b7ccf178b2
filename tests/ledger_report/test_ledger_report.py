"""The ledger's study: each rule has a probe, two are measured anew; mistakes are one message."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.errors import BadInput
from pipeline.ledger_report.probe import PROBES, Found
from pipeline.ledger_report.report import report_ledger
from pipeline.ledger_report.study import checked_rules, run_ledger
from pipeline.plan.ledger import LEDGER

AGAIN = ("adc", "targets.perturbations")


def test_every_rule_has_a_probe():
    assert set(PROBES) == {rule.components[0] for rule in LEDGER}


def test_two_rules_measured_anew(tmp_path):
    pytest.importorskip("trimesh")
    done = CliRunner().invoke(
        app, ["report", "ledger", "-o", str(tmp_path / "out"), "--json",
              *(word for name in AGAIN for word in ("--rule", name))],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "out" / "ledger.json").read_text())
    assert [row["rule"] for row in found["rules"]] == ["adc", "targets.forces"]
    for row in found["rules"]:
        assert row["holds"]
        assert 0.0 < row["error"] <= row["bound"]
        assert len(row["all"]) > 1
    assert "| targets.perturbations |" in (tmp_path / "out" / "ledger.md").read_text()


def test_a_broken_bound_is_told():
    assert Found("x", "", 1.0, 0.9, "px", 0.0, 0.0).holds
    assert not Found("x", "", 1.0, 1.1, "px", 0.0, 0.0).holds
    assert not Found("x", "", 1.0, float("nan"), "px", 0.0, 0.0).holds


@pytest.mark.slow
def test_all_rules_hold():
    """Minutes: every rule of the ledger measured anew."""
    rows = run_ledger()["rules"]
    assert not [row for row in rows if not row["holds"]]


def test_mistakes(tmp_path):
    with pytest.raises(BadInput, match="no such rule"):
        checked_rules(("no such rule",))
    (tmp_path / "old.txt").write_text("kept")
    with pytest.raises(BadInput, match="new or empty"):
        report_ledger(tmp_path)
