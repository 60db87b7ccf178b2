"""What the command line shows to people: progress bars, the plan, the contents of a product."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from catalog_tools.documents import JsonObject
from pipeline.lines import fold, pair, width

if TYPE_CHECKING:
    from pipeline.route.draw import Progress as Drawn

Listener = Callable[["Drawn"], None]


def is_quiet(as_json: bool = False) -> bool:
    """Whether no bar is shown: a program reads the result, or stderr is no terminal."""
    return as_json or not sys.stderr.isatty()


@contextmanager
def tile_progress(quiet: bool) -> Iterator[Listener | None]:
    """A listener that shows tiles done on stderr."""
    with stage_progress(quiet, "tiles") as told:
        if told is None:
            yield None
            return
        told("planning", 0, None)
        yield lambda progress: told(progress.stage, progress.done, progress.total)


@contextmanager
def stage_progress(
    quiet: bool, unit: str = ""
) -> Iterator[Callable[[str, int, int | None], None] | None]:
    """A listener on stderr for what is being done: the stage in words, how many of how many, how
    fast, and the time left."""
    if quiet:
        yield None
        return
    with progress_bar(unit) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda stage, done, total: bar.update(
            task, description=stage, completed=done, total=total
        )


class Rate(ProgressColumn):
    """How many a second, or a minute where they are slow."""

    def render(self, task: Any) -> Text:
        speed = task.finished_speed or task.speed or 0.0
        slow = speed < 1.0
        rate = f"{speed * 60:.3g}/min" if slow else f"{speed:.3g}/s"
        return Text(rate if speed else "")


def progress_bar(unit: str = "") -> Any:
    """A bar on stderr: `rendering ---- 12/40 tiles 3.1/s 0:00:09 left`; nothing stays of it."""
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(20),
        MofNCompleteColumn(),
        TextColumn(unit),
        Rate(),
        TimeRemainingColumn(),
        TextColumn("left"),
        console=Console(stderr=True),
        transient=True,
    )


MOST_TARGETS, MOST_WARNINGS = 3, 2


def print_plan(plan: JsonObject, everything: bool = False, explain: bool = False) -> None:
    """The answer in at most 15 lines; with `everything` also each decision with its reason and
    bound, and the notes; with `explain` the rules of the decisions, too."""
    everything = everything or explain
    print_warnings(plan["warnings"], None if everything else MOST_WARNINGS)
    for name, text in _answer(plan):
        print(pair(name, text, 8) if everything else _cut(f"{name:>8}  {text}"))
    if not everything:
        print(
            f"{'more':>8}  --all: {len(plan['decisions'])} decisions with the bounds of their "
            f"errors, {len(plan['remarks'])} notes"
        )
        return
    print(
        fold(
            f"{plan['tiles']} tiles of {plan['tile_shape'][0]} x {plan['tile_shape'][1]} px; "
            f"{plan['shards']} shards to read ({plan['row_groups']} row groups, "
            f"{plan['star_rows_to_read']} rows, {plan['bytes_to_read'] / 1e6:.1f} MB); "
            f"engine: {plan['engine']}",
            " " * 10,
            f"{'work':>8}  ",
        )
    )
    print(pair("coverage", _coverage(plan["coverage"]), 8))
    for d in plan["decisions"]:
        _print_decision(d, explain)
    for remark in plan["remarks"]:
        print(fold(remark, "      ", "note: "))


def _answer(plan: JsonObject) -> Iterator[tuple[str, str]]:
    """What a scene gives and takes: names and lines."""
    needs, out = plan["predicted"], plan["outlook"]
    yield "frames", f"{plan['frames']} of {plan['shape'][0]} x {plan['shape'][1]} px"
    field = plan["field_deg"]
    yield "field", f"{field[0]:.4g} x {field[1]:.4g} deg, {plan['ifov_arcsec']:.3g} arcsec a pixel"
    looked = len(out["looked_at"])
    where = "" if looked == plan["frames"] else f" (by {looked} of the frames)"
    few = "; the brightest" if out["in_view"] > MOST_TARGETS else ""
    yield "targets", f"{out['in_view']} of {plan['targets']} in view{where}{few}"
    for t in out["targets"][:MOST_TARGETS]:
        mag = "no magnitude" if t["v_mag"] is None else f"V {t['v_mag']:.1f}"
        yield "", f"{t['name'][:32]}: {mag}, SNR {t['snr']:.3g}, best in frame {t['frame']}"
    limit = out["limiting_g_mag"]
    noise = f"noise of an empty pixel {plan['noise_floor_e']:.3g} e-"
    yield "limit", (f"G {limit:.1f} at SNR 5; " if limit is not None else "") + noise
    yield "stars", _stars(plan)
    cpu, memory, disk = (needs[n] for n in ("cpu_s", "worker_memory_mb", "product_mb"))
    yield "needs", f"{cpu:.3g} s of one core, {memory:.0f} MB a worker, {disk:.3g} MB of disk"


def _stars(plan: JsonObject) -> str:
    if plan["catalogue"] is None:
        return "none: no catalogue"
    limit = (plan["coverage"] or {}).get("complete_to_g_mag")
    depth = "" if limit is None else f", everywhere to G {limit:g}"
    covered = _covered(plan["coverage"]) + depth
    return f"about {plan['stars_per_frame']} a frame; catalogue covers {covered}"


def _covered(said: JsonObject | None) -> str:
    if said is None or said["source"] is None:
        return "an unknown part of the field"
    worst = f"{100 * said['worst_frame_fraction']:.3g}%"
    return worst + ("" if said["mean_fraction"] == 1.0 else f" of frame {said['worst_frame']}")


def _print_decision(d: JsonObject, explain: bool) -> None:
    """A decision: what is kept or omitted, the bound of its error, and why."""
    bounds = [
        f"{d[name]:.3g} {unit}"
        for name, unit in (("error_bound_e", "e-"), ("error_bound_sigma", "sigma"))
        if d[name] is not None
    ]
    if d.get("bound") is not None:
        bounds.append(f"{d['bound']:.2g} {d['unit']}")
    bound = f", bound {', '.join(bounds)}" if bounds else ""
    print(fold(f"{d['component']}: {'kept' if d['kept'] else 'omitted'}{bound}", "  ", ""))
    print(fold(d["reason"], "    "))
    if explain and "rule" in d:
        print(fold(f"rule: {d['rule']}", "    "))
        print(fold(f"measured by: {d['measured_by'].replace('::', ', ')}", "    "))


def _cut(line: str) -> str:
    return line if len(line) <= width() else line[: width() - 4] + " ..."


def _coverage(said: JsonObject | None) -> str:
    """How much of the frames the catalogue covers."""
    if said is None:
        return "no catalogue"
    if said["source"] is None:
        return "cannot be found from the catalogue's few rows"
    worst, mean = said["worst_frame_fraction"], said["mean_fraction"]
    return (
        f"{100 * worst:.3g}% of frame {said['worst_frame']}, {100 * mean:.3g}% of all "
        f"(by {said['source']})"
    )


def print_warnings(warnings: list[str], most: int | None = None) -> None:
    """What is wrong in a product though the scene accepts it: before everything else.

    most : so many are shown, of each two lines at most, and how many more there are
    """
    shown = [fold(text, " " * 9, "WARNING: ").splitlines() for text in warnings]
    if most is not None:
        shown = [lines[:1] + [_cut(" ".join(lines[1:2] + lines[2:]))] for lines in shown[:most]]
        if len(warnings) > most:
            shown.append([f"WARNING: and {len(warnings) - most} more (--all)"])
    for line in (line for lines in shown for line in lines if line):
        Console().print(line, style="bold yellow", highlight=False, markup=False, soft_wrap=True)


CONTENTS = {
    "cube.zarr": "the frames: open with xarray.open_zarr",
    "truth/stars.parquet": "every star drawn: place, streak, light, SNR",
    "truth/targets.parquet": "every target: place, path, range, phase, light, SNR",
    "truth/pixels.parquet": "every bad, dead and hot pixel",
    "scene.yaml": "the scene as understood, defaults filled in",
    "plan.json": "what was used and omitted, with error bounds",
    "report.json": "time, memory, errors, versions, digests",
    "preview.png": "the first frame as a picture",
}


def print_info(product: Path, found: JsonObject) -> None:
    """A product at a glance, and how to open it or go on with it."""
    print_warnings(found["warnings"])
    for name, text in _facts(found).items():
        if text:
            print(pair(name, text, 8))
    if found["state"] == "complete":
        print_product(product)
    else:
        print(fold("`nightglass render SCENE -o PRODUCT --resume` goes on with it"))


def _facts(found: JsonObject) -> dict[str, str]:
    rows, columns = found["shape"] or (0, 0)
    size = found["field_deg"] or (0.0, 0.0)
    return {
        "scene": f"{found['scene']}, {found['epoch']}, seed {found['seed']}",
        "state": f"{found['state']}, {found['tiles']} of {found['tiles_expected']} tiles",
        "frames": f"{found['frames']} of {rows} x {columns} px, {size[0]:.4g} x {size[1]:.4g} deg",
        "layers": ", ".join(found["layers"] or ()),
        "targets": str(found["targets"]),
        "stars": f"from {found['catalogue']}" if found["catalogue"] else "none",
        "truth": ", ".join(f"{n} {kind}" for kind, n in (found["truth_rows"] or {}).items()),
        "size": f"{found['bytes'] / 1e6:.4g} MB",
        "made by": f"nightglass {found['version']}" if found["version"] else "",
        "digest": found["content_digest"] or "",
    }


def print_product(product: Path) -> None:
    """What lies in a product, and where."""
    for name, what in CONTENTS.items():
        if (product / name).exists():
            print(fold(what, " " * 6, f"  {product / name}  "))


@contextmanager
def progress_listener(unit: str, quiet: bool) -> Iterator[Callable[[Any], None] | None]:
    """A listener that shows what is done, what failed and the time left on stderr.

    It hears of `done`, `total` and, where there is one, `failed`.
    """
    if quiet:
        yield None
        return
    with progress_bar(unit) as bar:
        task = bar.add_task("planning", total=None)

        def listen(progress: Any) -> None:
            failed = f", {progress.failed} failed" if getattr(progress, "failed", 0) else ""
            bar.update(
                task, total=progress.total, completed=progress.done, description=f"running{failed}"
            )

        yield listen


def print_report(report: JsonObject, product: Path | str) -> None:
    """What a render ends with: frames, seconds, errors, notes."""
    seconds = report["seconds"]
    errors = report["errors"]
    print_warnings(report["warnings"])
    taken_s = seconds["plan_s"] + seconds["draw_s"] + seconds["finish_s"]
    when = "whole before, nothing was drawn" if "drawn_before" in report else f"in {taken_s:.2f} s"
    print(f"{product}: {report['frames']} frame(s), {report['tiles']} tile(s) {when}")
    print(
        f"  error bound at the noise floor {errors['bound_of_all_approximations_sigma']:.2g} sigma "
        f"(asked {errors['asked_sigma']}), WCS to {errors['wcs_residual_px']:.1e} px"
    )
    if errors["achieved_error_sigma"] is not None:
        print(
            f"  error found by drawing {errors['windows']} windows again: "
            f"{errors['achieved_error_sigma']:.4f} sigma, {errors['achieved_error_e']:.2g} e-"
        )
    if errors["windows_skipped"]:
        skipped = errors["windows_skipped"]
        print(f"  error not looked for in {skipped} more window(s): their sources take too long")
    if errors["common_streak_px"] > 0:
        share = errors["common_streak_px"]
        print(f"  stars share streaks that differ by up to {share:.1e} px at their ends")
    for remark in report["remarks"]:
        print(fold(remark, " " * 8, "  note: "))
