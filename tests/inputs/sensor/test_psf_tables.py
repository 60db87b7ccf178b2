"""Tables of point-spread functions from files: what is read, and what is refused and how."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import BadInput
from pipeline.inputs.sensor.psf_tables import gather_psf_table, read_psf_table
from pipeline.physics.psf.sampled import sampled
from pipeline.spec.scene import Scene

PITCH_UM = 10.0


def light(ny: int, nx: int, row: float, column: float, sigma: float = 3.0) -> np.ndarray:
    y, x = np.arange(ny) - row, np.arange(nx) - column
    return np.exp(-0.5 * (y[:, None] ** 2 + (x[None, :] + 0.3 * y[:, None]) ** 2) / sigma**2)


def rows(values: np.ndarray) -> str:
    return "\r\n".join("\t".join(f"{v:.10E}" for v in row) for row in values)


def zemax_fft(values: np.ndarray, unit: str = "µm", spacing: float = 0.422) -> str:
    ny, nx = values.shape
    return "\r\n".join(
        [
            "Listing of FFT PSF Data", "", r"File : C:\lenses\triplet.zmx", "Title: A TRIPLET",
            "Date : 1/2/2024", "Configuration 1 of 1", "", "", "Polychromatic FFT PSF",
            "0.4861 to 0.6563 µm at 0.0000, 14.0000 (deg).", f"Data spacing is {spacing} {unit}.",
            f"Data area is {spacing * nx:.3f} {unit} wide.", "Surface: Image",
            "Reference Coordinates: 0.00000E+00, 1.81500E+01", "Pupil grid size: 32 by 32",
            f"Image grid size: {nx} by {ny}",
            f"Center point is: row {ny // 2 + 1}, column {nx // 2}", "Values are not normalized.",
            "", rows(values), "",
        ]
    )  # fmt: skip


def zemax_huygens(values: np.ndarray) -> str:
    ny, nx = values.shape
    return "\n".join(
        [
            "Listing of Huygens PSF Data", "", "File : triplet.zos", "Title: A TRIPLET",
            "Date : 1/2/2024", "", "", "Polychromatic Huygens PSF",
            "0.4861 to 0.6563 um at 0.0000, 0.0000 (deg)", "Data spacing is 0.5000 um.",
            f"Data area is {0.5 * nx} by {0.5 * ny} um.", "Strehl ratio: 0.512",
            "Pupil grid size: 64 by 64", f"Image grid size: {nx} by {ny}",
            f"Center point is: {ny // 2 + 1}, {nx // 2 + 1}",
            "Center coordinates   :  0.00000000E+00,  1.23000000E+00 Millimeters", "",
            "Values are normalized to unity.", "", rows(values).replace("\r", ""),
        ]
    )  # fmt: skip


def codev(values: np.ndarray, options: str = "WVL 0.5876 SSZ 32767 NDA -32768") -> str:
    ny, nx = values.shape
    numbers = [str(round(v)) for v in (values * 32767).ravel()]
    body = "\n".join(" ".join(numbers[i : i + 10]) for i in range(0, len(numbers), 10))
    head = f"! written by a macro\n! second comment\nPSF of field 1\nGRD {nx} {ny} FIL {options}"
    return f"{head}\n{body}\n"


def scene(psf: dict[str, Any], fill: float = 1.0) -> Scene:
    return Scene.model_validate(
        {
            "schema": "nightglass/scene/1", "name": "table", "epoch": "2020-01-01T00:00:00Z",
            "observer": {"kind": "ground", "latitude_deg": 0.0, "longitude_deg": 0.0,
                         "height_m": 0.0},
            "sensor": {
                "shape": [64, 64], "pixel_pitch_um": PITCH_UM, "focal_length_m": 1.0,
                "aperture_m": 0.1, "fill_factor": fill,
                "bandpass": {"kind": "box", "short_nm": 400.0, "long_nm": 900.0},
                "psf": {"kind": "table", **psf},
            },
            "pointing": {"mode": "sidereal", "boresight_ra_deg": 0.0, "boresight_dec_deg": 0.0},
            "exposure": {"integration_s": 1.0},
        }
    )  # fmt: skip


def write(path: Path, text: str, encoding: str = "utf-8") -> str:
    path.write_bytes(text.encode(encoding))
    return str(path)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-8", "utf-8-sig", "latin-1"])
def test_fft_listings_in_every_encoding(tmp_path: Path, encoding: str) -> None:
    values = light(20, 32, 10.0, 15.0)
    path = Path(write(tmp_path / "psf.txt", zemax_fft(values), encoding))
    table = read_psf_table(path)
    assert table.samples == pytest.approx(values, rel=1e-9)
    assert table.spacing_um == pytest.approx(0.422)
    assert table.centre == (10.0, 15.0)  # row 11, column 16, counted from 1


def test_huygens_listings(tmp_path: Path) -> None:
    values = light(24, 24, 12.0, 12.0)
    table = read_psf_table(Path(write(tmp_path / "h.txt", zemax_huygens(values))))
    assert table.samples == pytest.approx(values, rel=1e-9)
    assert (table.spacing_um, table.centre) == (0.5, (12.0, 12.0))
    psf = gather_psf_table(scene({"path": str(tmp_path / "h.txt")}))
    assert psf == sampled(table.samples, 0.05, (12.0, 12.0))


@pytest.mark.parametrize(("unit", "um"), [("mm", 1e3), ("um", 1.0), ("μm", 1.0), ("cm", 1e4)])
def test_units_of_the_spacing(tmp_path: Path, unit: str, um: float) -> None:
    path = write(tmp_path / "psf.txt", zemax_fft(light(8, 8, 4, 4), unit, 0.25))
    assert read_psf_table(Path(path)).spacing_um == pytest.approx(0.25 * um)


def test_codev_grids(tmp_path: Path) -> None:
    values = light(21, 15, 10.0, 7.0)
    path = write(tmp_path / "psf.int", codev(values))
    table = read_psf_table(Path(path))
    assert table.samples / 32767 == pytest.approx(values, abs=2e-5)
    assert (table.spacing_um, table.centre) == (None, None)
    psf = gather_psf_table(scene({"path": path, "sample_um": 0.5}))
    assert psf is not None
    assert psf.spacing_px == pytest.approx(0.05)
    assert psf.centre == (10.0, 7.0)
    holes = codev(values).replace(f" {round(values[10, 7] * 32767)} ", " -32768 ", 1)
    nothing = read_psf_table(Path(write(tmp_path / "holes.int", holes)))
    assert nothing.samples.min() == 0.0


@pytest.mark.parametrize("suffix", ["npy", "fits"])
def test_images(tmp_path: Path, suffix: str) -> None:
    values, path = light(31, 41, 15.0, 20.0), tmp_path / f"psf.{suffix}"
    if suffix == "npy":
        np.save(path, values)
    else:
        from astropy.io import fits

        fits.writeto(path, values)
    psf = gather_psf_table(scene({"path": str(path), "samples_per_px": 16, "light_fraction": 0.9}))
    assert psf == sampled(values, 1.0 / 16.0, "middle", 0.9)
    up = gather_psf_table(scene({"path": str(path), "samples_per_px": 16, "flip_y": True}))
    assert up == sampled(values[::-1], 1.0 / 16.0, "middle")


@pytest.mark.parametrize("flip", [False, True])
def test_the_centre_goes_with_the_rows(tmp_path: Path, flip: bool) -> None:
    """The star of an even table, written about sample n // 2, stands at the source's place."""
    values, path = light(32, 32, 16.0, 16.0), tmp_path / "psf.npy"
    np.save(path, values)
    given = {"path": str(path), "samples_per_px": 4, "flip_y": flip}
    f, zero = np.array([0.01]), np.zeros(1)
    for centre in ("sample", "peak", [16.0, 16.0]):
        psf = gather_psf_table(scene({**given, "centre": centre}))
        assert psf is not None
        for at in ((f, zero), (zero, f)):
            assert np.angle(psf.transfer(*at)[0]) == pytest.approx(0.0, abs=1e-6)
    middle = gather_psf_table(scene({**given, "centre": "middle"}))
    assert middle is not None
    moved = -np.angle(middle.transfer(f, zero)[0]) / (2 * np.pi * 0.01)
    assert moved == pytest.approx(-0.125 if flip else 0.125, abs=1e-6)


