"""Libraries of cosmic rays: extracted from simulated darks, read, refused, and the real one."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from astropy.io import fits
from scipy import ndimage
from typer.testing import CliRunner

from pipeline.commands.cosmic_rays import cosmic_rays
from pipeline.errors import BadInput
from pipeline.inputs.sensor import cosmic_ray_darks
from pipeline.inputs.sensor import cosmic_rays as cosmic_rays_module
from pipeline.inputs.sensor.cosmic_ray_darks import extract_library, open_darks
from pipeline.inputs.sensor.cosmic_ray_library import read_library, write_library
from pipeline.inputs.sensor.cosmic_rays import gather_cosmic_rays
from pipeline.physics.cosmic_rays.frame import charge_e, truth_columns
from pipeline.physics.cosmic_rays.library import Library, Recorded
from pipeline.physics.cosmic_rays.tracks import Flux
from pipeline.resolve.resolve import resolve
from pipeline.spec.load import parse_scene
from pipeline.spec.sensor.cosmic_rays import GeneratedCosmicRays, LibraryCosmicRays
from pipeline.spec.sensor.sensor import Sensor
from pipeline.studies.cosmic_rays import (
    Events,
    _charge_per_um,
    compare_library,
    draw_comparison,
)
from tests.command import nightglass

SENSOR = Sensor(
    shape=(300, 200), pixel_pitch_um=10.0, focal_length_m=1.0, aperture_m=0.1,
    bandpass={"kind": "box", "short_nm": 400, "long_nm": 900},
    psf={"kind": "gaussian", "sigma_px": 1.0},
)  # fmt: skip
READ_NOISE_E, GAIN, EXPOSURE_S, FRAMES = 5.0, 2.0, 60.0, 12
FLUX = Flux(300, 200, 10.0, 30.0, 4.0, EXPOSURE_S, diffusion_um=3.0)


@pytest.fixture(scope="module")
def darks(tmp_path_factory):
    """Darks with a bias pattern, hot pixels, one that flickers, and the generator's events."""
    folder, rng = tmp_path_factory.mktemp("darks"), np.random.default_rng(4)
    bias = 500 + rng.normal(0, 20, (300, 200))
    dark = np.full((300, 200), 10.0)
    dark[rng.integers(0, 300, 60), rng.integers(0, 200, 60)] = 20_000.0
    paths = []
    for k in range(FRAMES):
        electrons = rng.poisson(dark) + charge_e(FLUX, 9, k, 0, 0, 300, 200)
        electrons[50, 60] += 5000.0 * (k % 3 == 0)
        dn = np.rint((electrons + rng.normal(0, READ_NOISE_E, dark.shape)) / GAIN + bias + 0.7 * k)
        if k % 2:
            paths.append(folder / f"{k}.npy")
            np.save(paths[-1], dn.astype(np.uint16))
        else:
            paths.append(folder / f"{k}.fits")
            fits.PrimaryHDU(dn.astype(np.uint16)).writeto(paths[-1])
    return paths


@pytest.fixture(scope="module")
def extracted(darks):
    return extract_library(open_darks(darks), EXPOSURE_S, 10.0, GAIN)


def test_extract_recovers_injected_events(extracted):
    """Completeness and purity by the events' own pixels, and the charge of what was found."""
    lib, report = extracted
    near = [np.zeros((300, 200)) for _ in range(FRAMES)]
    for n in range(len(lib)):
        part = slice(lib.start[n], lib.start[n + 1])
        near[lib.frame[n]][lib.y[part], lib.x[part]] = lib.electrons[part]
    injected = found = pure = 0
    in_charge, out_charge = 0.0, 0.0
    for k in range(FRAMES):
        truth = charge_e(FLUX, 9, k, 0, 0, 300, 200)
        clear = truth > 2 * report["threshold_e"]
        labels, _ = ndimage.label(truth > 5, structure=np.ones((3, 3)))
        bright = np.unique(labels[clear & (labels > 0)])
        injected += len(bright)
        found += sum((near[k][labels == b] > 0).any() for b in bright)
        in_charge += truth[np.isin(labels, bright)].sum()
        out_charge += near[k].sum()
    for n in range(len(lib)):
        part = slice(lib.start[n], lib.start[n + 1])
        truth = charge_e(FLUX, 9, int(lib.frame[n]), 0, 0, 300, 200)
        pure += truth[lib.y[part], lib.x[part]].max() > READ_NOISE_E
    assert injected > 100
    assert found / injected > 0.98
    assert pure / len(lib) > 0.98
    assert out_charge == pytest.approx(in_charge, rel=0.05)
    print(f"found {found}/{injected}, pure {pure}/{len(lib)}, charge {out_charge / in_charge:.4f}")


