"""Robots that nobody controls find a unit; robots that two units claim lose one."""

from dataclasses import dataclass, field

import numpy as np

from skyherd.control.tree.node_state import NodeState


@dataclass
class Orphans:
    """Robots that a unit sees and that no member controls.

    After half a dwell time in which nobody took them, so that reports on their way have arrived, each becomes
    the own of the member that sees it nearest to its image centre, by what all were told last. A robot goes
    from hand to hand by being shared for a slot at least: so nobody has it only if that is what all members
    say of the slot before, or of this one.
    """

    since_s: dict[int, float] = field(default_factory=dict, init=False)
    _told: dict[int, float] = field(default_factory=dict, init=False)

    def adopt(self, unit: NodeState, time_s: float, at_slot: bool) -> None:
        """Watch orphans, and at a slot adopt those that are the unit's to adopt."""
        members = unit.heard.members(time_s)
        orphans = unit.distances.keys() - unit.heard.claimed(time_s) - unit.controlled
        self.since_s = {robot: self.since_s.get(robot, time_s) for robot in orphans}
        told, self._told = self._told, unit.distances
        said_s = min((heard.report.time_s for heard in members), default=np.inf)
        if not at_slot or said_s < (unit.slot - 1) * unit.rule.dwell_s:
            return
        for robot in orphans:
            nearest = min(
                ((heard.distances.get(robot, np.inf), heard.report.unit_id) for heard in members),
                default=(np.inf, unit.unit_id),
            )
            waited_s = time_s - self.since_s[robot]
            if waited_s >= unit.rule.dwell_s / 2 and (told.get(robot, np.inf), unit.unit_id) <= nearest:
                unit.own.add(robot)


def disown(unit: NodeState, time_s: float) -> None:
    """Leave robots that went out of view to the members that see them."""
    secured = set().union(*(heard.near(unit.rule.radius) for heard in unit.heard.members(time_s)))
    unit.own -= (unit.lost(time_s) & secured) - unit.offered()


def yield_claims(unit: NodeState, time_s: float) -> None:
    """Drop own robots that a lower unit controls as well, or that an edge of other units shares.

    What a unit said before this one had the robot is no claim: it may have given the robot away since.
    """
    if unit.own.isdisjoint(unit.heard.claimed(time_s)):
        return
    for heard in unit.heard.members(time_s):
        claimed = heard.controlled if heard.report.unit_id < unit.unit_id else heard.paired
        said_s = heard.report.time_s
        unit.own -= {robot for robot in unit.own & claimed if unit.held_s.get(robot, time_s) <= said_s}
