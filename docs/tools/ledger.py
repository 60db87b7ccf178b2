"""docs/measured.json, every rule of the plan measured: `python docs/tools/ledger.py`."""

from __future__ import annotations

import json
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]


def main() -> None:
    """Measure, and write the rows that the page of omissions shows."""
    from pipeline.studies.ledger.study import run_ledger

    study = run_ledger()
    (DOCS / "measured.json").write_text(json.dumps(study, indent=1, allow_nan=False) + "\n")
    print(f"{len(study['rules'])} rules, {study['cpu_s']:.0f} CPU s")
    for row in study["rules"]:
        if not row["holds"]:
            print(f"NOT WITHIN ITS BOUND: {row['component']}: {row['error']} of {row['bound']}")


if __name__ == "__main__":
    main()
