"""Every case of `nightglass selftest` holds, and the command says so."""

from __future__ import annotations

import contextlib
import json
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.commands.studies import selftest as command
from pipeline.errors import BadInput
from pipeline.studies.selftest import frames as of_frames
from pipeline.studies.selftest import light, places, stars
from pipeline.studies.selftest.case import CaseResult, LimitingCase, run_case
from pipeline.studies.selftest.report import all_cases, chosen, markdown

CASES = all_cases()


@pytest.mark.parametrize("case", CASES, ids=[c.name for c in CASES])
def test_case(case, tmp_path):
    outcome = run_case(case, tmp_path)
    assert outcome.passed, (outcome.found, outcome.fault)


def test_names_differ_and_sources_are_named():
    assert len({c.name for c in CASES}) == len(CASES) >= 20
    assert all(c.source and c.what and c.allowed >= 0.0 for c in CASES)


@pytest.mark.parametrize("name", ["frames/63-bits", "frames/exposure"])
def test_one_wrong_pixel_fails_a_case(name, tmp_path, monkeypatch):
    def one_off(*args):
        found = drawn(*args)
        for layer in found.layers.values():
            layer.flat[-1] -= layer.dtype.type(1)
        return found

    drawn = of_frames.frames
    monkeypatch.setattr(of_frames, "frames", one_off)
    case = next(c for c in CASES if c.name == name)
    assert not run_case(case, tmp_path).passed


def test_an_error_in_a_faint_pixel_is_set_against_its_own_noise(tmp_path, monkeypatch):
    """1 e- in a dark corner is its noise, however bright the star in the middle pixel."""
    mean_e = np.zeros((1, 9, 9))
    mean_e[0, 4, 4], mean_e[0, 0, 0] = 1e6, 1.0
    truth = {"electrons": [1e6], "x_px": [4.0], "y_px": [4.0]}
    found = SimpleNamespace(truth=truth, layers={"mean_e": mean_e})
    monkeypatch.setattr(of_frames, "frames", lambda *_: found)
    sharp = {"kind": "gaussian", "sigma_px": 0.01}
    peak, noise, _ = of_frames._against_erf(tmp_path, sensor__psf=sharp)
    assert (peak, noise) == pytest.approx((1e-6, 1.0))


def test_a_wide_image_is_off_by_the_noise_of_its_pixels(tmp_path, monkeypatch):
    """However small a part of its peak that is."""
    monkeypatch.setattr(of_frames, "_against_erf", lambda *_, **__: (1e-6, 0.2, None))
    outcome = run_case(of_frames.widths, tmp_path)
    assert outcome.found.error == 0.2
    assert not outcome.passed


def test_a_streak_is_off_by_the_noise_of_its_pixels(tmp_path, monkeypatch):
    """By 3 of 1,000 e- in a bright pixel: a tenth of its noise, and twice what is allowed."""
    right = np.zeros((3, 3))
    right[1, 1] = 0.1
    truth = {"electrons": np.array([1e4])}
    found = SimpleNamespace(truth=truth, layers={"mean_e": 1.003e4 * right[None]})
    monkeypatch.setattr(stars, "_stars", lambda *_: found)
    monkeypatch.setattr(stars, "_swept", lambda *_: right)
    outcome = run_case(stars.streaks, tmp_path)
    assert outcome.found.error == pytest.approx(3.0 / np.sqrt(1001.0))
    assert not outcome.passed


def test_light_that_is_not_as_the_square_of_the_size_fails(tmp_path, monkeypatch):
    """Of one body alone, in truth and frame alike."""
    real = of_frames.frames

    def brighter(data, folder):
        found = real(data, folder)
        if data["targets"][0]["body"]["diameter_m"] == 1e-8:
            found.truth["electrons"] = found.truth["electrons"] * 1.01
            found.layers["mean_e"] = found.layers["mean_e"] * 1.01
        return found

    monkeypatch.setattr(of_frames, "frames", brighter)
    assert of_frames.fluxes.run(tmp_path).error == pytest.approx(0.01, rel=1e-3)


def test_a_wrong_answer_and_a_fault_are_failures(tmp_path):
    def nothing(_):
        return CaseResult("1", "nan", float("nan"))

    def broken(_):
        raise BadInput("field", 1, "2")

    for run, fault in ((nothing, ""), (broken, "field: 1 is not accepted; allowed: 2")):
        outcome = run_case(LimitingCase("x", "x", "x", "1", 1.0, run), tmp_path)
        assert not outcome.passed
        assert outcome.fault == fault
        assert json.loads(json.dumps(outcome.as_dict(), allow_nan=False))["error"] is None
        assert "x" in markdown([outcome])


