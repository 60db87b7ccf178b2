"""The detection study as text: for a file, and for people at a terminal."""

from __future__ import annotations

from typing import Any

from pipeline.detection.finders import TITLES


def markdown(study: dict[str, Any]) -> str:
    """The study's tables in Markdown."""
    frames, sigma = study["frames"], study["threshold_sigma"]
    lines = [f"{study['product']}: {frames} frame(s), threshold {sigma:g} sigma\n"]
    lines += ["| finder | detections | right | on other sources | false alarms a frame |",
              "| --- | --- | --- | --- | --- |"]  # fmt: skip
    for kind, told in study["finders"].items():
        lines.append(
            f"| {TITLES[kind]} | {told['detections']} | {told['right']} | {told['fragments']} | "
            f"{told['false_alarms'] / frames:.1f} |"
        )
    for kind, told in study["finders"].items():
        bins = [b for b in told["stars"] if b["sought"]]
        if not bins:
            continue
        lines += [f"\nStars by {TITLES[kind]}:\n", "| G | sought | found | completeness |",
                  "| --- | --- | --- | --- |"]  # fmt: skip
        lines += [
            f"| {b['bright_mag']:g} to {b['faint_mag']:g} | {b['sought']} | {b['found']} | "
            f"{b['completeness']:.3f} |"
            for b in bins
        ]
    if study["targets"]:
        lines += ["\nTargets:\n", "| target | frame | SNR | streak [px] | finder | found |",
                  "| --- | --- | --- | --- | --- | --- |"]  # fmt: skip
        lines += [
            f"| {t['name']} | {t['frame']} | {t['snr']:.0f} | {t['length_px']:.1f} | "
            f"{TITLES[t['finder']]} | {'yes' if t['found'] else 'no'} |"
            for t in study["targets"]
        ]
    return "\n".join(lines) + "\n"


def print_study(study: dict[str, Any]) -> None:
    """The same on the screen."""
    print(markdown(study), end="")
