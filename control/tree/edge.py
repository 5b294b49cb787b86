"""Edge of the tree: two units share two robots and take turns in choosing the pair.

The unit with the turn may exchange the pair for two other robots that the neighbour offers. Only its own
control set changes then, at one instant; the neighbour's set stays the same. It hands the turn over with a
report that contains the pair and the robots that it offers in return. It may not give those to another unit
before the turn is back.

At most one end has the turn under any message loss, delay, repetition and reordering: a turn ends at one end
before it begins at the other. The two sets therefore have exactly the pair in common at every instant,
without agreement on the time of a change. An end's knowledge of the pair is at most one turn old.
"""

from dataclasses import dataclass, replace

from skyherd.messages import TreeStatus, UnitReport

Robots = frozenset[int]
"""A set of robots, by id."""

NO_ROBOTS: Robots = frozenset()
"""An empty set of robots."""

NO_TURN = -(2**53)
"""Number of the turn at an end without a report about the edge. Derived: below the milliseconds of any clock,
also one that counts from a future epoch, and exact in JSON."""


@dataclass(frozen=True)
class Edge:
    """Edge as known by one of its two units; every change creates a new value.

    Attributes:
        unit_id: the unit itself.
        neighbor_id: the unit at the other end.
        since_s: time at which this end was created.
        turn: number of the turn, which may be negative; the lower unit has the even ones. `NO_TURN` before
            the first report.
        pair: the shared robots, none or two.
        offered: robots of the unit's own that the neighbour may take while it has the turn.
        reach: robots of the neighbour that the unit may take while it has the turn.
        to_release: robots of `reach` that the neighbour prefers to release.
        releasing: offered robots that the unit prefers to release.
        considered: slot and `reach` at the unit's last search for a better pair.
        wants: whether that search found one.
    """

    unit_id: int
    neighbor_id: int
    since_s: float
    turn: int = NO_TURN
    pair: Robots = NO_ROBOTS
    offered: Robots = NO_ROBOTS
    reach: Robots = NO_ROBOTS
    to_release: Robots = NO_ROBOTS
    releasing: Robots = NO_ROBOTS
    considered: tuple[int, Robots] = (-1, NO_ROBOTS)
    wants: bool = False

    @property
    def is_my_turn(self) -> bool:
        """True if this unit, and not the neighbour, may exchange the pair now."""
        return self.turn != NO_TURN and has_turn(self.turn, self.unit_id, self.neighbor_id)

    def received(self, report: UnitReport) -> "Edge":
        """Return the edge after a report of the neighbour, with the turn if the report hands it over.

        Older or repeated reports change nothing. On one edge the neighbour is at most one turn ahead, and
        only with a turn that it hands over. If it is farther ahead, it removed this edge and created a new
        one.
        """
        status = edge_status(report, self.unit_id)
        if status is None or status.turn <= self.turn:
            return self
        return replace(
            self,
            turn=status.turn,
            pair=status.pair,
            offered=NO_ROBOTS,
            reach=status.offered,
            to_release=status.to_release,
        )

    def handed_over(self, offered: Robots, releasing: Robots) -> "Edge":
        """Return the edge after the unit's turn; offered robots stay promised until the turn is back."""
        return replace(
            self,
            turn=self.turn + 1,
            offered=offered,
            releasing=releasing,
            reach=NO_ROBOTS,
            to_release=NO_ROBOTS,
        )


def has_turn(turn: int, unit_id: int, neighbor_id: int) -> bool:
    """Return whether `unit_id` has the turn on its edge to `neighbor_id`; the lower unit has even turns."""
    return (turn % 2 == 0) == (unit_id < neighbor_id)


def first_turn(time_s: float, holder_id: int, other_id: int) -> int:
    """Return the first turn of a new edge, held by `holder_id`: the team's time in milliseconds.

    A turn lasts at least one image, and so more than a millisecond. A new edge therefore starts beyond all
    turns of any former edge of the two units, even if one of them has lost its memory.
    """
    turn = round(1000 * time_s)
    return turn if has_turn(turn, holder_id, other_id) else turn + 1


def turn_time_s(turn: int) -> float:
    """Return the team's time of a turn made by `first_turn`, s, to a millisecond."""
    return turn / 1000


@dataclass(frozen=True)
class EdgeStatus:
    """Part of a report about the edge to one unit: turn, pair, offered robots and robots to release."""

    turn: int
    pair: Robots
    offered: Robots
    to_release: Robots


def edge_status(report: UnitReport, unit_id: int) -> EdgeStatus | None:
    """Return the status of the sender's edge to `unit_id`, or None if the report has no such edge."""
    tree: TreeStatus | None = report.tree
    if tree is None or unit_id not in tree.rows:
        return None
    row = tree.rows[unit_id]
    pair = frozenset(robot for robot in tree.pairs[row].tolist() if robot >= 0)
    offered = frozenset(tree.offered_ids[tree.offered_to_ids == unit_id].tolist())
    return EdgeStatus(
        turn=int(tree.turns[row]),
        pair=pair,
        offered=offered,
        to_release=offered.intersection(tree.to_release_ids.tolist()),
    )
