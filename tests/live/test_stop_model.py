"""Model checking of the latched stop: every order of delivery, with loss, repetition and restarts.

A sent message stays in the network, which may deliver it to any process, at any time and any number of times.
That covers message loss, latency, repetition and reordering, and frozen processes, which receive nothing for
a while. The numbers of stops, arm commands and restarts are bounded. The tests visit all reachable states.

The first model (`State`) has one robot, one unit and two operators, built from the classes of the live
processes. Robot and unit may restart without memory. The clocks of its operators are behind all numbers, and
its checks identify stops by their numbers. At any time the unit may latch a suspicion of its camera.

The second model (`TeamModel`) has one robot, two operators and an optional unit, without restarts. The
operators have constant clocks that disagree, and run the real `StopCommand` and `ArmCommand`. Every number of
a stop has an identity. A process hears of a stop when it receives a message whose sender had heard of it or
issued it. The checks judge knowledge by these identities. Learning ends at any time. The number of issues of
each stop is bounded. An arm command names one session of the robot, and clears the stops known when it was
given (`known`). The start of `live arm` (`given_s`), which compares numbers with the time, is not modelled.

A number is outnumbered if an independent stop has a number that is not lower. The guarantee of confirmed
stops includes these. The other guarantees are checked for numbers that are not outnumbered.

Numbers do not cover one case of confirmed stops, and the checks exclude exactly this case:

- An operator stops the robot, and the robot confirms the stop. Until then, or until its learning ends, the
  operator hears of no independent stop of the other operator.
- The other operator's stop has a number that is not lower. Its clock is ahead, or it stops later.
- The other operator clears its own stop, without having heard of the first stop.

Processes keep only the largest number, so that the cleared stop hides the first one. No rule for one largest
number avoids that.

A robot with a driver (`Setup.has_driver`) writes to its link at any time or never. Its heartbeats say which
stop number it knew at the last zero. Without a driver it writes at once.

The operators have different tags, so that their stops have different numbers.
`test_equal_numbers_break_the_guarantee` shows why: two independent stops with equal numbers are one stop for
all processes, so that one confirms the other and one arm command clears both.
"""

import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

from skyherd.live.operator import LEARN_S, ArmCommand, Sign, StopCommand, Watch
from skyherd.live.stop_latch import NO_COMMAND, NOT_HALTED, TAGS, ArmState, StopLatch
from skyherd.live.wire import Arm, Heartbeat, Stop

FRESH = ArmState()


class Session(NamedTuple):
    """Session in an arm command: start of the robot, and number of times disarmed since."""

    start: int
    disarmed_count: int


class Message(NamedTuple):
    """A message in the network.

    Attributes:
        kind: heartbeat, goal, stop, or arm.
        latch: latch of its sender.
        session: session of the sending robot, or of the robot to arm.
    """

    kind: str
    latch: StopLatch
    session: Session | None = None


class Issued(NamedTuple):
    """A stop with its number, or an arm command with the knowledge of its sender."""

    kind: str
    number: int
    known: StopLatch


@dataclass(frozen=True)
class State:
    """All processes and the network. Only the checks use the issued commands and learnt stops.

    Attributes:
        learnt: the largest stop number that reached the robot and the unit since they started.
        budget: remaining stops, arm commands and restarts.
        is_suspected: whether the unit's suspicion of its camera is latched.
        suspected_at: the largest cleared number that the unit knew when it latched it; None if it did not.
        suspicions: remaining suspicions.
    """

    robot: ArmState = FRESH
    start: int = 0
    unit: StopLatch = NO_COMMAND
    operators: tuple[StopLatch, StopLatch] = (NO_COMMAND, NO_COMMAND)
    network: frozenset[Message] = frozenset()
    issued: frozenset[Issued] = frozenset()
    learnt: tuple[int, int] = (0, 0)
    budget: tuple[int, int, int] = (0, 0, 0)
    is_suspected: bool = False
    suspected_at: int | None = None
    suspicions: int = 0

    @property
    def session(self) -> Session:
        return Session(self.start, self.robot.disarmed_count)


@dataclass(frozen=True)
class Rules:
    """Rules of the processes. Each negative control breaks one of them."""

    def stop(self, known: StopLatch) -> StopLatch:
        return known.with_stop(0.0, 0)

    def arm(self, known: StopLatch) -> StopLatch:
        return known.with_arm()

    def hear(self, robot: ArmState, message: Message, session: Session) -> ArmState:
        robot = robot.merge(message.latch)
        if message.kind == "stop":
            return robot.disarm()
        if message.kind == "arm" and message.session == session:
            return robot.arm(message.latch.cleared)
        return robot

    def merge(self, known: StopLatch, heard: StopLatch) -> StopLatch:
        return known.merge(heard)

    def suspects(self, is_suspected: bool, before: StopLatch, after: StopLatch) -> bool:
        return is_suspected and not after.is_armed_since(before)

    def sends_goals(self, unit: StopLatch, is_suspected: bool) -> bool:
        return not unit.stopped and not is_suspected