def test_scenes_without_a_table_read_nothing() -> None:
    plain = scene({"path": "x.npy", "samples_per_px": 2}).as_dict()
    plain["sensor"]["psf"] = {"kind": "gaussian", "sigma_px": 1.0}
    assert gather_psf_table(Scene.model_validate(plain)) is None


def refused(psf: dict[str, Any]) -> str:
    with pytest.raises(BadInput) as error:
        gather_psf_table(scene(psf))
    return str(error.value)


def test_even_images_must_say_where_the_source_stands(tmp_path: Path) -> None:
    for shape in ((32, 32), (32, 33)):
        np.save(tmp_path / "psf.npy", np.ones(shape))
        text = refused({"path": str(tmp_path / "psf.npy"), "samples_per_px": 4})
        assert "sensor.psf.centre" in text
        assert "half a sample" in text
    odd = {"path": str(tmp_path / "psf.npy"), "samples_per_px": 4}
    assert "names no centre" in refused({**odd, "centre": "file"})
    assert "a place in the table" in refused({**odd, "centre": [40.0, 1.0]})


@pytest.mark.parametrize(
    ("spoil", "what"),
    [(lambda v: v * np.nan, "NaN"), (lambda v: v - 0.5, "negative"), (lambda v: v * 0, "zeros")],
)
def test_tables_without_sense_are_refused(tmp_path: Path, spoil: Any, what: str) -> None:
    np.save(tmp_path / "psf.npy", spoil(light(9, 9, 4, 4)))
    text = refused({"path": str(tmp_path / "psf.npy"), "samples_per_px": 4})
    assert what in text
    assert "sensor.psf" in text


