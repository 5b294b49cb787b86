"""Mean-shift law: robots without roles fill the shape, each drawn to the free places near it."""

import numpy as np

from skyherd.geometry import Array, BoolArray, ComplexArray
from skyherd.sim.baseline_laws.graphs import MIN_DISTANCE_M, Law

RANGE_SPACINGS = 2.0
"""Radius within which free places attract a robot, in the smallest distances of two places. Chosen: it
contains the neighbouring places, as the sensing range of the paper does."""

AVOID_SPACINGS = 0.8
"""Distance of two robots below which they repel each other, in the same unit. Chosen: they do not at their
places."""


def mean_shift_law(shape: ComplexArray, gain_ps: float) -> Law:
    """Return a mean-shift law: `u_i = k Σ φ (q - z_i) / Σ φ` over the free places q, plus repulsion.

    After Sun and others (Sun 2023), simplified. The cells of the shape are its N points. All robots
    know its place, rotation and size, which they negotiate in the paper; its place is that of the robots'
    centroid. A place is occupied if another robot is within half a spacing of it and nearer to it. The
    weights are `φ(d) = 1 + cos(π d / r)` up to the range r. A robot without a free place in range goes to the
    nearest free one. No robot has a place of its own.

    Args:
        shape: (N,) points of the desired shape, m.
        gain_ps: rate k, 1/s.
    """
    places = shape - shape.mean()
    apart = np.abs(places[:, None] - places)
    np.fill_diagonal(apart, np.inf)
    spacing = float(apart.min())
    reach, avoid = RANGE_SPACINGS * spacing, AVOID_SPACINGS * spacing

    def law(positions: ComplexArray) -> ComplexArray:
        offsets = places + positions.mean() - positions[:, None]
        distances = np.abs(offsets)
        free = ~_occupied(distances, spacing / 2)
        weights = np.where(free & (distances < reach), 1 + np.cos(np.pi * distances / reach), 0.0)
        nearest = np.argmin(np.where(free, distances, np.inf), axis=1)
        alone = ~weights.any(axis=1)
        weights[alone, nearest[alone]] = 1.0
        drawn = (weights * offsets).sum(axis=1) / weights.sum(axis=1)
        return np.asarray(gain_ps * (drawn + _repulsion(positions, avoid)))

    return law


def _occupied(distances: Array, within: float) -> BoolArray:
    """Return whether place q is occupied for robot i (N, N): its nearest robot is another one, and near."""
    nearest = np.argmin(distances, axis=0)
    is_held = distances.min(axis=0) < within
    return np.asarray(is_held & (np.arange(len(distances))[:, None] != nearest))


def _repulsion(positions: ComplexArray, avoid: float) -> ComplexArray:
    """Return `Σ (a / d - 1) (z_i - z_j)` (N,) over robots nearer than a."""
    away = positions[:, None] - positions
    distances = np.maximum(np.abs(away), MIN_DISTANCE_M)
    return np.asarray((np.maximum(avoid / distances - 1, 0.0) * away).sum(axis=1))
