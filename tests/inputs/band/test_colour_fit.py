"""Colour fits against Evans et al. 2018, real DR2 rows and the embedded library."""

from __future__ import annotations

import json

import numpy as np
import pytest
from astropy.table import Table

from pipeline.inputs.band import colour_fit, curves
from pipeline.physics.colour import ColourFit, colour_correction_mag, star_electron_rate
from pipeline.physics.radiometry import photon_integral

BOX = {"kind": "box", "short_nm": 400, "long_nm": 900}

# G - band of Evans et al. 2018, A&A 616, A4, table A.2, for -0.5 < BP-RP < 2.75; scatter.
EVANS = {
    "V": ((-0.01760, -0.006860, -0.1732), 0.0459),
    "R": ((-0.003226, 0.3833, -0.1345), 0.0484),
    "I": ((0.02085, 0.7419, -0.09631), 0.0496),
}


def fitted(bandpass: dict) -> ColourFit:
    return colour_fit.gather_colour_fit(*curves.resolve_response(bandpass, 1.0, 1.0))


def named(name: str) -> dict:
    return {"kind": "named", "name": name}


@pytest.fixture
def real(shared_data, monkeypatch):
    monkeypatch.setenv("NIGHTGLASS_DATA", str(shared_data))


@pytest.fixture
def kept_in(tmp_path, monkeypatch):
    """The folder that fits are kept in, empty."""
    monkeypatch.setenv("NIGHTGLASS_CACHE", str(tmp_path))
    return tmp_path / "responses"


@pytest.fixture
def embedded(monkeypatch):
    monkeypatch.delenv("NIGHTGLASS_DATA", raising=False)


@pytest.mark.parametrize("band", EVANS)
def test_against_evans_polynomials(real, band, shared_data):
    """Magnitudes over Vega's, which is as bright in V, R and I (0.03; Bessell, Castelli & Plez
    1998, A&A 333, 231) as in the published G; the fit's are over an A0V star's."""
    coefficients, scatter = EVANS[band]
    fit = fitted(named(f"bessell-{band}"))
    vega = Table.read(shared_data / "stellar_spectra" / "alpha_lyr_stis_008-edit.fits")
    library, _ = curves.stellar_library()
    a0v = next((w, f) for name, w, f in library if name == "A0V")
    star = vega["WAVELENGTH"].astype(float) * 1e-10, vega["FLUX"].astype(float)
    responses = (curves.named_filter(f"bessell-{band}"), curves.named_filter("gaiadr2-G"))
    in_band, in_g = (photon_integral(*a0v, r) / photon_integral(*star, r) for r in responses)
    over_vega = -2.5 * np.log10(in_band / in_g)
    x = np.linspace(-0.5, 2.75, 300)
    published = -np.polynomial.polynomial.polyval(x, coefficients)
    difference = colour_correction_mag(x, fit) + over_vega - published
    assert np.sqrt(np.mean(difference[x < 2.0] ** 2)) < 0.5 * scatter
    # Unreddened dwarfs and giants leave Evans' mean relation for M stars, most so in R.
    assert np.max(np.abs(difference)) < {"V": 0.03, "R": 0.16, "I": 0.12}[band]
    assert fit.spectra_count == 102
    assert fit.residual_rms_mag < 0.022


def test_against_fluxes_of_real_rows(real, shared_data):
    """In Gaia's own band and pupil a star's electrons are those that DR2 publishes."""
    path = shared_data / "gaia_dr2" / "full_schema_random" / "gdr2_sm.fits"
    rows = Table.read(path, unit_parse_strict="silent")
    columns = ("phot_g_mean_mag", "phot_bp_mean_mag", "phot_rp_mean_mag")
    g, bp, rp = (np.ma.filled(rows[c].astype(float), np.nan) for c in columns)
    fit = fitted(named("gaiadr2-G"))
    rate, flag = star_electron_rate(g, bp, rp, fit)
    np.testing.assert_allclose(rate * 0.7278, rows["phot_g_mean_flux"], rtol=2e-5)
    assert np.array_equal(flag == 1, ~np.isfinite(bp - rp))
    # RP through the polynomial, against the published flux of stars with good colours.
    rate, _ = star_electron_rate(g, bp, rp, fitted(named("gaiadr2-RP")))
    good = np.isfinite(bp - rp) & (g < 17.0)
    error = -2.5 * np.log10(rate * 0.7278 / np.ma.filled(rows["phot_rp_mean_flux"], np.nan))
    assert abs(np.median(error[good])) < 0.02
    # BP and RP err alike (G's own trend with magnitude): BP-RP is as DR2 has it, to 3 mmag.
    other, _ = star_electron_rate(g, bp, rp, fitted(named("gaiadr2-BP")))
    blue = -2.5 * np.log10(other * 0.7278 / np.ma.filled(rows["phot_bp_mean_flux"], np.nan))
    assert abs(np.median((blue - error)[good])) < 0.003


