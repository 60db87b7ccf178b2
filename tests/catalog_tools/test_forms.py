"""Forms: strict reading of column maps, units and conventions against independent formulas."""

from __future__ import annotations

import pickle
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from astropy import units

from catalog_tools.columns import NAMES, REQUIRED
from catalog_tools.errors import BadInput
from catalog_tools.forms import known_forms, load_form
from catalog_tools.forms.form import UNITS, Names
from catalog_tools.readers import read_tables
from catalog_tools.readers.meaning import apply

FORMS = Path(__file__).parent / "forms"

EXAMPLE = """
name = "survey"
description = "A survey."
credit = "Nobody"
ref_epoch_jyear = 2000.0
epoch_scale = "TDB"

[source_id]
from = "id"

[ra]
from = "alpha"
unit = "deg"

[dec]
from = "delta"
unit = "deg"

[phot_g_mean_mag]
from = "mag"
unit = "mag"
"""


def load(tmp_path, text):
    path = tmp_path / "survey.toml"
    path.write_text(text)
    return load_form(path)


def rows(tmp_path, form, csv):
    path = tmp_path / "stars.csv"
    path.write_text(csv)
    return pa.concat_tables(read_tables(path, form)).to_pylist()


def test_built_in_forms_are_whole():
    assert known_forms() == ("gaia_dr2", "gaia_dr3", "gsc", "hipparcos")
    epochs = {name: load_form(name).ref_epoch_jyear for name in known_forms()}
    assert epochs == {"gaia_dr2": 2015.5, "gaia_dr3": 2016.0, "gsc": 2015.5, "hipparcos": 1991.25}
    assert set(UNITS) | {"source_id"} == set(NAMES)
    for name in known_forms():
        form = load_form(name)
        assert form.name == name
        assert form.description.endswith(".")
        assert all(form.of(column) for column in REQUIRED if column != "source_id")
        assert pickle.loads(pickle.dumps(form)) == form
        assert hash(form) == hash(load_form(name))


def test_a_column_map_reads(tmp_path):
    form = load(tmp_path, EXAMPLE)
    star = rows(tmp_path, form, "mag,id,alpha,delta\n9,7,1.5,-2\n")[0]
    assert (star["source_id"], star["ra"], star["dec"]) == (7, 1.5, -2.0)
    assert star["phot_g_mean_mag"] == 9.0
    assert star["parallax"] is None
    assert load_form(str(tmp_path / "survey.toml")) == form