def announced(state: State, rules: Rules) -> State:
    """Return the state with all messages in the network that the processes may send."""
    sent = {Message("heartbeat", state.robot.latch, state.session), Message("heartbeat", state.unit)}
    sent |= {Message("heartbeat", latch) for latch in state.operators}
    if rules.sends_goals(state.unit, state.is_suspected):
        sent.add(Message("goal", state.unit))
    return replace(state, network=state.network | sent)


def successors(state: State, rules: Rules) -> Iterator[State]:
    """Yield all states after one event."""
    stops, arms, restarts = state.budget
    for message in state.network:
        robot_learnt, unit_learnt = (max(learnt, message.latch.stop) for learnt in state.learnt)
        robot = rules.hear(state.robot, message, state.session)
        yield replace(state, robot=robot, learnt=(robot_learnt, state.learnt[1]))
        unit = rules.merge(state.unit, message.latch)
        suspects = rules.suspects(state.is_suspected, state.unit, unit)
        yield replace(state, unit=unit, learnt=(state.learnt[0], unit_learnt), is_suspected=suspects)
        for who in (0, 1):
            heard = rules.merge(state.operators[who], message.latch)
            yield with_operator(state, who, heard)
    for who in (0, 1):
        known = state.operators[who]
        if stops:
            latch = rules.stop(known)
            after = with_operator(state, who, latch)
            yield replace(
                after,
                network=after.network | {Message("stop", latch)},
                issued=after.issued | {Issued("stop", latch.stop, known)},
                budget=(stops - 1, arms, restarts),
            )
        if arms:
            latch = rules.arm(known)
            after = with_operator(state, who, latch)
            sessions = {message.session for message in state.network if message.session is not None}
            yield replace(
                after,
                network=after.network | {Message("arm", latch, session) for session in sessions},
                issued=after.issued | {Issued("arm", latch.cleared, known)},
                budget=(stops, arms - 1, restarts),
            )
    if restarts:
        budget = (stops, arms, restarts - 1)
        robot_learnt, unit_learnt = state.learnt
        start = state.start + 1
        yield replace(state, robot=FRESH, start=start, learnt=(0, unit_learnt), budget=budget)
        fresh = {"unit": NO_COMMAND, "is_suspected": False, "suspected_at": None}
        yield replace(state, learnt=(robot_learnt, 0), budget=budget, **fresh)
    if state.suspicions:
        at = state.unit.cleared
        yield replace(state, is_suspected=True, suspected_at=at, suspicions=state.suspicions - 1)


def with_operator(state: State, who: int, latch: StopLatch) -> State:
    operators = (latch, state.operators[1]) if who == 0 else (state.operators[0], latch)
    return replace(state, operators=operators)


def violation(state: State, rules: Rules) -> str | None:
    """Return the guarantee that a state violates, or None.

    The checks use the model's own records of issued commands, the knowledge of their senders, and deliveries.
    """
    stops = [one.number for one in state.issued if one.kind == "stop"]
    arms = [one for one in state.issued if one.kind == "arm"]
    robot_learnt, unit_learnt = state.learnt

    def drives_against_a_stop(robot: ArmState, learnt: int) -> bool:
        """Return whether a robot is armed by a command in ignorance of a stop that the robot learnt of."""
        known = max((arm.known.stop for arm in arms if arm.number == robot.armed_at), default=-1)
        return robot.armed and (known < 0 or any(known < stop <= learnt for stop in stops))

    if drives_against_a_stop(state.robot, robot_learnt):
        return "a robot that learnt of a stop is armed by a command whose sender did not know it"
    cleared = max((arm.known.stop for arm in arms), default=0)
    sends_goals = rules.sends_goals(state.unit, state.is_suspected)
    if sends_goals and any(cleared < stop <= unit_learnt for stop in stops):
        return "a unit that learnt of a stop sends goals"
    if sends_goals and state.suspected_at is not None and cleared_since(state) <= state.suspected_at:
        return "a unit sends goals although no arm command followed the suspicion of its camera"
    latch = NO_COMMAND
    for message in state.network:
        latch = latch.merge(message.latch)
        if message.kind == "goal":
            robot = rules.hear(state.robot, message, state.session)
            if drives_against_a_stop(robot, max(robot_learnt, message.latch.stop)):
                return "a robot drives by a goal that carries a stop"
    if any(cleared < stop for stop in stops):
        # No command cleared the newest stop: once all processes have heard of each other, all stand still.
        robot = rules.hear(state.robot, Message("heartbeat", latch), state.session)
        if robot.armed or rules.sends_goals(rules.merge(state.unit, latch), state.is_suspected):
            return "a stop that nobody cleared does not hold in the end"
    suspects = rules.suspects(state.is_suspected, state.unit, rules.merge(state.unit, latch))
    if suspects and (state.suspected_at is None or latch.cleared > state.suspected_at):
        return "a new arm command does not end the suspicion of the camera"
    return None