def test_extract_measures_rate_and_noise(extracted):
    lib, report = extracted
    truth = sum(len(truth_columns(FLUX, 9, k)["event"]) for k in range(FRAMES))
    assert len(lib) == pytest.approx(truth, rel=0.15)
    assert report["noise_e"] == pytest.approx(np.hypot(READ_NOISE_E, 10**0.5), rel=0.15)
    assert report["pixels_left_out"] >= 1  # the one that flickers
    assert report["events_per_cm2_s"] == pytest.approx(FLUX.rate_per_cm2_s, rel=0.25)
    assert not ((lib.y == 50) & (lib.x == 60) & (lib.electrons > 2500)).any()


def test_library_round_trip(extracted, tmp_path):
    lib, path = extracted[0], tmp_path / "library.fits"
    write_library(path, lib)
    back = read_library(path)
    for name in ("start", "x", "y", "frame"):
        np.testing.assert_array_equal(getattr(back, name), getattr(lib, name))
    np.testing.assert_array_equal(back.electrons, lib.electrons.astype(np.float32))
    for name in ("exposure_s", "pixels", "pixel_pitch_um", "shape", "frames"):
        assert getattr(back, name) == getattr(lib, name)
    a, b = (Recorded(one, 300, 200, 10.0, 600.0, arrival="frames") for one in (lib, back))
    np.testing.assert_allclose(charge_e(a, 1, 0, 0, 0, 300, 200),
                               charge_e(b, 1, 0, 0, 0, 300, 200), rtol=1e-6)  # fmt: skip


