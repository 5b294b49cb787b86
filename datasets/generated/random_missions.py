"""Random missions: a random tree of units, robots below them, and a random shape.

A mission is a scenario as a tree of plain values, for `make_mission`. Its seed alone determines it.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import pdist

from skyherd.control import fit_similarity
from skyherd.datasets.random_streams import RunStream, generator
from skyherd.datasets.shapes.shapes import shape_points
from skyherd.geometry import Array, ComplexArray, to_complex, to_points
from skyherd.messages.checks import check_kind

SIDE_M = 0.2
"""Marker side, m. Chosen: that of a small ground robot. Positions and spacings are multiples of it."""

IN_COMMON = 4
"""Minimum number of robots that two neighbours in the tree both see at the start. Chosen: a pair for their
edge, and two more for the edges of either to other units."""

TRIES = 200
"""Number of random starts tried per seed. Chosen: a seed that fails so often leaves too little room for its
robots."""

PLACE_TRIES = 2000
"""Number of random positions tried for one group of robots. Chosen: a view has room for hundreds."""

SHAPE_TRIES = 5000
"""Number of random points tried for a shape. Chosen: as `PLACE_TRIES`, for up to 64 points."""

WITHIN = 0.85
"""Share of a view's half width within which robots are placed. Chosen: the default safety radius of a
scenario, inside which a unit controls robots."""

BODY_SIDES = 1.0
"""Radius of a robot's body, marker sides. Chosen: a body of two sides holds a marker with its quiet zone."""

LEGIBLE_PX = 20.0
"""Minimum marker side in the images at the start, px. Chosen: 3 px a cell; detection of smaller markers is
less reliable."""


@dataclass(frozen=True)
class Crowd:
    """Size of a random mission.

    Attributes:
        units: number of aerial units.
        robots_a_unit: number of robots per unit; the total is `units * robots_a_unit`.
        form: topology of the tree of units. The parent of each unit is the previous one (`chain`), the first
            one (`star`, with room for at most seven units), or any previous one (`random`).
    """

    units: int
    robots_a_unit: int
    form: Literal["chain", "star", "random"] = "random"


def random_crowd(rng: np.random.Generator, units: tuple[int, int] = (2, 8)) -> Crowd:
    """Draw the size of a mission: a number of units within two bounds, and 4 to 8 robots per unit."""
    check_kind("random_crowd: rng", rng, np.random.Generator, "a numpy.random.Generator")
    count = int(rng.integers(units[0], units[1], endpoint=True))
    return Crowd(units=count, robots_a_unit=int(rng.integers(4, 8, endpoint=True)))


def random_mission(seed: int, crowd: Crowd | None = None) -> dict[str, Any]:
    """Draw a mission as a tree of plain values; without `crowd`, its size is random.

    Cameras differ in focal length, image size, yaw and height. Each robot is in a view. Neighbours in the
    tree have at least `IN_COMMON` robots in common. The shape consists of random points. The best-fitting
    similarity assigns the roles. The fitted shape has spacings of at least two marker sides.

    Raises:
        RuntimeError: no start was found in `TRIES` draws.
    """
    rng = generator(seed, RunStream.RANDOM_MISSION)
    crowd = random_crowd(rng) if crowd is None else crowd
    check_kind("random_mission: crowd", crowd, Crowd, "a Crowd, or None")
    for _ in range(TRIES):
        centers, parents = _tree(rng, crowd)
        cameras = [random_camera(rng) for _ in centers]
        heights = rng.uniform(8.0, 12.0, crowd.units)
        radii = _radii(heights, cameras)
        robots = _robots(rng, crowd, centers=centers, parents=parents, radii_m=WITHIN * radii)
        if robots is None:
            continue
        template = _template(rng, robots)
        if template is not None:
            break
    else:
        raise RuntimeError(f"seed {seed}: no start in {TRIES} tries")
    return make_tree(
        seed,
        rng,
        centers=centers,
        heights_m=heights,
        cameras=cameras,
        robots=robots,
        template=template,
    )


