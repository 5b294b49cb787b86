"""What every live process has: the set-up, a radio, a clock, a log, a name of its own, and status lines."""

import math
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from skyherd.errors import InputError
from skyherd.live.lab import Lab
from skyherd.live.live_clock import LiveClock
from skyherd.live.logs.process_log import ProcessLog
from skyherd.live.mailbox import Mailbox, Radio
from skyherd.live.name_locks import WAIT_S, hold_name
from skyherd.live.stop_latch import StopLatch

HEARTBEAT_S = 0.25
"""Time between two heartbeats, s. Chosen: clocks are compared four times a second."""

CLAIM_S = 1.0
"""Time that a new process listens for another one of its name, s. Chosen: four heartbeats."""

_NUMBERS = re.compile(r"[\d.]+")


@dataclass
class ProcessContext:
    """What every live process has.

    Attributes:
        lab: the set-up.
        radio: carries its messages.
        clock: its own.
        folder: where it records.
        tell: says a line to people.
        ended: asked before each round; True ends the process.
    """

    lab: Lab
    radio: Radio
    clock: LiveClock
    folder: Path
    tell: Callable[[str], None]
    ended: Callable[[], bool] = lambda: False

    def mailbox(self, name: str, kinds: tuple[str, ...], latch: Callable[[], StopLatch]) -> Mailbox:
        """Return the mailbox of a process of this name, whose messages carry what `latch` returns."""
        return Mailbox(self.radio, self.lab.model.team, name, self.clock, kinds, self.tell, latch)

    @contextmanager
    def claimed(self, name: str) -> Iterator[None]:
        """Hold a name, after listening for another process that uses it.

        On this machine a lock holds it, so that a suspended process is noticed too. On other machines a
        process is noticed by its heartbeats.

        Raises:
            InputError: another process uses the name.
        """
        with hold_name(self.lab, name, wait_s=WAIT_S):
            mailbox = self.mailbox(name, (f"heartbeat/{name}",), StopLatch)
            end_s = time.monotonic() + CLAIM_S
            while (left_s := end_s - time.monotonic()) > 0 and not self.ended():
                for arrival in mailbox.fetch(left_s):
                    if arrival.envelope.sender == name:
                        raise InputError(
                            f"{name} of team {self.lab.model.team}",
                            "a process of this name is alive on another machine",
                            "end that one first",
                        )
            yield

    def process_log(self, name: str) -> ProcessLog:
        """Return a new log for a process of this name; earlier logs of the same run stay."""
        self.folder.mkdir(parents=True, exist_ok=True)
        stem = name.replace("/", "_")
        path = next(
            path
            for number in range(10_000)
            if not (path := self.folder / f"{stem}{f'.{number}' if number else ''}.mcap").exists()
        )
        return ProcessLog(path, name, self.lab, self.clock())


class StatusLine:
    """Tells people a line when it changes, and keeps it."""

    def __init__(self, context: ProcessContext, process_log: ProcessLog) -> None:
        self._context, self._process_log, self._last = context, process_log, ""

    def say(self, line: str) -> None:
        """Say a line unless the last one was the same but for its numbers; nothing for an empty one."""
        if (gist := _NUMBERS.sub("", line)) != self._last:
            self._last = gist
            if line:
                self._process_log.put("/tell", self._context.clock(), {"line": line})
                self._context.tell(line)


class HeartbeatTimer:
    """When a process sends its next heartbeat: every `HEARTBEAT_S`, and at once if its clock was set back."""

    def __init__(self) -> None:
        self._last_s = -math.inf

    def due(self, now_s: float) -> bool:
        """Whether it is time for one, which is then taken as given."""
        if 0 <= now_s - self._last_s < HEARTBEAT_S:
            return False
        self._last_s = now_s
        return True
