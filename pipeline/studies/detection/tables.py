"""The detection study as text: for a file, and for people at a terminal."""

from __future__ import annotations

from collections.abc import Iterator

from catalog_tools.documents import JsonObject
from pipeline.lines import fold, markdown_table, table
from pipeline.studies.detection.finders import TITLES

Part = tuple[str, tuple[str, ...], list[tuple[str, ...]], int]


def parts(study: JsonObject) -> Iterator[Part]:
    """The tables: title, heads, rows, and how many columns are text."""
    frames, sigma = study["frames"], study["threshold_sigma"]
    yield (
        f"{study['product']}: {frames} frame(s), threshold {sigma:g} sigma",
        ("finder", "detections", "right", "on other sources", "false alarms a frame"),
        [
            (
                TITLES[kind],
                str(told["detections"]),
                str(told["right"]),
                str(told["fragments"]),
                f"{told['false_alarms'] / frames:.1f}",
            )
            for kind, told in study["finders"].items()
        ],
        1,
    )
    for kind, told in study["finders"].items():
        bins = [b for b in told["stars"] if b["sought"]]
        if bins:
            yield (
                f"Stars by {TITLES[kind]}:",
                ("G", "sought", "found", "completeness"),
                [
                    (
                        f"{b['bright_mag']:g} to {b['faint_mag']:g}",
                        str(b["sought"]),
                        str(b["found"]),
                        f"{b['completeness']:.3f}",
                    )
                    for b in bins
                ],
                1,
            )
    if study["targets"]:
        yield (
            "Targets:",
            ("target", "finder", "frame", "SNR", "streak [px]", "found"),
            [
                (
                    t["name"],
                    TITLES[t["finder"]],
                    str(t["frame"]),
                    f"{t['snr']:.0f}",
                    f"{t['length_px']:.1f}",
                    "yes" if t["found"] else "no",
                )
                for t in study["targets"]
            ],
            2,
        )


def markdown(study: JsonObject) -> str:
    """The study's tables in Markdown."""
    return "\n".join(
        f"{title}\n\n{markdown_table(heads, rows, len(heads))}"
        for title, heads, rows, _ in parts(study)
    )


def print_study(study: JsonObject) -> None:
    """The same on the terminal."""
    for title, heads, rows, texts in parts(study):
        print(fold(title))
        print(table(heads, rows, texts), end="\n\n")
