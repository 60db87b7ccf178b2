"""The command line's `catalog verify`."""

from __future__ import annotations

from dataclasses import asdict

from catalog_tools.catalogue import open_catalogue
from catalog_tools.errors import Damaged
from catalog_tools.verify.verify import verify as run
from pipeline.commands.catalog.shared import CataloguePlace
from pipeline.commands.options import Json, Workers, print_mapping
from pipeline.commands.pages import is_quiet, stage_progress


def verify(catalogue: CataloguePlace, workers: Workers = None, as_json: Json = False) -> None:
    """Verify a whole catalogue: every byte, every row's place, every count."""
    with stage_progress(is_quiet(as_json)) as progress:
        report = run(open_catalogue(catalogue), workers=workers, progress=progress)
    found = [f"{finding.path}: {finding.what}" for finding in report.findings]
    told = asdict(report) | {"whole": report.whole, "findings": found}
    if not report.notes and not as_json:
        del told["notes"]
    print_mapping(told, as_json)
    if found:
        raise Damaged(catalogue, f"{len(found)} problem(s): {'; '.join(found[:3])}")
