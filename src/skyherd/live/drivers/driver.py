"""Driver of one robot: a watchdog that repeats the last command while it is fresh, and then sends zero."""

import threading
import warnings
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import Self

from skyherd.errors import InputError, MessageError
from skyherd.live.drivers.limits import LIMITS, Limiter, SpeedLimits
from skyherd.live.drivers.link import STILL, Link, Motion
from skyherd.live.live_clock import steady_s
from skyherd.live.stop_latch import NOT_HALTED
from skyherd.messages import FlightCommand, VelocityCommand
from skyherd.messages.checks import check_numbers, shown

RATE_HZ = 20.0
"""Default rate at which commands are written, Hz. *Chosen*: robots stop after some tenths of a second without
a command."""

HOLD_S = 0.5
"""Default watchdog time: age at which a command is stale and zero is sent, s. *Chosen*: two or three images
of a slow camera."""

MIN_SHARE = 0.25
"""Shortest interval between two writes, as a share of the regular one. After it, a new command is written at
once. *Chosen*: a caller that sends too often does not fill a slow line."""

STOPS = 3
"""Number of zero commands that `close` writes. *Chosen*: one or two may get lost."""

RECOVERY = 3
"""Number of writes in a row without an error after which trouble is over. *Chosen*: sockets to a robot that
is switched off report an error at every second packet."""

CLOSE_S = 2.0
"""Longest time that `close` waits for the thread, s. *Chosen*: longer than any link's `write` should take."""


