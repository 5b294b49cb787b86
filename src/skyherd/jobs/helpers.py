"""Helpers: forked worker processes that answer requests in order.

A helper is a fork of its parent process. It inherits all loaded modules and data, so that it starts within
milliseconds without imports or compilation. Threads do not help, since most of the time goes to many short
calls of NumPy, which hold the interpreter's lock. *Measured* on two cores in two runs: the three cameras of
`star` took 39 and 47 ms per step in sequence, and 48 and 50 ms in three threads.

Only Linux forks processes safely with the libraries used here. On other systems `can_help` returns False, and
callers work without helpers. OpenCV's threads do not survive a fork, so that OpenCV gets one thread while
helpers exist (`one_thread`).

A helper ends when its parent closes it. If the parent ends in any other way, even by SIGKILL, the kernel
kills the helper (`skyherd.jobs.lifetime`). The thread that creates a helper must therefore live as long as
the helper is needed. A helper ignores signals, since a terminal sends Ctrl-C to both processes.
"""

import multiprocessing
import os
import pickle
import queue
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.util import Finalize
from types import TracebackType
from typing import Any, Self, TypeVar

from skyherd.jobs.lifetime import end_with_parent

Item = TypeVar("Item")
"""Unit of work."""

Result = TypeVar("Result")
"""Result of an item."""

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
"""Signals that a helper ignores; its parent handles them."""

PATIENCE_S = 20.0
"""Longest time for the end of a closed helper before it is killed, s. *Chosen*: many times the usual time."""

_open: "list[Helper]" = []
"""Open helpers of this process. A helper that is forked later closes its copies of their pipes."""


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def can_help() -> bool:
    """Return whether this system forks processes safely."""
    return sys.platform == "linux"


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit OpenCV to one thread in the body, since its threads do not survive a fork."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


class Helper:
    """Fork of this process that answers requests in order until it is closed.

    Use it in a `with` block, or call `close`. The helper queues up to `waiting` requests. `ask` blocks while
    the queue is full.

    Attributes:
        pipe: connection of this process to the helper.

    Args:
        serve: returns the answer to a request. It runs in the helper and may keep state there. `answer`
            raises its exceptions.
        gone: exception to raise if the helper ends unexpectedly, such as for lack of memory.
        waiting: length of the queue of requests.
    """

    def __init__(self, serve: Callable[[Any], Any], gone: Exception, *, waiting: int = 1) -> None:
        context = multiprocessing.get_context("fork")
        self._gone = gone
        self.pipe, its_pipe = context.Pipe()
        arguments = (serve, its_pipe, [self.pipe, *(other.pipe for other in _open)], waiting)
        self._process = context.Process(target=_work, args=arguments, daemon=True)
        with _signals_blocked(), warnings.catch_warnings():
            # Python 3.12 and later warn if any thread runs. OpenBLAS stops and restarts its threads around a
            # fork.
            warnings.simplefilter("ignore", DeprecationWarning)
            self._process.start()
        its_pipe.close()
        _open.append(self)
        # At its end the interpreter waits for helpers that were not closed. This makes them end.
        self._finalizer = Finalize(self, self.pipe.close, exitpriority=10)

    def ask(self, request: object) -> None:
        """Pickle and send a request."""
        self.send(pickle.dumps(request, pickle.HIGHEST_PROTOCOL))

    def send(self, request: bytes) -> None:
        """Send a pickled request. Several helpers can share one pickle."""
        try:
            self.pipe.send_bytes(request)
        except OSError:
            raise self._gone from None

    def answered(self) -> bool:
        """Return whether `answer` would return or raise at once."""
        return self.pipe.poll()

    def answer(self) -> Any:
        """Wait for the answer to the oldest unanswered request, and return it."""
        try:
            error, result = self.pipe.recv()
        except (EOFError, OSError):
            raise self._gone from None
        if error is not None:
            raise error
        return result

    def close(self) -> None:
        """End the helper after its current request. Queued requests are dropped."""
        if self in _open:
            _open.remove(self)
            self._finalizer()
            self._process.join(PATIENCE_S)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def shared(work: Callable[[Item], Result], items: Sequence[Item], jobs: int, gone: Exception) -> list[Result]:
    """Return the results of `work` for all items, in order, computed by up to `jobs` parallel helpers.

    An idle helper gets the next item. With one job or item, or where `can_help` returns False, this process
    does the work.

    Args:
        work: returns the result of an item; both must be picklable.
        items: the items of work.
        jobs: maximum number of helpers.
        gone: exception to raise if a helper ends unexpectedly.

    Raises:
        Exception: the first exception of `work`; the helpers are then ended.
    """
    if min(jobs, len(items)) <= 1 or not can_help():
        return [work(item) for item in items]
    results: dict[int, Result] = {}
    left = list(enumerate(items))
    with ExitStack() as stack:
        helpers = [stack.enter_context(Helper(work, gone)) for _ in range(min(jobs, len(items)))]
        busy: dict[Connection, tuple[Helper, int]] = {}
        idle = list(helpers)
        while left or busy:
            while idle and left:
                helper, (row, item) = idle.pop(), left.pop(0)
                helper.ask(item)
                busy[helper.pipe] = helper, row
            for pipe in wait(list(busy)):
                helper, row = busy.pop(pipe)  # type: ignore[call-overload]
                results[row] = helper.answer()
                idle.append(helper)
    return [results[row] for row in range(len(items))]


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """Block `SIGNALS` in the body, so that none arrives between a fork and its follow-up."""
    numbers = {getattr(signal, name) for name in SIGNALS}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(serve: Callable[[Any], Any], pipe: Connection, others: list[Connection], waiting: int) -> None:
    """Answer requests until the parent closes the pipe or ends.

    A thread reads the requests, so that the parent does not block while the helper works.
    """
    end_with_parent()
    _open.clear()
    with suppress(ValueError):  # only a main thread can set handlers
        for name in SIGNALS:
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {getattr(signal, name) for name in SIGNALS})
    for other in others:
        other.close()
    requests: queue.Queue[bytes | None] = queue.Queue(waiting)
    closed = threading.Event()
    threading.Thread(target=_read, args=(pipe, requests, closed), daemon=True).start()
    while (request := requests.get()) is not None and not closed.is_set():
        try:
            answer: tuple[Exception | None, Any] = None, serve(pickle.loads(request))
        except Exception as error:
            answer = _portable(error), None
        with suppress(OSError):
            pipe.send(answer)


def _read(pipe: Connection, requests: "queue.Queue[bytes | None]", closed: threading.Event) -> None:
    """Put the requests from a pipe into a queue, and None at the end."""
    try:
        while True:
            requests.put(pipe.recv_bytes())
    except (EOFError, OSError):
        closed.set()
        requests.put(None)


def _portable(error: Exception) -> Exception:
    """Return an error that survives pickling, with the traceback of the helper as a note."""
    error.add_note("in a helper:\n" + "".join(traceback.format_exception(error)).rstrip())
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:
        copy = RuntimeError(f"{type(error).__name__}: {error}")
    return copy if isinstance(copy, Exception) else RuntimeError(str(error))
