"""The clock of a live process: what it counts, and what does not change it."""

import inspect
import sys
import time

import pytest

from skyherd.live import live_clock
from skyherd.live.drivers import RobotDriver, open_driver
from skyherd.live.live_clock import LiveClock, steady_s


@pytest.mark.skipif(sys.platform != "linux", reason="the clock of Linux")
def test_steady_clock_counts_the_time_since_boot(monkeypatch) -> None:
    """It differs from the monotonic one by all the time that the machine slept."""
    assert steady_s() == pytest.approx(time.clock_gettime(time.CLOCK_BOOTTIME), abs=0.5)
    monkeypatch.setattr(time, "clock_gettime", {time.CLOCK_BOOTTIME: 1e6, time.CLOCK_MONOTONIC: 9e5}.get)
    assert steady_s() == 1e6


def test_process_and_driver_notice_sleep(monkeypatch) -> None:
    monkeypatch.setattr(live_clock, "steady_s", lambda: asleep_s + 100.0)
    asleep_s = 0.0
    clock = LiveClock()
    before_s, asleep_s = clock(), 20.0
    assert clock() - before_s == pytest.approx(20.0)
    for makes_driver in (RobotDriver, open_driver):
        assert inspect.signature(makes_driver).parameters["clock"].default is steady_s


def test_time_of_day_counts_at_the_start_only(monkeypatch) -> None:
    clock = LiveClock(offset_s=3.0)
    assert clock() == pytest.approx(time.time() + 3.0, abs=0.5)
    monkeypatch.setattr(time, "time", lambda: 0.0)
    assert clock() > 1e9
