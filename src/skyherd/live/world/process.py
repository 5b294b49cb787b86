"""Simulated world as a separate process, which replaces the hardware of a lab.

It renders the images of all cameras and streams each as H.264 in FLV over TCP, to one viewer at a time.
Robots and units follow commands from the radio. Wheels have a watchdog like real robots: they stop `HOLD_S`
after the last command. Only this process knows the ground truth, and records it.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from skyherd.datasets import Mission
from skyherd.datasets.random_streams import RunStream, generator
from skyherd.geometry import Image
from skyherd.live.live_clock import LiveClock
from skyherd.live.mailbox import Mailbox, Radio
from skyherd.live.wire import Wheels
from skyherd.live.world.camera_stream import CameraStream
from skyherd.messages import FlightCommand, VelocityCommand
from skyherd.recording.mcap_log import McapLog, Schema
from skyherd.render import Shot
from skyherd.sim.perception import make_renderer
from skyherd.sim.physics import make_world
from skyherd.sim.truth_metrics import TruthObserver

HOLD_S = 0.5
"""Watchdog time of the wheels, s of real time. Chosen: the one of `skyherd.live.drivers`."""

FIRST_PORT = 7461
"""TCP port of the first camera. Chosen: close to the radio's."""

TOPICS: dict[str, Schema] = {
    "/scenario": ("skyherd.WorldScenario", {"type": "object"}),
    "/truth": ("skyherd.WorldTruth", {"type": "object"}),
}
"""Topics of the recording: the scenario, and for each step positions, headings and wheel commands."""


@dataclass
class WheelState:
    """Last command to the wheels of one robot.

    Attributes:
        v_mps: speed, m per second of real time.
        omega_radps: turn rate, rad per second of real time.
        told_s: time of its arrival, on the world's clock; -inf without a command.
    """

    v_mps: float = 0.0
    omega_radps: float = 0.0
    told_s: float = -math.inf


@dataclass
class WorldProcess:
    """World of a mission: it receives commands, advances in time steps, and shows pictures on its streams.

    Attributes:
        mission: the simulated mission.
        speed: seconds of the scenario per second of real time.
        clock: returns the time by which commands age, s.
        mailbox: received messages.
        path: file of the recorded ground truth; None for no recording.
        streams: streams of the cameras, by unit; further cameras are not rendered.
        wheels: last wheel command of each robot, by marker id.
    """

    mission: Mission
    speed: float
    clock: Callable[[], float]
    mailbox: Mailbox
    path: Path | None = None
    streams: Sequence[CameraStream] = ()
    wheels: dict[int, WheelState] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        scenario = self.mission.scenario
        self._world = make_world(self.mission)
        self._observer = TruthObserver(self.mission.template, self.mission.ids)
        self._renderer = make_renderer(self.mission, generator(scenario.seed, RunStream.PERCEPTION))
        self._occluders = [occluder.make() for occluder in scenario.occluders]
        self._time_s, self._images = 0.0, [0] * len(scenario.units)
        self.wheels = {robot: WheelState() for robot in self.mission.ids.tolist()}
        self._log = None if self.path is None else McapLog(self.path, TOPICS)
        self._begun_s: float | None = None
        if self._log is not None:
            self._log.put("/scenario", self.clock(), scenario.model_dump(mode="json"))
            self._log.flush()

    @property
    def time_s(self) -> float:
        """Time of the scenario, s."""
        return self._time_s

    def hear(self) -> None:
        """Process the received wheel and flight commands."""
        for arrival in self.mailbox.fetch():
            message = arrival.envelope.message
            if isinstance(message, Wheels) and message.robot_id in self.wheels:
                state = WheelState(message.v_mps, message.omega_radps, arrival.received_s)
                self.wheels[message.robot_id] = state
            elif isinstance(message, FlightCommand) and 0 <= message.unit_id < len(self._images):
                self._world.fly(self._slowed(message))

    def step(self) -> float:
        """Show the pictures that are due, advance by a time step, and return the shape error before it."""
        scenario, now_s = self.mission.scenario, self.clock()
        self._begun_s = now_s if self._begun_s is None else self._begun_s
        for unit, model in enumerate(scenario.units):
            if self._time_s * model.frame_rate_hz >= self._images[unit] - 1e-9:
                self._images[unit] += 1
                if unit < len(self.streams):
                    self.streams[unit].show(self._picture(unit), now_s - self._begun_s)
        states = [self.wheels[robot] for robot in self.mission.ids.tolist()]
        live = np.array([now_s - state.told_s <= HOLD_S for state in states])
        v_mps = np.where(live, [state.v_mps for state in states], 0.0)
        omega_radps = np.where(live, [state.omega_radps for state in states], 0.0)
        told = VelocityCommand(self.mission.ids, v_mps / self.speed, omega_radps / self.speed)
        shape = self.mission.shape_at(self._time_s, np.arange(self.mission.ids.size))
        metrics = self._observer.observe(self._world.positions_m, {}, (), shape)
        self._record(now_s, v_mps, omega_radps, states, metrics.shape.error)
        self._world.advance(self._world.limit(told), self._time_s, scenario.step_s)
        self._time_s += scenario.step_s
        return float(metrics.shape.error)

    def close(self) -> None:
        """Finish the recording and end the streams."""
        if self._log is not None:
            self._log.close()
        for stream in self.streams:
            stream.close()

    def _picture(self, unit: int) -> Image:
        world, markers = self._world, self._world.markers_facing(unit)
        return self._renderer.render(
            Shot(
                world.cameras[unit],
                world.camera_pose(unit),
                markers.ids,
                markers.positions_m,
                markers.headings_rad,
                motion=world.motion(unit),
                occluders=self._occluders,
                stream=unit,
                frames=markers.frames,
            )
        )

    def _slowed(self, command: FlightCommand) -> FlightCommand:
        """Return a flight command whose rates are per second of the scenario."""
        share = 1 / self.speed
        return replace(
            command,
            lateral_mps=command.lateral_mps * share,
            climb_mps=command.climb_mps * share,
            yaw_rate_radps=command.yaw_rate_radps * share,
            zoom_rate_ps=command.zoom_rate_ps * share,
        )

    def _record(
        self,
        now_s: float,
        v_mps: np.ndarray,
        omega_radps: np.ndarray,
        states: Sequence[WheelState],
        error: float,
    ) -> None:
        if self._log is None:
            return
        record: dict[str, Any] = {
            "now_s": now_s,
            "time_s": self._time_s,
            "positions_m": self._world.positions_m,
            "headings_rad": self._world.headings_rad,
            "v_mps": v_mps,
            "omega_radps": omega_radps,
            "told_age_s": [now_s - state.told_s if state.told_s > -math.inf else None for state in states],
            "shape_error": error,
        }
        self._log.put("/truth", now_s, record)
        self._log.flush_when_due(now_s, now_s + self.mission.scenario.step_s / self.speed)


