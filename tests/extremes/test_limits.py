"""What would take too long or too much memory is limited, or refused in one line before work."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
import zarr
from scipy import integrate
from scipy.special import j1

from pipeline.errors import BadInput
from pipeline.execute import truth
from pipeline.execute.sources import place_targets
from pipeline.physics.motion.streak import Path, part_within, piece_counts, pieces
from pipeline.physics.psf import band
from pipeline.physics.psf.pupil import Airy, Blur
from pipeline.plan.needs import Spent, check_memory, predict
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.response.own_paths import exact_path, exact_paths
from pipeline.route.prepare import check_room, prepare, summary_of
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene

PITCH_UM, FOCAL_M, APERTURE_M, WAVE_NM = 10.0, 1.0, 0.1, 600.0  # Q = 0.6 px
MONO = {"kind": "airy", "wavelength_nm": WAVE_NM}


def scene_data(psf: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A body 1e7 m off in the middle of 33 x 33 pixels."""
    return {
        "schema": "nightglass/scene/1", "name": "limits", "epoch": "2019-07-20T09:00:00Z",
        "observer": {"kind": "orbit", "orbit": {"kind": "state", "position_m": [4.2e7, 0, 0],
                                                "velocity_m_s": [0, 3080.0, 0]}},
        "sensor": {"shape": [33, 33], "pixel_pitch_um": PITCH_UM, "focal_length_m": FOCAL_M,
                   "aperture_m": APERTURE_M, "psf": psf, "read_noise_e": 5.0,
                   "bandpass": {"kind": "box", "short_nm": 500, "long_nm": 700}},
        "pointing": {"mode": "target", "target": "t"}, "exposure": {"integration_s": 0.01},
        "targets": [{"name": "t", "orbit": {"kind": "state", "position_m": [4.2e7, 1e7, 0],
                                            "velocity_m_s": [0, 3080.0, 0]},
                     "body": {"kind": "sphere", "diameter_m": 10.0, "albedo": 0.3}}],
        "output": {"layers": ["dn", "targets_e"]},
    } | more  # fmt: skip


def airy_px(x: float, y: float, q: float) -> float:
    """Light in the pixel at (x, y) of a star at the origin: Airy's pattern by quadrature."""

    def at(v: float, u: float) -> float:
        z = np.pi * np.hypot(u, v) / q
        return float(np.pi / (4 * q**2) * (2 * j1(z) / z) ** 2)

    return float(integrate.dblquad(at, x - 0.5, x + 0.5, y - 0.5, y + 0.5, epsrel=1e-4)[0])


def test_a_wing_reaches_no_farther_than_the_frame(tmp_path):
    """One part in a million of a star's light needs no grid of 3 TiB; the corners have theirs."""
    data = scene_data(MONO, accuracy={"flux_fraction": 1e-6, "check_cells": 0})
    plan = prepare(parse_scene(data)).plan
    usual = prepare(parse_scene(scene_data(MONO))).plan.responses.reach_px
    assert plan.responses.reach_px <= usual + math.hypot(33, 33) / 0.9 + 1e-6
    assert predict(plan, None)["worker_memory_mb"] < 1000.0
    render(parse_scene(data), tmp_path / "p", Options("synchronous"))
    light = np.asarray(zarr.open_group(tmp_path / "p" / "cube.zarr", mode="r")["targets_e"])[0]
    q = WAVE_NM * 1e-9 * FOCAL_M / (APERTURE_M * PITCH_UM * 1e-6)
    far = light[1:4, 1:4].sum() / light[16, 16]
    by_hand = sum(airy_px(x - 16.0, y - 16.0, q) for x in (1, 2, 3) for y in (1, 2, 3))
    assert far == pytest.approx(by_hand / airy_px(1e-9, 1e-9, q), rel=0.02)


