"""The thread that keeps a robot informed: the last command while it is fresh, and then zero."""

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
"""How often a command is repeated, 1/s. *Chosen*: robots stop after some tenths of a second without one."""

HOLD_S = 0.5
"""Age at which a command is forgotten and zero is sent, s. *Chosen*: two or three images of a slow camera."""

MIN_SHARE = 0.25
"""A new command is written at once, but no sooner after another than this share of the usual interval.
*Chosen*: a caller that sends too often does not fill a slow line."""

STOPS = 3
"""How often zero is written by `close`. *Chosen*: one or two may get lost on the way."""

CLOSE_S = 2.0
"""How long `close` waits until zero is out, s. *Chosen*: longer than any link's `write` should take."""


class RobotDriver:
    """Drives one robot: repeats its last command while that is fresh, and sends zero once it is not.

    All writing happens in a thread of its own, at a steady rate. `send` only leaves the command there
    and never waits. Without further calls the robot stops. Commands are brought within the limits first.

    Args:
        link: where motions are written to.
        robot_id: the robot, or the unit that flies.
        limits: on speed, turn and acceleration.
        flies: whether it is a unit that flies, which all that is written says.
        rate_hz: how often something is written.
        hold_s: age at which a command is forgotten.
        clock: gives the time, s.
        pause: waits for so many seconds, or less if there is a new command; a real wait if None.

    Attributes:
        written: number of motions that were written.
        failed: number of those that could not be.

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
        """Take over the command for this robot, among those for a team.

        Raises:
            MessageError: there is none for it.
        """
        row = np.flatnonzero(command.ids == self.robot_id)
        if not row.size:
            raise MessageError(
                f"VelocityCommand.ids: {command.ids.tolist()}, expected {self.robot_id} among them"
            )
        self.send_motion(Motion(command.v_mps[row[0]], command.omega_radps[row[0]]))

    def send_flight(self, command: FlightCommand) -> None:
        """Take over a flight command of a unit whose camera looks down with its image's top ahead.

        Raises:
            InputError: it is the driver of a robot on wheels.
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
        """Take over a motion; its numbers may be anything, since they are limited before they are written."""
        with self._lock:
            self._wanted, self._sent_s = motion, self._clock()
        self._news.set()

    @property
    def trouble(self) -> str | None:
        """Why the last motion could not be written, in one line; None if it could."""
        return self._trouble

    def close(self) -> None:
        """Send zero and close the link. May be called again; after it nothing is written."""
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
        """Write at a steady rate until closed; zero comes last, whatever happens."""
        try:
            while not self._closing.is_set():
                self._write(self._due())
                self._pause(1 / self.rate_hz)
        finally:
            for _ in range(STOPS):
                self._write(STILL)
            self._link.close()

    def _await_news(self, seconds: float) -> None:
        """Wait until there is a new command, for so long at most, and for a share of it in any case."""
        if not self._closing.wait(MIN_SHARE * seconds):
            self._news.wait((1 - MIN_SHARE) * seconds)
        self._news.clear()

    def _due(self) -> Motion:
        """Return the next bytes to write."""
        with self._lock:
            age_s = self._clock() - self._sent_s
            return self._wanted if 0 <= age_s < self.hold_s else STILL

    def _write(self, motion: Motion) -> None:
        """Write a motion within the limits; what cannot be written is counted."""
        now_s = self._clock()
        allowed = self._limiter.limit(motion, now_s - self._written_s)
        self._written_s = now_s
        self.written += 1
        try:
            self._link.write(replace(allowed, flies=self.flies))
            self._trouble = None
        except Exception as error:  # a link of one's own may fail in any way, and zero must still be tried
            self.failed += 1
            words = " ".join(str(getattr(error, "strerror", None) or error).split())
            self._trouble = f"{self.name}: cannot be written to: {words or type(error).__name__}"
