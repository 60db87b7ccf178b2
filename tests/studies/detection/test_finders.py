"""Finders and their judge on images and labels that are made here, and on a rendered product."""

from __future__ import annotations

import json
import math
import time
import tracemalloc
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from pipeline.calibrate import calibrate
from pipeline.cli import app
from pipeline.errors import BadInput
from pipeline.export.labels import STAR, TARGET, Labels
from pipeline.route.run import render
from pipeline.spec.load import parse_scene
from pipeline.studies.detection.finders import drift_of, tasks
from pipeline.studies.detection.judge import DetectionVerdict, judge
from pipeline.studies.detection.points import Detections, find_points, flattened
from pipeline.studies.detection.streaks import all_lines, find_lines, without_streaks
from pipeline.studies.detection.study import _frame, _one, _summed, report_detection

pytest.importorskip("sep")
SIDE = 256


def labels(rows):
    """Labels of (kind, x, y, half dx, half dy, snr)."""
    rows = np.array(rows, float).reshape(-1, 6)
    kind, x, y, dx, dy, snr = rows.T
    values = {f.name: np.zeros(len(rows)) for f in fields(Labels)} | {
        "kind": kind.astype(int), "name": np.array([f"s{i}" for i in range(len(rows))], "U64"),
        "x_px": x, "y_px": y, "x_light_px": x, "y_light_px": y, "x_start_px": x - dx,
        "x_end_px": x + dx, "y_start_px": y - dy, "y_end_px": y + dy, "snr": snr,
        "g_mag": np.where(kind == STAR, 10.0, np.nan), "electrons": snr,
    }  # fmt: skip
    return Labels(**values)


def drawn(rows, noise=1.0, seed=0):
    """The labels' paths as Gaussians of 1.2 px over white noise; snr as matched filter."""
    rng = np.random.default_rng(seed)
    image = rng.normal(0, noise, (SIDE, SIDE))
    yy, xx = np.mgrid[:SIDE, :SIDE]
    for _, x, y, dx, dy, snr in rows:
        t = np.linspace(-1, 1, 81)
        one = sum(
            np.exp(-((xx - x - s * dx) ** 2 + (yy - y - s * dy) ** 2) / (2 * 1.2**2)) for s in t
        )
        image += one * snr * noise / math.sqrt((one**2).sum())
    return image


def found_at(*places):
    x, y = np.array(places, float).reshape(-1, 2).T
    none = np.zeros(len(x))
    return Detections(x, y, none + 5, none, none)


def test_sep_finds_round_sources_and_leaves_long_ones():
    rows = [(1, 60, 70, 0, 0, 80), (1, 180, 90, 12, 5, 200)]
    found = find_points(drawn(rows), 1.0, 3.0)
    assert len(found) == 1
    assert np.hypot(found.x_px[0] - 60, found.y_px[0] - 70) < 0.3


@pytest.mark.parametrize("angle", [0.0, 37.0, 90.0, 141.0])
def test_blind_bank_finds_streaks_of_any_direction(angle):
    """One detection a streak, near its middle, along it; a point is none."""
    way = math.radians(angle)
    rows = [(1, 100, 120, 12 * math.cos(way), 12 * math.sin(way), 25), (1, 200, 60, 0, 0, 60)]
    found = find_lines(drawn(rows), 1.0, 6.0, all_lines())
    assert len(found) == 1
    assert np.hypot(found.x_px[0] - 100, found.y_px[0] - 120) < 6
    turn = (found.angle_rad[0] - way + math.pi / 2) % math.pi - math.pi / 2
    assert abs(turn) < 0.25
    assert found.snr[0] == pytest.approx(25, rel=0.35)


def test_noise_alone_gives_few_false_alarms():
    """Unit noise: the filters' own signal-to-noise is one, so that 5.5 sigma is rare."""
    image = np.random.default_rng(2).normal(0, 1, (512, 512))
    assert len(find_lines(image, 1.0, 5.5, all_lines())) <= 2
    assert len(find_points(image, 1.0, 5.0)) == 0


