"""One edge of the tree: two units share two robots, and take turns in choosing which.

Whoever has the turn may exchange the pair for two other robots that the neighbour lends it; it alone
changes its set then, at one instant, and the neighbour's set stays as it is. It hands the turn over with a
report that names the pair and the robots that it lends in return, and may not give those away before the
turn is back. A turn is held by one unit at most however messages are lost, delayed, repeated or reordered,
since it ends where it is handed over before it begins at the other end. So both sets have exactly the pair
in common at every instant, with no agreement on when to change; what one unit says of the pair is at most
one turn old.
"""

from dataclasses import dataclass

from skyherd.messages import TreeStatus, UnitReport

Robots = frozenset[int]
NO_ROBOTS: Robots = frozenset()
NO_TURN = -1
"""Of an edge whose other end has yet to tell."""


@dataclass
class Edge:
    """An edge as one of its two units knows it.

    Attributes:
        unit_id: the unit itself.
        neighbor_id: the unit at the other end.
        since_s: when this end came to be.
        turn: turns taken so far, of which the lower unit holds the even ones; NO_TURN before the first word.
        pair: the shared robots, none or two.
        lent: robots of the unit's own that the neighbour may take while it has the turn.
        reach: robots that the unit may take while it has the turn.
        wished: those that the neighbour would rather lose.
        giving: robots that the unit would rather lose, and lent for that.
        considered: slot and reach when the unit last looked for a better pair,
        wants: and whether there was one.
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
    def mine(self) -> bool:
        """Whether the unit has the turn."""
        return self.turn != NO_TURN and holds(self.turn, self.unit_id, self.neighbor_id)

    def hear(self, report: UnitReport) -> None:
        """Take the turn if the neighbour's report hands it over; older and repeated words change nothing.

        On one edge the neighbour is a turn ahead at most, and only with a turn that it hands over. If it is
        farther ahead it gave up this edge, and began anew.
        """
        tree = report.tree
        row = None if tree is None else tree.rows.get(self.unit_id)
        if tree is None or row is None or tree.turns[row] <= self.turn:
            return
        word = _word(tree, row, self.unit_id)
        self.turn, self.pair = word.turn, word.pair
        self.offered, self.reach, self.to_release = NO_ROBOTS, word.offered, word.to_release

    def hand_over(self, offered: Robots, releasing: Robots) -> None:
        """End the turn; what is lent is promised until the turn is back."""
        self.turn += 1
        self.offered, self.releasing = offered, releasing
        self.reach = self.to_release = NO_ROBOTS


def holds(turn: int, unit_id: int, neighbor_id: int) -> bool:
    """Whether `unit_id` has the turn on its edge to `neighbor_id`: the lower unit holds the even ones."""
    return (turn % 2 == 0) == (unit_id < neighbor_id)


def first_turn(time_s: float, holder_id: int, other_id: int) -> int:
    """The turn at which an edge begins, held by `holder_id`: the common clock, in milliseconds.

    A turn lasts an image at least, and so more than a millisecond: a new edge starts beyond all turns of any
    former edge of the two, also if one of them knows nothing of its former life.
    """
    turn = round(1000 * time_s)
    return turn if holds(turn, holder_id, other_id) else turn + 1


@dataclass(frozen=True)
class EdgeStatus:
    """What a report says of the edge to one unit."""

    turn: int
    pair: Robots
    offered: Robots
    to_release: Robots


def edge_status(report: UnitReport, unit_id: int) -> EdgeStatus | None:
    """What the report says of the edge to `unit_id`; None if it names no such edge."""
    tree = report.tree
    if tree is None or unit_id not in tree.rows:
        return None
    return _word(tree, tree.rows[unit_id], unit_id)


def _word(tree: TreeStatus, row: int, unit_id: int) -> EdgeStatus:
    pair = frozenset(robot for robot in tree.pairs[row].tolist() if robot >= 0)
    offered = frozenset(tree.offered_ids[tree.offered_to_ids == unit_id].tolist())
    return EdgeStatus(int(tree.turns[row]), pair, offered, offered.intersection(tree.to_release_ids.tolist()))
