"""Sweeps on other machines: a worker without the user's files, and a cluster that loses workers."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Thread

import pytest

from softdyn.validation.studies import sweep
from softdyn.validation.studies.engine import cluster as dask
from softdyn.validation.studies.engine import executors, fingerprint, sources, worker
from softdyn.validation.studies.sweep_file import read_sweep
from tests.support.refused import refused
from tests.support.sweeps import OWN_SWEEP, contents, results, wait_for


def test_a_worker_without_the_user_s_files_gets_them(folder, written):
    wanted = written(OWN_SWEEP.format(stiffness="[2]"))
    (here,) = wanted.jobs()
    files = {
        sha: (folder / name).read_bytes()
        for source in (here.robot, here.controller)
        for name, sha in source.files
    }
    assert len(files) == 3  # the module beside it, too
    there = replace(
        here,
        robot=replace(here.robot, path="/nowhere/pendulum.urdf"),
        controller=replace(here.controller, path="/nowhere/own.py"),
    )
    expected = worker.attempt(here)
    sources._kept.__dict__.clear()  # as a new worker
    lost = worker.attempt(there)
    assert lost.figures["outcome"] == "not_run"
    assert worker.attempt(there, files) == expected
    assert expected.figures["outcome"] == "done"


CLUSTER = """
robots = ["finger", "pendulum.urdf"]
controllers = ["soft-id-clf-qp"]
[targets]
theta = [0.5, 1]
[gains]
Kp = { from = 100, to = 600, count = 6 }
[run]
duration = 0.5
"""


@pytest.fixture
def cluster(tmp_path):
    """A scheduler and two worker processes on the loopback: (address, scheduler, workers).

    A task fails after it killed two workers, not four, so that fewer processes start.
    """
    http = ["--no-dashboard", "--dashboard-address", "127.0.0.1:0", "--host", "127.0.0.1"]
    about = tmp_path / "scheduler.json"
    environment = os.environ | {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
    processes = []

    def start(kind, *arguments):
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *arguments, *http]
        processes.append(
            subprocess.Popen(command, stdout=log, stderr=log, cwd=tmp_path, env=environment)
        )

    with (tmp_path / "cluster.log").open("w") as log:
        try:
            start("scheduler", "--port", "0", "--scheduler-file", str(about))
            for i in range(2):
                start("worker", "--scheduler-file", str(about), "--nthreads", "1", "--no-nanny",
                      "--local-directory", str(tmp_path / f"w{i}"))  # fmt: skip
            wait_for(lambda: about.exists() and about.read_text().endswith("}"))
            yield json.loads(about.read_text())["address"], processes[0], processes[1:]
        finally:
            for process in processes:
                process.kill()
                process.wait()


# workers that are restarted, as by a nanny
RESPAWN = """
import signal, subprocess, sys
command = [sys.executable, "-m", "distributed.cli.dask_worker", sys.argv[1], "--nthreads", "1",
           "--no-nanny", "--no-dashboard", "--dashboard-address", "127.0.0.1:0",
           "--host", "127.0.0.1"]
worker = None
def end(*_):
    worker.kill()
    sys.exit()
signal.signal(signal.SIGTERM, end)
while True:
    worker = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    worker.wait()
"""


@contextmanager
def respawning(address, folder):
    process = subprocess.Popen(
        [sys.executable, "-c", RESPAWN, address], cwd=folder, stderr=subprocess.DEVNULL
    )
    try:
        yield
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait()


def listening(pid):
    """Addresses on which a process listens, from the kernel's tables."""
    sockets = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        try:
            sockets.add(os.readlink(entry))
        except OSError:
            continue
    lines = [line.split() for name in ("tcp", "tcp6")
             for line in Path(f"/proc/{pid}/net/{name}").read_text().splitlines()[1:]]  # fmt: skip
    return {x[1].rsplit(":", 1)[0] for x in lines if x[3] == "0A" and f"socket:[{x[9]}]" in sockets}


@pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None,
    reason="needs dask.distributed: the extra softdyn[cluster]",
)
def test_a_cluster_that_loses_all_it_has_loses_no_case(folder, call, cluster, monkeypatch):
    """One cluster, because it starts slowly: it loses a worker, then all, then the scheduler."""
    from distributed import Client

    address, scheduler, workers = cluster
    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(2)
    with monkeypatch.context() as patched:
        patched.setattr(fingerprint, "code", lambda: "other")
        with refused("--scheduler", "others on tcp://127.0.0.1:…"):
            dask.cluster(address)
    if sys.platform == "linux":
        assert set().union(*(listening(w.pid) for w in workers)) == {"0100007F"}

    # a worker is killed on the way; a fast machine may be done before
    path = folder / "sweep.toml"
    path.write_text(CLUSTER)

    def kill():
        wait_for(lambda: len(list(Path("far").rglob("cases/**/*.json"))) > 3)
        workers[0].kill()

    killer = Thread(target=kill)
    killer.start()
    code, out, err = call(path, "--scheduler", address, "--out", "far", "--json", "-")
    killer.join()
    assert code == 0, err
    assert (json.loads(out)["cases"], json.loads(out)["ran"]) == (24, 24)
    assert workers[0].wait() == -signal.SIGKILL
    assert workers[1].poll() is None
    assert call(path, "--out", "near", "--jobs", 1)[0] == 0
    assert contents(Path("far")) == contents(Path("near"))
    assert {r["outcome"] for r in results(Path("far"))} <= {"done", "failed"}

    # one case kills every worker that takes it; the other cases finish
    path.write_text(OWN_SWEEP.format(stiffness="[1, 66]"))
    with respawning(address, folder):
        code, out, err = call(path, "--scheduler", address, "--out", "own", "--json", "-")
    assert code == 1, err
    assert {r["inputs"]["gains"]["stiffness"]: r["outcome"] for r in results(Path("own"))} == {
        1.0: "done", 66.0: "not_run",
    }  # fmt: skip
    assert {r["reason"] for r in results(Path("own"))} == {None, executors.DIED}
    assert workers[1].wait() == -signal.SIGKILL

    # the scheduler goes away
    path.write_text(CLUSTER)
    jobs, store = read_sweep(path).jobs(), sweep.store(folder / "cut")
    running = store.run(jobs, dask.cluster(address))
    with respawning(address, folder):
        next(running)
        scheduler.kill()
        with pytest.raises(dask.ClusterError, match="repeat the command"):
            list(running)
    assert 0 < len(store.missing(jobs)) < len(jobs)

    # without remaining cases, no cluster is contacted
    assert call(path, "--out", "far", "--scheduler", "tcp://127.0.0.1:1")[0] == 0


def test_without_distributed_the_command_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with refused("--scheduler", "no dask.distributed"):
        dask.cluster("tcp://127.0.0.1:1")
