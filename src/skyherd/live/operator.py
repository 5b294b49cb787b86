"""Commands of an operator, from any process of the team: arm, stop and watch."""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Protocol

from skyherd.live.lab import Lab
from skyherd.live.mailbox import Arrival, Mailbox, Radio
from skyherd.live.peers import Instances
from skyherd.live.stop_latch import MAX_STOP, NO_COMMAND, StopLatch, new_tag, stop_number
from skyherd.live.wire import Arm, Heartbeat, Stop

REPEAT_S = 0.2
"""Repetition period of a command, s. Chosen: repetition covers message loss."""

LEARN_S = 1.0
"""Time for an operator to learn the team's stop numbers, s. Chosen: four heartbeats of each process."""

SETTLE_S = 3.0
"""Longest wait of arm and stop for all robots, s. Chosen: a dozen heartbeats of each."""

ARM_DELAY_S = 20.0
"""Longest time from an arm command, such as the start of `live arm`, to its last message, s. Chosen: start,
learning and waiting for all robots take 8 s on a slow machine. A command that was suspended meanwhile
has expired."""

CLOCK_ERROR_S = 1.0
"""Largest lead of another operator's clock, s, with which its stop is still dated by its number. Chosen:
computers that set their clocks agree better; a number that is further ahead tells no time."""

GONE_S = 2.0
"""Time without a heartbeat after which a process counts as gone, s. Chosen: eight heartbeats."""

HEARS = ("heartbeat/**", "arm/**", "stop/**")
"""Topics that an operator listens to, after the team's name."""


@dataclass(frozen=True)
class Sign:
    """The last heartbeat of a process.

    Attributes:
        heartbeat: the message.
        latch: commands known to the process.
        sent_s: time of sending on the clock of the process.
        received_s: time of arrival on the operator's clock.
    """

    heartbeat: Heartbeat
    latch: StopLatch
    sent_s: float
    received_s: float


@dataclass
class Watch:
    """An operator's view of the team.

    Attributes:
        mailbox: the operator's messages, which carry its latch.
        clock: the operator's clock.
        latch: commands known to the operator.
        signs: the last heartbeat of each process, by name.
        stop_heard_s: time at which the last stop command of another operator was heard.
        tag: the operator's part of the numbers of its stops.
    """

    mailbox: Mailbox
    clock: Callable[[], float]
    latch: StopLatch = NO_COMMAND
    signs: dict[str, Sign] = field(default_factory=dict)
    stop_heard_s: float = -math.inf
    tag: int = field(default_factory=new_tag)
    _instances: dict[str, Instances] = field(default_factory=dict)

    def listen(self, timeout_s: float) -> None:
        """Process the received messages. Wait up to `timeout_s` for the first one."""
        for arrival in self.mailbox.fetch(timeout_s):
            self.hear(arrival)

    def hear(self, arrival: Arrival) -> None:
        """Process one message."""
        envelope = arrival.envelope
        self.latch = self.latch.merge(envelope.latch)
        if isinstance(envelope.message, Stop):
            self.stop_heard_s = arrival.received_s
        if isinstance(envelope.message, Heartbeat):
            self.signs[envelope.sender] = Sign(
                envelope.message, envelope.latch, envelope.sent_s, arrival.received_s
            )
            instances = self._instances.setdefault(envelope.sender, Instances(envelope.instance))
            instances.hear(envelope.instance, arrival.received_s)

    def alive(self) -> dict[str, Heartbeat]:
        """Return the last heartbeat of each process that is alive, by name."""
        now_s = self.clock()
        return {
            name: sign.heartbeat for name, sign in self.signs.items() if now_s - sign.received_s <= GONE_S
        }

    def robots_alive(self) -> list[int]:
        """Return the numbers of the robots that are alive, also of those that the operator's lab lacks."""
        names = (name.partition("/") for name in self.alive())
        return [int(number) for kind, _, number in names if kind == "robot" and number.isdecimal()]

    def is_ambiguous(self, name: str) -> bool:
        """Return whether two processes use a name now."""
        return name in self._instances and self._instances[name].conflict(self.clock())

    def silence_s(self, name: str) -> tuple[float, str] | None:
        """Return how long ago another process last heard a process, s, and its name; None if none did."""
        now_s = self.clock()
        ages = [
            (sign.sent_s - sign.heartbeat.heard[name][1] + now_s - sign.received_s, other)
            for other, sign in self.signs.items()
            if name in sign.heartbeat.heard
        ]
        return min(ages, default=None)

    def robot_sign(self, robot: int) -> Sign | None:
        """Return the last heartbeat of a robot, or None without one or if two processes use its name."""
        name = f"robot/{robot}"
        return None if self.is_ambiguous(name) else self.signs.get(name)