def test_the_worst_of_several_lengths_is_what_counts(tmp_path, monkeypatch):
    """A tenth too much light in the short streaks alone fails the case of all of them."""
    right = stars._swept

    def wrong(shape, t, sigma):
        return right(shape, t, sigma) * (1.1 if abs(t["x_end_px"] - t["x_start_px"]) < 1.0 else 1.0)

    monkeypatch.setattr(stars, "_swept", wrong)
    (case,) = chosen("stars/streaks")
    assert not run_case(case, tmp_path).passed


@pytest.mark.parametrize(
    ("name", "function", "of"),
    [
        ("places/0.99c", "aberrate", lambda found: found),
        ("places/fly-by", "target_apparent", lambda found: found.direction_geometric),
    ],
)
def test_one_wrong_direction_fails_the_case_of_all(name, function, of, tmp_path, monkeypatch):
    """Of some thousand angles or moments, one a hundredth of a radian beside the right one."""
    right = getattr(places, function)

    def wrong(*given):
        found = right(*given)
        of(found)[700, :2] += 0.01
        return found

    monkeypatch.setattr(places, function, wrong)
    (case,) = chosen(name)
    assert not run_case(case, tmp_path).passed


def test_an_eclipse_off_by_more_than_is_allowed_fails_the_case_of_all(tmp_path, monkeypatch):
    """One of four, that is neither the first nor the last, by 3e-4 of the sunlight."""
    right = light.uncovered_fraction

    def wrong(sun, body, apart):
        return right(sun, body, apart) + (3e-4 if (body, apart) == (0.15, 0.146) else 0.0)

    monkeypatch.setattr(light, "uncovered_fraction", wrong)
    (case,) = chosen("light/penumbra")
    assert not run_case(case, tmp_path).passed


@pytest.mark.parametrize("part", [0.9, 1.1])
@pytest.mark.parametrize("length_m", [1.0, 1e-6])
def test_too_little_light_of_a_cylinder_fails_as_too_much_does(
    length_m, part, tmp_path, monkeypatch
):
    """Of the needle or of the disc alone, by a tenth."""
    right = light.frustum_area_function

    def wrong(*given):
        return right(*given) * (part if given[-1] == length_m else 1.0)

    monkeypatch.setattr(light, "frustum_area_function", wrong)
    assert light.needle_and_disc.run(tmp_path).error == pytest.approx(0.1, rel=1e-3)


def test_command(tmp_path):
    page = tmp_path / "page.md"
    done = CliRunner().invoke(
        app, ["selftest", "--only", "light/", "--json", "--markdown", str(page)]
    )
    assert done.exit_code == 0, done.output
    told = json.loads(done.output)
    assert told["passed"]
    assert {c["name"] for c in told["cases"]} == {c.name for c in chosen("light/")}
    assert page.read_text().count("\n| light/") == len(told["cases"])


def test_unknown_name():
    with pytest.raises(BadInput, match="--only"):
        chosen("no such case")


@pytest.mark.parametrize(
    ("passed", "code"), [([True, True], None), ([True, False, True], 1), ([False, False], 1)]
)
def test_one_case_that_fails_is_told_by_the_exit_code(passed, code, monkeypatch):
    outcomes = [SimpleNamespace(passed=one) for one in passed]
    monkeypatch.setattr(command, "run_cases", lambda *_: outcomes)
    monkeypatch.setattr(command, "as_data", lambda found: [one.passed for one in found])
    with pytest.raises(typer.Exit) if code else contextlib.nullcontext() as ended:
        command.selftest(as_json=True)
    assert code is None or ended.value.exit_code == code


def test_a_page_that_cannot_be_written_is_refused_before_any_case_runs(tmp_path, monkeypatch):
    def run_none(*_):
        pytest.fail("a case ran")

    monkeypatch.setattr(command, "run_cases", run_none)
    for page in (tmp_path / "missing" / "page.md", tmp_path):
        with pytest.raises(BadInput, match=r"--markdown: .*allowed: a file in a folder that exi"):
            command.selftest(None, page, False)


@pytest.mark.parametrize(
    ("room", "work", "named"),
    [(light, "uncovered_fraction", "penumbra"), (places, "keplerian_states", "orbits"),
     (places, "_off_px", "wide_and_narrow")],
)  # fmt: skip
def test_what_is_no_number_passes_no_case(room, work, named, tmp_path, monkeypatch):
    """The last of several results alone; the worst of them would be that of the others."""
    real, calls = getattr(room, work), []
    monkeypatch.setattr(room, work, lambda *a: calls.append(1) or real(*a))
    run_case(getattr(room, named), tmp_path)  # how often it asks
    last, calls[:] = len(calls), []

    def broken(*asked):
        calls.append(1)
        found = real(*asked)
        if len(calls) < last:
            return found
        return tuple(one * np.nan for one in found) if isinstance(found, tuple) else found * np.nan

    monkeypatch.setattr(room, work, broken)
    outcome = run_case(getattr(room, named), tmp_path)
    assert not outcome.fault
    assert not outcome.passed