def cleared_since(state: State) -> int:
    """Return the largest number that an arm command has cleared, by the issued commands."""
    return max((one.number for one in state.issued if one.kind == "arm"), default=0)


def explore(rules: Rules, budget: tuple[int, int, int], suspicions: int = 0) -> tuple[int, str | None]:
    """Visit all reachable states, and return their number and the first violation."""
    start = announced(State(budget=budget, suspicions=suspicions), rules)
    seen, waiting = {start}, [start]
    while waiting:
        state = waiting.pop()
        for after in successors(state, rules):
            if after in seen:
                continue
            after = announced(after, rules)
            if after not in seen:
                if found := violation(after, rules):
                    return len(seen), found
                seen.add(after)
                waiting.append(after)
    return len(seen), None


@pytest.mark.parametrize("budget", [(1, 1, 0), (2, 1, 0), (1, 1, 1)])
def test_stop_holds_under_every_order_of_messages(budget) -> None:
    states, found = explore(Rules(), budget)
    assert found is None and states > 50


@pytest.mark.parametrize("budget", [(1, 1, 0), (2, 1, 0), (1, 1, 1)])
def test_suspicion_of_camera_lasts_until_new_arm_command(budget) -> None:
    states, found = explore(Rules(), budget, suspicions=1)
    assert found is None and states > 100


@pytest.mark.slow
@pytest.mark.parametrize(("budget", "suspicions"), [((2, 2, 0), 1), ((1, 1, 0), 2)])
def test_suspicion_of_camera_lasts_under_longer_orders(budget, suspicions) -> None:
    states, found = explore(Rules(), budget, suspicions)
    assert found is None and states > 100


@pytest.mark.slow
@pytest.mark.parametrize("budget", [(2, 2, 0), (2, 1, 1)])
def test_stop_holds_under_longer_orders_of_messages(budget) -> None:
    states, found = explore(Rules(), budget)
    assert found is None and states > 1000


class ArmOutranks(Rules):
    """Broken rule: an arm command clears stops that its sender does not know."""

    def arm(self, known: StopLatch) -> StopLatch:
        return replace(known, cleared=max(known.stop, known.cleared) + TAGS)


class NewestMessageWins(Rules):
    """Broken rule: processes adopt the numbers of the last message."""

    def merge(self, known: StopLatch, heard: StopLatch) -> StopLatch:
        return heard

    def hear(self, robot: ArmState, message: Message, session: Session) -> ArmState:
        return super().hear(replace(robot, latch=NO_COMMAND), message, session)


class StopCarriesNoNumber(Rules):
    """Broken rule: only the stop message itself stops a robot, without a latch."""

    def hear(self, robot: ArmState, message: Message, session: Session) -> ArmState:
        if message.kind == "stop":
            return robot.disarm()
        if message.kind == "arm" and message.session == session:
            return replace(robot, armed_at=0)
        return robot


class UnitIgnoresStop(Rules):
    """Broken rule: stopped units send goals."""

    def sends_goals(self, unit: StopLatch, is_suspected: bool) -> bool:
        return not is_suspected


class SessionIgnored(Rules):
    """Broken rule: a robot obeys arm commands of any session, and those below a known stop."""

    def hear(self, robot: ArmState, message: Message, session: Session) -> ArmState:
        robot = robot.merge(message.latch)
        return replace(robot, armed_at=message.latch.cleared) if message.kind == "arm" else robot


class AnyMessageTrusts(Rules):
    """Broken rule: any message ends the suspicion of the camera."""

    def suspects(self, is_suspected: bool, before: StopLatch, after: StopLatch) -> bool:
        return False


class OldArmTrusts(Rules):
    """Broken rule: an arm command that the unit knew before ends the suspicion of its camera."""

    def suspects(self, is_suspected: bool, before: StopLatch, after: StopLatch) -> bool:
        return is_suspected and not (after.cleared and not after.stopped)


class NothingTrusts(Rules):
    """Broken rule: no command ends the suspicion of the camera."""

    def suspects(self, is_suspected: bool, before: StopLatch, after: StopLatch) -> bool:
        return is_suspected


