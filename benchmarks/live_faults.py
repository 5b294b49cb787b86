"""Measure the behaviour of live processes under faults: each fault ten times, judged at the wheels.

    python benchmarks/live_faults.py --json faults.json --table docs/live/faults.md

The processes' own cores run in one process and in simulated time, each with a clock of its own, over a radio
in memory. The code between camera, radio and driver is the code of the real processes. Each fault has an
exact place and time, in ten runs with different times and starts. The world is the scenario `triangle` on
exact points: one unit, six robots, ten images a second.

Columns:

- `longest blind s`: longest time that a wheel turned after the newest image that its robot had a goal from.
  The limit is `goal_timeout_s` and one period.
- `after a stop s`: longest time from a stop, or from the first heartbeats of a second team, to the last turn
  of a wheel, until an arm command. It has the same limit. `-` without a stop.
- `after waking`: runs in which a wheel of a robot that was frozen during the stop turned after it woke up.
- `moved off`: runs in which a limit was exceeded or such a wheel turned.
- `formed`: runs whose shape error was below 2 % at the end.
"""

import argparse
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from skyherd.datasets import load_mission
from skyherd.files.atomic import write_text
from skyherd.live import operator, robot_process, unit_process
from skyherd.live.lab import Lab, load_lab
from skyherd.live.mailbox import Air, Mailbox, MemoryRadio
from skyherd.live.robot_core import RobotCore
from skyherd.live.session import Session
from skyherd.live.stop_latch import NOT_HALTED
from skyherd.live.unit_core import UnitCore
from skyherd.live.wire import MAX_BYTES, VERSION, Heartbeat
from skyherd.messages import Detections, VelocityCommand
from skyherd.sim.physics import make_world
from skyherd.sim.projected_perception import ProjectedPerception
from skyherd.sim.truth_metrics import TruthObserver

PERIOD_S = 0.1
TIMES = 10
FAULT_S = 20.0
DURATION_S = 30.0
HEARTBEAT_STEPS = 3
HOLD_S = 0.5
FORMED = 0.02
KINDS = {
    "unit": unit_process.HEARS,
    "robot": robot_process.HEARS,
}


@dataclass
class Process:
    """One live process: its core, its mailbox, and its clock.

    Attributes:
        name: such as `robot/3`.
        core: of a unit or a robot.
        mailbox: its messages.
        offset_s: what its clock shows more than the world's.
        dead_until_s: it is killed until then.
        frozen_until_s: it is suspended until then; messages wait for it.
        told: reasons that it gave, in order, each once in a row.
        state: reason of a robot's last decision, which its heartbeats carry.
    """

    name: str
    core: Any
    mailbox: Mailbox
    radio: MemoryRadio
    offset_s: float = 0.0
    dead_until_s: float = -1.0
    frozen_until_s: float = -1.0
    told: list[str] = field(default_factory=list)
    state: str = ""

    def say(self, line: str) -> None:
        """Record a line unless it equals the last one."""
        if not self.told or self.told[-1] != line:
            self.told.append(line)


