"""What aerial units tell one another after each image."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, IntArray
from skyherd.messages.detections import centred
from skyherd.messages.frozen_arrays import freeze, freeze_ids
from skyherd.messages.role_map import RoleMap
from skyherd.messages.tree_status import TreeStatus


@dataclass(frozen=True)
class UnitReport:
    """What one aerial unit tells the others.

    Attributes:
        unit_id: the sender.
        time_s: when its image was taken.
        image_size_px: (2,) width and height of its images.
        ids: (N,) robots it sees.
        points_px: (N, 2) where it sees them.
        controlled_ids: (M,) robots it controls.
        secure_ids: (L,) those of them that it sees inside its safety radius now.
        tree: its standing in the tree of units; None where sets come from the safety radius alone.
        cost_sides2: its share V_j of the cost function, in marker sides squared.
        side_px: a marker side in its image, as agreed with its neighbours; 0 where sizes are free.
        roles: the map from robots to template points that it follows; None where roles are fixed.
    """

    unit_id: int
    time_s: float
    image_size_px: Array
    ids: IntArray
    points_px: Array
    controlled_ids: IntArray
    secure_ids: IntArray
    tree: TreeStatus | None = None
    cost_sides2: float = 0.0
    side_px: float = 0.0
    roles: RoleMap | None = None

    def __post_init__(self) -> None:
        n = freeze_ids(self, "ids")
        freeze(self, "image_size_px", (2,))
        freeze(self, "points_px", (n, 2))
        freeze_ids(self, "controlled_ids")
        freeze_ids(self, "secure_ids")

    @cached_property
    def controlled(self) -> frozenset[int]:
        """Robots it controls, as a set."""
        return frozenset(self.controlled_ids.tolist())

    @cached_property
    def distances(self) -> dict[int, float]:
        """Distances of the robots it sees from its image centre, in halves of its image's shorter side."""
        distances = np.linalg.norm(centred(self.points_px, self.image_size_px), axis=1)
        return dict(zip(self.ids.tolist(), distances.tolist(), strict=True))


def shared_ids(own: npt.ArrayLike, reports: Sequence[UnitReport]) -> IntArray:
    """Robots of `own` that at least one other unit reports to control."""
    others: set[int] = set().union(*(report.controlled for report in reports))
    return np.array(sorted(others.intersection(np.asarray(own).tolist())), dtype=np.int64)
