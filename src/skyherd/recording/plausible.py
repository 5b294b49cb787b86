"""Plausibility checks of a recording: its mission, and its steps against that mission.

Data with a valid checksum are as written, but possibly by another version or another program. All readers of
steps rely on these checks: array lengths, existing units and robots, finite numbers.
"""

from dataclasses import fields
from typing import Any

import numpy as np

from skyherd.control import GroundMap, Template
from skyherd.datasets import Mission, Scenario, check_tree
from skyherd.geometry import ComplexArray, IntArray, to_complex
from skyherd.loop import Step, UnitFrame
from skyherd.messages import Detections
from skyherd.sim.truth_metrics import ShapeFit

MAX_MAGNITUDE = 1e9
"""Maximum magnitude of a number in a recording, in any unit. Chosen: far above the limits of scenario files;
its square does not overflow."""


UNKNOWNS = GroundMap().unknowns.size
"""Number of parameters of a ground map."""

MAX_UNKNOWN = 1e3
"""Maximum magnitude of a ground map's parameter. Chosen: those of real lenses stay below 10."""


def read_mission(record: dict[str, Any]) -> Mission:
    """Read the mission from its record.

    Raises:
        ValueError, TypeError, KeyError: the record is not of this version.
    """
    scenario = check_tree(Scenario, record["scenario"], "scenario", see="skyherd scenario schema")
    ids = np.array(record["ids"], dtype=np.int64)
    mission = Mission(
        scenario=scenario,
        template=Template(record["template_ids"], _points(record["template_px"])),
        ids=ids,
        positions_m=np.array(record["positions_m"], dtype=float),
        headings_rad=np.array(record["headings_rad"], dtype=float),
        later=tuple(
            (float(later["at_s"]), Template(record["template_ids"], _points(later["template_px"])))
            for later in record["later"]
        ),
    )
    _require(ids.ndim == 1 and bool((np.diff(ids) > 0).all()), "ids must ascend")
    _require(np.array_equal(ids, mission.template.ids), "the template must have a point for each robot")
    _require_floats(mission.positions_m, (ids.size, 2), "positions_m")
    _require_floats(mission.headings_rad, (ids.size,), "headings_rad")
    times_s = [0.0, *(at_s for at_s, _ in mission.later)]
    _require(bool(np.isfinite(times_s).all() and (np.diff(times_s) > 0).all()), "later: times must ascend")
    return mission


def check_step(step: Step, mission: Mission) -> None:
    """Check a step of a recording against its mission.

    Raises:
        ValueError: a length, a unit or a robot does not match the mission, or a number is not finite.
    """
    robots, units = mission.ids.size, len(mission.scenario.units)
    _require_floats(step.positions_m, (robots, 2), "positions_m")
    _require_floats(step.headings_rad, (robots,), "headings_rad")
    _require(np.array_equal(step.command.ids, mission.ids), "command: ids must be the robots'")
    _require(_are_among(step.commanded_ids, mission.ids), "commanded_ids must be robots'")
    _require(np.array_equal(np.sort(step.roles), np.arange(robots)), "roles must be a permutation")
    _require(set(step.control_sets) == set(range(units)), "control_sets must be of all units")
    for ids in step.control_sets.values():
        _require(ids.ndim == 1 and _are_among(ids, mission.ids), "control_sets must be of robots")
    fleet = step.fleet
    for name, shape in (
        ("positions_m", (2,)),
        ("heights_m", ()),
        ("yaws_rad", ()),
        ("tilts_rad", (2,)),
        ("zooms", ()),
    ):
        _require_floats(getattr(fleet, name), (units, *shape), f"fleet.{name}")
    _require(bool((fleet.zooms > 0).all() and (fleet.heights_m > 0).all()), "fleet: heights, zooms above 0")
    for intervention in step.interventions:
        problems = list(mission.scenario_at(step.time_s).intervention_problems(intervention))
        _require(not problems, f"interventions: {problems}")
    _check_metrics(step, units)
    for unit, frame in step.frames.items():
        _require(0 <= unit < units, f"no unit {unit}")
        _check_frame(unit, frame, mission)


