"""Hooks of the documentation site: its navigation, and the pages made from the product itself."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).parent))
from reference import command_page, scene_page, study_page, sweep_page

from pipeline.plan.ledger import page as omissions_page

MEASURED = Path(__file__).parents[1] / "measured.json"


def omissions() -> str:
    """The ledger with the rows that docs/tools/ledger.py measured."""
    return omissions_page(json.loads(MEASURED.read_text())["rules"])


GENERATED = {"reference/scene.md": scene_page, "reference/sweep.md": sweep_page,
             "reference/study.md": study_page, "reference/commands.md": command_page,
             "reference/omissions.md": omissions}  # fmt: skip
# Titles that are not the page's own heading (that of extremes.md is written by `selftest`).
TITLES = {"extremes.md": "Limiting cases"}
# Pages in order; those that are not there are omitted, others come last, in `More`.
NAVIGATION: dict[str, list[str]] = {
    "Start": ["index.md", "tutorial.md"],
    "How to": [
        "howto/python.md", "howto/own-sensor.md", "howto/space-sensor.md",
        "howto/stray-light.md", "howto/own-catalogue.md", "howto/targets.md", "howto/orbits.md",
        "howto/attitude.md", "howto/materials.md", "howto/what-is-seen.md", "howto/exports.md",
        "howto/imports.md", "howto/gap-time.md", "howto/sweep-on-a-cluster.md",
        "howto/submit-jobs.md",
    ],
    "Guides": [
        "catalogues.md", "pointing.md", "background.md", "detector.md", "distortion.md",
        "cosmic_rays.md", "targets.md", "satellite_brightness.md", "sweeps.md", "studies.md",
        "cluster.md",
        "service.md", "client.md",
    ],
    "Explanation": ["physics.md", "drawing.md", "accuracy.md", "report.md", "extremes.md",
                    "detection.md", "validation.md"],
    "Reference": ["reference/scene.md", "reference/sweep.md", "reference/study.md",
                  "reference/commands.md", "reference/omissions.md", "reference/python.md",
                  "glossary.md"],
    "Development": ["architecture.md", "contributing.md", "pins.md"],
}  # fmt: skip


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages, then make the navigation from what is there."""
    for name, make in GENERATED.items():
        files.append(File.generated(config, name, content=make()))
    there = [f.src_uri for f in files.documentation_pages()]
    listed = {name for names in NAVIGATION.values() for name in names}
    config.nav = [
        {section: [{TITLES[n]: n} if n in TITLES else n for n in names if n in there]}
        for section, names in NAVIGATION.items()
    ]
    others = sorted(set(there) - listed)
    if others:
        config.nav.append({"More": others})
    return files
