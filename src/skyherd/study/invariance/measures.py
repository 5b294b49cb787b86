"""Measurements of a study of cameras, sweep by sweep, and geometric predictions.

The control law does not depend on the camera as long as the image is a similarity of the ground (Property 1:
square pixels, no distortion, a vertical optical axis). A study of cameras tests that. It also shows the loss
outside this class, and the share of it that rectification recovers. Each sweep changes one parameter of the
camera; robots, start and gains are the same in all runs.

Three numbers are measured for each run. Lengths are divided by the side of a marker. x are the robots'
positions, x^d the desired points, and x* the positions in the reference run, where an ideal camera gives
exact detections:

    goals   max |x^d - x^d of the truth|    over robots and images (`goal_error_m` of the run's summary)
    paths   max |x - x*|                    over robots and time
    shape   the final shape error

The same numbers are predicted without a run (`predict`). The template is fitted to the first image of the
camera as if the camera were ideal. The fitted points are projected to the ground through the true camera.
Their distance from the template fitted on the ground is the predicted error of the goals. Their own deviation
from the shape is the predicted shape error.

`plots.py` draws both, and `page.py` tabulates them. `skyherd.analysis.goal_points` computes the
`goal_error_m` of a run, since that needs the true camera and the true positions.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from skyherd.analysis.goal_points import desired_on_ground
from skyherd.datasets import Mission
from skyherd.errors import InputError
from skyherd.geometry import Array, apply_homography, inverse, to_complex, to_points
from skyherd.messages import VelocityCommand
from skyherd.render import homography_image_ground, project, undistort
from skyherd.sim.physics import make_world
from skyherd.sim.truth_metrics import fit_shape
from skyherd.study.parts import SweepModel
from skyherd.study.plan import Plan
from skyherd.study.spec import CURVE, REFERENCE, RUN_KEYS
from skyherd.study.store import ERROR
from skyherd.study.table import SWEEP

IDEAL, NOISY, RENDERED = "ideal", "noisy", "rendered"
"""Kinds of perception of a scenario: exact projection, the same with detector noise, and rendered images."""

INSTANTS = 25
"""Number of evenly spaced instants of a run at which a moving camera is predicted. Chosen: more instants
approximate the maximum better, in proportional time."""

CAMERA = "units.0.camera"
"""Key of the camera in the scenario of these studies."""

PROPERTY_1 = frozenset(
    {
        "units.0.height_m",
        "units.0.yaw_deg",
        "units.0.position_m.0",
        "units.0.position_m.1",
        "units.0.zoom.1.1",
        *(f"{CAMERA}.{name}" for name in ("focal_px", "half_angle_deg", "size_px.0", "size_px.1")),
        *(f"{CAMERA}.principal_point_px.{axis}" for axis in (0, 1)),
    }
)
"""Keys whose values keep a camera in Property 1's class, as long as no other key leaves it."""

LABELS: Mapping[str, str] = {
    "units.0.height_m": "height (m)",
    "units.0.yaw_deg": "yaw (deg)",
    "units.0.position_m.0": "place along x (m)",
    "units.0.zoom.1.1": "zoom at the end of a ramp of 4 s",
    "units.0.tilt_deg.0": "tilt (deg)",
    "units.0.sway.tilt_deg": "sway, RMS tilt (deg)",
    CAMERA: "test camera",
    f"{CAMERA}.focal_px": "focal length (px)",
    f"{CAMERA}.size_px.0": "image width (px)",
    f"{CAMERA}.principal_point_px.0": "principal point along u (px)",
    f"{CAMERA}.aspect": "aspect, focal length along v over u",
    f"{CAMERA}.skew": "skew",
    f"{CAMERA}.distortion.k1": "distortion k1",
    f"{CAMERA}.zoom_k1": "k1 gained by a doubling of the zoom",
}
"""Labels of the figures' horizontal axes by key, with units. A missing key is its own label."""


class Measures(NamedTuple):
    """Three numbers of one run, or of its prediction; NaN where unknown.

    Attributes:
        goals: largest error of a desired point, marker sides.
        paths: largest distance of a robot from its path in the reference run, marker sides.
        shape: final shape error, a share of the formation's RMS radius.
    """

    goals: float
    paths: float
    shape: float


UNKNOWN = Measures(goals=np.nan, paths=np.nan, shape=np.nan)
"""Measures of a missing run."""


@dataclass(frozen=True)
class Point:
    """One value of a sweep's parameter.

    Attributes:
        value: the parameter's value, as a number, or as a text for tables and texts.
        runs: measures of each run, by kind of perception and by use of rectification.
        predicted: geometric prediction for a camera that is assumed ideal.
    """

    value: float | str
    runs: Mapping[tuple[str, bool], list[Measures]]
    predicted: Measures

    def worst(self, perception: str, *, rectified: bool) -> Measures:
        """Return the largest value of each measure over the seeds of one kind of run; NaN without any."""
        runs = np.array(self.runs.get((perception, rectified), [UNKNOWN]))
        return Measures(*(float(np.max(column)) for column in runs.T))


@dataclass(frozen=True)
class Sweep:
    """One parameter of the camera over its values.

    Attributes:
        name: the sweep's name in the study's file.
        label: the parameter's label on axes, with its unit.
        inside: True if all cameras of the sweep are in Property 1's class.
        points: its values, in the study's order.
        noise: measures of the reference run with detector noise only.
    """

    name: str
    label: str
    inside: bool
    points: list[Point]
    noise: Measures

    def worst(self, perception: str, *, rectified: bool) -> Measures:
        """Return the largest value of each measure over all points; NaN in a measure that no point has."""
        return _largest(point.worst(perception, rectified=rectified) for point in self.points)

    def predicted(self) -> Measures:
        """Return the largest value of each prediction over all points."""
        return _largest(point.predicted for point in self.points)

    def floors(self) -> list[Measures]:
        """Return the measures with detector noise only at each point; the reference's if there is no run."""
        own = [point.worst(NOISY, rectified=False) for point in self.points]
        return [self.noise if np.isnan(floor.shape) else floor for floor in own]


