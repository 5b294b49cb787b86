"""What robots and units had to be told in a run: counted, or derived from what a law needs to know.

Under skyherd's own law these are the messages that units sent, counted as they left them: the goal of each
robot that is addressed is one message, and so are all bodies near it, and each report of a unit to the
others, with all that is in it. Under a law from the literature a robot measures its neighbours, or is told of
them, at every step: each of its links is one message, and the numbers in it follow from the law
(`skyherd.sim.baseline_laws.BaselineLaw`). When messages to robots were sent, and the ids in them, are not
counted: every method needs those.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from math import nan

import numpy as np

from skyherd.datasets import METHODS, Mission
from skyherd.loop import Step, UnitFrame
from skyherd.sim.baseline_laws import LAWS
from skyherd.sim.robot_teams import shape_m

GOAL_NUMBERS = 3
"""Numbers in a robot's goal beside its distances to neighbours: length, bearing, side of its marker."""

PAIR_NUMBERS = 4
"""Numbers about each body near a robot: distance, bearing, the reach of both, and the share of the gap."""


@dataclass(frozen=True)
class Traffic:
    """Messages of a whole run, and the numbers in them; NaN of a law of one's own, of which nobody knows."""

    messages: float
    numbers: float


def count_traffic(mission: Mission, steps: Sequence[Step]) -> Traffic:
    """What was sent in a run, or, under a law from the literature, what each robot had to know of others."""
    method = mission.scenario.control.method
    if method == METHODS[0]:
        frames = [frame for step in steps for frame in step.frames.values()]
        sent = np.array([_sent(frame) for frame in frames]).reshape(-1, 2).sum(axis=0)
        return Traffic(*sent.tolist())
    law = LAWS.get(method)
    if law is None or law.links is None:  # one's own is not imported: a recording may come from a stranger
        return Traffic(nan, nan)
    links = len(law.links(shape_m(mission))) * len(steps)
    return Traffic(links, links * law.numbers)


def _sent(frame: UnitFrame) -> tuple[int, int]:
    """Messages that a unit sent after one image, and the numbers in them."""
    messages, numbers = 1, _numbers_in(frame.decision.report)
    if (goals := frame.decision.goals) is not None:
        messages += len(goals)
        numbers += GOAL_NUMBERS * len(goals) + int((goals.neighbor_ids >= 0).sum())
    if (proximity := frame.decision.proximity) is not None:
        messages += len(proximity)
        numbers += PAIR_NUMBERS * proximity.robot_ids.size
    return messages, numbers


def _numbers_in(value: object) -> int:
    """Numbers in a message: in its arrays and collections, and in the messages within it."""
    if isinstance(value, np.ndarray):
        return value.size
    if is_dataclass(value):
        return sum(_numbers_in(getattr(value, field.name)) for field in fields(value))
    if isinstance(value, Mapping):
        return sum(map(_numbers_in, (*value.keys(), *value.values())))
    if isinstance(value, Collection) and not isinstance(value, str):
        return sum(map(_numbers_in, value))
    return int(isinstance(value, int | float))
