"""The control topology as data, and the paper's conditions on it (Section II).

A topology is the sets S_j^c of the robots that each unit controls. The nodes of the graph G_c are the units.
Two units are neighbours in it if they control at least two robots in common.
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
"""Sets S_j^c by unit id: the robots that each unit controls, ascending."""


@dataclass(frozen=True)
class Conditions:
    """Validity of each of the paper's topology conditions (Section II).

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
        """True if all hold: the shape is then reached from any start (Theorem 1)."""
        return self.in_q and self.tc3 and self.tc4 and self.tc5

    @property
    def in_q(self) -> bool:
        """True if TC1 and TC2 hold: the shape is then locally stable (Corollary 3)."""
        return self.tc1 and self.tc2


def control_matrix(sets: ControlSets, robot_ids: IntArray) -> BoolArray:
    """Return a mask (U, N) of the robots, ascending, that each unit, ascending, controls."""
    units = [sets[unit] for unit in sorted(sets)]
    robots = np.concatenate([np.zeros(0, dtype=np.int64), *units])
    row = np.repeat(np.arange(len(units)), [members.size for members in units])
    column = np.searchsorted(robot_ids[:-1], robots)  # at most the last column, a valid index below
    known = robot_ids[column] == robots
    matrix = np.zeros((len(units), robot_ids.size), dtype=bool)
    matrix[row[known], column[known]] = True
    return matrix


def graph_edges(sets: ControlSets) -> list[tuple[int, int]]:
    """Return the edges (j, k), j < k, of G_c."""
    units = sorted(sets)
    return [
        (j, k)
        for row, j in enumerate(units)
        for k in units[row + 1 :]
        if np.intersect1d(sets[j], sets[k]).size >= 2
    ]


def check_conditions(controlled: BoolArray) -> Conditions:
    """Check TC1-TC5 for a mask (U, N) of the robots of the team that each unit controls."""
    given: object = controlled
    if not isinstance(given, np.ndarray) or given.ndim != 2:
        raise InputError("check_conditions: controlled", shown(given), "an array of units by robots")
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
    """Return the units that control each robot, ascending; robots without a unit are omitted."""
    owners: dict[int, list[int]] = {}
    for unit in sorted(sets):
        check_vectors("owners_by_robot", **{f"sets[{unit}]": sets[unit]})
        for robot_id in sets[unit].tolist():
            owners.setdefault(robot_id, []).append(unit)
    return owners