def test_the_real_library(shared_data, tmp_path):
    """Its source's figures, and the charge per length of straight tracks beside the generator's."""
    lib = read_library(shared_data / "cosmic_rays" / "cosmic_rays_itl_2017.fits.gz")
    charge = np.add.reduceat(lib.electrons, lib.start[:-1])
    assert len(lib) == 1764
    np.testing.assert_allclose(np.percentile(charge, [5, 50, 95]), [52, 7134, 40016], atol=1)
    assert charge.max() == 629957
    assert np.median(np.diff(lib.start)) == 7
    assert lib.rate_per_px_s == pytest.approx(7.22e-8, rel=1e-3, abs=0.0)
    study = compare_library(lib, 10.0, 100.0, 4.0, 50.0, events=1000)
    recorded, muons, isotropic = study["summary"].values()
    assert recorded["rate_per_cm2_min"] == pytest.approx(4.33, abs=0.01)
    for made in (muons, isotropic):
        assert made["rate_per_cm2_min"] == pytest.approx(1.0, rel=0.1)
        assert made["straight_e_per_um_peak"] == pytest.approx(
            recorded["straight_e_per_um_peak"], rel=0.1
        )
    draw_comparison(study, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 20_000


def test_gather():
    assert gather_cosmic_rays(None, SENSOR, 1.0) is None
    assert gather_cosmic_rays(GeneratedCosmicRays(kind="generated", rate_per_cm2_s=0), SENSOR,
                              1.0) is None  # fmt: skip
    none = LibraryCosmicRays(kind="library", path="/nowhere", rate_scale=0)
    assert gather_cosmic_rays(none, SENSOR, 1.0) is None  # nor is it read
    space = gather_cosmic_rays(GeneratedCosmicRays(kind="generated"), SENSOR, 2.0)
    assert space == Flux(300, 200, 10.0, 15.0, 5.0, 2.0, 0.0, 0.09, 3.0)
    ground = gather_cosmic_rays(GeneratedCosmicRays(kind="generated", source="ground"), SENSOR, 2.0)
    assert (ground.zenith_power, ground.helium_share) == (2.0, 0.0)
    assert ground.rate_per_cm2_s == pytest.approx(1 / 60)


def test_the_longest_exposure_may_not_hold_too_many_events(monkeypatch):
    """0.06 cm2 at 5 a cm2 and second: 0.3 in the second of one dwell, 1.2 in four seconds."""
    monkeypatch.setattr(cosmic_rays_module, "MOST_EVENTS", 1)

    def asked(*times_s):
        dwells = [{"integration_s": t, "start_s": 10.0 * k} for k, t in enumerate(times_s)]
        return parse_scene({
            "schema": "nightglass/scene/1", "name": "rays", "epoch": "2019-04-20T03:00:00Z",
            "observer": {"kind": "fixed", "position_au": [1.2, 0.1, 0.05]},
            "sensor": SENSOR.model_dump(mode="json", exclude_unset=True),
            "cosmic_rays": {"kind": "generated", "rate_per_cm2_s": 5.0}, "dwells": dwells,
            "pointing": {"mode": "sidereal", "boresight_ra_deg": 40.0, "boresight_dec_deg": 25.0},
            "exposure": {"integration_s": 1.0},
        })  # fmt: skip

    assert resolve(asked(1.0, 1.0)).rays is not None
    with pytest.raises(BadInput, match=r"rate_per_cm2_s.*at most 4"):
        resolve(asked(1.0, 4.0))


def table(tmp_path, header=None, drop=(), **columns):
    """A library file with one thing changed."""
    given = {"fp_id": ("J", [0, 1]), "x0": ("J", [3, 4]), "y0": ("J", [5, 6]),
             "pixel_values": ("PE()", [np.float32([1.0, 2.0]), np.float32([3.0])])}  # fmt: skip
    for name, values in columns.items():
        given[name] = (given.get(name, "J")[0], values)
    made = []
    for name, (form, values) in given.items():
        if name not in drop:
            array = np.empty(2, object) if form == "PE()" else np.array(values)
            if form == "PE()":
                array[:] = values
            made.append(fits.Column(name, form, array=array))
    hdu = fits.BinTableHDU.from_columns(made, name="COSMIC_RAYS")
    hdu.header.update({"EXPTIME": 10.0, "NUM_PIX": 100} | (header or {}))
    path = tmp_path / "bad.fits"
    hdu.writeto(path, overwrite=True)
    return path


def test_refusals_of_libraries(tmp_path):
    assert len(read_library(table(tmp_path))) == 2
    brief = read_library(table(tmp_path, header={"EXPTIME": 0.5}))
    assert brief.rate_per_px_s == pytest.approx(2.0 / (100 * 0.5))
    text = tmp_path / "text.fits"
    text.write_text("no FITS")
    image = tmp_path / "image.fits"
    fits.PrimaryHDU(np.zeros((4, 4))).writeto(image)
    named = tmp_path / "named.fits"
    fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(name="COSMIC_RAYS")]).writeto(named)
    nan = [np.float32([np.nan, 2.0]), np.float32([3.0])]
    for path, says in (
        (tmp_path / "none.fits", "existing library"),
        (text, "readable FITS"),
        (image, "COSMIC_RAYS"),
        (named, "readable FITS table"),
        (table(tmp_path, drop=("x0",)), "column x0"),
    ):
        with pytest.raises(BadInput, match=says):
            read_library(path)
    for changed, says in (
        ({"header": {"EXPTIME": 0.0}}, "EXPTIME above 0"),
        ({"header": {"NUM_PIX": "many"}}, "NUM_PIX above 0"),
        ({"x0": [-3, 4]}, "places from 0"),
        ({"header": {"ROWS": 4, "COLUMNS": 40}}, "places in its"),
        ({"pixel_values": nan}, "electrons, 0 or more"),
        ({"pixel_values": [np.float32([-0.5, 2.0]), np.float32([3.0])]}, "electrons, 0 or more"),
        ({"header": {"ROWS": "few", "COLUMNS": 40}}, "ROWS above 0"),
    ):
        with pytest.raises(BadInput, match=says):
            read_library(table(tmp_path, **changed))
    odd = {
        "pixel_values": ("4E", [[[1.0, 2.0]] * 2] * 2, "(2,2)"),
        "x0": ("2J", [[3, 4], [3, 4]], None),
        "frame": ("2J", [[0, 0], [0, 0]], None),
    }
    for name, (form, values, shape) in odd.items():
        with fits.open(table(tmp_path)) as hdus:
            kept = [c for c in hdus[1].columns if c.name != name]
            changed = fits.Column(name, form, array=np.array(values), dim=shape)
            hdu = fits.BinTableHDU.from_columns([*kept, changed], hdus[1].header.copy())
            hdu.writeto(tmp_path / "odd.fits", overwrite=True)
        with pytest.raises(BadInput, match="readable FITS table"):
            read_library(tmp_path / "odd.fits")
    crowd = GeneratedCosmicRays(kind="generated", rate_per_cm2_s=1e5)
    with pytest.raises(BadInput, match="events a frame"):
        gather_cosmic_rays(crowd, SENSOR, 1e4)
    wish = LibraryCosmicRays(kind="library", path=str(table(tmp_path)), arrival="frames")
    with pytest.raises(BadInput, match="which frame"):
        gather_cosmic_rays(wish, SENSOR, 1.0)


