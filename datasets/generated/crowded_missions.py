"""Random crowded missions: bodies close together, every robot with any place of the shape."""

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
from skyherd.geometry import Array, BoolArray, ComplexArray, to_points
from skyherd.random_streams import RunStream, generator

START_SPACING = 2.5
"""Least distance between two robots' centres at the start, marker sides. *Chosen*: half a side of room
between bodies."""

SHAPE_SPACING = 3.0
"""Least distance between two robots' centres in the finished shape, marker sides. *Chosen*: a side of room
between bodies."""

MIN_HEIGHT_M = 3.0
"""Least height of a unit, m. *Derived*: the autopilot's in `make_tree`."""

VIEW_TRIES = 100
"""Random places of the units tried for a start. *Chosen*: another start is drawn where these fail."""


def crowded_mission(seed: int, units: int | None = None) -> dict[str, Any]:
    """Draw a crowded mission, a tree of plain values; the number of units is random if not given.

    6 to 40 robots, whose bodies cover 3 to 12 % of the disk that they stand in; 1 to 5 units whose views
    cover it, each with IN_COMMON robots in common with another; places of a random shape given at random.

    Raises:
        RuntimeError: no start was found, however often one was drawn.
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
    """Points in a disk, no two nearer than `spacing`; None if there is no room."""
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
    """Places of the units and half the widths of their views, m: all robots seen, and enough in common."""
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
    """Whether the graph of this adjacency matrix hangs together."""
    reached = np.linalg.matrix_power(neighbors.astype(float) + np.eye(len(neighbors)), len(neighbors))
    return bool((reached > 0).all())
