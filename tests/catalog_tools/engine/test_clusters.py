"""Schedulers beyond this process: TLS with our own certificates, jobs that Slurm would start."""

from __future__ import annotations

import copy
import json
import os
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import dask
import pytest
from dask.utils import parse_timedelta
from distributed.core import Status
from distributed.scheduler import KilledWorker

from catalog_tools.engine import clusters
from catalog_tools.engine.addresses import check_address
from catalog_tools.engine.cluster_scheduler import ClusterScheduler
from catalog_tools.engine.clusters import security_of
from catalog_tools.engine.schedulers import open_scheduler
from catalog_tools.errors import BadInput, Incomplete, TryLater
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.product import content_digest
from tests.service.conftest import SCENE
from tests.slow import slow
from tests.slurm import slurm_of_one_node, stand_in_for_slurm
from tests.tls_cluster import ROOT, make_certificates, tls_cluster_in

LONGER_THAN_A_JOB_S = 240.0  # CPU seconds of two processes; limits are looked at every 30 s


def double(shared: int, item: int) -> int:
    if item == 13:
        raise ValueError("an unlucky item")
    return shared * item


@pytest.fixture(scope="module")
def certificates(tmp_path_factory) -> Path:
    folder = make_certificates(tmp_path_factory.mktemp("tls"), "example.org")
    assert (folder / "cluster.key").stat().st_mode & 0o077 == 0
    return folder


@pytest.fixture(scope="module")
def tls_cluster(certificates, tmp_path_factory):
    """The address of a scheduler that takes only TLS, with one worker."""
    with tls_cluster_in(certificates, tmp_path_factory.mktemp("worker")) as cluster:
        cluster.start()
        cluster.add_workers(1)
        yield cluster.address


@pytest.fixture
def own_cluster(certificates, with_certificates, tmp_path):
    """A scheduler that a test may stop, without workers."""
    with tls_cluster_in(certificates, tmp_path) as cluster:
        cluster.start()
        yield cluster


@pytest.fixture
def with_certificates(certificates, monkeypatch):
    for name, file in (("CA", "ca.pem"), ("CERT", "cluster.pem"), ("KEY", "cluster.key")):
        monkeypatch.setenv(f"NIGHTGLASS_CLUSTER_{name}", str(certificates / file))
    monkeypatch.setenv("NIGHTGLASS_WORKERS_WAIT_S", "120")


@pytest.mark.parametrize("kind", ["synchronous", "threads"])
def test_each_gives_every_outcome_once(kind):
    with open_scheduler(kind, 3) as scheduler:
        found = dict(scheduler.each(double, 2, range(30)))
    assert len(found) == 30
    assert isinstance(found.pop(13), ValueError)
    assert found == {i: 2 * i for i in range(30) if i != 13}


def whence() -> tuple[int, bool, bool]:
    """A worker's parent, whether it is deaf to Ctrl-C, whether it has the product's code."""
    deaf = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    return os.getppid(), deaf, "pipeline.route.run" in sys.modules


@pytest.mark.skipif(not clusters.FORKS, reason="processes are forked on Linux alone")
def test_processes_are_forked_off_one_that_has_the_code_and_do_not_hear_ctrl_c():
    with clusters.cluster("processes", 2, 2) as (client, _):
        [(parent, *rest), other] = client.run(whence).values()
    assert rest == [True, True]
    assert other == (parent, True, True)
    assert parent != os.getpid()


def test_a_worker_that_idles_is_not_taken_for_one_that_hangs():
    """Distributed warns where its own clock ticks later than a limit."""
    clusters.set_up_dask()
    every, limit = (
        parse_timedelta(dask.config.get(f"distributed.admin.tick.{name}"))
        for name in ("interval", "limit")
    )
    assert limit >= 2.0 * every


def test_why_processes_cannot_be_started_is_told(monkeypatch):
    """As where /dev/shm cannot be written: what went wrong first, of all that followed."""

    def refused(**_):
        try:
            try:
                raise OSError(30, "Read-only file system")
            except OSError:
                raise AssertionError("Status.init") from None
        except AssertionError as error:
            raise RuntimeError("Nanny failed to start.") from error

    monkeypatch.setattr(clusters, "LocalCluster", refused)
    with pytest.raises(BadInput) as caught, open_scheduler("processes", 2):
        pass
    assert str(caught.value) == (
        "--scheduler: 'processes' is not accepted; allowed: threads, where no processes can be "
        "started ([Errno 30] Read-only file system)"
    )


