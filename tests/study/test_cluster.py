"""Studies through Dask: a kill at any moment does not change the table."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from distributed import Client, Security
from study_runs import SLOW_ENOUGH, conduct_here, run_in_process

from skyherd.study.cluster import open_client
from skyherd.study.conduct import missing_runs
from skyherd.study.plan import make_plan
from skyherd.study.spec import load_study
from skyherd.study.store import PARTS, Store
from skyherd.study.table import TABLE

PROGRAM = """
import os, signal
import psutil
from skyherd.cli import main
from skyherd.study.store import Store

signal.signal(signal.SIGINT, signal.default_int_handler)
append, parts, at_part = Store.append, [], {at_part}

def kill_worker():
    children = psutil.Process().children(recursive=True)
    workers = [child for child in children if "spawn_main" in " ".join(child.cmdline())]
    assert len(workers) == 2
    workers[0].kill()

def append_and_act(self, outcomes):
    append(self, outcomes)
    parts.append(outcomes)
    exec(at_part.get(len(parts), ""))

Store.append = append_and_act
main()
"""
"""Program that acts right after a part was written, in the middle of the study on any machine. It heeds
SIGINT, which processes ignore that a shell started in the background, and their children."""


def start(path: Path, out: Path, *options: str, **at_part: str) -> subprocess.Popen[str]:
    """Start a study in another process; `part_3="kill_worker()"` runs after its third part is written."""
    acts = {int(name.removeprefix("part_")): act for name, act in at_part.items()}
    program = PROGRAM.replace("{at_part}", repr(acts))
    return subprocess.Popen(
        [sys.executable, "-c", program, "study", str(path), "--out", str(out), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(path: Path, out: Path, *options: str) -> bytes:
    process = start(path, out, *options)
    _, err = process.communicate(timeout=600)
    assert process.returncode == 0, err
    assert err == ""  # quiet where there is no terminal
    return (out / TABLE).read_bytes()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the table of the same study, run sequentially without a cluster."""
    out = tmp_path_factory.mktemp("study")
    path = out / "small.toml"
    path.write_text(SLOW_ENOUGH, "utf-8")
    with pytest.MonkeyPatch.context() as patch:
        run_in_process(patch)
        conduct_here(path, out / "out")
    return (out / "out" / TABLE).read_bytes()


@pytest.mark.slow
def test_killed_and_resumed_study_gives_same_table(
    write_study: Any, tmp_path: Path, undisturbed: bytes
) -> None:
    """Byte-exact: repeated runs and their order have no effect."""
    path, out = write_study(SLOW_ENOUGH), tmp_path / "out"
    killing = "os.kill(os.getpid(), signal.SIGKILL)"
    process = start(path, out, "--jobs", "2", part_1="kill_worker()", part_3=killing)
    _, err = process.communicate(timeout=600)  # ends when all that share its pipe have, the workers too
    assert process.returncode == -signal.SIGKILL, err
    assert len(list((out / PARTS).glob("*.parquet"))) == 3
    kept = len(Store(out).keys())
    assert kept >= 3
    assert not (out / TABLE).exists()
    assert len(missing_runs(make_plan(load_study(str(path))), Store(out))) == 10 - kept
    assert finish(path, out, "--jobs", "2") == undisturbed


@pytest.fixture
def loopback(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Start a scheduler in its own process, with one worker; return its address and its process."""
    file = tmp_path / "scheduler.json"
    place = ["--host", "127.0.0.1", "--no-dashboard"]

    def launch(part: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{part}", *options, *place]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    processes = [launch("scheduler", "--port", "0", "--scheduler-file", str(file))]
    try:
        while not (file.exists() and file.read_text().endswith("}")):
            assert processes[0].poll() is None
            time.sleep(0.05)
        address = json.loads(file.read_text())["address"]
        processes.append(launch("worker", address, "--nthreads", "1", "--no-nanny"))
        yield address, processes[0]
    finally:
        for process in processes:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_external_scheduler_serves_study(
    write_study: Any, tmp_path: Path, undisturbed: bytes, loopback: Any
) -> None:
    address, _ = loopback
    assert finish(write_study(SLOW_ENOUGH), tmp_path / "out", "--scheduler", address) == undisturbed


@pytest.mark.slow
def test_lost_scheduler_is_reported_and_outcomes_kept(
    write_study: Any, tmp_path: Path, loopback: Any
) -> None:
    address, scheduler = loopback
    path, out = write_study(SLOW_ENOUGH), tmp_path / "out"
    killing = f"os.kill({scheduler.pid}, signal.SIGKILL)"
    process = start(path, out, "--scheduler", address, part_1=killing)
    _, err = process.communicate(timeout=600)
    assert (process.returncode, err) == (
        2,
        "error: the scheduler stopped; the same command continues from here\n",
    )
    assert Store(out).keys()


@pytest.mark.slow
def test_run_that_kills_workers_is_recorded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A run's key stands for the run: Python code that the worker executes."""
    from skyherd.study.cluster import run_missions

    monkeypatch.setattr("skyherd.study.cluster.measure", eval)
    bad = "__import__('os')._exit(1)"
    good = [f"dict(key={number}, error=None)" for number in range(6)]
    with open_client(jobs=2) as client:
        missions: Any = ((text, {}) for text in [bad, *good])
        batches: Any = run_missions(client, missions, {})  # type: ignore[arg-type]
        outcomes = {outcome["key"]: outcome["error"] for batch in batches for outcome in batch}
    assert "died" in outcomes.pop(bad)
    assert outcomes == dict.fromkeys(range(6))


def test_local_cluster_rejects_foreign_connections() -> None:
    """Without the run's certificate neither plain text nor TLS gets an answer; the run itself does."""
    with open_client(jobs=1) as client:
        assert client.submit(sum, [1, 2]).result() == 3
        address = client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        assert all(worker.startswith("tls://127.0.0.1:") for worker in client.nthreads())
        for other, security in (
            (address.replace("tls:", "tcp:"), None),
            (address, Security.temporary()),
        ):
            with pytest.raises(OSError, match=r"Timed out|reset|closed|SSL|TLS"):
                Client(other, security=security, timeout=1)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupt_leaves_intact_folder(write_study: Any, tmp_path: Path, number: int) -> None:
    path, out = write_study(SLOW_ENOUGH.replace("6.0", "20.0")), tmp_path / "out"
    process = start(path, out, "--jobs", "2", part_1=f"os.kill(os.getpid(), {int(number)})")
    _, err = process.communicate(timeout=600)
    assert process.returncode == 128 + number
    assert err.count("\n") == 1 and "continues from here" in err
    assert len(Store(out).keys()) >= 1
    assert not (out / TABLE).exists()
    assert not list(out.rglob("*.part"))
