"""The tree protocol under any interleaving of images, messages, message loss, crashes and views.

Two machines drive two and three units. Hypothesis chooses when and how often the radio delivers each message.
Robots enter and leave the views.

`Faithful`: no unit fails, every two receive each other once per silence timeout, and a unit sees each robot
of its set once per silence timeout. Then at every instant

- no robot is lost: a controlled robot stays controlled;
- two units share the pair of their edge, as known by the end with the later turn, or nothing; so no robot is
  controlled by three;
- the two ends of an edge are at most one turn apart. At the same turn they have the same pair, and never do
  both have the turn. The two have different pairs only until the first report handed over arrives.

Only an uncontrolled robot, adopted by units that could not yet know of each other, may be held by all of
these for `SETTLING_S`. Adopters do so in the same slot (a dwell time). The higher one drops it on the first
report of the lower one that it receives (a silence timeout, and its own next image).

`Faulty`: units crash, return without memory, and do not receive each other for any time. Once all messages
arrive and every unit sees all robots, TC1-TC5 hold after `healing_s`, and from then on. This time is two
silence timeouts, plus one until a unit that was declared dead, or that belongs to the smaller part, has
resigned. Units may have to join one by one. The time therefore adds, for each unit, a slot for its first turn
and one for the adoption of its robots.
"""

from dataclasses import replace
from typing import ClassVar

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test
from protocol_world import ProtocolWorld

from skyherd.control.tree.failover import GRACE
from skyherd.control.tree.node_state import TreeSettings
from skyherd.control.tree.protocol import TreeProtocol

IMAGE_S = 0.9
"""The longest time between two images of a unit."""
RULE = TreeSettings(gain=1.05)
SETTLING_S = RULE.dwell_s + RULE.silence_s + 2 * IMAGE_S

DISTANCES = st.sampled_from([None, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0, 1.2])
"""Distance at which a unit sees a robot, in half images; None if it does not."""
NUMBERS = st.integers(0, 1000)
TICKS = st.lists(st.tuples(st.sampled_from("dkdkl"), NUMBERS), max_size=8)
"""Fates of messages: delivered, delivered and kept for a repetition, lost."""


def healing_s(units: int) -> float:
    """Return the time after all faults in which the units agree on a tree again."""
    return (GRACE + 1) * RULE.silence_s + 2 * units * RULE.dwell_s


class Machine(RuleBasedStateMachine):
    """Images, messages and views; the invariants are checked after every image."""

    make: ClassVar[type[TreeProtocol]] = TreeProtocol

    @initialize(
        units=st.integers(2, 3),
        spare=st.integers(0, 4),
        distances=st.lists(DISTANCES, min_size=30, max_size=30),
        calm_s=st.sampled_from([0.0, 9.0]),
    )
    def begin(self, units: int, spare: int, distances: list[float | None], calm_s: float) -> None:
        robots = 2 * units + spare
        rows = [distances[unit * 10 : unit * 10 + robots] for unit in range(units)]
        views = [{robot: at for robot, at in enumerate(row) if at is not None} for row in rows]
        self.world = ProtocolWorld(units, robots, RULE, views, self.make)
        self.world.image(0)
        self.world.deliver_all()
        self.adopted_s: dict[int, float] = {}
        for _ in range(round(calm_s / 0.5)):
            self.world.time_s += 0.5
            for unit in range(units):
                self.world.deliver_all()
                self.image(unit)

    @rule(
        dt=st.sampled_from([0.1, 0.3, 0.6, 0.9]),
        fates=TICKS,
        order=st.permutations([0, 1, 2]),
        idle=st.sampled_from([None, None, 0, 1, 2]),
    )
    def tick(self, dt: float, fates: list[tuple[str, int]], order: list[int], idle: int | None) -> None:
        """Advance the time, decide the fates of messages, and give units their images one by one."""
        world = self.world
        world.time_s = round(world.time_s + dt, 3)
        for turn, unit in enumerate(order):
            for fate, pick in fates[turn::3]:
                if world.waiting:
                    index = (len(world.waiting) - 1 - pick % 12) % len(world.waiting)
                    if fate == "l":
                        del world.waiting[index]
                    else:
                        world.deliver(index, keep=fate == "k")
            late = world.time_s - world.imaged_s.get(unit, world.time_s) > IMAGE_S - 0.01
            if unit in world.nodes and (unit != idle or late):
                self.image(unit)
        del world.waiting[:-40]

    @rule(unit=NUMBERS, robot=NUMBERS, distance=DISTANCES)
    def look(self, unit: int, robot: int, distance: float | None) -> None:
        """Move a robot in the view of a unit, or out of it."""
        view, robot = self.world.views[unit % self.world.units], robot % self.world.robots
        view.pop(robot, None)
        if distance is not None:
            view[robot] = distance

    def image(self, unit: int) -> None:
        self.world.image(unit)


