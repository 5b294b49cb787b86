"""Measure contacts of robots where the ground or a camera violates the assumptions.

```sh
export OPENBLAS_NUM_THREADS=1
python benchmarks/odd_worlds.py sheet --runs 20      # a spare sheet with a robot's id lies on the ground
python benchmarks/odd_worlds.py sheets --runs 20     # sheets with all ids lie beside the team
python benchmarks/odd_worlds.py stranger --runs 20   # a body with an unknown id stands among the robots
python benchmarks/odd_worlds.py movers --runs 100    # two obstacles move through the team
python benchmarks/odd_worlds.py freeze --runs 100    # a camera repeats one image for 2 to 6 s
python benchmarks/odd_worlds.py delay --runs 100     # a camera is 2 to 6 s late
python benchmarks/odd_worlds.py replay --runs 100    # a camera repeats its last 2 to 6 s three times
python benchmarks/odd_worlds.py none --harsh         # false alarms under slip, latency and lost messages
```

`--unchecked` switches the units' check of their cameras off, and `--longest 12` makes faults longer.
`--together` keeps units from telling robots apart from copies of their markers.

Each run is the scenario `crowd` with another seed and projected noisy markers, with a single unit if its
camera is faulty. Robots have bodies of two
marker sides across. Sheets are flat, and robots may drive over them. Strangers and
movers are bodies.
"""

import argparse
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rows import Row, gather

from skyherd.control import AerialController
from skyherd.control.camera_check import MOVED_SIDES, RESPONSIVE, TRIAL_S, CameraCheck
from skyherd.datasets import Mission, load_mission
from skyherd.geometry import Array
from skyherd.loop import run_steps
from skyherd.render import CameraPose
from skyherd.sim.agents import make_controller
from skyherd.sim.perception import make_run_perception
from skyherd.sim.robot_teams import make_camera_rule
from skyherd.sim.sight import Perception, Sight
from skyherd.sim.world import Markers, World

FAULTS = ("freeze", "delay", "replay")
WORLDS = ("none", "sheet", "sheets", "stranger", "movers", *FAULTS)
CLEAR_SIDES = 3.0
"""Minimum distance of a sheet or stranger from the robots at the start, marker sides. Chosen: a gap of one
side between bodies."""

STRANGER_ID, MOVER_IDS = 45, [46, 47]
SPEEDS_MPS = (0.02, 0.1)
"""Range of a mover's speed, m/s. Chosen: below the robots' top speed of 0.6 m/s by a factor of 6."""

MOVERS_FROM_M = (3.5, 7.0)
"""Range of a mover's distance from the team's centre at the start, m. Chosen: the nearest movers meet robots
that still form the shape, and the farthest meet the finished one."""

MOVERS_VIEW = ("units.*.flight.border_sides=3.5", "units.*.height_m=7.0")
"""Settings of the cameras among movers. Derived: bodies touch at 2 sides, the margin is 0.2 sides, half the
diagonal of a card 1.0 side, and 0.3 sides are for the unit's response. They start at the height at which they
then fly."""

AIM_M = 1.0
"""Maximum offset of a mover's path from the team's centre, along each axis, m."""

WAY_OUT_SPEED_MPS, WAY_OUT_AFTER_S, WAY_OUT_FOR_S = 0.3, 1.0, 3.0
"""A robot has a way out if it can drive straight at this speed, after this time, for this time. Chosen: half
of the top speed, the time of a response and a turn, and a way of more than the diameter of a body."""

DURATION_S = {"movers": 140.0, "sheets": 300.0, **dict.fromkeys(FAULTS, 40.0)}
"""Simulated time by world, s. Chosen: a mover at 0.1 m/s has passed the shape, a fault has
ended, and all robots are told apart although one unit after the other sees them."""

USUAL_DURATION_S = 40.0
"""Simulated time in other worlds, s. Chosen: twice the time in which the shape is formed."""


ONE_CAMERA = (
    "units=[{ position_m = [0.0, 0.0], height_m = 8.0, camera = { half_angle_deg = 35.0 }, "
    'flight = { kind = "keep-in-view" } }]'
)
"""Setting of a single unit: no other one corrects it."""

FAULT_START_S = (0.3, 3.0)
"""Range of a fault's start, s. Chosen: the robots move for about 5 s."""

MIN_FAULT_S, MAX_FAULT_S = 2.0, 6.0
"""Range of a fault's duration, of a delay and of a clip, s. Chosen: 2 s of frozen images cause contacts."""