@pytest.mark.parametrize(
    ("psf", "more", "field"),
    [
        ({"kind": "airy", "aberrations": [{"noll": 11, "rms_nm": 2e4}]}, {}, "sensor.psf"),
        ({"kind": "airy"}, {"jitter": 1e4}, "pointing.attitude"),
        ({"kind": "gaussian", "sigma_px": 1.0, "charge_diffusion_um": 1000.0}, {}, "sensor.psf"),
    ],
)
def test_what_is_too_wide_is_refused_before_bands_are_compared(psf, more, field, monkeypatch):
    def never(*_):
        raise AssertionError("bands were compared")

    monkeypatch.setattr(band, "_Field", never)
    data = scene_data(psf)
    if "jitter" in more:
        data["pointing"]["attitude"] = {"jitter": [
            {"kind": "white", "rms_arcsec": more["jitter"], "low_hz": 1e3, "high_hz": 1e4}]}
    started = time.process_time()
    with pytest.raises(BadInput) as refusal:
        prepare(parse_scene(data))
    assert refusal.value.field.startswith(field)
    assert "\n" not in str(refusal.value)
    assert time.process_time() - started < 5.0


def test_bands_of_blurred_stars_are_compared_on_few_samples(monkeypatch):
    sides = []
    usual = band.scipy.fft.dctn
    monkeypatch.setattr(
        band.scipy.fft, "dctn", lambda a, **how: sides.append(len(a)) or usual(a, **how)
    )
    chosen = band.choose_wavelengths(
        lambda w: Airy(w / 1e-6), Blur(Airy(0.5), jitter_px=50.0), np.array([5e-7, 6e-7]),
        np.ones(2), 1e-5,
    )  # fmt: skip
    assert chosen.error < 1e-5
    assert max(sides) <= 550


def test_more_memory_than_there_is_names_what_takes_it():
    plan = prepare(parse_scene(scene_data(MONO))).plan
    check_memory(plan, None, Spent(), 2000.0)
    with pytest.raises(BadInput, match=r"^sensor\.shape: .* most the 100 MB of memory"):
        check_memory(plan, None, Spent(), 100.0)
    with pytest.raises(BadInput, match=r"^exposure\.integration_s: .*stars move by 1000000 px"):
        check_memory(plan, None, Spent(excursion_px=1e6), 1e5)


def test_wings_of_a_target_that_no_frame_comes_near_cost_nothing():
    """A plan reserves their grids where a target lights a frame, also from beside it."""
    told = []
    for ra_deg, frames in ((90.0, 1), (90.1, 1), (30.0, 1), (30.0, 1000)):
        data = scene_data(MONO, accuracy={"flux_fraction": 1e-6})
        data["pointing"] = {"mode": "sidereal", "boresight_ra_deg": ra_deg, "boresight_dec_deg": 0}
        data["exposure"]["frames"] = frames
        told.append(summary_of(prepare(parse_scene(data)))["predicted"]["worker_memory_mb"])
    inside, beside, away, hardly_looked_at = told
    assert inside == pytest.approx(beside) == pytest.approx(hardly_looked_at)
    assert inside > away + 10.0


def test_processes_share_the_memory_that_is_free(monkeypatch):
    """Some 330 MB each: one process fits in 600 MB, two do not."""
    prepared = prepare(parse_scene(scene_data(MONO)))
    monkeypatch.setattr("pipeline.route.prepare.free_mb", lambda: 600.0)
    check_room(prepared, processes=1)
    with pytest.raises(BadInput, match="300 MB of memory that there are"):
        check_room(prepared, processes=2)


def test_threads_hold_a_tile_each(monkeypatch, tmp_path):
    """Some 150 MB more for each that draws at once, as measured with 2 to 8; one tile has one."""
    data = scene_data(MONO, output={"tile_shape": [2048, 2048]})
    data["sensor"]["shape"] = [2048, 2048]
    monkeypatch.setattr("pipeline.route.prepare.free_mb", lambda: 2000.0)
    for frames, fit in ((1, 64), (2, 64), (100, 4)):
        data["exposure"]["frames"] = frames
        check_room(prepare(parse_scene(data)), threads=fit)
    with pytest.raises(BadInput, match=r"^--workers: 64 .* fewer threads"):
        check_room(prepare(parse_scene(data)), threads=64)
    assert [Options(s, 5).threads for s in ("threads", "synchronous", "processes")] == [5, 1, 1]
    with pytest.raises(BadInput, match=r"^--workers: 64 "):
        render(parse_scene(data), tmp_path / "p", Options("threads", 64))



