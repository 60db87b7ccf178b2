"""Images of the sensor's terms: the dark image in any unit, by its scale."""

from __future__ import annotations

import numpy as np
import psutil
import pytest
from astropy.io import fits

from pipeline.errors import BadInput
from pipeline.execute.truth import target_truth
from pipeline.inputs import memory
from pipeline.inputs.sensor.sensor import gather_sensor_maps
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.route.prepare import prepare
from pipeline.route.run import render
from pipeline.spec.load import InvalidScene, parse_scene
from pipeline.store.cube import open_cube

SCENE = {
    "schema": "nightglass/scene/1", "name": "dark", "epoch": "2015-07-02T12:00:00Z",
    "observer": {"kind": "fixed", "position_au": [0.9, 0.4, 0.1]},
    "sensor": {
        "shape": [32, 48], "pixel_pitch_um": 10.0, "focal_length_m": 0.4, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0}, "read_noise_e": 5.0,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 101.0, "boresight_dec_deg": 30.0},
    "exposure": {"integration_s": 20.0}, "output": {"layers": ["dn", "dark_e"]},
}  # fmt: skip


def scene(**sensor):
    return parse_scene(SCENE | {"sensor": SCENE["sensor"] | sensor})


def test_a_dark_image_in_other_units(tmp_path):
    """A master dark of 300 s in DN at 1.5 e-/DN: scale 1.5 / 300 e-/s each."""
    dark_dn = np.random.default_rng(2).uniform(0, 900, (32, 48))
    np.save(tmp_path / "dark.npy", dark_dn)
    wish = {"dark_e_per_s": str(tmp_path / "dark.npy"), "dark_scale": 1.5 / 300.0}
    render(scene(**wish), tmp_path / "run")
    drawn = open_cube(tmp_path / "run")["dark_e"].values[0]
    assert np.allclose(drawn, dark_dn * 0.005 * 20.0, rtol=1e-6)


@pytest.mark.parametrize(
    ("scale", "told"), [(1.0, False), (0.3, False), (100.0, True), (3e-4, True)]
)
def test_the_plan_remarks_on_a_flat_far_from_one(tmp_path, scale, told):
    """An image in percent or in counts is not refused, its mean is told; of a number nothing."""
    image = np.random.default_rng(3).uniform(0.9, 1.1, (32, 48)) * scale
    np.save(tmp_path / "flat.npy", image)
    remarks = prepare(scene(flat=str(tmp_path / "flat.npy"))).plan.remarks
    assert [f"flat.npy is {image.mean():.3g}:" in r for r in remarks if "sensor.flat" in r] == (
        [True] * told
    )
    assert not any("sensor.flat" in r for r in prepare(scene(flat=scale)).plan.remarks)


@pytest.mark.parametrize(
    "wish", [{"dark_scale": 2.0}, {"dark_scale": 0.0, "dark_e_per_s": "d.npy"}]
)
def test_limits_a_scale_is_of_an_image(wish):
    with pytest.raises(InvalidScene, match=r"sensor\.dark_scale"):
        scene(**wish)


def test_limits_of_images(tmp_path):
    """An image may hold what a number may; a flat's dead pixels too, but not dead ones alone."""
    plain = np.full((32, 48), 1.0)
    for key, value, word in (
        ("gain_e_per_dn", 1e12, "1e-09 to 1e\\+06"),
        ("gain_e_per_dn", 0.0, "1e-09 to 1e\\+06"),
        ("bias_dn", -1e300, "-1e\\+19 to 2e\\+19"),
        ("flat", -0.1, "0 to 1000"),
    ):
        image = plain.copy()
        image[3, 4] = value
        np.save(tmp_path / "image.npy", image)
        with pytest.raises(BadInput, match=rf"sensor\.{key}.*{word}"):
            gather_sensor_maps(scene(**{key: str(tmp_path / "image.npy")}))
    np.save(tmp_path / "image.npy", 0.0 * plain)
    with pytest.raises(BadInput, match="above 0"):
        gather_sensor_maps(scene(flat=str(tmp_path / "image.npy")))


