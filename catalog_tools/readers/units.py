"""Units that a file declares for its columns, against those in which a form reads them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from math import isclose

from astropy import units

from ..errors import BadInput
from ..forms import Form
from ..forms.form import UNITS, Names

FORMATS = ("generic", "vounit", "cds")  # mas/yr, 'electron'.s**-1, mas.yr-1 and more
LONGEST = 80
TOLERANCE = 1e-3  # kinds of years differ by less


def refuse_other_units(form: Form, table: Names, declared: Mapping[str, str], where: str) -> None:
    """Raise BadInput where a file declares another unit for a column than the form reads it in.

    declared : units by column; one that can't be understood, or is a number, says nothing. A
    motion may be declared as an angle, by the year, and a column with a `factor` as anything.
    """
    for source in (way for column in UNITS for way in form.ways(column, table)):
        name = table.first(source.names)
        text = declared.get(name or "", "").strip()
        unit = _parsed(text)
        if unit is None or source.factor != 1.0 or _is_read(unit, source.column, source.unit):
            continue
        fitting = [key for key in UNITS[source.column] if _is_read(unit, source.column, key)]
        fitting.sort(key="flux".__eq__)  # last, as it fits any
        remedy = f'unit = "{fitting[0]}"' if fitting else "its unit and factor"
        allowed = f"{source.unit}, as the form {form.name} reads it (else --form with a column map"
        allowed += f" that says {remedy})"
        raise BadInput(f"{where} unit of {name}", text, allowed)


@lru_cache(maxsize=256)
def _parsed(text: str) -> units.UnitBase | None:
    if not text or len(text) > LONGEST:
        return None
    for kind in FORMATS:
        try:
            unit = units.Unit(text, format=kind)
        except Exception:  # astropy's parsers have many ways to fail
            continue
        unit = getattr(unit, "function_unit", unit)  # mag(AB) is mag
        is_number = not unit.bases or unit == units.dimensionless_unscaled
        return None if is_number else unit
    return None


def _is_read(unit: units.UnitBase, column: str, key: str) -> bool:
    """Whether a declared unit is that of the key of UNITS[column]."""
    if key == "flux":  # of any unit
        return not unit.is_equivalent(units.mag)
    same = [unit]
    if column in ("pmra", "pmdec"):
        same.append(unit / units.yr)
    if key == "hourangle":
        same.append(unit * units.hourangle / units.hour)
    wanted = units.Unit(key)
    return any(
        u.is_equivalent(wanted) and isclose(u.to(wanted), 1.0, rel_tol=TOLERANCE) for u in same
    )