MOTION = '\n[pmra]\nfrom = "m"\nunit = "mas/yr"\n'


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("credit =", "credits =", "credit: None is not accepted; allowed: a text"),
        ('name = "survey"', 'name = "survey"\nnmae = 1', "nmae: 1 is not accepted; allowed: only"),
        ('unit = "mag"', 'unit = "mag"\nzero = 1', "phot_g_mean_mag.zero: 1"),
        ('unit = "mag"', 'unit = "Mag"', "phot_g_mean_mag.unit: 'Mag'"),
        ('from = "alpha"\nunit = "deg"', 'from = "alpha"', "ra.unit: None"),
        ('from = "alpha"', "from = []", "ra.from: [] is not accepted"),
        ('from = "alpha"', "from = 3", "ra.from: 3 is not accepted"),
        ('from = "alpha"', 'from = ["alpha", ""]', "ra.from: ['alpha', ''] is not accepted"),
        ("[ra]", "[[ra]]\nfrom = 1\n[x]", "ra.from"),
        ("[dec]", "[decl]", "dec: None is not accepted; allowed: a table [dec]"),
        ('[source_id]\nfrom = "id"', "", "source_id.from: None"),
        ('from = "id"', 'from = "id"\nrule = "guess"', "source_id.rule: 'guess'"),
        ('from = "id"', 'from = "id"\nfactor = 2', "source_id.factor: 2.0"),
        ("2000.0", "'2000'", "ref_epoch_jyear: '2000'"),
        ("2000.0", "51544.5", "ref_epoch_jyear: 51544.5"),
        ("2000.0", "nan", "ref_epoch_jyear: nan"),
        ('"TDB"', '"UTC"', "one of TCB, TDB, TT"),
        ('unit = "mag"', f'unit = "mag"{MOTION}', "pmra.is: None"),
        ('unit = "mag"', f'unit = "mag"{MOTION}is = "yes"', "mu_alpha_star, mu_alpha"),
        ('unit = "mag"', 'unit = "mag"\ncolour = "bv"', "phot_g_mean_mag.colour"),
        ('unit = "mag"', 'unit = "mag"\nclip = true', "phot_g_mean_mag.clip"),
        ('unit = "mag"', 'unit = "mag"\ncolour_range = [2, 1]', "the lower one first"),
        ('unit = "mag"', 'unit = "mag"\nnull = 99', "a list of finite numbers"),
        ('unit = "mag"', 'unit = "mag"\noptional = 1', "true or false"),
        ("[source_id]", '[table]\nlayout = "fixed"\n[source_id]', "table.columns"),
        (
            "[source_id]",
            '[table]\nlayout = "fixed"\ncolumns = {id = [5, 2]}\n[source_id]',
            "table.columns.id: [5, 2]",
        ),
        ("[source_id]", '[table]\ndelimiter = "||"\n[source_id]', "one character"),
        ("[source_id]", "[table]\nhdu = 0\n[source_id]", "from 1"),
        ("[source_id]", "[table]\nattach = 3\n[source_id]", "alias = file name"),
        ("[source_id]", '[epoch]\nfrom = "t"\nunit = "s"\n[source_id]', "jyear, mjd, jd"),
        ("[ra]", "[ra", "a TOML file"),
        ("[source_id]", '[epoch]\nfrom = "t"\nunits = "mjd"\n[source_id]', "epoch.units"),
        ("[source_id]", "[table]\nrow = 5\n[source_id]", "table.row"),
        ("[source_id]", "[source_id]\nfirst = 5", "source_id.first"),
        ("[ra]", "[ra]\nscales = 5", "ra.scales"),
        ('name = "survey"', 'name = "survey"\nepoch_jyear = 2000.0', "epoch_jyear"),
        ("2000.0", "1" + "0" * 400, "a finite number"),
    ],
)
def test_every_mistake_in_a_map_is_named(tmp_path, old, new, message):
    assert old in EXAMPLE
    with pytest.raises(BadInput) as caught:
        load(tmp_path, EXAMPLE.replace(old, new, 1))
    assert "survey.toml" in str(caught.value)
    assert message in str(caught.value)


def test_unknown_names_are_refused_with_the_known_ones(tmp_path):
    for name in ("gaia", "../forms/gaia_dr2", tmp_path):
        with pytest.raises(BadInput, match=r"gaia_dr2, gaia_dr3, gsc, hipparcos"):
            load_form(name)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(BadInput, match="TOML"):
        load_form(tmp_path / "binary.toml")
    for name, value in (("digits", "1" * 5000), ("deep", "[" * 2000 + "]" * 2000)):
        (tmp_path / f"{name}.toml").write_text(f"name = {value}\n")
        with pytest.raises(BadInput, match="TOML"):
            load_form(tmp_path / f"{name}.toml")
    (tmp_path / "long.toml").write_text("#" * (1 << 20) + "\n")
    with pytest.raises(BadInput, match="at most 1 MiB"):
        load_form(tmp_path / "long.toml")


ASTROPY = {
    "deg": units.deg, "ra": units.deg, "dec": units.deg, "pmra": units.mas / units.yr,
    "pmdec": units.mas / units.yr, "parallax": units.mas, "radial_velocity": units.km / units.s,
}  # fmt: skip


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="no file that opens but fails")
def test_a_map_on_a_disk_that_fails_is_refused():
    with pytest.raises(BadInput, match=r"a file that can be read \(Input/output error\)") as caught:
        load_form("/proc/self/mem")
    assert (caught.value.field, caught.value.value) == ("form", "/proc/self/mem")


def test_units_against_astropy():
    for column, factors in UNITS.items():
        for name, factor in factors.items():
            if name in ("flux", "mag"):
                continue
            canonical = ASTROPY.get(column, units.Jy)
            expected = units.Unit(name.replace("uas", "uarcsec")).to(canonical)
            assert factor == pytest.approx(expected, rel=1e-14), (column, name)


