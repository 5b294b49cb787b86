"""Radio between units and robots: messages are delayed, lost, repeated, and arrive out of order.

Units out of each other's range receive reports by relay. Each unit relays a report immediately if it is the
newest of its sender. With every report of its own, it also relays the last reports of all other units. A loss
therefore costs one period of the images.
"""

import heapq
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.control import Delivery
from skyherd.datasets import NetworkModel
from skyherd.geometry import BoolArray
from skyherd.messages import TIME_TOLERANCE_S, MotionGoals, Proximity, UnitReport

ToRobots = MotionGoals | Proximity
"""Messages that units send to robots."""


@dataclass
class Network:
    """Messages in transit, and the reports that units have received.

    A message is delayed by its sender's latency and by up to `delay_s` more, so that later messages may
    overtake it. This random delay is drawn for each receiver of a report, and once for all receivers of a
    message to robots. Losses are independent for each receiver. A message may also arrive twice.

    Attributes:
        model: losses, delay, repeats and relays of a scenario. Relays matter only with a limited range.
        rng: generator of all random events.
        units: number of units.
        reports: by receiving unit, the newest received report of each other unit.
    """

    model: NetworkModel
    rng: np.random.Generator
    units: int
    reports: list[dict[int, UnitReport]] = field(init=False)
    _in_range: list[list[int]] | None = field(default=None, init=False)
    _waiting: list[tuple[float, int, Sequence[int], ToRobots | UnitReport]] = field(
        default_factory=list, init=False
    )
    _posted: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self.reports = [{} for _ in range(self.units)]

    def connect(self, in_range: Sequence[Sequence[int]] | None, dead: Collection[int] = ()) -> None:
        """Set the connections of the next step, which change with flight and failures.

        Args:
            in_range: by unit, the units that receive its radio; None if all receive all.
            dead: units without radio.
        """
        if in_range is None:
            self._in_range = None
            return
        self._in_range = [
            [] if unit in dead else [other for other in others if other not in dead]
            for unit, others in enumerate(in_range)
        ]

    def send(self, to_robots: Sequence[ToRobots | None], report: UnitReport, arrival_s: float) -> None:
        """Send one unit's messages to robots, and its report to other units.

        Args:
            to_robots: messages to robots; None stands for no message.
            report: the report.
            arrival_s: time of arrival without random delay.
        """
        self._spread(report, report.unit_id, arrival_s)
        if self._relays:
            for other in self.reports[report.unit_id].values():
                self._spread(other, report.unit_id, arrival_s)
        for message in to_robots:
            if message is not None:
                self._post(arrival_s, [], message)

    def deliver(self, time_s: float) -> list[Delivery]:
        """Return the messages to robots that have arrived by now, in order of arrival; update `reports`.

        A report has no effect after the arrival of a newer one of the same unit.
        """
        delivered: list[Delivery] = []
        while self._waiting and self._waiting[0][0] <= time_s + TIME_TOLERANCE_S:
            arrival_s, _, receivers, message = heapq.heappop(self._waiting)
            if not isinstance(message, UnitReport):
                delivered.append(Delivery(message, self._received(len(message))))
                continue
            for unit, received in zip(receivers, self._received(len(receivers)).tolist(), strict=True):
                if received:
                    self._take(unit, message, arrival_s)
        return delivered

    def _take(self, unit: int, report: UnitReport, arrival_s: float) -> None:
        """Store a report that arrives at a unit, and relay it if it is new to the unit."""
        last = self.reports[unit].get(report.unit_id)
        if last is not None and report.time_s < last.time_s:
            return
        self.reports[unit][report.unit_id] = report
        if self._relays and (last is None or report.time_s > last.time_s):
            self._spread(report, unit, arrival_s + self.model.relay_s)

    @property
    def _relays(self) -> bool:
        return self._in_range is not None and self.model.relay

    def _spread(self, report: UnitReport, sender: int, arrival_s: float) -> None:
        """Send a report to all units in range of a sender, except its author and the sender itself."""
        receivers = range(self.units) if self._in_range is None else self._in_range[sender]
        others = [unit for unit in receivers if unit not in (report.unit_id, sender)]
        if self.model.delay_s or self.model.repeats:
            for unit in others:
                self._post(arrival_s, [unit], report)
        else:
            self._put(arrival_s, others, report)

    def forget(self, unit: int) -> None:
        """Drop all reports that a unit has received; called when it fails."""
        self.reports[unit].clear()

    def _post(self, arrival_s: float, receivers: Sequence[int], message: ToRobots | UnitReport) -> None:
        self._put(arrival_s + self._delay_s(), receivers, message)
        if self.model.repeats and self.rng.random() < self.model.repeats:
            self._put(arrival_s + self._delay_s(), receivers, message)

    def _put(self, arrival_s: float, receivers: Sequence[int], message: ToRobots | UnitReport) -> None:
        heapq.heappush(self._waiting, (arrival_s, self._posted, receivers, message))
        self._posted += 1

    def _delay_s(self) -> float:
        return self.model.delay_s and self.model.delay_s * float(self.rng.random())

    def _received(self, count: int) -> BoolArray:
        """Return the mask (count,) of the receivers that get a message."""
        if self.model.message_loss == 0:
            return np.ones(count, dtype=bool)
        return self.rng.random(count) >= self.model.message_loss


def connected_parts(in_range: Sequence[Sequence[int]]) -> list[list[int]]:
    """Return the parts of a team that are connected by relay, each ascending, by their first units.

    Args:
        in_range: by unit, the units that receive its radio.
    """
    parts: list[list[int]] = []
    unvisited = set(range(len(in_range)))
    while unvisited:
        part, ahead = set[int](), [min(unvisited)]
        while ahead:
            unit = ahead.pop()
            part.add(unit)
            ahead += [other for other in in_range[unit] if other not in part]
        parts.append(sorted(part))
        unvisited -= part
    return parts
