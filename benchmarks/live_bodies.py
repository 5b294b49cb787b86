"""Measure contacts of live robots with bodies: crowded starts of a live team, judged by the true gaps.

    python benchmarks/live_bodies.py --json bodies.json --table bodies.md
    python benchmarks/live_bodies.py --processes 3

Without `--processes` the processes' own cores run in one process and in simulated time. The world is the
scenario `crowd` on exact points, and the set-up is the lab `crowd`. Images are 0.1 to 0.3 s old when a unit
decides on them. Messages take up to 0.1 s, and 10 % are lost. Clocks differ by up to 0.6 s. Robots decide at
different instants. Each stalls at random for up to 0.6 s, while its wheels obey the last command for
`HOLD_S`. A run without avoidance differs in nothing else.

With `--processes` a start of fewer robots runs as `skyherd world` and `skyherd live run --arm`. The world's
record of the truth gives the gaps.

Columns: `contact` counts the runs in which some gap between two bodies was below 0. `least gap` is the least
of all runs and time steps. `formed` counts runs whose shape error was below 2 % at the end, by the roles that
the units agreed on.
"""

import argparse
import json
import subprocess
import tempfile
import time
import tomllib
from collections import deque
from dataclasses import dataclass, field
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from live_faults import HOLD_S, KINDS, Process
from live_latency import toml_text
from live_process_faults import SKYHERD, _free_port
from mcap.reader import make_reader

from skyherd.control import newest_roles
from skyherd.datasets import Mission, load_mission, make_mission, put_value, scenario_text
from skyherd.errors import InputError
from skyherd.files.atomic import write_text
from skyherd.geometry import Array
from skyherd.live import operator
from skyherd.live.lab import Lab, lab_text, load_lab, make_lab
from skyherd.live.logs.process_log_file import read_process_log
from skyherd.live.mailbox import Air, Mailbox
from skyherd.live.robot_core import RobotCore
from skyherd.live.unit_core import UnitCore
from skyherd.messages import Detections, RoleMap, VelocityCommand
from skyherd.sim.physics import make_world
from skyherd.sim.projected_perception import ProjectedPerception
from skyherd.sim.truth_metrics import TruthObserver

STARTS = 20
STEP_S = 0.02
IMAGE_S = 0.2
IMAGE_AGE_S = 0.1, 0.3
MESSAGE_S = 0.1
LOSS = 0.1
CLOCK_S = 0.3
HEARTBEAT_S = 0.25
ARM_S = 1.0, 3.0
STALL_SHARE = 0.005
STALL_S = 0.1, 0.6
"""A robot begins to stall after this share of its decisions, once in 20 s, for a time in this range."""

FORMED = 0.02
KINDS_OF_RUN: dict[str, tuple[list[str], float]] = {
    "exchanged roles": ([], 60.0),
    "fixed roles": (["shape.exchange=false"], 40.0),
    "exchanged roles, no avoidance": (["avoidance.on=false"], 30.0),
    "fixed roles, no avoidance": (["shape.exchange=false", "avoidance.on=false"], 20.0),
}
"""Settings of the lab and duration, s, by the kind of run."""

PROCESS_ROBOTS = 6
PROCESS_S = 60.0
WAIT_S = 120.0
"""Robots of a run with processes, how long it lasts from the first driving robot on, and how long that is
waited for, s of real time."""

PATIENT = [
    "limits.goal_timeout_s=1.5",
    "limits.clock_uncertainty_s=0.2",
    "recording.image_rate_hz=0",
]
"""Settings of the lab for a machine that is busy."""


@dataclass
class Agent:
    """A live process and its schedule.

    Attributes:
        process: its core, mailbox and clock.
        due_s: when it decides or takes an image the next time.
        beat_s: when it sends its next heartbeat.
        images: of a unit, what it will decide on: when, and the detections.
        roles: of a unit, the newest map from robots to points that it reported.
    """

    process: Process
    due_s: float
    beat_s: float
    images: deque[tuple[float, Detections]] = field(default_factory=deque)
    roles: RoleMap | None = None


