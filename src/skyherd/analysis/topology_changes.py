"""Topology changes of a run as a list of timed sentences."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skyherd.analysis.history import History
from skyherd.analysis.tree_snapshot import TreeSnapshot
from skyherd.geometry import BoolArray


@dataclass(frozen=True)
class TopologyChange:
    """A change of the topology: its time, and a description of a few words."""

    time_s: float
    what: str


def find_topology_changes(history: History) -> list[TopologyChange]:
    """List all changes after the first step: units die, return, join, leave; robots change units."""
    found = []
    for row in range(1, history.times_s.size):
        before, after = history.trees[row - 1], history.trees[row]
        changes = [*_of_units(before, after), *_of_robots(history, row)]
        found += [TopologyChange(float(history.times_s[row]), what) for what in changes]
    return found


def _of_units(before: TreeSnapshot | None, after: TreeSnapshot | None) -> Iterator[str]:
    if before is None or after is None:
        return
    yield from (f"unit {unit} died" for unit in sorted(after.dead - before.dead))
    yield from (f"unit {unit} returned" for unit in sorted(before.dead - after.dead))
    yield from (f"unit {unit} joined the tree" for unit in sorted(after.members - before.members))
    gone = before.members - after.members - after.dead
    yield from (f"unit {unit} left the tree" for unit in sorted(gone))
    if after.ready and not before.ready:
        yield "the tree is complete"


def _of_robots(history: History, row: int) -> Iterator[str]:
    """List the robots whose controlling units changed, those with the same change in one sentence."""
    before, after = history.controlled[row - 1], history.controlled[row]
    changes: dict[tuple[str, str], list[int]] = {}
    for column in np.flatnonzero((before != after).any(axis=0)).tolist():
        change = _owners(before[:, column]), _owners(after[:, column])
        changes.setdefault(change, []).append(int(history.ids[column]))
    for (old, new), robots in changes.items():
        yield f"{robot_names(robots)}: {old} → {new}"


def _owners(units: BoolArray) -> str:
    names = [str(unit) for unit in np.flatnonzero(units)]
    return f"unit {names[0]}" if len(names) == 1 else f"units {' + '.join(names)}" if names else "no unit"


def robot_names(ids: list[int]) -> str:
    """Name robots by their ids, as `robot 3` or `robots 3, 5`."""
    return f"robot{'s' if len(ids) > 1 else ''} {', '.join(str(robot) for robot in ids)}"