def make_sweeps(plan: Plan, table: pa.Table) -> list[Sweep]:
    """Compare the runs of a study of cameras with its reference, and with geometric predictions.

    Args:
        plan: the study and its runs.
        table: the study's table, with the columns that `skyherd.study.spec.INVARIANCE_KEEPS` names.

    Returns:
        the sweeps in the study's order, without the reference. Runs that failed are left out.

    Raises:
        InputError: the run of the reference failed.
    """
    rows = _rows(table)
    exact = [row for row in rows if row[SWEEP] == REFERENCE and row["perception"] == IDEAL]
    if not exact:
        raise InputError(
            plan.study.where, "the run of the reference failed", "see table.md; `retry=True` repeats it"
        )
    paths_m = exact[0][CURVE + "positions_m"]
    runs = {run.key: run for run in plan.runs}
    measured = {row["key"]: _measures(plan.mission(runs[row["key"]]), row, paths_m) for row in rows}
    noise = _largest(
        measured[row["key"]] for row in rows if row[SWEEP] == REFERENCE and row["perception"] == NOISY
    )
    return [
        _sweep(sweep, plan, measured, noise)
        for sweep in plan.study.spec.all_sweeps
        if sweep.name != REFERENCE
    ]


def own_key(sweep: SweepModel) -> str:
    """Return the camera key that a sweep changes; other grid keys are perception, rectification, seed."""
    return next(key for key in sweep.grid if key not in RUN_KEYS)


def predict(mission: Mission) -> Measures:
    """Predict the errors of a mission geometrically, with its first camera assumed ideal, without a run.

    The robots stand still at the start while the camera moves as in the mission. At `INSTANTS` instants the
    template is fitted to their exact image, and the fitted image points are projected to the ground through
    the true camera.

    Returns:
        the largest distance of these points from the template fitted on the ground, in marker sides; NaN for
        the paths; and the shape error of the last ones. All NaN if a camera's ray does not reach the ground.
    """
    world, scenario = make_world(mission), mission.scenario
    template = mission.template.points_of(mission.ids)
    true = desired_on_ground(template.conj(), to_complex(mission.positions_m))
    step_s = scenario.duration_s / (INSTANTS - 1)
    still = VelocityCommand(mission.ids, np.zeros(mission.ids.size), np.zeros(mission.ids.size))
    goals, shape = np.zeros(INSTANTS), float("nan")
    for tick in range(INSTANTS):
        camera, pose = world.cameras[0], world.camera_pose(0)
        seen = to_complex(project(camera, pose, mission.positions_m))
        try:
            wanted = undistort(camera, pose.zoom, to_points(desired_on_ground(template, seen)))
        except InputError:
            return UNKNOWN
        ground = to_complex(apply_homography(inverse(homography_image_ground(camera, pose)), wanted))
        goals[tick] = np.abs(ground - true).max()
        shape = fit_shape(template.conj(), ground).error
        world.advance(still, tick * step_s, step_s)
    return Measures(goals=float(goals.max()) / scenario.marker.side_m, paths=float("nan"), shape=shape)


def _rows(table: pa.Table) -> list[dict[str, Any]]:
    names = [SWEEP, "perception", "goal_error_m", "shape_error", CURVE + "positions_m", "key", ERROR]
    rows = table.select(names).to_pylist()
    for row in rows:
        row[CURVE + "positions_m"] = np.array(row[CURVE + "positions_m"], dtype=float)
    return [row for row in rows if row[ERROR] is None]


def _measures(mission: Mission, row: dict[str, Any], paths_m: Array) -> Measures:
    side_m, error_m = mission.scenario.marker.side_m, row["goal_error_m"]
    off_m = np.linalg.norm(row[CURVE + "positions_m"] - paths_m, axis=-1).max()
    goals = float("nan") if error_m is None else error_m / side_m
    return Measures(goals=goals, paths=float(off_m) / side_m, shape=row["shape_error"])


def _sweep(sweep: SweepModel, plan: Plan, measured: Mapping[str, Measures], noise: Measures) -> Sweep:
    key = own_key(sweep)
    inside = key in PROPERTY_1 and not any(name.startswith(f"{CAMERA}.lens") for name in sweep.set)
    mine = [run for run in plan.runs if run.sweep == sweep.name]
    points = []
    for value in sweep.grid[key]:
        here = [run for run in mine if run.settings[key] == value]
        runs: dict[tuple[str, bool], list[Measures]] = {}
        for run in here:
            kind = run.parameters["perception"], run.parameters["control.rectify"]
            if run.key in measured:
                runs.setdefault(kind, []).append(measured[run.key])
        points.append(Point(_shown(value), runs, predict(plan.mission(here[0]))))
    return Sweep(name=sweep.name, label=LABELS.get(key, key), inside=inside, points=points, noise=noise)


def _shown(value: Any) -> float | str:
    """Return a parameter's value for an axis: a number, a preset's name, or another value's text."""
    if isinstance(value, int | float):
        return float(value)
    return str(value.get("preset", value)) if isinstance(value, dict) else str(value)


def _largest(measures: Iterable[Measures]) -> Measures:
    columns = np.array(list(measures) or [UNKNOWN], dtype=float).T
    return Measures(
        *(float(np.nanmax(column)) if np.isfinite(column).any() else float("nan") for column in columns)
    )