HARSH = (
    "robots.drive.slip=0.05",
    "robots.drive.gain_error=0.2",
    "robots.drive.delay_s=0.1",
    "network.message_loss=0.3",
    "network.frame_loss=0.1",
    "network.delay_s=0.2",
    "units.0.latency_s=0.2",
)
"""Settings of imperfect wheels and radio."""


class ExtraMarkers(Perception):
    """Perception of the world with additional markers, which may move.

    Args:
        perception: perception of the scenario.
        ids: (K,) ids of the additional markers.
        positions_m: (K, 2) their positions at the start.
        velocities_mps: (K, 2) their velocities.
    """

    def __init__(
        self,
        perception: Perception,
        ids: Sequence[int],
        positions_m: Array,
        velocities_mps: Array,
    ) -> None:
        self._perception, self._ids, self._positions_m = (
            perception,
            np.array(ids, dtype=np.int64),
            positions_m,
        )
        self._velocities_mps = velocities_mps

    def positions_m(self, time_s: float) -> Array:
        """Return the positions (K, 2) of the additional markers."""
        return np.asarray(self._positions_m + self._velocities_mps * time_s)

    def look(self, world: World, units: Sequence[int], time_s: float) -> list[Sight]:
        """Return the detections of all markers in the units' images."""
        own = world.markers
        extra = Markers(self._ids, self.positions_m(time_s), np.zeros(self._ids.size))
        return self._perception.look(_Extended(world, own, extra), units, time_s)


class _Extended(World):
    """View of a world with more markers on the ground; it cannot be advanced."""

    def __init__(self, world: World, own: Markers, extra: Markers) -> None:
        self._world, self._own, self._extra = world, own, extra
        self.cameras, self.imaging, self.covered_ids = world.cameras, world.imaging, world.covered_ids

    @property
    def markers(self) -> Markers:
        """All markers of the world and the additional ones."""
        names = ("ids", "positions_m", "headings_rad")
        return Markers(*(np.concatenate([getattr(self._own, n), getattr(self._extra, n)]) for n in names))

    def camera_pose(self, unit: int) -> CameraPose:
        """Return the present pose of one unit's camera."""
        return self._world.camera_pose(unit)


def draw_fault(seed: int, kind: str, longest_s: float) -> list[str]:
    """Return the settings of a single camera with a fault at a random time."""
    rng = np.random.default_rng([seed, 92])
    start_s, by_s = rng.uniform(*FAULT_START_S), rng.uniform(MIN_FAULT_S, longest_s)
    lasts_s = by_s if kind == "freeze" else 3 * by_s
    times = f"start_s = {start_s:.1f}, end_s = {start_s + lasts_s:.1f}, by_s = {by_s:.1f}"
    return [ONE_CAMERA, f'units.0.camera.faults=[{{ kind = "{kind}", {times} }}]']


def load_world(
    seed: int,
    world: str,
    *,
    checked: bool = True,
    apart: bool = True,
    harsh: bool = False,
    longest_s: float = MAX_FAULT_S,
) -> Mission:
    """Return the mission of one run."""
    settings = [
        f"seed={seed}",
        "perception=noisy",
        f"duration_s={DURATION_S.get(world, USUAL_DURATION_S)}",
    ]
    settings += [] if checked else ["control.camera_check=false"]
    settings += [] if apart else ["control.tell_apart=false"]
    settings += draw_fault(seed, world, longest_s) if world in FAULTS else []
    settings += HARSH if harsh else []
    if world == "movers":
        # The scenario's own obstacles are far away; they make the movers' ids known as obstacles.
        far = (f"{{ id = {mover}, position_m = [{10 * mover}.0, 500.0] }}" for mover in MOVER_IDS)
        settings += [f"obstacles=[{', '.join(far)}]", *MOVERS_VIEW]
    return load_mission("crowd", settings)


