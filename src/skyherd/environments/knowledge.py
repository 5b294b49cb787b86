"""Data that observations may use: the last image of each unit, and the messages that robots received.

Neither contains the true state, except for some fields of `Sight`, which are not copied here.
"""

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from skyherd.control import GoalFollowers
from skyherd.datasets import Mission
from skyherd.geometry import Array, Image, IntArray
from skyherd.loop import Step, UnitFrame
from skyherd.messages import Detections, VelocityCommand


@dataclass(frozen=True)
class Cast:
    """Robots, obstacles and cameras of a mission, which fix the shapes of observations.

    Attributes:
        robot_ids: (N,) robots, ascending.
        marker_ids: (M,) robots, then obstacles, each ascending.
        image_sizes_px: width and height of each unit's image.
        has_bodies: whether units report bodies near the robots.
    """

    robot_ids: IntArray
    marker_ids: IntArray
    image_sizes_px: tuple[tuple[int, int], ...]
    has_bodies: bool

    @classmethod
    def of(cls, mission: Mission) -> Self:
        """Return the cast of a mission."""
        return cls(
            mission.ids,
            np.concatenate([mission.ids, mission.obstacle_ids]),
            tuple(unit.camera.size_px for unit in mission.scenario.units),
            mission.scenario.avoidance.on,
        )


@dataclass(frozen=True)
class View:
    """Last image of a unit.

    Attributes:
        detections: detections, as the detector returned them.
        image: the grey picture; None without rendering.
        accepted: detections that the unit's controller uses, rectified.
        controlled_ids: robots that the unit controls.
    """

    detections: Detections
    image: Image | None
    accepted: Detections
    controlled_ids: IntArray

    @classmethod
    def of(cls, frame: UnitFrame) -> Self:
        """Return the view of a unit's frame, without its ground truth."""
        decision = frame.decision
        return cls(
            frame.sight.detections,
            frame.sight.image,
            decision.detections,
            decision.report.controlled_ids,
        )


@dataclass
class Knowledge:
    """Knowledge of all agents at a time.

    Attributes:
        team: the robots' memory of received messages.
        rates: (N, 2) last commands of the robots, as shares of the limits of the wheels.
        views: last image of each living unit that has taken one.
        time_s: the time.
    """

    team: GoalFollowers
    rates: Array
    views: dict[int, View] = field(default_factory=dict)
    time_s: float = 0.0

    def update(self, step: Step, dead: list[int]) -> None:
        """Take in the images of a step.

        The robots' memory contains the order of the paper's law for the motion after the step. Wheels may
        obey another order, which is not known yet. Until then the robots are recorded at rest.
        """
        self.views |= {unit: View.of(frame) for unit, frame in step.frames.items()}
        for unit in dead:
            self.views.pop(unit, None)
        self.time_s, ids = step.time_s, step.command.ids
        self.team.record(VelocityCommand(ids, np.zeros(ids.size), np.zeros(ids.size)), step.time_s)
