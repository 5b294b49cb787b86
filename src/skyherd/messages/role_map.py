"""Which robot takes which point of the template: part of a unit's report (control/formation/roles.py)."""

from dataclasses import dataclass

import numpy as np

from skyherd.errors import MessageError
from skyherd.geometry import IntArray
from skyherd.messages.frozen_arrays import freeze


@dataclass(frozen=True)
class RoleMap:
    """A whole map from robots to points of the template, and how new it is.

    Attributes:
        version: exchanges made so far; of two maps the one with the higher version holds,
        author_id: and of one version that of the lower unit.
        roles: (N,) row of each robot's template point, in the order of the template's ids: a permutation.
    """

    version: int
    author_id: int
    roles: IntArray

    def __post_init__(self) -> None:
        freeze(self, "roles", (None,), integer=True)
        if not np.array_equal(np.sort(self.roles), np.arange(self.roles.size)):
            raise MessageError(f"RoleMap.roles: no permutation: {self.roles.tolist()}")

    @property
    def name(self) -> tuple[int, int]:
        """What tells one map from another; the newer of two has the greater name."""
        return self.version, -self.author_id
