"""Messages that robots and units need in a run: counted, or derived from a control law.

Under skyherd's own law, these are the messages that units sent. The goal of each addressed robot is one
message. The bodies near it are one, and so is each report of a unit to the others. Under a law from the
literature, a robot measures its neighbours, or receives their state, at every step. Each of its links is one
message, whose numbers follow from the law (`skyherd.sim.baseline_laws.BaselineLaw`). Time stamps and ids do
not count, since every method needs them.
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

PAIR_NUMBERS = 5
"""Numbers per body near a robot: distance, bearing, combined reach, share of the gap, and way."""


@dataclass(frozen=True)
class Traffic:
    """Messages of a whole run and the numbers in them; NaN for a user's own law, whose needs are unknown."""

    messages: float
    numbers: float


def count_traffic(mission: Mission, steps: Sequence[Step]) -> Traffic:
    """Count the messages of a run, or derive them from a law of the literature."""
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
    """Count the messages that a unit sent after one image, and the numbers in them."""
    if frame.decision.suspicion:
        return 0, 0
    messages, numbers = 1, _numbers_in(frame.decision.report)
    for goals in (frame.decision.goals, frame.decision.turns):
        if goals is not None:
            messages += len(goals)
            numbers += GOAL_NUMBERS * len(goals) + int((goals.neighbor_ids >= 0).sum())
    if (proximity := frame.decision.proximity) is not None:
        messages += len(proximity)
        numbers += PAIR_NUMBERS * proximity.robot_ids.size
    return messages, numbers


def _numbers_in(value: object) -> int:
    """Count the numbers in a message: in arrays, collections and nested messages."""
    if isinstance(value, np.ndarray):
        return value.size
    if is_dataclass(value):
        return sum(_numbers_in(getattr(value, field.name)) for field in fields(value))
    if isinstance(value, Mapping):
        return sum(map(_numbers_in, (*value.keys(), *value.values())))
    if isinstance(value, Collection) and not isinstance(value, str):
        return sum(map(_numbers_in, value))
    return int(isinstance(value, int | float))