def test_fluxes_become_ab_magnitudes_and_back(tmp_path):
    for unit, jy in (("Jy", 1.0), ("mJy", 1e-3), ("uJy", 1e-6), ("nJy", 1e-9)):
        form = load(tmp_path, EXAMPLE.replace('"mag"\nunit = "mag"', f'"mag"\nunit = "{unit}"'))
        flux = 3631.0 / jy * 10.0 ** (-0.4 * 17.5)
        csv = f"mag,id,alpha,delta\n{flux!r},7,1,2\n0,8,1,2\n-1,9,1,2\n"
        stars = rows(tmp_path, form, csv)
        assert stars[0]["phot_g_mean_mag"] == pytest.approx(17.5, abs=2e-6)
        assert stars[1]["phot_g_mean_mag"] is stars[2]["phot_g_mean_mag"] is None
    # electrons per second with their own zero point
    text = EXAMPLE.replace('unit = "mag"', 'unit = "flux"\nadd = 25.68837')
    assert rows(tmp_path, load(tmp_path, text), "mag,id,alpha,delta\n947.848656,7,1,2\n")[0][
        "phot_g_mean_mag"
    ] == pytest.approx(18.24652, abs=1e-5)


def test_both_conventions_of_motion_in_right_ascension(tmp_path):
    csv = "mag,id,alpha,delta,m\n9,7,1,60,0.1\n9,8,1,-89.9999,0.1\n9,9,1,0,-999\n"
    motion = '\n[pmra]\nfrom = "m"\nunit = "arcsec/yr"\nnull = [-999]\nis = '
    with_cos = load(tmp_path, f'{EXAMPLE}{motion}"mu_alpha_star"')
    assert [star["pmra"] for star in rows(tmp_path, with_cos, csv)] == [100.0, 100.0, None]
    without = load(tmp_path, f'{EXAMPLE}{motion}"mu_alpha"')
    made = [star["pmra"] for star in rows(tmp_path, without, csv)]
    assert made[:2] == pytest.approx([50.0, 100.0 * np.cos(np.radians(89.9999))], rel=1e-6)
    assert made[2] is None


def test_a_fallback_serves_where_nothing_better_is_offered(tmp_path):
    """The first one, and only where its own columns are there too."""
    ways = """
[[phot_bp_mean_mag]]
from = "blue"
unit = "mag"
optional = true

[[phot_bp_mean_mag]]
from = "mag"
unit = "mag"
colour = "b_g"
coefficients = [0.0, 1.0]
fallback = true

[[phot_bp_mean_mag]]
from = "mag"
unit = "mag"
add = 0.5
fallback = true
"""
    form = load(tmp_path, EXAMPLE + ways)
    for more, value, expected in (("blue", 3, 3), ("b_g", 0.25, 9.25), ("other", 1, 9.5)):
        csv = f"mag,id,alpha,delta,{more}\n9,1,0,0,{value}\n"
        assert [s["phot_bp_mean_mag"] for s in rows(tmp_path, form, csv)] == [expected]
    csv = "mag,id,alpha,delta,blue,b_g\n9,1,0,0,3,0.25\n9,2,0,0,,0.25\n"
    found = [star["phot_bp_mean_mag"] for star in rows(tmp_path, form, csv)]
    assert found == [3, None]  # a better column is there: where it is empty nothing is made up


@pytest.mark.parametrize("kind", [pa.float16(), pa.float32(), pa.float64()])
def test_null_numbers_are_known_in_the_precision_of_the_column(tmp_path, kind):
    """As a float32 99.99 is 99.98999786: no double 99.99."""
    form = load(tmp_path, EXAMPLE.replace('unit = "mag"', 'unit = "mag"\nnull = [99.99, -1e300]'))
    near = np.nextafter(*np.array([99.99, 0.0], kind.to_pandas_dtype()))
    mags = pa.array(np.array([9.5, 99.99, near], kind.to_pandas_dtype()), kind)
    zeros = pa.array(np.zeros(3))
    columns = {"id": pa.array([1, 2, 3]), "alpha": zeros, "delta": zeros, "mag": mags}
    found = apply(form, pa.table(columns), "here", 0)["phot_g_mean_mag"].to_pylist()
    assert found == [9.5, None, pytest.approx(float(near), abs=1e-5)]


