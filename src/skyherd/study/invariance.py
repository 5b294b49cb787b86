"""What a study of cameras measured, sweep by sweep: goals, paths and shape, beside what geometry predicts.

Lengths are in marker sides. With x the robots' places and x* those of the reference's run, in which an ideal
camera sees exactly, of a run are measured

    goals   max |x^d - x^d of the truth|    over robots and images: `goal_error_m`
    paths   max |x - x*|                    over robots and time
    shape   the final shape error.

Predicted for a camera that is taken as ideal: the template is fitted to the image of the start, and seen on
the ground through the true camera; its distance from the fit on the ground, and its own shape error.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from skyherd.analysis.goal_points import desired_on_ground
from skyherd.datasets import Mission
from skyherd.errors import DegenerateSetError, InputError
from skyherd.geometry import Array, IntArray, apply_homography, inverse, to_complex, to_points
from skyherd.messages import VelocityCommand
from skyherd.render import homography_image_ground, project, undistort
from skyherd.sim.physics import make_world
from skyherd.sim.truth_metrics import fit_shape
from skyherd.study.plan import Plan, Run
from skyherd.study.spec import CURVE, REFERENCE, RUN_KEYS, SweepModel
from skyherd.study.store import ERROR
from skyherd.study.table import SWEEP

IDEAL, NOISY, RENDERED = "ideal", "noisy", "rendered"
INSTANTS = 25
"""At so many instants a camera that moves is asked for its prediction."""

CAMERA = "units.0.camera"
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
"""Keys that may have any value within Property 1's class, as long as the camera is otherwise in it."""

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


class Measures(NamedTuple):
    """Goals and paths in marker sides, and the shape error; NaN where there is none."""

    goals: float
    paths: float
    shape: float


NOTHING = Measures(np.nan, np.nan, np.nan)


@dataclass(frozen=True)
class Point:
    """One value of a sweep's parameter.

    Attributes:
        value: of the parameter, a number or a word.
        runs: measures of each run, by perception and whether it rectified.
        predicted: from geometry, for a camera taken as ideal.
    """

    value: float | str
    runs: Mapping[tuple[str, bool], list[Measures]]
    predicted: Measures

    def worst(self, perception: str, *, rectified: bool) -> Measures:
        """The largest of each measure over the runs."""
        runs = np.array(self.runs.get((perception, rectified), [NOTHING]))
        return Measures(*(float(np.max(column)) for column in runs.T))


@dataclass(frozen=True)
class Sweep:
    """One parameter over its values.

    Attributes:
        name: as the study has it.
        label: of the parameter, with its unit.
        inside: whether all its cameras are in Property 1's class.
        points: in the study's order.
        noise: what the detector's noise alone does at the reference.
    """

    name: str
    label: str
    inside: bool
    points: list[Point]
    noise: Measures

    def worst(self, perception: str, *, rectified: bool) -> Measures:
        """The largest of each measure over all values."""
        return _largest(point.worst(perception, rectified=rectified) for point in self.points)

    def predicted(self) -> Measures:
        """The largest of each prediction over all values."""
        return _largest(point.predicted for point in self.points)

    def floors(self) -> list[Measures]:
        """What the detector's noise alone does, at each value; at the reference where that was not run."""
        own = [point.worst(NOISY, rectified=False) for point in self.points]
        return [self.noise if np.isnan(floor.shape) else floor for floor in own]


def make_sweeps(plan: Plan, table: pa.Table) -> list[Sweep]:
    """The sweeps of a study of cameras, but its reference; runs that failed are left out.

    Raises:
        InputError: the reference's run failed.
    """
    rows = _rows(table)
    exact = [row for row in rows if row[SWEEP] == REFERENCE and row["perception"] == IDEAL]
    if not exact:
        raise InputError(
            plan.study.where, "the reference's run failed", "see table.md; --retry makes it again"
        )
    paths_m = exact[0][CURVE + "positions_m"]
    measured = {row["key"]: _measures(plan.mission(run), row, paths_m) for run, row in _paired(plan, rows)}
    noise = _largest(
        measured[row["key"]] for row in rows if row[SWEEP] == REFERENCE and row["perception"] == NOISY
    )
    return [
        _sweep(sweep, plan, measured, noise)
        for sweep in plan.study.spec.all_sweeps
        if sweep.name != REFERENCE
    ]


def own_key(sweep: SweepModel) -> str:
    """The parameter that a sweep is about."""
    return next(key for key in sweep.grid if key not in RUN_KEYS)


def predict(mission: Mission) -> Measures:
    """Largest displacement of the goals while robots stand at the start, and the shape's error at the end."""
    world, scenario = make_world(mission), mission.scenario
    template = mission.template.points_of(mission.ids)
    true = desired_on_ground(template.conj(), to_complex(mission.positions_m))
    step_s, still = scenario.duration_s / (INSTANTS - 1), _stand(mission.ids)
    goals, shape = np.zeros(INSTANTS), float("nan")
    for tick in range(INSTANTS):
        camera, pose = world.cameras[0], world.camera_pose(0)
        seen = to_complex(project(camera, pose, mission.positions_m))
        try:
            wanted = undistort(camera, pose.zoom, to_points(desired_on_ground(template, seen)))
        except (InputError, DegenerateSetError):
            return NOTHING
        ground = to_complex(apply_homography(inverse(homography_image_ground(camera, pose)), wanted))
        goals[tick] = np.abs(ground - true).max()
        shape = fit_shape(template.conj(), ground).error
        world.advance(still, tick * step_s, step_s)
    return Measures(float(goals.max()) / scenario.marker.side_m, float("nan"), shape)


def _stand(ids: IntArray) -> VelocityCommand:
    return VelocityCommand(ids, np.zeros(ids.size), np.zeros(ids.size))


def _rows(table: pa.Table) -> list[dict[str, Any]]:
    names = [SWEEP, "perception", "goal_error_m", "shape_error", CURVE + "positions_m", "key", ERROR]
    rows = table.select(names).to_pylist()
    for row in rows:
        row[CURVE + "positions_m"] = np.array(row[CURVE + "positions_m"], dtype=float)
    return [row for row in rows if row[ERROR] is None]


def _paired(plan: Plan, rows: list[dict[str, Any]]) -> Iterable[tuple[Run, dict[str, Any]]]:
    runs = {run.key: run for run in plan.runs}
    return ((runs[row["key"]], row) for row in rows)


def _measures(mission: Mission, row: dict[str, Any], paths_m: Array) -> Measures:
    side_m, error_m = mission.scenario.marker.side_m, row["goal_error_m"]
    off_m = np.linalg.norm(row[CURVE + "positions_m"] - paths_m, axis=-1).max()
    goals = float("nan") if error_m is None else error_m / side_m
    return Measures(goals, float(off_m) / side_m, row["shape_error"])


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
    return Sweep(sweep.name, LABELS.get(key, key), inside, points, noise)


def _shown(value: Any) -> float | str:
    """A value as an axis has it."""
    if isinstance(value, int | float):
        return float(value)
    return str(value.get("preset", value)) if isinstance(value, dict) else str(value)


def _largest(measures: Iterable[Measures]) -> Measures:
    columns = np.array(list(measures) or [NOTHING], dtype=float).T
    return Measures(
        *(float(np.nanmax(column)) if np.isfinite(column).any() else float("nan") for column in columns)
    )