def test_limits_a0v_is_zero_and_scaled_to_g(real):
    for bandpass in (BOX, named("bessell-V"), named("bessell-I")):
        points = colour_fit.gather_colour_points(curves.resolve_response(bandpass, 1.0, 1.0)[0])
        i = points.names.index("A0V")
        assert points.bp_rp[i] == points.a0v_bp_rp == pytest.approx(0.047, abs=1e-3)
        assert points.band_minus_g[i] == 0.0
        fit = colour_fit.fit_band(points, "b")
        at_a0v = colour_correction_mag(np.array([points.a0v_bp_rp]), fit)
        assert at_a0v == pytest.approx(0.0, abs=1e-12)
    # an A0V star of G = 15 has F(5556 A) = 3.587e-15 erg/s/cm2/A, with the revised
    # zero point; with the one of the published magnitudes it is 0.28% fainter.
    library, _ = curves.stellar_library()
    _, wavelength, flux = next(star for star in library if star[0] == "A0V")
    g = curves.named_filter("gaiadr2-G")
    per_unit = photon_integral(wavelength, flux, g)
    at_5556 = np.interp(5556e-10, wavelength, flux) / per_unit
    f5556 = at_5556 * fitted(named("gaiadr2-G")).zero_electrons_s_m2 * 1e-6 * 1e-7
    assert f5556 == pytest.approx(3.587e-15, rel=4e-3, abs=0.0)
    assert f5556 * 10 ** (0.4 * (25.6914396869 - 25.6883657251)) == pytest.approx(
        3.587e-15, rel=1e-3, abs=0.0
    )


@pytest.mark.parametrize(
    ("bandpass", "rms_mag", "zero"),
    [
        (BOX, 0.003, 1e-3),
        ({"kind": "box", "short_nm": 450, "long_nm": 900}, 0.002, 1e-3),
        ({"kind": "box", "short_nm": 500, "long_nm": 700}, 0.012, 1e-3),
        (named("bessell-V"), 0.011, 2e-3),
        (named("bessell-R"), 0.011, 2e-3),
        (named("bessell-I"), 0.008, 2e-3),
    ],
)
def test_against_whole_library_embedded_fit(shared_data, monkeypatch, bandpass, rms_mag, zero):
    monkeypatch.setenv("NIGHTGLASS_DATA", str(shared_data))
    full = fitted(bandpass)
    monkeypatch.delenv("NIGHTGLASS_DATA")
    small = fitted(bandpass)
    x = np.linspace(-0.6, 2.75, 200)
    difference = colour_correction_mag(x, small) - colour_correction_mag(x, full)
    assert np.sqrt(np.mean(difference**2)) < rms_mag
    assert small.zero_electrons_s_m2 == pytest.approx(full.zero_electrons_s_m2, rel=zero)
    assert "embedded" in small.source


def test_same_fit_from_disk_and_after_damage(embedded, kept_in, monkeypatch):
    first = colour_fit.describe(fitted(BOX))
    (file,) = kept_in.iterdir()
    calls = []
    gather = colour_fit.gather_colour_points
    monkeypatch.setattr(colour_fit, "gather_colour_points", lambda r: calls.append(1) or gather(r))
    assert colour_fit.describe(fitted(BOX)) == first
    assert not calls
    whole = file.read_bytes()
    turned = bytearray(whole)
    turned[whole.index(np.float64(first["coefficients"][1]).tobytes())] ^= 1
    for damage in (b"", b"PK", whole[:-40], bytes(turned)):
        file.write_bytes(damage)
        assert colour_fit.describe(fitted(BOX)) == first
    assert len(calls) == 4
    assert file.read_bytes() == whole
    fitted({"kind": "box", "short_nm": 400, "long_nm": 901})
    assert len(list(kept_in.iterdir())) == 2
    blocked = kept_in / "file"
    blocked.write_text("")
    monkeypatch.setenv("NIGHTGLASS_CACHE", str(blocked / "below"))
    assert colour_fit.describe(fitted(BOX)) == first