def test_whole_frames_arrive_only_from_a_library_that_says_their_size(tmp_path):
    """Events are placed by the pixels of a frame: how many frames there are is too little."""
    path, count, shape = table(tmp_path), {"FRAMES": 3}, {"ROWS": 20, "COLUMNS": 40}
    wish = LibraryCosmicRays(kind="library", path=str(path), arrival="frames")
    table(tmp_path, header=count | shape, frame=[0, 2])
    assert gather_cosmic_rays(wish, SENSOR, 1.0) is not None
    for lacking in (count, {"FRAMES": 3, "ROWS": 20}, shape):
        table(tmp_path, header=lacking, frame=[0, 2])
        with pytest.raises(BadInput, match="which frame"):
            gather_cosmic_rays(wish, SENSOR, 1.0)


def test_a_dark_that_is_cut_off_after_it_was_opened_is_named(tmp_path):
    """Whose shape is read from its head alone."""
    np.save(tmp_path / "a.npy", np.zeros((9, 20, 30)))
    darks = open_darks([tmp_path / "a.npy"])
    os.truncate(tmp_path / "a.npy", 4000)
    with pytest.raises(BadInput, match=r"DARK_FRAMES: .*a\.npy' is .*allowed: a readable image; "):
        darks.band(0, 4)


def test_refusals_of_darks(tmp_path):
    def saved(name, value):
        np.save(tmp_path / name, value)
        return tmp_path / name

    good = [saved(f"{k}.npy", np.zeros((8, 9), np.uint16)) for k in range(3)]
    assert open_darks(good).frames == 3
    assert open_darks([saved("cube.npy", np.zeros((5, 8, 9)))]).frames == 5
    table_of_arrays, no_zip = tmp_path / "arrays.npy", tmp_path / "zip.npy"
    with table_of_arrays.open("wb") as file:
        np.savez(file, a=np.zeros((8, 9)))
    no_zip.write_bytes(b"PK\x03\x04 no zip")
    for paths, says in (
        (good[:2], "at least 3"),
        ([*good, saved("other.npy", np.zeros((9, 8)))], "one shape"),
        ([*good, saved("line.npy", np.zeros(8))], "rows x columns"),
        ([*good, saved("text.npy", np.array([["a"]]))], "numbers"),
        ([*good, tmp_path / "none.npy"], "existing"),
        ([*good, tmp_path / "dark.tif"], "existing"),
        ([*good, table_of_arrays], "readable image"),
        ([*good, no_zip], "readable image"),
    ):
        with pytest.raises(BadInput, match=says):
            open_darks(paths)
    nan = saved("nan.npy", np.full((8, 9), np.nan))
    with pytest.raises(BadInput, match="finite"):
        extract_library(open_darks([*good, nan]), 1.0, 10.0)


def test_a_dark_of_no_known_type_of_number_is_refused(tmp_path):
    path = tmp_path / "d.fits"
    fits.PrimaryHDU(np.zeros((4, 8, 9), np.int16)).writeto(path)
    path.write_bytes(path.read_bytes().replace(b"                  16", b"                   9", 1))
    with pytest.raises(BadInput, match="readable image"):
        open_darks([path]).band(0, 8)


@pytest.mark.parametrize("name", ["d.fits", "d.fit", "d.fits.gz", "d.fits.fz", "d.npy"])
def test_darks_of_each_kind_of_file(name, tmp_path):
    cube = np.random.default_rng(3).integers(400, 600, (4, 8, 9)).astype(np.int16)
    if name.endswith(".npy"):
        np.save(tmp_path / name, cube)
    elif name.endswith(".fz"):
        packed = fits.CompImageHDU(cube, compression_type="RICE_1")
        fits.HDUList([fits.PrimaryHDU(), packed]).writeto(tmp_path / name)
    else:
        fits.PrimaryHDU(cube).writeto(tmp_path / name)
    stack = open_darks([tmp_path / name])
    assert (stack.frames, stack.shape) == (4, (8, 9))
    np.testing.assert_array_equal(stack.band(2, 7), cube[:, 2:7])