def test_null_numbers_of_a_column_of_whole_numbers(tmp_path):
    """And one with a fraction is none of them."""
    form = load(tmp_path, EXAMPLE.replace('unit = "mag"', 'unit = "mag"\nnull = [99.0, 9.5]'))
    columns = {"id": [1, 2, 3], "alpha": [0.0] * 3, "delta": [0.0] * 3, "mag": [9, 99, 10]}
    found = apply(form, pa.table(columns), "here", 0)["phot_g_mean_mag"].to_pylist()
    assert found == [9.0, None, 10.0]


def test_ways_are_tried_in_order_and_colours_have_ranges(tmp_path):
    ways = """
[[phot_bp_mean_mag]]
from = "mag"
unit = "mag"
colour = ["b", "v"]
coefficients = [0.5, 2.0, -1.0]
colour_range = [0.0, 1.0]

[[phot_bp_mean_mag]]
from = "mag"
unit = "mag"
colour = "b"
coefficients = [0.0, 1.0]
colour_range = [3.0, 5.0]
clip = true

[[phot_bp_mean_mag]]
from = "mag"
unit = "mag"
add = -0.25
"""
    csv = "mag,id,alpha,delta,b,v\n9,1,0,0,4,3.5\n9,2,0,0,4,1\n9,3,0,0,9,\n9,4,0,0,,2\n"
    csv += "9,5,0,0,3,2\n9,6,0,0,4,4\n"  # both ends of the range are in it
    stars = rows(tmp_path, load(tmp_path, EXAMPLE + ways), csv)
    assert [star["phot_bp_mean_mag"] for star in stars] == [
        9 + 0.5 + 1.0 - 0.25, 13.0, 14.0, 8.75, 9 + 0.5 + 2.0 - 1.0, 9.5
    ]  # fmt: skip


def test_null_numbers_are_absent_in_colours_too(tmp_path):
    """Such a star is one without that colour: the next way serves it, or it has no value."""
    way = 'from = "mag"\nunit = "mag"\nnull = [99.999]\n'
    term = 'colour = ["b", "v"]\ncoefficients = [0.0, 0.5]\n'
    ways = f"\n[[phot_bp_mean_mag]]\n{way}{term}\n[[phot_bp_mean_mag]]\n{way}"
    form = load(tmp_path, f"{EXAMPLE}{ways}\n[phot_rp_mean_mag]\n{way}{term}")
    csv = "mag,id,alpha,delta,b,v\n12,1,0,0,13,12\n12,2,0,0,99.999,12\n12,3,0,0,13,99.999\n"
    csv += "12,4,0,0,99.999,99.999\n12,5,0,0,,12\n99.999,6,0,0,13,12\n"
    found = rows(tmp_path, form, csv)
    assert [star["phot_bp_mean_mag"] for star in found] == [12.5, 12.0, 12.0, 12.0, 12.0, None]
    assert [star["phot_rp_mean_mag"] for star in found] == [12.5, *5 * [None]]


def test_missing_columns_are_named_unless_optional(tmp_path):
    text = f'{EXAMPLE}\n[parallax]\nfrom = ["plx", "par"]\nunit = "arcsec"\n'
    with pytest.raises(BadInput, match=r"'plx' or 'par' \(parallax of the form survey\)"):
        rows(tmp_path, load(tmp_path, text), "mag,id,alpha,delta\n9,7,1,2\n")
    form = load(tmp_path, f"{text}optional = true\n")
    assert rows(tmp_path, form, "mag,id,alpha,delta\n9,7,1,2\n")[0]["parallax"] is None
    assert rows(tmp_path, form, "mag,id,alpha,delta,par\n9,7,1,2,0.5\n")[0]["parallax"] == 500.0


def test_names_in_any_case_where_that_is_unique():
    assert Names(["RA", "Dec"]).first(["ra"]) == "RA"
    assert Names(["RA", "ra", "Ra"]).first(["ra"]) == "ra"
    assert Names(["RA", "Ra"]).first(["ra"]) is None


