"""Folders of live runs with known times, written by the process logs of units and robots."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from skyherd.live.lab import Lab, make_lab
from skyherd.live.logs.process_log import ProcessLog
from skyherd.live.logs.view import View
from skyherd.live.mailbox import Arrival
from skyherd.live.robot_core import Order
from skyherd.live.wire import Envelope, Heartbeat
from skyherd.messages import Detections, MotionGoals

BEGUN_S = 1.7e9
"""Start of the run on the unit's clock, s since 1970."""


def small_lab(robots: int = 3, cameras: int = 1) -> Lab:
    """Return a lab of a few robots."""
    return make_lab(
        {
            "team": "small",
            "shape": {"shape": "circle"},
            "markers": {"side_m": 0.1},
            "cameras": [{"address": "/dev/video0"}] * cameras,
            "robots": [{"id": robot} for robot in range(robots)],
        }
    )


@dataclass
class Script:
    """Scripted run of one unit and its robots, with known times.

    Attributes:
        lab: the lab.
        images: number of images.
        step_s: time between two images.
        clock_offset_s: lead of the robots' clocks over the unit's.
        compared: whether heartbeats compare the clocks.
        first_s: time of the first image since the start.
        pause_s: additional time before the middle image.
        seed: seed of the random times.
        stages_s: (images, 4) durations from capture to arrival, begin, found and sent.
        radio_s: (images, robots) durations from sent to the robot.
        command_s: (images, robots) durations from there to the robot's next decision.
        reasons: stop reason at each image, by robot; default `driving`.
    """

    lab: Lab = field(default_factory=small_lab)
    images: int = 40
    step_s: float = 0.2
    clock_offset_s: float = 0.0
    compared: bool = True
    first_s: float = 0.0
    pause_s: float = 0.0
    seed: int = 0
    reasons: dict[int, list[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        robots = len(self.lab.ids)
        self.stages_s = rng.uniform(0.001, 0.02, (self.images, 4))
        self.radio_s = rng.uniform(0.001, 0.01, (self.images, robots))
        self.command_s = rng.uniform(0.001, 0.04, (self.images, robots))

    @property
    def captured_s(self) -> np.ndarray:
        number = np.arange(self.images)
        return BEGUN_S + self.first_s + self.step_s * number + self.pause_s * (number >= self.images // 2)

    @property
    def passed_s(self) -> np.ndarray:
        """Return times (images, 5) by the unit's clock: captured, arrived, begun, found, sent."""
        return self.captured_s[:, None] + np.insert(np.cumsum(self.stages_s, axis=1), 0, 0.0, axis=1)

    @property
    def received_s(self) -> np.ndarray:
        """Return times of reception (images, robots) by the unit's clock."""
        return self.passed_s[:, 4:] + self.radio_s

    @property
    def commanded_s(self) -> np.ndarray:
        """Return times of commands (images, robots) by the unit's clock."""
        return self.received_s + self.command_s

    def places_px(self, image: int) -> np.ndarray:
        """Return the robots' positions in an image, (robots, 2), px."""
        angle = 2 * np.pi * np.arange(len(self.lab.ids)) / len(self.lab.ids)
        return 320 + (200 - image) * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def goals(self, image: int) -> MotionGoals:
        """Return the goals that follow from an image."""
        ids = np.array(self.lab.ids)
        ones = np.ones(ids.size)
        near = np.full((ids.size, 1), -1)
        return MotionGoals(
            unit_id=0,
            time_s=float(self.captured_s[image]),
            ids=ids,
            rho_px=ones,
            bearings_rad=0 * ones,
            sides_px=20 * ones,
            neighbor_ids=near,
            neighbor_distances_px=0.0 * near,
        )

    def write(self, folder: Path) -> Path:
        """Write the files of the unit and of all robots into a new folder."""
        folder.mkdir(parents=True, exist_ok=True)
        with ProcessLog(folder / "unit_0.mcap", "unit/0", self.lab, BEGUN_S) as process_log:
            for image in range(self.images):
                self.write_image(process_log, image)
            process_log.put(
                "/heartbeat", float(self.passed_s[-1, 4]), {"refused": {"not JSON": 3}, "dropped": 1}
            )
            process_log.put("/end", float(self.passed_s[-1, 4]), {})
        for row, robot in enumerate(self.lab.ids):
            begun_s = BEGUN_S + self.clock_offset_s
            with ProcessLog(
                folder / f"robot_{robot}.mcap", f"robot/{robot}", self.lab, begun_s
            ) as process_log:
                for image in range(self.images):
                    self.write_decision(process_log, image, row, robot)
                process_log.put("/end", float(self.commanded_s[-1, row] + self.clock_offset_s), {})
        return folder

    def write_image(self, process_log: ProcessLog, image: int) -> None:
        """Write the unit's records of an image."""
        captured_s, arrived_s, begun_s, found_s, sent_s = self.passed_s[image].tolist()
        ids, centers = np.array(self.lab.ids), self.places_px(image)
        square = np.array([[-10, -10], [10, -10], [10, 10], [-10, 10]])
        detections = Detections(
            unit_id=0,
            time_s=captured_s,
            image_size_px=np.array([640, 640]),
            ids=ids,
            centers_px=centers,
            headings_rad=np.zeros(ids.size),
            sides_px=np.full(ids.size, 20.0),
            corners_px=centers[:, None] + square,
            covariances=np.zeros((ids.size, 3, 3)),
        )
        process_log.saw(detections, found_s)
        process_log.put("/sent", sent_s, {"messages": None})
        process_log.keep("/view", sent_s, View(captured_s, ids, centers + 5, 0.5 * 0.9**image, ids.size))
        stages = {
            "captured_s": captured_s,
            "arrived_s": arrived_s,
            "begun_s": begun_s,
            "found_s": found_s,
            "sent_s": sent_s,
            "stamped_by": "stream",
            "number": image,
            "dropped": 0,
        }
        process_log.put("/stages", sent_s, stages)

    def write_decision(self, process_log: ProcessLog, image: int, row: int, robot: int) -> None:
        """Write a robot's records of an image: a heartbeat of the unit, its goals, and a decision.

        Heartbeats have no latency in either direction, so that the clock offset is known exactly.
        """
        name, offset_s = f"robot/{robot}", self.clock_offset_s
        unit_s = float(self.captured_s[image])
        heartbeat = Heartbeat({name: (unit_s + offset_s, unit_s)} if self.compared else {})
        process_log.heard(Arrival(Envelope("unit/0", unit_s, heartbeat), unit_s + offset_s))
        sent_s, received_s = float(self.passed_s[image, 4]), float(self.received_s[image, row]) + offset_s
        process_log.heard(Arrival(Envelope("unit/0", sent_s, self.goals(image)), received_s))
        now_s = float(self.commanded_s[image, row]) + offset_s
        reason = self.reasons.get(robot, ["driving"] * self.images)[image]
        speed = 0.1 * (reason == "driving")
        order = Order(speed, 0.0, reason, wanted_v_mps=0.0, wanted_omega_radps=0.0)
        age_s = now_s - float(self.captured_s[image]) - offset_s
        decided = {"order": order, "armed": speed > 0, "image_age_s": age_s, "trouble": None}
        process_log.put("/decide", now_s, decided)
        process_log.put("/heartbeat", now_s, {"refused": {}, "dropped": 0})
