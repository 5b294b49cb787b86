"""Driver thread of a robot: it repeats the last command while it is fresh, and then sends zero."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import Self

import numpy as np

from skyherd.errors import InputError, MessageError
from skyherd.live.drivers.limits import LIMITS, Limiter, SpeedLimits
from skyherd.live.drivers.link import STILL, Link, Motion
from skyherd.messages import FlightCommand, VelocityCommand
from skyherd.messages.checks import check_numbers

RATE_HZ = 20.0
"""Rate at which commands are repeated, 1/s. *Chosen*: robots stop after some tenths of a second without
one."""

HOLD_S = 0.5
"""Watchdog time: age at which a command is stale and zero is sent, s. *Chosen*: two or three images of a slow
camera."""

MIN_SHARE = 0.25
"""Shortest time between two writes, as a share of the usual interval. *Chosen*: new commands are written
almost at once, and cannot fill a slow link."""

STOPS = 3
"""Number of zeros that `close` writes. *Chosen*: one or two may be lost."""

CLOSE_S = 2.0
"""Longest time that `close` waits for the zeros, s. *Chosen*: longer than any link's `write` should take."""


class RobotDriver:
    """Driver of one robot: it repeats the last command while it is fresh, and sends zero once it is stale.

    A separate thread writes at a steady rate, within the limits. `send` stores the command and never blocks.
    The robot stops if `send` is not called again within `hold_s`.

    Args:
        link: link that writes motions.
        robot_id: the robot, or the flying unit.
        limits: limits of speed, turn rate and acceleration.
        flies: True for a flying unit; all written motions are marked with it.
        rate_hz: rate of writes.
        hold_s: watchdog time; older commands are stale.
        clock: returns the time, s.
        pause: waits for a number of seconds, or until a new command; a real wait if None.

    Attributes:
        written: number of attempted writes.
        failed: number of failed writes.

    Raises:
        InputError: `rate_hz` or `hold_s` is not above 0.
    """

    def __init__(
        self,
        link: Link,
        *,
        robot_id: int,
        limits: SpeedLimits = LIMITS,
        flies: bool = False,
        rate_hz: float = RATE_HZ,
        hold_s: float = HOLD_S,
        clock: Callable[[], float] = time.monotonic,
        pause: Callable[[float], object] | None = None,
    ) -> None:
        self.robot_id, self.flies, self.rate_hz, self.hold_s = robot_id, flies, rate_hz, hold_s
        check_numbers(self, positive=("rate_hz", "hold_s"))
        self.name = link.name
        self.written = self.failed = 0
        self._link, self._limiter, self._clock = link, Limiter(limits), clock
        self._wanted, self._sent_s = STILL, float("-inf")
        self._written_s = clock()
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._news = threading.Event()
        self._pause = self._await_news if pause is None else pause
        self._trouble: str | None = None
        self._thread = threading.Thread(target=self._run, name=f"driver {self.name}", daemon=True)
        self._thread.start()

    def send(self, command: VelocityCommand) -> None:
        """Set this robot's command from those of a team.

        Raises:
            MessageError: the message has no command for this robot.
        """
        row = np.flatnonzero(command.ids == self.robot_id)
        if not row.size:
            raise MessageError(
                f"VelocityCommand.ids: {command.ids.tolist()}, expected {self.robot_id} among them"
            )
        self.send_motion(Motion(command.v_mps[row[0]], command.omega_radps[row[0]]))

    def send_flight(self, command: FlightCommand) -> None:
        """Set the flight command of a unit whose camera looks down, with the top of its image ahead.

        Raises:
            InputError: the driver is that of a robot on wheels.
        """
        if not self.flies:
            raise InputError(f"driver {self.name}", "a flight command for wheels", "a driver with flies=True")
        right_mps, back_mps = command.lateral_mps.tolist()
        self.send_motion(
            Motion(
                forward_mps=-back_mps,
                turn_radps=command.yaw_rate_radps,
                left_mps=-right_mps,
                up_mps=command.climb_mps,
            )
        )

    def send_motion(self, motion: Motion) -> None:
        """Set the motion. It may have arbitrary values, since the limits are applied before each write."""
        with self._lock:
            self._wanted, self._sent_s = motion, self._clock()
        self._news.set()

    @property
    def trouble(self) -> str | None:
        """Reason, in one line, why the last write failed; None if it succeeded."""
        return self._trouble

    def close(self) -> None:
        """Send zero and close the link. It may be called repeatedly; nothing is written afterwards."""
        self._closing.set()
        self._news.set()
        if self._thread is not threading.current_thread():
            self._thread.join(CLOSE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> None:
        """Write at a steady rate until closed, and zeros at the end, also after an exception."""
        try:
            while not self._closing.is_set():
                self._write(self._due())
                self._pause(1 / self.rate_hz)
        finally:
            for _ in range(STOPS):
                self._write(STILL)
            self._link.close()

    def _await_news(self, seconds: float) -> None:
        """Wait for a new command, at least `MIN_SHARE` of `seconds` and at most `seconds`."""
        if not self._closing.wait(MIN_SHARE * seconds):
            self._news.wait((1 - MIN_SHARE) * seconds)
        self._news.clear()

    def _due(self) -> Motion:
        """Return the motion to write now: the last command, or zero if it is stale."""
        with self._lock:
            age_s = self._clock() - self._sent_s
            return self._wanted if 0 <= age_s < self.hold_s else STILL

    def _write(self, motion: Motion) -> None:
        """Write a motion within the limits, and count failures."""
        now_s = self._clock()
        allowed = self._limiter.limit(motion, now_s - self._written_s)
        self._written_s = now_s
        self.written += 1
        try:
            self._link.write(replace(allowed, flies=self.flies))
            self._trouble = None
        except Exception as error:  # A custom link may raise anything, and later zeros must still be tried.
            self.failed += 1
            words = " ".join(str(getattr(error, "strerror", None) or error).split())
            self._trouble = f"{self.name}: cannot be written to: {words or type(error).__name__}"
