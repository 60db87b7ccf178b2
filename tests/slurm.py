"""A Slurm of one node, in a folder and with a key of its own (what it needs comes with Debian), and
a stand-in for its commands."""

from __future__ import annotations

import getpass
import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

NEEDED = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "scancel")
CONFIGURATION = """
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmUser={user}
SlurmdUser={user}
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
AuthInfo=socket={folder}/munge.sock
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
ProctrackType=proctrack/pgid
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
JobCompType=jobcomp/filetxt
JobCompLoc={folder}/ended
KillWait=2
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} RealMemory=8000
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""

# A job is its script in a session of its own, known by its process.
SBATCH = """#!/bin/sh
cp "$1" {folder}/script   # the caller removes its own at once
setsid sh {folder}/script >{folder}/log 2>&1 &
echo $! >>{folder}/jobs
echo "Submitted batch job $!"
"""
SCANCEL = """#!/bin/sh
echo "$1" >>{folder}/cancelled
kill -- "-$1" 2>/dev/null
exit 0
"""
SQUEUE = """#!/bin/sh
for job in $(cat {folder}/jobs); do
    case $(cut -d ' ' -f 3 /proc/$job/stat 2>/dev/null) in
        ''|Z) ;;
        *) echo "$job RUNNING (None)" ;;
    esac
done
"""


def stand_in_for_slurm(folder: Path, **scripts: str) -> Path:
    """A folder with sbatch, scancel and squeue, other scripts where given, for a PATH."""
    bin_ = folder / "bin"
    bin_.mkdir(parents=True)
    (folder / "jobs").touch()
    scripts = {"sbatch": SBATCH, "scancel": SCANCEL, "squeue": SQUEUE} | scripts
    for name, script in scripts.items():
        (bin_ / name).write_text(script.format(folder=folder))
        (bin_ / name).chmod(0o755)
    return bin_


@contextmanager
def slurm_of_one_node() -> Iterator[Path]:
    """Slurm, running; its folder, whose file `ended` has a line for each job that has ended."""
    lacking = [name for name in NEEDED if shutil.which(name) is None]
    if lacking:
        pytest.skip(f"{', '.join(lacking)} not installed (slurm-wlm and munge)")
    with ExitStack() as closing:
        # its sockets' paths are short, and munged takes no folder that others may write
        folder = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="slurm")))
        folder.chmod(0o755)
        key, configuration = folder / "key", folder / "slurm.conf"
        key.write_bytes(os.urandom(256))
        key.chmod(0o400)
        host = socket.gethostname().partition(".")[0]
        with socket.socket() as one, socket.socket() as other:
            for free in (one, other):
                free.bind(("127.0.0.1", 0))
            ports = one.getsockname()[1], other.getsockname()[1]
        configuration.write_text(CONFIGURATION.format(
            host=host, user=getpass.getuser(), ports=ports, folder=folder,
            cpus=os.cpu_count(),
        ))  # fmt: skip
        (folder / "state").mkdir()
        (folder / "spool").mkdir()
        with pytest.MonkeyPatch.context() as patch, (folder / "log").open("wb") as log:
            patch.setenv("SLURM_CONF", str(configuration))
            for command in (
                ["munged", "--foreground", "--force", f"--socket={folder}/munge.sock",
                 f"--key-file={key}", f"--pid-file={folder}/munged.pid",
                 f"--log-file={folder}/munged.log", f"--seed-file={folder}/seed"],
                ["slurmctld", "-D"], ["slurmd", "-D"],
            ):  # fmt: skip
                daemon = subprocess.Popen(command, stdout=log, stderr=log)
                closing.callback(daemon.wait, 30)
                closing.callback(daemon.terminate)
            _until_ready(folder)
            yield folder
            subprocess.run(["scancel", "--full", "--me"], check=False)


def _until_ready(folder: Path) -> None:
    deadline = time.monotonic() + 60
    while subprocess.run(["srun", "--immediate=5", "true"], capture_output=True).returncode != 0:
        assert time.monotonic() < deadline, (folder / "log").read_text()
        time.sleep(0.5)
