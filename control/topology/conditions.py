"""The control topology as data, and the paper's conditions on it (Section II).

A topology is the sets S_j^c: which robots each unit controls. G_c has the units as nodes and an edge
where two of them control at least two robots in common.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from skyherd.errors import InputError
from skyherd.geometry import BoolArray, IntArray
from skyherd.messages.checks import check_vectors, shown

ControlSets = Mapping[int, IntArray]
"""S_j^c by unit id: the robots that each unit controls, ascending."""


@dataclass(frozen=True)
class Conditions:
    """Which of the paper's topology conditions hold (Section II).

    Attributes:
        tc1: the graph G_c of the units is connected.
        tc2: every robot is controlled by some unit.
        tc3: neighbours in G_c share exactly two robots, other units none.
        tc4: no robot is controlled by more than two units.
        tc5: G_c is a tree.
    """

    tc1: bool
    tc2: bool
    tc3: bool
    tc4: bool
    tc5: bool

    @property
    def in_p(self) -> bool:
        """Whether all hold: then the shape is reached from any start (Theorem 1)."""
        return self.in_q and self.tc3 and self.tc4 and self.tc5

    @property
    def in_q(self) -> bool:
        """Whether TC1 and TC2 hold: then the shape is reached from nearby (Corollary 3)."""
        return self.tc1 and self.tc2


def control_matrix(sets: ControlSets, robot_ids: IntArray) -> BoolArray:
    """(U, N) whether each unit, in ascending order, controls each of the robots, which ascend as well."""
    units = [sets[unit] for unit in sorted(sets)]
    robots = np.concatenate([np.zeros(0, dtype=np.int64), *units])
    row = np.repeat(np.arange(len(units)), [members.size for members in units])
    column = np.searchsorted(robot_ids[:-1], robots)  # never past the end, so that it can be compared below
    known = robot_ids[column] == robots
    matrix = np.zeros((len(units), robot_ids.size), dtype=bool)
    matrix[row[known], column[known]] = True
    return matrix


def graph_edges(sets: ControlSets) -> list[tuple[int, int]]:
    """Edges (j, k), j < k, of G_c."""
    units = sorted(sets)
    return [
        (j, k)
        for row, j in enumerate(units)
        for k in units[row + 1 :]
        if np.intersect1d(sets[j], sets[k]).size >= 2
    ]


def check_conditions(controlled: BoolArray) -> Conditions:
    """Which of TC1-TC5 hold for (U, N) booleans, units by all robots of the team: who controls whom."""
    if not isinstance(controlled, np.ndarray) or controlled.ndim != 2:
        raise InputError("check_conditions: controlled", shown(controlled), "an array of units by robots")
    holders = controlled.sum(axis=0)
    counts = controlled[:, holders > 1].astype(np.float64)  # exact, and much faster than integers
    common = counts @ counts.T
    np.fill_diagonal(common, 0)
    adjacent = common >= 2
    units = controlled.shape[0]
    parts, _ = connected_components(csr_array(adjacent.astype(np.int8)), directed=False)
    connected = parts == 1
    return Conditions(
        tc1=connected,
        tc2=bool((holders > 0).all()),
        tc3=bool((common[adjacent] == 2).all() and (common[~adjacent] == 0).all()),
        tc4=bool((holders <= 2).all()),
        tc5=bool(connected and adjacent.sum() // 2 == units - 1),
    )


def owners_by_robot(sets: ControlSets) -> dict[int, list[int]]:
    """Units that control each robot, ascending; a robot without any is left out."""
    owners: dict[int, list[int]] = {}
    for unit in sorted(sets):
        check_vectors("owners_by_robot", **{f"sets[{unit}]": sets[unit]})
        for robot_id in sets[unit].tolist():
            owners.setdefault(robot_id, []).append(unit)
    return owners
