"""All processes of a lab on one machine: started, restarted when they crash, and ended together."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from skyherd.text import printable

FIRST_WAIT_S, MAX_WAIT_S = 0.5, 8.0
"""Pause before a process that crashed is started again, doubled each time up to the second, s. Chosen: a
short break costs little, and what crashes at once does not keep the machine busy."""

STEADY_S = 10.0
"""A process that ran for so long before it crashed is started again after the first pause, s."""

END_S = 10.0
"""How long processes have to end when they are asked to, before they are killed, s. Chosen: wheels are told
to stand still at once; the rest is a recording's last chunk."""

KILL_S = 5.0
"""Longest wait for a process that was killed, s. Chosen: the system ends it at once unless it waits for a
device."""

WRONG = 2
"""Exit code of a process that was given what is wrong."""

DONE = frozenset({0, WRONG, 129, 130, 143})
"""Exit codes after which a process is not restarted: it is done, its input is wrong, or a signal (SIGHUP,
SIGINT, SIGTERM) asked it to end."""


@dataclass
class Child:
    """One process.

    Attributes:
        name: such as `robot/3`.
        command: what starts it.
        restarts: how often it was started again.
        process: the process; None between two starts.
        code: its last exit code; None while it runs.
    """

    name: str
    command: Sequence[str]
    restarts: int = 0
    process: "subprocess.Popen[str] | None" = None
    code: int | None = None
    started_s: float = field(default=0.0, repr=False)
    wait_s: float = field(default=FIRST_WAIT_S, repr=False)
    again_s: float = field(default=0.0, repr=False)


class Supervisor:
    """Starts processes, keeps them running, and writes what they say into one log.

    Each has a pipe as its standard input whose other end this process holds: when this one ends, for
    whatever reason, theirs reads to its end, and they end.

    Args:
        log: file that every line goes to.
        tell: is given every line as well, with the time and the name of its process before it.
    """

    def __init__(self, log: Path, tell: Callable[[str], None] = lambda line: None) -> None:
        self.children: list[Child] = []
        self._log: IO[str] = log.open("a", encoding="utf-8")
        self._tell, self._lock = tell, threading.Lock()

    def add(self, name: str, arguments: Sequence[str]) -> None:
        """Start `skyherd ARGUMENTS` under a name."""
        self.take(Child(name, [sys.executable, "-m", "skyherd", *arguments]))

    def take(self, child: Child) -> None:
        """Start any other process."""
        self.children.append(child)
        self._start(child)

    def tend(self) -> None:
        """Look after the processes; called a few times a second."""
        for child in self.children:
            if child.process is None:
                if child.code not in DONE and time.monotonic() >= child.again_s:
                    child.restarts += 1
                    self._start(child)
                continue
            code = child.process.poll()
            if code is None:
                continue
            if child.process.stdin is not None:
                child.process.stdin.close()
            child.process, child.code = None, code
            if code in DONE:
                self.say(child.name, f"ended with code {code}")
                continue
            ran_s = time.monotonic() - child.started_s
            child.wait_s = FIRST_WAIT_S if ran_s >= STEADY_S else min(2 * child.wait_s, MAX_WAIT_S)
            child.again_s = time.monotonic() + child.wait_s
            self.say(child.name, f"ended with code {code}; is started again in {child.wait_s:g} s")

    def goes_on(self, prefix: str = "") -> bool:
        """Whether any process runs, or will again, whose name begins with `prefix`."""
        named = (child for child in self.children if child.name.startswith(prefix))
        return any(child.process is not None or child.code not in DONE for child in named)

    @property
    def refused(self) -> list[str]:
        """Names of the processes that ended because what they were given is wrong."""
        return [child.name for child in self.children if child.code == WRONG]

    def end(self) -> list[str]:
        """Ask all processes to end, kill those that do not, and return the names of those still running."""
        for child in self.children:
            if child.process is not None:
                child.process.terminate()
        limit_s = time.monotonic() + END_S
        for child in self.children:
            if child.process is None:
                continue
            try:
                child.process.wait(max(0.05, limit_s - time.monotonic()))
            except subprocess.TimeoutExpired:
                child.process.kill()
                with suppress(subprocess.TimeoutExpired):
                    child.process.wait(KILL_S)
                self.say(child.name, "did not end, and was killed")
            if child.process.stdin is not None:
                child.process.stdin.close()
            child.code = child.process.returncode
            if child.code is not None:
                child.process = None
        with self._lock:
            self._log.close()
        return [child.name for child in self.children if child.process is not None]

    def say(self, name: str, line: str) -> None:
        """Write a line of a process, or on it, into the log."""
        text = f"{time.strftime('%H:%M:%S')} {name:9} {printable(line)}"
        with self._lock:
            if not self._log.closed:
                self._log.write(text + "\n")
                self._log.flush()
            # Within the lock, so that lines of several processes are not glued together. A terminal or pipe
            # that is gone does not end the run.
            with suppress(OSError):
                self._tell(text)

    def _start(self, child: Child) -> None:
        child.code, child.started_s = None, time.monotonic()
        child.process = subprocess.Popen(
            child.command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,  # Ctrl-C reaches this process alone, which then ends them in order
        )
        threading.Thread(target=self._read, args=(child.name, child.process.stdout), daemon=True).start()

    def _read(self, name: str, lines: IO[str]) -> None:
        with lines:
            for line in lines:
                if line.strip():
                    self.say(name, line.rstrip().removeprefix(f"{name}: "))
