"""What the studies tell: pages, tables, figures and verdicts of made rows; what they refuse."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import io
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.pins.told import check_told

TINY = 1e-13  # of the largest in an array, below which a number is rounding
OFTEN = "cpu_s wall_s again_cpu_s again_wall_s seconds seconds_on seconds_off seconds_saved machine"
TIMES = f"{OFTEN} cpu_s_per_star table_s peak_mb before_mb load nightglass pareto".split()


def tell(value: Any, digits: int = 9) -> str:
    """Numbers at some digits; of long arrays sums, a moment, extremes and some values."""
    if isinstance(value, np.ma.MaskedArray):
        return f"masked {value.shape}"
    if isinstance(value, np.ndarray):
        return _array(value, digits)
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return f"{value:.{digits}g}"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = vars(value)
    if isinstance(value, dict):
        told = ((k, "-" if k in TIMES else tell(v, digits)) for k, v in value.items())
        return "\n".join(f"{k}: {v}" for k, v in told)
    if isinstance(value, list | tuple):
        parts = [tell(v, digits) for v in value]
        short = sum(map(len, parts)) < 90 and "\n" not in "".join(parts)
        return f"[{', '.join(parts)}]" if short else "\n".join(parts)
    return str(value)


def _array(v: np.ndarray, digits: int) -> str:
    if v.dtype.kind == "c":
        return f"{_array(v.real, digits)}; imaginary {_array(v.imag, digits)}"
    if v.dtype.kind not in "fiub" or v.size <= 12:
        scale = float(np.abs(v[np.isfinite(v)]).max(initial=0.0)) if v.dtype.kind == "f" else 0.0
        cut = np.where(np.abs(v) < TINY * scale, 0 * v, v) if scale else v
        return " ".join(tell(x, digits) for x in cut.ravel()) or "none"
    good = v[np.isfinite(v)].astype(float)
    size = float(np.abs(good).sum())
    told = [good.sum(), size, good @ np.arange(1.0, good.size + 1.0) / good.size]
    told = [0.0 if abs(x) < 1e-9 * size else x for x in told]
    lost = f", {v.size - good.size} not finite" if good.size < v.size else ""
    ends = f"{tell(good.min(), digits)} to {tell(good.max(), digits)}" if good.size else ""
    some = _array(v.ravel()[:: max(1, v.size // 4)], digits)
    return f"{v.shape}{lost} sums {' '.join(tell(x, digits) for x in told)}; {ends}; {some}"


def coarse(value: Any, least: float = 1e-9) -> Any:
    """The same with errors that are rounding as zeros."""
    if isinstance(value, dict):
        return {k: coarse(v, least) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [coarse(v, least) for v in value]
    return 0.0 if isinstance(value, float) and abs(value) < least else value


def told_lines(script: str, space: dict[str, Any]) -> str:
    """Each line of a script and what it gives or raises; `name = value` is kept for later lines."""
    out: list[str] = []
    for line in script.strip().replace("\n    ", " ").splitlines():
        try:
            code = compile(line, "case", "eval")
        except SyntaxError:
            exec(line, space)
            continue
        try:
            found = tell(eval(code, space))
        except Exception as error:
            found = f"{type(error).__name__}: {error}"
        out += [line[:100], *(f" {row}" for row in found.splitlines())]
    return "\n".join(out)


def printed(work: Callable[[], Any]) -> str:
    with contextlib.redirect_stdout(io.StringIO()) as out:
        work()
    return out.getvalue()


def pictured(work: Callable[[], Any]) -> str:
    """All that the figures of a function hold: titles, axes, lines, bars, marks, images."""
    from matplotlib.figure import Figure

    made: list[Any] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", lambda self, *_, **__: made.append(self))
        work()
    lines: list[str] = []
    for figure in made:
        lines.append(f"figure {tell(figure.get_size_inches())} {figure.get_suptitle()}")
        for ax in figure.axes:
            names = f"{ax.get_xlabel()}, {ax.get_xscale()}; {ax.get_ylabel()}, {ax.get_yscale()}"
            lines.append(f"{ax.get_title() or ax.get_title('left')!r}: {names}")
            if not ax.get_autoscalex_on():
                lines.append(f"limits {tell([*ax.get_xlim(), *ax.get_ylim()], 6)}")
            for line in ax.lines:
                style = f"{line.get_color()} {line.get_marker()} {line.get_linestyle()}"
                at = tell(line.get_xydata().astype(float), 6)
                lines.append(f"{line.get_label().lstrip('_')} {style} {at}")
            lines += [f"{t.get_text()!r} at {tell(t.get_position(), 6)}" for t in ax.texts]
            lines += [f"bars {tell(p.get_xy(), 6)}" for p in ax.patches]
            for c in ax.collections:
                bars = [tell(s, 6) for s in getattr(c, "get_segments", list)()]
                lines.append(f"marks {tell(np.array(c.get_offsets(), float), 6)} {bars}")
            for i in ax.images:
                lines.append(f"image {tell(np.array(i.get_array(), float), 6)} {i.get_extent()}")
            lines += [t.get_text() for t in ax.get_yticklabels() if ": " in t.get_text()]
        for legend in filter(None, (*figure.legends, *(ax.get_legend() for ax in figure.axes))):
            lines.append(f"legend {[t.get_text() for t in legend.get_texts()]}")
    return "\n".join(lines)


def tools(**more: Any) -> dict[str, Any]:
    """What scripts call."""
    fake = {"np": np, "partial": partial, "but": dataclasses.replace, "Space": SimpleNamespace}
    mine = {f.__name__: f for f in (tell, coarse, printed, pictured)}
    return fake | mine | {"a": lambda *v: np.array(v, float)} | more


SELFTEST = """
bad = [case.LimitingCase("a/b|c", "what", "whose", "px", .5, f) for f in (
    lambda _: {}["gone"], lambda _: CaseResult("1", "2|3", np.nan),
    lambda _: CaseResult("1", "2", .5), lambda _: report.chosen("no such"),
    lambda _: CaseResult("1", "2", np.float64(.51)))]