def test_ids_from_texts_are_stable_and_never_gaias(tmp_path):
    form = load(tmp_path, EXAMPLE.replace('from = "id"', 'from = "id"\nrule = "text"'))
    csv = "mag,id,alpha,delta\n9,HD 1,0,0\n9,HD 2,0,0\n9, HD 1 ,0,0\n9,,0,0\n"
    ids = [star["source_id"] for star in rows(tmp_path, form, csv)]
    assert ids[0] == ids[2] == -7913014919495737619
    assert ids[1] != ids[0]
    assert ids[3] is None
    assert all(-(2**63) <= number < -(2**62) for number in ids[:3])


def test_ids_from_positions_are_pixels_of_order_29(tmp_path):
    import healpy

    text = EXAMPLE.replace('from = "id"', 'rule = "position"')
    csv = "mag,alpha,delta\n9,12.5,-30\n9,12.5,-30\n9,12.500001,-30\n9,,5\n9,7,95\n"
    ids = [star["source_id"] for star in rows(tmp_path, load(tmp_path, text), csv)]
    assert ids[0] == ids[1] != ids[2]
    assert healpy.pix2ang(2**29, -1 - ids[0], nest=True, lonlat=True) == pytest.approx((12.5, -30))
    assert ids[3:] == [0, 0]  # rejected for their positions


@pytest.mark.parametrize(
    ("table", "content"),
    [
        ('layout = "whitespace"', "# c\nid alpha  delta\tmag\n 7  1.5   -2 9\n\n8 2.5 3\t99.9 \n"),
        (
            'layout = "whitespace"\ncolumns = ["id", "alpha", "delta", "mag"]',
            "7 1.5 -2 9\n8 2.5 3 99.9\n",
        ),
        (
            'layout = "whitespace"\ncolumns = ["id", "alpha", "delta", "mag"]',
            "# a table without a header line, below a comment\n\n7 1.5 -2 9\n8 2.5 3 99.9\n",
        ),
        ('delimiter = "|"', "id| alpha |delta|mag\n  7|1.5|-2|  9\n  8|2.5| 3|99.9\n"),
        (
            'delimiter = "\\t"\nnull = ["-"]',
            "id\talpha\tdelta\tmag\r\n7\t1.5\t-2\t9\r\n8\t2.5\t3\t-\r\n",
        ),
        (
            'layout = "fixed"\ncolumns = {mag = [10, 13], id = [1, 2], alpha = [3, 5], '
            "delta = [7, 8]}",
            " 71.5 -2 9   \r\n 82.5  3 99.9\r\n",
        ),
    ],
)
def test_text_layouts(tmp_path, table, content):
    text = EXAMPLE.replace("[source_id]", f"[table]\n{table}\n[source_id]")
    form = load(tmp_path, text.replace('unit = "mag"', 'unit = "mag"\nnull = [99.9]'))
    (tmp_path / "t.dat").write_text(content, newline="")
    stars = pa.concat_tables(read_tables(tmp_path / "t.dat", form)).to_pylist()
    found = [[s[n] for n in ("source_id", "ra", "dec", "phot_g_mean_mag")] for s in stars]
    assert found == [[7, 1.5, -2.0, 9.0], [8, 2.5, 3.0, None]]


def test_a_fixed_line_that_ends_within_a_column_is_refused(tmp_path):
    columns = "columns = {id = [1, 2], alpha = [3, 5], delta = [7, 8], mag = [10, 13]}"
    form = load(
        tmp_path,
        EXAMPLE.replace("[source_id]", f'[table]\nlayout = "fixed"\n{columns}\n[source_id]'),
    )
    for cut in ("9.1", "9.", "9"):  # the last after the column's first byte
        (tmp_path / "t.dat").write_text(f" 71.5 -2 9.12\n 71.5 -2 {cut}\n")
        with pytest.raises(BadInput, match=r"t\.dat row 2.*bytes 10 to 13"):
            list(read_tables(tmp_path / "t.dat", form))
    (tmp_path / "t.dat").write_text(" 71.5 -2 9.12\n 71.5 -2\n")  # blanks at the end cut off
    stars = pa.concat_tables(read_tables(tmp_path / "t.dat", form))
    assert stars["phot_g_mean_mag"].null_count == 1


