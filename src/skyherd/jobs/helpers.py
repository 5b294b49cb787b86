"""Helpers: forked worker processes that answer requests in order.

A helper starts as a copy of its parent, with all loaded modules, compiled functions and data. The start takes
milliseconds. Threads do not help here: most of the time goes to many short calls of NumPy, which hold the
interpreter's lock. *Measured* for a step of the three cameras of `star`, on two cores: 25 ms one after the
other, 25 ms in two threads, 20 ms in two helpers.

Only Linux forks safely with the libraries used here. Elsewhere `can_help` returns False, and callers work
without helpers. OpenCV's threads do not survive a fork, so OpenCV gets one thread while there are helpers
(`one_thread`).

A helper ends when its parent closes it. If the parent ends in any other way, even by SIGKILL, the kernel
kills the helper (`skyherd.jobs.lifetime`). The thread that makes a helper must therefore live as long as the
helper. A helper ignores signals, since a terminal sends Ctrl-C to both processes.
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
"""Signals that a helper ignores."""

PATIENCE_S = 20.0
"""Timeout of `Helper.close`, s; a helper that still runs is killed. *Chosen*: many times the usual time."""

_open: "list[Helper]" = []
"""Open helpers of this process. Each later fork inherits copies of their pipes, and closes them."""


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def can_help() -> bool:
    """Return whether this system forks processes safely."""
    return sys.platform == "linux"


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit OpenCV to one thread in the body, so that a fork loses no thread."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


class Helper:
    """Fork of this process that answers requests in order, until it is closed.

    Use it in a `with` block, or call `close`. Requests wait in the helper's queue. When it is full, further
    requests fill the pipe, and then `ask` blocks.

    Attributes:
        pipe: connection to the helper.

    Args:
        serve: returns the answer to a request. It runs in the helper, and may keep state there. `answer`
            raises its exceptions.
        gone: exception to raise if the helper ends early, for example if the system kills it to free memory.
        waiting: size of the queue, requests.
    """

    def __init__(self, serve: Callable[[Any], Any], gone: Exception, *, waiting: int = 1) -> None:
        context = multiprocessing.get_context("fork")
        self._gone = gone
        self.pipe, its_pipe = context.Pipe()
        arguments = (serve, its_pipe, [self.pipe, *(other.pipe for other in _open)], waiting)
        self._process = context.Process(target=_work, args=arguments, daemon=True)
        with _signals_blocked(), warnings.catch_warnings():
            # Python 3.12 and newer warn of a fork while any thread runs. Those of OpenBLAS are harmless: it
            # stops and restarts them around a fork.
            warnings.simplefilter("ignore", DeprecationWarning)
            self._process.start()
        its_pipe.close()
        _open.append(self)
        # At its end the interpreter waits for helpers that are still open, so their pipes must close first.
        self._finalizer = Finalize(self, self.pipe.close, exitpriority=10)

    def ask(self, request: object) -> None:
        """Pickle and send a request."""
        self.send(pickle.dumps(request, pickle.HIGHEST_PROTOCOL))

    def send(self, request: bytes) -> None:
        """Send a pickled request, for example the same one to several helpers."""
        try:
            self.pipe.send_bytes(request)
        except OSError:
            raise self._gone from None

    def answered(self) -> bool:
        """Return whether `answer` would return or raise at once."""
        return self.pipe.poll()

    def answer(self) -> Any:
        """Wait for and return the answer to the earliest open request."""
        try:
            error, result = self.pipe.recv()
        except (EOFError, OSError):
            raise self._gone from None
        if error is not None:
            raise error
        return result

    def close(self) -> None:
        """End the helper after its current request. Discard the requests in its queue."""
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
    """Return the results of `work` for all items, in order, computed by at most `jobs` parallel helpers.

    An idle helper gets the next item. With one job or item, or where helpers are unavailable, this process
    does the work.

    Args:
        work: returns the result of an item; both are pickled.
        items: the items.
        jobs: largest number of helpers.
        gone: exception to raise if a helper ends early.

    Raises:
        Exception: the first exception of `work`; it closes the helpers.
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
    """Block `SIGNALS` in the body, so that none arrives before a new fork ignores them."""
    numbers = {getattr(signal, name) for name in SIGNALS}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(serve: Callable[[Any], Any], pipe: Connection, others: list[Connection], waiting: int) -> None:
    """Answer requests in the helper until its parent closes the pipe or ends.

    A separate thread reads requests, so that the parent does not block while the helper works.
    """
    end_with_parent()
    _open.clear()
    with suppress(ValueError):  # `signal.signal` raises it outside the main thread.
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
    """Move requests from a pipe to a queue, and add None at the end of the pipe."""
    try:
        while True:
            requests.put(pipe.recv_bytes())
    except (EOFError, OSError):
        closed.set()
        requests.put(None)


def _portable(error: Exception) -> Exception:
    """Return an error that survives pickling, with the helper's traceback as a note."""
    error.add_note("in a helper:\n" + "".join(traceback.format_exception(error)).rstrip())
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:
        copy = RuntimeError(f"{type(error).__name__}: {error}")
    return copy if isinstance(copy, Exception) else RuntimeError(str(error))