heard = []
made = [but(o, seconds=1.2345) for o in report.run_cases(tuple(bad), lambda *at: heard.append(at))]
heard, [c.name for c in report.chosen("stars")], report.as_data(made), report.markdown(made)
printed(lambda: report.print_table(made)), printed(lambda: report.print_table(made[2:3]))
report.chosen("no such")
"""
LEDGER = """
pairs = ((1., .9), (.1, .5), (9., 2.), (0., .1), (0., 0.), (1., 1.), (1., np.nan), (np.inf, np.inf))
found = [probe.ProbeResult("a", "in b", b, e, "px", 1., 3.) for b, e in pairs]
[study.told(f) for f in found], [study._row(study.LEDGER[0], f) for f in (found[:4], found[:3],
    found[4:6])]
told = {"rules": [study._row(r, found[k : k + 2]) for k, r in enumerate(study.LEDGER[:3])], "cpu_s":
    12.5, "nightglass": "0"}
report.text(told), printed(lambda: report.print_ledger(told)), probe.most(a()), probe.most(a(1, -3))
[r.components[0] for r in study.checked_rules(("flat", "stars", "bias", "background"))]
study.checked_rules(("flat", "no"))
report.report_ledger(folder)
report.report_ledger(folder / "full")
report.report_ledger(folder / "new", ("no",))
"""
ACCURACY = """
["; ".join([f"{c.name} {c.frame} {tell(c.track.x_px[0], 6)} {probes.probe_count(c, q)}",
    *(f"{s.engine} {s.setting}" for s in engines.our_settings(c, q))]) for q in (True, False) for c
    in study.cases((256, 300), q)]
one = study.Record("products", "4", True, "gaussian 0.8 px", 0., False, 30, 20, 1., .1, .25, 99,
    1e-3, 3., .1)
pairs = ((1., 1e-3, "products"), (1., 1e-3, "stamps, cubic"), (.5, 2e-3, "core radius"), (.1, 1e-9,
    "tiles"), (2., 2e-3, "SkyMaker"), (3., 1e-11, "spectral"))
rows = study.with_pareto([but(one, engine=e, cpu_s=c, error_of_peak=p, error_sigma=3e3 * p,
    stars_timed=30 - k) for k, (c, p, e) in enumerate(pairs)])
[r.pareto for r in rows], study._beats(rows[0], rows[1]), study._beats(rows[0], rows[4])
every = [*rows, but(one, curved=True, streak_px=60.), but(one, psf="airy Q=1", streak_px=60.)]
peers = [{"name": "P", "version": v, "cannot": "fly"} for v in (None, "1.2")]
told = {"stars": 30000, "frame": [50, 120], "noise": {"star_e": 1e5, "floor_e": 10.}, "notes":
    study.NOTES, "peers": peers, "failed": [{"engine": "A", "setting": "1", "case": "c", "why":
    "w"}], "records": [vars(r) for r in every]}
tables.markdown(told), printed(lambda: tables.print_study(told)), pictured(lambda:
    figure.draw_figure(told, folder / "x.png"))
[probe_errors(w) for w in (0., .1, -.5)]
report.report_accuracy(folder, 0)
report.report_accuracy(folder, 10_000_001)
report.report_accuracy(folder, 1, (256, 255))
report.report_accuracy(folder, 1, (4097, 256))
"""
SCENES = """
row = {"noise_fraction": .5, "cpu_s": 1., "again_cpu_s": .5, "wall_s": 1.25, "peak_mb": 99.6,
    "max_sigma": .0123, "rms_sigma": 1e-9, "bias": -3e-4, "bound_sigma": [.1, .5], "of_bound": .04}
switch = {"component": "x|y*", "error_e": .1, "error_sigma": .01, "bound_e": .5, "bound_sigma": .05,
    "of_light": False, "seconds_on": .1, "seconds_off": .3, "scaled_from": None, "holds": True}
