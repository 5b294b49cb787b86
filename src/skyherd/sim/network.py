"""The radio between units and robots: messages come late, not at all, twice, and out of order."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.control import Delivery
from skyherd.datasets import NetworkModel
from skyherd.geometry import BoolArray
from skyherd.messages import MotionGoals, Proximity, UnitReport

ToRobots = MotionGoals | Proximity
"""What units send to robots."""


@dataclass
class Network:
    """Messages on their way.

    Each is late by its sender's latency and, for each receiver anew, by up to `delay_s` more, so that a later
    one may overtake it. It is lost at random for each receiver, and arrives once more at random.

    Attributes:
        model: losses, delay and repeats.
        rng: what decides.
        units: how many there are.
        reports: by receiving unit, the newest report that arrived from each other one.
    """

    model: NetworkModel
    rng: np.random.Generator
    units: int
    reports: list[dict[int, UnitReport]] = field(init=False)
    _waiting: list[tuple[float, Sequence[int], ToRobots | UnitReport]] = field(
        default_factory=list, init=False
    )

    def __post_init__(self) -> None:
        self.reports = [{} for _ in range(self.units)]

    def send(
        self,
        to_robots: Sequence[ToRobots | None],
        report: UnitReport,
        arrival_s: float,
        receivers: Sequence[int] | None = None,
    ) -> None:
        """Send what one unit tells robots, and its report to other units, all if `receivers` is None."""
        others = [
            unit for unit in (range(self.units) if receivers is None else receivers) if unit != report.unit_id
        ]
        if self.model.delay_s or self.model.repeats:
            for unit in others:
                self._post(arrival_s, [unit], report)
        else:
            self._waiting.append((arrival_s, others, report))
        for message in to_robots:
            if message is not None:
                self._post(arrival_s, [], message)

    def deliver(self, time_s: float) -> list[Delivery]:
        """Messages to robots that arrive by now, in order of arrival; reports between units are kept."""
        arrived = [item for item in self._waiting if item[0] <= time_s + 1e-9]
        self._waiting = [item for item in self._waiting if item[0] > time_s + 1e-9]
        delivered: list[Delivery] = []
        for _, receivers, message in sorted(arrived, key=lambda item: item[0]):
            if not isinstance(message, UnitReport):
                delivered.append(Delivery(message, self._heard(len(message))))
                continue
            for unit, heard in zip(receivers, self._heard(len(receivers)).tolist(), strict=True):
                last = self.reports[unit].get(message.unit_id)
                if heard and (last is None or message.time_s >= last.time_s):
                    self.reports[unit][message.unit_id] = message
        return delivered

    def forget(self, unit: int) -> None:
        """What a unit had heard is gone with it."""
        self.reports[unit].clear()

    def _post(self, arrival_s: float, receivers: Sequence[int], message: ToRobots | UnitReport) -> None:
        self._waiting.append((arrival_s + self._delay_s(), receivers, message))
        if self.model.repeats and self.rng.random() < self.model.repeats:
            self._waiting.append((arrival_s + self._delay_s(), receivers, message))

    def _delay_s(self) -> float:
        return self.model.delay_s and self.model.delay_s * float(self.rng.random())

    def _heard(self, count: int) -> BoolArray:
        if self.model.message_loss == 0:
            return np.ones(count, dtype=bool)
        return self.rng.random(count) >= self.model.message_loss
