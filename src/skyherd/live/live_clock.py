"""Clock of a process: the time of day at its start, advanced by the machine's steady clock."""

import sys
import time

from skyherd.errors import InputError

MAX_OFFSET_S = 86_400.0
"""Largest deliberate clock offset, s. *Chosen*: one day, far above the limit of any lab. Recordings store
nanoseconds since 1970, which have room for it."""


_STEADY = time.CLOCK_MONOTONIC if sys.platform == "darwin" else getattr(time, "CLOCK_BOOTTIME", None)


def steady_s() -> float:
    """Return the time of a clock that never goes back, and that runs on while the machine sleeps, s.

    A robot whose computer slept must know how old its last message is. On Linux and macOS `time.monotonic`
    stands still meanwhile; on Windows it runs on.
    """
    return time.monotonic() if _STEADY is None else time.clock_gettime(_STEADY)


class LiveClock:
    """Time in seconds since 1970 that never goes back. Changes of the machine's time of day do not affect it.

    Args:
        offset_s: deliberate offset, for tests of clocks that disagree.

    Raises:
        InputError: the offset is not a number, or its magnitude exceeds `MAX_OFFSET_S`.
    """

    def __init__(self, offset_s: float = 0.0) -> None:
        if not abs(offset_s) <= MAX_OFFSET_S:
            raise InputError(
                "offset_s",
                f"{offset_s:g}",
                f"a number of seconds, {MAX_OFFSET_S:g} at most either way",
            )
        self._zero_s = time.time() - steady_s() + offset_s

    def __call__(self) -> float:
        """Return the current time, s since 1970."""
        return self._zero_s + steady_s()