def place_extra(mission: Mission, seed: int, world: str) -> tuple[list[int], Array, Array]:
    """Draw ids (K,), positions (K, 2), m, and velocities (K, 2), m/s, of the additional markers."""
    rng, still = np.random.default_rng([seed, 91]), np.zeros((1, 2))
    side_m, robots_m = mission.scenario.marker.side_m, mission.positions_m
    if world == "sheets":
        count = mission.ids.size
        row, column = np.divmod(np.arange(count), 4)
        corner_m = np.array([robots_m[:, 0].max() + CLEAR_SIDES * side_m, robots_m[:, 1].mean() - 1.5])
        return mission.ids.tolist(), corner_m + np.stack([row, column], axis=1), still
    clear_m = CLEAR_SIDES * side_m
    if world == "movers":
        places_m: list[Array] = []
        velocities_mps: list[Array] = []
        while len(places_m) < len(MOVER_IDS):
            angle = rng.uniform(-np.pi, np.pi)
            along = np.array([np.cos(angle), np.sin(angle)])
            aim_m = robots_m.mean(axis=0) + rng.uniform(-AIM_M, AIM_M, 2)
            at_m, speed_mps = aim_m - rng.uniform(*MOVERS_FROM_M) * along, rng.uniform(*SPEEDS_MPS)
            if np.linalg.norm(np.array([*robots_m, *places_m]) - at_m, axis=1).min() > clear_m:
                places_m.append(at_m)
                velocities_mps.append(speed_mps * along)
        return MOVER_IDS, np.array(places_m), np.array(velocities_mps)
    low_m, high_m = robots_m.min(axis=0) - clear_m, robots_m.max(axis=0) + clear_m
    while True:
        at_m = rng.uniform(low_m, high_m)
        if np.linalg.norm(robots_m - at_m, axis=1).min() > clear_m:
            break
    robot = int(rng.choice(mission.ids))
    return [robot if world == "sheet" else STRANGER_ID], at_m[None], still


def has_way_out(robot: int, robots_m: Array, extra_m: Array, extra_mps: Array, touch_m: float) -> bool:
    """Return whether a robot can leave straight in some direction without a contact.

    The other robots stand still, and the additional bodies keep their velocities.

    Args:
        robot: row of the robot.
        robots_m: (N, 2) the robots' positions.
        extra_m: (K, 2) the additional bodies' positions.
        extra_mps: (K, 2) their velocities.
        touch_m: distance between the centres of two bodies that touch.
    """
    times_s = np.linspace(0.0, WAY_OUT_AFTER_S + WAY_OUT_FOR_S, 41)
    angles = np.linspace(-np.pi, np.pi, 72, endpoint=False)
    along = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    way_m = WAY_OUT_SPEED_MPS * np.maximum(times_s - WAY_OUT_AFTER_S, 0.0)
    path_m = robots_m[robot] + way_m[:, None, None] * along
    others_m = np.delete(robots_m, robot, axis=0)
    there_m = extra_m + times_s[:, None, None] * extra_mps
    clear = np.linalg.norm(path_m[:, :, None] - others_m, axis=3).min(axis=(0, 2)) >= touch_m
    clear &= np.linalg.norm(path_m[:, :, None] - there_m[:, None], axis=3).min(axis=(0, 2)) >= touch_m
    return bool(clear.any())


class Responses(CameraCheck):
    """Check of a camera that keeps the ratio of seen to commanded motion of each robot that is tried."""

    ratios: list[float]

    def _judge_robots(self, view: Any, trial: Any) -> None:
        if view.time_s - trial.time_s >= TRIAL_S + self._rule.lag_s:
            commanded = self._commanded_sides(trial.time_s, view.time_s - self._rule.lag_s)
            tried = (commanded >= MOVED_SIDES) & view.seen & trial.seen
            moved = view.relative_sides(trial, np.ones(tried.size, dtype=bool))
            self.ratios += (moved[tried] / commanded[tried]).tolist()
        super()._judge_robots(view, trial)