def test_known_drift_and_its_removal():
    """The drift is the stars' median path; the top-hat takes their trails off, not the point."""
    stars = [(STAR, 40 + 30 * i, 30 + 33 * i, 10, 1, 40) for i in range(6)]
    target = (TARGET, 70, 200, 0, 0, 60)
    told, image = labels([*stars, target]), drawn([*stars, target])
    drift = drift_of(told)
    assert drift == pytest.approx((2 * math.hypot(10, 1), math.atan2(1, 10)))
    left = without_streaks(image, drift)
    assert left[196:205, 66:75].sum() > 0.6 * image[196:205, 66:75].sum()
    on_star = np.s_[28:33, 33:48]
    assert left[on_star].mean() < 0.35 * image[on_star].mean()
    kinds = [t.kind for t in tasks(told, image)]
    assert kinds == ["sep", "sep_cleaned", "drift", "lines"]
    for task in tasks(told, image):
        verdict = judge(told, task.sought, task.find(task.image, 1.0, 5.0))
        assert verdict.found[task.sought].all() or task.kind in ("sep", "lines")
        assert verdict.false <= 3


@pytest.mark.parametrize("half_px", [4, 5])
def test_streaks_not_much_longer_than_the_opening_go_and_points_stay(half_px):
    """The opening is half as long: one of their own length would leave a part of their middles."""
    rows = [(STAR, 60, 60, half_px, 0, 3000), (TARGET, 150, 100, 0, 0, 3000)]
    image = drawn(rows)
    left = without_streaks(image, drift_of(labels(rows)))
    middle, point = np.s_[59:62, 58:63], np.s_[99:102, 149:152]
    assert left[middle].mean() < 0.1 * image[middle].mean()
    assert left[point].mean() > 0.5 * image[point].mean()


def test_judge_counts_right_fragments_and_false():
    told = labels([(TARGET, 50, 50, 0, 0, 20), (STAR, 120, 100, 15, 0, 30)])
    sought = np.array([True, False])
    verdict = judge(told, sought, found_at((50.5, 50), (51, 51), (133, 101), (200, 200)))
    assert verdict.found.tolist() == [True, False]
    assert int(verdict.right.sum()) == 1
    assert (verdict.fragments, verdict.false) == (2, 1)
    streak = judge(told, ~sought, found_at((126, 101)))
    assert streak.found.tolist() == [False, True]


def test_the_brightest_detection_stands_for_a_source():
    """Of two near one source the brighter, though farther; a fainter one takes what is left."""
    told = labels([(TARGET, 50, 50, 0, 0, 20), (TARGET, 52, 50, 0, 0, 20)])
    found = replace(found_at((50.2, 50), (51.2, 50), (49, 50)), snr=np.array([5.0, 9.0, 4.0]))
    verdict = judge(told, np.array([True, False]), found)
    assert verdict.right.tolist() == [False, True, False]
    both = judge(told, np.array([True, True]), found)
    assert both.right.tolist() == [True, True, False]
    assert both.found.all()


def test_a_detection_is_of_the_brightest_source_in_reach():
    """A faint star may be nearer by chance; of two alike the nearer one is taken."""
    told = labels([(STAR, 50, 50, 9, 0, 700), (STAR, 53, 51, 9, 0, 40), (STAR, 56, 51, 9, 0, 700)])
    for at, found in (((53, 50.5), [1, 0, 0]), ((53.5, 50.5), [0, 0, 1])):
        assert judge(told, np.ones(3, bool), found_at(at)).found.tolist() == found


@pytest.mark.parametrize("angle", [0.0, 30.0, 75.0, 120.0, 160.0])
def test_judge_measures_along_and_across_a_streak(angle):
    """Half a length of 40 px: a detection 20 px along it is its own, one 4 px beside it is not."""
    way = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    told = labels([(STAR, 128, 128, *(20 * way), 30)])
    sought = np.array([True])
    for along, across, right in ((20, 0, 1), (-20, 2, 1), (0, 4, 0), (15, -4, 0), (26, 0, 0)):
        place = 128 + along * way + across * np.array([-way[1], way[0]])
        assert int(judge(told, sought, found_at(place)).right.sum()) == right, (along, across)


@settings(max_examples=30)
@given(st.lists(st.tuples(st.floats(0, 255), st.floats(0, 255)), max_size=12), st.integers(0, 6))
def test_judge_counts_each_once(places, sources):
    """One to one: no more found than sought or detected; every detection is of one kind."""
    rng = np.random.default_rng(sources)
    told = labels(
        [(STAR, *rng.uniform(0, 255, 2), *rng.uniform(-9, 9, 2), 9) for _ in range(sources)]
    )
    found = found_at(*places)
    verdict = judge(told, np.ones(sources, bool), found)
    right = int(verdict.right.sum())
    assert right == verdict.found.sum() <= min(sources, len(found))
    assert right + verdict.fragments + verdict.false == len(found)


