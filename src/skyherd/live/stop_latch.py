"""The latched stop of a live team: two monotonically increasing numbers in every message.

Each stop has a number. Every process keeps the largest known stop number and the largest one that an arm
command has cleared (`StopLatch`). It sends both with every message, and takes the maximum of each from
every message. Message loss, latency, repetition and reordering affect only the time at which a process learns
a number.

- The team is *stopped* while the newest stop is not cleared.
- The number of a stop is a time of day in milliseconds, followed by the tag of its operator. It exceeds all
  numbers that its sender knows, and its time is at least the sender's. An operator that has just started
  therefore outranks all earlier commands. Operators with different tags never give equal numbers.
- An arm command clears only the newest stop that its sender knows. It never overrides an unknown stop.
- A robot is armed (`ArmState`) until it learns of a stop that its arm command did not clear. A restarted
  robot is disarmed, and arm commands for its former session have no effect.

docs/live/safety.md lists states, transitions and guarantees. tests/live/test_stop_model.py checks them over
every order of delivery.
"""

import secrets
from dataclasses import dataclass, replace

MAX_STOP = 2**53 - 1
"""Largest stop number, which no arm command clears. Derived: every JSON reader keeps integers up to it. The
time of day reaches it in the year 2109, so that only forged messages contain it."""

TAGS = 2**11
"""Number of different operator tags. Derived: the most that leave `MAX_STOP` for a century."""

NOT_HALTED = -1
"""Value of `Heartbeat.halted` while the link has not taken a zero last. Derived: below all stop numbers."""


def stop_number(time_s: float, tag: int = 0) -> int:
    """Return the number of a stop at a time of day, s since 1970, by the operator with this tag."""
    return int(1000 * time_s) * TAGS + tag


def new_tag() -> int:
    """Return a random tag for a new operator, below `TAGS`. Two operators have equal tags once in 2,048."""
    return secrets.randbelow(TAGS)


@dataclass(frozen=True)
class StopLatch:
    """Commands known to one process.

    Attributes:
        stop: largest stop number; 0 without a stop.
        cleared: largest stop number that an arm command has cleared.
    """

    stop: int = 0
    cleared: int = 0

    @property
    def stopped(self) -> bool:
        """True while a stop is in force: no unit sends goals, and no robot moves."""
        return self.stop > self.cleared

    def merge(self, other: "StopLatch") -> "StopLatch":
        """Return the maximum of each number of two latches."""
        return StopLatch(max(self.stop, other.stop), max(self.cleared, other.cleared))

    def is_armed_since(self, before: "StopLatch") -> bool:
        """Return whether an arm command has cleared a newer stop than those cleared in an earlier latch."""
        return self.cleared > before.cleared

    def with_stop(self, time_s: float, tag: int) -> "StopLatch":
        """Return the latch after a new stop.

        Args:
            time_s: time of day, s since 1970.
            tag: tag of the operator that stops, below `TAGS`.
        """
        next_ms = max(self.stop, self.cleared) // TAGS + 1
        number = max(next_ms * TAGS + tag, stop_number(time_s, tag))
        return replace(self, stop=min(number, MAX_STOP))

    def with_arm(self) -> "StopLatch":
        """Return the latch after a new arm command. A stop numbered `MAX_STOP` stays in force."""
        return replace(self, cleared=max(self.cleared, min(self.stop, MAX_STOP - 1)))


NO_COMMAND = StopLatch()
"""Latch of a process that knows of no command."""


@dataclass(frozen=True)
class ArmState:
    """Arm state of one robot.

    Attributes:
        latch: commands known to the robot.
        armed_at: stop number cleared by the arm command in force; None while disarmed.
        disarmed_count: number of times the robot was disarmed, which is part of its session.
    """

    latch: StopLatch = NO_COMMAND
    armed_at: int | None = None
    disarmed_count: int = 0

    @property
    def armed(self) -> bool:
        """True while an arm command is in force."""
        return self.armed_at is not None

    def merge(self, latch: StopLatch) -> "ArmState":
        """Return the state after a message with this latch. A newer stop disarms."""
        state = replace(self, latch=self.latch.merge(latch))
        is_outdated = state.armed_at is not None and state.latch.stop > state.armed_at
        return state.disarm() if is_outdated else state

    def disarm(self) -> "ArmState":
        """Return the disarmed state. Disarming an armed robot begins a new session."""
        return replace(self, armed_at=None, disarmed_count=self.disarmed_count + 1) if self.armed else self

    def arm(self, cleared: int) -> "ArmState":
        """Return the state after an arm command for this session, unchanged if a newer stop is known."""
        return replace(self, armed_at=cleared) if cleared >= self.latch.stop else self
