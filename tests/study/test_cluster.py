"""Studies through Dask: no kill at any moment changes the table."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from distributed import Client, Security
from study_runs import SLOW_ENOUGH, conduct_here, run_in_process

from skyherd.study.cluster import open_client
from skyherd.study.conduct import missing_runs
from skyherd.study.plan import make_plan
from skyherd.study.spec import load_study
from skyherd.study.store import PARTS, Store
from skyherd.study.table import TABLE

SKYHERD = [sys.executable, "-c", "from skyherd.cli import main; main()"]


def start(path: Path, out: Path, *options: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*SKYHERD, "study", str(path), "--out", str(out), *options],
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


def parts(out: Path) -> list[Path]:
    return sorted((out / PARTS).glob("*.parquet"))


def wait_for_parts(process: subprocess.Popen[str], out: Path, count: int) -> None:
    """Until so many parts are there and the study is in its middle."""
    ends = time.monotonic() + 600
    while len(parts(out)) < count:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < ends
        time.sleep(0.02)


def workers(process: subprocess.Popen[str]) -> list[psutil.Process]:
    children = psutil.Process(process.pid).children(recursive=True)
    return [child for child in children if "spawn_main" in " ".join(child.cmdline())]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The table of the same study, run one after the other without any cluster."""
    out = tmp_path_factory.mktemp("study")
    path = out / "small.toml"
    path.write_text(SLOW_ENOUGH, "utf-8")
    with pytest.MonkeyPatch.context() as patch:
        run_in_process(patch)
        conduct_here(path, out / "out")
    return (out / "out" / TABLE).read_bytes()


@pytest.mark.slow
def test_worker_and_client_killed_in_mid_study_and_resumed_give_the_undisturbed_table(
    write_study: Any, tmp_path: Path, undisturbed: bytes
) -> None:
    """The table to the byte: a run that was made twice or in another order shows nowhere."""
    path, out = write_study(SLOW_ENOUGH), tmp_path / "out"
    process = start(path, out, "--jobs", "2")
    wait_for_parts(process, out, 1)
    agents = workers(process)
    assert len(agents) == 2
    agents[0].kill()
    wait_for_parts(process, out, len(parts(out)) + 2)
    process.kill()
    process.communicate()
    kept = len(Store(out).keys())
    assert 3 <= kept < 10
    assert not (out / TABLE).exists()
    psutil.wait_procs(agents, timeout=120)
    assert not any(worker.is_running() and worker.status() != "zombie" for worker in agents)
    assert len(missing_runs(make_plan(load_study(str(path))), Store(out))) == 10 - kept
    assert finish(path, out, "--jobs", "2") == undisturbed


@pytest.fixture
def loopback(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A scheduler in a process of its own, with one worker: its address, and its process."""
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
def test_a_second_process_as_scheduler_serves_the_same_study(
    write_study: Any, tmp_path: Path, undisturbed: bytes, loopback: Any
) -> None:
    address, _ = loopback
    assert finish(write_study(SLOW_ENOUGH), tmp_path / "out", "--scheduler", address) == undisturbed


@pytest.mark.slow
def test_a_scheduler_that_goes_is_told_in_one_line_and_what_was_made_is_kept(
    write_study: Any, tmp_path: Path, loopback: Any
) -> None:
    address, scheduler = loopback
    path, out = write_study(SLOW_ENOUGH), tmp_path / "out"
    process = start(path, out, "--scheduler", address)
    wait_for_parts(process, out, 1)
    scheduler.kill()
    _, err = process.communicate(timeout=600)
    assert (process.returncode, err) == (
        2,
        "error: the scheduler is gone; the same command goes on from here\n",
    )
    assert Store(out).keys()


@pytest.mark.slow
def test_a_run_that_kills_its_workers_is_recorded_and_the_others_are_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A run's key stands in for the run: Python that the worker carries out."""
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


def test_nobody_else_gets_into_the_local_cluster() -> None:
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
def test_an_interrupt_leaves_a_whole_folder(write_study: Any, tmp_path: Path, number: int) -> None:
    path, out = write_study(SLOW_ENOUGH.replace("6.0", "20.0")), tmp_path / "out"
    process = start(path, out, "--jobs", "2")
    wait_for_parts(process, out, 1)
    process.send_signal(number)
    _, err = process.communicate(timeout=600)
    assert process.returncode == 128 + number
    assert err.count("\n") == 1 and "goes on from here" in err
    assert len(Store(out).keys()) >= 1
    assert not (out / TABLE).exists()
    assert not list(out.rglob("*.part"))
