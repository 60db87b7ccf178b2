"""An ingest killed at random moments, in every pass, ends with the undisturbed catalogue's bits."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pytest
from star_rows import random_stars, same_rows, write_csv

from catalog_tools.catalogue import open_catalogue
from catalog_tools.ingest.ingest import ingest
from catalog_tools.query.query import cone
from tests.slow import slow

KILLS = 5

# One process imports everything, then forks: a child ingests, and is killed after a random while.
DRIVER = """
import json, os, random, signal, sys, time
from pathlib import Path
import healpy, pyarrow.parquet, pyarrow.csv
from catalog_tools.ingest import build
from catalog_tools.ingest.ingest import ingest

build.BATCH_SOURCES = 2
source, folder, kills = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])


def run(destination):
    child = os.fork()
    if child:
        return child
    try:
        ingest([source], destination, rows_per_leaf=150, workers=1)
    except BaseException as error:
        print(error, file=sys.stderr, flush=True)
        os._exit(1)
    os._exit(0)


def seconds(destination):
    start = time.monotonic()
    assert os.waitstatus_to_exitcode(os.waitpid(run(destination), 0)[1]) == 0
    return time.monotonic() - start


whole = seconds(folder / "undisturbed")
rng, done, moments, number = random.Random(7), 0, [], 0
while done < kills:
    destination = folder / f"killed-{number}"
    child = run(destination)
    moment = rng.uniform(0.0, whole)
    time.sleep(moment)
    os.kill(child, signal.SIGKILL)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (0, -signal.SIGKILL), code
    done += code != 0
    visible = destination.exists()
    moments.append([number, round(moment, 3), code, visible])
    number += visible
if not (folder / f"killed-{number}").exists():
    seconds(folder / f"killed-{number}")
print(json.dumps({"whole_s": whole, "moments": moments, "last": number}))
"""


def content(root: Path) -> dict[str, str]:
    """Digest of every file by name; the properties without the date on which they were made."""
    found = {}
    for path in sorted(p for p in root.rglob("*") if p.is_file()):
        data = path.read_bytes()
        if path.name.endswith("properties"):
            lines = [x for x in data.splitlines() if not x.startswith(b"hats_creation_date")]
            data = b"\n".join(lines)
        found[str(path.relative_to(root))] = hashlib.sha256(data).hexdigest()
    return found


@pytest.mark.parametrize("kills", [KILLS, slow(24)])
def test_killed_at_random_moments_the_content_is_that_of_an_undisturbed_ingest(kills, tmp_path):
    stars = random_stars(4_800, 3)
    source = tmp_path / "in"
    source.mkdir()
    for i in range(8):
        write_csv(source / f"part{i}.csv.gz", stars.slice(600 * i, 600))
    write_csv(source / "zagain.csv.gz", pa.concat_tables([stars.slice(0, 10), stars.slice(9, 2)]))
    (tmp_path / "out").mkdir()
    command = [sys.executable, "-c", DRIVER, str(source), str(tmp_path / "out"), str(kills)]
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert sum(code != 0 for _, _, code, _ in told["moments"]) >= kills
    expected = content(tmp_path / "out" / "undisturbed")
    assert len(expected) > 40
    for number in range(told["last"] + 1):
        assert content(tmp_path / "out" / f"killed-{number}") == expected
    catalogue = open_catalogue(tmp_path / "out" / "undisturbed")
    assert catalogue.rejected == {"source_id occurs more than once": 12}
    assert same_rows(cone(catalogue, 0, 0, 180)[0], stars)


def test_nothing_stays_beside_a_catalogue_that_was_finished_after_kills(tmp_path):
    stars = random_stars(3000, 5)
    source = write_csv(tmp_path / "stars.csv", stars)
    ingest([source], tmp_path / "c", rows_per_leaf=500)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c", "stars.csv"]
