"""What the command line shows to people: progress bars, the plan, the contents of a product."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pipeline.run import Progress

Listener = Callable[["Progress"], None]


@contextmanager
def tile_progress(quiet: bool) -> Iterator[Listener | None]:
    """A listener that shows tiles done on stderr."""
    if quiet:
        yield None
        return
    with _bar() as bar:
        task = bar.add_task("planning", total=None)

        def listen(progress: Progress) -> None:
            bar.update(task, total=progress.total, completed=progress.done, description="rendering")

        yield listen


@contextmanager
def stage_progress(quiet: bool) -> Iterator[Callable[[str, int, int], None] | None]:
    """A listener for named stages with counts, on stderr."""
    if quiet:
        yield None
        return
    with _bar() as bar:
        tasks: dict[str, Any] = {}

        def listen(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=total)
            bar.update(tasks[stage], completed=done, total=total)

        yield listen


def _bar() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        console=Console(stderr=True), transient=True,
    )  # fmt: skip


def print_plan(plan: dict[str, Any], explain: bool = False) -> None:
    """The plan as a page: size, work, decisions with reasons and bounds; their rules too."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    predicted = plan["predicted"]
    facts = [
        ("frames", f"{plan['frames']} of {plan['shape'][0]} x {plan['shape'][1]} px"),
        ("tiles", f"{plan['tiles']} of {plan['tile_shape'][0]} x {plan['tile_shape'][1]} px"),
        ("field", "{:.4g} x {:.4g} deg, {:.3g} arcsec a pixel".format(
            *plan["field_deg"], plan["ifov_arcsec"])),
        ("shards", f"{plan['shards']} ({plan['row_groups']} row groups, "
                   f"{plan['star_rows_to_read']} rows, {plan['bytes_to_read'] / 1e6:.1f} MB)"),
        ("stars a frame", f"about {plan['stars_per_frame']}"),
        ("coverage", _coverage(plan["coverage"])),
        ("targets", str(plan["targets"])),
        ("engine", plan["engine"]),
        ("noise floor", f"{plan['noise_floor_e']:.3g} e- (sky {plan['background_e']:.3g} e-)"),
        ("predicted", f"{predicted['cpu_s']:.1f} CPU s, {predicted['worker_memory_mb']:.0f} MB "
                      f"a worker, product {predicted['product_mb']:.0f} MB before compression"),
    ]  # fmt: skip
    print_warnings(plan["warnings"])
    for name, text in facts:
        console.print(f"{name:>14}  {text}", highlight=False)
    table = Table("component", "", "reason", "bound e-", "bound sigma", "bound", show_edge=False)
    for d in plan["decisions"]:
        other = "" if d.get("bound") is None else f"{d['bound']:.2g} {d['unit']}"
        bounds = (_number(d["error_bound_e"]), _number(d["error_bound_sigma"]), other)
        reason = d["reason"]
        if explain and "rule" in d:
            reason += f"\nrule: {d['rule']}\nmeasured by: {d['measured_by']}"
        table.add_row(d["component"], "kept" if d["kept"] else "out", reason, *bounds)
    console.print(table)
    for remark in plan["remarks"]:
        console.print(f"note: {remark}", highlight=False)


def _coverage(said: dict[str, Any] | None) -> str:
    """How much of the frames the catalogue covers."""
    if said is None:
        return "no catalogue"
    if said["source"] is None:
        return "cannot be told from the catalogue's few rows"
    worst, mean = said["worst_frame_fraction"], said["mean_fraction"]
    return (
        f"{100 * worst:.3g}% of frame {said['worst_frame']}, {100 * mean:.3g}% of all "
        f"(by {said['source']})"
    )


def print_warnings(warnings: list[str]) -> None:
    """What is wrong in a product though the scene accepts it: before everything else."""
    from rich.console import Console

    for warning in warnings:
        Console().print(f"WARNING: {warning}", style="bold yellow", highlight=False, markup=False)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


CONTENTS = {
    "cube.zarr": "the frames: open with xarray.open_zarr",
    "truth/stars.parquet": "every star drawn: place, streak, light, SNR",
    "truth/targets.parquet": "every target: place, path, range, phase, light, SNR",
    "truth/pixels.parquet": "every bad, dead and hot pixel",
    "scene.yaml": "the scene as understood, defaults filled in",
    "plan.json": "what was used and left out, with error bounds",
    "report.json": "time, memory, errors, versions, digests",
    "preview.png": "the first frame as a picture",
}


def print_product(product: Path) -> None:
    """What lies in a product, and where."""
    for name, what in CONTENTS.items():
        if (product / name).exists():
            print(f"  {product / name}  {what}")