@pytest.mark.parametrize(
    ("unit", "same", "later"),
    [("jyear", 2000.0, 2001.0), ("mjd", 51544.5, 51909.75), ("jd", 2451545.0, 2451910.25)],
)
def test_rows_of_another_epoch_are_refused(tmp_path, unit, same, later):
    """J2000.0 and a Julian year after it, in every unit of an epoch."""
    epoch = f'[epoch]\nfrom = "t"\nunit = "{unit}"\n[source_id]'
    form = load(tmp_path, EXAMPLE.replace("[source_id]", epoch))
    assert rows(tmp_path, form, f"id,alpha,delta,mag,t\n7,1.5,-2,9,{same}\n")[0]["ra"] == 1.5
    with pytest.raises(BadInput, match=r"t row 2: 2001"):
        rows(tmp_path, form, f"id,alpha,delta,mag,t\n7,1,-2,9,{same}\n8,1,-2,9,{later}\n")
    year = later - same
    for share, fine in ((0.0019, True), (-0.0019, True), (0.0021, False), (-0.0021, False)):
        csv = f"id,alpha,delta,mag,t\n7,1.5,-2,9,{same + share * year!r}\n"  # half a day more: no
        with nullcontext() if fine else pytest.raises(BadInput, match="t row 1"):
            rows(tmp_path, form, csv)


def test_gaias_column_of_epochs_counts_where_a_column_map_names_none(tmp_path):
    """Positions of J2015.5 read as J2000.0 would be off by 15.5 years of motion."""
    form = load(tmp_path, EXAMPLE)
    head = "id,alpha,delta,mag,ref_epoch\n"
    assert rows(tmp_path, form, f"{head}7,1.5,-2,9,2000.0\n")[0]["ra"] == 1.5
    with pytest.raises(BadInput, match=r"ref_epoch row 1: 2015\.5.*allowed: 2000"):
        rows(tmp_path, form, f"{head}7,1.5,-2,9,2015.5\n")


def test_a_bad_row_is_named_by_its_place_in_the_file(tmp_path):
    """Files are read in pieces: the rows of those before count."""
    epoch = '[epoch]\nfrom = "t"\nunit = "jyear"\n[source_id]'
    form = load(tmp_path, EXAMPLE.replace("[source_id]", epoch))
    good = {"id": [7.0, 8.0], "alpha": [1.0, 1.0], "delta": [2.0, 2.0], "mag": [9.0, 9.0],
            "t": [2000.0, 2000.0]}  # fmt: skip
    for change, name in (({"t": [2000.0, 1990.0]}, "t"), ({"id": [7.0, 8.5]}, "id")):
        with pytest.raises(BadInput, match=f"f {name} row 5002"):
            apply(form, pa.table(good | change), "f", 5000)


GSC_HEAD = "hstID,gsc2ID,GAIAdr2sourceID,ra,dec,epoch,rapm,decpm,parallax,radialVelocity,"
GSC_HEAD += "classification,gaiaGmag,gaiaRpmag,gaiaBpmag,VMag,mag,objID"


@pytest.mark.parametrize("first", ["Objects found : 2 , GSC242, ConeSearch\r\n", "# c\r\n", ""])
def test_guide_star_catalogue_as_its_service_gives_it(tmp_path, first):
    row = "S1HP,S01,4658,80.5,-69.5,2015.5,2.25,0.08,0.07,,0,16.25,15.5,17,,16,2013200000001"
    plate = "S1HQ,S02,,80.6,-69.4,1987.1,,,,,3,,,,18.5,18.5,2013200000002"
    (tmp_path / "gsc.csv").write_text(f"{first}{GSC_HEAD}\r\n{row}\r\n{plate}\r\n", newline="")
    stars = pa.concat_tables(read_tables(tmp_path / "gsc.csv", load_form("gsc"))).to_pylist()
    assert stars[0] == {
        "source_id": -2013200000001, "ra": 80.5, "dec": -69.5, "pmra": 2.25,
        "pmdec": pytest.approx(0.08), "parallax": pytest.approx(0.07), "radial_velocity": None,
        "phot_g_mean_mag": 16.25, "phot_bp_mean_mag": 17.0, "phot_rp_mean_mag": 15.5,
    }  # fmt: skip
    assert stars[1]["phot_g_mean_mag"] is None  # and so rejected, whatever its epoch
    later = row.replace("2015.5", "2016.0")
    (tmp_path / "gsc3.csv").write_text(f"{GSC_HEAD}\n{later}\n")
    with pytest.raises(BadInput, match=r"gsc3\.csv epoch row 1"):
        list(read_tables(tmp_path / "gsc3.csv", load_form("gsc")))


