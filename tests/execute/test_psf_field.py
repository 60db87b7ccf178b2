"""Stars, targets and bodies drawn by responses over the field: places, flux, tiles, crowds, SNR."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import pipeline.execute.blocks
import pipeline.plan.response.responses
from catalog_tools.ingest.ingest import ingest
from pipeline.arrays import FrameStars
from pipeline.errors import BadInput
from pipeline.execute import check, tables
from pipeline.execute.blocks import render_block
from pipeline.execute.light import _draw_path, draw_exact, draw_stars, draw_targets
from pipeline.execute.sources import FrameTarget, place_targets, streaks
from pipeline.execute.tables import ContentCache
from pipeline.execute.truth import matched_snr
from pipeline.physics.drawing.direct import draw_direct
from pipeline.physics.motion.streak import LONGEST_PIECE_PX, POINT, Path, in_few_runs
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.response import compact_core
from pipeline.physics.targets.disc import Sphere
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.stars import engines
from pipeline.plan.tiles import Tile
from pipeline.route.prepare import prepare
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube
from tests.slow import slow

IFOV_DEG, RA_DEG, DEC_DEG, SIDE = 2.0 / 3600.0, 80.0, 20.0, 320
ROUND = {"kind": "gaussian", "sigma_px": 1.1}
CORNERS = [[{"kind": "gaussian", "sigma_px": 0.9 + 0.2 * i + 0.1 * j} for j in range(2)]
           for i in range(2)]  # fmt: skip
NINE = [[{"kind": "gaussian", "sigma_px": 0.9 + 0.2 * i + 0.1 * j} for j in range(3)]
        for i in range(3)]  # fmt: skip
# A defocus that tilts across the field, and coma at its far end: with wings.
TILTED = [[{"kind": "airy", "wavelengths": 1, "defocus_um": 20.0 * i,
            "aberrations": [{"noll": 8, "rms_waves": 0.08 * j}]} for j in range(2)]
          for i in range(2)]  # fmt: skip


def field(psfs):
    rows, columns = (([160.0], [0.0, 319.0], [0.0, 160.0, 319.0])[n - 1]
                     for n in (len(psfs), len(psfs[0])))  # fmt: skip
    return {"kind": "field", "rows_px": rows, "columns_px": columns, "psfs": psfs}


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory):
    """400 stars over and around the frame, G 11 to 16."""
    folder = tmp_path_factory.mktemp("field")
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-0.6, 0.6, (2, 400)) * SIDE * IFOV_DEG
    g = rng.uniform(11.0, 16.0, 400)
    ra = RA_DEG + x / np.cos(np.radians(DEC_DEG + y))
    rows = ["source_id,ref_epoch,ra,dec,parallax,pmra,pmdec,radial_velocity,phot_g_mean_mag,"
            "phot_bp_mean_mag,phot_rp_mean_mag"]  # fmt: skip
    rows += [
        f"{i + 1},2015.5,{ra[i]:.12f},{DEC_DEG + y[i]:.12f},1,0,0,,{g[i]:.6f},"
        f"{g[i] + 0.4:.6f},{g[i] - 0.6:.6f}"
        for i in range(400)
    ]
    (folder / "stars.csv").write_text("\n".join(rows) + "\n")
    return str(ingest([folder / "stars.csv"], folder / "catalogue").catalogue.path)


def scene(catalogue, psf, streak_px=0.0, **more):
    data = {
        "schema": "nightglass/scene/1", "name": "field", "epoch": "2019-12-01T08:00:00Z",
        "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
        "sensor": {
            "shape": [SIDE, SIDE], "pixel_pitch_um": 9.0, "aperture_m": 0.08, "obscuration": 0.3,
            "focal_length_m": 9e-6 / np.radians(IFOV_DEG), "psf": psf, "read_noise_e": 5.0,
            "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900}, "adc_bits": 20,
        },
        "pointing": {
            "mode": "rate", "boresight_ra_deg": RA_DEG, "boresight_dec_deg": DEC_DEG,
            "rate_ra_arcsec_s": 0.8 * streak_px, "rate_dec_arcsec_s": 0.6 * streak_px,
        },
        "exposure": {"integration_s": 2.0}, "stars": {"catalogue": catalogue},
        "output": {"layers": ["dn", "stars_e"]},
    }  # fmt: skip
    return parse_scene(data | more)


def planned(catalogue, psf, streak_px=0.0):
    plan = prepare(scene(catalogue, psf, streak_px)).plan
    return plan, plan_geometry(plan.scene, np.zeros(1, np.int64), 0.0)


def stars_at(x, y, light):
    n = len(x)
    x, y, light = (np.asarray(v, float) for v in (x, y, light))
    zero = np.zeros(n)
    return FrameStars(np.arange(n), x, y, light, zero, zero, zero, np.zeros(n, np.uint8),
                      np.zeros(n, np.uint8), np.ones(n))  # fmt: skip


def drawn(planned, stars, tile=None):
    """Light of hand-placed stars in a part of the frame."""
    plan, g = planned
    whole = Tile(0, 0, 0, 0, SIDE, SIDE)
    blocks = [render_block(plan, g, whole, [stars])] if plan.responses.spacing_px else []
    return draw_stars(plan, g, tile or whole, [stars], blocks)


def with_one(planned, blur):
    """The same plan where one response of the field serves all of it."""
    plan, g = planned
    return replace(plan, responses=replace(plan.responses, field=None, blur=blur)), g


PLACES = [10.3, 150.0, 318.6], [300.2, 33.7, 20.5], [1e4, 3e4, 2e4]


def test_a_constant_field_is_the_single_response(catalogue):
    stars = stars_at(*PLACES)
    one = drawn(planned(catalogue, ROUND, 8.0), stars)
    same = drawn(planned(catalogue, field([[ROUND] * 3] * 2), 8.0), stars)
    assert np.abs(same - one).max() <= 1e-12 * one.max()
    turned = [[ROUND | {"sigma_minor_px": 1.1, "angle_deg": 10.0 * (i + 2 * j)} for j in range(2)]
              for i in range(2)]  # fmt: skip
    made = planned(catalogue, field(turned), 8.0)
    assert len(made[0].responses.blurs) == 4
    assert np.abs(drawn(made, stars) - one).max() <= 2e-7 * one.max()  # float32 tables


@pytest.mark.parametrize("psfs", [CORNERS, TILTED], ids=["gaussian", "airy"])
def test_a_star_at_a_place_is_its_own_and_between_two_their_mean(psfs, catalogue):
    made = planned(catalogue, field(psfs))
    blurs = made[0].responses.blurs
    corner = stars_at([319.0], [0.0], [1e5])
    image = drawn(made, corner)
    assert np.array_equal(image, drawn(with_one(made, blurs[1]), corner))
    middle = stars_at([159.5], [0.0], [1e5])
    mean = 0.5 * sum(drawn(with_one(made, blurs[k]), middle) for k in (0, 1))
    assert np.abs(drawn(made, middle) - mean).max() <= 1e-12 * mean.max()
    off = stars_at([159.5], [400.0], [1e5])
    rows = made[0].responses.blurs[2:]
    mean = 0.5 * sum(drawn(with_one(made, b), off) for b in rows)
    assert np.abs(drawn(made, off) - mean).max() <= 1e-12 * max(mean.max(), 1e-3)


def test_all_light_is_drawn_at_every_place(catalogue):
    made = planned(catalogue, field(CORNERS))
    rng = np.random.default_rng(1)
    for x, y in rng.uniform(60.0, 260.0, (8, 2)):
        image = drawn(made, stars_at([x], [y], [1e5]))
        assert image.sum() == pytest.approx(1e5, rel=2e-7)
        assert image.min() >= -1e-6 * image.max()


@pytest.mark.parametrize(
    "psfs",
    [pytest.param(CORNERS, id="gaussian"), slow(TILTED, id="airy")],
)
def test_same_bits_in_any_part(psfs, catalogue):
    made = planned(catalogue, field(psfs), 12.0)
    rng = np.random.default_rng(2)
    stars = stars_at(*rng.uniform(-20.0, 340.0, (2, 60)), 10.0 ** rng.uniform(1.0, 4.5, 60))
    whole = drawn(made, stars)
    for y0, x0, rows, columns in ((0, 0, 100, 320), (100, 37, 220, 200), (159, 159, 3, 3)):
        part = drawn(made, stars, Tile(0, 0, y0, x0, rows, columns))
        assert np.array_equal(part, whole[y0 : y0 + rows, x0 : x0 + columns])


def test_exact_drawing_and_tables_agree(catalogue):
    plan, g = planned(catalogue, field(CORNERS))
    exact = tuple(replace(c, phases=0) for c in plan.responses.classes)
    stars = stars_at(*PLACES)
    one = drawn((plan, g), stars)
    other = drawn((replace(plan, responses=replace(plan.responses, classes=exact)), g), stars)
    assert np.abs(one - other).max() <= plan.responses.budget_e + 1e-6 * one.max()


@pytest.mark.parametrize("psfs", [CORNERS, slow(TILTED)])
def test_products_have_small_errors_and_the_same_bits(psfs, catalogue, tmp_path, monkeypatch):
    """Stamps and crowds of streaks in common, tiles of two shapes; the reference of the check draws
    the field too."""
    images = []
    monkeypatch.setattr(engines, "CHEAPER", 0.0)  # points along own paths have their own responses
    for crowd in (False, True):
        if crowd:
            monkeypatch.setattr(pipeline.plan.response.responses, "_spectral_from", lambda *_: 1)
            monkeypatch.setattr(pipeline.execute.blocks, "BLOCK_PX", 256)
        digests = set()
        for k, tile in enumerate(([320, 320], [256, 320])):
            output = {"layers": ["dn", "stars_e"], "tile_shape": tile}
            made = scene(catalogue, field(psfs), 12.0, output=output)
            path = tmp_path / f"{crowd}{k}"
            report = render(made, path, Options("synchronous"))
            digests.add(report["content_digest"])
            assert 3 <= report["errors"]["windows"] <= 6  # one or two of each cell
            assert report["errors"]["achieved_error_sigma"] < 0.05
        assert len(digests) == 1
        images.append(open_cube(path)["stars_e"].values[0].astype(float))
    noise = np.sqrt(25.0 + images[0])
    assert not np.array_equal(*images)
    assert (np.abs(images[0] - images[1]) / noise).max() < 0.05


def test_crowds_at_the_edges_of_a_block_take_the_responses_beyond(catalogue, monkeypatch):
    """Blocks that end 12 px beyond the middle place of three; in stamps each of four has a part."""
    stamps = planned(catalogue, field(NINE))
    monkeypatch.setattr(pipeline.plan.response.responses, "_spectral_from", lambda *_: 1)
    plan, g = planned(catalogue, field(NINE))
    for start, at in ((0, 168.0), (148, 151.0)):
        stars = stars_at([at], [at], [5e3])
        wanted = drawn(stamps, stars)[start : start + 172, start : start + 172]
        block = render_block(plan, g, Tile(0, 0, start, start, 172, 172), [stars])
        assert block.in_crowd(plan, stars, streaks(plan, g)).all()
        assert np.abs(block.crowd_e - wanted).max() < 1e-3 * wanted.max()


def test_bodies_and_targets_are_drawn_by_the_responses_around_them(tmp_path):
    from tests.execute import test_extended as discs  # the scene of a resolved sphere

    rows = [[{"kind": "gaussian", "sigma_px": s} for s in (0.8, 1.6)]]
    psf = {"kind": "field", "rows_px": [0.0], "columns_px": [0.0, 399.0], "psfs": rows}
    for diameter in (0.02, 400.0):
        images, places = [], []
        for k, one in enumerate((rows[0][0], rows[0][1], psf)):
            image, truth, report = discs.drawn(tmp_path / f"{diameter}{k}", diameter, one)
            images.append(image)
            places.append(truth["x_px"])
            assert report["errors"]["achieved_error_e"] < 2e-5 * image.max()
        share = places[2] / 399.0
        mixed = (1.0 - share) * images[0] + share * images[1]
        assert 0.4 < share < 0.6
        assert np.abs(images[2] - mixed).max() <= 1e-5 * mixed.max()


def test_the_reference_sweeps_a_body_by_every_response_along_its_own_path(catalogue):
    """Not along the fewer runs that serve its wings: four that are alike are as one."""
    turned = [[ROUND | {"sigma_minor_px": 1.1, "angle_deg": 10.0 * (i + 2 * j)} for j in range(2)]
              for i in range(2)]  # fmt: skip
    path = Path(np.array([-9.0, 0.0, 9.0]), np.array([0.0, 0.035, 0.0]), np.full(2, 0.5))
    body = FrameTarget(0, 160.2, 159.7, path, 1e5, 4.0, Sphere(4.0, 1.0, 0.5))
    window, images = Tile(0, 0, 144, 144, 32, 32), np.zeros((2, 32, 32))
    for image, psf in zip(images, (ROUND, field(turned)), strict=True):
        check._add_body(planned(catalogue, psf)[0], image, window, body)
    assert len(in_few_runs(path, check.WING_BEND_PX).weight) < len(path.weight)
    assert images[0].sum() == pytest.approx(1e5, rel=1e-3)
    assert np.abs(images[1] - images[0]).max() <= 1e-11 * images[0].max()


def test_each_response_is_made_once_where_none_is_kept(catalogue, monkeypatch):
    """Bright stars at their exact places: the cores of sharp responses may be too large to keep."""
    plan, _ = planned(catalogue, field(CORNERS))
    rng = np.random.default_rng(3)
    x, y, light = *rng.uniform(60.0, 260.0, (2, 12)), np.full(12, 1e5)
    at, whole = np.zeros((SIDE, SIDE)), Tile(0, 0, 0, 0, SIDE, SIDE)
    made: list[Blur] = []
    monkeypatch.setattr(tables, "_CACHE", ContentCache(1.0))

    def make(blur, radius_px):
        made.append(blur)
        return compact_core(blur, radius_px)

    monkeypatch.setattr(tables, "compact_core", make)
    draw_exact(plan, at, whole, 0, POINT, x, y, light)
    assert len(made) == len(CORNERS) * len(CORNERS[0])
    assert at.sum() == pytest.approx(light.sum(), rel=1e-4)


def test_snr_between_places_is_between_theirs(catalogue):
    plan, _ = planned(catalogue, field(CORNERS))
    light, x = np.full(5, 500.0), np.linspace(0.0, 319.0, 5)
    snr = matched_snr(plan, POINT, light, x, np.zeros(5))
    ends = [
        matched_snr(with_one((plan, None), b)[0], POINT, light[:1], x[:1], x[:1])[0]
        for b in plan.responses.blurs[:2]
    ]
    np.testing.assert_allclose(snr, np.linspace(*ends, 5), rtol=1e-12)
    assert ends[0] > ends[1]


def test_tables_from_files_at_their_places(catalogue, tmp_path):
    """Each file once; a mistake in one is told of its place."""
    at = np.arange(-40, 41) / 8.0
    for k, sigma in enumerate((0.9, 1.2)):
        values = np.exp(-0.5 * (at[:, None] ** 2 + at**2) / sigma**2)
        np.save(tmp_path / f"{k}.npy", values)
    np.save(tmp_path / "even.npy", values[1:])
    tables = [{"kind": "table", "path": str(tmp_path / f"{k}.npy"), "samples_per_px": 8}
              for k in (0, 1)]  # fmt: skip
    made = planned(catalogue, field([[tables[0], ROUND, tables[1]]]))
    plain = planned(catalogue, field([[{"kind": "gaussian", "sigma_px": s}
                                       for s in (0.9, 1.1, 1.2)]]))  # fmt: skip
    stars = stars_at(*PLACES)
    images = drawn(made, stars), drawn(plain, stars)
    assert np.abs(images[0] - images[1]).max() <= 1e-4 * images[1].max()
    even = tables[0] | {"path": str(tmp_path / "even.npy")}
    for psf, name in (
        (even, "sensor.psf.psfs.0.1.centre: "),
        (tables[0] | {"path": "none.npy"}, "sensor.psf.psfs.0.1.path: "),
        ({"kind": "airy", "wavelengths": 1, "defocus_um": 1e5}, "sensor.psf.psfs.0.1.aberrations"),
    ):
        with pytest.raises(BadInput) as caught:
            prepare(scene(catalogue, field([[ROUND, psf]])))
        assert str(caught.value).startswith(name)


def test_a_streak_takes_the_responses_along_it(catalogue, tmp_path, monkeypatch):
    """As the same exposure in 16 parts does: of stars with streaks in common and along their own
    paths. By the responses of its middle a streak of 60 px was 0.3 sigma off at its ends."""
    streaked = scene(catalogue, field(CORNERS), 60.0)
    parts = {"integration_s": 0.125, "frames": 16, "cadence_s": 0.125}
    layers = []
    in_parts = scene(catalogue, field(CORNERS), 60.0, exposure=parts, accept=["error"])
    for name, made in (("own", streaked), ("one", streaked), ("parts", in_parts)):
        monkeypatch.setattr(engines, "CHEAPER", 0.5 if name == "own" else 0.0)
        render(made, tmp_path / name, Options("synchronous"))
        layers.append(open_cube(tmp_path / name).stars_e.values.astype(float).sum(axis=0))
    plan = prepare(streaked).plan
    noise = np.sqrt(layers[2] + plan.facts.sigma_floor_e**2)
    found = [(np.abs(layer - layers[2]) / noise).max() for layer in layers[:2]]
    assert max(found) < 0.03
    assert not [w for w in plan.warnings if "responses of their middle" in w]


def test_a_body_takes_the_responses_along_its_path(catalogue, monkeypatch):
    """A disc swept through the field, against discs at rest all along: in cores and wings."""
    for psfs, most in ((CORNERS, 2e-5), (TILTED, 2e-4)):
        made = planned(catalogue, field(psfs))
        along, share = np.polynomial.legendre.leggauss(60)
        body, light = Sphere(2.0, 1.0, 0.5), 2e5
        path = Path(np.array([-6.0, 6.0]), np.array([-8.0, 8.0]), np.ones(1))
        swept = [FrameTarget(0, 160.3, 158.9, path, light, 2.0, body)]
        places = zip(160.3 + 6.0 * along, 158.9 + 8.0 * along, 0.5 * share * light, strict=True)
        still = [FrameTarget(0, x, y, POINT, part, 2.0, body) for x, y, part in places]
        images, whole = [], Tile(0, 0, 0, 0, SIDE, SIDE)
        for targets in (swept, still):
            for module in (pipeline.execute.blocks, pipeline.execute.light):
                monkeypatch.setattr(module, "place_targets", lambda *_, held=targets: held)
            blocks = [render_block(*made, whole, [])] if made[0].responses.spacing_px else []
            images.append(draw_targets(*made, whole, blocks))
        assert images[1].sum() == pytest.approx(light, rel=2e-3)
        off = np.abs(images[0] - images[1]).max()
        assert off < most * images[1].max()


def test_what_a_body_loses_by_the_responses_of_its_middle_is_told():
    """More than points all over its lit side differ, each with its own responses; nothing of one
    that is hardly larger than a point."""
    from tests.execute import test_extended as discs  # the scene of a resolved sphere

    rows = [[{"kind": "gaussian", "sigma_px": s} for s in (0.8, 1.6)]]
    psf = {"kind": "field", "rows_px": [0.0], "columns_px": [0.0, 399.0], "psfs": rows}
    made = discs.scene(160.0, psf)
    plan = prepare(made).plan
    g = plan_geometry(plan.scene, np.zeros(1, np.int64), 0.0)
    [target], whole = place_targets(plan, g), Tile(0, 0, 0, 0, discs.SIDE, discs.SIDE)
    image, parts = draw_targets(plan, g, whole, []), np.zeros((discs.SIDE, discs.SIDE))
    y, x, share = target.body.points(1.0)
    places = target.x_px + x, target.y_px + y, target.light_e * share
    draw_exact(plan, parts, whole, len(plan.responses.classes) - 1, POINT, *places)
    assert image.sum() == pytest.approx(parts.sum(), rel=1e-6)
    off = np.abs(image - parts) / np.sqrt(plan.facts.light_floor_e**2 + parts)
    (told,) = [w for w in plan.warnings if "responses of their middle" in w]
    said = float(re.search(r"([\d.e+-]+) of its noise", told)[1])
    assert "one of 8 px in radius" in told
    assert 0.1 * said < off.max() < said
    small = prepare(discs.scene(0.2, psf)).plan
    assert not [w for w in small.warnings if "responses of their middle" in w]


@pytest.mark.parametrize("light_e", [1e4, 1e6, 1e8])
@pytest.mark.parametrize("beyond", [False, True])
def test_a_path_of_its_own_takes_the_responses_along_it(catalogue, light_e, beyond):
    """A source without a table through the field, against points all along: by transforms, and by
    quadrature as the brightest are drawn. Pieces of 8 px erred by 3 sigma of a star of 1e8 e-."""
    plan, _ = planned(catalogue, field(CORNERS))
    tile, (x, y) = Tile(0, 0, 0, 0, SIDE, SIDE), (160.3, 158.9)
    ends = np.array([-15.0, 15.0]), np.array([-20.0, 20.0])
    k, out, parts = len(plan.responses.classes), np.zeros((SIDE, SIDE)), np.zeros((SIDE, SIDE))
    path = Path(*ends, np.ones(1))
    _draw_path(plan, out, tile, k if beyond else 0, path, x, y, light_e)
    along, share = np.polynomial.legendre.leggauss(200)
    places = x + 15.0 * along, y + 20.0 * along, 0.5 * share * light_e
    draw_exact(plan, parts, tile, 0, POINT, *places)
    assert out.sum() == pytest.approx(light_e, rel=1e-5)
    assert plan.field_step_px(path, 5.0, 0.0) == LONGEST_PIECE_PX  # of one without light
    steps = [plan.field_step_px(path.scaled(1e-3), 5.0, e) for e in (1e12, 1e14)]
    assert steps[0] == pytest.approx(10.0**0.5 * steps[1], rel=0.01)  # as its noise grows
    noise = np.sqrt(plan.facts.light_floor_e**2 + np.maximum(parts, 0.0))
    assert (np.abs(out - parts) / noise).max() < 2e-3


@pytest.mark.parametrize("psfs", [CORNERS, NINE], ids=["one cell", "across places"])
def test_the_reference_takes_the_responses_along_paths(psfs, catalogue):
    """Three sources that share a path, against points all along it."""
    plan, _ = planned(catalogue, field(psfs))
    x, y, light = np.array([160.3, 166.0, 171.2]), np.array([158.9, 150.0, 171.0]), 1e5
    path = Path(np.array([-9.0, 15.0]), np.array([-12.0, 20.0]), np.ones(1))
    at = Tile(0, 0, 130, 130, 64, 64)
    done = check._by_core(plan, at, [(x, y, np.full(3, light), path)])
    image = sum(draw_direct(core, swept, (64, 64), (130, 130)) for core, swept in done.items())
    along, share = np.polynomial.legendre.leggauss(200)
    t, parts = 0.5 * (1.0 + along), np.zeros((64, 64))
    places = np.add.outer(x - 9.0, 24.0 * t), np.add.outer(y - 12.0, 32.0 * t)
    share_e = np.tile(0.5 * share * light, 3)
    draw_exact(plan, parts, at, 0, POINT, places[0].ravel(), places[1].ravel(), share_e)
    assert len(done) == len(plan.responses.blurs)
    noise = np.sqrt(plan.facts.light_floor_e**2 + np.maximum(parts, 0.0))
    assert (np.abs(image - parts) / noise).max() < 1e-3


def test_without_a_field_nothing_of_it_is_loaded(catalogue, tmp_path):
    code = (
        "import sys, json, pathlib\n"
        "from pipeline.route.prepare import prepare\n"
        "from pipeline.spec.load import parse_scene\n"
        "for text in sys.argv[1:]:\n"
        "    prepare(parse_scene(json.loads(text)))\n"
        "    print('pipeline.plan.optics.psf_field' in sys.modules)\n"
    )
    scenes = (json.dumps(scene(catalogue, psf).as_dict()) for psf in (ROUND, field([[ROUND]])))
    done = subprocess.run(
        [sys.executable, "-c", code, *scenes], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["False", "True"]