@dataclass(frozen=True)
class Outcome:
    """Result of a command to all robots.

    Attributes:
        done: robots that confirmed the command, by a heartbeat with its number.
        missing: last known state in words of each robot that did not confirm it.
        failure: reason why the whole command failed; empty if it did not.
    """

    done: list[int]
    missing: dict[int, str]
    failure: str = ""

    @property
    def is_complete(self) -> bool:
        """True if all robots confirmed the command."""
        return not self.missing and not self.failure


class Command(Protocol):
    """A command, repeated until all robots have confirmed it."""

    def advance(self) -> bool:
        """Send the command if it is due. Return whether the command is finished."""
        ...

    def outcome(self) -> Outcome:
        """Return the result so far."""
        ...


class StopCommand:
    """Command that stops and disarms all robots, and latches the stop in every process of the team.

    A robot confirms the stop by a heartbeat that carries its number, or a newer one, and reports the robot
    disarmed. The heartbeat also says that the link to the wheels took a zero since the robot knew that
    number. Heartbeats sent before the stop do not confirm it: if the team turns out to know a higher number,
    such as of an operator whose clock is ahead, the stop gets one above that.

    Args:
        lab: the set-up.
        watched: the operator's view of the team.
        why: origin of the command, for people.
    """

    def __init__(self, lab: Lab, watched: Watch, why: str) -> None:
        self._lab, self._watched, self._why = lab, watched, why
        self._began_s = self._sent_s = watched.clock()
        self._issue()

    def advance(self) -> bool:
        """Repeat the stop if it is due. Return whether all robots have confirmed it."""
        now_s, latch = self._watched.clock(), self._watched.latch
        if not self._watched.signs:
            self._began_s = now_s  # There is no process yet to learn the numbers from.
        is_outnumbered = not latch.stopped or latch.stop > self._number
        if is_outnumbered and now_s - self._began_s <= LEARN_S:
            # The operator did not know the team's numbers, and its clock lags.
            self._issue()
        elif now_s - self._sent_s >= REPEAT_S:
            self._sent_s = now_s
            self._watched.mailbox.send(Stop(self._why))
        return not self.outcome().missing

    def outcome(self) -> Outcome:
        """Return the robots that confirmed the stop, and the others, also those that the lab lacks."""
        robots = sorted({*self._lab.ids, *self._watched.robots_alive()})
        confirmed = {robot: self._has_stopped(robot) for robot in robots}
        overridden = not self._watched.latch.stopped
        return _outcome(self._watched, confirmed, "a newer arm command overrides the stop" * overridden)

    def _issue(self) -> None:
        """Give the stop a new number, and send it."""
        watched = self._watched
        watched.latch = watched.latch.with_stop(watched.clock(), watched.tag)
        self._number = watched.latch.stop
        watched.mailbox.send(Stop(self._why))

    def _has_stopped(self, robot: int) -> bool:
        sign = self._watched.robot_sign(robot)
        if sign is None or sign.heartbeat.armed:
            return False
        return min(sign.latch.stop, sign.heartbeat.halted) >= self._number


class ArmCommand:
    """Command that arms robots, each at most once. The first newer stop cancels it.

    Args:
        lab: the set-up.
        watched: the operator's view of the team.
        known: the commands that were known when this one was given; all that are known now if left out. It
            clears no other stop.
        given_s: when it was given, on the operator's clock; now if left out. After `ARM_DELAY_S` it arms no
            robot.
        robots: the robots to arm; all of the lab if left out.
    """

    def __init__(
        self,
        lab: Lab,
        watched: Watch,
        known: StopLatch | None = None,
        given_s: float | None = None,
        robots: Collection[int] | None = None,
    ) -> None:
        self._watched = watched
        self._robots = sorted(lab.ids if robots is None else robots)
        self._given_s = watched.clock() if given_s is None else given_s
        self._sent_s = -float("inf")
        self._done: set[int] = set()
        self._cleared = (watched.latch if known is None else known).with_arm().cleared
        if not self.is_void:
            watched.latch = watched.latch.with_arm()

    @property
    def is_void(self) -> bool:
        """True while a stop is in force that this command does not clear."""
        return self._watched.latch.stop > self._cleared

    def advance(self) -> bool:
        """Send the command if it is due.

        Return whether all robots are armed, a newer stop cancels it, or it has expired.
        """
        self._done |= {robot for robot in self._robots if self._is_armed(robot)}
        if self.is_void or self._has_expired() or len(self._done) == len(self._robots):
            return True
        if self._watched.clock() - self._sent_s >= REPEAT_S:
            alive = self._watched.alive()
            waiting = [f"robot/{robot}" for robot in self._robots if robot not in self._done]
            sessions = {name: alive[name].session for name in waiting if name in alive}
            if sessions:
                self._sent_s = self._watched.clock()
                self._watched.mailbox.send(Arm(sessions))
        return False

    def outcome(self) -> Outcome:
        """Return the robots armed by this command, and the others."""
        confirmed = {robot: robot in self._done and not self.is_void for robot in self._robots}
        failure = f"the command was given more than {ARM_DELAY_S:g} s ago" * self._has_expired()
        failure = "a stop is newer than this command" if self.is_void else failure
        if self._watched.latch.stop == MAX_STOP:
            failure = "the stop has the largest possible number, so it was forged: restart the whole team"
        return _outcome(self._watched, confirmed, failure)

    def _has_expired(self) -> bool:
        return not 0 <= self._watched.clock() - self._given_s <= ARM_DELAY_S

    def _is_armed(self, robot: int) -> bool:
        sign = self._watched.robot_sign(robot)
        return sign is not None and sign.latch.cleared >= self._cleared and sign.heartbeat.armed


