"""The two numbers of the latched stop form a semilattice, and an arm command never clears an unknown stop."""

import hypothesis.strategies as st
import pytest
from hypothesis import given

from skyherd.live.stop_latch import MAX_STOP, NO_COMMAND, ArmState, StopLatch

numbers = st.one_of(st.integers(0, 5), st.integers(0, MAX_STOP))
latches = st.builds(StopLatch, numbers, st.integers(0, MAX_STOP - 1) | st.integers(0, 5))
times_s = st.floats(0, 1e11)


@given(latches, latches, latches)
def test_merge_is_a_semilattice(a, b, c) -> None:
    assert a.merge(a) == a
    assert a.merge(b) == b.merge(a)
    assert a.merge(b).merge(c) == a.merge(b.merge(c))
    assert a.merge(NO_COMMAND) == a


@given(latches, times_s)
def test_a_stop_holds_against_all_that_its_sender_knows(known, time_s) -> None:
    stopped = known.with_stop(time_s)
    assert stopped.stopped and stopped.merge(known) == stopped
    assert stopped.stop > known.stop or known.stop == MAX_STOP


@given(latches, latches, times_s)
def test_an_arm_command_clears_only_known_stops(issuer, other, time_s) -> None:
    unknown = other.with_stop(time_s)
    armed = issuer.with_arm()
    assert armed.cleared <= max(issuer.stop, issuer.cleared)
    if unknown.stop > max(issuer.stop, issuer.cleared):
        assert armed.merge(unknown).stopped


@given(latches)
def test_the_largest_stop_number_stays_in_force(known) -> None:
    forged = known.merge(StopLatch(stop=MAX_STOP))
    assert forged.with_arm().stopped and forged.with_arm().with_stop(0.0).stopped


def test_an_operator_that_just_started_outranks_old_commands() -> None:
    old = StopLatch().with_stop(1_700_000_000.0).with_arm()
    assert not old.stopped
    assert old.merge(NO_COMMAND.with_stop(1_700_000_000.5)).stopped


@given(latches, latches)
def test_an_armed_robot_stays_armed_until_a_newer_stop(known, heard) -> None:
    state = ArmState(known.with_arm())
    armed = state.arm(state.latch.cleared)
    if state.latch.stopped:
        assert not armed.armed
        return
    after = armed.merge(heard)
    assert after.armed == (heard.stop <= state.latch.cleared)
    assert after.disarmed_count == (not after.armed)


@pytest.mark.parametrize("cleared", [0, 6])
def test_an_arm_command_below_a_known_stop_has_no_effect(cleared) -> None:
    assert not ArmState(StopLatch(stop=7)).arm(cleared).armed
    assert ArmState(StopLatch(stop=7)).arm(7).armed
