"""Catalogues: ingest and cones beside hats-import and LSDB, the same work on the same files.

Run: python -m benchmarks.catalog --workdir DIR [--json FILE] [--rows N] [--small] [--only cones].
Makes (and keeps) in DIR: a synthetic set of files in Gaia DR2's layout, a catalogue with three
fields of DR2's real density, and a virtual environment with the peers and isal, which their reader
then uses. CPU is user + system time of the whole process tree; page cache warm.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import psutil

from benchmarks.catalog_peers import TYPES, arrow_types, timed

Row = dict[str, Any]
DR2_ROWS = 1_692_919_135
WORKERS = 2
PEERS_SCRIPT = Path(__file__).with_name("catalog_peers.py")
# Name, ra, dec [deg]; the fields that are complete around them: radius [deg], limiting G.
PLACES = (
    ("north galactic pole", 192.86, 27.13, ((5.2, 21.0),)),
    ("latitude -26, 14,000 stars/deg2", 318.7, 9.4, ((5.2, 21.0),)),
    ("galactic plane at longitude 90", 318.0, 48.3, ((5.2, 16.0), (1.2, 21.0))),
)
ALL_SKY_G_MAG = 12.0


def run(command: Sequence[str | Path]) -> Row:
    """Run a command: wall seconds, CPU seconds of its process tree, peak of its largest process.

    Processes are looked at ten times a second; what a process did after its last look is taken
    from the kernel's account of children, where that is larger.
    """
    started = time.perf_counter()
    process = subprocess.Popen(
        [str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    seen: dict[int, tuple[float, float]] = {}
    watch = threading.Thread(target=_watch, args=(process.pid, seen), daemon=True)
    watch.start()
    before = os.times()
    out, errors = process.communicate()
    wall, after = time.perf_counter() - started, os.times()
    watch.join()
    if process.returncode:
        raise SystemExit(f"{' '.join(map(str, command))} failed:\n{errors[-3000:]}")
    account = sum(after[2:4]) - sum(before[2:4])
    cpu = max(account, sum(seconds for seconds, _ in seen.values()))
    peak = max(peak for _, peak in seen.values())
    return {"wall_s": wall, "cpu_s": cpu, "peak_mib": peak, "out": out}


def _watch(pid: int, seen: dict[int, tuple[float, float]]) -> None:
    """Note CPU seconds and peak memory [MiB] of a process and its descendants until it ends."""
    root = psutil.Process(pid)
    while root.is_running() and root.status() != psutil.STATUS_ZOMBIE:
        try:
            tree = [root, *root.children(recursive=True)]
        except psutil.NoSuchProcess:
            return
        for process in tree:
            try:
                status = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
                peak = int(status.split("VmHWM:")[1].split()[0]) / 1024.0
                seen[process.pid] = (sum(process.cpu_times()[:2]), peak)
            except (psutil.NoSuchProcess, OSError, IndexError):
                continue
        time.sleep(0.1)


def make_peers(folder: Path) -> Path:
    """The Python of a virtual environment with the peers, made on demand."""
    python = folder / "bin" / "python"
    if not (folder / ".ready").exists():
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        wanted = ["hats-import", "lsdb", "isal"]
        subprocess.run([python, "-m", "pip", "install", "--quiet", *wanted], check=True)
        (folder / ".ready").touch()
    return python


def measure_ingest(files: Path, work: Path, peers: Path) -> list[Row]:
    """Ingest of the same files by everyone, ten columns."""
    rows = json.loads((files / "_made.jsonl").read_text().splitlines()[0])["synthetic_rows"]
    ours, theirs = work / "ours", work / "theirs"
    cli = [sys.executable, "-m", "pipeline", "catalog", "ingest", files, "-o"]
    peer = [peers, PEERS_SCRIPT, "import", files, theirs, WORKERS]
    limit = [sys.executable, "-m", "benchmarks.catalog", "--limit", files, "--workdir", work]
    # Name, command, output, workers in each process.
    cases: list[tuple[str, list[Any], Path | None, int]] = [
        ("nightglass", [*cli, ours, "--workers", WORKERS, "--json"], ours, WORKERS),
        ("nightglass, 1 worker", [*cli, ours, "--workers", 1, "--json"], ours, 1),
        ("hats-import, zstd-3", [*peer, "zstd-3"], theirs, 1),
        ("hats-import, as it comes (zstd-15)", [*peer, "default"], theirs, 1),
        ("bare limit: gunzip (isal) + pyarrow.csv, 1 thread", limit, None, 1),
    ]
    results = []
    for name, command, output, workers in cases:
        for folder in (ours, theirs, work / "tmp"):
            shutil.rmtree(folder, ignore_errors=True)
        found = run(command)
        size = _size(output) if output else 0
        results.append({
            "case": name, "rows": rows, "rows_per_cpu_s": rows / found["cpu_s"],
            "wall_s": found["wall_s"], "cpu_s": found["cpu_s"],
            "peak_of_a_process_mib": found["peak_mib"], "workers_in_it": workers,
            "bytes_per_row": size / rows or None,
        })  # fmt: skip
        print_ingest(results[-1])
    return results


def print_ingest(r: Row) -> None:
    size = f", {r['bytes_per_row']:.1f} B/row" if r["bytes_per_row"] else ""
    print(
        f"{r['case']:>50}: {r['rows_per_cpu_s']:,.0f} rows/CPU-s, {r['wall_s']:.1f} s wall, "
        f"peak of a process {r['peak_of_a_process_mib']:.0f} MiB "
        f"({r['workers_in_it']} workers in it){size}", flush=True,
    )  # fmt: skip


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def read_everything(files: Path) -> None:
    """The bare limit: decompress and parse ten columns of every file, on one thread."""
    import pyarrow as pa
    import pyarrow.csv as pacsv
    from isal import igzip

    wanted = pacsv.ConvertOptions(include_columns=list(TYPES), column_types=arrow_types())
    once = pacsv.ReadOptions(use_threads=False, block_size=8 << 20)
    for path in sorted(files.glob("Gaia*.csv.gz")):
        data = pa.py_buffer(igzip.decompress(path.read_bytes()))
        for _ in pacsv.open_csv(pa.BufferReader(data), once, convert_options=wanted):
            pass


def make_catalogue(folder: Path, small: bool) -> None:
    """All sky to G = 12, and the fields of PLACES."""
    from catalog_tools.partition import ROWS_PER_LEAF
    from catalog_tools.synthetic.synthetic import make_demo

    if folder.exists():
        return
    fields = [
        (ra, dec, radius, min(g_mag, 16.5) if small else g_mag)
        for _, ra, dec, around in PLACES
        for radius, g_mag in around
    ]
    limit = 9.0 if small else ALL_SKY_G_MAG
    make_demo(folder, faintest_g_mag=limit, deep_fields=fields, rows_per_leaf=ROWS_PER_LEAF)


def queries() -> list[Row]:
    """Cones of 1 and 5 degrees at three limits, wherever the catalogue is complete."""
    asked = []
    for place, ra, dec, fields in PLACES:
        for radius in (1.0, 5.0):
            for g_mag in (12.0, 16.0, 21.0):
                if any(radius < reach and g_mag <= limit for reach, limit in fields):
                    asked.append({"place": place, "ra_deg": ra, "dec_deg": dec,
                                  "radius_deg": radius, "faintest_g_mag": g_mag})  # fmt: skip
    return asked


def measure_cones(catalogue: Path, work: Path, peers: Path) -> list[Row]:
    """Every cone by both, in a process of its own each."""
    asked = work / "queries.json"
    asked.write_text(json.dumps(queries()), encoding="utf-8")
    ours = run(
        [sys.executable, "-m", "benchmarks.catalog", "--cones", catalogue, "--workdir", work]
    )
    theirs = run([peers, PEERS_SCRIPT, "cones", catalogue, asked])
    results = []
    for query, us, them in zip(
        queries(), *(json.loads(r["out"].splitlines()[-1])["cones"] for r in (ours, theirs)),
        strict=True,
    ):  # fmt: skip
        results.append({
            **query, "rows": us["rows"], "same_ids": us["ids"] == them["ids"],
            "ms": us["median_ms"], "bytes": us["bytes_read"],
            "lsdb_ms": them["median_ms"], "lsdb_bytes": them["bytes_read"],
        })  # fmt: skip
        print_cone(results[-1])
    return results


def print_cone(r: Row) -> None:
    print(
        f"{r['place']:>32}, {r['radius_deg']:g} deg, G < {r['faintest_g_mag']:g}: "
        f"{r['rows']:>9,} stars, {r['ms']:.1f} ms, {r['bytes'] / 1e6:.2f} MB; "
        f"LSDB {r['lsdb_ms']:.0f} ms, {r['lsdb_bytes'] / 1e6:.1f} MB; "
        f"{'same' if r['same_ids'] else 'OTHER'} source_ids", flush=True,
    )  # fmt: skip


def our_cones(catalogue: Path) -> Row:
    """Every query by Nightglass: catalogue open, ten columns."""
    from catalog_tools.catalogue import open_catalogue
    from catalog_tools.query.query import cone

    opened = open_catalogue(catalogue)

    def ask(query: Row) -> Any:
        names = ("ra_deg", "dec_deg", "radius_deg", "faintest_g_mag")
        table, _ = cone(opened, *(query[name] for name in names))
        return table["source_id"].to_numpy()

    return {"cones": [timed(lambda query=query: ask(query)) for query in queries()]}


def extrapolate(ingests: Sequence[Row], files: Path) -> Row:
    """What all of DR2 would take at these rates."""
    ours, limit = ingests[0], ingests[-1]
    packed = _size(files) / ours["rows"]
    whole = DR2_ROWS / ours["rows"]
    result = {
        "rows": DR2_ROWS, "core_hours": DR2_ROWS / ours["rows_per_cpu_s"] / 3600.0,
        "hours_on_2_cores": ours["wall_s"] * whole / 3600.0,
        "share_of_bare_limit": ours["rows_per_cpu_s"] / limit["rows_per_cpu_s"],
        "read_gb": packed * DR2_ROWS / 1e9, "catalogue_gb": ours["bytes_per_row"] * DR2_ROWS / 1e9,
        "read_mb_s_on_2_cores": packed * ours["rows"] / ours["wall_s"] / 1e6,
    }  # fmt: skip
    print(
        f"all of DR2: {result['core_hours']:.1f} core-hours, {result['hours_on_2_cores']:.1f} h on "
        f"2 cores; reads {result['read_gb']:.0f} GB at {result['read_mb_s_on_2_cores']:.0f} MB/s, "
        f"writes {result['catalogue_gb']:.0f} GB. {result['share_of_bare_limit']:.0%} of its CPU "
        "time is what decompressing and splitting the text takes at the least."
    )
    return result


def machine(peers: Path) -> Row:
    """What it ran on, and the versions of everything."""
    model = [
        x for x in Path("/proc/cpuinfo").read_text().splitlines() if x.startswith("model name")
    ]
    code = "import json, importlib.metadata as m\n"
    code += (
        "print(json.dumps({n: m.version(n) for n in ('hats-import', 'hats', 'lsdb', 'pyarrow')}))"
    )
    out = subprocess.run([peers, "-c", code], capture_output=True, text=True, check=True).stdout
    ours = ("nightglass", "pyarrow", "isal", "numpy")
    return {
        "machine": f"{platform.machine()}, {model[0].split(':')[1].strip() if model else ''}",
        "cores": os.cpu_count(), "python": platform.python_version(),
        "ours": {name: version(name) for name in ours}, "peers": json.loads(out),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workdir", type=Path, required=True, help="some 20 GB for 4 million rows")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--rows", type=int, default=4_000_000)
    parser.add_argument("--small", action="store_true", help="200,000 rows, shallow fields")
    parser.add_argument("--csv", type=Path, help="a folder of such files that is there already")
    parser.add_argument("--peers", type=Path, help="a virtual environment that is there already")
    parser.add_argument("--only", choices=("ingest", "cones"), help="a part of the measurements")
    parser.add_argument("--limit", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--cones", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.limit:
        return read_everything(args.limit)
    if args.cones:
        return print(json.dumps(our_cones(args.cones)))
    work: Path = args.workdir
    work.mkdir(parents=True, exist_ok=True)
    rows = 200_000 if args.small else args.rows
    files = args.csv or work / f"csv_{rows}"
    if not args.csv and args.only != "cones":
        from catalog_tools.synthetic.csv import write_csv_files

        write_csv_files(files, rows)
    peers = make_peers(args.peers or work / "peers")
    result: Row = machine(peers)
    if args.only != "cones":
        result["ingest"] = measure_ingest(files, work, peers)
        result["whole_dr2"] = extrapolate(result["ingest"], files)
    if args.only != "ingest":
        catalogue = work / ("cones_small" if args.small else "cones")
        make_catalogue(catalogue, args.small)
        result["cones"] = measure_cones(catalogue, work, peers)
    if args.json:
        args.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return None


if __name__ == "__main__":
    main()