class SuspectingUnitSends(Rules):
    """Broken rule: a unit that suspects its camera sends goals."""

    def sends_goals(self, unit: StopLatch, is_suspected: bool) -> bool:
        return not unit.stopped


@pytest.mark.parametrize("broken", [AnyMessageTrusts, OldArmTrusts, NothingTrusts, SuspectingUnitSends])
def test_model_detects_each_broken_rule_of_suspicions(broken) -> None:
    _, found = explore(broken(), (1, 1, 0), suspicions=1)
    assert found is not None and "camera" in found


@pytest.mark.parametrize(
    "broken", [ArmOutranks, NewestMessageWins, StopCarriesNoNumber, UnitIgnoresStop, SessionIgnored]
)
def test_model_detects_each_broken_rule(broken) -> None:
    _, found = explore(broken(), (1, 1, 0))
    assert found is not None


MAX_ISSUES = 8
"""Number of bits for the issues of one operator."""

CONFIRMED = "a robot that confirmed a stop drives by a command whose operator had not heard of it"
HEARD = "a robot that heard of a stop drives by a command whose operator had not heard of it"
GOALS = "a unit that heard of a stop sends goals"
UNWRITTEN = "a stop is confirmed by a robot that wrote no zero since it knew the number"
IN_THE_END = "a stop that no command cleared does not hold in the end"


class Issue(NamedTuple):
    """One number of a stop. A stop that is issued again has several.

    Attributes:
        bit: identity of the issue, which no other issue has.
        number: number given by `StopLatch.with_stop`.
        known: bits of the issues that the operator had heard before.
    """

    bit: int
    number: int
    known: int


class Packet(NamedTuple):
    """A message in the network, with the model's record of its sender.

    Attributes:
        kind: heartbeat, stop, or arm.
        latch: latch of its sender.
        heard: bits of the issues that its sender had heard or issued.
        session: disarmed count of the sending robot, or of the robot to arm; None without a robot.
        armed: whether the sending robot is armed.
        given: bits of the issues that the operator had heard when it gave the arm command.
        halted: stop number that the sending robot knew when it last wrote zero.
    """

    kind: str
    latch: StopLatch
    heard: int
    session: int | None = None
    armed: bool = False
    given: int = 0
    halted: int = 0


class Running(NamedTuple):
    """A stop command in progress.

    Attributes:
        bit: identity of its last issue.
        number: its number.
        reissues: remaining number of times that it may be issued again.
        seen: bits of the issues that the operator heard while it learned numbers; None while it learns.
    """

    bit: int
    number: int
    reissues: int
    seen: int | None = None


class Confirmed(NamedTuple):
    """An issue that the robot confirmed. The attributes are those of `Running` at that time."""

    bit: int
    number: int
    seen: int


class Given(NamedTuple):
    """An arm command with the knowledge of its operator when it was given."""

    known: StopLatch
    heard: int


Record = Issue | Confirmed | Given


class Operator(NamedTuple):
    """One operator.

    Attributes:
        latch: commands known to the operator.
        heard: bits of the issues that it heard or issued.
        issued: number of its issues.
        running: its stop command in progress.
        given: its arm command in progress.
    """

    latch: StopLatch = NO_COMMAND
    heard: int = 0
    issued: int = 0
    running: Running | None = None
    given: Given | None = None


class Robot(NamedTuple):
    """The robot with the issues that it heard, and those known to the arm command in force.

    Attributes:
        halted: stop number known at the last write if it was zero, of a robot with a driver.
        zeroed: bits of the issues that it had heard when it wrote zero.
    """

    state: ArmState = FRESH
    heard: int = 0
    armed_by: int = 0
    halted: int = NOT_HALTED
    zeroed: int = 0


class Unit(NamedTuple):
    """The unit with the issues that it heard."""

    latch: StopLatch = NO_COMMAND
    heard: int = 0


@dataclass(frozen=True)
class Setup:
    """The clock of each operator, ms, its tag, and the initial state of the team.

    Attributes:
        clocks_ms: constant time of day of each operator.
        tags: tag of each operator.
        stops: number of stop commands.
        arms: number of arm commands.
        is_armed: whether the robot is armed by an earlier command.
        has_unit: whether a unit relays the numbers and sends goals.
        has_driver: whether writes of the robot are events of their own, which may not come.
        reissues: number of times that each stop may be issued again.
        ignores_unseen: whether the checks exclude the case that numbers do not cover.
    """

    clocks_ms: tuple[int, int]
    tags: tuple[int, int] = (0, 1)
    stops: int = 2
    arms: int = 1
    is_armed: bool = False
    has_unit: bool = False
    has_driver: bool = False
    reissues: int = 1
    ignores_unseen: bool = True