def test_ctrl_c_while_processes_start_is_heard_once_they_can_be_closed(monkeypatch):
    """It hung for a minute, or ended in the library's tracebacks."""
    made, start = [], clusters._processes

    def interrupted(count):
        signal.raise_signal(signal.SIGINT)
        made.append(start(count))
        return made[0]

    monkeypatch.setattr(clusters, "_processes", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), clusters.cluster("processes", 1, 1):
            pytest.fail("the work has begun")
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert made[0].status == Status.closed


@pytest.mark.parametrize("kind", ["synchronous", "threads"])
def test_each_takes_items_only_a_few_ahead(kind):
    taken = []

    def items():
        for i in range(10_000):
            taken.append(i)
            yield i

    with open_scheduler(kind, 2) as scheduler:
        results = scheduler.each(later, 1, items())
        for heard in range(100):
            next(results)
            assert len(taken) < heard + 20
        results.close()


def test_work_over_tls(tls_cluster, with_certificates):
    with open_scheduler(tls_cluster, None) as scheduler:
        found = dict(scheduler.each(double, 3, range(12)))
        assert found == {i: 3 * i for i in range(12)}
        shared = scheduler.share(5)
        done = []
        out = scheduler.run({("t", i): (double, shared, i) for i in range(3)},
                            [("t", i) for i in range(3)], done.append)  # fmt: skip
        assert list(out) == [0, 5, 10]
        assert done == ["t"] * 3


def test_a_stranger_is_refused(tls_cluster, certificates, tmp_path, monkeypatch):
    """Without a certificate, with one of another authority, and without TLS at all."""
    with pytest.raises(BadInput, match="NIGHTGLASS_CLUSTER_CA"), open_scheduler(tls_cluster, None):
        pass
    make_certificates(tmp_path)
    for name, file in (("CA", "ca.pem"), ("CERT", "cluster.pem"), ("KEY", "cluster.key")):
        monkeypatch.setenv(f"NIGHTGLASS_CLUSTER_{name}", str(tmp_path / file))
    with pytest.raises(BadInput, match="certificates fit"), open_scheduler(tls_cluster, None):
        pass
    host, port = tls_cluster.removeprefix("tls://").split(":")
    context = ssl.create_default_context(cafile=str(certificates / "ca.pem"))
    context.check_hostname = False

    def talk() -> bytes:
        with (
            socket.create_connection((host, int(port)), 10) as plain,
            context.wrap_socket(plain) as wire,
        ):
            wire.sendall(b"\0" * 64)  # TLS 1.3 tells of the missing certificate on the first read
            return wire.recv(1)

    with pytest.raises(ssl.SSLError):
        talk()
    plain = f"tcp://{host}:{port}"
    monkeypatch.setattr("catalog_tools.engine.clusters.ANSWER_S", 1.0)
    with pytest.raises(TryLater, match="is it a tls:// one"), open_scheduler(plain, None):
        pass


def later(shared: int, item: int) -> int:
    time.sleep(0.005)
    return shared + item


def slowly(shared: bytes, item: int) -> int:
    time.sleep(0.2)
    return item + len(shared)


@pytest.mark.parametrize("kills", [(4,), slow((4, 10, 16))])
def test_work_goes_on_though_all_workers_die(own_cluster, kills):
    """What the tasks share is where any new worker finds it."""
    own_cluster.add_workers(2)
    with open_scheduler(own_cluster.address, None) as scheduler:
        shared, done = scheduler.share(b"12345"), []
        graphs = [({("t", i): (slowly, shared, i)}, [("t", i)]) for i in range(40)]

        def heard(kind):
            done.append(kind)
            if len(done) in kills:
                own_cluster.kill_workers()
                own_cluster.add_workers(1)

        scheduler.stream(graphs, heard)
    assert done == ["t"] * 40


def test_a_task_that_kills_every_worker_is_not_to_be_tried_again():
    """It would kill the next ones too: Incomplete, not TryLater."""
    killed = KilledWorker("draw", SimpleNamespace(address="tcp://10.0.0.1:4000"), 3)
    future = SimpleNamespace(status="error", key="draw", exception=lambda: killed)
    with pytest.raises(Incomplete, match=r"keeps killing its workers.*'draw' on 4"):
        object.__new__(ClusterScheduler)._told(future, lambda key: None)