class Team:
    """A live team in memory, in simulated time, over a radio that can be made to fail.

    Attributes:
        now_s: the world's time.
        processes: by name.
        air: the radio.
        lab: the set-up.
        blind_s: by robot, the longest time that its wheels turned after its newest image.
        errors: shape error at each step.
        stopped_s: when the team was stopped; None if it was not, or was armed since.
        turned_s: longest time from a stop to the last turn of a wheel.
        woke: robots that were frozen when the stop came, with the times at which they woke up.
        turned_after_waking: whether a wheel of one of these turned after it woke up.
        see: filters the time at which an image seems to be taken; None loses the image.
        delay_s: delay of the images that their times do not show, as of a stream without a clock.
        driven: by robot, the one whose wheels its driver turns; a robot that is left out turns none.
    """

    def __init__(
        self,
        lab: Lab,
        settings: list[str],
        seed: int,
        air: Air | None = None,
        scenario_name: str = "triangle",
    ) -> None:
        self.lab = lab
        self.mission = load_mission(
            scenario_name, ["perception=ideal", "units.*.tilt_deg=[3.0,2.0]", *settings], seed=seed
        )
        scenario = self.mission.scenario
        self.world = make_world(self.mission)
        rng = np.random.default_rng(seed)
        self.world.headings_rad += rng.uniform(-1, 1, self.mission.ids.size)
        self.perception = ProjectedPerception(scenario.marker.side_m, scenario.marker.dictionary)
        self.observer = TruthObserver(self.mission.template, self.mission.ids)
        self.air = air or Air(now_s=1000.0)
        self.now_s, self.start_s, self._step = 1000.0, 1000.0, 0
        self.offsets: dict[str, float] = {}
        self.processes: dict[str, Process] = {}
        for unit in range(len(lab.model.cameras)):
            self.start(f"unit/{unit}")
        for robot in lab.ids:
            self.start(f"robot/{robot}")
        self.operator = operator.watch(lab, self.air.radio("operator"), lambda: self.now_s)
        self._arming: tuple[operator.ArmCommand, float] | None = None
        self._stopping: operator.StopCommand | None = None
        self.session: Session | None = None
        self.stopped_s: float | None = None
        self.turned_s: float | None = None
        self.woke: dict[int, float] = {}
        self.turned_after_waking = False
        self.wheels = {robot: (0.0, 0.0, -np.inf) for robot in lab.ids}
        self.imaged_s = dict.fromkeys(lab.ids, -np.inf)
        self.blind_s = dict.fromkeys(lab.ids, 0.0)
        self.errors: list[float] = []
        self.armed_s: float | None = 2.0
        self.see: Callable[[int, float], float | None] = lambda unit, time_s: time_s
        self.delay_s = 0.0
        self._images: dict[int, list[Detections]] = {}
        self.driven = {robot: robot for robot in lab.ids}

    def start(self, name: str) -> Process:
        """Start a process, or restart it without memory."""
        kind, number = name.split("/")
        if name in self.processes:
            self.processes[name].radio.close()
        radio = self.air.radio(name)
        process = Process(name, None, None, radio, self.offsets.get(name, 0.0))  # type: ignore[arg-type]
        process.mailbox = Mailbox(
            radio,
            self.lab.model.team,
            name,
            lambda: self.now_s + process.offset_s,
            KINDS[kind] if kind == "unit" else (*KINDS[kind], f"heartbeat/{name}"),
            process.say,
            lambda: process.core.latch,
        )
        process.core = getattr(self.lab, f"make_{kind}")(int(number))
        self.processes[name] = process
        return process

    def kill(self, name: str, for_s: float) -> None:
        """Kill a process; it restarts after a while."""
        self.start(name).dead_until_s = self.now_s + for_s

    def freeze(self, name: str, for_s: float) -> None:
        """Suspend a process. The messages that are sent to it meanwhile arrive when it wakes up."""
        self.processes[name].frozen_until_s = self.now_s + for_s

    def stop(self) -> None:
        """Stop the team, as `skyherd live stop` does."""
        self._stopping = operator.StopCommand(self.lab, self.operator, "test")
        self._arming = None
        self.stopped_s, self.turned_s = self.now_s, 0.0
        for robot in self.lab.ids:
            if self.processes[f"robot/{robot}"].frozen_until_s > self.now_s:
                self.woke[robot] = self.processes[f"robot/{robot}"].frozen_until_s

    def use_session(self, *, arms: bool) -> None:
        """Let the operator of `skyherd live run` take part, instead of `armed_s`."""
        self.armed_s = None
        watched = operator.watch(self.lab, self.air.radio("session"), lambda: self.now_s, "session")
        self.session = Session(self.lab, watched, lambda name, line: None, arms=arms)

    @property
    def time_s(self) -> float:
        """Return the time since the start, s."""
        return self.now_s - self.start_s

    def step(self) -> None:
        """Run one time step of a tenth of a second."""
        self.air.advance(self.now_s)
        self._command()
        for process in self.processes.values():
            self.air.advance(self.now_s)
            clock_s = self.now_s + process.offset_s
            if self.now_s < process.dead_until_s:
                list(process.mailbox.fetch())
                continue
            if self.now_s < process.frozen_until_s:
                continue
            for arrival in process.mailbox.fetch():
                # A suspended process stamps what waited for it when it wakes up.
                received_s = max(arrival.received_s, process.frozen_until_s + process.offset_s)
                process.core.receive(arrival.envelope, received_s)
            if isinstance(process.core, UnitCore):
                self._look(process, clock_s)
            else:
                self._drive(process, clock_s)
            if self._step % HEARTBEAT_STEPS == 0:
                process.mailbox.send(self._heartbeat(process, clock_s))
        self._move()
        self._step += 1
        self.now_s = self.start_s + self._step * PERIOD_S

    def _command(self) -> None:
        """Arm all robots once, as `skyherd live arm` does: repeat the command for 3 s."""
        self.operator.listen(0.0)
        if self.session is not None:
            self.session.step("", 0.0)
        if self._stopping is not None and self._stopping.advance():
            self._stopping = None
        if self.armed_s is not None and self.time_s >= self.armed_s:
            self._arming = operator.ArmCommand(self.lab, self.operator), self.time_s + 3.0
            self.armed_s = self.stopped_s = None
            self.woke = {}
        if self._arming is not None and self.time_s < self._arming[1]:
            self._arming[0].advance()

    def _heartbeat(self, process: Process, clock_s: float) -> Heartbeat:
        """Return a heartbeat; the links of these robots take every command at once."""
        core = process.core
        if isinstance(core, UnitCore):
            return core.heartbeat(clock_s, "")
        stands = not any(self.wheels.get(core.robot_id, (0.0, 0.0))[:2])
        return core.heartbeat(clock_s, process.state, core.latch.stop if stands else NOT_HALTED)

    def _look(self, process: Process, clock_s: float) -> None:
        unit = process.core.unit_id
        taken_s = self.see(unit, clock_s)
        if taken_s is None:
            return
        images = self._images.setdefault(unit, [])
        images.append(self.perception.look(self.world, [unit], taken_s)[0].detections)
        shown = images[max(len(images) - 1 - round(self.delay_s / PERIOD_S), 0)]
        news = process.core.see(replace(shown, time_s=taken_s), clock_s)
        if process.core.trouble:
            process.say(process.core.trouble)
        if news is None:
            return
        for message in news.messages:
            process.mailbox.send(message)
        self.world.fly(news.decision.flight)

    def _drive(self, process: Process, clock_s: float) -> None:
        core: RobotCore = process.core
        order = core.decide(clock_s)
        process.state = order.reason
        process.say(order.reason)
        self.wheels[core.robot_id] = order.v_mps, order.omega_radps, self.now_s
        age_s = core.image_age_s(clock_s)
        if age_s is not None:
            self.imaged_s[core.robot_id] = self.now_s - age_s

    def _move(self) -> None:
        """Move robots by their last command, unless it is older than the keep-alive."""
        told = dict.fromkeys(self.lab.ids, (0.0, 0.0))
        for robot, (v_mps, omega_radps, told_s) in self.wheels.items():
            live = self.now_s - told_s <= HOLD_S
            if live and robot in self.driven:
                told[self.driven[robot]] = v_mps, omega_radps
            if live and (v_mps or omega_radps):
                blind_s = self.now_s - self.imaged_s[robot]
                self.blind_s[robot] = max(self.blind_s[robot], blind_s)
                if self.stopped_s is not None:
                    self.turned_s = max(self.turned_s or 0.0, self.now_s - self.stopped_s)
                self.turned_after_waking |= self.now_s >= self.woke.get(robot, np.inf)
        command = VelocityCommand(np.array(self.lab.ids), *np.array(list(told.values())).T)
        metrics = self.observer.observe(self.world.positions_m, {}, (), self.mission.template)
        self.errors.append(metrics.shape.error)
        self.world.advance(self.world.limit(command), self.time_s, PERIOD_S)