def test_spacing_is_given_once(tmp_path: Path) -> None:
    np.save(tmp_path / "psf.npy", light(9, 9, 4, 4))
    image = {"path": str(tmp_path / "psf.npy")}
    assert "samples_per_px" in refused(image)
    assert "1/256 to 4 pixels" in refused({**image, "sample_um": 100.0})
    listing = {"path": write(tmp_path / "psf.txt", zemax_fft(light(8, 8, 4, 4)))}
    assert "says 0.422 um itself" in refused({**listing, "samples_per_px": 4})


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda t: t.replace("Values are not normalized.", ""), "Values are"),
        (lambda t: t.replace("not normalized", "logarithmic"), "linear intensity"),
        (lambda t: t.replace("Image grid size", "Grid"), "Image grid size"),
        (lambda t: t.replace("0.422 µm.", "0.422 (deg).", 1), "a length"),
        (lambda t: t.replace("8 by 8", "8 by 9"), "72 values"),
        (lambda t: t.replace("8 by 8", "4096 by 4096"), "at most 2048"),
        (lambda t: t.rsplit("\t", 1)[0] + "\tabc", "numbers only"),
        (lambda t: "hello", "OpticStudio"),
        (lambda t: "", "OpticStudio"),
        (lambda t: t[: len(t) // 2], "64 values"),
        (lambda t: "a grid\nGRD 1E400 3 FIL WVL 0.5 SSZ 9\nGRD 3 3 FIL\n", "two whole numbers"),
    ],
)
def test_broken_listings_are_refused(tmp_path: Path, change: Any, what: str) -> None:
    path = write(tmp_path / "psf.txt", change(zemax_fft(light(8, 8, 4, 4))))
    text = refused({"path": path})
    assert what in text
    assert len(text) < 600


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda t: t.replace("FIL", "WFR"), "FIL"),
        (lambda t: t.replace("NDA -32768", "XSC 2.0"), "XSC"),
        (lambda t: t.replace("NDA -32768", "NDA none"), "NDA"),
        (lambda t: t + " 17", "81 values"),
    ],
)
def test_broken_grids_are_refused(tmp_path: Path, change: Any, what: str) -> None:
    path = write(tmp_path / "psf.int", change(codev(light(9, 9, 4, 4))))
    assert what in refused({"path": path, "sample_um": 1.0})


def test_absent_files_are_named(tmp_path: Path) -> None:
    for name in ("no.txt", "no.npy", "no.fits"):
        assert name in refused({"path": str(tmp_path / name), "sample_um": 1.0})