@pytest.mark.parametrize(
    ("own", "first", "says"),
    [
        (600.0, None, "600"),
        (None, 600, "600"),
        ("30", 300, "30"),
        (300.5, 600, None),
        ("", None, None),
        ("long", None, None),
        (None, None, None),
    ],
)
def test_darks_of_another_exposure_than_is_given_are_refused(own, first, says, tmp_path):
    """By EXPTIME of the image, else of the file's first header, to 1%; with the file and both."""
    levels = np.random.default_rng(3).normal(500.0, 5.0, (4, 8, 9))
    levels[0, 3:5, 4] += 900.0
    units = [fits.PrimaryHDU(), fits.ImageHDU(levels[:3])]
    for unit, value in zip(units, (first, own), strict=True):
        if value is not None:
            unit.header["EXPTIME"] = value
    fits.HDUList(units).writeto(tmp_path / "odd.fits")
    odd = tmp_path / "odd.fits"  # with `long` as no header has it: without quotes
    odd.write_bytes(odd.read_bytes().replace(b"'long    '", b" long d'x "))
    np.save(tmp_path / "none.npy", levels[3])
    command = ["cosmic-rays", "extract", tmp_path / "none.npy", tmp_path / "odd.fits",
               "--exposure-s", "300", "--pixel-pitch-um", "9"]  # fmt: skip
    done = nightglass(*command, "-o", tmp_path / "made.fits")
    assert done.returncode == (0 if says is None else 2), done.stderr
    if says is not None:
        told = " ".join(done.stderr.split())
        assert f"odd.fits with EXPTIME {says}' is not accepted; allowed: frames of " in told
        assert "--exposure-s, 300," in told


def test_command_line(darks, tmp_path):
    run = CliRunner()
    out = str(tmp_path / "made.fits")
    options = ["--exposure-s", "60", "--pixel-pitch-um", "10", "--gain-e-per-dn", "2"]
    result = run.invoke(cosmic_rays, ["extract", *map(str, darks), "-o", out, *options, "--json"])
    assert result.exit_code == 0, result.output
    assert len(read_library(tmp_path / "made.fits")) > 100
    for changed, says in (
        ([out, *options], "does not exist yet"),
        ([str(tmp_path / "a.txt"), *options], "ends in .fits"),
        ([str(tmp_path / "b.fits"), *options, "--gain-e-per-dn", "0"], "above 0"),
        ([str(tmp_path / "b.fits"), *options, "--threshold-sigma", "1"], "3 or more"),
        ([str(tmp_path / "b.fits"), *options, "--grow-sigma", "9"], "1 to the threshold"),
    ):
        result = run.invoke(cosmic_rays, ["extract", *map(str, darks), "-o", *changed])
        assert isinstance(result.exception, BadInput)
        assert says in str(result.exception)


def test_a_library_without_a_long_event_is_compared(tmp_path):
    """Its charge per length is not known; a threshold above or below all charge is refused."""
    command = ["cosmic-rays", "compare", table(tmp_path), "--pixel-pitch-um", "10", "-o"]
    done = nightglass(*command, tmp_path / "two.png", "--threshold-e", "1", "--json")
    assert json.loads(done.stdout)["recorded"]["straight_e_per_um_peak"] is None
    for value in ("0", "-5", "nan", "1e9"):
        done = nightglass(*command, tmp_path / "no.png", "--threshold-e", value)
        assert done.stderr.startswith(f"nightglass: --threshold-e: {float(value)} is not accepted")
    done = nightglass(*command, tmp_path / "two.png", "--threshold-e", "1")
    assert "a path that does not exist yet" in done.stderr


def test_a_library_without_events_is_refused(tmp_path):
    path = table(tmp_path)
    with fits.open(path, mode="update") as file:
        file["COSMIC_RAYS"].data = file["COSMIC_RAYS"].data[:0]
    done = nightglass("cosmic-rays", "compare", path, "--pixel-pitch-um", "10", "-o",
                      tmp_path / "no.png")  # fmt: skip
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.endswith("allowed: a library with events; it has none\n")


