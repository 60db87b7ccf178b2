"""docs/report.md, its pictures and docs/report.json: `python docs/tools/scene_report.py`."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[1]
HEAD = """# Whole scenes: error against run time

`nightglass report scenes -o DIR` renders scenes of every kind at a ladder of accuracy targets, each
in a process of its own, and compares the noise-free mean with the reference path; then it switches
off one approximation at a time. It writes `report.json`, `report.html` (one page that needs nothing
beside it), `report.md` and two figures. `--quick` takes smaller frames and fewer levels, `--scene`
and `--levels` choose, `--catalog` takes another catalogue than the synthetic one it makes.

This page is one run, made by `python docs/tools/scene_report.py`; all its figures are in
`docs/report.json`. What components that are omitted are worth, each rule of the plan has measured
in the ledger (the page *What the plan may omit* of the built documentation). {remark}

![error of a pixel over its noise against CPU seconds of a render](pictures/report.png)

![bound and error of each approximation, scene by scene](pictures/omissions.png)

"""
GUARDS = """
## Guards

Every frame that is drawn is looked at while it is drawn: light and places of stars are finite, a
star's pixel is where its direction is seen to 0.001 px (some stars of each task), the light of a
tile is no more than its sources send and no less than those inside it do, and the mean is finite
and not negative by more than rounding. A fault names frame and tile, and the star or the layer; no
frame comes of it. All of it takes {share:.1%} of the CPU time of a frame of {side} x {side} pixels
with {stars:,} stars, written to disk (`python -m benchmarks.guards`; `benchmarks/guards.json`).
"""


def main() -> None:
    """Run the report (or take finished ones), and write page, picture and rows."""
    from pipeline.studies.scenes.figure import ladder_figure, omission_figure
    from pipeline.studies.scenes.report import report_scenes, text
    from pipeline.studies.scenes.scenes import MAKERS

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--docs", type=Path, default=DOCS)
    parser.add_argument("--quick", action="store_true", help="every scene, but small")
    parser.add_argument("--remark", default="", help="what a reader should know of the run")
    parser.add_argument("reports", type=Path, nargs="*", help="report.json files; default: run it")
    args = parser.parse_args()
    if args.reports:
        study = joined([json.loads(path.read_text()) for path in args.reports])
    else:
        with tempfile.TemporaryDirectory() as folder:
            study = report_scenes(Path(folder) / "out", tuple(MAKERS), quick=args.quick)
    guards = json.loads((DOCS.parent / "benchmarks" / "guards.json").read_text())
    tail = GUARDS.format(share=guards["share"], side=guards["side_px"], stars=guards["stars"])
    page = HEAD.format(remark=args.remark) + text(study) + tail
    (args.docs / "report.md").write_text(page.rstrip() + "\n", encoding="utf-8")
    (args.docs / "pictures").mkdir(parents=True, exist_ok=True)
    (args.docs / "pictures" / "report.png").write_bytes(ladder_figure(study))
    (args.docs / "pictures" / "omissions.png").write_bytes(omission_figure(study))
    (args.docs / "report.json").write_text(json.dumps(study, indent=1) + "\n")


def joined(studies: list[dict[str, Any]]) -> dict[str, Any]:
    """Reports of several scenes as one."""
    return studies[0] | {"scenes": [scene for study in studies for scene in study["scenes"]]}


if __name__ == "__main__":
    main()
