"""The content of a recorded run, the same for simulated and live runs.

Times are s since the start of the run, on one clock for all processes. Pixels, angles and bearings are those
of `skyherd.messages`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

from skyherd.geometry import Array, IntArray
from skyherd.messages import Detections, FlightCommand, MotionGoals, Proximity, UnitReport
from skyherd.sim.truth_metrics import TruthMetrics
from skyherd.sim.world import Fleet


@dataclass(frozen=True)
class Seen:
    """One image of a unit, and the unit's decision on it.

    Attributes:
        time_s: time of capture.
        decided_s: time of the decision; equal to `time_s` in a simulated run.
        detections: the markers, as the detector returned them. Their own time is on the unit's clock.
        goals: goals for the controlled robots; None if none were sent.
        proximity: bodies near the robots; None if none were sent.
        report: report to the other units; None if none was sent.
        flight: command to the unit's autopilot; None if it is not recorded.
        jpeg: the image as JPEG; None if it is not recorded.
    """

    time_s: float
    decided_s: float
    detections: Detections
    goals: MotionGoals | None = None
    proximity: Proximity | None = None
    report: UnitReport | None = None
    flight: FlightCommand | None = None
    jpeg: bytes | None = None


@dataclass(frozen=True)
class Commanded:
    """Wheel commands of robots, as arrays over N robots.

    Attributes:
        time_s: time of the command.
        ids: (N,) robots.
        v_mps: (N,) forward speeds.
        omega_radps: (N,) turn rates, counter-clockwise from above.
        states: (N,) `driving`, or the reason why a robot stands still.
        armed: whether the robots are armed; None in a simulated run.
        image_age_s: age of the newest image that the robot knows; None without one, and in a simulated run.
    """

    time_s: float
    ids: IntArray
    v_mps: Array
    omega_radps: Array
    states: tuple[str, ...]
    armed: bool | None = None
    image_age_s: float | None = None


@dataclass(frozen=True)
class Truth:
    """True state of a simulated world.

    Attributes:
        time_s: time of the state.
        ids: (N,) robots.
        positions_m: (N, 2) their markers on the ground.
        headings_rad: (N,) counter-clockwise from +x.
        roles: (N,) template row of each robot.
        fleet: places and attitudes of the units.
        metrics: ground-truth metrics.
    """

    time_s: float
    ids: IntArray
    positions_m: Array
    headings_rad: Array
    roles: IntArray
    fleet: Fleet
    metrics: TruthMetrics


Moment = Seen | Commanded | Truth
"""One record of a run."""


@dataclass
class RecordedRun:
    """A recorded run that can be exported.

    Attributes:
        name: name of its folder.
        kind: `simulated` or `live`.
        ids: (N,) ids of the robots.
        units: number of units.
        side_m: side of the markers.
        start_unix_s: start of the run, s since 1970; 0 for a simulated run.
        end_s: time of the last record.
        configuration: the scenario or the lab, as a JSON object.
        versions: versions of the recording programs, by name.
        moments: returns an iterator over all records, in the order of decisions.
        flaws: defects of the recording, a short text each. Reading the moments may add some.
    """

    name: str
    kind: Literal["simulated", "live"]
    ids: IntArray
    units: int
    side_m: float
    start_unix_s: float
    end_s: float
    configuration: dict[str, Any]
    versions: dict[str, str]
    moments: Callable[[], Iterator[Moment]]
    flaws: list[str] = field(default_factory=list)