def test_flattened_takes_the_sky_off():
    ramp = np.linspace(0, 5, SIDE)[None, :] + np.random.default_rng(1).normal(500, 3, (SIDE, SIDE))
    image, noise = flattened(ramp.astype(np.uint16))
    assert noise == pytest.approx(3.0, rel=0.1)
    assert abs(np.median(image)) < 0.5


@pytest.fixture(scope="module")
def product(tmp_path_factory):
    """A target alone before a plain sky: a satellite that follows another."""
    from pathlib import Path

    from pipeline.spec.load import load_scene

    root = Path(__file__).resolve().parents[3]
    data = load_scene(root / "examples" / "space-based-rate.yaml").as_dict()
    data["exposure"]["frames"] = 2
    path = tmp_path_factory.mktemp("detect") / "run"
    render(parse_scene(data), path)
    return path


def test_study_of_a_product(product, tmp_path):
    """The target is found in both frames; files and figure are whole."""
    from PIL import Image

    told: list[tuple[int, int]] = []
    study = report_detection(
        product, tmp_path / "out", progress=lambda _, done, total: told.append((done, total))
    )
    assert told == [(1, 2), (2, 2)]  # each frame as it is done
    assert [bool(_frame(product, (512, 512), 5.0, k)[1]) for k in (0, 1)] == [True, False]
    assert [t["found"] for t in study["targets"] if t["finder"] == "sep"] == [True, True]
    assert study["finders"]["sep"]["false_alarms"] <= 2
    assert json.loads((tmp_path / "out" / "detection.json").read_text()) == study
    assert "chaser" in (tmp_path / "out" / "detection.md").read_text()
    assert Image.open(tmp_path / "out" / "detection.png").size[0] > 800