Sent = list[tuple[Stop | Arm, StopLatch]]
"""Sent messages of an operator, with the latch that each carries."""


class Outbox:
    """Mailbox of an operator that keeps the sent messages with the latch that they carry."""

    def __init__(self) -> None:
        self.watched: Any = None
        self.sent: Sent = []

    def send(self, message: Stop | Arm) -> None:
        self.sent.append((message, self.watched.latch))


ROBOT = "robot/0"
LAB: Any = SimpleNamespace(ids=[0])
FIRST_SIGN = Packet("heartbeat", NO_COMMAND, 0, session=0)
"""The robot's first heartbeat, which every operator has received."""


def watching(latch: StopLatch, sign: Packet, time_s: float, tag: int) -> tuple[Watch, Outbox]:
    """Return the real view of an operator that knows a latch and the robot's last heartbeat."""
    outbox: Any = Outbox()
    outbox.watched = Watch(outbox, lambda: time_s, latch, tag=tag)
    heartbeat = Heartbeat({}, session=str(sign.session), armed=sign.armed, ready=True, halted=sign.halted)
    outbox.watched.signs[ROBOT] = Sign(heartbeat, sign.latch, time_s, time_s)
    return outbox.watched, outbox


@dataclass(frozen=True)
class OperatorRules:
    """Rules of the operators, by the real commands. Each negative control breaks one of them."""

    def advance(
        self, latch: StopLatch, sign: Packet, number: int, is_learning: bool, time_s: float, tag: int
    ) -> tuple[bool, int, Sent]:
        """Advance a stop command. Return whether it is finished, its number, and the messages."""
        watched, outbox = watching(latch, sign, time_s, tag)
        command = object.__new__(StopCommand)
        began_s = time_s if is_learning else time_s - 2 * LEARN_S
        vars(command).update(_lab=LAB, _watched=watched, _why="", _began_s=began_s, _sent_s=-math.inf)
        vars(command).update(_number=number)
        is_finished = command.advance()
        return is_finished, vars(command)["_number"], outbox.sent

    def arm(
        self, latch: StopLatch, sign: Packet, known: StopLatch | None, time_s: float
    ) -> tuple[StopLatch, Sent]:
        """Advance an arm command. Return the operator's latch and the messages."""
        watched, outbox = watching(latch, sign, time_s, 0)
        ArmCommand(LAB, watched, known).advance()
        return watched.latch, outbox.sent


class Reaction(NamedTuple):
    """State of a process after an event, with the sent messages and the new records."""

    after: Operator
    sent: tuple[Packet, ...] = ()
    records: tuple[Record, ...] = ()


class Team(NamedTuple):
    """State of all processes, by their numbers in the catalogue; messages and records are sets of bits.

    Attributes:
        stops: remaining stop commands.
        arms: remaining arm commands.
    """

    robot: int
    unit: int
    operators: tuple[int, int]
    network: int
    records: int
    stops: int
    arms: int