def test_a_lost_scheduler_says_so_and_nothing_else(own_cluster, capfd):
    def cut_off():
        with open_scheduler(own_cluster.address, None) as scheduler:
            found = scheduler.each(slowly, b"", range(1000))
            next(found)
            own_cluster.stop_scheduler()
            list(found)

    own_cluster.add_workers(1)
    with pytest.raises(TryLater, match=own_cluster.address):
        cut_off()
    lost = pytest.raises(TryLater, match=own_cluster.address)
    with lost, open_scheduler(own_cluster.address, None):
        pass
    assert capfd.readouterr().err == ""


def test_a_scheduler_without_workers_is_no_mistake(own_cluster, monkeypatch, tmp_path):
    monkeypatch.delenv("NIGHTGLASS_WORKERS_WAIT_S")
    with pytest.raises(TryLater, match="no workers"), open_scheduler(own_cluster.address, None):
        pass
    heard = []
    with pytest.raises(TryLater, match="no workers"):
        render(parse_scene(SCENE), tmp_path / "run", Options(own_cluster.address), heard.append)
    assert [told.stage for told in heard] == ["waiting for workers"]
    assert (heard[0].done, heard[0].total) == (0, 2)


def test_a_worker_of_other_code_is_refused_by_name(own_cluster, tmp_path):
    """Between releases a version's number stays, and the code changes: a line is enough."""
    ours = shutil.ignore_patterns("__pycache__")
    for package in ("catalog_tools", "pipeline"):
        shutil.copytree(ROOT / package, tmp_path / "other" / package, ignore=ours)
    with (tmp_path / "other" / "pipeline" / "lines.py").open("a") as file:
        file.write("# another line\n")
    first = {"PYTHONPATH": f"{tmp_path / 'other'}:{ROOT}", "PYTHONSAFEPATH": "1"}
    own_cluster.add_workers(1, **first)
    told = r"the worker tls://127\.0\.0\.1:\d+ runs other code of nightglass"
    with (
        open_scheduler(own_cluster.address, None) as scheduler,
        pytest.raises(TryLater, match=told),
    ):
        scheduler.share(5)


def test_workers_end_with_4_when_their_scheduler_dies_and_with_0_when_asked(own_cluster, tmp_path):
    command = [sys.executable, "-m", "pipeline", "worker", own_cluster.address, "--folder",
               str(tmp_path), "--patience", "60"]  # fmt: skip
    with (tmp_path / "worker").open("w") as log:
        workers = [subprocess.Popen(command, stderr=log, cwd=ROOT) for _ in range(2)]
        with open_scheduler(own_cluster.address, None) as scheduler:
            scheduler.client.wait_for_workers(2, timeout=60)
            workers[0].send_signal(signal.SIGTERM)
            assert workers[0].wait(30) == 0
        own_cluster.stop_scheduler()
        assert workers[1].wait(30) == 4
    assert f"the scheduler at {own_cluster.address} went away" in (tmp_path / "worker").read_text()


@pytest.mark.parametrize(
    "address",
    ["tcp://10.0.0.7:8786", "tcp://example.org:8786", "http://127.0.0.1:80", "tls://", "tcp://:1",
     "tls://host", "tcp://127.0.0.1:port", "thread", "", "tcp://[::2]:8786"],
)  # fmt: skip
def test_bad_addresses(address):
    with pytest.raises(BadInput, match="--scheduler"):
        check_address(address)


@pytest.mark.parametrize("kind", ["tcp://127.0.0.1:9", "processes"])
def test_what_is_not_encrypted_is_refused_where_that_is_required(kind, tmp_path, monkeypatch):
    """By the command as by the service: exit 2, and no product is begun."""
    monkeypatch.setenv("DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION", "true")
    monkeypatch.setenv("NIGHTGLASS_SCHEDULER", kind)
    (tmp_path / "scene.json").write_text(json.dumps(SCENE))
    for words in (
        ["render", "scene.json", "-o", "product", "--scheduler", kind],
        ["serve", "--home", "home", "--port", "0"],
    ):
        told = subprocess.run([sys.executable, "-m", "pipeline", *words], cwd=tmp_path,
                              capture_output=True, text=True, timeout=120)  # fmt: skip
        assert told.returncode == 2, told.stderr
        assert "require-encryption" in told.stderr
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene.json"]


