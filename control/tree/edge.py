"""One edge of the tree: two units share two robots, and take turns in choosing which.

The unit that has the turn may exchange the pair for two other robots that the neighbour offers. It alone
changes its control set then, at one instant; the neighbour's set stays as it is. It hands the turn over with
a report that names the pair and the robots that it offers in return, and may not give those to anybody else
before the turn is back.

At most one end has the turn, however messages are lost, delayed, repeated or reordered, because a turn ends
where it is handed over before it begins at the other end. So the two sets have exactly the pair in common at
every instant, and the two units need not agree on when to change. What one end knows of the pair is at most
one turn old.
"""

from dataclasses import dataclass, replace

from skyherd.messages import TreeStatus, UnitReport

Robots = frozenset[int]
"""A set of robots, by id."""

NO_ROBOTS: Robots = frozenset()
"""An empty set of robots."""

NO_TURN = -(2**53)
"""Number of the turn at an end that has not received anything about the edge yet. *Derived*: below the
milliseconds that any clock shows, also one that counts from a time to come, and exact in JSON."""


@dataclass(frozen=True)
class Edge:
    """An edge as one of its two units knows it; a new value for each change.

    Attributes:
        unit_id: the unit itself.
        neighbor_id: the unit at the other end.
        since_s: when this end came to be.
        turn: number of the turn, which may be negative; the lower unit has the even ones. `NO_TURN` before
            the first report.
        pair: the shared robots, none or two.
        offered: robots of the unit's own that the neighbour may take while it has the turn.
        reach: robots of the neighbour that the unit may take while it has the turn.
        to_release: those robots of `reach` that the neighbour would rather lose.
        releasing: robots that the unit would rather lose, offered for that.
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
        """Whether this unit, and not the neighbour, may exchange the pair now."""
        return self.turn != NO_TURN and has_turn(self.turn, self.unit_id, self.neighbor_id)

    def received(self, report: UnitReport) -> "Edge":
        """The edge after a report of the neighbour: the turn is taken if the report hands it over.

        Reports that are older or repeated change nothing. On one edge the neighbour is one turn ahead at
        most, and only with a turn that it hands over; if it is farther ahead, it gave up this edge and began
        a new one.
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
        """The edge after the unit's turn; what is offered stays promised until the turn is back."""
        return replace(
            self,
            turn=self.turn + 1,
            offered=offered,
            releasing=releasing,
            reach=NO_ROBOTS,
            to_release=NO_ROBOTS,
        )


def has_turn(turn: int, unit_id: int, neighbor_id: int) -> bool:
    """Whether `unit_id` has the turn on its edge to `neighbor_id`: the lower unit has the even ones."""
    return (turn % 2 == 0) == (unit_id < neighbor_id)


def first_turn(time_s: float, holder_id: int, other_id: int) -> int:
    """The turn at which a new edge begins, which `holder_id` has: the team's time in milliseconds.

    A turn lasts for one image at least, and so for more than a millisecond. A new edge therefore starts
    beyond all turns of any former edge of the two units, also if one of them has lost its memory.
    """
    turn = round(1000 * time_s)
    return turn if has_turn(turn, holder_id, other_id) else turn + 1


def turn_time_s(turn: int) -> float:
    """The team's time at which `first_turn` made a turn, s, to a millisecond."""
    return turn / 1000


@dataclass(frozen=True)
class EdgeStatus:
    """What a report says of the edge to one unit: turn, pair, robots offered, and those to be released."""

    turn: int
    pair: Robots
    offered: Robots
    to_release: Robots


def edge_status(report: UnitReport, unit_id: int) -> EdgeStatus | None:
    """What the report says of the sender's edge to `unit_id`; None if it names no such edge."""
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