class TeamModel:
    """All states of a team with the real commands of its operators.

    Every state of a process, message and record has a number in a catalogue, so that states of the team are
    small and each reaction is computed once.

    Args:
        setup: initial state and clocks.
        rules: rules of the operators.
    """

    def __init__(self, setup: Setup, rules: OperatorRules) -> None:
        self._setup, self._rules = setup, rules
        self._items: list[Any] = []
        self._numbers: dict[tuple[type, Any], int] = {}
        self.robot_after = cache(self._robot_after)
        self.robot_written = cache(self._robot_written)
        self.unit_after = cache(self._unit_after)
        self.reactions = cache(self._reactions)
        self.actions = cache(self._actions)
        self.heartbeat = cache(self._heartbeat)
        self.violations = cache(self._violations)
        self.members = cache(self._members)

    def number(self, item: Any) -> int:
        """Return the number of an item in the catalogue."""
        key = type(item), item  # Named tuples of two types are equal if their fields are.
        if key not in self._numbers:
            self._numbers[key] = len(self._items)
            self._items.append(item)
        return self._numbers[key]

    def bits(self, items: Iterable[Any]) -> int:
        """Return a set of items as bits."""
        return sum(1 << number for number in {self.number(item) for item in items})

    def _members(self, bits: int) -> list[int]:
        return [number for number in range(bits.bit_length()) if bits >> number & 1]

    def explore(
        self, guarantees: Iterable[str] = (CONFIRMED, HEARD, GOALS, UNWRITTEN, IN_THE_END)
    ) -> tuple[int, str]:
        """Visit all reachable states. Return their number, and the first violation of these guarantees."""
        setup = self._setup
        robot = Robot(ArmState(NO_COMMAND, 0 if setup.is_armed else None))
        operators = (self.number(Operator()), self.number(Operator()))
        unit = self.number(Unit())
        start = self.announced(Team(self.number(robot), unit, operators, 0, 0, setup.stops, setup.arms))
        seen, waiting = {start}, deque([start])
        while waiting:
            for after in self.successors(waiting.popleft()):
                if after in seen:
                    continue
                after = self.announced(after)
                if after not in seen:
                    seen.add(after)
                    found = self.violations(after.robot, after.unit, after.network, after.records)
                    if broken := [one for one in guarantees if one in found]:
                        return len(seen), broken[0]
                    waiting.append(after)
        return len(seen), ""

    def announced(self, team: Team) -> Team:
        """Return the state with the heartbeats that robot and unit may send."""
        network = team.network | self.heartbeat(team.robot)
        if self._setup.has_unit:
            network |= self.heartbeat(team.unit)
        return team if network == team.network else team._replace(network=network)

    def successors(self, team: Team) -> Iterator[Team]:
        """Yield all states after one event."""
        if self._setup.has_driver and (robot := self.robot_written(team.robot)) != team.robot:
            yield team._replace(robot=robot)
        for packet in self.members(team.network):
            robot = self.robot_after(team.robot, packet)
            if robot != team.robot:
                yield team._replace(robot=robot)
            if self._setup.has_unit:
                unit = self.unit_after(team.unit, packet)
                if unit != team.unit:
                    yield team._replace(unit=unit)
            for who in (0, 1):
                for reaction in self.reactions(who, team.operators[who], packet):
                    yield self.after(team, who, *reaction)
        for who in (0, 1):
            for stops, arms, *reaction in self.actions(who, team.operators[who], team.stops, team.arms):
                yield self.after(team, who, *reaction)._replace(stops=stops, arms=arms)

    def after(self, team: Team, who: int, operator: int, sent: int, records: int) -> Team:
        """Return the state after a reaction of an operator."""
        operators = (operator, team.operators[1]) if who == 0 else (team.operators[0], operator)
        network, records = team.network | sent, team.records | records
        return Team(team.robot, team.unit, operators, network, records, team.stops, team.arms)

    def _heartbeat(self, process: int) -> int:
        sender = self._items[process]
        if isinstance(sender, Unit):
            return self.bits([Packet("heartbeat", sender.latch, sender.heard)])
        state = sender.state
        session = state.disarmed_count
        at_once = NOT_HALTED if state.armed else state.latch.stop
        halted = sender.halted if self._setup.has_driver else at_once
        return self.bits(
            [Packet("heartbeat", state.latch, sender.heard, session, state.armed, halted=halted)]
        )

    def _robot_written(self, number: int) -> int:
        """Return the robot after a write without an error: zero, unless it is armed."""
        robot = self._items[number]
        if robot.state.armed:
            return self.number(robot._replace(halted=NOT_HALTED))
        zeroed = robot.zeroed | robot.heard
        return self.number(robot._replace(halted=robot.state.latch.stop, zeroed=zeroed))

    def _robot_after(self, number: int, packet_number: int) -> int:
        """Return the robot after a message, by the rules of the first model."""
        robot, packet = self._items[number], self._items[packet_number]
        session = Session(0, robot.state.disarmed_count)
        named = None if packet.session is None else Session(0, packet.session)
        state = Rules().hear(robot.state, Message(packet.kind, packet.latch, named), session)
        is_obeyed = packet.kind == "arm" and named == session and state.armed_at == packet.latch.cleared
        armed_by = packet.given if is_obeyed else robot.armed_by if state.armed else 0
        after = robot._replace(state=state, heard=robot.heard | packet.heard, armed_by=armed_by)
        return self.number(after)

    def _unit_after(self, number: int, packet_number: int) -> int:
        unit, packet = self._items[number], self._items[packet_number]
        return self.number(Unit(unit.latch.merge(packet.latch), unit.heard | packet.heard))

    def _numbered(self, reaction: Reaction) -> tuple[int, int, int]:
        return self.number(reaction.after), self.bits(reaction.sent), self.bits(reaction.records)

    def _reactions(self, who: int, number: int, packet_number: int) -> list[tuple[int, int, int]]:
        """Return the reactions of an operator to a message. It advances its command after each."""
        operator, packet = self._items[number], self._items[packet_number]
        heard = operator.heard | packet.heard
        after = operator._replace(latch=operator.latch.merge(packet.latch), heard=heard)
        time_s = self._setup.clocks_ms[who] / 1000
        sign = packet if packet.kind == "heartbeat" and packet.session is not None else FIRST_SIGN
        if after.running:
            reaction = self.advance_stop(who, after, sign, time_s)
        elif after.given:
            reaction = self.advance_arm(after, sign, time_s)
        else:
            reaction = Reaction(after)
        numbered = None if reaction is None else self._numbered(reaction)
        return [] if numbered in (None, (number, 0, 0)) else [numbered]

    def advance_stop(self, who: int, operator: Operator, sign: Packet, time_s: float) -> Reaction | None:
        """Return the reaction of the real stop command; None if it may not be issued again."""
        running = operator.running
        is_learning = running.seen is None
        is_finished, number, sent = self._rules.advance(
            operator.latch, sign, running.number, is_learning, time_s, self._setup.tags[who]
        )
        if number != running.number:
            if not running.reissues:
                return None
            return issued(who, operator, sent[0][1], running.reissues - 1)
        if not is_finished:
            return Reaction(operator)
        seen = operator.heard if is_learning else running.seen
        return Reaction(operator._replace(running=None), (), (Confirmed(running.bit, number, seen),))

    def advance_arm(self, operator: Operator, sign: Packet, time_s: float) -> Reaction:
        """Return the reaction of the real arm command."""
        given = operator.given
        latch, sent = self._rules.arm(operator.latch, sign, given.known, time_s)
        packets = tuple(
            Packet("arm", carried, operator.heard, int(message.sessions[ROBOT]), given=given.heard)
            for message, carried in sent
        )
        if not packets:
            return Reaction(operator._replace(latch=latch))
        return Reaction(operator._replace(latch=latch, given=None), packets, (given,))

    def _actions(self, who: int, number: int, stops: int, arms: int) -> list[tuple[int, int, int, int, int]]:
        """Return the commands of an operator, with the remaining ones, and the end of its learning."""
        operator = self._items[number]
        actions = []
        if stops:
            latch = operator.latch.with_stop(self._setup.clocks_ms[who] / 1000, self._setup.tags[who])
            actions.append(
                (stops - 1, arms, *self._numbered(issued(who, operator, latch, self._setup.reissues)))
            )
        if arms:
            given = Given(operator.latch, operator.heard)
            after = operator._replace(running=None, given=given)
            actions.append((stops, arms - 1, *self._numbered(Reaction(after))))
        if operator.running and operator.running.seen is None:
            running = operator.running._replace(seen=operator.heard)
            actions.append((stops, arms, *self._numbered(Reaction(operator._replace(running=running)))))
        return actions

    def _violations(self, robot_number: int, unit_number: int, network: int, bits: int) -> set[str]:
        """Return the guarantees that a state violates. The checks compare identities of stops."""
        robot, unit, found = self._items[robot_number], self._items[unit_number], set()
        records = [self._items[number] for number in self.members(bits)]
        issues = [one for one in records if isinstance(one, Issue)]
        given = [one.heard for one in records if isinstance(one, Given)]
        for stop in records:
            if isinstance(stop, Confirmed) and robot.state.armed and not stop.bit & robot.armed_by:
                known = [one for one in issues if one.bit & robot.armed_by]
                is_unseen = any(not one.bit & stop.seen and one.number >= stop.number for one in known)
                if not (is_unseen and self._setup.ignores_unseen):
                    found.add(CONFIRMED)
            if isinstance(stop, Confirmed) and self._setup.has_driver:
                written = [one.number for one in issues if one.bit & robot.zeroed]
                if not any(one >= stop.number for one in written):
                    found.add(UNWRITTEN)
        latch = NO_COMMAND
        for number in self.members(network):
            latch = latch.merge(self._items[number].latch)
        for issue in issues:
            if any(is_outnumbered(issue, other) for other in issues):
                continue  # The operator issues the stop again.
            if robot.state.armed and issue.bit & robot.heard & ~robot.armed_by:
                found.add(HEARD)
            if any(issue.bit & heard for heard in given):
                continue
            if issue.bit & unit.heard and not unit.latch.stopped:
                found.add(GOALS)
            if robot.state.merge(latch).armed or not latch.stopped:
                found.add(IN_THE_END)
        return found