def test_the_command_studies_the_frames_that_were_asked_for(product, tmp_path):
    done = CliRunner().invoke(
        app, ["report", "detection", str(product), "-o", str(tmp_path / "out"), "--frames", "1",
              "--json"],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["frames"] == 1


def test_crowds_are_judged_in_seconds():
    """As many sources and detections as a frame of 2048 px has."""
    rng = np.random.default_rng(3)
    n = 20_000
    x, y = rng.uniform(0, 2000, (2, n))
    ones = np.ones(n)
    many = labels(np.stack([0 * ones, x, y, 9 * ones, 4 * ones, 50 * ones], axis=-1))
    part = rng.uniform(-0.5, 0.5, n)
    at = found_at(*np.stack([x + 18 * part, y + 8 * part], axis=-1))
    began = time.process_time()
    verdict = judge(many, np.ones(n, bool), at)
    assert time.process_time() - began < 6.0  # 13 s where lengths are worked out star by star
    assert verdict.explained.all()
    assert verdict.right.mean() > 0.9


def test_limits_refused(product, tmp_path):
    calibrate(product, tmp_path / "calibrated")
    (tmp_path / "file").touch()
    for arguments, field in (
        ((product, tmp_path, 0.5), "--threshold"), ((product, tmp_path, math.nan), "--threshold"),
        ((product, tmp_path, 5.0, 0), "--frames"), ((tmp_path / "no", tmp_path), "PRODUCT"),
        ((tmp_path / "calibrated", tmp_path), "PRODUCT"), ((product, tmp_path / "file"), "-o"),
        ((product, tmp_path / "file" / "in"), "-o"),
    ):  # fmt: skip
        with pytest.raises(BadInput) as caught:
            report_detection(*arguments)
        assert caught.value.field == field


def test_sources_at_every_edge_of_an_oblong_frame():
    """Those within 4 px of an edge are not asked for, whichever edge it is."""
    image = np.zeros((60, 200))
    inside = [(4, 30), (195, 30), (100, 4), (100, 55), (150, 40)]
    beside = [(3.9, 30), (195.1, 30), (100, 3.9), (100, 55.1), (150, 70), (30, 150)]
    told = labels([(TARGET, *place, 0, 0, 30) for place in inside + beside])
    sep, blind = tasks(told, image)
    assert sep.sought.tolist() == [True] * 5 + [False] * 6
    assert not blind.sought.any()
    long = labels([(TARGET, *place, 9, 2, 30) for place in inside + beside])
    assert tasks(long, image)[1].sought.tolist() == [True] * 5 + [False] * 6


def test_wings_of_bright_sources_explain_detections_farther_out():
    """2.5 px up to a signal-to-noise of 100, then as its square root; none of sources below 3."""
    for snr, near, far in ((3, 2.4, 2.6), (100, 2.4, 2.6), (400, 4.9, 5.1), (2.9, None, 0.0)):
        told = labels([(STAR, 60, 70, 0, 0, snr), (STAR, 160, 170, 20, -10, snr)])
        nothing = np.zeros(2, bool)
        for x, y, way in ((60, 70, (0.6, 0.8)), (150, 175, (0.447214, 0.894427))):
            for off, explained in ((near, True), (far, False)):
                if off is not None:
                    at = found_at((x + off * way[0], y + off * way[1]))
                    assert judge(told, nothing, at).explained[0] == explained, (snr, off)


def test_one_bright_star_does_not_fill_the_memory_of_a_crowd():
    """Its wings reach 56 px; some 300 MB where every trail is searched so far around."""
    rng = np.random.default_rng(4)
    n = 2000
    x, y = rng.uniform(0, 600, (2, n))
    snr = np.append(5e4, np.full(n - 1, 10.0))
    told = labels(np.stack([np.full(n, STAR), x, y, 40 + 0 * x, 30 + 0 * x, snr], axis=-1))
    at = found_at(*rng.uniform(0, 600, (500, 2)))
    tracemalloc.start()
    explained = judge(told, np.zeros(n, bool), at).explained
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 60e6
    t = np.linspace(-1, 1, 101)
    for k in range(0, 500, 50):
        gap = np.hypot(x[:, None] + 40 * t - at.x_px[k], y[:, None] + 30 * t - at.y_px[k])
        reach = 2.5 * np.sqrt(np.maximum(1.0, snr / 100))
        assert explained[k] == (gap.min(axis=1) < reach).any()


def test_bins_of_magnitude_and_their_sum():
    """Each star in one bin, its brighter edge within; targets in none; frames add up."""
    told = replace(labels([(STAR, 0, 0, 0, 0, 9)] * 5 + [(TARGET, 0, 0, 0, 0, 9)]),
                   g_mag=np.array([10.0, 10.4, 10.5, 11.2, 11.6, np.nan]))  # fmt: skip
    sought, found = np.array([1, 1, 1, 0, 1, 1], bool), np.array([1, 0, 1, 0, 0, 1], bool)
    verdict = DetectionVerdict(found, np.array([True, False]), np.array([True, False]))
    none = found_at((0, 0), (1, 1))
    frames = [_one(k, "sep", told, sought, none, verdict) for k in range(2)]
    total = _summed(frames)["sep"]
    assert (total["detections"], total["right"], total["false_alarms"]) == (4, 2, 2)
    bins = {(b["bright_mag"], b["sought"], b["found"]): b["completeness"] for b in total["stars"]}
    assert bins == {(10.0, 4, 2): 0.5, (10.5, 2, 2): 1.0, (11.0, 0, 0): None, (11.5, 2, 0): 0.0}
    assert [t["found"] for t in frames[0]["targets"]] == [True]
    whole = replace(told, g_mag=np.array([10.0, 10.4, 10.5, 11.0, 12.0, np.nan]))
    counted = _one(0, "sep", whole, sought, none, verdict)["stars"]
    assert sum(b["sought"] for b in counted) == 4


@pytest.mark.parametrize("shape", [(96, 200), (200, 96)])
def test_streaks_in_oblong_frames(shape):
    """The blind bank and the top-hat know rows from columns."""
    rng = np.random.default_rng(8)
    y, x = np.mgrid[: shape[0], : shape[1]]
    image, way = rng.normal(0, 1, shape), math.radians(25.0)
    middle = shape[1] / 2 + 7, shape[0] / 2 - 9
    for s in np.linspace(-14, 14, 57):
        dx, dy = x - middle[0] - s * math.cos(way), y - middle[1] - s * math.sin(way)
        image += 0.9 * np.exp(-(dx**2 + dy**2) / (2 * 1.2**2))
    (found,) = np.stack([find_lines(image, 1.0, 8.0, all_lines()).take(np.array([True]))])
    assert math.hypot(found.x_px[0] - middle[0], found.y_px[0] - middle[1]) < 4
    assert found.angle_rad[0] == pytest.approx(way, abs=0.25)
    left = without_streaks(image, (28.0, way))
    at = np.s_[int(middle[1]) - 2 : int(middle[1]) + 3, int(middle[0]) - 2 : int(middle[0]) + 3]
    assert left[at].mean() < 0.5 * image[at].mean()
