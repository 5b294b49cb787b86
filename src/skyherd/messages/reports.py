"""Reports that aerial units send to one another after each image; they also serve as heartbeats."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, IntArray
from skyherd.messages.checks import check_time
from skyherd.messages.detections import Detections, centre_distances
from skyherd.messages.frozen_arrays import freeze, freeze_ids, freeze_image_size
from skyherd.messages.role_map import RoleMap
from skyherd.messages.short_repr import short_repr
from skyherd.messages.tree_status import TreeStatus


@dataclass(frozen=True)
class UnitReport:
    """Report of one aerial unit to the other units after an image.

    Attributes:
        unit_id: the sender.
        time_s: time of its image.
        image_size_px: (2,) width and height of its images.
        ids: (N,) robots that it sees, each once.
        points_px: (N, 2) their centres in its image.
        controlled_ids: (M,) robots that it controls, S_j^c in the paper.
        secure_ids: (L,) controlled robots inside its safety radius now.
        tree: its state in the tree protocol; None with sets from the safety radius alone.
        cost_sides2: its term V_j of the Lyapunov function (paper, eq. 9), in marker sides squared.
        side_px: the side of a marker in its image, as estimated jointly with its neighbours; 0 if the size of
            the shape is free.
        roles: its map from robots to template points; None with fixed roles.

    Raises:
        MessageError: a shape is wrong or an id occurs twice.
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

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_time(self)
        n = freeze_ids(self, "ids")
        freeze_image_size(self)
        freeze(self, "points_px", (n, 2))
        freeze_ids(self, "controlled_ids")
        freeze_ids(self, "secure_ids")

    @classmethod
    def of_image(cls, seen: Detections) -> "UnitReport":
        """Return a report that only lists the markers `seen` in an image, each once."""
        seen, none = seen.unambiguous(), np.zeros(0, dtype=np.int64)
        return cls(
            unit_id=seen.unit_id,
            time_s=seen.time_s,
            image_size_px=seen.image_size_px,
            ids=seen.ids,
            points_px=seen.centers_px,
            controlled_ids=none,
            secure_ids=none,
        )

    @cached_property
    def controlled(self) -> frozenset[int]:
        """Controlled robots as a set."""
        return frozenset(self.controlled_ids.tolist())

    @cached_property
    def centre_distances(self) -> Array:
        """Distances (N,) of the robots from the image centre, in halves of the image's shorter side."""
        return centre_distances(self.points_px, self.image_size_px)

    @cached_property
    def distances(self) -> dict[int, float]:
        """Distance from the image centre of each robot seen, as `centre_distances`."""
        return dict(zip(self.ids.tolist(), self.centre_distances.tolist(), strict=True))


def shared_ids(own: npt.ArrayLike, reports: Sequence[UnitReport]) -> IntArray:
    """Return the robots of `own` that at least one other unit reports to control, ascending."""
    others: set[int] = set().union(*(report.controlled for report in reports))
    return np.array(sorted(others.intersection(np.asarray(own).tolist())), dtype=np.int64)
