"""Hooks of the documentation site: its navigation, and the pages made from the product itself."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).parent))
from reference import command_page, scene_page

from pipeline.plan.ledger import page as omissions_page

MEASURED = Path(__file__).parents[1] / "measured.json"


def omissions() -> str:
    """The ledger with the rows that docs/tools/ledger.py measured."""
    return omissions_page(json.loads(MEASURED.read_text())["rules"])


GENERATED = {"reference/scene.md": scene_page, "reference/commands.md": command_page,
             "reference/omissions.md": omissions}  # fmt: skip
# Pages in order; those that are not there are left out, others come last, in `More`.
NAVIGATION: dict[str, list[str]] = {
    "Start": ["index.md", "tutorial.md"],
    "How to": [
        "howto/python.md", "howto/own-sensor.md", "howto/own-catalogue.md", "howto/exports.md",
        "howto/imports.md", "howto/sweep-on-a-cluster.md", "howto/submit-jobs.md",
    ],
    "Guides": [
        "catalogues.md", "pointing.md", "background.md", "detector.md", "distortion.md",
        "cosmic_rays.md", "targets.md", "satellite_brightness.md", "sweeps.md", "cluster.md",
        "service.md", "client.md",
    ],
    "Explanation": ["physics.md", "drawing.md", "accuracy.md", "report.md", "extremes.md",
                    "detection.md", "validation.md", "pins.md"],
    "Reference": ["reference/scene.md", "reference/commands.md", "reference/omissions.md",
                  "reference/python.md"],
}  # fmt: skip


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages, then make the navigation from what is there."""
    for name, make in GENERATED.items():
        files.append(File.generated(config, name, content=make()))
    there = [f.src_uri for f in files.documentation_pages()]
    listed = {name for names in NAVIGATION.values() for name in names}
    config.nav = [{title: [n for n in names if n in there]} for title, names in NAVIGATION.items()]
    others = sorted(set(there) - listed)
    if others:
        config.nav.append({"More": others})
    return files
