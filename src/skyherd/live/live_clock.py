"""A process's own clock: the time of day at the start, and from there on the machine's steady one."""

import time


class LiveClock:
    """Seconds since 1970 that never jump, whatever sets the machine's time of day meanwhile.

    Args:
        offset_s: is added to it; a clock that is off, for tests of what that does.
    """

    def __init__(self, offset_s: float = 0.0) -> None:
        self._zero_s = time.time() - time.monotonic() + offset_s

    def __call__(self) -> float:
        """Now, s."""
        return self._zero_s + time.monotonic()