def star_mission(seed: int) -> dict[str, Any]:
    """Draw a mission with a star of 16 robots under three units in a line, as a tree of plain values.

    The units are 5 m apart and 10 m high. The start is random. The best-fitting similarity assigns the roles.
    """
    rng = generator(seed, RunStream.STAR_MISSION)
    robots = None
    while robots is None:
        centers, heights = np.array([-5.0, 0.0, 5.0], dtype=np.complex128), np.full(3, 10.0)
        cameras = [random_camera(rng) for _ in centers]
        radii = _radii(heights, cameras)
        robots = _robots(
            rng, Crowd(3, 5), centers=centers, parents=[-1, 0, 1], radii_m=WITHIN * radii, extra=1
        )
    spread = 1.3 * np.abs(robots - robots.mean()).std() + np.abs(robots - robots.mean()).mean()
    shape = to_complex(shape_points("star", 16)) * spread
    return make_tree(
        seed,
        rng,
        centers=centers,
        heights_m=heights,
        cameras=cameras,
        robots=robots,
        template=_assign(shape, robots),
    )


def _radii(heights_m: Array, cameras: list[dict[str, Any]]) -> Array:
    """Return half the width that each unit sees on the ground, m."""
    return np.asarray(heights_m * np.tan(np.radians([camera["half_angle_deg"] for camera in cameras])))


def make_tree(
    seed: int,
    rng: np.random.Generator,
    *,
    centers: ComplexArray,
    heights_m: Array,
    cameras: list[dict[str, Any]],
    robots: ComplexArray,
    template: ComplexArray,
) -> dict[str, Any]:
    """Make a scenario, as a tree of plain values, from the drawn quantities.

    The image size makes markers at least `LEGIBLE_PX` large at the start. Units keep markers from becoming
    too small. Robots have bodies and avoid each other, because a robot on top of another would hide its
    marker. The same mission therefore runs with projected and with rendered markers.

    Args:
        seed: seed of the mission.
        rng: generator of the units' yaws and the robots' headings.
        centers: (U,) ground points below the units, m, `x + iy`.
        heights_m: (U,) heights of the units.
        cameras: cameras of the units, as `random_camera` returns them.
        robots: (N,) start positions, m, `x + iy`.
        template: (N,) points of the shape, in the robots' order, in any unit.
    """
    units = [
        {
            "position_m": to_points(center).tolist(),
            "height_m": float(height),
            "yaw_deg": float(rng.uniform(-180, 180)),
            "camera": _legible(camera, float(height)),
            "flight": {"kind": "keep-in-view"},
            "frame_rate_hz": 5.0,
        }
        for center, height, camera in zip(centers, heights_m, cameras, strict=True)
    ]
    return {
        "name": f"random-{seed}",
        "seed": seed,
        "duration_s": 600.0 if len(units) <= 5 else 1800.0,
        "step_s": 0.2,
        "perception": "noisy",
        "template": {"points": to_points(template).tolist()},
        "robots": {
            "positions_m": to_points(robots).tolist(),
            "headings_deg": rng.uniform(-180, 180, robots.size).tolist(),
            "max_speed_mps": 0.5,
            "max_turn_radps": 2.0,
            "timeout_s": 0.7,
            "body_radius_sides": BODY_SIDES,
        },
        "avoidance": {"on": True},
        "marker": {"side_m": SIDE_M, "dictionary": "5X5_100"},
        "control": {"k": 0.5, "k_omega": 2.0, "b_th": 0.0, "rectify": False},  # cameras look straight down
        "selection": {"kind": "tree"},
        "autopilot": {"min_height_m": 3.0, "max_height_m": 60.0, "max_speed_mps": 1.0, "max_climb_mps": 1.0},
        "units": units,
    }


def _legible(camera: dict[str, Any], height_m: float) -> dict[str, Any]:
    """Scale a camera's resolution by a whole number, so that markers are at least `LEGIBLE_PX` large."""
    size, (u0, v0) = min(camera["size_px"]), camera["principal_point_px"]
    focal_px = size / 2 / np.tan(np.radians(camera["half_angle_deg"]))
    finer = int(np.ceil(LEGIBLE_PX * height_m / (SIDE_M * focal_px)))
    return camera | {
        "size_px": [finer * side for side in camera["size_px"]],
        "principal_point_px": [finer * (place + 0.5) - 0.5 for place in (u0, v0)],
    }


