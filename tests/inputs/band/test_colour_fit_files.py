"""Colour fits that a scene names: written, read back the same, refused where they do not belong."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from catalog_tools.ingest.ingest import ingest
from pipeline.cli import app
from pipeline.errors import BadInput
from pipeline.inputs.band.colour_fit_files import read_colour_fit
from pipeline.inputs.band.response import gather_response
from pipeline.route.prepare import prepare
from pipeline.route.run import render
from pipeline.spec.load import load_scene, parse_scene

SCENE = {
    "schema": "nightglass/scene/1", "name": "fitted", "epoch": "2015-07-02T12:00:00Z",
    "observer": {"kind": "fixed", "position_au": [0.9, 0.4, 0.1]},
    "sensor": {
        "shape": [64, 64], "pixel_pitch_um": 10.0, "focal_length_m": 0.4, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0}, "read_noise_e": 5.0,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 101.0, "boresight_dec_deg": 30.0},
    "exposure": {"integration_s": 1.0},
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A star of BP-RP = 1, a scene without a named fit, and the fit that color-fit saves of it."""
    folder = tmp_path_factory.mktemp("fit")
    (folder / "stars.csv").write_text(
        "source_id,ref_epoch,ra,dec,pmra,pmdec,phot_g_mean_mag,phot_bp_mean_mag,phot_rp_mean_mag\n"
        "1,2015.5,101.0,30.0,0,0,9.0,9.5,8.5\n"
    )
    ingest([folder / "stars.csv"], folder / "catalogue")
    scene = SCENE | {"stars": {"catalogue": str(folder / "catalogue")}}
    (folder / "scene.json").write_text(json.dumps(scene))
    result = CliRunner().invoke(
        app, ["color-fit", str(folder / "scene.json"), "-o", str(folder / "fit.json")]
    )
    assert result.exit_code == 0, result.output
    return folder


def named(folder, path="fit.json", **sensor):
    data = json.loads((folder / "scene.json").read_text())
    data["stars"]["colour_fit"] = str(folder / path)
    data["sensor"] |= sensor
    return parse_scene(data)


def edited(folder, name, by_hand=True, **changes):
    stored = json.loads((folder / "fit.json").read_text())
    stored["fit"] |= changes
    if by_hand:
        stored["sha256"] = None
    (folder / name).write_text(json.dumps(stored))
    return name


def test_same_light_as_the_fit_that_was_saved(folder):
    plain = prepare(load_scene(folder / "scene.json", [])).plan
    plan = prepare(named(folder)).plan
    assert np.array_equal(plan.colour.coefficients, plain.colour.coefficients)
    assert plan.colour.zero_electrons_s_m2 == plain.colour.zero_electrons_s_m2
    assert plain.colour.digest is None
    content = (folder / "fit.json").read_bytes()
    assert plan.colour.digest == hashlib.sha256(content).hexdigest()


def test_a_measured_fit_sets_the_light(folder, tmp_path):
    """A correction of 0.75 mag more than the library's makes the star 10^0.3 fainter."""
    library = prepare(named(folder)).plan.colour
    terms = [float(library.coefficients[0]) + 0.75, *map(float, library.coefficients[1:])]
    electrons = {}
    for name in ("fit.json", edited(folder, "measured.json", coefficients=terms)):
        report = render(named(folder, name), tmp_path / name)
        electrons[name] = report["errors"]["brightest_source_e"]
        assert report["colour_fit"]["source"].startswith(name)
        digest = hashlib.sha256((folder / name).read_bytes()).hexdigest()
        assert report["colour_fit"]["digest"] == digest
    assert electrons["measured.json"] == pytest.approx(electrons["fit.json"] * 10**-0.3, rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"band_name": "another"}, "band another"),
        ({"coefficients": []}, "fit.coefficients"),
        ({"coefficients": [0.0, float("nan")]}, "fit.coefficients"),
        ({"coefficients": [0.0, 1e9]}, "fit.coefficients"),
        ({"colour_range": [2.0, 1.0]}, "fit.colour_range"),
        ({"zero_electrons_s_m2": 0.0}, "fit.zero_electrons_s_m2"),
        ({"zero_electrons_s_m2": True}, "fit.zero_electrons_s_m2"),
        ({"spectra_count": None}, "fit.spectra_count"),
        ({"coefficients": [0.0, 10**400]}, "1 to 16 numbers"),
        ({"colour_range": [-4.0, 0.5], "coefficients": [0.0] * 4 + [200.0]}, "at most 30 mag"),
    ],
)
def test_limits_of_what_a_file_may_say(folder, changes, word):
    scene = named(folder, edited(folder, "bad.json", **changes))
    with pytest.raises(BadInput, match=word) as caught:
        prepare(scene)
    assert caught.value.field == "stars.colour_fit"


def test_limits_other_files_and_sensors(folder):
    edited(folder, "changed.json", by_hand=False, default_colour=1.0)
    (folder / "none.json").write_text("[1]")
    cases = [
        (named(folder, "changed.json"), "sha256"),
        (named(folder, "none.json"), "colour-fit-file/2"),
        (named(folder, "absent.json"), "No such file"),
        (named(folder, quantum_efficiency=0.5), "response"),
    ]
    for scene, word in cases:
        with pytest.raises(BadInput, match=word):
            prepare(scene)
    _, band, digest = gather_response(named(folder))
    assert read_colour_fit(folder / "fit.json", band, digest).band_name == band
    again = ["color-fit", str(folder / "scene.json"), "-o", str(folder / "fit.json")]
    assert CliRunner().invoke(app, again).exit_code != 0