@pytest.mark.parametrize("source", ["ours", "dask's"])
def test_connections_by_tls_are_never_plain(certificates, monkeypatch, source):
    """Whoever names the certificates: both sides' are the given ones; nothing plain is said."""
    files = [str(certificates / name) for name in ("ca.pem", "cluster.pem", "cluster.key")]
    names = ("NIGHTGLASS_CLUSTER_CA", "NIGHTGLASS_CLUSTER_CERT", "NIGHTGLASS_CLUSTER_KEY")
    for name, file in zip(names, files, strict=True):
        if source == "ours":
            monkeypatch.setenv(name, file)
        else:
            monkeypatch.delenv(name, raising=False)
    keys = ("ca-file", "client.cert", "client.key", "worker.cert", "worker.key")
    theirs = zip(keys, (files[0], *files[1:], *files[1:]), strict=True)
    known = {f"distributed.comm.tls.{key}": file for key, file in theirs}
    with dask.config.set(known if source == "dask's" else {}):
        made = security_of("tls://somewhere:8786")
        assert made.require_encryption is True
        assert made.tls_ca_file == files[0]
        for side in ("client", "worker"):
            told = [getattr(made, f"tls_{side}_{what}") for what in ("cert", "key")]
            assert told == files[1:]
    assert security_of("tcp://somewhere:8786") is None


def test_half_a_certificate_is_named(certificates, monkeypatch):
    monkeypatch.setenv("NIGHTGLASS_CLUSTER_CA", str(certificates / "ca.pem"))
    monkeypatch.setenv("NIGHTGLASS_CLUSTER_CERT", str(certificates / "gone.pem"))
    with pytest.raises(BadInput, match=r"NIGHTGLASS_CLUSTER_CERT.*gone.pem"):
        security_of("tls://somewhere:8786")


def slurm_settings(**changed) -> dict:
    """The settings of our file, as Dask has them with one process a job."""
    from ruamel.yaml import YAML

    settings = YAML(typ="safe").load((ROOT / "deploy" / "slurm" / "jobqueue.yaml").read_text())
    return dask.config.get("jobqueue.slurm") | settings["jobqueue"]["slurm"] | {
        "cores": 1, "processes": 1, "memory": "1GiB", "interface": "lo", "python": sys.executable,
    } | changed  # fmt: skip


@pytest.fixture
def with_slurm(tmp_path, monkeypatch):
    """A function that puts a stand-in for Slurm, with other scripts, on the PATH."""
    pytest.importorskip("dask_jobqueue")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("NIGHTGLASS_SLURM_FOLDER", str(tmp_path / "certificates"))
    monkeypatch.setenv("NIGHTGLASS_WORKERS_WAIT_S", "120")
    monkeypatch.setattr("catalog_tools.engine.slurm_jobs.LOOK_S", 1.0)

    def made(**scripts: str) -> Path:
        bin_ = stand_in_for_slurm(tmp_path, **scripts)
        monkeypatch.setenv("PATH", f"{bin_}:{os.environ['PATH']}")
        return tmp_path

    return made


@pytest.mark.slow
def test_slurm_starts_workers(with_slurm):
    """Our settings file through dask-jobqueue, with a stand-in for sbatch that runs the script."""
    folder = with_slurm()
    with (
        dask.config.set({"jobqueue.slurm": slurm_settings()}),
        open_scheduler("slurm", 1) as scheduler,
    ):
        found = dict(scheduler.each(double, 2, range(6)))
    assert found == {i: 2 * i for i in range(6)}
    script = (folder / "script").read_text()
    assert "--requeue" in script
    assert "tls://" in script
    assert "--no-dashboard" in script
    assert (folder / "certificates").stat().st_mode & 0o077 == 0


@pytest.mark.slow
def test_jobs_of_several_processes_that_end_are_followed_by_others(with_slurm):
    """As at the walltime, or when all are cancelled."""
    folder = with_slurm()
    settings = slurm_settings(cores=2, processes=2)
    with dask.config.set({"jobqueue.slurm": settings}), open_scheduler("slurm", 1) as scheduler:
        found = {}
        for item, value in scheduler.each(slowly, b"12345", range(40)):
            found[item] = value
            if len(found) == 5:
                os.killpg(int((folder / "jobs").read_text().split()[-1]), signal.SIGKILL)
    assert found == {i: i + 5 for i in range(40)}
    assert len((folder / "jobs").read_text().split()) >= 2


ONCE = """#!/bin/sh
if [ -s {folder}/jobs ]; then
    echo 999999999 >>{folder}/jobs
    echo "Submitted batch job 999999999"
    exit
fi
cp "$1" {folder}/script
setsid sh {folder}/script >{folder}/log 2>&1 &
echo $! >>{folder}/jobs
echo "Submitted batch job $!"
"""


