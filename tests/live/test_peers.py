"""Clock offsets and instances of other processes, from the stamps and ids of their messages."""

import numpy as np
import pytest

from skyherd.live.peers import CONFLICT_S, FORGET_S, MAX_FORMER, MAX_PEERS, ClockLimits, Instances, PeerClocks
from skyherd.live.wire import Envelope, Heartbeat
from skyherd.messages import MotionGoals

LIMITS = ClockLimits(1.0, 0.1)


def heartbeat(sent_s: float, heard=None, sender: str = "unit/0", instance: str = "a") -> Envelope:
    return Envelope(sender, sent_s, Heartbeat(heard or {}), instance)


def compared(offset_s: float, delay_s: float = 0.02) -> PeerClocks:
    """Return the clocks of `robot/1`, compared with a unit whose clock is ahead by `offset_s`."""
    clocks = PeerClocks("robot/1", LIMITS)
    ours_s = 100.0
    theirs_s = ours_s + delay_s + offset_s
    clocks.hear(heartbeat(theirs_s + 0.1, {"robot/1": (ours_s, theirs_s)}), ours_s + 2 * delay_s + 0.1)
    return clocks


class TestPeerClocks:
    @pytest.mark.parametrize("offset_s", [-0.9, 0.0, 0.4])
    def test_offset_error_is_below_the_latency(self, offset_s) -> None:
        known = compared(offset_s).estimate("unit/0", 100.14)
        assert known.offset_s == pytest.approx(offset_s, abs=1e-3)
        assert known.uncertainty_s == pytest.approx(0.02, abs=1e-3)

    def test_stamp_in_the_future_is_ignored(self) -> None:
        """With this stamp, the other clock would appear to be hours behind."""
        clocks = compared(0.4)
        clocks.hear(heartbeat(100.7, {"robot/1": (9999.0, 100.6)}), 100.3)
        assert clocks.resets() == 0
        assert clocks.estimate("unit/0", 100.3).offset_s == pytest.approx(0.4, abs=0.02)

    def test_stamp_of_now_is_used(self) -> None:
        clocks = PeerClocks("robot/1", LIMITS)
        clocks.hear(heartbeat(100.0, {"robot/1": (100.0, 100.0)}), 100.0)
        assert clocks.estimate("unit/0", 100.0).is_known

    @pytest.mark.parametrize(
        ("offset_s", "delay_s", "why"),
        [
            (0.0, 0.02, None),
            (1.5, 0.02, "+1.5 s off"),
            (-1.5, 0.02, "-1.5 s off"),
            (0.0, 0.2, "uncertain by 0.2 s"),
        ],
    )
    def test_clock_beyond_limits_is_distrusted(self, offset_s, delay_s, why) -> None:
        found = compared(offset_s, delay_s).distrust("unit/0", 100.5)
        assert found is None if why is None else why in found
        assert "not compared yet" in compared(offset_s).distrust("unit/7", 100.5)

    @pytest.mark.parametrize(("sent_s", "after"), [(100.46, False), (100.51, False), (100.55, True)])
    def test_sent_after_requires_lead_above_uncertainty(self, sent_s, after) -> None:
        """The other clock is ahead by 0.4 s ± 0.02 s: 100.1 s on ours is 100.5 s on theirs."""
        clocks = compared(0.4)
        assert clocks.was_sent_after(heartbeat(sent_s), 100.1, 100.3) == after

    def test_silent_process_is_forgotten(self) -> None:
        clocks = compared(0.0)
        assert set(clocks.heard(100.2 + FORGET_S - 1)) == {"unit/0"}
        assert not clocks.heard(100.2 + FORGET_S + 1)
        assert not clocks.estimate("unit/0", 100.2 + FORGET_S + 1).is_known

    def test_number_of_names_is_bounded(self) -> None:
        clocks = PeerClocks("robot/1", LIMITS)
        for number in range(MAX_PEERS + 10):
            clocks.hear(heartbeat(0.0, sender=f"x{number}"), 0.0)
        assert len(clocks.heard(0.0)) == MAX_PEERS


class TestInstances:
    def test_restart_is_no_conflict(self) -> None:
        instances = Instances("a")
        for at_s, instance in enumerate("aabbccdd"):
            instances.hear(instance, float(at_s))
        assert not instances.conflict(8.0)

    def test_two_processes_of_one_name_conflict_until_timeout(self) -> None:
        instances = Instances("a")
        for at_s, instance in ((0.0, "b"), (1.0, "a")):
            instances.hear(instance, at_s)
        assert instances.conflict(1.0 + CONFLICT_S)
        assert not instances.conflict(1.1 + CONFLICT_S)

    def test_ambiguous_name_is_distrusted_with_reason(self) -> None:
        clocks = compared(0.0)
        for sent_s, instance in ((100.2, "b"), (100.3, "a")):
            clocks.hear(heartbeat(sent_s, {"robot/1": (sent_s, sent_s)}, instance=instance), sent_s)
        assert clocks.distrust("unit/0", 100.3) == "two processes are named unit/0"

    def test_former_instances_are_bounded(self) -> None:
        instances = Instances("0")
        for number in range(100):
            instances.hear(str(number), 0.0)
        assert len(instances.former) == MAX_FORMER


def test_uncertainty_counts_in_favour_of_a_clock_near_its_limit() -> None:
    """An offset of 0.96 s known to 0.08 s may be within the limit of 1 s, and one of 1.04 s may be too."""
    assert compared(0.96, 0.08).distrust("unit/0", 100.3) is None
    assert compared(1.04, 0.08).distrust("unit/0", 100.3) is None
    assert "off, more than 1 s" in compared(1.04, 0.02).distrust("unit/0", 100.2)


def test_message_of_distrusted_clock_counts_as_sent_before() -> None:
    assert not compared(5.0).was_sent_after(heartbeat(1e6), 100.1, 100.3)
    assert not PeerClocks("robot/1", LIMITS).was_sent_after(heartbeat(1e6), 100.1, 100.3)


def test_times_of_messages_are_shifted_by_the_offset() -> None:
    goals = MotionGoals(0, 107.5, [3], [1.0], [0.0], [20.0], np.zeros((1, 0)), np.zeros((1, 0)))
    ours = compared(0.4).in_our_time(goals, "unit/0", 100.3)
    assert ours.time_s == pytest.approx(107.1, abs=1e-3) and ours.ids.tolist() == [3]
