"""Parallel execution of runs by Dask, in local processes or on an existing cluster.

A thread of a worker executes one run at a time, without files (`skyherd.study.measure`), and returns its
outcome. Local workers listen on loopback only, and have no dashboard. Any client of a worker can execute code
there, and every user of a machine has access to its ports. Local workers and their scheduler therefore use
mutual TLS, with a temporary certificate that stays in memory. Local workers and their temporary files end
with this process, even if it is killed.
"""

import logging
import signal
import ssl
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import islice
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import dask
from dask.system import CPU_COUNT
from distributed import Client, LocalCluster, Security, as_completed
from distributed.scheduler import KilledWorker

from skyherd.datasets import Mission
from skyherd.errors import InputError, OutputError
from skyherd.jobs.lifetime import temporary_folder
from skyherd.study.measure import Outcome, failure, measure
from skyherd.version import __version__

PROTOCOLS = ("tcp://", "tls://")
"""Prefixes of scheduler addresses."""

WINDOW = 4
"""Submitted runs per thread of the cluster. Chosen: with 1, threads wait between two runs. Larger values make
missions earlier than needed."""

TIMEOUT_S = 5.0
"""Timeout of a scheduler's answer, and again of its first worker, s. Chosen."""

WORKER_DEATHS = 2
"""Largest number of workers that may die during one run; with one more, the run counts as failed. Chosen."""

LOST = "lost"
"""Status of a run whose outcome was lost with its worker. The scheduler repeats it. Defined by Dask."""

GONE = "the scheduler stopped; the same command continues from here"
"""Message of the error when the cluster stops answering."""

LOGGERS = ("distributed", "distributed.client", "distributed.utils", "tornado", "asyncio")
"""Silenced loggers: an exception of skyherd reports each error of the cluster once."""

WORKER_START = "skyherd.study.worker_start"
"""Module that Dask loads in each local worker before its first run."""

_SETTINGS = {
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.scheduler.allowed-failures": WORKER_DEATHS,
    "distributed.scheduler.worker-saturation": 1.0,  # Waiting runs would be blamed for a worker's death.
    "distributed.admin.large-graph-warning-threshold": "1GB",
    "distributed.nanny.pre-spawn-environ.OPENBLAS_NUM_THREADS": 1,
    "distributed.nanny.pre-spawn-environ.OMP_NUM_THREADS": 1,
    "distributed.nanny.pre-spawn-environ.MKL_NUM_THREADS": 1,
}


@contextmanager
def open_client(scheduler: str | None = None, jobs: int | None = None) -> Iterator[Client]:
    """Open a Dask client, and close it and its local workers at the end of the context.

    Args:
        scheduler: address of a scheduler, such as `tcp://192.168.1.2:8786`; local processes if None.
        jobs: number of local processes with one thread each; one per core if None.

    Raises:
        InputError: the scheduler does not answer, has no workers, or a worker has another version of skyherd.
        OutputError: the local processes or their temporary folder cannot be made.
    """
    for name in LOGGERS:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set(_SETTINGS):
        if scheduler is not None:
            with _connect(scheduler) as client:
                yield client
            return
        jobs = jobs or CPU_COUNT
        with ExitStack() as stack:
            try:
                folder = stack.enter_context(temporary_folder("skyherd-study-"))
            except OSError as error:
                raise OutputError(f"no temporary folder could be made: {error.strerror or error}") from None
            with _interrupts_delayed():
                cluster = _local_cluster(jobs, folder)
            stack.enter_context(cluster)
            yield stack.enter_context(Client(cluster))