def test_another_library_has_a_fit_of_its_own(shared_data, monkeypatch, kept_in):
    """Data that come later, or go, are not answered from the cache of what was there before."""
    monkeypatch.delenv("NIGHTGLASS_DATA", raising=False)
    small = fitted(BOX)
    monkeypatch.setenv("NIGHTGLASS_DATA", str(shared_data))
    assert fitted(BOX).source != small.source


def test_same_description_carries_every_spectrum(embedded):
    points = colour_fit.gather_colour_points(curves.resolve_response(BOX, 0.5, 0.5)[0])
    fit = colour_fit.fit_band(points, "half")
    whole = fitted(BOX)
    assert fit.zero_electrons_s_m2 == pytest.approx(0.25 * whole.zero_electrons_s_m2)
    np.testing.assert_allclose(fit.coefficients, whole.coefficients, atol=1e-12)
    text = json.dumps(colour_fit.describe(fit, points))
    described = json.loads(text)
    assert len(described["spectra"]) == len(points.names) == fit.spectra_count
    worst = max(abs(row["residual_mag"]) for row in described["spectra"])
    assert worst == pytest.approx(fit.residual_max_mag)
    low = colour_fit.fit_band(points, "two", degree=2)
    assert low.coefficients.size == 3
    assert 0.0 < fit.default_error_mag < 0.05


def test_what_the_default_colour_costs_is_what_it_costs_real_stars(shared_data):
    """921 random DR2 rows, and V - G of Evans et al. 2018 at their colours and at the default."""
    table = Table.read(shared_data / "gaia_dr2" / "full_schema_random" / "gdr2_sm.fits")
    name = {column.lower(): column for column in table.colnames}["bp_rp"]
    colours = np.ma.filled(np.ma.array(table[name], dtype=float), np.nan)
    colours = colours[np.isfinite(colours)]
    assert colours.size == 921
    rms, most = colour_fit.default_colour_error_mag(fitted(named("bessell-V")))
    coefficients, _ = EVANS["V"]
    inside = np.append(colours[(colours > -0.5) & (colours < 2.75)], colour_fit.DEFAULT_BP_RP_MAG)
    g_minus_v = np.polynomial.polynomial.polyval(inside, coefficients)
    error = g_minus_v[:-1] - g_minus_v[-1]
    assert rms == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.2)  # no reddest
    assert most > np.abs(error).max()
    assert most < 2.5


def test_curves_of_one_name_have_fits_of_their_own(embedded, kept_in):
    """A curve's file was changed and keeps its name: its content tells the fits apart."""
    found = {}
    for _ in range(2):
        for end in (700, 900):
            box = {"kind": "box", "short_nm": 400, "long_nm": end}
            response, _, digest = curves.resolve_response(box, 1.0, 1.0)
            fit = colour_fit.gather_colour_fit(response, "mine", digest, 2)
            assert np.array_equal(found.setdefault(end, fit).coefficients, fit.coefficients)
    assert not np.allclose(found[700].coefficients, found[900].coefficients)


def test_curves_of_one_content_keep_their_names_and_degrees(embedded, kept_in):
    """Products tell the band's name; `color-fit` may ask for a degree."""
    response, _, digest = curves.resolve_response(
        {"kind": "box", "short_nm": 400, "long_nm": 900}, 1.0, 1.0
    )
    asked = [("mine", 2), ("theirs", 2), ("mine", 3)]
    for _ in range(2):
        found = [colour_fit.gather_colour_fit(response, n, digest, d) for n, d in asked]
        assert [(f.band_name, len(f.coefficients) - 1) for f in found] == asked
    assert len(list(kept_in.iterdir())) == 3