def run_world(
    mission: Mission,
    radio: Radio,
    *,
    team: str,
    speed: float,
    path: Path | None,
    first_port: int = FIRST_PORT,
    tell: Callable[[str], None] = lambda line: None,
    ended: Callable[[], bool] = lambda: False,
) -> None:
    """Run the world of a mission for the scenario's duration, at a multiple of real time.

    Each step takes `step_s / speed` of real time. On a slower machine the world falls behind, and reports the
    number of late steps.

    Args:
        mission: the simulated mission.
        radio: radio of the commands.
        team: team whose commands the world follows.
        speed: seconds of the scenario per second of real time.
        path: file of the recorded ground truth; None for no recording.
        first_port: TCP port of the first camera; further cameras use the next ports.
        tell: called with each status line.
        ended: called before each step; True ends the world.
    """
    clock = LiveClock()
    scenario = mission.scenario
    mailbox = Mailbox(radio, team, "world", clock, ("wheels/**", "flight/**"), tell)
    streams = [
        CameraStream(model.camera.size_px, model.frame_rate_hz * speed, first_port + unit)
        for unit, model in enumerate(scenario.units)
    ]
    world = WorldProcess(mission, speed, clock, mailbox, path, streams)
    period_s = scenario.step_s / speed
    tell("cameras at " + " ".join(f"tcp://127.0.0.1:{stream.port}" for stream in streams))
    next_s, told_s, late = time.monotonic(), -math.inf, 0
    try:
        while world.time_s <= scenario.duration_s and not ended():
            world.hear()
            error = world.step()
            now_s = time.monotonic()
            next_s += period_s
            if now_s > next_s:
                late, next_s = late + 1, now_s
            if now_s - told_s >= 5.0:
                told_s = now_s
                tell(
                    f"{world.time_s:6.1f} s  shape error {error:.4f}" + (f"  {late} steps late" * bool(late))
                )
            while (left_s := next_s - time.monotonic()) > 0:
                time.sleep(min(left_s, 0.05))
                world.hear()
        tell(f"{world.time_s:6.1f} s  shape error {error:.4f}  over; {late} steps late")
    finally:
        world.close()
