"""Limits of speed and acceleration, for any input."""

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyherd.errors import InputError
from skyherd.live.drivers import STILL, Limiter, Motion, SpeedLimits

anything = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.floats(-2, 2),
    st.sampled_from([0.0, -0.0, 1e308, -1e308, 5e-324, 10**400, None, "fast"]),
)
motions = st.builds(Motion, anything, anything, anything, anything)
steps = st.lists(st.tuples(motions, st.one_of(st.floats(), st.floats(0, 0.2))), max_size=8)
sizes = st.floats(1e-3, 10)
limits = st.builds(SpeedLimits, sizes, sizes, sizes, sizes)

LONGEST_S = 0.2
"""Expected value of `skyherd.live.drivers.limits.MAX_STEP_S`, s."""

ROUNDING = 1 + 1e-12
"""Tolerance for the rounding of one sum and one product."""


def speeds(motion: Motion) -> tuple[float, ...]:
    return motion.forward_mps, motion.left_mps, motion.up_mps, motion.turn_radps


@settings(max_examples=60)
@given(limits, steps)
def test_speeds_and_growth_stay_within_limits(most, wanted) -> None:
    limiter = Limiter(most)
    written = [STILL, *(limiter.limit(motion, passed_s) for motion, passed_s in wanted)]
    caps = (most.speed_mps,) * 3 + (most.turn_radps,)
    growths = (most.acceleration_mps2,) * 3 + (most.turn_acceleration_radps2,)
    for (before, after), (_, passed_s) in zip(pairwise(written), wanted, strict=True):
        counted_s = min(passed_s, LONGEST_S) if passed_s > 0 else 0.0
        for old, new, cap, growth in zip(speeds(before), speeds(after), caps, growths, strict=True):
            assert isinstance(new, float) and math.isfinite(new) and abs(new) <= cap
            kept = abs(old) if (old > 0) == (new > 0) else 0.0  # A product may underflow.
            assert abs(new) <= (kept + growth * counted_s) * ROUNDING


@settings(max_examples=40)
@given(limits, motions)
def test_non_finite_motion_stops_immediately(most, motion) -> None:
    limiter = Limiter(most)
    for _ in range(50):
        limiter.limit(Motion(1, 1, 1, 1), 0.1)
    numbers = all(isinstance(value, int | float) and abs(value) <= 1e308 for value in speeds(motion))
    assert numbers or limiter.limit(motion, 0.1) == STILL


def test_stopping_is_immediate_and_reversal_starts_at_zero() -> None:
    limiter = Limiter(SpeedLimits(speed_mps=1.0, acceleration_mps2=0.5))
    for _ in range(100):
        fast = limiter.limit(Motion(5.0, 0.0), 0.1)
    assert fast.forward_mps == 1.0
    assert limiter.limit(Motion(-5.0, 0.0), 0.1).forward_mps == pytest.approx(-0.05)
    assert limiter.limit(STILL, 0.1) == STILL
    assert limiter.limit(Motion(0.02, 0.0), 0.1).forward_mps == 0.02


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, None])
def test_limits_not_above_zero_are_refused(value) -> None:
    with pytest.raises(InputError, match=r"SpeedLimits\.turn_radps"):
        SpeedLimits(turn_radps=value)