@pytest.mark.parametrize("scheduler", ["synchronous", "tcp://127.0.0.1:1"])
def test_a_render_beyond_the_memory_draws_nothing(tmp_path, scheduler):
    """Nor is a scheduler asked whose workers' memory was named."""
    asked = Options(scheduler, most_memory_mb=100.0)
    with pytest.raises(BadInput, match="MB of memory that there are, not"):
        render(parse_scene(scene_data(MONO)), tmp_path / "p", asked)
    assert not (tmp_path / "p").exists()


def test_pieces_near_a_box_are_those_of_the_whole_path():
    """None that touches the box is missing, and the others are the same, to the last bit."""
    rng = np.random.default_rng(3)
    for _ in range(200):
        path = Path(*np.cumsum(rng.normal(0, 400, (2, 4)), axis=1), rng.dirichlet([1, 1, 1]))
        low = rng.uniform(-500, 500, 2)
        box = (low[0], low[0] + 100, low[1], low[1] + 50)
        every = pieces(path)
        near = pieces(path, near=box)
        held = {(x, y, share) for x, y, _, share in near}
        assert held <= {(x, y, share) for x, y, _, share in every}
        for x, y, piece, share in every:
            at = np.linspace(0, 1, 300)
            px, py = x + np.interp(at, [0, 1], piece.x_px[[0, -1]]), y + np.interp(
                at, [0, 1], piece.y_px[[0, -1]])
            inside = (px > box[0]) & (px < box[1]) & (py > box[2]) & (py < box[3])
            if inside.any() and piece.segments == 1:
                assert (x, y, share) in held
        assert sum(n for *_, n in piece_counts(path)) == len(every)


def test_the_part_of_a_path_in_a_box_has_its_light():
    path = Path(np.array([-100.0, 0.0, 100.0]), np.zeros(3), np.array([0.25, 0.75]))
    part, share = part_within(path, (-20.0, 40.0, -1.0, 1.0))
    assert share == pytest.approx(0.2 * 0.25 + 0.4 * 0.75)
    assert part.x_px == pytest.approx([-20.0, 0.0, 40.0])
    assert part.weight * share == pytest.approx([0.05, 0.3])
    one = Path(np.array([-100.0, 100.0]), np.zeros(2), np.ones(1))
    assert part_within(one, (-20.0, 30.0, -1.0, 1.0))[1] == pytest.approx(0.25)
    assert part_within(path, (-20.0, 40.0, 5.0, 9.0)) is None
    assert part_within(path, (-200.0, 200.0, -1.0, 1.0)) == (path, 1.0)


def far_scene() -> dict[str, Any]:
    """The body drifts by some 6000 px, half a degree off the frame."""
    data = scene_data({"kind": "gaussian", "sigma_px": 1.0}, exposure={"integration_s": 2.0})
    data["pointing"] = {"mode": "sidereal", "boresight_ra_deg": 90.5, "boresight_dec_deg": 0.0}
    data["targets"][0]["orbit"]["velocity_m_s"] = [0, 3080.0, 3e5]
    return data


def test_targets_whose_light_reaches_no_pixel_are_not_swept(monkeypatch):
    plan = prepare(parse_scene(far_scene())).plan
    g = plan_geometry(plan.scene, np.zeros(1, np.int64), plan.dut1_s)
    [target] = place_targets(plan, g, everywhere=True)
    assert target.path.length_px > 1000.0

    def never(*_):
        raise AssertionError("a target off the frame was swept")

    monkeypatch.setattr(truth, "swept_core", never)
    assert truth.target_truth(plan, g)["snr"] == [0.0]


