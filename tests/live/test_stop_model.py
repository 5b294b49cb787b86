"""Model checking of the latched stop: every order of delivery, with loss, repetition and restarts.

The model has one robot, one unit and two operators, built from the classes of the live processes. A sent
message stays in the network, which may deliver it to any process, at any time and any number of times. That
covers message loss, latency, repetition and reordering, and frozen processes, which receive nothing for a
while. Robot and unit may restart without memory. The numbers of stops, arm commands and restarts are bounded,
and the test visits all reachable states.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import pytest

from skyherd.live.stop_latch import NO_COMMAND, ArmState, StopLatch

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
    """

    robot: ArmState = FRESH
    start: int = 0
    unit: StopLatch = NO_COMMAND
    operators: tuple[StopLatch, StopLatch] = (NO_COMMAND, NO_COMMAND)
    network: frozenset[Message] = frozenset()
    issued: frozenset[Issued] = frozenset()
    learnt: tuple[int, int] = (0, 0)
    budget: tuple[int, int, int] = (0, 0, 0)

    @property
    def session(self) -> Session:
        return Session(self.start, self.robot.disarmed_count)


@dataclass(frozen=True)
class Rules:
    """Rules of the processes. Each negative control breaks one of them."""

    def stop(self, known: StopLatch) -> StopLatch:
        return known.with_stop(0.0)

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

    def sends_goals(self, unit: StopLatch) -> bool:
        return not unit.stopped


def announced(state: State, rules: Rules) -> State:
    """Return the state with all messages in the network that the processes may send."""
    sent = {Message("heartbeat", state.robot.latch, state.session), Message("heartbeat", state.unit)}
    sent |= {Message("heartbeat", latch) for latch in state.operators}
    if rules.sends_goals(state.unit):
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
        yield replace(state, unit=unit, learnt=(state.learnt[0], unit_learnt))
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
        yield replace(state, unit=NO_COMMAND, learnt=(robot_learnt, 0), budget=budget)


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
    if rules.sends_goals(state.unit) and any(cleared < stop <= unit_learnt for stop in stops):
        return "a unit that learnt of a stop sends goals"
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
        if robot.armed or rules.sends_goals(rules.merge(state.unit, latch)):
            return "a stop that nobody cleared does not hold in the end"
    return None


def explore(rules: Rules, budget: tuple[int, int, int]) -> tuple[int, str | None]:
    """Visit all reachable states, and return their number and the first violation."""
    start = announced(State(budget=budget), rules)
    seen, waiting = {start}, [start]
    while waiting:
        state = waiting.pop()
        for after in successors(state, rules):
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


@pytest.mark.slow
@pytest.mark.parametrize("budget", [(2, 2, 0), (2, 1, 1)])
def test_stop_holds_under_longer_orders_of_messages(budget) -> None:
    states, found = explore(Rules(), budget)
    assert found is None and states > 1000


class ArmOutranks(Rules):
    """Broken rule: an arm command clears stops that its sender does not know."""

    def arm(self, known: StopLatch) -> StopLatch:
        return replace(known, cleared=max(known.stop, known.cleared) + 1)


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

    def sends_goals(self, unit: StopLatch) -> bool:
        return True


class SessionIgnored(Rules):
    """Broken rule: a robot obeys arm commands of any session, and those below a known stop."""

    def hear(self, robot: ArmState, message: Message, session: Session) -> ArmState:
        robot = robot.merge(message.latch)
        return replace(robot, armed_at=message.latch.cleared) if message.kind == "arm" else robot


@pytest.mark.parametrize(
    "broken", [ArmOutranks, NewestMessageWins, StopCarriesNoNumber, UnitIgnoresStop, SessionIgnored]
)
def test_model_detects_each_broken_rule(broken) -> None:
    _, found = explore(broken(), (1, 1, 0))
    assert found is not None
