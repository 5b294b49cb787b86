"""Helpers: processes beside the one that works, each of which answers requests in the order they come.

A helper is a fork of the process that makes it. It begins with everything that is loaded and computed there,
so that nothing is imported, compiled or sent to it, and it exists within milliseconds. Threads in place of
processes do not help where most of the time goes to many short calls of NumPy, which hold the interpreter's
lock: *measured* on two cores, the three cameras of `star` took 39 and 47 ms a step one after the other, and
48 and 50 ms in three threads.

Only Linux forks processes safely with the libraries that are used here; elsewhere `can_help` is false, and
callers work alone. OpenCV's own threads do not survive a fork, so that it is given one
thread for as long as there are helpers (`one_thread`).

A helper ends when its maker closes it. The kernel kills it when its maker ends in any other way, even by
SIGKILL (`skyherd.jobs.lifetime`): the thread that makes a helper must therefore live as long as the helper is
needed. A helper leaves signals to its maker, since a terminal sends Ctrl-C to both.
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
"""Signals that a helper leaves to its maker."""

PATIENCE_S = 20.0
"""How long a helper may take to tidy up when it is closed before its time, s. *Chosen*: many times what it
takes; one that hangs is killed then."""

_open: "list[Helper]" = []
"""Helpers of this process. Each one that is forked later has copies of their pipes, and closes them."""


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def can_help() -> bool:
    """Return whether this system forks processes safely."""
    return sys.platform == "linux"


@contextmanager
def one_thread() -> Iterator[None]:
    """Give OpenCV one thread in the body, so that none is lost when this process forks."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


class Helper:
    """A fork of this process that answers requests, in their order, until it is closed.

    Use it in a `with` block, or call `close`. The requests that it has not come to yet are kept in it; of
    these there are `waiting` at most, and `ask` waits for it to be done with one when there are more.

    Attributes:
        pipe: connects it with this process.

    Args:
        serve: makes of a request its answer. It is called in the helper, where it may keep what it likes.
            What it raises is raised by `answer`.
        gone: what to raise if the helper ends by itself, as when the system has no memory left and kills it.
        waiting: how many requests may wait.
    """

    def __init__(self, serve: Callable[[Any], Any], gone: Exception, *, waiting: int = 1) -> None:
        context = multiprocessing.get_context("fork")
        self._gone = gone
        self.pipe, its_pipe = context.Pipe()
        arguments = (serve, its_pipe, [self.pipe, *(other.pipe for other in _open)], waiting)
        self._process = context.Process(target=_work, args=arguments, daemon=True)
        with _signals_blocked(), warnings.catch_warnings():
            # From Python 3.12 on there is a warning if any thread runs, such as those of OpenBLAS, which
            # stops and starts them around a fork.
            warnings.simplefilter("ignore", DeprecationWarning)
            self._process.start()
        its_pipe.close()
        _open.append(self)
        # At the end of the interpreter helpers that were not closed are waited for, and must end.
        self._finalizer = Finalize(self, self.pipe.close, exitpriority=10)

    def ask(self, request: object) -> None:
        """Send a request, which is pickled."""
        self.send(pickle.dumps(request, pickle.HIGHEST_PROTOCOL))

    def send(self, request: bytes) -> None:
        """Send a request that is pickled already, as for several helpers."""
        try:
            self.pipe.send_bytes(request)
        except OSError:
            raise self._gone from None

    def answered(self) -> bool:
        """Return whether `answer` would return at once, or raise."""
        return self.pipe.poll()

    def answer(self) -> Any:
        """Wait for the answer to the earliest request that has none yet, and return it."""
        try:
            error, result = self.pipe.recv()
        except (EOFError, OSError):
            raise self._gone from None
        if error is not None:
            raise error
        return result

    def close(self) -> None:
        """End the helper, after the request that it is working on; those that wait are forgotten."""
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
    """Return the results of `work` for some items, in their order, from `jobs` parallel helpers.

    Each helper gets its next item when it is done with one, the first items first. With one job or item, or
    where there can be no helpers, the work is done here.

    Args:
        work: makes of an item its result; both are pickled on their way.
        items: what to work on.
        jobs: number of helpers, at most.
        gone: what to raise if a helper ends by itself.

    Raises:
        Exception: what `work` raised, first of all; the helpers are ended then.
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
    """Answer requests until the helper's maker has closed the pipe, or is gone.

    A thread reads the requests, so that its maker can go on while it works.
    """
    end_with_parent()
    _open.clear()
    with suppress(ValueError):  # there are no handlers to set if it was not forked from a main thread
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
    """Put pipe contents into a queue, and None at its end."""
    try:
        while True:
            requests.put(pipe.recv_bytes())
    except (EOFError, OSError):
        closed.set()
        requests.put(None)


def _portable(error: Exception) -> Exception:
    """Return an error that survives pickling, with the trace of its own process as a note."""
    error.add_note("in a helper:\n" + "".join(traceback.format_exception(error)).rstrip())
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:
        copy = RuntimeError(f"{type(error).__name__}: {error}")
    return copy if isinstance(copy, Exception) else RuntimeError(str(error))
