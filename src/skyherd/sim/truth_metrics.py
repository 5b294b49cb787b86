"""What only one who knows the truth can say: V, the topology's conditions, how good the shape is.

For plots and tests; nothing here reaches `control`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from skyherd.control import Template, fit_similarities, fit_similarity
from skyherd.control.topology.conditions import Conditions, ControlSets, check_conditions, control_matrix
from skyherd.geometry import Array, BoolArray, IntArray, to_complex


@dataclass(frozen=True)
class ShapeFit:
    """The similarity of the template that fits a formation best, on the ground.

    Attributes:
        error: RMS distance to it over the formation's RMS radius.
        scale: metres a template unit.
        rotation_rad: counter-clockwise.
        squares_m2: sum of squared distances to it.
    """

    error: float
    scale: float
    rotation_rad: float
    squares_m2: float


def fit_shape(template_ground: np.ndarray, positions: np.ndarray) -> ShapeFit:
    """Fit template points (N,) to ground positions (N,), both complex in map sense."""
    similarity = fit_similarity(template_ground, positions)
    squares = float(np.sum(np.abs(similarity(template_ground) - positions) ** 2))
    spread = float(np.sum(np.abs(positions - positions.mean()) ** 2))
    return ShapeFit(float(np.sqrt(squares / spread)), similarity.scale, similarity.rotation_rad, squares)


@dataclass(frozen=True)
class TruthMetrics:
    """The state of a mission at one instant.

    Attributes:
        V: cost function, m² (eq. 9).
        V_units: (U,) each unit's share, `1/2 Σ_i |x_i^{d,j} - x_i|²`; NaN for a set that makes no shape.
        scales: (U,) metres a template unit, of each partial formation.
        rotations_rad: (U,) of each partial formation, ground sense.
        conditions: TC1-TC5.
        shape: of the whole formation.
        min_separation_m: between any two robots.
    """

    V: float
    V_units: Array
    scales: Array
    rotations_rad: Array
    conditions: Conditions
    shape: ShapeFit
    min_separation_m: float


class TruthObserver:
    """Watches a team form the shape of `template`; `ids` are its robots, ascending."""

    def __init__(self, template: Template, ids: IntArray) -> None:
        self.ids = ids
        self.template_ground = template.points_of(ids).conj()
        self._topology: BoolArray = np.zeros((0, ids.size), dtype=bool)
        self._conditions = check_conditions(self._topology)

    def observe(
        self,
        positions_m: Array,
        sets: ControlSets,
        dead: Sequence[int] = (),
        shape: Template | None = None,
    ) -> TruthMetrics:
        """Judge robots at positions (N, 2) under the topology `sets`, in which dead units have no part.

        `shape` is what they form now, each robot with the point that is its own; the template if None.
        """
        template = self.template_ground if shape is None else shape.points_of(self.ids).conj()
        positions = to_complex(positions_m)
        controlled = control_matrix(sets, self.ids)
        unit, robot = np.nonzero(controlled)
        units = len(controlled)
        partial = fit_similarities(template[robot], positions[robot], unit, units)
        missed = np.abs(partial(template[robot], unit) - positions[robot])
        costs = np.bincount(unit, weights=missed**2, minlength=units) / 2
        return TruthMetrics(
            V=float(costs[partial.exist].sum()),
            V_units=np.where(partial.exist, costs, np.nan),
            scales=np.where(partial.exist, np.abs(partial.factors), np.nan),
            rotations_rad=np.where(partial.exist, np.angle(partial.factors), np.nan),
            conditions=self._judged(np.delete(controlled, list(dead), axis=0)),
            shape=fit_shape(template, positions),
            min_separation_m=_least_separation(positions_m),
        )

    def _judged(self, topology: BoolArray) -> Conditions:
        """TC1-TC5 of a topology; most steps leave it as it was."""
        if not np.array_equal(topology, self._topology):
            self._topology, self._conditions = topology, check_conditions(topology)
        return self._conditions


def _least_separation(positions_m: Array) -> float:
    """Distance of the two robots that are nearest to each other; a robot is the nearest to itself."""
    distances, _ = KDTree(positions_m).query(positions_m, 2)
    return float(np.asarray(distances)[:, 1].min())
