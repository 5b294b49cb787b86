"""Start of a team: as given, or scattered at random with room for every body."""

from typing import Literal

import numpy as np

from skyherd.control import Template, assign, best_assignment
from skyherd.datasets.configuration.bodies import Bodies
from skyherd.datasets.configuration.models import Scenario
from skyherd.datasets.configuration.robot_models import RobotsModel, ScatterModel
from skyherd.errors import InputError
from skyherd.geometry import Array, IntArray, to_complex, to_points

SCATTER_TRIES = 2000
"""Number of random positions tried for each robot. Chosen: takes a fraction of a second, and fails only for
starts with almost no room."""

START_ROTATIONS = 24
"""Start rotations of the search for roles. Chosen: as in `skyherd.control.RoleRule`."""

ROUNDING_M = 1e-9
"""Overlap below which two bodies only touch, m. Chosen: far above the rounding of coordinates, 1e-13 m, and
far below any body."""


def start_positions(scenario: Scenario, ids: IntArray, template: Template, rng: np.random.Generator) -> Array:
    """Return the start positions (N, 2), m, of the robots `ids` (N,), in their order.

    Raises:
        InputError: the file does not give exactly one start, two bodies overlap in it, or a random start has
            no room.
    """
    robots, bodies = scenario.robots, scenario.make_bodies()
    if (robots.positions_m is None) == (robots.scatter is None):
        raise InputError("robots", "needs a start", "exactly one of positions_m and scatter")
    if robots.scatter is not None:
        return _scatter(robots.scatter, template.points_of(ids).conj(), bodies, rng)
    positions = np.array(robots.positions_m, dtype=float)
    if (pair := coincident(positions, ROUNDING_M)) is not None:
        raise InputError(
            "robots.positions_m",
            f"robots {ids[pair[0]]} and {ids[pair[1]]} are on one spot, {positions[pair[0]].tolist()}",
            "each robot its own place",
        )
    _check_room(scenario, bodies, ids, positions)
    return positions


def with_assigned_roles(
    template: Template, ids: IntArray, positions_m: Array, assigned: Literal["similar", "parallel"]
) -> Template:
    """Return the template with its points exchanged, so that the shape is nearest to the robots.

    Args:
        template: the shape.
        ids: (N,) the robots.
        positions_m: (N, 2) their positions.
        assigned: `similar` to compare all copies of the shape, `parallel` for those without rotation.
    """
    robots, points = to_complex(positions_m), template.points_of(ids).conj()
    alike = np.zeros(ids.size, dtype=np.int64)
    if assigned == "similar":
        order = best_assignment(robots, points, alike, starts=START_ROTATIONS)
    else:
        order = assign(robots - robots.mean(), points - points.mean(), 1.0, classes=alike)
    return Template.from_ground_points(ids, to_points(points[order]))


def start_headings(robots: RobotsModel, count: int, rng: np.random.Generator) -> Array:
    """Return the headings (N,) at the start, rad, counter-clockwise from +x; random by default.

    Raises:
        InputError: the number of headings differs from the number of robots.
    """
    if robots.headings_deg is None:
        return rng.uniform(-np.pi, np.pi, size=count)
    if len(robots.headings_deg) != count:
        raise InputError(
            "robots.headings_deg", f"{len(robots.headings_deg)} headings for {count} robots", "one for each"
        )
    return np.radians(robots.headings_deg)


def coincident(points: Array, distance: float) -> tuple[int, int] | None:
    """Return the indices of the first two points (N, 2) within a distance of each other, or None."""
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    first, second = np.nonzero(np.triu(distances <= distance, 1))
    return (int(first[0]), int(second[0])) if first.size else None


def _check_room(scenario: Scenario, bodies: Bodies, ids: IntArray, positions: Array) -> None:
    pairs = bodies.overlapping(positions, ROUNDING_M)
    if not pairs.size:
        return
    first, second = pairs[0].tolist()
    if second < ids.size:
        other, place, reach_m = f"robot {ids[second]}", positions[second], 2 * bodies.radius_m
    else:
        row = second - ids.size
        other, place = f"obstacle {scenario.obstacles_by_id[row].id}", bodies.obstacles_m[row]
        reach_m = bodies.radius_m + float(bodies.obstacle_radii_m[row])
    apart_m = float(np.linalg.norm(place - positions[first]))
    raise InputError(
        "robots.positions_m",
        f"robot {ids[first]} overlaps {other}, {apart_m:.2g} m away",
        f"at least {reach_m:.3g} m between their centres, or smaller bodies",
    )


def _scatter(model: ScatterModel, points: np.ndarray, bodies: Bodies, rng: np.random.Generator) -> Array:
    """Draw positions one by one; keep each that has room between earlier ones and obstacles."""
    turned = (points - points.mean()) * model.scale_m * np.exp(1j * np.radians(model.rotation_deg))
    home = np.column_stack([turned.real, turned.imag]) + model.center_m
    spacing_m, clear_m = max(model.spacing_m, 2 * bodies.radius_m), bodies.radius_m + bodies.obstacle_radii_m
    placed = np.zeros((0, 2))
    for place in home:
        for _ in range(SCATTER_TRIES):
            at = place + rng.uniform(-model.jitter_m, model.jitter_m, size=2)
            near = (np.linalg.norm(placed - at, axis=1) < spacing_m).any()
            if not near and not (np.linalg.norm(bodies.obstacles_m - at, axis=1) < clear_m).any():
                break
        else:
            raise InputError(
                "robots.scatter",
                f"no room for {len(home)} robots",
                "a smaller spacing_m, a larger scale_m, or smaller bodies",
            )
        placed = np.vstack([placed, at])
    return placed
