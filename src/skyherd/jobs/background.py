"""A thread that does one job at a time, beside a loop that must not wait."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Generic, ParamSpec, Self, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class BackgroundWorker(Generic[Result]):
    """One thread for one job at a time. Its context waits for the last job.

    Args:
        name: name of the thread.
    """

    def __init__(self, name: str) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)
        self._job: Future[Result] | None = None

    @property
    def is_free(self) -> bool:
        """True if no job runs and no result waits to be taken."""
        return self._job is None

    def start(
        self, job: Callable[Arguments, Result], *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> None:
        """Start a job. Call it only if the worker is free."""
        self._job = self._thread.submit(job, *args, **kwargs)

    def take(self) -> Result | None:
        """Return the result of a finished job, once, or raise its error; None without one."""
        if self._job is None or not self._job.done():
            return None
        job, self._job = self._job, None
        return job.result()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thread.shutdown(cancel_futures=True)
