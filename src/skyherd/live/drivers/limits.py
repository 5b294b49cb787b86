"""Limits of speed, turn rate and acceleration, for any input."""

import math
from dataclasses import dataclass

from skyherd.live.drivers.link import STILL, Motion
from skyherd.messages.checks import check_numbers

MAX_STEP_S = 0.2
"""Largest time step between two commands for the acceleration limit, s. *Chosen*: four usual intervals, so
that a pause does not permit a jump in speed."""


@dataclass(frozen=True)
class SpeedLimits:
    """Limits of the commands to a robot.

    Attributes:
        speed_mps: largest speed in each direction, m/s.
        turn_radps: largest turn rate, rad/s.
        acceleration_mps2: largest increase of a speed, m/s².
        turn_acceleration_radps2: largest increase of the turn rate, rad/s².

    Raises:
        InputError: a limit is not above 0.
    """

    speed_mps: float = 0.3
    turn_radps: float = 1.5
    acceleration_mps2: float = 0.5
    turn_acceleration_radps2: float = 4.0

    def __post_init__(self) -> None:
        names = ("speed_mps", "turn_radps", "acceleration_mps2", "turn_acceleration_radps2")
        check_numbers(self, positive=names)


LIMITS = SpeedLimits()
"""Default limits. *Chosen*: usual for small indoor robots."""


class Limiter:
    """Limiter of a sequence of motions.

    It clips speeds to the limit. The magnitude of a speed grows by at most acceleration times elapsed time.
    It may decrease at once, since stopping is always allowed, so that a change of direction starts at zero. A
    motion with a value that is not a finite number becomes zero.

    Args:
        limits: the limits.
    """

    def __init__(self, limits: SpeedLimits) -> None:
        self.limits = limits
        self.last = STILL

    def limit(self, motion: Motion, passed_s: float) -> Motion:
        """Return the limited motion, from which the next one starts.

        Args:
            motion: requested motion, with arbitrary values.
            passed_s: time since the last call; negative values and NaN count as 0.
        """
        wanted = [motion.forward_mps, motion.left_mps, motion.up_mps, motion.turn_radps]
        if not all(_is_finite(value) for value in wanted):
            self.last = STILL
            return STILL
        passed_s = min(passed_s, MAX_STEP_S) if passed_s > 0 else 0.0
        speed, growth = self.limits.speed_mps, self.limits.acceleration_mps2 * passed_s
        turn_growth = self.limits.turn_acceleration_radps2 * passed_s
        self.last = Motion(
            _limited(motion.forward_mps, self.last.forward_mps, speed, growth),
            _limited(motion.turn_radps, self.last.turn_radps, self.limits.turn_radps, turn_growth),
            _limited(motion.left_mps, self.last.left_mps, speed, growth),
            _limited(motion.up_mps, self.last.up_mps, speed, growth),
        )
        return self.last


def _is_finite(value: object) -> bool:
    try:
        return math.isfinite(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return False


def _limited(wanted: float, last: float, most: float, growth: float) -> float:
    """Return a speed within ±most whose magnitude exceeds the last one of its sign by at most `growth`."""
    before = abs(last) if (last > 0) == (wanted > 0) else 0.0
    size = min(abs(wanted), most, before + growth)
    return float(math.copysign(size, wanted)) if size else 0.0