def test_snr_of_a_long_path_counts_its_equal_pieces(monkeypatch):
    """Each different piece once: as all of them together, but for the pixels that two share."""
    plan = prepare(parse_scene(far_scene())).plan
    path = Path(np.array([-1000.0, 1000.0]), np.array([-300.0, 300.0]), np.ones(1))
    at = np.array([1e6]), np.zeros(1), np.zeros(1)
    whole = truth.matched_snr(plan, path, *at)
    monkeypatch.setattr(truth, "MOST_PIECES", 2)
    assert truth.matched_snr(plan, path, *at) == pytest.approx(whole, rel=0.03)


def test_same_paths_of_stars_worked_out_together():
    """To the last bit, through a distortion and with a roll; and in the order asked for."""
    data = scene_data({"kind": "gaussian", "sigma_px": 1.0})
    data["sensor"]["distortion"] = {"kind": "radial", "k1": -0.05, "p1": 1e-4}
    data["pointing"] = {"mode": "rate", "boresight_ra_deg": 90.5, "boresight_dec_deg": 80.0,
                        "rate_ra_arcsec_s": 300.0, "rate_dec_arcsec_s": 50.0,
                        "roll_rate_deg_s": 5.0}  # fmt: skip
    plan = prepare(parse_scene(data)).plan
    g = plan_geometry(plan.scene, np.zeros(1, np.int64), plan.dut1_s)
    x, y = np.random.default_rng(1).uniform(-40, 70, (2, 33))
    together = list(exact_paths(plan.camera, g, x, y, True))
    assert together == [
        exact_path(plan.camera, g, float(a), float(b), True) for a, b in zip(x, y, strict=True)
    ]


def moffat_table(per_px: int, side: int) -> np.ndarray:
    """Light of seeing, FWHM 2.5 px, cut off where it is not 0 yet."""
    at = (np.arange(side) - (side - 1) / 2) / per_px
    return (1.0 + (at[:, None] ** 2 + at**2) / 6.0) ** -3.0


def pixels_of_a_gaussian(side: int) -> np.ndarray:
    """Pixels, one sample each, of sigma 1 px."""
    at = np.arange(side + 1) - side / 2
    one = np.diff([0.5 * math.erf(x / 2**0.5) for x in at])
    return np.outer(one, one)


@pytest.mark.parametrize(
    ("table", "per_px", "collected", "told"),
    [
        (moffat_table(4, 81), 4, False, None),
        (moffat_table(2, 51), 2, False, None),
        (pixels_of_a_gaussian(25), 1, True, "core_ends"),
        (np.ones((5, 5)), 5, False, "sensor.psf: 'a table with 0.0"),
    ],
    ids=["fine", "noisier", "coarse", "box"],
)
def test_what_rings_between_the_samples_of_a_table_is_told(
    tmp_path, table, per_px, collected, told
):
    """Band-limited samples have no end: their cores' end is measured, and found as stated."""
    np.save(tmp_path / "psf.npy", table)
    psf = {"kind": "table", "path": str(tmp_path / "psf.npy"), "samples_per_px": per_px,
           "includes_pixel": collected}  # fmt: skip
    data = scene_data(psf, accuracy={"check_cells": 4})
    data["targets"][0]["body"]["diameter_m"] = 100.0
    if told:
        with pytest.raises(BadInput, match=told):
            prepare(parse_scene(data))
        if told != "core_ends":
            return
    report = render(parse_scene(data | {"accept": ["error"]}), tmp_path / "p")["errors"]
    assert report["as_stated"]
    assert 0.0 < report["achieved_error_sigma"] <= report["bound_of_all_approximations_sigma"]
    assert (report["achieved_error_sigma"] > 0.05) == (told == "core_ends")


@pytest.mark.parametrize(("major_px", "fits"), [(2.0, True), (50.0, False)])
def test_an_image_far_longer_than_wide(major_px, fits):
    """Of 50 px by 0.05 px it took 24 GB to plan; its memory is in the forecast."""
    psf = {"kind": "gaussian", "sigma_px": major_px, "sigma_minor_px": 0.05}
    if fits:
        plan = prepare(parse_scene(scene_data(psf))).plan
        assert predict(plan, None)["worker_memory_mb"] > 350.0
        return
    with pytest.raises(BadInput, match="64 samples a pixel over 401"):
        prepare(parse_scene(scene_data(psf)))
