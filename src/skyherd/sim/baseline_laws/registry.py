"""Laws by the names of `control.method`, the data that each needs, and user-defined laws."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from skyherd.datasets import OWN_METHOD
from skyherd.geometry import ComplexArray, IntArray
from skyherd.plugins import import_factory
from skyherd.sim.baseline_laws.affine import affine_modules_law, affine_stress_law
from skyherd.sim.baseline_laws.angles_and_ratios import angle_law, distance_ratio_law
from skyherd.sim.baseline_laws.bearings import bearing_only_law, bearings_with_ranges_law
from skyherd.sim.baseline_laws.distances import distance_law
from skyherd.sim.baseline_laws.graphs import Law, both_ways, modules, neighbors, within
from skyherd.sim.baseline_laws.laplacians import (
    complex_laplacian_law,
    complex_maneuver_law,
    follower_links,
    matrix_weighted_law,
)
from skyherd.sim.baseline_laws.mean_shift import mean_shift_law


@dataclass(frozen=True)
class BaselineLaw:
    """Law from the literature.

    Attributes:
        make: function from the shape on the ground, (N,) complex, and the rate k, 1/s, to the law. The shape
            is in metres if the scenario gives `size.unit_m`, and in template units otherwise.
        links: function from the shape to links (L, 2): a robot, and another that it must know at every
            instant. None for a user-defined law, whose links are unknown.
        numbers: how many numbers a robot needs per link at every instant.
        needs_size: True if the law needs the size of the shape.
        has_free_roles: True if robots have no places of their own in the shape.
        move: function from the shape and the velocities of its points, (N,) complex, to a law that is added
            and moves the shape. None if the law is for shapes at rest.
    """

    make: Callable[[ComplexArray, float], Law]
    links: Callable[[ComplexArray], IntArray] | None = None
    numbers: int = 0
    needs_size: bool = False
    has_free_roles: bool = False
    move: Callable[[ComplexArray, ComplexArray], Law] | None = None


def _between_neighbors(shape: ComplexArray) -> IntArray:
    return both_ways(neighbors(shape))


def _within_modules(shape: ComplexArray) -> IntArray:
    return within(modules(shape))


def _between_all(shape: ComplexArray) -> IntArray:
    return within(np.arange(shape.size)[None])


LAWS: Mapping[str, BaselineLaw] = {
    "complex-laplacian": BaselineLaw(complex_laplacian_law, _between_neighbors, 2, move=complex_maneuver_law),
    "matrix-weighted": BaselineLaw(matrix_weighted_law, follower_links, 2),
    "affine-modules": BaselineLaw(affine_modules_law, _within_modules, 2),
    "affine-stress": BaselineLaw(affine_stress_law, _within_modules, 2),
    "bearing-only": BaselineLaw(bearing_only_law, _between_neighbors, 1),
    "bearings-with-ranges": BaselineLaw(bearings_with_ranges_law, _between_neighbors, 2),
    "distances": BaselineLaw(distance_law, _between_neighbors, 2, needs_size=True),
    "angles": BaselineLaw(angle_law, _between_neighbors, 2),
    "distance-ratios": BaselineLaw(distance_ratio_law, _between_neighbors, 3),
    "mean-shift": BaselineLaw(mean_shift_law, _between_all, 2, needs_size=True, has_free_roles=True),
}
"""Laws from the literature by the names of `control.method`: all `skyherd.datasets.METHODS` except the first,
which is skyherd's own."""


def find_law(method: str) -> BaselineLaw:
    """Return the law of a `control.method`: one of `LAWS`, or a user-defined one as `module:factory`.

    Raises:
        InputError: the factory cannot be imported.
    """
    if OWN_METHOD not in method:
        return LAWS[method]
    allowed = "a function from the shape and the rate to a law, which takes positions to velocities"
    return BaselineLaw(import_factory(method, f"control.method {method}", allowed))
