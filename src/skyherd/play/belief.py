"""What one unit saw and aims at, placed on the ground beside the truth.

A unit knows no metres, place or direction: its knowledge is a flat picture of any size. For people, the
similarity that fits the robots in this picture best to their true places puts it on the ground. The
distances that remain are the unit's errors: noise, latency, and tilt unless it rectifies.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from skyherd.analysis.goal_points import rectified_goals_px, rectified_outline_px, rows_of
from skyherd.control import fit_similarity
from skyherd.datasets import Mission
from skyherd.errors import DegenerateSetError
from skyherd.geometry import Array, ComplexArray, to_complex, to_points
from skyherd.loop import Step, UnitFrame
from skyherd.play.buttons import Controls

NOBODY = "nobody"
"""Choice of no unit."""


@dataclass(frozen=True)
class Belief:
    """Knowledge of one unit, on the ground.

    Attributes:
        seen_m: (N, 2) places of the robots that it saw.
        starts_m: (G, 2) places of the robots with a goal.
        goals_m: (G, 2) their goals.
        outline_m: lines (M, 2) of the shape that it aims at.
    """

    seen_m: Array
    starts_m: Array
    goals_m: Array
    outline_m: list[Array]


def belief_of(frame: UnitFrame, step: Step, mission: Mission) -> Belief | None:
    """Return the knowledge of a unit after an image; None if it saw fewer than two robots.

    Args:
        frame: image and decision of the unit.
        step: the step of the image.
        mission: the mission.
    """
    decision = frame.decision
    robots = decision.detections.select(mission.ids)
    if len(robots) < 2:
        return None
    rows = np.searchsorted(mission.ids, robots.ids)
    try:
        # The ground's frame is mirrored against the image's.
        fit = fit_similarity(to_complex(robots.centers_px).conj(), to_complex(step.positions_m)[rows])
    except DegenerateSetError:
        return None

    def on_ground(points_px: Array) -> Array:
        return to_points(fit(to_complex(points_px).conj()))

    goals = decision.goals
    starts_px = np.zeros((0, 2))
    if goals is not None:
        starts_px = decision.detections.centers_px[rows_of(decision.detections, goals.ids)]
    shape = mission.shape_at(step.time_s, step.roles)
    lines: list[ComplexArray] = list(mission.outline_at(step.time_s))
    return Belief(
        on_ground(robots.centers_px),
        on_ground(starts_px),
        on_ground(rectified_goals_px(decision)),
        [on_ground(line) for line in rectified_outline_px(decision, shape, lines)],
    )


class BeliefChoice:
    """Choice of the unit whose knowledge is shown. It is added to the container that is open.

    Args:
        controls: maker of controls.
        units: number of units.
    """

    def __init__(self, controls: Controls, units: int) -> None:
        names = [NOBODY, *(f"unit {unit}" for unit in range(units))]
        hint = "what the unit saw and aims at, in its colour, beside the truth"
        self._node: Any = controls.known(controls.gui.add_dropdown("knowledge of", names, hint=hint))

    @property
    def unit(self) -> int | None:
        """The chosen unit, or None."""
        return None if self._node.value == NOBODY else int(self._node.value.split()[1])