def test_frames_are_counted_at_a_terminal(darks, tmp_path, monkeypatch):
    """One line that is written over, and ends with the last frame; none in a file."""
    command = ["cosmic-rays", "extract", *darks, "--exposure-s", "60", "--pixel-pitch-um", "10"]
    quiet = nightglass(*command, "-o", tmp_path / "a.fits")
    monkeypatch.setattr("pipeline.commands.cosmic_rays.is_quiet", lambda as_json: as_json)
    shown = nightglass(*command, "-o", tmp_path / "b.fits")
    assert (quiet.returncode, quiet.stderr, shown.returncode) == (0, "", 0)
    assert shown.stderr.endswith(f"\rframe {FRAMES} of {FRAMES}\n")
    assert shown.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("header", "given", "told"),
    [
        ({}, (), "--pixel-pitch-um: None is not accepted; allowed: 0.05 to 1000: the library "),
        ({}, ("--pixel-pitch-um", "0.01"), "--pixel-pitch-um: 0.01 is not accepted; allowed: 0.05"),
        ({"PITCH_UM": 2000}, ("--pixel-pitch-um", "10"), "LIBRARY: "),
    ],
)
def test_a_pitch_that_is_none_is_told_where_it_was_given(header, given, told, tmp_path):
    path = table(tmp_path, header=header)
    done = nightglass("cosmic-rays", "compare", path, *given, "-o", tmp_path / "no.png")
    assert done.returncode == 2
    assert done.stderr.startswith(f"nightglass: {told}")
    assert not header or done.stderr.endswith("allowed: PITCH_UM of 0.05 to 1000, not 2000\n")
    assert not (tmp_path / "no.png").exists()


def test_same_library_read_band_by_band(darks, extracted, monkeypatch):
    """Bands of 7 rows, whose last is shorter: the same events as of the whole stack at once."""
    monkeypatch.setattr(cosmic_ray_darks, "BAND_BYTES", 4 * FRAMES * 200 * 7)
    whole, told = extracted
    banded, again = extract_library(open_darks(darks), EXPOSURE_S, 10.0, GAIN)
    assert again == told
    for name in ("start", "x", "y", "electrons", "frame"):
        assert np.array_equal(getattr(banded, name), getattr(whole, name)), name


def test_charge_over_length_is_of_long_events_alone():
    """A straight track of 80 e-/um across 40 px and the slab, beside a spot of more charge."""
    path_um = np.hypot(40 * 10.0, 100.0)
    charge_e = np.array([80.0 * path_um, 9e5])
    two = Events(np.array([41.0, 4.0]), np.array([40.0, 2.0]), charge_e, 1.0, [])
    assert _charge_per_um(two, 10.0, 100.0) == pytest.approx([80.0])


def test_darks_without_an_event_make_no_library(tmp_path):
    """A threshold that nothing passes is told in one line; no file comes of it."""
    np.save(tmp_path / "a.npy", np.random.default_rng(0).normal(500, 3, (5, 16, 16)))
    result = nightglass("cosmic-rays", "extract", tmp_path / "a.npy", "-o", tmp_path / "l.fits",
                        "--exposure-s", "10", "--pixel-pitch-um", "10", "--threshold-sigma",
                        "1000")  # fmt: skip
    assert result.returncode == 2
    assert "--threshold-sigma" in result.stderr
    assert not (tmp_path / "l.fits").exists()


def test_tracks_that_lie_askew_keep_their_rows(tmp_path):
    """One diagonal of single pixels, one whose rows begin a column on from where the last ended."""
    x, y = np.array([3, 4, 5, 10, 11, 12, 13]), np.array([5, 6, 7, 20, 20, 21, 21])
    one = Library(np.array([0, 3, 7]), x, y, np.arange(1.0, 8.0), 600.0, 10_000, 10.0, (100, 100),
                  2, np.array([0, 1]))  # fmt: skip
    write_library(tmp_path / "askew.fits", one)
    back = read_library(tmp_path / "askew.fits")
    for name in ("start", "x", "y", "electrons", "frame"):
        np.testing.assert_array_equal(getattr(back, name), getattr(one, name), err_msg=name)


def test_a_file_of_darks_counts_once(tmp_path):
    path = tmp_path / "d.npy"
    np.save(path, np.zeros((4, 8, 9), np.int16))
    (tmp_path / "link.npy").symlink_to(path)
    with pytest.raises(BadInput, match=r"link\.npy twice' is .*allowed: each file once"):
        open_darks([path, tmp_path / "link.npy"])
