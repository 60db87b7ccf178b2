"""Units that files declare: another than the form's is refused, the same in any spelling read."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.io import fits
from test_forms import EXAMPLE, load
from test_readers import read

from catalog_tools.errors import BadInput
from catalog_tools.readers import detect_form, ecsv

NAMES = ("source_id", "ra", "dec", "pmra", "pmdec", "parallax", "phot_g_mean_mag", "other")
VALUES = (7, 10.0, 20.0, 1.0, 2.0, 3.0, 12.0, 1.0)
KINDS = ("ecsv", "fits", "vot")


def as_ecsv(path, units):
    """With the columns in blocks, as the archive of Gaia DR3 writes them."""
    lines = ["# %ECSV 1.0", "# ---", "# delimiter: ','", "# datatype:"]
    for name in NAMES:
        lines += ["# -", f"#   name: {name}", "#   datatype: float64"]
        if name in units:
            quoted = units[name].replace("'", "''")
            lines += [f"#   unit: '{quoted}'", "#   description: of a star, it's said"]
    lines += ["# meta: !!omap", "# - {x: !astropy.units.Unit {unit: deg}}"]
    path.write_text("\n".join([*lines, ",".join(NAMES), ",".join(map(str, VALUES))]) + "\n")


def as_fits(path, units):
    columns = [
        fits.Column(name, "K" if name == "source_id" else "D", units.get(name), array=[value])
        for name, value in zip(NAMES, VALUES, strict=True)
    ]
    fits.BinTableHDU.from_columns(columns).writeto(path)


def as_vot(path, units):
    head = '<?xml version="1.0"?>\n<VOTABLE version="1.3"><RESOURCE><TABLE>'
    for i, name in enumerate(NAMES):
        kind = "long" if name == "source_id" else "double"
        unit = f' unit="{units[name]}"' if name in units else ""
        head += f'<FIELD ID="col{i}" name="{name}" datatype="{kind}"{unit}/>'
    row = "".join(f"<TD>{value}</TD>" for value in VALUES)
    end = "</TABLEDATA></DATA></TABLE></RESOURCE></VOTABLE>"
    path.write_text(f"{head}<DATA><TABLEDATA><TR>{row}</TR>{end}")


def star(tmp_path, kind, units, form=None):
    path = tmp_path / f"a.{kind}"
    {"ecsv": as_ecsv, "fits": as_fits, "vot": as_vot}[kind](path, units)
    return read(path, form or detect_form(path)).to_pylist()[0]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("column", "unit", "expected", "remedy"),
    [
        ("pmra", "arcsec/yr", "mas/yr", 'unit = "arcsec/yr"'),
        ("pmdec", "deg.yr**-1", "mas/yr", 'unit = "deg/yr"'),
        ("pmra", "s/yr", "mas/yr", "its unit and factor"),
        ("pmra", "arcsec", "mas/yr", 'unit = "arcsec/yr"'),
        ("parallax", "arcsec", "mas", 'unit = "arcsec"'),
        ("ra", "h", "deg", 'unit = "hourangle"'),
        ("dec", "rad", "deg", 'unit = "rad"'),
        ("phot_g_mean_mag", "mJy", "mag", 'unit = "mJy"'),
        ("phot_g_mean_mag", "mmag", "mag", "its unit and factor"),
    ],
)
def test_another_unit_is_refused_by_name(tmp_path, kind, column, unit, expected, remedy):
    with pytest.raises(BadInput) as caught:
        star(tmp_path, kind, {"dec": "deg", column: unit})
    told = str(caught.value)
    assert f"a.{kind} unit of {column}: " in told
    assert f"allowed: {expected}, as the form gaia_dr2 reads it (else --form with a column" in told
    assert told.endswith(f"that says {remedy})")
    assert "\n" not in told


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "units",
    [
        {"ra": "deg", "dec": "degree", "pmra": "mas/yr", "pmdec": "mas.yr**-1", "parallax": "mas"},
        {"pmra": "mas yr-1", "pmdec": "mas.yr-1", "phot_g_mean_mag": "mag", "parallax": "marcsec"},
        {"pmra": "mas / a", "pmdec": "mas*yr^-1", "phot_g_mean_mag": "mag(AB)"},
        {"pmra": "mas", "pmdec": "mas", "other": "'electron'.s**-1"},
        {"ra": "Angle[deg]", "dec": "---", "pmra": "of a kind", "pmdec": "1" * 90, "parallax": "1"},
        {"other": "arcsec/yr", "source_id": "km"},
    ],
)
def test_the_same_unit_in_another_spelling_is_read(tmp_path, kind, units):
    found = star(tmp_path, kind, units)
    assert (found["ra"], found["pmra"], found["pmdec"], found["parallax"]) == (10, 1, 2, 3)


MAP = EXAMPLE.replace("alpha", "ra").replace("delta", "dec").replace('"id"', '"source_id"')
MAP = MAP.replace('from = "mag"\nunit = "mag"', 'from = "phot_g_mean_mag"\nunit = "mag"')


@pytest.mark.parametrize(
    ("old", "new", "units", "is_read"),
    [
        ("", "", {"ra": "deg", "phot_g_mean_mag": "mag"}, True),
        ('"ra"\nunit = "deg"', '"ra"\nunit = "hourangle"', {"ra": "h"}, True),
        ('"ra"\nunit = "deg"', '"ra"\nunit = "hourangle"', {"ra": "hourangle"}, True),
        ('"ra"\nunit = "deg"', '"ra"\nunit = "hourangle"', {"ra": "deg"}, False),
        ('"ra"\nunit = "deg"', '"ra"\nunit = "deg"\nfactor = 57.29578', {"ra": "rad"}, True),
        ('unit = "mag"', 'unit = "nJy"', {"phot_g_mean_mag": "10**-9 Jy"}, True),
        ('unit = "mag"', 'unit = "nJy"', {"phot_g_mean_mag": "uJy"}, False),
        ('unit = "mag"', 'unit = "flux"', {"phot_g_mean_mag": "'electron'.s**-1"}, True),
        ('unit = "mag"', 'unit = "flux"', {"phot_g_mean_mag": "mag"}, False),
    ],
)
def test_a_column_map_says_the_unit(tmp_path, old, new, units, is_read):
    assert old in MAP
    form = load(tmp_path, MAP.replace(old, new, 1))
    if is_read:
        assert np.isfinite(star(tmp_path, "fits", units, form)["phot_g_mean_mag"])
    else:
        with pytest.raises(BadInput, match=r"unit of .* as the form survey reads it"):
            star(tmp_path, "fits", units, form)


@pytest.mark.parametrize(
    "lines",
    [
        ["# - {name: pmra, unit: arcsec"],
        ["# - [pmra, arcsec/yr]"],
        ["# - {name: pmra, unit: !other arcsec/yr}"],
        ["# {" + "[" * 5000],
        ["# - {name: pmra, unit: arcsec}", "#" * (1 << 20)],
        [],
    ],
)
def test_a_head_that_cannot_be_read_declares_nothing(lines):
    comments = [line.encode() for line in ("# %ECSV 1.0", "# datatype:", *lines)]
    assert ecsv.units_of(comments) == {}
    assert ecsv.units_of([b"# - {name: pmra, unit: arcsec}"]) == {}
    good = [b"# %ECSV 1.0", b"# datatype:", b"# - {name: pmra, unit: arcsec}", b"# meta: 1"]
    assert ecsv.units_of(good) == {"pmra": "arcsec"}
