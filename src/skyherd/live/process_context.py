"""What every live process has: the set-up, a radio, a clock, a process_log, and ways to say something."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from skyherd.live.lab import Lab
from skyherd.live.live_clock import LiveClock
from skyherd.live.logs.process_log import ProcessLog
from skyherd.live.mailbox import Mailbox, Radio

HEARTBEAT_S = 0.25
"""Time between two signs of life, s. Chosen: clocks are compared four times a second."""

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

    def mailbox(self, name: str, kinds: tuple[str, ...]) -> Mailbox:
        """The mailbox of a process of this name."""
        return Mailbox(self.radio, self.lab.model.team, name, self.clock, kinds, self.tell)

    def process_log(self, name: str) -> ProcessLog:
        """A new file for a process of this name; earlier ones of the same run stay."""
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
        self._context, self._diary, self._last = context, process_log, ""

    def say(self, line: str) -> None:
        """Say a line unless the last one was the same but for its numbers; nothing for an empty one."""
        if (gist := _NUMBERS.sub("", line)) != self._last:
            self._last = gist
            if line:
                self._diary.put("/tell", self._context.clock(), {"line": line})
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