def test_hipparcos_colours_beyond_the_relations(tmp_path):
    def line(hip, vmag, bv, vi):
        text = [" "] * 450
        for first, value in ((9, f"{hip:6d}"), (42, vmag), (52, "010.50000000"),
                             (65, "-20.25000000"), (246, bv), (261, vi)):  # fmt: skip
            text[first - 1 : first - 1 + len(value)] = value
        return "".join(text)

    lines = [line(1, " 5.00", " 0.600", "0.70"), line(2, " 5.00", " 1.900", "4.50")]
    lines += [line(3, " 5.00", " 0.600", "    "), line(118322, " 5.00", "      ", "    ")]
    (tmp_path / "hip.dat").write_text("\n".join(lines))
    stars = pa.concat_tables(read_tables(tmp_path / "hip.dat", load_form("hipparcos"))).to_pylist()
    poly = np.polynomial.polynomial.polyval
    g_of_vi = (-0.01746, 0.008092, -0.2810, 0.03655)
    g_of_bv = (-0.02907, -0.02385, -0.2297, -0.001768)
    expected = [5 + poly(0.7, g_of_vi), 5 + poly(2.7, g_of_vi), 5 + poly(0.6, g_of_bv), 5.0]
    assert [star["phot_g_mean_mag"] for star in stars] == pytest.approx(expected, abs=1e-6)
    assert [star["phot_bp_mean_mag"] is None for star in stars] == [False, False, True, True]
    assert [star["source_id"] for star in stars] == [1, 2, 3, 118322]


def test_a_colour_is_held_at_both_ends_of_its_range(tmp_path):
    way = '\n[phot_bp_mean_mag]\nfrom = "mag"\nunit = "mag"\ncolour = "b"\n'
    way += "coefficients = [0.0, 1.0]\ncolour_range = [3.0, 5.0]\nclip = true\n"
    csv = "mag,id,alpha,delta,b\n9,1,0,0,1\n9,2,0,0,3\n9,3,0,0,4.5\n9,4,0,0,5\n9,5,0,0,8\n"
    stars = rows(tmp_path, load(tmp_path, EXAMPLE + way), csv)
    assert [star["phot_bp_mean_mag"] for star in stars] == [12.0, 12.0, 13.5, 14.0, 14.0]


@pytest.mark.parametrize("number", [2.0**53 + 2, -(2.0**53) - 2, 1.5, -1.5, np.inf, -np.inf])
def test_floating_ids_that_are_damaged_are_refused_with_their_row(tmp_path, number):
    """Exact to 2**53 of either sign; the form is for a table of doubles."""
    path = tmp_path / "stars.parquet"
    for last, refused in ((number, True), (2.0**53, False), (-(2.0**53), False)):
        table = pa.table({"id": [1.0, last], "mag": [9.0, 9.0], "alpha": [1.0, 1.0],
                          "delta": [2.0, 3.0]})  # fmt: skip
        pq.write_table(table, path)
        form = load(tmp_path, EXAMPLE)
        if refused:
            with pytest.raises(BadInput, match=r"id row 2: .*integers"):
                list(read_tables(path, form))
        else:
            found = pa.concat_tables(read_tables(path, form))["source_id"].to_pylist()
            assert found == [1, int(last)]


def test_a_value_is_there_where_nothing_speaks_against_it(tmp_path):
    """Neither a number that stands for none, nor any of the columns that must be positive."""
    way = '\n[phot_bp_mean_mag]\nfrom = "b"\nunit = "mag"\nnull = [99.0]\npositive = ["p", "q"]\n'
    csv = "mag,id,alpha,delta,b,p,q\n9,1,0,0,8,1,1\n9,2,0,0,99,1,1\n9,3,0,0,8,0,1\n"
    csv += "9,4,0,0,8,1,-1\n9,5,0,0,8,,1\n9,6,0,0,7,1,2\n"
    stars = rows(tmp_path, load(tmp_path, EXAMPLE + way), csv)
    assert [star["phot_bp_mean_mag"] for star in stars] == [8.0, None, None, None, None, 7.0]
