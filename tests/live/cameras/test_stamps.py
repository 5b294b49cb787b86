"""Estimation of the time of capture under clock offset, drift and latency."""

import numpy as np
import pytest

from skyherd.live.cameras.stamps import DRIFT, StreamStamps
from skyherd.live.cameras.streams import age_on_this_machine

DELAY_S = 0.08
"""Smallest latency of the pictures, s. Chosen."""


def run(taken_s, delays_s, *, drift=0.0, ahead_s=1234.5):
    """Return stamps of pictures taken at times on our clock, by a stream clock with offset and drift."""
    stamps = StreamStamps()
    return np.array(
        [
            stamps.captured_s((1 + drift) * taken + ahead_s, taken + delay)
            for taken, delay in zip(taken_s, delays_s, strict=True)
        ]
    )


def test_jitter_is_removed_except_the_common_latency() -> None:
    rng = np.random.default_rng(0)
    taken_s = np.arange(3000) / 30
    delays_s = DELAY_S + rng.exponential(0.05, taken_s.size)
    off_s = run(taken_s, delays_s) - taken_s
    # The smallest latency so far remains: on average below 0.05 / 100 for 100 draws.
    assert (off_s >= DELAY_S - 1e-9).all()
    assert off_s[300:].max() < DELAY_S + 0.005
    assert delays_s[300:].max() > DELAY_S + 0.3, "the jitter that was taken off"


@pytest.mark.parametrize("drift", [-1e-4, 1e-4])
def test_clock_drift_is_tracked(drift) -> None:
    rng = np.random.default_rng(1)
    taken_s = np.arange(0, 3600, 0.1)
    off_s = run(taken_s, DELAY_S + rng.exponential(0.02, taken_s.size), drift=drift) - taken_s
    assert np.abs(off_s[100:] - DELAY_S).max() < 0.02
    assert abs(drift) * 3600 > 0.3, "what would be off if the offset were fixed"


def test_growing_latency_appears_as_age() -> None:
    taken_s = np.arange(1200) / 30
    delays_s = np.where(taken_s < 10, DELAY_S, DELAY_S + 3.0)
    captured_s = run(taken_s, delays_s)
    lag_s = taken_s + delays_s - captured_s
    assert lag_s[:300].max() < 1e-9
    # The drift allowance of 2e-4 removes its share of 33 s: from the last picture before the jump to the end.
    assert lag_s[300:].min() >= 3.0 - 33 * DRIFT - 1e-9


def test_capture_is_never_after_arrival() -> None:
    rng = np.random.default_rng(2)
    stamps = StreamStamps()
    arrived_s = 0.0
    for _ in range(2000):
        arrived_s += rng.exponential(0.1)
        stream_s = rng.normal(0, 1e4)
        assert stamps.captured_s(stream_s, arrived_s) <= arrived_s + 1e-9


def test_buffered_pictures_are_not_settled() -> None:
    stamps = StreamStamps()
    # Ten buffered pictures arrive at once, and then one every 0.1 s.
    kept = [stamps.captured_s(k / 10, 5.0 + k / 1000) for k in range(10)]
    assert not stamps.settled
    assert stamps.captured_s(1.0, 5.009 + 0.1) == pytest.approx(5.1, abs=0.02)
    assert stamps.settled and kept[0] == 5.0
    endless = StreamStamps()
    for k in range(100):
        endless.captured_s(k / 10, 5.0 + k / 40)
    assert endless.settled, "a fast stream is not waited for without end"


def test_device_time_is_used_only_on_monotonic_clock() -> None:
    assert age_on_this_machine(100.0, 100.03) == pytest.approx(0.03)
    assert age_on_this_machine(1.7e9, 100.0) is None
    assert age_on_this_machine(0.5, 100.0) is None
