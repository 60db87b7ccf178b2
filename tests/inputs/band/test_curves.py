"""Curves that are read: bad tables, named filters, the Sun, the stellar library."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from astropy.io import fits

from catalog_tools.errors import BadInput, Damaged
from pipeline.inputs.band import curves
from pipeline.inputs.reference import boxes
from pipeline.physics.radiometry import (
    ResponseCurve,
    ab_photon_rate,
    box,
    energy_integral,
    photon_integral,
)

BOX = {"kind": "box", "short_nm": 400, "long_nm": 900}


@pytest.fixture
def real(shared_data, monkeypatch):
    monkeypatch.setenv("NIGHTGLASS_DATA", str(shared_data))
    return shared_data


@pytest.fixture
def embedded(monkeypatch):
    monkeypatch.delenv("NIGHTGLASS_DATA", raising=False)


def table(tmp_path, text: str) -> str:
    path = tmp_path / "curve.csv"
    path.write_text(text)
    return str(path)


def test_same_numbers_and_tables_of_one_number(tmp_path):
    flat = table(tmp_path, "wavelength_nm,value\n300,0.9\n1000,0.9\n")
    first, name, digest = curves.resolve_response(BOX, 0.8, 0.9)
    second, _, other = curves.resolve_response(BOX, 0.8, flat)
    assert name == "box 400-900 nm"
    assert ab_photon_rate(0, first) == pytest.approx(ab_photon_rate(0, second), rel=1e-12)
    assert len(digest) == 64
    assert digest == curves.resolve_response(BOX, 0.8, 0.9)[2]
    assert digest != curves.resolve_response(BOX, 0.8, 0.91)[2]
    relative, _, again = curves.resolve_response(BOX, 0.8, "curve.csv", base=tmp_path)
    assert again == other
    assert np.all(np.diff(relative.wavelength_m) > 0)


@pytest.mark.parametrize(
    ("bandpass", "field", "words"),
    [
        ({"kind": "named", "name": "gaiadr2-g"}, "sensor.bandpass.name", "gaiadr2-G"),
        ({"kind": "named", "name": "../../secret"}, "sensor.bandpass.name", "speclite"),
        ({"kind": "named", "name": "wise2010-W1"}, "sensor.bandpass.name", "290 to 2500"),
        ({"kind": "box", "short_nm": 900, "long_nm": 400}, "sensor.bandpass.long_nm", "more"),
        ({"kind": "box", "short_nm": 400}, "sensor.bandpass.long_nm", "finite"),
        ({"kind": "box", "short_nm": 400, "long_nm": np.nan}, "sensor.bandpass.long_nm", "finite"),
        ({"kind": "box", "short_nm": 0.4, "long_nm": 0.9}, "sensor.bandpass.short_nm", "290"),
        ({"kind": "boxx"}, "sensor.bandpass.kind", "box, named or table"),
    ],
)
def test_limits_bad_bandpass(bandpass, field, words):
    with pytest.raises(BadInput) as caught:
        curves.resolve_response(bandpass, 1.0, 1.0)
    assert caught.value.field == field
    assert words in str(caught.value)


@pytest.mark.parametrize("value", [0, 1.01, -0.5, np.nan, np.inf, True, None])
def test_limits_bad_efficiency(value):
    with pytest.raises(BadInput, match="quantum_efficiency"):
        curves.resolve_response(BOX, 1.0, value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("400,0.5\n900,nan\n", "finite"),
        ("400,0.5\n900,-0.1\n", "0 to 1"),
        ("400,50\n900,90\n", "0 to 1"),
        ("400,0.5\n900,0.5\n700,0.5\n", "ascending"),
        ("400,0.5\n400,0.6\n900,0.5\n", "ascending"),
        ("0.4,0.5\n0.9,0.5\n", "nm"),
        ("400,0.5,1\n900,0.5,1\n", "two finite"),
        ("wavelength_nm,value\n400,0.5\n", "two rows"),
        ("", "two rows"),
        ("1000,0.5\n1100,0.5\n", "covers the band"),
        ("400,0.5\n800,0.5\n", "ends at 800 nm.*covers the band"),
        ("300,0\n400,0.5\n800,0.5\n", "ends at 800 nm with 0.5"),
        ("1000,0\n1100,0.5\n", "wavelengths in common"),
        ("300,0\n1000,0\n", "above zero"),
        ("0.4,0.5\n400,0.5\n900,0.5\n", "0.4 to 900.*wavelengths in nm"),
    ],
)
def test_limits_bad_table(tmp_path, text, words):
    with pytest.raises(BadInput, match=words) as caught:
        curves.resolve_response(BOX, 1.0, table(tmp_path, text))
    assert caught.value.field.startswith("sensor")


def test_limits_tables_that_cannot_be_read(tmp_path):
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x01" * 10)
    for path in ("absent.csv", "binary.csv", "."):
        with pytest.raises(BadInput, match="readable"):
            curves.resolve_response({"kind": "table", "path": path}, 1.0, 1.0, base=tmp_path)
    zeros = table(tmp_path, "400,0\n900,0\n")
    with pytest.raises(BadInput, match="above zero"):
        curves.resolve_response({"kind": "table", "path": zeros}, 1.0, 1.0)


def test_limits_a_table_that_ends_in_zero_narrows_the_band(tmp_path):
    path = table(tmp_path, "# measured\n\nnm,qe\n450,0\n500,0.9\n800,0.9\n850,0\n")
    response, _, _ = curves.resolve_response(BOX, 1.0, path)
    assert response.wavelength_m[[0, -1]] * 1e9 == pytest.approx([450, 850])
    path = table(tmp_path, "300,0.9\n800,0.9\n850,0\n")  # at one end alone
    response, _, _ = curves.resolve_response(BOX, 1.0, path)
    assert response.wavelength_m[[0, -1]] * 1e9 == pytest.approx([400, 850])


def test_named_filters_need_speclite(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(BadInput) as told:
        curves.filter_folder()
    assert str(told.value) == (
        "sensor.bandpass.name: 'speclite' is not accepted; "
        "allowed: an installation with speclite"
    )


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("unit: Angstrom", "unit: furlong"),
        ("\n5000 0.5", "\n5000 0.5 0.1"),
        ("\n5000 0.5", "\n5000 half"),
        ("\n4000 0.0\n5000 0.5\n6000 0.0", ""),
    ],
)
def test_a_damaged_filter_of_speclite_is_told(old, new, tmp_path, monkeypatch):
    text = "# %ECSV 0.9\n# - {name: wavelength, unit: Angstrom}\nwavelength response\n"
    text += "4000 0.0\n5000 0.5\n6000 0.0\n"
    monkeypatch.setattr(curves, "filter_folder", lambda: tmp_path)
    (tmp_path / "mine-V.ecsv").write_text(text)
    assert curves.named_filter("mine-V").value.tolist() == [0.0, 0.5, 0.0]
    (tmp_path / "mine-V.ecsv").write_text(text.replace(old, new))
    with pytest.raises(Damaged, match=r"mine-V\.ecsv.*no wavelength unit, or not two columns"):
        curves.named_filter("mine-V")


def test_against_every_filter_that_speclite_carries():
    for path in curves.filter_folder().glob("*.ecsv"):
        curve = curves.named_filter(path.stem)
        assert 1e-7 < curve.wavelength_m[0] < curve.wavelength_m[-1] < 3e-5
        assert 0.05 < curve.value.max() <= 1.0  # SDSS z passes 0.09 at most


def test_2mass_bands_are_relative_to_their_peak():
    """Cohen et al. 2003, AJ 126, 1090, table 1: the widths of their responses [um]."""
    for band, width_um in (("J", 0.162), ("H", 0.251), ("Ks", 0.262)):
        curve = curves.named_filter(f"twomass-{band}")
        width = np.trapezoid(curve.value, curve.wavelength_m * 1e6)
        assert width == pytest.approx(width_um, rel=0.05)


def test_against_published_gaia_passbands(shared_data):
    table_nm = np.loadtxt(shared_data / "passbands" / "GaiaDR2_RevisedPassbands.dat")
    for column, band in ((1, "G"), (3, "BP"), (5, "RP")):
        expected = np.where(table_nm[:, column] > 99, 0.0, table_nm[:, column])
        curve = curves.named_filter(f"gaiadr2-{band}")
        got = np.interp(table_nm[:, 0] * 1e-9, curve.wavelength_m, curve.value, left=0, right=0)
        # speclite ends G at 1090 nm; the published 0.002 beyond that is omitted there.
        assert np.max(np.abs(got - expected)[table_nm[:, 0] < 1090.0]) < 1e-6
    # AB zero points worked out from these bands, pupil 0.7278 m2.
    for band, zero in (("G", 25.7889), ("BP", 25.3830), ("RP", 25.1134)):
        rate = ab_photon_rate(0.0, curves.named_filter(f"gaiadr2-{band}"))
        assert 2.5 * np.log10(rate * 0.7278) == pytest.approx(zero, abs=2e-4)


def test_against_energy_convention_of_bessell():
    # Photon responses are the tabulated ones over the wavelength: bluer than the table.
    tabulated = {480.0: 0.030, 500.0: 0.458, 530.0: 1.0, 560.0: 0.792}
    curve = curves.named_filter("bessell-V")
    nm = np.array(list(tabulated))
    photon = np.interp(nm * 1e-9, curve.wavelength_m, curve.value) * nm
    np.testing.assert_allclose(photon / photon[2], list(tabulated.values()), rtol=1e-12)


def test_against_the_sun(real):
    wavelength, irradiance, source, _ = curves.solar_spectrum()
    band = box(400e-9, 900e-9)
    assert "table 3" in source
    assert np.all(np.diff(wavelength) > 0)
    assert np.trapezoid(irradiance, wavelength) == pytest.approx(1366.09, abs=0.01)
    assert energy_integral(wavelength, irradiance, band) == pytest.approx(758.32, abs=0.005)
    assert photon_integral(wavelength, irradiance, band) == pytest.approx(2.36453e21, rel=4e-6)
    vega = fits.getdata(real / "stellar_spectra" / "alpha_lyr_stis_008-edit.fits", 1)
    vega_m = np.array(vega["WAVELENGTH"], float) * 1e-10
    vega_flux = np.array(vega["FLUX"], float) * 1e7
    assert np.interp(5556e-10, vega_m, vega_flux) == pytest.approx(3.4434e-2, rel=1e-3)
    sun_v = {}
    stsci = fits.getdata(real / "passbands" / "johnson_v_004_syn.fits", 1)
    photon = curves.named_filter("bessell-V")
    for name, v in (
        ("photon", photon),
        ("as tabulated", ResponseCurve(photon.wavelength_m, photon.value * photon.wavelength_m)),
        ("stsci", ResponseCurve(stsci["WAVELENGTH"] * 1e-10, stsci["THROUGHPUT"])),
    ):
        ratio = photon_integral(wavelength, irradiance, v) / photon_integral(vega_m, vega_flux, v)
        sun_v[name] = 0.03 - 2.5 * np.log10(ratio)
    # The usual -26.755 counts photons with Bessell's energy responses; by 0.011 too bright.
    assert sun_v["as tabulated"] == pytest.approx(-26.755, abs=0.001)
    assert sun_v["photon"] == pytest.approx(sun_v["stsci"], abs=0.001)
    assert sun_v["photon"] == pytest.approx(-26.76, abs=0.03)
    # Vega's own zero points in the DR2 bands.
    for name, zero in (("G", 25.6594), ("BP", 25.3122), ("RP", 24.7384)):
        rate = photon_integral(vega_m, vega_flux, curves.named_filter(f"gaiadr2-{name}"))
        assert 2.5 * np.log10(rate * 0.7278) == pytest.approx(zero, abs=2e-4)


def test_against_the_whole_table_embedded_sun(shared_data, monkeypatch):
    monkeypatch.setenv("NIGHTGLASS_DATA", str(shared_data))
    full = curves.solar_spectrum()[:2]
    monkeypatch.delenv("NIGHTGLASS_DATA")
    small = curves.solar_spectrum()[:2]
    rng = np.random.default_rng(0)
    for width, bound, beyond_400 in (
        (50, 0.011, 0.0045),
        (100, 0.004, 0.0025),
        (200, 0.0015, 0.001),
    ):
        for short in rng.uniform(300, 1200 - width, 150):
            band = box(short * 1e-9, (short + width) * 1e-9)
            error = photon_integral(*small, band) / photon_integral(*full, band) - 1.0
            assert abs(error) < (beyond_400 if short > 400 else bound)
    band = box(400e-9, 900e-9)
    assert photon_integral(*small, band) == pytest.approx(2.36453e21, rel=1e-4)


def test_against_the_whole_library_every_embedded_spectrum(real):
    """Mean photon flux of each box, of each of the 29 types: to the thousandth it is kept to."""
    folder = real / "stellar_spectra" / "pickles_uvk"
    files = {str(t): str(f) for f, t in fits.getdata(folder / "pickles_uk.fits", 1)}
    embedded = boxes.stars()
    edges = np.array(embedded.edges_nm)
    for name, kept in embedded.columns.items():
        table = fits.getdata(folder / f"{files[name]}.fits", 1)
        nm, photons = table["WAVELENGTH"] / 10.0, table["WAVELENGTH"] * table["FLUX"]
        means = []
        for low, high in pairwise(edges):
            at = np.unique(np.r_[low, nm[(nm > low) & (nm < high)], high])
            means.append(np.trapezoid(np.interp(at, nm, photons), at) / (high - low))
        found = -2.5e3 * np.log10(np.array(means) / means[list(edges).index(550)])
        assert np.abs(found - kept).max() <= 0.51, name


def test_limits_damaged_data_are_named(tmp_path, monkeypatch):
    monkeypatch.setenv("NIGHTGLASS_DATA", str(tmp_path))
    assert "boxes" in curves.solar_spectrum()[2]
    (tmp_path / "solar_spectrum").mkdir()
    file = tmp_path / "solar_spectrum" / "e490-00a_2014_table3.txt"
    file.write_text("wavelength, irradiance\n0.5, 1900\n0.5, 1800\n")
    with pytest.raises(Damaged, match="e490"):
        curves.solar_spectrum()
    file.write_text("nothing here\n")
    with pytest.raises(Damaged, match="e490"):
        curves.solar_spectrum()
    (tmp_path / "stellar_spectra" / "pickles_uvk").mkdir(parents=True)
    with pytest.raises(Damaged, match="pickles_uk"):
        curves.stellar_library()


def test_every_spectrum_of_the_library_counts_in_its_digest(tmp_path, monkeypatch):
    """Names and contents of the user's, else the numbers that are embedded: fits are kept by it."""
    monkeypatch.setenv("NIGHTGLASS_DATA", str(tmp_path))
    found = [curves.stellar_library_digest()]

    def now():
        found.append(curves.stellar_library_digest())
        assert found[-1] not in found[:-1]

    one = boxes.Boxes(boxes.stars().edges_nm, {"A0V": (0.0, 1.0)})
    monkeypatch.setattr(boxes, "stars", lambda: one)
    now()
    monkeypatch.setattr(boxes, "stars", lambda: one._replace(edges_nm=(300.0, 400.0, 500.0)))
    now()
    folder = tmp_path / "stellar_spectra" / "pickles_uvk"
    folder.mkdir(parents=True)
    now()
    for name, content in (("a.fits", b"1"), ("a.fits", b"2"), ("b.fits", b"2"), ("b.fits", b"1")):
        (folder / name).write_bytes(content)
        now()
    (folder / "b.fits").rename(folder / "c.fits")  # in its old place of the order
    now()


def test_against_pickles_embedded_boxes(real, monkeypatch):
    full, source = curves.stellar_library()
    assert source.startswith("106 spectra")
    whole = {name: (w, f) for name, w, f in full}
    digest = curves.stellar_library_digest()
    monkeypatch.delenv("NIGHTGLASS_DATA")
    small, _ = curves.stellar_library()
    assert digest != curves.stellar_library_digest()
    bands = [box(a * 1e-9, b * 1e-9) for a, b in ((550, 575), (400, 900), (330, 680), (700, 1000))]
    for name, wavelength, flux in small:
        assert np.all(flux[1:-1] > 0.0)
        mine = np.array([photon_integral(wavelength, flux, band) for band in bands])
        theirs = np.array([photon_integral(*whole[name], band) for band in bands])
        error_mag = -2.5 * np.log10(mine / mine[0] * theirs[0] / theirs)
        assert np.max(np.abs(error_mag)) < 0.01