class CrowdedTeam:
    """A live team with bodies in memory and simulated time.

    Attributes:
        mission: the scenario.
        lab: the set-up.
        gaps_m: least gap of each step.
        errors: shape error of each step.

    Args:
        lab: the set-up.
        mission: the world; its time step is `STEP_S`.
        seed: of delays, losses, clocks and stalls.
    """

    def __init__(self, lab: Lab, mission: Mission, seed: int) -> None:
        self.lab, self.mission, self._rng = lab, mission, np.random.default_rng([seed, 34])
        self._world = make_world(mission)
        marker = mission.scenario.marker
        self._perception = ProjectedPerception(marker.side_m, marker.dictionary)
        self._observer = TruthObserver(mission.template, mission.ids)
        self._bodies = mission.scenario.make_bodies()
        self._start_s, self._step, self._now_s = 1000.0, 0, 1000.0
        self._air = Air(
            now_s=self._now_s,
            drop=lambda topic, receiver: bool(self._rng.random() < LOSS),
            delay_s=lambda topic, receiver: float(self._rng.uniform(0, MESSAGE_S)),
        )
        units = [f"unit/{unit}" for unit in range(len(lab.model.cameras))]
        self._agents = [self._agent(name) for name in [*units, *(f"robot/{robot}" for robot in lab.ids)]]
        self._operator = operator.watch(lab, self._air.radio("operator"), lambda: self._now_s)
        self._arming: operator.ArmCommand | None = None
        self._wheels = {robot: (0.0, 0.0, -np.inf) for robot in lab.ids}
        self.gaps_m: list[float] = []
        self.errors: list[float] = []

    @property
    def time_s(self) -> float:
        """Return the time since the start, s."""
        return self._now_s - self._start_s

    def _agent(self, name: str) -> Agent:
        kind, number = name.split("/")
        radio = self._air.radio(name)
        core = getattr(self.lab, f"make_{kind}")(int(number))
        process = Process(name, core, None, radio, float(self._rng.uniform(-CLOCK_S, CLOCK_S)))  # type: ignore[arg-type]
        process.mailbox = Mailbox(
            radio,
            self.lab.model.team,
            name,
            lambda: self._now_s + process.offset_s,
            KINDS[kind],
            process.say,
            lambda: process.core.latch,
        )
        period_s = IMAGE_S if kind == "unit" else self.lab.model.limits.period_s
        due_s, beat_s = self._now_s + self._rng.uniform(0, [period_s, HEARTBEAT_S])
        return Agent(process, float(due_s), float(beat_s))

    def run(self, duration_s: float) -> None:
        """Run all processes and the world for a time."""
        for _ in range(round(duration_s / STEP_S)):
            self._air.advance(self._now_s)
            self._arm()
            for agent in self._agents:
                if isinstance(agent.process.core, UnitCore):
                    self._run_unit(agent)
                else:
                    self._run_robot(agent)
            self._move()
            self._step += 1
            self._now_s = self._start_s + self._step * STEP_S

    def _arm(self) -> None:
        """Arm all robots, as `skyherd live arm` does."""
        self._operator.listen(0.0)
        if ARM_S[0] <= self.time_s < ARM_S[1]:
            self._arming = self._arming or operator.ArmCommand(self.lab, self._operator)
            self._arming.advance()

    def _listen(self, agent: Agent) -> float:
        """Receive messages, send a heartbeat when it is due, and return the process's clock."""
        process, clock_s = agent.process, self._now_s + agent.process.offset_s
        for arrival in process.mailbox.fetch():
            process.core.receive(arrival.envelope, arrival.received_s)
        if self._now_s >= agent.beat_s:
            agent.beat_s += HEARTBEAT_S
            process.mailbox.send(process.core.heartbeat(clock_s, ""))
        return clock_s

    def _run_unit(self, agent: Agent) -> None:
        """Take an image when it is due, and decide on one when it is old enough."""
        process, clock_s = agent.process, self._listen(agent)
        if self._now_s >= agent.due_s:
            agent.due_s += IMAGE_S
            sight = self._perception.look(self._world, [process.core.unit_id], clock_s)[0]
            age_s = float(self._rng.uniform(*IMAGE_AGE_S))
            agent.images.append((self._now_s + age_s, sight.detections))
        while agent.images and agent.images[0][0] <= self._now_s:
            news = process.core.see(agent.images.popleft()[1], clock_s)
            if news is not None:
                agent.roles = news.decision.report.roles
                for message in news.messages:
                    process.mailbox.send(message)
                self._world.fly(news.decision.flight)

    def _run_robot(self, agent: Agent) -> None:
        """Decide when it is due, and sometimes stall after that."""
        if self._now_s < agent.due_s:
            return
        core: RobotCore = agent.process.core
        order = core.decide(self._listen(agent))
        agent.process.say(order.reason)
        self._wheels[core.robot_id] = order.v_mps, order.omega_radps, self._now_s
        agent.due_s = max(agent.due_s + self.lab.model.limits.period_s, self._now_s)
        if self._rng.random() < STALL_SHARE:
            agent.due_s += float(self._rng.uniform(*STALL_S))

    def _move(self) -> None:
        """Integrate one step. Wheels keep their last command until it is `HOLD_S` old."""
        told = [
            (v_mps, omega_radps) if self._now_s - told_s <= HOLD_S else (0.0, 0.0)
            for v_mps, omega_radps, told_s in self._wheels.values()
        ]
        self.gaps_m.append(float(self._bodies.gaps_m(self._world.positions_m).min()))
        command = VelocityCommand(np.array(self.lab.ids), *np.array(told).T)
        if self._step % 10 == 0:
            self.errors.append(self._error())
        self._world.advance(self._world.limit(command), self.time_s, STEP_S)

    def _error(self) -> float:
        """Return the shape error by the newest roles of any unit."""
        roles = newest_roles([agent.roles for agent in self._agents], self.mission.ids.size)
        shape = self.mission.shape_at(self.time_s, roles)
        return float(self._observer.observe(self._world.positions_m, {}, (), shape).shape.error)


