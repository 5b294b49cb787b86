"""The latched stop of a live team: one pair of numbers that every message carries, and that only grows.

A stop and an arm command each have a number. Every process keeps the largest stop number and the largest arm
number that it knows (`StopLatch`), sends both with every message, and merges both from every message. The
merge takes the maximum of each, so that lost, late, repeated and reordered messages change nothing but the
time at which a process learns a number.

- The team is *stopped* while the stop number is at least the arm number. At equal numbers the stop wins.
- A stop gets a number above all that its sender knows, and at least the sender's time of day in
  milliseconds: an operator that has just started outranks all earlier commands.
- An arm command gets the smallest number above all that its sender knows. A stop that the sender does not
  know is at least as large, so that nobody overrides a stop in ignorance of it.
- A robot is armed by one arm command (`ArmState`), and only while the number of that command exceeds its
  stop number. A restarted robot is disarmed, and arm commands for its former session mean nothing.

The states, transitions and guarantees are written down in docs/live/safety.md, and
tests/live/test_stop_model.py checks them over every order of delivery.
"""

from dataclasses import dataclass, replace

MAX_NUMBER = 2**53 - 1
"""Largest number of a command. Derived: every JSON reader keeps integers up to it. Milliseconds since 1970
reach it in 285,000 years."""


@dataclass(frozen=True)
class StopLatch:
    """What one process knows of the team's commands.

    Attributes:
        stop: largest stop number, 0 if there was none.
        arm: largest arm number, 0 if there was none.
    """

    stop: int = 0
    arm: int = 0

    @property
    def stopped(self) -> bool:
        """Whether a stop is in force: no unit sends goals, and no robot moves."""
        return self.stop > 0 and self.stop >= self.arm

    def merged(self, other: "StopLatch") -> "StopLatch":
        """Return the maximum of each number of two latches."""
        return StopLatch(max(self.stop, other.stop), max(self.arm, other.arm))

    def with_stop(self, time_s: float) -> "StopLatch":
        """Return the latch after a new stop, issued at a time of day in seconds since 1970.

        At `MAX_NUMBER`, which only a forged message reaches, the stop still holds: it equals the arm number.
        """
        number = max(self.stop + 1, self.arm + 1, int(1000 * time_s))
        return replace(self, stop=min(number, MAX_NUMBER))

    def with_arm(self) -> "StopLatch | None":
        """Return the latch after a new arm command, or None if no number is left for one."""
        number = max(self.stop, self.arm) + 1
        return None if number > MAX_NUMBER else replace(self, arm=number)


NO_COMMAND = StopLatch()
"""The latch of a process that has heard of no command."""


@dataclass(frozen=True)
class ArmState:
    """Whether one robot is armed, and by which command.

    Attributes:
        latch: what the robot knows of the team's commands.
        armed_by: number of the arm command in force; 0 while disarmed.
        disarmed_count: how often the robot was disarmed, which is part of its session.
    """

    latch: StopLatch = NO_COMMAND
    armed_by: int = 0
    disarmed_count: int = 0

    @property
    def armed(self) -> bool:
        """Whether wheels may turn as far as commands are concerned."""
        return self.armed_by > 0

    def merge(self, latch: StopLatch) -> "ArmState":
        """Return the state after a message with this latch: a newer stop disarms."""
        state = replace(self, latch=self.latch.merged(latch))
        return state.disarm() if 0 < state.armed_by <= state.latch.stop else state

    def disarm(self) -> "ArmState":
        """Return the disarmed state of a new session."""
        return replace(self, armed_by=0, disarmed_count=self.disarmed_count + 1)

    def arm(self, number: int) -> "ArmState":
        """Return the state after an arm command for this session; unchanged if a stop is as new."""
        return replace(self, armed_by=number) if number > self.latch.stop else self
