"""A run as arrays over time, the source of figures and summary."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter

import numpy as np

from skyherd.analysis.goal_points import goal_error_m
from skyherd.analysis.shortest_paths import shortest_path
from skyherd.analysis.traffic import Traffic, count_traffic
from skyherd.analysis.tree_snapshot import TreeHistory, TreeSnapshot
from skyherd.control import Template, control_matrix
from skyherd.datasets import Mission, SizeModel
from skyherd.geometry import Array, BoolArray, IntArray, to_complex
from skyherd.loop import Step, UnitFrame
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.sim.truth_metrics import affine_error
from skyherd.sim.world import Fleet

WAYPOINTS = 61
"""Maximum number of positions of each robot in `History.waypoints_m`. Chosen: paths of a minute look as they
do in full, and a study of thousands of runs can keep them."""

FOREIGN_SHARE = 0.1
"""Share of the images from which an id counts as one that is really there. Chosen: false detections change
from image to image."""


@dataclass(frozen=True)
class ImageTrace:
    """Image traces of the robots that one unit controlled.

    Attributes:
        times_s: (K,) times of its images.
        points_px: (K, N) complex image points `u + iv`; NaN for robots that are not seen or not controlled.
    """

    times_s: Array
    points_px: np.ndarray


@dataclass(frozen=True)
class History:
    """A run of T steps with N robots, in ascending order of their ids, and U units.

    Attributes:
        mission: what was run.
        times_s: (T,).
        positions_m: (T, N, 2).
        headings_rad: (T, N).
        v_mps: (T, N) commanded, within the wheels' limits.
        omega_radps: (T, N).
        unit_positions_m: (T, U, 2).
        heights_m: (T, U).
        yaws_rad: (T, U).
        tilts_rad: (T, U, 2) about the cameras' u and v axes.
        zooms: (T, U).
        V: (T,) m².
        V_units: (T, U) m²; NaN for a set that defines no shape.
        scales: (T, U) metres a template unit.
        rotations_rad: (T, U) ground sense.
        goal_errors_m: (T, U) largest ground distance of a desired point from the true one; NaN where a unit
            took no image or set no goals, and where the shape's size is fixed.
        shape_error: (T,).
        shape_scale: (T,) metres a template unit.
        shape_rotation_rad: (T,).
        min_separation_m: (T,).
        roles: (T, N) template row assigned to each robot.
        conditions: (T, 5) True where TC1-TC5 hold.
        controlled: (T, U, N) True where unit j controls a robot: the set S_j^c.
        commanded: (T, N) True where a robot follows a goal received within `robots.timeout_s`.
        trees: the tree of units at each step, None where sets come from the safety radius alone.
        suspected: (T, U) True where a unit suspects its camera and sends nothing.
        traces: image traces by unit.
        frames: images taken.
        whole: markers whose card was whole in an image, over all images.
        found: number of these that were detected.
        false_detections: detections that match no robot.
        foreign_ids: ids of no robot or obstacle that at least `FOREIGN_SHARE` of the images show, ascending.
        traffic: messages to robots and units.
    """

    mission: Mission
    times_s: Array
    positions_m: Array
    headings_rad: Array
    v_mps: Array
    omega_radps: Array
    unit_positions_m: Array
    heights_m: Array
    yaws_rad: Array
    tilts_rad: Array
    zooms: Array
    V: Array
    V_units: Array
    scales: Array
    rotations_rad: Array
    goal_errors_m: Array
    shape_error: Array
    shape_scale: Array
    shape_rotation_rad: Array
    min_separation_m: Array
    roles: IntArray
    conditions: BoolArray
    controlled: BoolArray
    commanded: BoolArray
    trees: list[TreeSnapshot | None]
    suspected: BoolArray
    traces: list[ImageTrace]
    frames: int
    whole: int
    found: int
    false_detections: int
    foreign_ids: list[int]
    traffic: Traffic

    @cached_property
    def affine_error(self) -> Array:
        """Distance (T,) of the formation from the nearest affine image of its shape; see `affine_error`."""
        places, errors = to_complex(self.positions_m), np.empty(len(self.times_s))
        rows_of: dict[bytes, list[int]] = {}
        for row, (time_s, roles) in enumerate(zip(self.times_s.tolist(), self.roles, strict=True)):
            points = self.mission.schedule.at(time_s).points_px[roles]
            rows_of.setdefault(points.tobytes(), []).append(row)
        for rows in rows_of.values():
            shape = self.mission.shape_at(float(self.times_s[rows[0]]), self.roles[rows[0]])
            errors[rows] = affine_error(shape.points_of(self.ids).conj(), places[rows])
        return errors

    @property
    def affine_reached_s(self) -> float:
        """Time, s, since which `affine_error` stayed under `goal.shape_error`.

        NaN if the error was above the goal within the last `goal.hold_s` of the run.
        """
        goal = self.mission.scenario.goal
        above = np.flatnonzero(~(self.affine_error < goal.shape_error))
        since_s = float(np.append(self.times_s, np.inf)[above[-1] + 1 if above.size else 0])
        held = since_s <= self.times_s[-1] - goal.hold_s + TIME_TOLERANCE_S
        return since_s if held else np.nan

    @property
    def min_path_m(self) -> float:
        """Least sum of straight paths, m, from the start into the shape at any pose, size and assignment.

        `shortest_path` computes it without a bound on the size, whatever the mission allows. It is one lower
        bound for all methods that form a similar shape from one start.
        """
        template = self.mission.template.points_of(self.ids).conj()
        return shortest_path(template, to_complex(self.positions_m[0])).length

    @property
    def waypoints_m(self) -> Array:
        """Positions (W, N, 2) at up to `WAYPOINTS` instants from start to end, in whole mm."""
        rows = np.linspace(0, len(self.times_s) - 1, min(WAYPOINTS, len(self.times_s))).round().astype(int)
        return np.asarray(np.round(self.positions_m[rows], 3))

    @property
    def largest_set(self) -> int:
        """Number of robots in the largest control set at the end."""
        return int(self.controlled[-1].sum(axis=1).max(initial=0))

    @property
    def messages_per_robot_s(self) -> float:
        """Messages per robot and second of the run, as `Traffic` counts them; NaN if unknown."""
        return self.traffic.messages / self.ids.size / self._duration_s

    @property
    def numbers_per_robot_s(self) -> float:
        """Numbers in those messages, per robot and second of the run."""
        return self.traffic.numbers / self.ids.size / self._duration_s

    @property
    def _duration_s(self) -> float:
        return len(self.times_s) * self.mission.scenario.step_s

    @property
    def ids(self) -> IntArray:
        """Ids (N,) of the robots, ascending."""
        return self.mission.ids

    @property
    def shape(self) -> Template:
        """The shape at the end, with the template point that each robot has then."""
        return self.mission.shape_at(float(self.times_s[-1]), self.roles[-1])

    def fleet(self, row: int) -> Fleet:
        """Return the state of the units at a step."""
        return Fleet(
            positions_m=self.unit_positions_m[row],
            heights_m=self.heights_m[row],
            yaws_rad=self.yaws_rad[row],
            tilts_rad=self.tilts_rad[row],
            zooms=self.zooms[row],
        )

    @property
    def ready_row(self) -> int | None:
        """First step with a complete tree of units; 0 without a tree, None if it was never complete."""
        if self.mission.scenario.selection.kind != "tree":
            return 0
        return next((row for row, tree in enumerate(self.trees) if tree and tree.ready), None)


_COLUMNS = {
    "times_s": "time_s",
    "positions_m": "positions_m",
    "headings_rad": "headings_rad",
    "v_mps": "command.v_mps",
    "omega_radps": "command.omega_radps",
    "unit_positions_m": "fleet.positions_m",
    "heights_m": "fleet.heights_m",
    "yaws_rad": "fleet.yaws_rad",
    "tilts_rad": "fleet.tilts_rad",
    "zooms": "fleet.zooms",
    "V": "metrics.V",
    "V_units": "metrics.V_units",
    "scales": "metrics.scales",
    "rotations_rad": "metrics.rotations_rad",
    "shape_error": "metrics.shape.error",
    "shape_scale": "metrics.shape.scale",
    "shape_rotation_rad": "metrics.shape.rotation_rad",
    "min_separation_m": "metrics.min_separation_m",
    "roles": "roles",
}
"""Fields of the history that are stacked from the steps, and their location in a step."""

CURVES = (
    *_COLUMNS,
    "goal_errors_m",
    "conditions",
    "controlled",
    "commanded",
    "affine_error",
    "affine_reached_s",
    "min_path_m",
    "largest_set",
    "waypoints_m",
    "messages_per_robot_s",
    "numbers_per_robot_s",
)
"""Names of the history fields that studies can keep: arrays over time, and some numbers."""


def make_history(mission: Mission, steps: Iterable[Step]) -> History:
    """Stack the steps of a run into arrays over time.

    Camera images are dropped step by step, so that a running `run_steps(mission)` needs little memory.

    Args:
        mission: mission of the run.
        steps: at least one step, in the order of time.
    """
    steps = [step.without_images() for step in steps]
    columns = {name: np.array([attrgetter(path)(step) for step in steps]) for name, path in _COLUMNS.items()}
    frames = [frame for step in steps for frame in step.frames.values()]
    conditions = [step.metrics.conditions for step in steps]
    units = range(len(mission.scenario.units))
    return History(
        mission=mission,
        **columns,
        goal_errors_m=_goal_errors(mission, steps),
        conditions=np.array([[c.tc1, c.tc2, c.tc3, c.tc4, c.tc5] for c in conditions]),
        controlled=np.array([control_matrix(step.control_sets, mission.ids) for step in steps]),
        commanded=np.array([np.isin(mission.ids, step.commanded_ids) for step in steps]),
        trees=_trees(mission, steps),
        suspected=np.array([[_suspects(step, unit) for unit in units] for step in steps]),
        traces=[_trace(mission, steps, unit) for unit in units],
        frames=len(frames),
        whole=sum(frame.sight.whole_ids.size for frame in frames),
        found=sum(frame.sight.found_ids.size for frame in frames),
        false_detections=sum(frame.sight.false_detections for frame in frames),
        foreign_ids=_foreign_ids(mission, frames),
        traffic=count_traffic(mission, steps),
    )


def _suspects(step: Step, unit: int) -> bool:
    """Return whether a unit suspects its camera after its image of a step."""
    return unit in step.frames and bool(step.frames[unit].decision.suspicion)


def _trees(mission: Mission, steps: list[Step]) -> list[TreeSnapshot | None]:
    history = TreeHistory()
    return [history.add(step, mission.scenario.dead_units(step.time_s)) for step in steps]


def _foreign_ids(mission: Mission, frames: list[UnitFrame]) -> list[int]:
    """Return the ids in `History.foreign_ids`."""
    counts = Counter(number for frame in frames for number in set(frame.sight.detections.ids.tolist()))
    known = {*mission.ids.tolist(), *mission.obstacle_ids.tolist()}
    least = FOREIGN_SHARE * len(frames)
    return sorted(number for number, count in counts.items() if number not in known and count >= least)


def _goal_errors(mission: Mission, steps: list[Step]) -> Array:
    errors = np.full((len(steps), len(mission.scenario.units)), np.nan)
    if mission.scenario.size != SizeModel():
        return errors
    points = mission.template.points_of(mission.ids).conj()
    for row, step in enumerate(steps):
        for unit, frame in step.frames.items():
            goals = frame.decision.goals
            if goals is None:
                continue
            mine = np.searchsorted(mission.ids, goals.ids)
            template, positions = points[step.roles[mine]], to_complex(step.positions_m[mine])
            camera, pose = mission.cameras_at(step.time_s)[unit], step.fleet.pose(unit)
            errors[row, unit] = goal_error_m(frame, camera, pose, template, positions)
    return errors


def _trace(mission: Mission, steps: list[Step], unit: int) -> ImageTrace:
    seen = [(step.time_s, step.frames[unit]) for step in steps if unit in step.frames]
    points = np.full((len(seen), mission.ids.size), np.nan + 1j * np.nan)
    for row, (_, frame) in enumerate(seen):
        mine = frame.sight.detections.select(frame.decision.report.controlled_ids)
        points[row, np.searchsorted(mission.ids, mine.ids)] = (
            mine.centers_px[:, 0] + 1j * mine.centers_px[:, 1]
        )
    return ImageTrace(np.array([time for time, _ in seen]), points)
