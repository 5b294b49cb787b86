"""A process's own clock: the time of day at the start, and from there on the machine's steady one."""

import time

from skyherd.errors import InputError

MAX_OFFSET_S = 86_400.0
"""Greatest offset of a clock that is off on purpose, s. *Chosen*: a day, far beyond what any lab trusts; the
nanoseconds since 1970 that recordings keep have room for it."""


class LiveClock:
    """Seconds since 1970 that never jump, whatever sets the machine's time of day meanwhile.

    Args:
        offset_s: is added to it; a clock that is off, for tests of what that does.

    Raises:
        InputError: the offset is no number, or more than `MAX_OFFSET_S` either way.
    """

    def __init__(self, offset_s: float = 0.0) -> None:
        if not abs(offset_s) <= MAX_OFFSET_S:
            raise InputError(
                "--clock-offset",
                f"{offset_s:g}",
                f"a number of seconds, {MAX_OFFSET_S:g} at most either way",
            )
        self._zero_s = time.time() - time.monotonic() + offset_s

    def __call__(self) -> float:
        """Now, s."""
        return self._zero_s + time.monotonic()