def check_map(ground_map: GroundMap) -> None:
    """Check a unit's ground map, by which its detections are rectified.

    Raises:
        ValueError: a number is missing or not finite, or pixels are degenerate.
    """
    _require_floats(ground_map.unknowns, (UNKNOWNS,), "map: unknowns")
    _require_floats(ground_map.covariance, (UNKNOWNS, UNKNOWNS), "map: covariance")
    within = np.abs(ground_map.unknowns).max() < MAX_UNKNOWN
    _require(within and np.hypot(*ground_map.unknowns[:2]) < 1, "map: parameters beyond any camera's")


def check_places(detections: Detections) -> None:
    """Check the positions of detected markers before they are used.

    Raises:
        ValueError: a coordinate is beyond any image.
    """
    for name in ("centers_px", "corners_px", "sides_px"):
        _require(bool((np.abs(getattr(detections, name)) < MAX_MAGNITUDE).all()), f"detections: {name}")


def _check_metrics(step: Step, units: int) -> None:
    metrics = step.metrics
    for name in ("V_units", "scales", "rotations_rad"):
        _require_floats(getattr(metrics, name), (units,), f"metrics.{name}", nan=True)
    numbers = [metrics.V, metrics.min_separation_m]
    numbers += [getattr(metrics.shape, field.name) for field in fields(ShapeFit)]
    _require_floats(np.array(numbers, dtype=float), (len(numbers),), "metrics")
    flags = vars(metrics.conditions).values()
    _require(all(isinstance(flag, bool) for flag in flags), "metrics.conditions must be true or false")


def _check_frame(unit: int, frame: UnitFrame, mission: Mission) -> None:
    sight, decision = frame.sight, frame.decision
    known = np.concatenate([mission.ids, mission.obstacle_ids])
    size = mission.scenario.units[unit].camera.size_px
    report = decision.report
    _require(tuple(sight.detections.image_size_px) == size, "detections: the camera's image size")
    _require(_are_among(report.controlled_ids, mission.ids), "report: controlled_ids must be robots'")
    _require(_are_among(sight.whole_ids, known), "truth: whole_ids must be of markers")
    _require(_are_among(sight.found_ids, sight.whole_ids), "truth: found_ids must be of whole_ids")
    _require(_is_count(sight.false_detections), "truth: false_detections")
    for name, goals in (("goals", decision.goals), ("turns", decision.turns)):
        if goals is not None:
            seen = _are_among(goals.ids, decision.detections.ids) and _are_among(goals.ids, mission.ids)
            _require(seen, f"{name}: ids must be of robots that were seen")
    if report.roles is not None:
        _require(report.roles.roles.size == mission.ids.size, "roles must be of all robots")
    if report.tree is not None:
        neighbors = report.tree.neighbor_ids
        limit = len(mission.scenario.units)
        _require(bool(((neighbors >= 0) & (neighbors < limit)).all()), "tree: neighbor_ids must be units")
    if sight.image is not None:
        _require(sight.image.shape == size[::-1], "image: of the camera's size")


def _are_among(ids: IntArray, known: IntArray) -> bool:
    """Return whether all ids are known. For so few ids, sets are ten times as fast as `numpy.isin`."""
    return set(ids.ravel().tolist()) <= set(known.tolist())


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < MAX_MAGNITUDE


def _points(pairs: Any) -> ComplexArray:
    points = np.array(pairs, dtype=float)
    _require_floats(points, (len(points), 2), "template_px")
    return to_complex(points)


def _require_floats(array: Any, shape: tuple[int, ...], name: str, *, nan: bool = False) -> None:
    """Check shape and values of a float array; `nan` allows unknown values."""
    _require(isinstance(array, np.ndarray) and array.shape == shape, f"{name}: expected shape {shape}")
    numbers = array[~np.isnan(array)] if nan else array
    _require(bool((np.abs(numbers) < MAX_MAGNITUDE).all()), f"{name}: a number is not finite")


def _require(holds: Any, what: str) -> None:
    if not holds:
        raise ValueError(what)
