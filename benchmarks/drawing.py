"""Stars onto 2048x2048 pixels: CPU seconds of the engines on one core, their errors, and peers.

Run: python -m benchmarks.drawing [--json FILE]. Stars of equal light at random places; Gaussian
sigma 0.8 px, and the core (12 px) of an Airy pattern with Q = 1 and 0.3 obscured. Seconds are
medians of three, of drawing alone; plans and tables are made once and told apart. Errors are the
largest over the pixels about isolated stars, relative to their brightest pixel: against erf and
quadrature in time (Gaussian), against one float64 transform for each star (Airy core).
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path as File
from typing import Any

import numpy as np
from scipy.special import erf

from pipeline.errors import BadInput
from pipeline.physics.drawing.along import swept_spectrum
from pipeline.physics.drawing.spectral import Sources, draw_spectral, transfer_table
from pipeline.physics.drawing.spectral_band import peak_light
from pipeline.physics.drawing.spectral_plan import SpectralPlan, plan_spectral
from pipeline.physics.drawing.stamps import draw_stamps
from pipeline.physics.motion.streak import Path, pieces, transfer
from pipeline.physics.psf.product import ProductResponse, is_product, product_table
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.psf.response import (
    Core,
    PixelResponse,
    compact_core,
    core_spectrum,
    frequencies,
    phase_table,
    stamp_at,
    window,
)

Array = np.ndarray
SIZE, SIGMA_PX, AIRY_RADIUS_PX, OBSCURED = 2048, 0.8, 12.0, 0.3
COUNTS, LENGTHS_PX, ANGLE_RAD = (10_000, 100_000, 1_000_000), (0.0, 60.0, 300.0), 0.6435
MOST_STREAKED = 10_000  # stars that the stamps engine draws with streaks
PHASES, CELL_PX = {"gaussian": 16, "airy": 32}, (32, 64)
WITHIN = 1e-3  # of the peak: engines with larger errors are omitted from the table
GOALS = {  # CPU seconds, by response and length, of each count
    ("gaussian", 0.0): (0.01, 0.03, 0.2), ("airy", 0.0): (0.02, 0.08, 0.4),
    ("gaussian", 60.0): (0.3, 0.33, 0.4), ("airy", 60.0): (0.3, 0.33, 0.4),
    ("gaussian", 300.0): (0.35, 0.4, 0.5), ("airy", 300.0): (0.35, 0.4, 0.5),
}  # fmt: skip
BLURS = {"gaussian": Blur(Gaussian(SIGMA_PX)), "airy": Blur(Airy(1.0, OBSCURED))}
CORES = {
    "gaussian": lambda: compact_core(BLURS["gaussian"], 6.1 * SIGMA_PX),
    "airy": lambda: compact_core(BLURS["airy"], AIRY_RADIUS_PX),
}
SHOWN = {
    "error": "error {:.1e}", "stated": "stated {:.1e}", "plan_s": "plan {:.2f} s",
    "table_s": "table {:.2f} s", "mb": "{:.0f} MB", "two_threads": "two threads x{:.2f}",
}  # fmt: skip
Draw = Callable[[Array, Array], Array]


def line(length_px: float) -> Path:
    """A straight, even streak about its middle."""
    x, y = 0.5 * length_px * np.cos(ANGLE_RAD), 0.5 * length_px * np.sin(ANGLE_RAD)
    return Path(np.array([-x, x]), np.array([-y, y]), np.ones(1))


def cpu_seconds(work: Callable[[], Any], times: int = 3) -> float:
    """Median CPU seconds of this process."""
    taken = []
    for _ in range(times):
        started = time.process_time()
        work()
        taken.append(time.process_time() - started)
    return sorted(taken)[times // 2]


def wall_seconds(work: Callable[[], Any], times: int = 5) -> float:
    """Shortest wall-clock seconds: what it takes when nothing else runs."""
    taken = []
    for _ in range(times):
        started = time.perf_counter()
        work()
        taken.append(time.perf_counter() - started)
    return min(taken)


def exact_gaussian(shape: tuple[int, int], x: float, y: float, path: Path) -> Array:
    """A moving Gaussian: Gauss-Legendre in time, erf in space."""
    nodes, weights = np.polynomial.legendre.leggauss(16)
    parts = int(path.length_px / SIGMA_PX) + 1
    t = ((np.arange(parts)[:, None] + 0.5 + 0.5 * nodes) / parts).ravel()
    sides = []
    for n, at, ends in ((shape[0], y, path.y_px), (shape[1], x, path.x_px)):
        middle = at + ends[0] + t * (ends[1] - ends[0])
        edges = (np.arange(n + 1) - 0.5 - middle[:, None]) / (SIGMA_PX * np.sqrt(2.0))
        sides.append(0.5 * np.diff(erf(edges), axis=1))
    return (np.tile(0.5 * weights / parts, parts)[:, None] * sides[0]).T @ sides[1]


def exact_core(core: Core, shape: tuple[int, int], x: float, y: float, path: Path) -> Array:
    """A moving core from its samples, one transform for each star, in float64."""
    half = window(core, float(np.abs(path.y_px).max()), float(np.abs(path.x_px).max()))
    swept = transfer(*frequencies(core, *half[2:]), path.x_px, path.y_px, path.weight)
    spectrum = core_spectrum(core, *half[2:]) * swept
    row, column, stamp = stamp_at(core, spectrum, half[:2], half[2:], y, x)
    image = np.zeros(shape)
    image[row : row + stamp.shape[0], column : column + stamp.shape[1]] = stamp
    return image


def worst_error(core: Core, name: str, path: Path, draw: Draw) -> float:
    """Largest error near 12 stars that stand apart, over the peak of the brightest pixel."""
    rng, step, worst, peak = np.random.default_rng(2), SIZE // 4, 0.0, 0.0
    x, y = (step * (k + 0.5) + rng.uniform(-1.0, 1.0, 12) for k in np.divmod(np.arange(12), 4))
    image = draw(x, y)
    for k in range(12):
        x0, y0 = (int(v[k]) - step // 2 for v in (x, y))
        at = (step, step), x[k] - x0, y[k] - y0, path
        exact = exact_gaussian(*at) if name == "gaussian" else exact_core(core, *at)
        part = image[max(0, y0) : y0 + step, max(0, x0) : x0 + step]
        exact = exact[max(0, -y0) : max(0, -y0) + len(part), max(0, -x0) :][:, : part.shape[1]]
        worst = max(worst, float(np.abs(part - exact).max()))
        peak = max(peak, float(exact.max()))
    return worst / peak


def spectral(name: str, length_px: float, asked: float) -> dict[str, Any]:
    """Seconds and error of the spectral engine at an error of `asked` of the peak."""
    core, path = CORES[name](), line(length_px)
    error = asked * peak_light(core, path)
    row: dict[str, Any] = {"engine": f"spectral {asked:g}", "response": name, "length": length_px}
    row["plan_s"] = cpu_seconds(partial(plan_spectral, (SIZE, SIZE), core, path, error))
    for count in COUNTS:
        plan = plan_spectral((SIZE, SIZE), core, path, error, sources=count)
        table = transfer_table(core, plan)
        draw = partial(_draw, plan, table, path)
        row[str(count)] = cpu_seconds(partial(draw, *places(count)))
        if count == COUNTS[1]:
            row["table_s"] = cpu_seconds(partial(transfer_table, core, plan))
            row["mb"], row["stated"] = plan.bytes / 1e6, plan.error / error * asked
            row["error"] = worst_error(core, name, path, draw)
            one, two = (wall_seconds(partial(draw, *places(count), n)) for n in (1, 2))
            row["two_threads"] = one / two
    return row


def _draw(
    plan: SpectralPlan, table: Array, path: Path, x: Array, y: Array, threads: int = 1
) -> Array:
    return draw_spectral(plan, table, [Sources(x, y, np.ones(x.size), path)], (0, 0), threads)


def stamps(name: str, length_px: float) -> dict[str, Any]:
    """Seconds and error of the stamps engine: products, or linear between the phases of a table."""
    core, path = CORES[name](), line(length_px)
    engine = "products" if is_product(BLURS[name], length_px) else "stamps"
    row: dict[str, Any] = {"engine": engine, "response": name, "length": length_px}
    started = time.process_time()
    tables = [
        (x0, y0, stamp_table(name, core, piece), share) for x0, y0, piece, share in pieces(path)
    ]
    row["table_s"] = time.process_time() - started

    def draw(x: Array, y: Array) -> Array:
        image, cubic = np.zeros((SIZE, SIZE)), np.zeros(x.size, bool)
        for x0, y0, table, share in tables:
            draw_stamps(image, (0, 0), table, x + x0, y + y0, np.full(x.size, share), cubic)
        return image

    row["error"] = worst_error(core, name, path, draw)
    for count in COUNTS:
        if length_px == 0.0 or count <= MOST_STREAKED:
            x, y = by_cell(*places(count))
            row[str(count)] = cpu_seconds(partial(draw, x, y))
    return row


_TABLES: dict[tuple[str, Path], PixelResponse | ProductResponse] = {}


def stamp_table(name: str, core: Core, piece: Path) -> PixelResponse | ProductResponse:
    """The table of a piece of streak; equal pieces share one."""
    key = (name, piece)
    if key not in _TABLES and is_product(BLURS[name], piece.length_px):
        _TABLES[key] = product_table(BLURS[name], core.radius_px)
    elif key not in _TABLES:
        half = window(core, float(np.abs(piece.y_px).max()), float(np.abs(piece.x_px).max()))
        spectrum = swept_spectrum(core, piece, half[2:])
        _TABLES[key] = phase_table(core, spectrum, half[:2], half[2:], PHASES[name])
    return _TABLES[key]


def places(count: int) -> tuple[Array, Array]:
    """Where the stars are: (x, y), a little beyond the pixels too."""
    x, y = np.random.default_rng(1).uniform(-20.0, SIZE + 20.0, (2, count))
    return x, y


def by_cell(x: Array, y: Array) -> tuple[Array, Array]:
    """The same stars in cells of the frame, so that the pixels of a stamp stay in the cache."""
    order = np.lexsort((x // CELL_PX[1], y // CELL_PX[0]))
    return x[order], y[order]


def galsim_stars(name: str, length_px: float, stars: int = 20) -> dict[str, Any]:
    """Seconds a star of GalSim: FFT of response x streak x pixel, one stamp for each star."""
    import galsim

    psf = (
        galsim.Gaussian(sigma=SIGMA_PX)
        if name == "gaussian"
        else galsim.Airy(lam_over_diam=1.0, obscuration=OBSCURED)
    )
    if length_px:
        box = galsim.Box(length_px, 1e-3).rotate(ANGLE_RAD * galsim.radians)
        psf = galsim.Convolve(psf, box)
    radius = 6.1 * SIGMA_PX if name == "gaussian" else AIRY_RADIUS_PX
    nx, ny = (int(2 * radius + length_px * f) + 3 for f in (np.cos(ANGLE_RAD), np.sin(ANGLE_RAD)))
    rng = np.random.default_rng(3)
    shifts = rng.uniform(-0.5, 0.5, (stars, 2))

    def draw() -> None:
        for shift in shifts:
            psf.drawImage(nx=nx, ny=ny, scale=1.0, offset=tuple(shift))

    row = {"engine": f"GalSim {version('galsim')}", "response": name, "length": length_px}
    return {**row, "s_per_star": cpu_seconds(draw) / stars}


def photutils_stars(stars: int = 10_000) -> dict[str, Any]:
    """Seconds of photutils for Gaussian stars without streaks, 11 pixels wide."""
    from astropy.table import Table
    from photutils.datasets import make_model_image
    from photutils.psf import CircularGaussianPRF

    x, y = (np.clip(v, 6.0, SIZE - 7.0) for v in places(stars))
    table = Table({"x_0": x, "y_0": y, "flux": np.ones(stars)})
    model = CircularGaussianPRF(fwhm=SIGMA_PX * np.sqrt(8.0 * np.log(2.0)))
    seconds = cpu_seconds(
        lambda: make_model_image((SIZE, SIZE), model, table, model_shape=(11, 11)), 1
    )
    row = {"engine": f"photutils {version('photutils')}", "response": "gaussian", "length": 0.0}
    return {**row, "s_per_star": seconds / stars}


def measure() -> list[dict[str, Any]]:
    """All rows, each printed when it is there."""
    rows: list[dict[str, Any]] = []
    for name in CORES:
        for length in LENGTHS_PX:
            _show(rows, partial(stamps, name, length))
            for asked in (1e-3, 1e-5):
                _show(rows, partial(spectral, name, length, asked))
            _show(rows, partial(galsim_stars, name, length))
    _show(rows, photutils_stars)
    return rows


def _show(rows: list[dict[str, Any]], make: Callable[[], dict[str, Any]]) -> None:
    try:
        row = make()
    except (ImportError, PackageNotFoundError, BadInput) as reason:
        print(f"omitted: {reason}")
        return
    rows.append(row)
    goal = GOALS[row["response"], row["length"]]
    cells = []
    for count, most in zip(COUNTS, goal, strict=True):
        key = str(count)
        cells.append(f"{row[key]:7.3f}/{most:.2f}" if key in row else f"{'':>12}")
    seconds = " ".join(cells)
    if "s_per_star" in row:
        seconds = f"{1e3 * row['s_per_star']:.3f} ms a star"
    print(f"{row['response']:>9} {row['length']:4.0f} px {row['engine']:>16} {seconds}", end="")
    for key, text in SHOWN.items():
        if key in row:
            print("  " + text.format(row[key]), end="")
    print(flush=True)


def markdown(rows: list[dict[str, Any]]) -> str:
    """The quickest engine of each case at 1e-3 of peak, over its goal, as a table for the docs."""
    cases = [(name, length) for length in LENGTHS_PX for name in CORES]
    lines = ["| stars | " + " | ".join(f"{n}, {k:.0f} px" for n, k in cases) + " |"]
    lines.append("| --- " * (len(cases) + 1) + "|")
    for k, count in enumerate(COUNTS):
        cells = []
        for case in cases:
            mine = [r for r in rows if (r["response"], r["length"]) == case]
            found = [
                (r[str(count)], r["engine"].split()[0])
                for r in mine if str(count) in r and r["error"] <= WITHIN
            ]  # fmt: skip
            cells.append("{:.3f} s ({})".format(*min(found)) + f" / {GOALS[case][k]:g}")
        lines.append(f"| {count:,} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=File)
    args = parser.parse_args()
    print("CPU seconds of 1e4, 1e5 and 1e6 stars, each over its goal")
    rows = measure()
    print(markdown(rows))
    if args.json:
        machine = f"{platform.machine()}, {platform.python_version()}"
        out = {"machine": machine, "pixels": SIZE, "rows": rows}
        args.json.write_text(json.dumps(out, indent=2) + "\n")


if __name__ == "__main__":
    main()
