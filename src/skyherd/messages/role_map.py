"""Assignment of robots to template points: part of a unit's report.

`skyherd.control.formation.roles` has the protocol by which units agree on it.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.errors import MessageError
from skyherd.geometry import IntArray
from skyherd.messages.checks import shown
from skyherd.messages.frozen_arrays import freeze


@dataclass(frozen=True)
class RoleMap:
    """Complete map from robots to points of the template, with a version.

    Attributes:
        version: number of exchanges so far; the higher version is valid.
        author_id: the unit that created the map; of one version the map of the lower unit is valid.
        roles: (N,) row of each robot's point in the template, robots in the order of the template's ids; a
            permutation of 0 to N - 1, so that no point has two robots.

    Raises:
        MessageError: `roles` is not a permutation.
    """

    version: int
    author_id: int
    roles: IntArray

    def __post_init__(self) -> None:
        freeze(self, "roles", (None,), integer=True)
        if not np.array_equal(np.sort(self.roles), np.arange(self.roles.size)):
            raise MessageError("RoleMap.roles", shown(self.roles.tolist()), "a permutation of 0 to N - 1")

    @property
    def precedence(self) -> tuple[int, int]:
        """Key of the map; of two maps the one with the greater key is valid."""
        return self.version, -self.author_id
