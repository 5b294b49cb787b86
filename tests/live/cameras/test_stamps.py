"""When a picture was taken, from clocks that differ, drift and are delayed."""

import numpy as np
import pytest

from skyherd.live.cameras.stamps import DRIFT, StreamStamps
from skyherd.live.cameras.streams import age_on_this_machine

DELAY_S = 0.08
"""Delay that all pictures of these tests have at least."""


def run(taken_s, delays_s, *, drift=0.0, ahead_s=1234.5):
    """Stamps of pictures taken at times on our clock, the stream's being ahead, and drifting."""
    stamps = StreamStamps()
    return np.array(
        [
            stamps.captured_s((1 + drift) * taken + ahead_s, taken + delay)
            for taken, delay in zip(taken_s, delays_s, strict=True)
        ]
    )


def test_jitter_is_taken_off_but_for_what_is_common_to_all() -> None:
    rng = np.random.default_rng(0)
    taken_s = np.arange(3000) / 30
    delays_s = DELAY_S + rng.exponential(0.05, taken_s.size)
    off_s = run(taken_s, delays_s) - taken_s
    # The least delay so far is what is left: of 100 draws below 0.05 / 100 in the mean.
    assert (off_s >= DELAY_S - 1e-9).all()
    assert off_s[300:].max() < DELAY_S + 0.005
    assert delays_s[300:].max() > DELAY_S + 0.3, "the jitter that was taken off"


@pytest.mark.parametrize("drift", [-1e-4, 1e-4])
def test_a_clock_that_drifts_is_followed(drift) -> None:
    rng = np.random.default_rng(1)
    taken_s = np.arange(0, 3600, 0.1)
    off_s = run(taken_s, DELAY_S + rng.exponential(0.02, taken_s.size), drift=drift) - taken_s
    assert np.abs(off_s[100:] - DELAY_S).max() < 0.02
    assert abs(drift) * 3600 > 0.3, "what would be off if the offset were fixed"


def test_a_stream_that_falls_behind_shows_its_age() -> None:
    taken_s = np.arange(1200) / 30
    delays_s = np.where(taken_s < 10, DELAY_S, DELAY_S + 3.0)
    captured_s = run(taken_s, delays_s)
    lag_s = taken_s + delays_s - captured_s
    assert lag_s[:300].max() < 1e-9
    # The allowance for drift forgives 33 s at 2e-4, from the last before to the end.
    assert lag_s[300:].min() >= 3.0 - 33 * DRIFT - 1e-9


def test_no_picture_is_taken_after_it_came() -> None:
    rng = np.random.default_rng(2)
    stamps = StreamStamps()
    arrived_s = 0.0
    for _ in range(2000):
        arrived_s += rng.exponential(0.1)
        stream_s = rng.normal(0, 1e4)
        assert stamps.captured_s(stream_s, arrived_s) <= arrived_s + 1e-9


def test_what_a_server_kept_is_not_taken_for_the_present() -> None:
    stamps = StreamStamps()
    # Ten pictures that were kept come at once, and then one each tenth of a second.
    kept = [stamps.captured_s(k / 10, 5.0 + k / 1000) for k in range(10)]
    assert not stamps.settled
    assert stamps.captured_s(1.0, 5.009 + 0.1) == pytest.approx(5.1, abs=0.02)
    assert stamps.settled and kept[0] == 5.0
    endless = StreamStamps()
    for k in range(100):
        endless.captured_s(k / 10, 5.0 + k / 40)
    assert endless.settled, "a fast stream is not waited for without end"


def test_a_device_s_time_counts_where_it_is_this_machine_s() -> None:
    assert age_on_this_machine(100.0, 100.03) == pytest.approx(0.03)
    assert age_on_this_machine(1.7e9, 100.0) is None
    assert age_on_this_machine(0.5, 100.0) is None
