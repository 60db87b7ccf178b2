"""Tell Gaia DR2 from DR3 by a file's columns and the epoch and designation of its first rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pyarrow as pa

from ..errors import BadInput
from ..forms import Form, Layout, load_form
from ..forms.form import Names
from .kinds import kind_of
from .raw import raw_tables

EPOCHS = {2015.5: "gaia_dr2", 2016.0: "gaia_dr3"}
DESIGNATIONS = {"Gaia DR2": "gaia_dr2", "Gaia DR3": "gaia_dr3", "Gaia EDR3": "gaia_dr3"}


def detect_form(path: str | Path, field: str = "source", most_bytes: int | None = None) -> Form:
    """The form of a Gaia file: gaia_dr2 where nothing speaks for DR3.

    Raises BadInput where the file has not the columns of gaia_source, or where its columns, its
    `ref_epoch` and its `designation` speak for different releases.
    """
    return told_form(path, field, most_bytes)[0]


def told_form(
    path: str | Path, field: str = "source", most_bytes: int | None = None
) -> tuple[Form, bool]:
    """The form as `detect_form` has it, and whether anything in the file tells the release."""
    path = Path(path)
    where = f"{field} {path}"
    kind = kind_of(path, field)
    if kind == "sqlite":
        raise BadInput(where, "an SQLite file", "with a form that has `query` in its [table]")
    evidence: dict[str, str] = {}

    def choose(names: list[str], _declared: Mapping[str, str]) -> dict[str, str]:
        table = Names(names)
        for form, other in (("gaia_dr2", "gaia_dr3"), ("gaia_dr3", "gaia_dr2")):
            if (mark := table.first(load_form(other).foreign)) is not None:
                evidence[f"the column {mark}"] = form
        replace(load_form("gaia_dr2"), foreign=()).choose(names, where)  # what both need
        chosen = {"number": table.first(["ref_epoch"]), "text": table.first(["designation"])}
        wanted = {name: want for want, name in chosen.items() if name is not None}
        return wanted or {str(table.first(["ra"])): "number"}

    tables = raw_tables(path, kind, Layout(), choose, where, most_bytes=most_bytes)
    first = next(tables, pa.table({}))
    evidence.update(_from_rows(first, where))
    forms = set(evidence.values())
    if len(forms) > 1:
        said = ", ".join(f"{what} says {form}" for what, form in sorted(evidence.items()))
        raise BadInput(where, said, "a file of one release")
    return load_form(forms.pop() if forms else "gaia_dr2"), bool(evidence)


def _from_rows(table: pa.Table, where: str) -> dict[str, str]:
    """What the first epoch and designation say; an epoch or text of no known release is refused."""
    names = Names(table.column_names)
    evidence = {}
    if (name := names.first(["ref_epoch"])) is not None:
        for epoch in table[name].drop_null().unique().to_pylist():
            if epoch == epoch:
                form = EPOCHS.get(epoch)
                if form is None:
                    allowed = "2015.5 (Gaia DR2) or 2016.0 (Gaia DR3)"
                    raise BadInput(f"{where} {name}", epoch, allowed)
                evidence[f"the {name} {epoch}"] = form
    if (name := names.first(["designation"])) is not None and table.num_rows:
        text = str(table[name][0].as_py() or "")
        for start, form in DESIGNATIONS.items():
            if text.startswith(start + " "):
                evidence[f"the {name} {text!r}"] = form
    return evidence
