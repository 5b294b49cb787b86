"""The radio between units and robots: messages are delayed, lost, repeated, and arrive out of order."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.control import Delivery
from skyherd.geometry import BoolArray
from skyherd.messages import TIME_TOLERANCE_S, MotionGoals, Proximity, UnitReport

ToRobots = MotionGoals | Proximity
"""Messages that units send to robots."""


@dataclass(frozen=True)
class NetworkParameters:
    """What goes wrong with messages; by default nothing.

    Attributes:
        message_loss: share of messages lost, for each receiver independently.
        delay_s: greatest random delay, uniform from 0, in addition to the sender's latency.
        repeats: share of messages that arrive twice.
    """

    message_loss: float = 0.0
    delay_s: float = 0.0
    repeats: float = 0.0


@dataclass
class Network:
    """Messages under way, and the reports that units have received.

    A message is delayed by its sender's latency and by up to `delay_s` more, so that a later one may overtake
    it; reports draw this delay for each receiver, messages to robots once for all of them. It is lost at
    random for each receiver, and arrives a second time at random.

    Attributes:
        parameters: losses, delay and repeats.
        rng: draws what happens.
        units: number of units.
        reports: by receiving unit, the newest report that arrived from each other one.
    """

    parameters: NetworkParameters
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
        """Send one unit's messages to robots, and its report to other units.

        Args:
            to_robots: messages to robots; None stands for no message.
            report: the report.
            arrival_s: time of arrival without random delay.
            receivers: units within radio range; all if None.
        """
        others = [
            unit for unit in (range(self.units) if receivers is None else receivers) if unit != report.unit_id
        ]
        if self.parameters.delay_s or self.parameters.repeats:
            for unit in others:
                self._post(arrival_s, [unit], report)
        else:
            self._waiting.append((arrival_s, others, report))
        for message in to_robots:
            if message is not None:
                self._post(arrival_s, [], message)

    def deliver(self, time_s: float) -> list[Delivery]:
        """Messages to robots that have arrived by now, in the order of arrival; `reports` is updated.

        A report changes nothing where a newer one of the same unit arrived before.
        """
        arrived = [item for item in self._waiting if item[0] <= time_s + TIME_TOLERANCE_S]
        self._waiting = [item for item in self._waiting if item[0] > time_s + TIME_TOLERANCE_S]
        delivered: list[Delivery] = []
        for _, receivers, message in sorted(arrived, key=lambda item: item[0]):
            if not isinstance(message, UnitReport):
                delivered.append(Delivery(message, self._received(len(message))))
                continue
            for unit, received in zip(receivers, self._received(len(receivers)).tolist(), strict=True):
                last = self.reports[unit].get(message.unit_id)
                if received and (last is None or message.time_s >= last.time_s):
                    self.reports[unit][message.unit_id] = message
        return delivered

    def forget(self, unit: int) -> None:
        """Drop all reports that a unit has received, as when it fails."""
        self.reports[unit].clear()

    def _post(self, arrival_s: float, receivers: Sequence[int], message: ToRobots | UnitReport) -> None:
        self._waiting.append((arrival_s + self._delay_s(), receivers, message))
        if self.parameters.repeats and self.rng.random() < self.parameters.repeats:
            self._waiting.append((arrival_s + self._delay_s(), receivers, message))

    def _delay_s(self) -> float:
        return self.parameters.delay_s and self.parameters.delay_s * float(self.rng.random())

    def _received(self, count: int) -> BoolArray:
        """Mask (count,) of the receivers that a message is not lost for."""
        if self.parameters.message_loss == 0:
            return np.ones(count, dtype=bool)
        return self.rng.random(count) >= self.parameters.message_loss
