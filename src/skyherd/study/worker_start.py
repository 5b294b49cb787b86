"""A module that Dask loads at the start of each local worker."""

from typing import Any

from skyherd.jobs.lifetime import end_with_parent


def dask_setup(worker: Any) -> None:
    """Let the worker's process end with the process of the study."""
    end_with_parent()
