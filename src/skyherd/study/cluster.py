"""Runs on many processes through Dask: those of this machine, or of a cluster that is there already."""

import logging
import signal
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from multiprocessing import resource_tracker
from typing import Any

import dask
from dask.system import CPU_COUNT
from distributed import Client, LocalCluster, as_completed
from distributed.scheduler import KilledWorker

from skyherd.datasets import Mission
from skyherd.errors import InputError, OutputError
from skyherd.study.measure import Outcome, failure, measure
from skyherd.version import __version__

WINDOW = 4
"""Runs under way for each thread of the cluster: none of them waits, and few wait for an interrupt."""

TIMEOUT_S = 5.0
"""For a scheduler to answer, and to have a worker."""

WORKER_DEATHS = 2
"""A run that was under way in more workers than this when they died is taken as what killed them."""

GONE = "the scheduler is gone; the same command goes on from here"

LOGGERS = ("distributed", "distributed.client", "distributed.utils", "tornado", "asyncio")
"""What goes wrong with a cluster is told once, in our words."""

_SETTINGS = {
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.scheduler.allowed-failures": WORKER_DEATHS,
    "distributed.scheduler.worker-saturation": 1.0,  # no run waits on a worker, lest it be blamed for a death
    "distributed.admin.large-graph-warning-threshold": "1GB",
    "distributed.nanny.pre-spawn-environ.OPENBLAS_NUM_THREADS": 1,
    "distributed.nanny.pre-spawn-environ.OMP_NUM_THREADS": 1,
    "distributed.nanny.pre-spawn-environ.MKL_NUM_THREADS": 1,
}


@contextmanager
def open_client(scheduler: str | None = None, jobs: int | None = None) -> Iterator[Client]:
    """A client of a scheduler, or of as many local processes of one thread, all cores by default.

    Raises:
        InputError: nothing answers there, it has no workers, or they have another skyherd.
    """
    for name in LOGGERS:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set(_SETTINGS):
        if scheduler is not None:
            with _connect(scheduler) as client:
                yield client
            return
        with _interrupts_held():
            cluster = _local_cluster(jobs or CPU_COUNT)
        with cluster, Client(cluster) as client:
            yield client


def run_missions(
    client: Client, missions: Iterable[tuple[str, Mission]], curves: Sequence[str]
) -> Iterator[list[Outcome]]:
    """Outcomes as they come, in batches of what is there; missions are made when there is room for them.

    Raises:
        OutputError: the cluster is gone.
    """
    waiting, done = iter(missions), as_completed()
    while True:
        threads = _threads(client)
        for key, mission in islice(waiting, max(0, WINDOW * threads - done.count())):
            done.add(client.submit(measure, key, mission, curves, key=f"run-{key}", pure=False))
        if done.is_empty():
            return
        yield [_outcome(future) for future in done.next_batch()]


def _threads(client: Client) -> int:
    """Threads that the cluster has now; the first that notices a scheduler that went between two batches."""
    try:
        threads: int = sum(client.nthreads().values())
    except OSError:
        raise OutputError(GONE) from None
    return max(1, threads)


def _outcome(future: Any) -> Outcome:
    key = future.key.removeprefix("run-")
    if future.status == "finished":
        result: Outcome = future.result()
        return result
    if future.status != "error":
        raise OutputError(GONE)
    error = future.exception()
    if isinstance(error, KilledWorker):
        return failure(key, "each worker that tried it died, perhaps for want of memory")
    return failure(key, f"{type(error).__name__}: {error}")


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back while workers start: half-started ones cannot be closed.

    Workers inherit this thread's mask, those that are started anew too: an interrupt is the parent's to obey.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    resource_tracker.ensure_running()  # started later, it would take the mask away
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    handler = signal.signal(signal.SIGINT, lambda number, frame: held.append(number))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)
    if held:
        raise KeyboardInterrupt


def _local_cluster(jobs: int) -> LocalCluster:
    """Workers of one thread that listen to nobody but this machine; no dashboard."""
    try:
        return LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            scheduler_port=0,
            scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
            silence_logs=logging.CRITICAL,
        )
    except (RuntimeError, OSError) as error:
        raise OutputError(
            f"{jobs} worker processes could not be started: {error}; try fewer --jobs"
        ) from None


@contextmanager
def _connect(address: str) -> Iterator[Client]:
    try:
        client = Client(address, timeout=TIMEOUT_S)
    except (OSError, ValueError) as error:
        why = "not an address" if isinstance(error, ValueError) else "no scheduler answers there"
        raise InputError(f"--scheduler {address}", why, "such as tcp://192.168.1.2:8786") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=TIMEOUT_S)
        except TimeoutError:
            what = f"has no workers after {TIMEOUT_S:g} s"
            allowed = f"start some there: dask worker {address} --nthreads 1"
            raise InputError(f"--scheduler {address}", what, allowed) from None
        for worker, found in client.run(_version, on_error="return").items():
            _check_version(worker, found)
        yield client


def _version() -> str:
    """Of a worker's skyherd."""
    return __version__


def _check_version(worker: str, found: Any) -> None:
    if found != __version__:
        what = f"has skyherd {found}" if isinstance(found, str) else "has no skyherd"
        raise InputError(f"worker {worker}", what, f"pip install skyherd=={__version__} there, as here")