def run_world(
    seed: int,
    world: str,
    *,
    checked: bool = True,
    apart: bool = True,
    harsh: bool = False,
    longest_s: float = MAX_FAULT_S,
) -> Row:
    """Run one mission and return its contacts and its shape error at the end.

    A contact with an additional body is avoidable if the robot had a way out when the body came within its
    margin (`has_way_out`).
    """
    mission = load_world(seed, world, checked=checked, apart=apart, harsh=harsh, longest_s=longest_s)
    perception = make_run_perception(mission)
    extra = None
    if world not in ("none", *FAULTS):
        ids, places_m, extra_mps = place_extra(mission, seed, world)
        perception = extra = ExtraMarkers(perception, ids, places_m, extra_mps)
    side_m, radius_m = mission.scenario.marker.side_m, mission.bodies.radius_m
    is_body = world in ("stranger", "movers")
    margin_m = mission.scenario.avoidance.margin_sides * side_m
    had_way_out = np.ones(mission.ids.size, dtype=bool)
    within = np.zeros(mission.ids.size, dtype=bool)
    avoidable = 0
    touching: set[tuple[int, ...]] = set()
    faults = [fault for unit in mission.scenario.units for fault in unit.camera.faults]
    contacts, gap_m, images, alarms, missed_s = 0, np.inf, 0, 0, np.nan
    ratios: list[float] = []

    def controller_for(of: Mission, unit: int) -> AerialController:
        controller, rule = make_controller(of, unit), make_camera_rule(of.scenario)
        if checked and rule is not None:
            controller.camera_check = Responses(rule, controller.template.ids)
            controller.camera_check.ratios = ratios
        return controller

    for step in run_steps(mission, perception, controller_for=controller_for):
        gaps_m, pairs = mission.bodies.gaps_m(step.positions_m), mission.bodies.pairs(len(step.positions_m))
        now = {tuple(pair) for pair in pairs[gaps_m < 0].tolist()}
        if is_body and extra is not None:
            extra_m = extra.positions_m(step.time_s)
            away_m = np.linalg.norm(step.positions_m[:, None] - extra_m, axis=2) - 2 * radius_m
            gaps_m = np.append(gaps_m, away_m)
            now |= {(robot, -1 - body) for robot, body in zip(*np.nonzero(away_m < 0), strict=True)}
            entered, within = ~within & (away_m < margin_m).any(axis=1), (away_m < margin_m).any(axis=1)
            for robot in np.flatnonzero(entered).tolist():
                had_way_out[robot] = has_way_out(
                    robot, step.positions_m, extra_m, extra_mps, touch_m=2 * radius_m
                )
            avoidable += sum(body < 0 and bool(had_way_out[robot]) for robot, body in now - touching)
        contacts += len(now - touching)
        touching, gap_m = now, min(gap_m, float(gaps_m.min()))
        suspects = [unit for unit, frame in step.frames.items() if frame.decision.suspicion]
        images += len(step.frames)
        if not any(step.time_s >= fault.start_s for fault in faults):
            alarms += len(suspects)
        elif suspects and np.isnan(missed_s):
            missed_s = step.time_s - faults[0].start_s
    return {
        "seed": seed,
        "contacts": contacts,
        "avoidable": avoidable,
        "min_gap_sides": round(gap_m / side_m, 3),
        "shape_error": round(step.metrics.shape.error, 4),
        "images": images,
        "false_alarms": alarms,
        "tried": len(ratios),
        "unresponsive": sum(ratio < RESPONSIVE for ratio in ratios),
        "suspected_after_s": None if np.isnan(missed_s) else round(missed_s, 1),
    }


def summarize(rows: list[Row]) -> dict[str, Any]:
    """Return the summary of all runs."""
    return {
        "runs": len(rows),
        "with_contacts": sum(row["contacts"] > 0 for row in rows),
        "contacts": sum(row["contacts"] for row in rows),
        "avoidable": sum(row["avoidable"] for row in rows),
        "min_gap_sides": min(row["min_gap_sides"] for row in rows),
        "formed": sum(row["shape_error"] < 0.01 for row in rows),
        "images": sum(row["images"] for row in rows),
        "false_alarms": sum(row["false_alarms"] for row in rows),
        "tried": sum(row["tried"] for row in rows),
        "unresponsive": sum(row["unresponsive"] for row in rows),
        "suspected": sum(row["suspected_after_s"] is not None for row in rows),
    }


def main() -> None:
    """Run the missions and print their rows and a summary."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("world", choices=WORLDS)
    parser.add_argument("--unchecked", action="store_true", help="units trust every image")
    parser.add_argument("--together", action="store_true", help="units do not tell robots from copies")
    parser.add_argument("--harsh", action="store_true", help="imperfect wheels and radio")
    parser.add_argument("--longest", type=float, default=MAX_FAULT_S, help="longest fault, s, up to 12")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=100, help="of the first run")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", type=Path, help="file of rows, one a line")
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.runs)
    run = partial(
        run_world,
        world=options.world,
        checked=not options.unchecked,
        apart=not options.together,
        harsh=options.harsh,
        longest_s=options.longest,
    )
    rows = gather(run, seeds, options.jobs, options.json)
    print(json.dumps(summarize(rows), indent=1))


if __name__ == "__main__":
    main()