def is_outnumbered(issue: Issue, other: Issue) -> bool:
    """Return whether another issue has no lower number although neither operator had heard of the other."""
    is_independent = other != issue and not other.bit & issue.known and not issue.bit & other.known
    return is_independent and other.number >= issue.number


def issued(who: int, operator: Operator, latch: StopLatch, reissues: int) -> Reaction:
    """Return the reaction of an operator that gives its stop a number."""
    bit = 1 << (MAX_ISSUES * who + operator.issued)
    heard = operator.heard | bit
    running = Running(bit, latch.stop, reissues)
    after = Operator(latch, heard, operator.issued + 1, running)
    return Reaction(after, (Packet("stop", latch, heard),), (Issue(bit, latch.stop, operator.heard),))


DISAGREEING = Setup((1, 3))
"""The first operator's clock is behind."""


DRIVEN = Setup((1, 3), stops=2, arms=0, is_armed=True, has_driver=True)
"""The robot has a driver."""


@pytest.mark.parametrize(
    "setup", [replace(DISAGREEING, is_armed=True), Setup((2, 2), stops=1, arms=2), DRIVEN]
)
def test_stop_holds_with_clocks_that_disagree(setup) -> None:
    states, found = TeamModel(setup, OperatorRules()).explore()
    assert not found and states > 1000


