"""Context of a live process: lab, radio, clock, log, name lock, status lines and heartbeat timer."""

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
"""Heartbeat period, s. Chosen: four clock comparisons a second."""

CLAIM_S = 1.0
"""Time for which a new process listens for another process of its name, s. Chosen: four heartbeats."""

_NUMBERS = re.compile(r"[\d.]+")


@dataclass
class ProcessContext:
    """Resources of one live process.

    Attributes:
        lab: the set-up.
        radio: carries its messages.
        clock: the clock of the process.
        folder: folder of its recordings.
        tell: called with each status line.
        ended: called before each cycle; True ends the process.
        supervised: whether a session runs the process.
        dry_run: whether commands to robots and autopilots are not sent.
    """

    lab: Lab
    radio: Radio
    clock: LiveClock
    folder: Path
    tell: Callable[[str], None]
    ended: Callable[[], bool] = lambda: False
    supervised: bool = False
    dry_run: bool = False

    def mailbox(self, name: str, kinds: tuple[str, ...], latch: Callable[[], StopLatch]) -> Mailbox:
        """Return the mailbox of a process of this name. Its messages carry the latch from `latch()`."""
        return Mailbox(self.radio, self.lab.model.team, name, self.clock, kinds, self.tell, latch)

    @contextmanager
    def claimed(self, name: str) -> Iterator[None]:
        """Hold a name, after listening for another process that uses it.

        A lock holds the name on this machine, which also detects a suspended process. Heartbeats reveal a
        process on another machine.

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
                            "a process of this name runs on another machine",
                            "end that process first",
                        )
            yield

    def process_log(self, name: str) -> ProcessLog:
        """Return a new log for a process of this name. Earlier logs of the same run are kept."""
        self.folder.mkdir(parents=True, exist_ok=True)
        stem = name.replace("/", "_")
        path = next(
            path
            for number in range(10_000)
            if not (path := self.folder / f"{stem}{f'.{number}' if number else ''}.mcap").exists()
        )
        return ProcessLog(
            path, name, self.lab, self.clock(), supervised=self.supervised, dry_run=self.dry_run
        )


class StatusLine:
    """Status line of a process, reported and recorded when it changes."""

    def __init__(self, context: ProcessContext, process_log: ProcessLog) -> None:
        self._context, self._process_log, self._last = context, process_log, ""

    def say(self, line: str) -> None:
        """Report a line unless it equals the last one except for numbers. An empty line reports nothing."""
        if (gist := _NUMBERS.sub("", line)) != self._last:
            self._last = gist
            if line:
                self._process_log.put("/tell", self._context.clock(), {"line": line})
                self._context.tell(line)


class HeartbeatTimer:
    """Timer of heartbeats: one every `HEARTBEAT_S`.

    A heartbeat is also due at once when the clock was set back.
    """

    def __init__(self) -> None:
        self._last_s = -math.inf

    def due(self, now_s: float) -> bool:
        """Return whether a heartbeat is due, and restart the timer if so."""
        if 0 <= now_s - self._last_s < HEARTBEAT_S:
            return False
        self._last_s = now_s
        return True
