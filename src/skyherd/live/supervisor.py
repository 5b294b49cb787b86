"""Supervision of all processes of a lab on one machine: start, restart after a crash, and shutdown."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from skyherd.live.line_writer import LineWriter
from skyherd.text import printable

FIRST_WAIT_S, MAX_WAIT_S = 0.5, 8.0
"""First and longest pause before a restart after a crash, s; each pause doubles. Chosen: a short outage costs
little, and repeated crashes do not keep the machine busy."""

STEADY_S = 10.0
"""Run time after which a crash is followed by the first pause again, s. Chosen: 20 first pauses."""

END_S = 10.0
"""Time for processes to end after SIGTERM, before SIGKILL, s. Chosen: robots stop their wheels at once, and
the last chunk of a recording needs less."""

KILL_S = 5.0
"""Longest wait for a killed process, s. Chosen: the operating system ends it at once, unless it waits for
a device."""

MAX_WAITING_LINES = 100_000
"""Lines of the log that wait while its disk hangs; older ones are lost. Chosen: hours of a run, 10 MB."""

WRONG = 2
"""Exit code of a process that refused its input."""

DONE = frozenset({0, WRONG, 129, 130, 143})
"""Exit codes without a restart: success, wrong input, and the signals SIGHUP, SIGINT and SIGTERM."""


@dataclass
class Child:
    """One supervised process.

    Attributes:
        name: such as `robot/3`.
        command: its command line.
        restarts: number of restarts.
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
    """Supervisor that starts processes, restarts them, and writes their output into one log.

    The standard input of each process is a pipe held by this process. When this process ends for any reason,
    they read the end of the pipe and end too.

    The log is written by a thread of its own: a disk that hangs holds neither the processes nor the caller.

    Args:
        log: file of all output lines.
        tell: called with every line, prefixed with the time and the name of its process. It must not block:
            the threads that read the processes wait for it.
    """

    def __init__(self, log: Path, tell: Callable[[str], None] = lambda line: None) -> None:
        self.children: list[Child] = []
        self._file: IO[str] = log.open("a", encoding="utf-8")
        self._log = LineWriter(self._write, MAX_WAITING_LINES)
        self._tell, self._lock = tell, threading.Lock()

    def add(self, name: str, arguments: Sequence[str]) -> None:
        """Start `skyherd ARGUMENTS` as the process of this name."""
        self.take(Child(name, [sys.executable, "-m", "skyherd", *arguments]))

    def take(self, child: Child) -> None:
        """Start any other process."""
        self.children.append(child)
        self._start(child)

    def tend(self) -> None:
        """Notice ended processes and restart crashed ones. Called a few times a second."""
        for child in self.children:
            if child.process is None:
                if child.code not in DONE and time.monotonic() >= child.again_s:
                    self._restart(child)
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
            self._restart_later(child, f"ended with code {code}", first=ran_s >= STEADY_S)

    def _restart(self, child: Child) -> None:
        """Start a crashed process again, or try it later if the machine lacks a resource now."""
        try:
            self._start(child)
        except (OSError, RuntimeError) as error:  # RuntimeError: no further thread can be started.
            words = getattr(error, "strerror", None) or error
            self._restart_later(child, f"cannot be started: {words}", first=False)
        else:
            child.restarts += 1

    def _restart_later(self, child: Child, why: str, *, first: bool) -> None:
        """Choose the next pause before a restart."""
        child.wait_s = FIRST_WAIT_S if first else min(2 * child.wait_s, MAX_WAIT_S)
        child.again_s = time.monotonic() + child.wait_s
        self.say(child.name, f"{why}; restarts in {child.wait_s:g} s")

    def is_active(self, prefix: str = "") -> bool:
        """Return whether a process whose name begins with `prefix` runs or will be restarted."""
        named = (child for child in self.children if child.name.startswith(prefix))
        return any(child.process is not None or child.code not in DONE for child in named)

    @property
    def refused(self) -> list[str]:
        """Names of the processes that refused their input."""
        return [child.name for child in self.children if child.code == WRONG]

    def end(self) -> list[str]:
        """End all processes, kill those that do not end in time, and return the names of survivors."""
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
                self.say(child.name, "did not end and was killed")
            if child.process.stdin is not None:
                child.process.stdin.close()
            child.code = child.process.returncode
            if child.code is not None:
                child.process = None
        if self._log.close():
            with suppress(OSError):
                self._file.close()
        return [child.name for child in self.children if child.process is not None]

    def say(self, name: str, line: str) -> None:
        """Write a line from or about a process into the log."""
        text = f"{time.strftime('%H:%M:%S')} {name:9} {printable(line)}"
        self._log.put(text)
        # Within the lock, so that lines of several processes are not glued together. A terminal or pipe that
        # is gone does not end the run.
        with self._lock, suppress(OSError):
            self._tell(text)

    def _write(self, line: str) -> None:
        self._file.write(line + "\n")
        self._file.flush()

    def _start(self, child: Child) -> None:
        child.code, child.started_s = None, time.monotonic()
        process = subprocess.Popen(
            child.command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,  # Ctrl-C reaches only this process, which then ends the others in order.
        )
        try:
            threading.Thread(target=self._read, args=(child.name, process.stdout), daemon=True).start()
        except RuntimeError:
            with process:  # It closes the pipes, and waits.
                process.kill()
            raise
        child.process = process

    def _read(self, name: str, lines: IO[str]) -> None:
        with lines:
            for line in lines:
                if line.strip():
                    self.say(name, line.rstrip().removeprefix(f"{name}: "))