@pytest.mark.slow
@pytest.mark.parametrize(
    "setup",
    [
        DISAGREEING,
        replace(DISAGREEING, reissues=2),
        Setup((2, 2)),
        Setup((2, 2), tags=(1, 0)),
        replace(DISAGREEING, stops=1, arms=2, has_unit=True),
        replace(DISAGREEING, has_unit=True),
        replace(DISAGREEING, arms=2),
        replace(DISAGREEING, has_driver=True),
    ],
)
def test_stop_holds_with_clocks_in_longer_orders(setup) -> None:
    states, found = TeamModel(setup, OperatorRules()).explore()
    assert not found and states > 1000


class NoReissue(OperatorRules):
    """Broken rule: a stop keeps its number, so that an earlier stop confirms it."""

    def advance(
        self, latch: StopLatch, sign: Packet, number: int, is_learning: bool, time_s: float, tag: int
    ) -> tuple[bool, int, Sent]:
        return super().advance(latch, sign, number, False, time_s, tag)


class AnyHeartbeatConfirms(OperatorRules):
    """Broken rule: every heartbeat of a disarmed robot confirms a stop."""

    def advance(
        self, latch: StopLatch, sign: Packet, number: int, is_learning: bool, time_s: float, tag: int
    ) -> tuple[bool, int, Sent]:
        _, number, sent = super().advance(latch, sign, number, is_learning, time_s, tag)
        return not sign.armed, number, sent


class UnwrittenZeroConfirms(OperatorRules):
    """Broken rule: a disarmed robot that knows the stop confirms it before it has written zero."""

    def advance(
        self, latch: StopLatch, sign: Packet, number: int, is_learning: bool, time_s: float, tag: int
    ) -> tuple[bool, int, Sent]:
        sign = sign._replace(halted=sign.latch.stop)
        return super().advance(latch, sign, number, is_learning, time_s, tag)


class ArmClearsLaterStops(OperatorRules):
    """Broken rule: an arm command clears stops learnt after it was given."""

    def arm(
        self, latch: StopLatch, sign: Packet, known: StopLatch | None, time_s: float
    ) -> tuple[StopLatch, Sent]:
        return super().arm(latch, sign, None, time_s)


class ArmClearsUnknownStops(OperatorRules):
    """Broken rule: an arm command clears stops that its operator does not know."""

    def arm(
        self, latch: StopLatch, sign: Packet, known: StopLatch | None, time_s: float
    ) -> tuple[StopLatch, Sent]:
        latch, sent = super().arm(latch, sign, known, time_s)
        return latch, [(message, replace(carried, cleared=100 * TAGS)) for message, carried in sent]


@pytest.mark.parametrize(
    ("broken", "guarantee"),
    [
        (NoReissue, CONFIRMED),
        (AnyHeartbeatConfirms, CONFIRMED),
        (UnwrittenZeroConfirms, UNWRITTEN),
        (ArmClearsLaterStops, CONFIRMED),
        (ArmClearsUnknownStops, CONFIRMED),
        (ArmClearsUnknownStops, HEARD),
        (ArmClearsUnknownStops, GOALS),
        (ArmClearsUnknownStops, IN_THE_END),
    ],
)
def test_model_detects_each_broken_command(broken, guarantee) -> None:
    setup = DRIVEN if guarantee == UNWRITTEN else replace(DISAGREEING, has_unit=guarantee == GOALS)
    _, found = TeamModel(setup, broken()).explore([guarantee])
    assert found == guarantee


def test_unseen_stop_of_a_clock_ahead_needs_exclusion() -> None:
    _, found = TeamModel(replace(DISAGREEING, ignores_unseen=False), OperatorRules()).explore()
    assert found == CONFIRMED


def test_equal_numbers_break_the_guarantee() -> None:
    _, found = TeamModel(Setup((2, 2), tags=(0, 0)), OperatorRules()).explore()
    assert found == CONFIRMED
