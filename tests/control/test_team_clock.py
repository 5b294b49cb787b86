"""The team's time: bounded by the leading clock, behind a message by at most its excess delay."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyherd.control import TeamClock
from skyherd.errors import InputError
from skyherd.messages.clock_offset import DRIFT

MIN_S = 0.1


@dataclass
class Member:
    """Member of a team whose clock has an offset and drifts."""

    offset_s: float
    rate: float
    clock: TeamClock = field(default_factory=lambda: TeamClock(MIN_S))

    def shows(self, time_s: float) -> np.ndarray:
        return np.array([self.offset_s + self.rate * time_s])

    def team_s(self, time_s: float) -> float:
        return float(self.clock.time_s(self.shows(time_s))[0])


MEMBERS = st.lists(st.tuples(st.floats(-20, 20), st.floats(-1e-4, 1e-4)), min_size=2, max_size=5)
"""Offsets, s, and drifts of clocks."""


@given(clocks=MEMBERS, seed=st.integers(0, 1000))
def test_team_time_is_bounded_by_leading_clock_and_delay(clocks, seed) -> None:
    """60 s of messages at random, with message loss of one third, each up to 0.3 s later than the fastest."""
    rng = np.random.default_rng(seed)
    members = [Member(offset_s, 1 + drift) for offset_s, drift in clocks]
    flying, last_s = [], [-np.inf] * len(members)
    for time_s in np.arange(0, 60, 0.2):
        for arrival_s, stamp_s, sent_s, to in [item for item in flying if item[0] <= time_s]:
            members[to].clock.hear(stamp_s, members[to].shows(arrival_s))
            late_s = arrival_s - sent_s - MIN_S
            age_s = members[to].team_s(arrival_s) - stamp_s
            assert age_s >= arrival_s - sent_s - late_s - 1e-4
        flying = [item for item in flying if item[0] > time_s]
        leading_s = max(float(member.shows(time_s)[0]) for member in members)
        for number, member in enumerate(members):
            team_s = member.team_s(time_s)
            assert team_s <= leading_s + 1e-4 * MIN_S * 300 + 1e-9
            assert team_s >= last_s[number] + 0.2 * (1 - 1e-4 - DRIFT) - 1e-9, "it is monotonic"
            last_s[number] = team_s
            to = int(rng.integers(len(members)))
            if to != number and rng.random() > 1 / 3:
                flying.append((time_s + MIN_S + 0.3 * rng.random(), team_s, time_s, to))


def test_fastest_message_gives_exact_team_time() -> None:
    """Clocks 7 s apart: after one message with the minimum delay both permanently show one time."""
    ahead, behind = Member(5.0, 1.0), Member(-2.0, 1.0)
    behind.clock.hear(ahead.team_s(3.0), behind.shows(3.0 + MIN_S))
    assert behind.team_s(3.1) == pytest.approx(ahead.team_s(3.1), abs=1e-12)
    behind.clock.hear(ahead.team_s(4.0), behind.shows(4.9))
    assert ahead.team_s(5.0) - 2 * DRIFT <= behind.team_s(5.0) <= ahead.team_s(5.0)
    ahead.clock.hear(behind.team_s(5.0), ahead.shows(5.1))
    assert ahead.team_s(6.0) == 11.0, "the leading clock runs freely"


def test_listener_with_leading_clock_follows_team() -> None:
    """A robot's clock that is 5 s fast has no effect on the team's time, unless no other clock is known."""
    listening, sending = TeamClock(0.0, 2, listens=True), TeamClock(0.0, 2)
    own_s = np.array([15.0, 5.0])
    assert np.array_equal(listening.time_s(own_s), own_s)
    for clock in (listening, sending):
        clock.hear(10.0, own_s, np.array([0, 1]))
    assert listening.time_s(own_s).tolist() == [10.0, 10.0]
    assert sending.time_s(own_s).tolist() == [15.0, 10.0]


def test_message_updates_only_its_receivers() -> None:
    clock = TeamClock(0.5, 3)
    clock.hear(20.0, np.zeros(3), np.array([1]))
    assert clock.time_s(np.zeros(3)).tolist() == [0.0, 20.5, 0.0]


def test_bound_decay_keeps_fast_clock_with_team() -> None:
    """A listener's clock is 100 parts in a million fast; a message arrives every second."""
    clock, rate = TeamClock(0.0, 1, listens=True), 1 + 1e-4
    for time_s in range(1000):
        clock.hear(float(time_s), np.array([rate * time_s]))
        assert clock.time_s(np.array([rate * time_s]))[0] == pytest.approx(time_s, abs=1e-9)
    assert abs(clock.time_s(np.array([rate * 1000.0]))[0] - 1000.0) <= 1e-4 + DRIFT


@pytest.mark.parametrize(
    ("given", "where"),
    [
        ({"min_delay_s": -0.1}, "min_delay_s"),
        ({"min_delay_s": np.nan}, "min_delay_s"),
        ({"members": -1}, "members"),
        ({"members": 2**63}, "members"),
    ],
)
def test_team_clock_rejects_invalid_delay_and_count(given, where) -> None:
    with pytest.raises(InputError, match=where):
        TeamClock(**given)