drawn = [{"title": t, "levels": [row, row | {"cpu_s": c, "again_cpu_s": 2 * c,
    "noise_fraction": .05, "max_sigma": 1e-3}],
    "switches": [switch, switch | {"of_light": True, "holds": False, "scaled_from": 3.}]}
    for t, c in (("stars | streak", 2.), ("two", 50.), ("3", 5.), ("4", 9.),
    ("5", 1.2))]
told = {"machine": {"cores": 2, "processor": "x", "load_before": .25}, "nightglass": "0",
    "catalogue": "given", "quick": True, "scenes": drawn}
two = told | {"scenes": drawn[:2]}
report.text(two), page.page(two, b"one", b"two")[1100:], printed(lambda: tables.print_study(two))
tables.explained(told | {"quick": False, "machine": told["machine"] | {"load_before": None}})[0],
    page._coded("a `b` < `c`")
pictured(lambda: (figure.ladder_figure(told), figure.omission_figure(told),
    figure.omission_figure(told | {"scenes": []})))
[figure._few(v, 0) for v in (.2, .3, 5., 50.)], figure._plain(2.50, 0),
    [f"{w.name} {w.title} {w.share} {listed(scenes.with_accuracy(w, .05, .001, 'cat'))}" for w in
    scenes.requests((), False)], [(w.name, w.share, w.data["sensor"], w.data.get("stars"),
    len(w.data.get("targets", ()))) for w in scenes.requests((), True)]
[scenes.deep_fields(n, q) for q in (True, False) for n in (tuple(scenes.MAKERS), ("wide-field",),
    ("rate-track", "sidereal-crowded"))]
scenes.SENSOR, [study.checked_levels(None, q) for q in (True, False)],
    study.checked_levels("0.05,1,0.05,1e-4", True)
study.checked_levels("x", True)
study.checked_levels("1.01", True)
study.checked_levels("0.5,9e-5", True)
study.checked_levels(",".join(["1"] * 13), True)
scenes.requests(("wide-field", "no"), True)
says(1, "", "a broken")
says(0, "", "")
says(0, 'x {"a": 1}', "")
says(0, 'x {"failed": "too many"}', "")
says(0, 'x {"refused": ["f", "v", "w"]}', "")
report.report_scenes(folder)
report.report_scenes(folder / "full")
report.report_scenes(folder / "new", ("no",))
report.report_scenes(folder / "new", (), "0")
report.report_scenes(folder / "new", (), None, True, folder / "none")
"""


def test_pages_and_refusals(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from pipeline.studies import accuracy, selftest
    from pipeline.studies import ledger as ledger_report
    from pipeline.studies import scenes as scene_report
    from pipeline.studies.accuracy import engines, probes
    from pipeline.studies.scenes import study
    from pipeline.studies.scenes.scenes import SENSOR

    def listed(data: dict[str, Any]) -> str:
        """A scene as JSON, many targets as sums."""
        kept = data.get("targets", [])
        rows = [t["orbit"][k] for t in kept for k in ("position_m", "velocity_m_s")]
        sizes = np.array([t["body"]["diameter_m"] for t in kept])
        short = (
            {"targets": [kept[:1], kept[-1:], tell(np.array(rows)), tell(sizes)]} if kept else {}
        )
        return json.dumps(
            data
            | short
            | {"sensor": {k: v for k, v in data["sensor"].items() if v != SENSOR.get(k)}}
        )

    def says(code: int, out: str, err: str) -> Any:
        done = SimpleNamespace(returncode=code, stdout=out.replace(" ", "\n", 1), stderr=err)
        monkeypatch.setattr(study, "subprocess", SimpleNamespace(run=lambda *_, **__: done))
        return study.run_child({"scene": {"name": "x"}})

    def probe_errors(more: float) -> Any:
        case = engines.EngineCase(
            probes.GaussianStar(0.8),
            engines.Track(*[np.zeros((1, 2))] * 2, np.ones(1)),
            0.0,
            (130, 140),
        )
        made = probes.make_probes(case, 1)
        image = probes.exact_pixels(
            case.shape, case.track, made.x_px[0], made.y_px[0], np.arange(140), np.arange(130)
        )
        image[int(made.y_px[0]), int(made.x_px[0])] += more
        return [coarse(made.errors(k, image)) for k in range(3)], made

    (tmp_path / "full").write_text("")
    told = []
    for home, script in (
        (selftest, SELFTEST),
        (ledger_report, LEDGER),
        (accuracy, ACCURACY),
        (scene_report, SCENES),
    ):
        space = tools(folder=tmp_path, listed=listed, says=says, probe_errors=probe_errors)
        for path in sorted(Path(home.__path__[0]).glob("*.py")):
            if path.stem not in ("__init__", "satsim_worker"):
                space[path.stem] = importlib.import_module(f"{home.__name__}.{path.stem}")
        space["CaseResult"] = getattr(space.get("case"), "CaseResult", None)
        told.append(told_lines(script, space))
    check_told("studies/pages", "\n".join(told), folder=tmp_path)