def run_missions(
    client: Client, missions: Iterable[tuple[str, Mission]], curves: Sequence[str]
) -> Iterator[list[Outcome]]:
    """Run missions on a cluster, and yield batches of outcomes in order of completion.

    The iterable may be very long: a mission is taken only shortly before a thread is free for it.

    Args:
        client: client of the cluster.
        missions: key and mission of each run.
        curves: fields of the history to keep as arrays over time.

    Raises:
        OutputError: the scheduler stopped.
    """
    waiting, done = iter(missions), as_completed()
    while True:
        threads = _threads(client)
        for key, mission in islice(waiting, max(0, WINDOW * threads - done.count())):
            done.add(client.submit(measure, key, mission, curves, key=f"run-{key}", pure=False))
        if done.is_empty():
            return
        outcomes = []
        for future in done.next_batch():
            if future.status == LOST and client.status == "running":
                done.add(future)  # The worker died before its outcome was fetched.
            else:
                outcomes.append(_outcome(future))
        if outcomes:
            yield outcomes


def _threads(client: Client) -> int:
    """Return the cluster's current number of threads, at least 1. Raise OutputError without a scheduler."""
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
        return failure(key, "each worker that tried it died, possibly for lack of memory")
    return failure(key, f"{type(error).__name__}: {error}")


@contextmanager
def _interrupts_delayed() -> Iterator[None]:
    """Delay SIGINT and SIGTERM until workers have started, since half-started ones cannot be closed.

    Workers inherit the signal mask of this thread, also those that start later. Only this process reacts to
    SIGINT (Ctrl-C). SIGTERM is delayed but not masked, since it ends workers.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    delayed: list[int] = []
    resource_tracker.ensure_running()  # Started later, it would reset the mask.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    handlers = {
        number: signal.signal(number, lambda number, frame: delayed.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in handlers.items():
            signal.signal(number, handler)
    if delayed:
        signal.raise_signal(delayed[0])


def _local_cluster(jobs: int, folder: Path) -> LocalCluster:
    """Start workers with one thread each, on loopback by TLS, without a dashboard.

    Args:
        jobs: number of workers.
        folder: folder of their temporary files.

    Raises:
        OutputError: the workers cannot be started.
    """
    try:
        return LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            scheduler_port=0,
            protocol="tls://",
            security=Security.temporary(),
            local_directory=str(folder),
            preload=WORKER_START,
            scheduler_kwargs={
                "dashboard": False,
                "dashboard_address": "127.0.0.1:0",
                "local_directory": str(folder),
            },
            silence_logs=logging.CRITICAL,
        )
    except (RuntimeError, OSError) as error:
        raise OutputError(
            f"{jobs} worker processes could not be started: {error}; try fewer `jobs=`"
        ) from None


@contextmanager
def _connect(address: str) -> Iterator[Client]:
    allowed = "such as tcp://192.168.1.2:8786, or tls:// with certificates in Dask's configuration"
    if not address.startswith(PROTOCOLS):
        raise InputError("scheduler", f"{address!r} is not an address", allowed)
    try:
        client = Client(address, timeout=TIMEOUT_S)
    except ssl.SSLError as error:
        raise InputError("scheduler", f"TLS of {address} fails: {error.reason}", allowed) from None
    except OSError:
        raise InputError("scheduler", f"no scheduler answers at {address}", allowed) from None
    except TypeError:  # A TLS address without certificates.
        raise InputError("scheduler", f"no certificates for TLS with {address}", allowed) from None
    except (ValueError, RuntimeError):
        raise InputError("scheduler", f"{address!r} is not an address", allowed) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=TIMEOUT_S)
        except TimeoutError:
            what = f"{address} has no workers after {TIMEOUT_S:g} s"
            allowed = f"start some there: `dask worker {address} --nthreads 1`"
            raise InputError("scheduler", what, allowed) from None
        for worker, found in client.run(_version, on_error="return").items():
            _check_version(worker, found)
        yield client


def _version() -> str:
    """Return the version of skyherd in the process of the call, such as a worker."""
    return __version__


def _check_version(worker: str, found: Any) -> None:
    if found != __version__:
        what = f"has skyherd {found}" if isinstance(found, str) else "has no skyherd"
        raise InputError(f"worker {worker}", what, f"pip install skyherd=={__version__} there, as here")