def run_in_memory(
    kind: str, seed: int, duration_s: float | None = None, *, small: bool = False
) -> dict[str, Any]:
    """Run one crowded start in memory.

    Args:
        kind: one of `KINDS_OF_RUN`.
        seed: of the start and of all that is random.
        duration_s: instead of the kind's own.
        small: with the robots and the one unit of `small_scenario`.

    Returns:
        A row of the table.
    """
    settings, default_s = KINDS_OF_RUN[kind]
    if small:
        mission = make_mission(small_scenario(seed) | {"perception": "ideal", "step_s": STEP_S})
        tree = small_lab("none", "tcp/127.0.0.1:7450")
        for setting in settings:
            key, _, value = setting.partition("=")
            put_value(tree, key, value == "true", setting)
        lab = make_lab(tree)
    else:
        mission = load_mission("crowd", ["perception=ideal", f"step_s={STEP_S}"], seed=seed)
        lab = load_lab("crowd", settings)
    team = CrowdedTeam(lab, mission, seed)
    team.run(default_s if duration_s is None else duration_s)
    row = _row(kind, seed, np.array(team.gaps_m), STEP_S, team.errors[-1])
    return row | {"start_error": team.errors[0]}


def _row(kind: str, seed: int, gaps_m: Array, step_s: float, error: float) -> dict[str, Any]:
    return {
        "kind": kind,
        "seed": seed,
        "start_gap_m": float(gaps_m[0]),
        "min_gap_m": float(gaps_m.min()),
        "contact_s": float((gaps_m < 0).sum() * step_s),
        "error": float(error),
        "formed": bool(error < FORMED),
    }


def has_room(seed: int) -> bool:
    """Return whether the small scenario of a seed has room for its robots."""
    try:
        make_mission(small_scenario(seed))
    except InputError:
        return False
    return True


def run_processes(kind: str, seed: int) -> dict[str, Any]:
    """Run one crowded start with real processes, and return a row of the table."""
    settings = [*PATIENT, *KINDS_OF_RUN[kind][0]]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        camera, radio = _free_port(), f"tcp/127.0.0.1:{_free_port()}"
        scenario_file, lab_file = folder / "scenario.toml", folder / "lab.toml"
        write_text(scenario_file, toml_text(small_scenario(seed)))
        write_text(lab_file, toml_text(small_lab(f"tcp://127.0.0.1:{camera}", radio)))
        world = [*SKYHERD, "world", str(scenario_file), "--lab", str(lab_file), "--port", str(camera)]
        session = [*SKYHERD, "live", "run", str(lab_file), "--arm", "--out", str(folder / "run")]
        processes = [
            subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            for command in (
                [*world, "--record", str(folder / "world.mcap")],
                [*session, *(part for setting in settings for part in ("--set", setting))],
            )
        ]
        try:
            drives = _wait_for_driving(folder / "run" / "live.log", processes)
            if drives:
                time.sleep(PROCESS_S)
        finally:
            for process in reversed(processes):
                process.terminate()
                try:
                    process.wait(30)
                except subprocess.TimeoutExpired:
                    process.kill()
        return _judge(kind, seed, folder) | {"drives": drives}


