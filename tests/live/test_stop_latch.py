"""Latched stop: its two numbers form a semilattice, and an arm command clears only known stops."""

import hypothesis.strategies as st
import pytest
from hypothesis import given

from skyherd.live.stop_latch import MAX_STOP, NO_COMMAND, TAGS, ArmState, StopLatch, stop_number

pytestmark = pytest.mark.smoke

numbers = st.one_of(st.integers(0, 5), st.integers(0, MAX_STOP))
latches = st.builds(StopLatch, numbers, st.integers(0, MAX_STOP - 1) | st.integers(0, 5))
times_s = st.floats(0, 1e11)
tags = st.integers(0, TAGS - 1)


class TestStopLatch:
    @given(latches, latches, latches)
    def test_merge_is_a_semilattice(self, a, b, c) -> None:
        assert a.merge(a) == a
        assert a.merge(b) == b.merge(a)
        assert a.merge(b).merge(c) == a.merge(b.merge(c))
        assert a.merge(NO_COMMAND) == a

    @given(latches, times_s, tags)
    def test_stop_outranks_all_commands_its_sender_knows(self, known, time_s, tag) -> None:
        stopped = known.with_stop(time_s, tag)
        assert stopped.stopped and stopped.merge(known) == stopped
        assert stopped.stop > known.stop or known.stop == MAX_STOP

    @given(latches, latches, times_s, tags)
    def test_arm_clears_only_known_stops(self, issuer, other, time_s, tag) -> None:
        unknown = other.with_stop(time_s, tag)
        armed = issuer.with_arm()
        assert armed.cleared <= max(issuer.stop, issuer.cleared)
        if unknown.stop > max(issuer.stop, issuer.cleared):
            assert armed.merge(unknown).stopped

    @given(latches)
    def test_largest_stop_number_stays_in_force(self, known) -> None:
        forged = known.merge(StopLatch(stop=MAX_STOP))
        assert forged.with_arm().stopped and forged.with_arm().with_stop(0.0, 0).stopped

    def test_stop_of_new_operator_outranks_old_commands(self) -> None:
        old = StopLatch().with_stop(1_700_000_000.0, TAGS - 1).with_arm()
        assert not old.stopped
        assert old.merge(NO_COMMAND.with_stop(1_700_000_000.5, 0)).stopped


class TestArmState:
    @given(latches, latches)
    def test_armed_until_newer_stop(self, known, heard) -> None:
        state = ArmState(known.with_arm())
        armed = state.arm(state.latch.cleared)
        if state.latch.stopped:
            assert not armed.armed
            return
        after = armed.merge(heard)
        assert after.armed == (heard.stop <= state.latch.cleared)
        assert after.disarmed_count == (not after.armed)

    @pytest.mark.parametrize("cleared", [0, 6])
    def test_arm_below_known_stop_has_no_effect(self, cleared) -> None:
        assert not ArmState(StopLatch(stop=7)).arm(cleared).armed
        assert ArmState(StopLatch(stop=7)).arm(7).armed


def test_largest_stop_number_is_exact_in_json() -> None:
    assert int(float(MAX_STOP)) == MAX_STOP
    assert int(float(MAX_STOP + 2)) != MAX_STOP + 2


def test_stop_number_is_the_time_of_day_and_the_tag() -> None:
    assert StopLatch(stop=0, cleared=0) == NO_COMMAND
    assert divmod(NO_COMMAND.with_stop(1_700_000_000.25, 3).stop, TAGS) == (1_700_000_000_250, 3)
    known = StopLatch(stop=5 * TAGS + 7, cleared=9 * TAGS + 7)
    assert divmod(known.with_stop(0.0, 3).stop, TAGS) == (10, 3)
    year_2100_s = 4_102_444_800.0
    assert stop_number(year_2100_s, TAGS - 1) < MAX_STOP


@given(latches, times_s, tags)
def test_stop_numbers_of_different_tags_differ(known, time_s, tag) -> None:
    number = known.with_stop(time_s, tag).stop
    assert number % TAGS == tag or number == MAX_STOP


def test_each_disarming_begins_a_new_session() -> None:
    state, counts = ArmState(), []
    for _ in range(5):
        state = state.arm(0).disarm()
        counts.append(state.disarmed_count)
    assert counts == [1, 2, 3, 4, 5] and state.disarm() == state