def watch(lab: Lab, radio: Radio, clock: Callable[[], float], name: str = "operator") -> Watch:
    """Return the view of a new operator of this name, which listens to the team from now on."""

    def latch() -> StopLatch:
        return watched.latch

    watched = Watch(Mailbox(radio, lab.model.team, name, clock, HEARS, latch=latch), clock)
    return watched


def arm(
    lab: Lab,
    watched: Watch,
    settle_s: float = SETTLE_S,
    *,
    given_s: float | None = None,
    robots: Collection[int] | None = None,
) -> Outcome:
    """Arm robots, and return the confirmations received within `settle_s`.

    A stop that was given after the command is not cleared: one that is heard while the numbers are learned,
    or whose number is a time of day since.

    Args:
        lab: the set-up.
        watched: the operator's view of the team.
        settle_s: longest wait for all robots.
        given_s: when the command was given, on the operator's clock; now if left out.
        robots: the robots to arm; all of the lab if left out.
    """
    began_s = watched.clock()
    given_s = began_s if given_s is None else given_s
    # An arm command clears only stops that its sender knows, so the operator learns the numbers first.
    while watched.clock() - began_s < LEARN_S and len(watched.alive()) < len(lab.ids):
        watched.listen(0.05)
    latest = stop_number(watched.clock() + CLOCK_ERROR_S)
    is_since = stop_number(given_s) <= watched.latch.stop <= latest
    known = NO_COMMAND if is_since or watched.stop_heard_s >= began_s else None
    return _insist(ArmCommand(lab, watched, known, given_s, robots), watched, settle_s)


def stop(lab: Lab, watched: Watch, why: str, settle_s: float = SETTLE_S) -> Outcome:
    """Stop and disarm all robots at once, and return the confirmations received within `settle_s`."""
    return _insist(StopCommand(lab, watched, why), watched, settle_s)


def _insist(command: Command, watched: Watch, settle_s: float) -> Outcome:
    """Repeat a command until it is finished, for at most `settle_s`."""
    end_s = watched.clock() + settle_s
    while not command.advance() and watched.clock() < end_s:
        watched.listen(0.05)
    return command.outcome()


def _outcome(watched: Watch, confirmed: dict[int, bool], failure: str) -> Outcome:
    """Return the result of a command, with the last known state of the robots that did not confirm it."""
    missing = {robot: _last_state(watched, robot) for robot, has in confirmed.items() if not has}
    return Outcome([robot for robot, has in confirmed.items() if has], missing, failure)


def _last_state(watched: Watch, robot: int) -> str:
    """Return the last known state of a robot and its age, as a text."""
    name = f"robot/{robot}"
    if watched.is_ambiguous(name):
        return f"two processes are named {name}"
    sign = watched.signs.get(name)
    if sign is None:
        known = watched.silence_s(name)
        return "never heard" if known is None else f"silent; {known[1]} heard it {known[0]:.1f} s ago"
    armed = "armed" if sign.heartbeat.armed else "disarmed"
    age_s = max(0.0, watched.clock() - sign.received_s)
    is_pending = sign.latch.stopped and not sign.heartbeat.armed and sign.heartbeat.halted < sign.latch.stop
    zero = ", its link has not taken a zero since" * is_pending
    return f"{armed}, {sign.heartbeat.state or 'no state'}{zero}, heard {age_s:.1f} s ago"
