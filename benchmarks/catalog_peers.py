"""The peers' side of `benchmarks.catalog`: hats-import and LSDB, run by the Python that has them.

    python catalog_peers.py import CSV_FOLDER OUTPUT WORKERS zstd-3|default
    python catalog_peers.py cones CATALOGUE QUERIES.json

Imports nothing of Nightglass. Prints one line of JSON.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

# The types that Nightglass stores; it also rounds them (catalog_tools.columns), peers do not.
TYPES = {
    "source_id": "int64", "ra": "float64", "dec": "float64", "pmra": "float32",
    "pmdec": "float32", "parallax": "float32", "radial_velocity": "float32",
    "phot_g_mean_mag": "float32", "phot_bp_mean_mag": "float32", "phot_rp_mean_mag": "float32",
}  # fmt: skip
REPEATS = 7


def arrow_types() -> dict[str, Any]:
    """TYPES as pyarrow has them."""
    import pyarrow as pa

    return {name: pa.type_for_alias(kind) for name, kind in TYPES.items()}


def import_files(source: str, output: str, workers: str, compression: str) -> dict[str, Any]:
    """One hats-import run: its fastest reader (pyarrow), the ten columns, `workers` processes."""
    import pyarrow.csv as pacsv
    from hats_import.catalog.arguments import ImportArguments
    from hats_import.catalog.file_readers.csv import CsvPyarrowReader
    from hats_import.pipeline import pipeline

    reader = CsvPyarrowReader(
        compression="gzip",
        column_names=list(TYPES),
        read_options=pacsv.ReadOptions(block_size=8 << 20, use_threads=False),
        convert_options=pacsv.ConvertOptions(column_types=arrow_types()),
    )
    squeeze = {"compression": "zstd", "compression_level": 3} if compression == "zstd-3" else None
    pipeline(
        ImportArguments(
            input_file_list=sorted(Path(source).glob("Gaia*.csv.gz")),
            file_reader=reader,
            output_path=Path(output).parent,
            output_artifact_name=Path(output).name,
            ra_column="ra",
            dec_column="dec",
            pixel_threshold=1_000_000,
            write_table_kwargs=squeeze,
            dask_n_workers=int(workers),
            dask_threads_per_worker=1,
            tmp_dir=Path(output).parent / "tmp",
            resume=False,
            progress_bar=False,
        )
    )
    return {"versions": {name: version(name) for name in ("hats-import", "hats", "pyarrow")}}


def bytes_read() -> int:
    """Bytes that this process has read by system calls."""
    text = Path("/proc/self/io").read_text(encoding="ascii")
    return int(text.split("rchar:")[1].split()[0])


def timed(ask: Any) -> dict[str, Any]:
    """A query once to warm up, then REPEATS times: median ms, bytes of the last, digest of ids.

    ask : without arguments; returns the source_ids found, in any order.
    """
    ask()
    times = []
    for _ in range(REPEATS):
        before, started = bytes_read(), time.perf_counter()
        ids = ask()
        times.append(time.perf_counter() - started)
        read = bytes_read() - before
    numbers = sorted(int(i) for i in ids)
    digest = hashlib.sha256(repr(numbers).encode()).hexdigest()
    median_ms = 1e3 * sorted(times)[REPEATS // 2]
    return {"median_ms": median_ms, "bytes_read": read, "rows": len(numbers), "ids": digest}


def cones(catalogue: str, queries: str) -> dict[str, Any]:
    """Every query by LSDB: catalogue open, ten columns, the magnitude as a filter on reading."""
    import lsdb

    results = []
    for query in json.loads(Path(queries).read_text(encoding="utf-8")):
        limit: Any = [("phot_g_mean_mag", "<=", query["faintest_g_mag"])]
        opened = lsdb.open_catalog(catalogue, columns=list(TYPES), filters=limit)

        def ask(opened: Any = opened, query: dict[str, Any] = query) -> Any:
            centre = (query["ra_deg"], query["dec_deg"])
            found: Any = opened.cone_search(*centre, radius_arcsec=3600.0 * query["radius_deg"])
            return found.compute()["source_id"]

        results.append(timed(ask))
    return {"versions": {name: version(name) for name in ("lsdb", "hats")}, "cones": results}


if __name__ == "__main__":
    asked: dict[str, Any] = {"import": import_files, "cones": cones}
    print(json.dumps(asked[sys.argv[1]](*sys.argv[2:])))