Fault = Callable[[Team, np.random.Generator, float], None]


def unit_killed(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Kill the unit; it restarts after three seconds."""
    if abs(team.time_s - at_s) < PERIOD_S / 2:
        team.kill("unit/0", 3.0)


def robot_killed(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Kill a robot's process; it restarts after two seconds and is armed again ten seconds later."""
    if abs(team.time_s - at_s) < PERIOD_S / 2:
        team.kill(f"robot/{rng.integers(6)}", 2.0)
    if abs(team.time_s - at_s - 10.0) < PERIOD_S / 2:
        team.armed_s = team.time_s


def stream_stalls(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Hold back all pictures for three seconds."""
    team.see = lambda unit, time_s: None if at_s <= team.time_s < at_s + 3.0 else time_s


def stream_repeats(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Repeat earlier pictures with their old stamps for three seconds."""
    frozen_s = team.start_s + at_s
    team.see = lambda unit, time_s: frozen_s if at_s <= team.time_s < at_s + 3.0 else time_s


def stream_late(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Delay pictures by two seconds, for five seconds."""
    team.see = lambda unit, time_s: time_s - 2.0 * (at_s <= team.time_s < at_s + 5.0)


def messages_lost(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Lose 30 % of all messages and delay the others by up to 0.2 s, for the rest of the run."""
    if abs(team.time_s - at_s) < PERIOD_S / 2:
        team.air.drop = lambda topic, receiver: bool(rng.random() < 0.3)
        team.air.delay_s = lambda topic, receiver: float(rng.uniform(0, 0.2))


def clock_off(offset_s: float) -> Fault:
    """Start with an offset of the unit's clock."""

    def fault(team: Team, rng: np.random.Generator, at_s: float) -> None:
        if team.time_s < PERIOD_S / 2:
            team.processes["unit/0"].offset_s = offset_s * (1 if rng.random() < 0.5 else -1)

    fault.__doc__ = f"Start with an offset of {offset_s:g} s of the unit's clock."
    return fault


def clock_set(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Set the unit's clock by 20 s."""
    if abs(team.time_s - at_s) < PERIOD_S / 2:
        team.processes["unit/0"].offset_s += 20.0 * (1 if rng.random() < 0.5 else -1)


def partition(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Block all messages between the unit and the robots for ten seconds."""
    team.air.drop = lambda topic, receiver: at_s <= team.time_s < at_s + 10.0


def two_teams(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Let another team's unit of the same number send to all topics, under its own name."""
    if not hasattr(team, "other"):
        team.other = team.air.radio("other")  # type: ignore[attr-defined]
        team.heard = []  # type: ignore[attr-defined]
        team.other.subscribe("skyherd/*/goals/**", team.heard.append)  # type: ignore[attr-defined]
    for data in team.heard[-1:]:  # type: ignore[attr-defined]
        ours = f'"team":"{team.lab.model.team}"'.encode()
        team.other.publish("skyherd/others/goals/unit/0", data.replace(ours, b'"team":"others"'))  # type: ignore[attr-defined]


def missed_stop(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Suspend a robot while the team is stopped, and wake it up one to four seconds later.

    Every other time the messages that were sent to it meanwhile are lost.
    """
    if abs(team.time_s - at_s) < PERIOD_S / 2:
        name, for_s = f"robot/{rng.integers(6)}", round(float(rng.uniform(1.0, 4.0)), 1)
        team.freeze(name, for_s)
        if rng.random() < 0.5:
            team.air.drop = lambda topic, receiver: receiver == name and team.time_s < at_s + for_s
    if abs(team.time_s - at_s - 0.5) < PERIOD_S / 2:
        team.stop()


def stop_lost(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Withhold all messages from a robot for three seconds, in which the team is stopped."""
    if abs(team.time_s - at_s) < PERIOD_S / 2:
        deaf = f"robot/{rng.integers(6)}"
        team.air.drop = lambda topic, receiver: receiver == deaf and team.time_s < at_s + 3.0
        team.stop()


def pending_arm(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Suspend a robot while `live run --arm` starts, and stop the team before it wakes up."""
    if team.time_s < PERIOD_S / 2:
        team.use_session(arms=True)
        team.freeze(f"robot/{rng.integers(6)}", at_s + round(float(rng.uniform(1.0, 4.0)), 1))
    if abs(team.time_s - at_s) < PERIOD_S / 2:
        team.stop()


def second_team(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Start a second, disarmed team of the same name: both stand still and say so."""
    if abs(team.time_s - at_s) < PERIOD_S / 2:
        other = Team(team.lab, [], int(rng.integers(100)) + 100, team.air)
        other.armed_s = None
        team.second = other  # type: ignore[attr-defined]
        # The robots drive until they hear the first heartbeats of the others.
        team.stopped_s, team.turned_s = team.now_s + HEARTBEAT_STEPS * PERIOD_S, 0.0
    if (second := getattr(team, "second", None)) is not None:
        second.now_s = team.now_s
        second.step()
        if any(v_mps or omega_radps for v_mps, omega_radps, _ in second.wheels.values()):
            team.turned_after_waking = True


def garbage(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Send bytes of all kinds, up to twice the largest size, to every topic."""
    radio = getattr(team, "noise", None) or team.air.radio("noise")
    team.noise = radio  # type: ignore[attr-defined]
    name = team.lab.model.team
    samples = [
        rng.bytes(100),
        b"[]",
        b"null",
        json.dumps(
            {"team": name, "version": VERSION, "sender": "unit/0", "sent_s": 1e308, "kind": "goals"}
        ).encode(),
        json.dumps(
            {
                "team": name,
                "version": VERSION,
                "sender": "unit/0",
                "sent_s": 5.0,
                "kind": "goals",
                "body": {"ids": 3},
            }
        ).encode(),
        json.dumps({"team": name, "version": 9, "sender": "x", "sent_s": 5.0, "kind": "stop"}).encode(),
        b"{" * 10_000,
    ]
    if rng.random() < 0.02:
        samples.append(b"x" * (2 * MAX_BYTES))
    data = samples[int(rng.integers(len(samples)))]
    for topic in ("goals/unit/0", "sighting/unit/0", "heartbeat/unit/0", "report/unit/1", "arm/x", "stop/x"):
        radio.publish(f"skyherd/{name}/{topic}", data)


def nothing(team: Team, rng: np.random.Generator, at_s: float) -> None:
    """Run without a fault."""


FAULTS: dict[str, Fault] = {
    "none": nothing,
    "unit killed": unit_killed,
    "robot killed": robot_killed,
    "stream stalls 3 s": stream_stalls,
    "stream repeats": stream_repeats,
    "stream 2 s late": stream_late,
    "30 % lost": messages_lost,
    "clock 0.2 s off": clock_off(0.2),
    "clock 2 s off": clock_off(2.0),
    "clock 20 s off": clock_off(20.0),
    "clock set by 20 s": clock_set,
    "partition 10 s": partition,
    "two teams": two_teams,
    "missed stop": missed_stop,
    "stop lost": stop_lost,
    "pending arm": pending_arm,
    "second team of one name": second_team,
    "garbage": garbage,
}


def run(fault: str, seed: int, duration_s: float = DURATION_S) -> dict[str, Any]:
    """Run once with one fault and return the row."""
    rng = np.random.default_rng([seed, 20])
    lab = load_lab("triangle", ["control.k=0.3", "control.k_omega=1.2"])
    team = Team(lab, [], seed)
    at_s = round(float(rng.uniform(0.2, 0.5)) * FAULT_S, 1)
    for _ in range(round(duration_s / PERIOD_S)):
        FAULTS[fault](team, rng, at_s)
        team.step()
    limit_s = lab.model.limits.goal_timeout_s + PERIOD_S + 1e-9
    blind_s, turned_s = max(team.blind_s.values()), team.turned_s
    told: list[str] = []
    for process in team.processes.values():
        told += [f"{process.name.split('/')[0]}: {line}" for line in process.told]
    return {
        "fault": fault,
        "seed": seed,
        "blind_s": blind_s,
        "turned_s": turned_s,
        "woke": team.turned_after_waking,
        "exceeded": blind_s > limit_s or (turned_s or 0.0) > limit_s or team.turned_after_waking,
        "error": team.errors[-1],
        "formed": team.errors[-1] < FORMED,
        "refused": sum(sum(p.mailbox.refusals.counts.values()) for p in team.processes.values()),
        "told": sorted(set(told)),
    }


def longest_after_stop(rows: list[dict[str, Any]]) -> str:
    """Return the longest time that a wheel turned after a stop, or a dash where there was none."""
    times_s = [row["turned_s"] for row in rows if row["turned_s"] is not None]
    return f"{max(times_s):.2f}" if times_s else "-"


STOP_COLUMNS: dict[str, Callable[[list[dict[str, Any]]], Any]] = {
    "after a stop, s": longest_after_stop,
    "after waking": lambda here: sum(row["woke"] for row in here),
}
"""Columns of a table about stops."""


def table(rows: list[dict[str, Any]]) -> str:
    """Return a Markdown table with one line a fault."""
    return fault_table(
        rows,
        {
            "longest blind, s": lambda here: f"{max(row['blind_s'] for row in here):.2f}",
            **STOP_COLUMNS,
            "moved off": lambda here: sum(row["exceeded"] for row in here),
            "formed": lambda here: sum(row["formed"] for row in here),
            "messages refused": lambda here: sum(row["refused"] for row in here),
        },
    )


def fault_table(rows: list[dict[str, Any]], entries: dict[str, Callable[[list[dict[str, Any]]], Any]]) -> str:
    """Return a Markdown table with one line a fault, by a function of its rows for each heading."""
    by_fault: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        by_fault.setdefault(row["fault"], []).append(row)
    lines = ["| " + " | ".join(["fault", "runs", *entries]) + " |", "|---" * (2 + len(entries)) + "|"]
    for fault, here in by_fault.items():
        cells = [fault, len(here), *(entry(here) for entry in entries.values())]
        lines.append("| " + " | ".join(str(cell) for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def measure(
    description: str | None,
    faults: Iterable[str],
    run: Callable[[str, int], dict[str, Any]],
    table: Callable[[list[dict[str, Any]]], str],
) -> None:
    """Run each fault as often as the command line says, and write and print the results."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--table", type=Path)
    parser.add_argument("--times", type=int, default=TIMES)
    parser.add_argument("--fault", choices=[*faults], help="this one alone")
    parser.add_argument("--go-on", action="store_true", help="run what the JSON file does not have yet")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if options.go_on and options.json and options.json.exists():
        rows = json.loads(options.json.read_text(encoding="utf-8"))
    done = {(row["fault"], row["seed"]) for row in rows}
    for seed in range(options.times):
        for fault in [options.fault] if options.fault else faults:
            if (fault, seed) in done:
                continue
            rows.append(run(fault, seed))
            print(json.dumps(rows[-1]), flush=True)
            if options.json:
                write_text(options.json, json.dumps(rows, indent=1) + "\n")
    if options.table:
        write_text(options.table, table(rows))
    print(table(rows))


if __name__ == "__main__":
    measure(__doc__, FAULTS, run, table)