def small_scenario(seed: int) -> dict[str, Any]:
    """Return the scenario `crowd` with fewer robots, a circle, and one camera."""
    tree = tomllib.loads(scenario_text("crowd"))
    tree["seed"], tree["duration_s"] = seed, WAIT_S + PROCESS_S
    tree["template"] = {"shape": "circle"}
    tree["robots"] |= {
        "count": PROCESS_ROBOTS,
        "scatter": {"scale_m": 0.001, "jitter_m": 1.2, "spacing_m": 0.95},
    }
    tree["units"] = [tree["units"][0] | {"position_m": [0.0, 0.0], "height_m": 6.0, "frame_rate_hz": 5}]
    return tree


def small_lab(camera: str, radio: str) -> dict[str, Any]:
    """Return the lab `crowd` for the small scenario.

    Args:
        camera: address of the camera.
        radio: where the radio listens.
    """
    tree = tomllib.loads(lab_text("crowd"))
    tree["shape"]["shape"] = "circle"
    tree["cameras"] = [tree["cameras"][0] | {"address": camera}]
    tree["robots"] = tree["robots"][:PROCESS_ROBOTS]
    tree["radio"] = {"listen": [radio], "connect": [radio]}
    return tree


def _wait_for_driving(log: Path, processes: list["subprocess.Popen[bytes]"]) -> bool:
    """Wait until a robot drives, and return whether one does."""
    end_s = time.monotonic() + WAIT_S
    while time.monotonic() < end_s and all(process.poll() is None for process in processes):
        if log.exists() and "driving" in log.read_text(encoding="utf-8"):
            return True
        time.sleep(0.2)
    return False


def _judge(kind: str, seed: int, folder: Path) -> dict[str, Any]:
    """Return a row from the world's record of the truth, and the unit's own shape error."""
    bodies = make_mission(small_scenario(seed)).scenario.make_bodies()
    with (folder / "world.mcap").open("rb") as stream:
        messages = make_reader(stream).iter_messages(topics=["/truth"])
        truth = [orjson.loads(message.data) for _, _, message in messages]
    gaps_m = np.array([bodies.gaps_m(np.array(step["positions_m"])).min() for step in truth])
    views = [record for topic, record in read_process_log(folder / "run" / "unit_0.mcap") if topic == "/view"]
    error = views[-1]["shape_error"] if views else None
    step_s = truth[1]["time_s"] - truth[0]["time_s"]
    row = _row(f"processes, {kind}", seed, gaps_m, step_s, np.nan if error is None else error)
    places_m = np.array([step["positions_m"] for step in truth])
    moved_m = np.abs(np.diff(places_m, axis=0)).sum(axis=0).max(axis=1)
    return row | {"moved": int((moved_m > 0.1).sum())}


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table in Markdown, a line for each kind of run."""
    head = ["run", "starts", "contact", "least gap, m", "longest contact, s", "formed"]
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for kind in dict.fromkeys(row["kind"] for row in rows):
        here = [row for row in rows if row["kind"] == kind]
        cells = [
            kind,
            len(here),
            sum(row["min_gap_m"] < 0 for row in here),
            f"{min(row['min_gap_m'] for row in here):.3f}",
            f"{max(row['contact_s'] for row in here):.1f}",
            sum(row["formed"] for row in here),
        ]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run what the command line asks for; print each row and the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", type=Path, help="add the rows to this file")
    parser.add_argument("--table", type=Path, help="write the table of that file")
    parser.add_argument("--starts", type=int, default=STARTS)
    parser.add_argument("--kind", choices=[*KINDS_OF_RUN], help="this one alone")
    parser.add_argument("--processes", type=int, default=0, help="starts with real processes instead")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if options.json and options.json.exists():
        rows = json.loads(options.json.read_text(encoding="utf-8"))
    kinds = [options.kind] if options.kind else [*KINDS_OF_RUN]
    runs: list[tuple[str, int]] = [(kind, seed) for kind in kinds for seed in range(options.starts)]
    prefix = "processes, " if options.processes else ""
    if options.processes:
        seeds = islice(filter(has_room, count()), options.processes)
        runs = [(options.kind or kinds[0], seed) for seed in seeds]
    done = {(row["kind"], row["seed"]) for row in rows}
    for kind, seed in runs:
        if (prefix + kind, seed) in done:
            continue
        rows.append(run_processes(kind, seed) if options.processes else run_in_memory(kind, seed))
        print(json.dumps(rows[-1]), flush=True)
        if options.json:
            write_text(options.json, json.dumps(rows, indent=1) + "\n")
    if options.table:
        write_text(options.table, table(rows))
    print(table(rows))


if __name__ == "__main__":
    main()
