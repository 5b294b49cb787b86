"""Whether the tree holds together: of parts that lost one another the smaller ones join anew."""

from dataclasses import dataclass, field

import numpy as np

from skyherd.control.tree.node_state import NodeState


@dataclass
class PartitionWatch:
    """Two ends of an edge that hear nothing of each other for long each go on without the other.

    Once they hear each other again there are two parts of one tree, with no edge in between. Every unit can
    tell its part by the edges that all members name. A part that for a silence is not the largest resigns,
    unit by unit; of equal ones the one with the lowest unit stays.
    """

    _since_s: float = field(default=np.inf, init=False)

    def keep(self, unit: NodeState, time_s: float) -> None:
        """Resign if the unit's part of the tree is to give way to another one."""
        parts = _parts(unit, time_s)
        largest = min(parts, key=lambda part: (-len(part), min(part)))
        if not unit.is_member or unit.unit_id in largest:
            self._since_s = np.inf
            return
        self._since_s = min(self._since_s, time_s)
        if time_s - self._since_s >= unit.rule.silence_s:
            self._since_s = np.inf
            unit.resign()


def _parts(unit: NodeState, time_s: float) -> list[set[int]]:
    """Members that are heard and this unit, by the edges that they name, dead units in between as well.

    Parts with an edge to a unit that is not heard, dead or out of range, may be one part beyond it.
    """
    links = {heard.report.unit_id: set(heard.tree.rows) for heard in unit.heard.members(time_s)}
    links[unit.unit_id] = set(unit.edges)
    for member, neighbors in list(links.items()):
        for neighbor in neighbors:
            links.setdefault(neighbor, set()).add(member)
    heard = {unit.unit_id, *(heard.report.unit_id for heard in unit.heard.members(time_s))}
    ended, open_ended, left = [], set(), set(links)
    while left:
        part = _reached(left.pop(), links)
        left -= part
        if part <= heard:
            ended.append(part)
        else:
            open_ended |= part & heard
    return ended + ([open_ended] if open_ended else [])


def _reached(start: int, links: dict[int, set[int]]) -> set[int]:
    """All units that a walk along links gets to."""
    part, ahead = {start}, [start]
    while ahead:
        new = links[ahead.pop()] - part
        part |= new
        ahead += new
    return part