def _tree(rng: np.random.Generator, crowd: Crowd) -> tuple[ComplexArray, list[int]]:
    """Draw the units' ground points, m, 6 to 8 m from their parents; return the parents as well."""
    centers, parents = [0j], [-1]
    while len(centers) < crowd.units:
        before = {"chain": [len(centers) - 1], "star": [0]}.get(crowd.form, range(len(centers)))
        parent = int(rng.choice(before))
        place = centers[parent] + rng.uniform(6.0, 8.0) * np.exp(2j * np.pi * rng.random())
        if min(abs(place - center) for center in centers) > 5.5:
            centers.append(place)
            parents.append(parent)
    return np.array(centers), parents


def random_camera(rng: np.random.Generator) -> dict[str, Any]:
    """Draw a camera of random size, half angle and principal point, as keys of `CameraModel`."""
    size = int(rng.choice([640, 800, 1000]))
    return {
        "half_angle_deg": float(rng.uniform(28.0, 38.0)),
        "size_px": [size, size],
        "principal_point_px": ((size - 1) / 2 + rng.uniform(-15, 15, 2)).tolist(),
    }


def _robots(
    rng: np.random.Generator,
    crowd: Crowd,
    *,
    centers: ComplexArray,
    parents: list[int],
    radii_m: Array,
    extra: int = 0,
) -> ComplexArray | None:
    """Draw the robots' positions, m, over three sides apart: shared ones first, then around each unit."""
    places: list[complex] = []

    def put(count: int, units: list[int]) -> bool:
        for _ in range(PLACE_TRIES):
            if count == 0:
                return True
            away_m = radii_m[units[0]] * np.sqrt(rng.random())
            at = centers[units[0]] + away_m * np.exp(2j * np.pi * rng.random())
            inside = all(abs(at - centers[unit]) < radii_m[unit] for unit in units)
            if inside and all(abs(at - other) > 3 * SIDE_M for other in places):
                places.append(at)
                count -= 1
        return False

    for unit, parent in enumerate(parents[1:], start=1):
        both = [abs(np.array(places) - centers[u]) < radii_m[u] for u in (unit, parent)] if places else []
        have = int(np.count_nonzero(both[0] & both[1])) if places else 0
        if not put(max(IN_COMMON - have, 0), [unit, parent]):
            return None
    total = crowd.units * crowd.robots_a_unit + extra
    if len(places) > total:
        return None
    placed = all(put(1, [int(rng.integers(crowd.units))]) for _ in range(total - len(places)))
    return np.array(places) if placed else None


def _template(rng: np.random.Generator, robots: ComplexArray) -> ComplexArray | None:
    """Draw a random shape about as large as the start, in the robots' order; return None on failure."""
    spread = np.abs(robots - robots.mean()).max()
    shape: list[complex] = []
    for _ in range(SHAPE_TRIES):
        at = spread * (rng.uniform(-1, 1) + 1j * rng.uniform(-1, 1))
        if all(abs(at - other) > 4 * SIDE_M for other in shape):
            shape.append(at)
        if len(shape) == robots.size:
            break
    else:
        return None
    points = _assign(np.array(shape), robots)
    fitted = fit_similarity(points, robots)(points)
    return points if pdist(to_points(fitted)).min() >= 2 * SIDE_M else None


def _assign(shape: ComplexArray, robots: ComplexArray) -> ComplexArray:
    """Sort a shape's points into the robots' order, alternating assignment and similarity to convergence."""
    placed = shape - shape.mean() + robots.mean()
    order = np.arange(shape.size)
    for _ in range(50):
        _, columns = linear_sum_assignment(np.abs(robots[:, None] - placed[None, :]) ** 2)
        if np.array_equal(columns, order):
            break
        order = columns
        placed = fit_similarity(shape[order], robots)(shape)
    return shape[order]
