"""Caps on speed, turn and acceleration that hold whatever comes in."""

import math
from dataclasses import dataclass

from skyherd.live.drivers.link import STILL, Motion
from skyherd.messages.checks import check_numbers

MAX_STEP_S = 0.2
"""Time that passed between two commands counts as no more than this, s. *Chosen*: four times the usual
interval; after a pause a robot speeds up no faster than otherwise."""


@dataclass(frozen=True)
class SpeedLimits:
    """What a robot may be told at most.

    Attributes:
        speed_mps: greatest speed in each direction, m/s.
        turn_radps: greatest turn rate, rad/s.
        acceleration_mps2: greatest growth of a speed, m/s².
        turn_acceleration_radps2: greatest growth of the turn rate, rad/s².

    Raises:
        InputError: one of them is not above 0.
    """

    speed_mps: float = 0.3
    turn_radps: float = 1.5
    acceleration_mps2: float = 0.5
    turn_acceleration_radps2: float = 4.0

    def __post_init__(self) -> None:
        names = ("speed_mps", "turn_radps", "acceleration_mps2", "turn_acceleration_radps2")
        check_numbers(self, positive=names)


LIMITS = SpeedLimits()
"""Limits where none are named. *Chosen*: what small indoor robots do."""


class Limiter:
    """Brings one motion after the other within limits.

    A speed that is too high is cut to the limit. Away from zero it changes by no more than the acceleration
    times the time that passed; towards zero it may change at once, since stopping is always allowed; so a
    change of direction begins at zero. A motion with anything that is not a finite number is no motion: zero.

    Args:
        limits: to be held.
    """

    def __init__(self, limits: SpeedLimits) -> None:
        self.limits = limits
        self.last = STILL

    def limit(self, motion: Motion, passed_s: float) -> Motion:
        """The motion that is allowed instead, which the next one starts from.

        Args:
            motion: what is wanted; its numbers may be anything.
            passed_s: time since the last call; anything below 0 or not a number counts as 0.
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
    """A speed within ±most whose size exceeds that of the last, if of its sign, by no more than growth."""
    before = abs(last) if (last > 0) == (wanted > 0) else 0.0
    size = min(abs(wanted), most, before + growth)
    return float(math.copysign(size, wanted)) if size else 0.0
