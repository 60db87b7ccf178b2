"""`nightglass plan`: the answer first, in few lines that fit, with the numbers of the product."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from catalog_tools.synthetic.synthetic import make_demo
from pipeline import demo
from pipeline.commands import pages
from pipeline.commands.pages import print_plan
from pipeline.demo import DEEP_FIELD
from pipeline.spec.load import load_scene
from tests.command import nightglass

SCENE = Path(demo.__file__).parent / "scenes" / "demo.yaml"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo's scene, of a quarter of the frame: a rate track with four targets."""
    folder = tmp_path_factory.mktemp("plan")
    data = load_scene(SCENE).as_dict()
    make_demo(folder / "sky", faintest_g_mag=8.0, deep_fields=[DEEP_FIELD])
    data["sensor"]["shape"] = [1024, 1024]
    data["sensor"]["detector"] = {}
    data["exposure"]["frames"] = 2
    data["stars"] |= {"catalogue": "sky"}
    data["accept"] = ["error"]
    (folder / "scene.yaml").write_text(json.dumps(data))
    return folder / "scene.yaml"


def lines_of(capsys: pytest.CaptureFixture[str], plan: dict[str, Any], **how: bool) -> list[str]:
    print_plan(plan, **how)
    return capsys.readouterr().out.splitlines()


def test_the_answer_is_that_of_the_product(scene: Path, tmp_path: Path) -> None:
    """Targets, magnitudes and SNR are those of the truth; stars to a third."""
    told = json.loads(nightglass("plan", scene, "--json").stdout)
    here = "--scheduler", "synchronous"
    assert nightglass("render", scene, "-o", tmp_path / "run", *here).returncode == 0
    truth = pd.read_parquet(tmp_path / "run" / "truth" / "targets.parquet")
    seen = truth[truth.in_frame & (truth.snr > 0)]
    best = seen.loc[seen.groupby("name").snr.idxmax()].set_index("name")
    out = told["outlook"]
    assert out["in_view"] == len(best)
    for target in out["targets"]:
        row = best.loc[target["name"]]
        assert target["snr"] == pytest.approx(row.snr, rel=1e-9)
        assert target["v_mag"] == pytest.approx(row.v_mag, rel=1e-9)
    stars = pd.read_parquet(tmp_path / "run" / "truth" / "stars.parquet")
    most = stars.groupby("frame").size().max()
    assert told["stars_per_frame"] == pytest.approx(most, rel=0.35)
    faint = stars[(stars.g_mag - out["limiting_g_mag"]).abs() < 0.3]
    if len(faint) > 20:
        assert faint.snr.median() == pytest.approx(5.0, rel=0.3)


@pytest.mark.parametrize("columns", [80, 100])
def test_the_answer_has_fifteen_lines_that_fit(
    scene: Path, columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With many targets and long warnings too; `--all` has all of them, and the decisions."""
    monkeypatch.setenv("COLUMNS", str(columns))
    told = json.loads(nightglass("plan", scene, "--json").stdout)
    one = {"name": "n" * 60, "frame": 7, "v_mag": 12.3456, "snr": 1234.5, "frames": 2}
    told["outlook"] |= {"targets": [one] * 40, "in_view": 40, "limiting_g_mag": 17.25}
    told["warnings"] = ["the Sun is in the field, and so on; " * 9] * 5
    short = lines_of(capsys, told)
    assert len(short) <= 15
    assert all(len(line) <= columns for line in short)
    text = "\n".join(short)
    for word in ("frames", "field", "40 of", "V 12.3", "SNR 1.23e+03", "G 17.2", "stars",
                 "s of one core", "MB", "WARNING", "3 more"):  # fmt: skip
        assert word in text, word
    whole = lines_of(capsys, told, everything=True)
    assert all(len(line) <= columns for line in whole)
    assert sum("WARNING" in line for line in whole) == 5
    for decision in told["decisions"]:
        assert any(line.startswith(decision["component"]) for line in whole)
    explained = lines_of(capsys, told, explain=True)
    assert len(explained) > len(whole)
    told["warnings"] = ["one", "another"]  # all are shown: there are no more to look for
    assert not any("more (--all)" in line for line in lines_of(capsys, told))


def test_the_worst_frames_coverage_is_told_before_that_of_all() -> None:
    worst = {"worst_frame": 3, "worst_frame_fraction": 0.25}
    said = {"source": "rows", **worst, "mean_fraction": 0.875}
    assert pages._coverage(said) == "25% of frame 3, 87.5% of all (by rows)"
    unknown = pages._coverage({"source": None})
    assert unknown == "cannot be found from the catalogue's few rows"