@pytest.mark.slow
def test_jobs_that_end_one_after_the_other_without_a_worker_are_given_up(with_slurm, monkeypatch):
    """The first job's worker is killed; what follows it ends at once, for ever."""
    monkeypatch.setattr("catalog_tools.engine.slurm_jobs.MOST_IN_VAIN", 3)
    folder = with_slurm(sbatch=ONCE)

    def killing(scheduler) -> None:
        for _ in scheduler.each(slowly, b"12345", range(400)):
            os.killpg(int((folder / "jobs").read_text().split()[0]), signal.SIGKILL)

    settings = {"jobqueue.slurm": slurm_settings(), "distributed.comm.timeouts.connect": 2}
    with (
        dask.config.set(settings),
        pytest.raises(TryLater) as error,
        open_scheduler("slurm", 1) as scheduler,
    ):
        killing(scheduler)
    told = "3 jobs in a row ended before a worker came: last Slurm's job 999999999"
    assert str(error.value).startswith(told)
    assert len((folder / "jobs").read_text().split()) == 4


REFUSALS = {
    "Invalid partition name specified": (BadInput, "Invalid partition name specified"),
    "Unable to contact slurm controller (connect failure)": (TryLater, "Unable to contact"),
}


@pytest.mark.parametrize("told", REFUSALS)
def test_what_sbatch_refuses_is_told_at_once(with_slurm, told):
    said = f"sbatch: error: a thing\nsbatch: error: Batch job submission failed: {told}"
    folder = with_slurm(sbatch=f"#!/bin/sh\necho '{said}' >&2\nexit 1\n")
    kind, words = REFUSALS[told]
    with (
        dask.config.set({"jobqueue.slurm": slurm_settings()}),
        pytest.raises(kind, match=words) as error,
        open_scheduler("slurm", 1),
    ):
        pass
    assert "\n" not in str(error.value)
    # keys of the run lie in it: the user's alone
    assert (folder / "certificates").stat().st_mode & 0o077 == 0


def test_a_machine_without_slurm_is_told(with_slurm, tmp_path, monkeypatch):
    with_slurm()
    monkeypatch.setenv("PATH", str(tmp_path / "nothing"))
    with (
        dask.config.set({"jobqueue.slurm": slurm_settings()}),
        pytest.raises(BadInput, match="command sbatch"),
        open_scheduler("slurm", 1),
    ):
        pass


def test_slurm_without_settings_names_the_file_that_has_them(with_slurm):
    with_slurm()
    with (
        dask.config.set({"jobqueue.slurm": slurm_settings(cores=None, memory=None)}),
        pytest.raises(BadInput, match=r"deploy/slurm/jobqueue.yaml") as error,
        open_scheduler("slurm", 1),
    ):
        pass
    assert "\n" not in str(error.value)


def test_slurm_with_settings_that_cannot_be_used_says_why(with_slurm):
    """A network that the machine does not have."""
    with_slurm()
    with (
        dask.config.set({"jobqueue.slurm": slurm_settings(interface="none0")}),
        pytest.raises(BadInput, match="none0") as error,
        open_scheduler("slurm", 1),
    ):
        pass
    assert (error.value.field, error.value.value) == ("--scheduler", "slurm")
    assert error.value.allowed.startswith("settings in jobqueue.slurm of Dask's configuration; ")
    assert "\n" not in str(error.value)


PENDING = "#!/bin/sh\necho 7 'PENDING (PartitionDown)'\n"
SUBMITS = "#!/bin/sh\ntouch {folder}/submitted\necho Submitted batch job 7\n"


@pytest.mark.parametrize(
    ("squeue", "told"),
    [(PENDING, r"job 7: PENDING \(PartitionDown\)"), ("#!/bin/sh\n", "job 7 ended")],
)
def test_a_job_without_a_worker_is_told(with_slurm, monkeypatch, squeue, told):
    """One that waits in the queue for too long, and one that ended before its worker came."""
    with_slurm(sbatch=SUBMITS, squeue=squeue)
    monkeypatch.setenv("NIGHTGLASS_WORKERS_WAIT_S", "5")
    with (
        dask.config.set({"jobqueue.slurm": slurm_settings()}),
        pytest.raises(TryLater, match=told),
        open_scheduler("slurm", 1),
    ):
        pass


