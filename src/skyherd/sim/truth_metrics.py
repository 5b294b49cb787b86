"""Ground-truth metrics: the cost V, the topological conditions, and the quality of the shape.

They serve plots, summaries and tests, and are not available to `skyherd.control`.

The conditions TC1-TC5 use the control sets that the units declared in their last reports, whether or not the
robots received goals. The time without a goal is a separate metric, `uncommanded_robot_s` in the summary
(`skyherd.analysis.summary`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import pdist

from skyherd.control import (
    Conditions,
    ControlSets,
    Template,
    check_conditions,
    control_matrix,
    fit_similarities,
    fit_similarity,
)
from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray, to_complex


@dataclass(frozen=True)
class ShapeFit:
    """Best-fitting similarity from the template to a formation on the ground.

    Attributes:
        error: RMS distance of the robots to the fitted template over the RMS radius of the formation.
        scale: metres per template unit.
        rotation_rad: rotation of the template, counter-clockwise seen from above.
        squares_m2: sum of squared distances to the fitted template.
    """

    error: float
    scale: float
    rotation_rad: float
    squares_m2: float


def fit_shape(template_ground: np.ndarray, positions: np.ndarray) -> ShapeFit:
    """Fit a template to a formation.

    Args:
        template_ground: (N,) template points, complex, x right and y up.
        positions: (N,) positions of the robots, complex, m.

    Raises:
        DegenerateSetError: the points define no similarity.
    """
    similarity = fit_similarity(template_ground, positions)
    squares = float((np.abs(similarity(template_ground) - positions) ** 2).sum())
    spread = float((np.abs(positions - similarity.target) ** 2).sum())
    return ShapeFit(
        error=math.sqrt(squares / spread),
        scale=similarity.scale,
        rotation_rad=similarity.rotation_rad,
        squares_m2=squares,
    )


def affine_error(template_ground: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return the relative distance of formations from the nearest affine image of their template.

    It is the RMS distance of the robots to that image over the RMS radius of the formation. It never exceeds
    `ShapeFit.error`, the same for similar images. For the matrix A with columns `1, Re p, Im p`, the images
    are the range of A, and the residual is `z - A A⁺ z`.

    Args:
        template_ground: (N,) template points p, complex.
        positions: (..., N) positions z of the robots, complex, m, of one or more formations.

    Returns:
        (...) one number per formation.
    """
    columns = np.stack([np.ones(template_ground.size), template_ground.real, template_ground.imag], axis=1)
    residual = positions - positions @ (columns @ np.linalg.pinv(columns)).T
    spread = positions - positions.mean(axis=-1, keepdims=True)
    return np.asarray(np.linalg.norm(residual, axis=-1) / np.linalg.norm(spread, axis=-1))


@dataclass(frozen=True)
class TruthMetrics:
    """Ground-truth metrics of a mission at one instant.

    Attributes:
        V: the cost function, m² (paper, eq. 9).
        V_units: (U,) each unit's term `V^j = 1/2 Σ_i |x_i^{d,j} - x_i|²`, m²; NaN for a set of robots that
            defines no similarity.
        scales: (U,) metres per template unit, of each unit's partial formation.
        rotations_rad: (U,) rotations of the partial formations, counter-clockwise seen from above.
        conditions: the topological conditions TC1 to TC5 (paper, Section II).
        shape: the fit of the whole formation.
        min_separation_m: minimum distance between the centres of two robots.
    """

    V: float
    V_units: Array
    scales: Array
    rotations_rad: Array
    conditions: Conditions
    shape: ShapeFit
    min_separation_m: float


def _fit_parts(
    template: ComplexArray, positions: ComplexArray, controlled: BoolArray
) -> tuple[ComplexArray, Array]:
    """Return the factors (U,) of the units' similarities, and V^j (U,), m²; both NaN without a similarity."""
    unit, robot = np.nonzero(controlled)
    units = len(controlled)
    partial = fit_similarities(template[robot], positions[robot], group=unit, groups=units)
    missed = np.abs(partial(template[robot], unit) - positions[robot])
    costs = np.bincount(unit, weights=missed**2, minlength=units) / 2
    factors: ComplexArray = np.where(partial.exist, partial.factors, np.nan)
    return factors, np.where(partial.exist, costs, np.nan)


def total_cost(template: ComplexArray, positions: ComplexArray, controlled: BoolArray) -> float:
    """Return V, m² (paper, eq. 9), for any positions and topology, as in `TruthMetrics.V`.

    Args:
        template: (N,) template points, complex, x right and y up.
        positions: (N,) positions of the robots, complex, m.
        controlled: (U, N) mask of the robots that each unit controls.
    """
    return _summed(_fit_parts(template, positions, controlled)[1])


def _summed(costs: Array) -> float:
    """Return the sum of the costs (U,) without NaN, in the order of the units."""
    return float(costs[~np.isnan(costs)].sum())


class TruthObserver:
    """Observer that computes the metrics of one team at each instant.

    Args:
        template: the shape at the start.
        ids: (N,) robots of the team, ascending.
    """

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
        """Return the metrics of robots at given positions under a given topology.

        Args:
            positions_m: (N, 2) positions on the ground.
            sets: S_j^c, the robots that each unit controls.
            dead: failed units, which TC1 to TC5 exclude.
            shape: the shape at this time, with the points in the order of the roles; the template if None.
        """
        template = self.template_ground if shape is None else shape.points_of(self.ids).conj()
        positions = to_complex(positions_m)
        controlled = control_matrix(sets, self.ids)
        factors, costs = _fit_parts(template, positions, controlled)
        return TruthMetrics(
            V=_summed(costs),
            V_units=costs,
            scales=np.abs(factors),
            rotations_rad=np.angle(factors),
            conditions=self._checked(np.delete(controlled, list(dead), axis=0)),
            shape=fit_shape(template, positions),
            min_separation_m=_min_separation_m(positions_m),
        )

    def _checked(self, topology: BoolArray) -> Conditions:
        """Return TC1 to TC5 of a topology (U, N), computed only after a change."""
        if not np.array_equal(topology, self._topology):
            self._topology, self._conditions = topology, check_conditions(topology)
        return self._conditions


def _min_separation_m(positions_m: Array) -> float:
    """Return the minimum distance between two of the positions (N, 2)."""
    return float(pdist(positions_m).min(initial=np.inf))