class RobotDriver:
    """Driver of one robot with a watchdog: it repeats the last command while fresh, and then sends zero.

    A separate thread writes at a steady rate. `send` only replaces the command, and never blocks. Without
    further calls the robot stops. The driver limits each motion before it writes it. After a failed write,
    and after one that blocked for longer than the watchdog time, the speed grows from zero again.

    Args:
        link: connection to the robot.
        robot_id: the robot, or the flying unit.
        limits: limits of speed, turn rate and acceleration.
        flies: True for a flying unit; each written motion carries it.
        rate_hz: rate at which commands are written.
        hold_s: watchdog time; commands of this age are stale, and zero is sent.
        clock: returns the time, s.
        pause: waits for a number of seconds, or until a new command; the default wait if None.

    Attributes:
        name: name of the link.
        written: number of attempts to write a motion.
        failed: number of attempts that failed.

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
        clock: Callable[[], float] = steady_s,
        pause: Callable[[float], object] | None = None,
    ) -> None:
        self.robot_id, self.flies, self.rate_hz, self.hold_s = robot_id, flies, rate_hz, hold_s
        check_numbers(self, positive=("rate_hz", "hold_s"))
        self.name = link.name
        self.written = self.failed = 0
        self._link, self._limiter, self._clock = link, Limiter(limits), clock
        self._wanted, self._sent_s, self._stop = STILL, float("-inf"), NOT_HALTED
        self._written_s = clock()
        self._writing_since_s: float | None = None
        self._halted, self._taken = NOT_HALTED, 0
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._news = threading.Event()
        self._pause = self._await_news if pause is None else pause
        self._trouble: str | None = None
        self._thread = threading.Thread(target=self._run, name=f"driver {self.name}", daemon=True)
        self._thread.start()

    def send(self, command: VelocityCommand, *, stop: int = 0) -> None:
        """Set the command to this robot's row of a team's command.

        Args:
            command: the command of the team.
            stop: see `send_motion`.

        Raises:
            MessageError: the command has no row for this robot.
        """
        ids = command.ids.tolist()
        if self.robot_id not in ids:
            raise MessageError("VelocityCommand.ids", shown(ids), f"robot {self.robot_id} among them")
        row = ids.index(self.robot_id)
        self.send_motion(Motion(command.v_mps[row], command.omega_radps[row]), stop=stop)

    def send_flight(self, command: FlightCommand) -> None:
        """Set the command to a flight command. The camera looks down, and the top of its image is ahead.

        Raises:
            InputError: the driver is one of a wheeled robot.
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

    def send_motion(self, motion: Motion, *, stop: int = 0) -> None:
        """Set the command to a motion with arbitrary values; the driver limits them before it writes.

        Args:
            motion: the motion.
            stop: largest stop number known to the sender, which `halted` returns after a zero.
        """
        with self._lock:
            self._wanted, self._sent_s, self._stop = motion, self._clock(), stop
        self._news.set()

    @property
    def halted(self) -> int:
        """Stop number with the last write if the link took it as a zero without trouble; else `NOT_HALTED`.

        The number was known before the write began.
        """
        return self._halted

    @property
    def trouble(self) -> str | None:
        """Reason why motions are not written now, in one line; None after `RECOVERY` writes without an error.

        A write that failed, a write that has blocked for longer than the watchdog time, or a thread that has
        ended before `close`.
        """
        since_s = self._writing_since_s
        if self._closing.is_set():
            return self._trouble
        if not self._thread.is_alive():
            return f"{self.name}: the thread that writes has ended"
        if since_s is not None and (blocked_s := self._clock() - since_s) > self.hold_s:
            return f"{self.name}: a write has blocked for {blocked_s:.1f} s"
        return self._trouble

    def close(self) -> None:
        """Send zero and close the link. Further calls do nothing.

        If the link blocks for more than `CLOSE_S`, a `RuntimeWarning` and `trouble` report that zero may not
        have arrived. An exception would replace the one that ends the caller's `with` statement.
        """
        self._closing.set()
        self._news.set()
        if self._thread is threading.current_thread():
            return
        self._thread.join(CLOSE_S)
        if self._thread.is_alive():
            self._trouble = f"{self.name}: blocks since {CLOSE_S:g} s; the robot may not have received zero"
            warnings.warn(self._trouble, RuntimeWarning, stacklevel=2)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> None:
        """Write at a steady rate until `close`. Zero is written last, also after an error."""
        try:
            while not self._closing.is_set():
                self._write(*self._due())
                self._pause(1 / self.rate_hz)
        finally:
            for _ in range(STOPS):
                self._write(STILL, NOT_HALTED)
            self._link.close()

    def _await_news(self, seconds: float) -> None:
        """Wait until a new command or the end of a time, but at least for `MIN_SHARE` of the time."""
        if not self._closing.wait(MIN_SHARE * seconds):
            self._news.wait((1 - MIN_SHARE) * seconds)
        self._news.clear()

    def _due(self) -> tuple[Motion, int]:
        """Return the last command, or zero if it is stale, and the stop number known with it."""
        with self._lock:
            age_s = self._clock() - self._sent_s
            return (self._wanted if 0 <= age_s < self.hold_s else STILL), self._stop

    def _write(self, motion: Motion, stop: int) -> None:
        """Limit and write a motion. Count failures, and keep the reason of the last one."""
        now_s = self._clock()
        allowed = self._limiter.limit(motion, now_s - self._written_s)
        self._written_s = self._writing_since_s = now_s
        self.written += 1
        if allowed != STILL:
            self._halted = NOT_HALTED
        try:
            self._link.write(replace(allowed, flies=self.flies))
        except BaseException as error:
            # A custom link may raise anything, also SystemExit, and zero must still be tried. Signals
            # interrupt the main thread alone.
            self.failed += 1
            self._halted, self._limiter.last, self._taken = NOT_HALTED, STILL, 0
            words = " ".join(str(getattr(error, "strerror", None) or error).split())
            words = words if words and isinstance(error, Exception) else f"{type(error).__name__} {words}"
            self._trouble = f"{self.name}: cannot be written to: {words.strip()}"
        else:
            self._taken += 1
            if self._taken >= RECOVERY:
                self._trouble = None
            if allowed == STILL:
                self._halted = stop if self._trouble is None else NOT_HALTED
            elif not 0 <= self._clock() - now_s <= self.hold_s:
                self._limiter.last = STILL  # The robot's own watchdog has stopped it meanwhile.
        finally:
            self._writing_since_s = None