def test_snr_counts_the_flat():
    """A flat of 0.25 sees what a quantum efficiency of a quarter sees: source and sky."""
    target = {
        "name": "ball", "body": {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.3},
        "orbit": {"kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3075.0, 0]},
    }  # fmt: skip
    observer = {"kind": "orbit", "orbit": {"kind": "state", "position_m": [4.1e7, 0, 0],
                                           "velocity_m_s": [0, 3118.0, 0]}}  # fmt: skip
    found = []
    for wish in ({"flat": 0.25}, {"quantum_efficiency": 0.25}):
        data = SCENE | {
            "targets": [target], "observer": observer, "sensor": SCENE["sensor"] | wish,
            "pointing": {"mode": "target", "target": "ball"},
            "background": {"uniform_mag_arcsec2": 16.0}, "exposure": {"integration_s": 1e-3},
        }  # fmt: skip
        plan = prepare(parse_scene(data)).plan
        g = plan_geometry(plan.scene, np.zeros(1, np.int64), plan.dut1_s)
        found.append(float(target_truth(plan, g)["snr"][0]))
    assert found[0] == pytest.approx(found[1], rel=1e-3)
    assert found[0] > 1.0


@pytest.mark.parametrize(
    ("key", "least", "most"),
    [("flat", 0.0, 1e3), ("dark_e_per_s", 0.0, 1e12), ("read_noise_e", 0.0, 1e9),
     ("gain_e_per_dn", 1e-9, 1e6), ("bias_dn", -1e19, 2e19)],
)  # fmt: skip
def test_ends_of_what_a_pixel_may_hold(tmp_path, key, least, most):
    """One pixel at an end among others is taken, one a little beyond is refused, either way."""
    image, path = np.full((32, 48), 1.0), tmp_path / "image.npy"
    for end, beyond in ((least, -1e-9 + least * (1 + 1e-9)), (most, most * (1 + 1e-9))):
        image[31, 47] = end
        np.save(path, image)
        assert getattr(gather_sensor_maps(scene(**{key: str(path)})), key)[31, 47] == end
        image[31, 47] = beyond
        np.save(path, image)
        with pytest.raises(BadInput, match=rf"sensor\.{key}"):
            gather_sensor_maps(scene(**{key: str(path)}))


@pytest.mark.parametrize("damage", ["checksum", "cut"])
def test_a_packed_image_that_is_damaged_is_refused(tmp_path, damage):
    """Also behind the last pixel, where astropy no longer reads."""
    path = tmp_path / "flat.fits.gz"
    fits.PrimaryHDU(np.random.default_rng(1).uniform(0.9, 1.1, (32, 48))).writeto(path)
    assert gather_sensor_maps(scene(flat=str(path))).flat.shape == (32, 48)
    whole = bytearray(path.read_bytes())
    whole[-6] ^= 1
    path.write_bytes(whole if damage == "checksum" else whole[:-9])
    with pytest.raises(BadInput, match=r"sensor\.flat: .*a readable FITS image"):
        gather_sensor_maps(scene(flat=str(path)))


def test_an_image_of_no_known_type_of_number_is_refused(tmp_path):
    path = tmp_path / "flat.fits"
    fits.PrimaryHDU(np.ones((32, 48))).writeto(path)
    path.write_bytes(path.read_bytes().replace(b"                 -64", b"                   7", 1))
    with pytest.raises(BadInput, match=r"sensor\.flat: .*a readable FITS image; KeyError: 7"):
        gather_sensor_maps(scene(flat=str(path)))


def test_memory_is_what_machine_and_container_leave(tmp_path, monkeypatch):
    """The lesser of both, with what the process holds already."""
    machine = psutil.virtual_memory().available
    own = psutil.Process().memory_info().rss
    monkeypatch.setattr(memory, "GROUP", tmp_path)
    monkeypatch.setattr(memory, "OWN_GROUP", tmp_path / "own")
    assert memory.free_mb() == pytest.approx((machine + own) / 1e6, rel=0.2)
    for most, held, free in (("3000000000", "1000000000", 2e9), ("500000000", "900000000", 0.0),
                             ("400000000", "", 4e8)):  # fmt: skip
        (tmp_path / "memory.max").write_text(most + "\n")
        (tmp_path / "memory.current").write_text(held + "\n")
        assert memory.free_mb() == pytest.approx((min(free, machine) + own) / 1e6, abs=30.0)
    (tmp_path / "memory.stat").write_text("anon 5\ninactive_file 150000000\nactive_file 50000000\n")
    for held, free in (("300000000", 3e8), ("100000000", 4e8)):  # files are given back
        (tmp_path / "memory.current").write_text(held + "\n")
        assert memory.free_mb() == pytest.approx((min(free, machine) + own) / 1e6, abs=30.0)
    step = tmp_path / "job" / "step"
    step.mkdir(parents=True)
    (tmp_path / "own").write_text("1:name=systemd:/other\n0::/job/step\n")
    for group, free in ((step, 1e8), (step.parent, 5e7)):  # a job's step, and the job itself
        (group / "memory.max").write_text(f"{free:.0f}\n")
        assert memory.free_mb() == pytest.approx((free + own) / 1e6, abs=30.0)
    for group in (step, step.parent):
        (group / "memory.max").write_text("max\n")
    (tmp_path / "memory.max").write_text("max\n")
    assert memory.free_mb() == pytest.approx((machine + own) / 1e6, rel=0.2)


@pytest.mark.parametrize(
    ("name", "wrong", "right"),
    [
        ("dark_e_per_s", "adu", "electron / s"),
        ("read_noise_e", "ADU", "electrons"),
        ("gain_e_per_dn", "adu/electron", "electron/ADU"),
        ("bias_dn", "electron", "DN"),
    ],
)
def test_another_unit_that_a_file_declares_is_told(tmp_path, name, wrong, right):
    """The image's own BUNIT, where it is not what the term is read as."""
    image = np.full((32, 48), 3.0)

    def told(unit: str, **more: float) -> list[str]:
        hdu = fits.PrimaryHDU(image)
        if unit:
            hdu.header["BUNIT"] = unit
        hdu.writeto(tmp_path / "image.fits", overwrite=True)
        wish = {"bias_dn": 100.0, name: str(tmp_path / "image.fits"), **more}
        return [w for w in prepare(scene(**wish)).plan.warnings if "BUNIT" in w]

    (warning,) = told(wrong)
    assert warning.startswith(f"sensor.{name}: ")
    assert repr(wrong) in warning
    assert told(right) == told("") == []
    if name == "dark_e_per_s":
        assert told(wrong, dark_scale=0.005) == []