class Faithful(Machine):
    """Machine without faults: TC3-TC5 hold and no robot is lost, at every instant."""

    def image(self, unit: int) -> None:
        world = self.world
        self._keep_faith(unit)
        before = world.holders()
        world.image(unit)
        after = world.holders()
        lost = before.keys() - after.keys()
        assert not lost, f"at {world.time_s} s uncontrolled: {sorted(lost)}"
        self.adopted_s |= dict.fromkeys(after.keys() - before.keys(), world.time_s)
        young = {r for r, since_s in self.adopted_s.items() if world.time_s - since_s <= SETTLING_S}
        assert not world.edge_faults(but=young), f"at {world.time_s} s {world.edge_faults(but=young)}"
        shared = {robot: count for robot, count in after.items() if count > 2 and robot not in young}
        assert not shared, f"at {world.time_s} s controlled by three: {shared}"

    def _keep_faith(self, unit: int) -> None:
        """Limit silences to the protocol's timeout: between two units, and of a robot to its unit."""
        world, node = self.world, self.world.nodes[unit]
        longest_s = RULE.silence_s - 0.01
        for other, report in world.latest.items():
            heard = [h.report for h in (node.peers.newest.get(other),) if h is not None]
            last_s = max((r.time_s for r in [*heard, *world.inbox_of(unit, other)]), default=-10.0)
            if other != unit and world.time_s - last_s > longest_s:
                world.inbox[unit][other] = report
        for robot in world.sets[unit] - world.views[unit].keys():
            if world.time_s - node.state.seen_s.get(robot, world.time_s) > longest_s:
                world.views[unit][robot] = 1.2


class Faulty(Machine):
    """Machine with faults: violated conditions hold again a bounded time after the last fault."""

    @rule(unit=NUMBERS)
    def crash(self, unit: int) -> None:
        if len(self.world.nodes) > 1:
            self.world.crash(sorted(self.world.nodes)[unit % len(self.world.nodes)])

    @rule()
    def revive(self) -> None:
        for unit in range(self.world.units):
            if unit not in self.world.nodes:
                self.world.revive(unit)
                return

    @rule(seconds=st.sampled_from([1.0, 4.0, 8.0]), deaf=NUMBERS, dumb=NUMBERS)
    def be_deaf(self, seconds: float, deaf: int, dumb: int) -> None:
        """Block reception of one unit from another one, or from all, without other faults."""
        world = self.world
        deaf, dumb = deaf % world.units, dumb % world.units
        for _ in range(round(seconds / 0.5)):
            world.time_s += 0.5
            for unit in list(world.nodes):
                world.waiting = [
                    (to, report)
                    for to, report in world.waiting
                    if to != deaf or dumb not in (deaf, report.unit_id)
                ]
                world.deliver_all()
                world.image(unit)

    @rule(seconds=st.sampled_from([2.0, 6.0]))
    def be_well(self, seconds: float) -> None:
        self.world.quiet(seconds)

    def teardown(self) -> None:
        if not hasattr(self, "world"):
            return
        world = self.world
        seen = {robot: 0.1 + 0.8 * robot / world.robots for robot in range(world.robots)}
        world.views[:] = [dict(seen) for _ in range(world.units)]
        world.quiet(healing_s(len(world.nodes)))
        for _ in range(12):
            world.quiet(0.5)
            assert world.in_p(), f"{world.sets} at {world.time_s} s"
            assert not world.edge_faults()


class Hasty(TreeProtocol):
    """Protocol that exchanges without the turn: a deliberate violation of the rule for TC3 and TC4."""

    def choose(self, seen, reports, shape, last):
        edges = dict(self.state.edges)
        for neighbor, edge in edges.items():
            peer = self.peers.newest.get(neighbor)
            if not edge.is_my_turn and edge.pair and peer is not None:
                edges[neighbor] = replace(edge, turn=edge.turn + 1, reach=peer.controlled - peer.paired)
        self.state = replace(self.state, edges=edges)
        return super().choose(seen, reports, shape, last)


class FaithfulHasty(Faithful):
    make = Hasty


class Careless(TreeProtocol):
    """Protocol that forgets its offers and offers robots twice: a deliberate violation of the promise."""

    def choose(self, seen, reports, shape, last):
        edges = {unit: replace(edge, offered=frozenset()) for unit, edge in self.state.edges.items()}
        self.state = replace(self.state, edges=edges)
        return super().choose(seen, reports, shape, last)


class FaithfulCareless(Faithful):
    make = Careless


def run(machine: type[Machine], examples: int, steps: int, **extra) -> None:
    """Drive a machine."""
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=examples,
            stateful_step_count=steps,
            suppress_health_check=list(HealthCheck),
            **extra,
        ),
    )


@pytest.mark.random
@pytest.mark.parametrize("machine", [Faithful, Faulty])
def test_protocol_is_safe_under_interleavings(machine) -> None:
    run(machine, 8, 40)


@pytest.mark.slow
@pytest.mark.parametrize("machine", [Faithful, Faulty])
def test_protocol_is_safe_under_many_interleavings(machine) -> None:
    run(machine, 600, 80)


def test_machine_detects_missing_turns() -> None:
    with pytest.raises(AssertionError, match=r"share|turn"):
        run(FaithfulHasty, 400, 40, phases=[Phase.generate])


@pytest.mark.slow
def test_machine_detects_broken_promises() -> None:
    with pytest.raises(AssertionError, match=r"share|turn|three"):
        run(FaithfulCareless, 400, 60, phases=[Phase.generate])
