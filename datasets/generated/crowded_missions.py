"""Random crowded missions: bodies close together, and a random assignment of robots to template points."""

from typing import Any

import numpy as np
from scipy.spatial.distance import cdist

from skyherd.datasets.generated.random_missions import (
    BODY_SIDES,
    IN_COMMON,
    SIDE_M,
    TRIES,
    WITHIN,
    make_tree,
    random_camera,
)
from skyherd.datasets.random_streams import RunStream, generator
from skyherd.geometry import Array, BoolArray, ComplexArray, to_points

START_SPACING = 2.5
"""Minimum distance between two robots' centres at the start, marker sides. Chosen: a gap of half a side
between bodies."""

SHAPE_SPACING = 3.0
"""Minimum distance between two robots' centres in the finished shape, marker sides. Chosen: a gap of one
side between bodies."""

MIN_HEIGHT_M = 3.0
"""Minimum height of a unit, m. Derived: the autopilot's minimum in `make_tree`."""

VIEW_TRIES = 100
"""Number of random unit positions tried for one start. Chosen: a new start is drawn after a failure."""


def crowded_mission(seed: int, units: int | None = None) -> dict[str, Any]:
    """Draw a crowded mission as a tree of plain values; without `units`, their number is random.

    A mission has 6 to 40 robots. Their bodies cover 3 to 12 % of the disk in which they start. Each robot is
    in the view of one of 1 to 5 units. Pairs of units that see `IN_COMMON` robots in common form a connected
    graph. The template points are random, in random order.

    Raises:
        RuntimeError: no start was found in `TRIES` draws.
    """
    rng = generator(seed, RunStream.CROWDED_MISSION)
    for _ in range(TRIES):
        count = int(rng.integers(6, 40, endpoint=True))
        agents = units or int(rng.integers(1, min(5, count // 4), endpoint=True))
        cover = float(rng.uniform(0.03, 0.12))
        radius_m = np.sqrt(count / cover) * BODY_SIDES * SIDE_M
        robots = _scatter(rng, count, radius=radius_m, spacing=START_SPACING * SIDE_M)
        views = _views(rng, agents, radius_m=radius_m, robots=robots)
        shape = _scatter(rng, count, radius=1.0, spacing=1.1 / np.sqrt(count))
        if robots is not None and views is not None and shape is not None:
            break
    else:
        raise RuntimeError(f"seed {seed}: no start in {TRIES} tries")
    centers, view_m = views
    cameras = [random_camera(rng) for _ in centers]
    half = np.tan(np.radians([camera["half_angle_deg"] for camera in cameras]))
    tree = make_tree(
        seed,
        rng,
        centers=centers,
        heights_m=np.maximum(view_m / half, MIN_HEIGHT_M),
        cameras=cameras,
        robots=robots,
        template=shape,
    )
    tree["name"] = f"crowded-{seed}"
    tree["roles"] = {"exchange": True}
    tree["size"] = {"min_spacing_sides": SHAPE_SPACING}
    return tree


def _scatter(rng: np.random.Generator, count: int, *, radius: float, spacing: float) -> ComplexArray | None:
    """Draw points in a disk, no two nearer than `spacing`; return None if there is no room."""
    placed: list[complex] = []
    for _ in range(200 * count):
        at = radius * np.sqrt(rng.random()) * np.exp(2j * np.pi * rng.random())
        if all(abs(at - other) >= spacing for other in placed):
            placed.append(at)
        if len(placed) == count:
            return np.array(placed)
    return None


def _views(
    rng: np.random.Generator, units: int, *, radius_m: float, robots: ComplexArray | None
) -> tuple[ComplexArray, Array] | None:
    """Draw ground points of the units and half the widths of their views, m; return None on failure.

    Every robot is in some view, and views that share `IN_COMMON` robots connect all units.
    """
    if robots is None:
        return None
    view_m = radius_m * (1.15 if units == 1 else 1.25 / np.sqrt(units) + 0.15)
    for _ in range(VIEW_TRIES):
        spread = 0.0 if units == 1 else 0.75 * radius_m
        centers = spread * np.sqrt(rng.random(units)) * np.exp(2j * np.pi * rng.random(units))
        seen = cdist(to_points(centers), to_points(robots)) < WITHIN * view_m
        if seen.any(axis=0).all() and _connected(seen.astype(int) @ seen.T.astype(int) >= IN_COMMON):
            return centers, np.full(units, view_m)
    return None


def _connected(neighbors: BoolArray) -> bool:
    """Return True if the graph of this adjacency matrix is connected."""
    reached = np.linalg.matrix_power(neighbors.astype(float) + np.eye(len(neighbors)), len(neighbors))
    return bool((reached > 0).all())
