"""The report's tables: the levels of each scene, and its approximations one by one."""

from __future__ import annotations

from collections.abc import Iterator

from catalog_tools.documents import JsonObject
from pipeline.lines import fold, table

Row = JsonObject
Table = tuple[tuple[str, ...], list[tuple[str, ...]]]

LEVEL_HEADS = (
    "scene",
    "asked, sigma",
    "CPU s",
    "again",
    "wall s",
    "peak MB",
    "largest error, sigma",
    "rms",
    "bias of light",
    "allowed, sigma",
    "over found",
    "of allowed",
)
SWITCH_HEADS = ("scene", "approximation", "bound", "error caused", "CPU s with", "without", "holds")
NOTES = (
    "CPU s: of a whole render by a process of its own: planning, tables, drawing, product on disk; "
    "imports and the start of Python are not in it, the loading of compiled code is. `again`: the "
    "same once more in that process. Peak: the process's own high-water mark (VmHWM).",
    "Errors are those of the noise-free mean in windows of 16 x 16 pixels against the reference "
    "path: every source at its exact place, along its own path, by the sum of its phases in double "
    "precision, wings on half the grid, the sky in each pixel, planned four times finer than the "
    "finest level. The windows are around the brightest stars and targets, at a streak's end, at "
    "random, and where each level errs most: on the sources that are just faint enough for a way "
    "of drawing, and where their cores end.",
    "Allowed: the sum of all bounds that the plan states, in a pixel away from bright sources and "
    "in the window's most favoured pixel (a source's wavelengths and wings may err by a fraction "
    "of its light); `over found`: the first of these over the largest error; `of allowed`: the "
    "largest fraction of what is allowed that any pixel used. 1 or less: it holds.",
    "One approximation at a time was switched off, at 0.05 sigma; `CPU s`: drawing the light of "
    "the frame once tables are there (~: scaled up from a part of the frame). Bounds marked * are "
    "shares of a source's light, times the brightest one's that reaches a window (all of it where "
    "wings end).",
)


def level_table(study: Row) -> Table:
    """A row for each scene and level."""
    return LEVEL_HEADS, [
        (
            scene["title"],
            f"{r['noise_fraction']:g}",
            _seconds(r["cpu_s"]),
            _seconds(r["again_cpu_s"]),
            _seconds(r["wall_s"]),
            f"{r['peak_mb']:.0f}",
            f"{r['max_sigma']:.1e}",
            f"{r['rms_sigma']:.1e}",
            f"{r['bias']:+.0e}",
            f"{r['bound_sigma'][0]:.2g}-{r['bound_sigma'][1]:.2g}",
            _times(r["bound_sigma"][0], r["max_sigma"]),
            f"{r['of_bound']:.2g}",
        )
        for scene in study["scenes"]
        for r in scene["levels"]
    ]


def _seconds(s: float) -> str:
    return f"{s:.2f}" if s < 10.0 else f"{s:.1f}"


def _times(allowed: float, found: float) -> str:
    return f"{allowed / found:.2g}" if found else "-"


def switch_table(study: Row) -> Table:
    """A row for each scene and approximation."""
    return SWITCH_HEADS, [(scene["title"], *_switch(s)) for scene, s in _switches(study)]


def _switches(study: Row) -> Iterator[tuple[Row, Row]]:
    for scene in study["scenes"]:
        for s in scene["switches"]:
            yield scene, s


def _switch(s: Row) -> tuple[str, ...]:
    if s["of_light"]:
        bound, error = f"{s['bound_e']:.2g} e- *", f"{s['error_e']:.2g} e-"
    else:
        bound, error = f"{s['bound_sigma']:.2g} sigma", f"{s['error_sigma']:.2g} sigma"
    scaled = "~" if s["scaled_from"] else ""
    return (
        s["component"],
        bound,
        error,
        f"{s['seconds_on']:.2g}",
        f"{scaled}{s['seconds_off']:.2g}",
        "yes" if s["holds"] else "NO",
    )


def explained(study: Row) -> list[str]:
    """What was measured, and how."""
    m = study["machine"]
    load = "" if m["load_before"] is None else f", load {m['load_before']:.1f} before it"
    head = (
        f"Nightglass {study['nightglass']}, {m['cores']} cores of {m['processor']}{load}; "
        f"{study['catalogue']} catalogue" + ("; quick" if study["quick"] else "") + "."
    )
    return [head, *NOTES]


def print_study(study: Row) -> None:
    """The study on the terminal."""
    for heads, rows in (level_table(study), switch_table(study)):
        print(table(heads, rows, 2), end="\n\n")
    for line in explained(study):
        print(fold(line))