@pytest.mark.parametrize("processes", [1, 2])
def test_for_much_work_as_many_jobs_are_asked_for_as_are_allowed(
    with_slurm, monkeypatch, processes
):
    """Jobs, not workers: each may be several processes."""
    folder = with_slurm(sbatch=SUBMITS, squeue=PENDING)
    from catalog_tools.engine import slurm_jobs

    async def much(_):
        return 100

    monkeypatch.setattr(slurm_jobs.FollowsJobs, "target", much)
    settings = slurm_settings(cores=2, processes=processes)
    most, until = 0, time.monotonic() + 20
    with (
        dask.config.set({"jobqueue.slurm": settings}),
        slurm_jobs.cluster_of_jobs(folder, 3) as cluster,
    ):
        while most < 3 and time.monotonic() < until:
            most = max(most, len(cluster.worker_spec))
            time.sleep(0.1)
        time.sleep(2)  # in which a fourth would be asked for
        assert (most, len(cluster.worker_spec)) == (3, 3)
        listening = cluster.scheduler.http_server._sockets.values()
        assert {one.getsockname()[0] for one in listening} == {"127.0.0.1"}


@pytest.mark.parametrize(
    ("number", "code"),
    [
        (signal.SIGINT, 130),
        slow(signal.SIGTERM, 143),
        slow(signal.SIGHUP, 129),
    ],
)
def test_a_render_that_is_stopped_cancels_its_jobs(with_slurm, number, code):
    folder = with_slurm(sbatch=SUBMITS, squeue=PENDING)
    (folder / "scene.json").write_text(json.dumps(SCENE))
    (folder / "jobqueue.json").write_text(json.dumps({"jobqueue": {"slurm": slurm_settings()}}))
    with subprocess.Popen(
        [sys.executable, "-m", "pipeline", "render", "scene.json", "-o", "product", "--slurm"],
        cwd=folder, env=os.environ | {"DASK_CONFIG": str(folder / "jobqueue.json")},
        stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # whatever ran the tests
    ) as render:  # fmt: skip
        until = time.monotonic() + 60
        while not (folder / "submitted").exists() and time.monotonic() < until:
            time.sleep(0.2)
        time.sleep(1)
        render.send_signal(number)
        _, told = render.communicate(timeout=60)
    assert render.returncode == code, told
    assert (folder / "cancelled").read_text().split() == ["7"]
    assert ("go on with:" in told) == (number == signal.SIGINT)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_slurm_worker_that_reaches_its_walltime_is_followed_by_the_next(tmp_path):
    """A real Slurm, one job of a minute at a time, a render of some more: whole, the same bits."""
    pytest.importorskip("dask_jobqueue")
    from ruamel.yaml import YAML

    scene = copy.deepcopy(SCENE)
    scene["targets"] += [scene["targets"][0] | {"name": f"other-{i}"} for i in range(40)]
    spent_s = {}
    for frames in (1, 2, 22):  # the first compiles
        scene["exposure"]["frames"] = frames
        before = time.process_time()
        render(parse_scene(scene), tmp_path / f"timed{frames}")
        spent_s[frames] = time.process_time() - before
    each_s = (spent_s[22] - spent_s[2]) / 20
    scene["exposure"]["frames"] = int(LONGER_THAN_A_JOB_S / each_s)
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    yaml = YAML(typ="safe")
    settings = yaml.load((ROOT / "deploy" / "slurm" / "jobqueue.yaml").read_text())
    settings["jobqueue"]["slurm"] |= {
        "cores": 2, "processes": 2, "memory": "2GiB", "walltime": "00:01:00", "interface": "lo",
        "log-directory": str(tmp_path / "jobs"),
    }  # fmt: skip
    (tmp_path / "dask").mkdir()
    yaml.dump(settings, tmp_path / "dask" / "jobqueue.yaml")
    with slurm_of_one_node() as slurm:
        told = subprocess.run(
            [sys.executable, "-m", "pipeline", "render", "scene.json", "-o", "product", "--slurm",
             "--workers", "1"], cwd=tmp_path, capture_output=True, text=True,
            env=os.environ | {"DASK_CONFIG": str(tmp_path / "dask"), "PYTHONPATH": str(ROOT),
                              "NIGHTGLASS_SLURM_FOLDER": str(tmp_path / "certificates")},
        )  # fmt: skip
        ended = (slurm / "ended").read_text()
    assert told.returncode == 0, told.stderr
    assert "JobState=TIMEOUT" in ended, "the render ended before the first job's walltime"
    alone = render(parse_scene(scene), tmp_path / "alone")
    assert alone["content_digest"] == content_digest(tmp_path / "product")
