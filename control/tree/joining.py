"""How units become one tree: found it, ask to be admitted, grant an edge; and when it is complete."""

from dataclasses import dataclass

from skyherd.control.tree.edge import NO_ROBOTS, NO_TURN, edge_status, first_turn
from skyherd.control.tree.node_state import NodeState
from skyherd.control.tree.peer_reports import PeerReport
from skyherd.messages import NO_ID


def seek(unit: NodeState, time_s: float, at_slot: bool) -> None:
    """Without a tree: ask one to be admitted to it; if there is none, let the unit found it that sees most.

    Large sets bind the team firmly (docs/topology.md), and the founder's is all that it sees. So that there
    is one founder, however late reports are, the lowest unit chooses: it founds the tree, or asks another
    to and keeps to that while it hears of it, since the other may have done so by then.
    """
    members = unit.heard.members(time_s)
    if members:
        _ask(unit, members, time_s)
        return
    fresh = {heard.report.unit_id: heard for heard in unit.heard.fresh(time_s)}
    lowest = min(fresh, default=unit.unit_id)
    if lowest < unit.unit_id:
        if lowest in unit.askers(time_s):
            _found(unit)
    elif at_slot and time_s - unit.since_s >= unit.rule.dwell_s and unit.asks_id not in fresh:
        inside = {other: len(heard.near(unit.rule.radius)) for other, heard in fresh.items()}
        inside[unit.unit_id] = len(unit.visible)
        chosen = max(inside, key=lambda other: (inside[other], -other))
        if chosen == unit.unit_id:
            _found(unit)
        else:
            unit.asks_id, unit.ask_turn = chosen, first_turn(time_s, unit.unit_id, chosen)


def _found(unit: NodeState) -> None:
    """Begin the tree, with all robots in view as the unit's own."""
    unit.tree_id, unit.asks_id, unit.own = unit.unit_id, NO_ID, unit.visible


def _ask(unit: NodeState, members: list[PeerReport], time_s: float) -> None:
    """Ask the member with most own robots in common; open the edge that the one asked grants.

    The question names the turn at which the edge is to begin, another one each time: a grant that comes late
    answers a question that is no longer put, and is void.
    """
    if unit.edges:
        return
    for heard in members:
        asked, word = heard.report.unit_id, edge_status(heard.report, unit.unit_id)
        if asked == unit.asks_id and word and not word.pair and word.turn == unit.ask_turn:
            unit.open_edge(asked, time_s, NO_TURN, NO_ROBOTS)
            unit.edges[asked].hear(heard.report)
            return
    visible = unit.visible
    common = {
        heard.report.unit_id: len(visible.intersection(heard.report.secure_ids.tolist()) - heard.paired)
        for heard in members
    }
    best = max(common, key=lambda member: (common[member], -member))
    if common.get(unit.asks_id, 0) < 2:
        unit.asks_id = best if common[best] >= 2 else NO_ID
        unit.ask_turn = first_turn(time_s, unit.unit_id, best)


def admit(unit: NodeState, time_s: float) -> None:
    """Grant an edge, yet without a pair, to each unit that asks for one."""
    for asking in sorted(unit.askers(time_s) - unit.edges.keys()):
        offered = unit.offerable(asking, time_s)
        if len(offered) >= 2:
            unit.open_edge(asking, time_s, unit.heard.newest[asking].tree.ask_turn, NO_ROBOTS, offered)


@dataclass(frozen=True)
class Extent:
    """How far the tree reaches, as one unit knows it: units outside of it, robots that some unit holds."""

    outside: frozenset[int]
    held: frozenset[int]


def extent_of(unit: NodeState, time_s: float) -> Extent:
    """The tree's reach, by what was heard of late."""
    fresh = unit.heard.fresh(time_s)
    outside = {heard.report.unit_id for heard in fresh if not heard.is_member}
    return Extent(
        frozenset(outside if unit.is_member else outside | {unit.unit_id}),
        frozenset(unit.controlled.union(*(heard.controlled for heard in fresh))),
    )


def is_complete(unit: NodeState, extent: Extent, time_s: float) -> bool:
    """Whether all units heard belong to the tree and all robots to a unit, or waiting has lasted too long."""
    if not unit.is_member:
        return False
    told = any(heard.tree.ready for heard in unit.heard.fresh(time_s))
    waited = time_s - unit.since_s > unit.rule.patience_s
    return told or waited or (not extent.outside and extent.held >= unit.template.members)
