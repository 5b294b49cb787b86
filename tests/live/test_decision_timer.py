"""Timer of a robot's decisions: immediate after goals, once a period without, with a rate limit."""

import numpy as np
import pytest
from live_sessions import Script
from sightings import make_sighting

from skyherd.live.mailbox import Arrival
from skyherd.live.robot_process import MIN_SHARE, DecisionTimer
from skyherd.live.wire import Envelope, Heartbeat, Stop

PERIOD_S = 0.1
GOALS = Script().goals(0)


def arrival(message):
    return Arrival(Envelope("unit/0", 0.0, message), 0.0)


def decisions(news_s, until_s=2.0, step_s=1e-3, message=GOALS, robot=1):
    """Return the times of decisions of a loop that checks its clock every millisecond."""
    timer, made, news = DecisionTimer(PERIOD_S, 0.0), [], list(news_s)
    for now_s in np.arange(0.0, until_s, step_s):
        if now_s >= timer.due_s:
            made.append(now_s)
            timer.decided(now_s)
        while news and news[0] <= now_s:
            news.pop(0)
            timer.hear(arrival(message), robot, now_s)
    return np.array(made)


def test_decision_without_new_goals_once_a_period() -> None:
    assert np.diff(decisions([])) == pytest.approx(PERIOD_S, abs=2e-3)


def test_decision_after_a_goal_immediate() -> None:
    made = decisions([0.155, 0.7])
    for news_s in (0.155, 0.7):
        after = made[made >= news_s]
        assert 0 <= after[0] - news_s <= 3e-3
        assert after[1] - after[0] == pytest.approx(PERIOD_S, abs=3e-3), "and a period later again"
    assert np.diff(made).max() <= PERIOD_S + 2e-3


def test_decisions_under_many_goals_at_most_five_a_period() -> None:
    made = decisions(np.arange(0.0, 2.0, 0.004))
    assert np.diff(made).min() >= MIN_SHARE * PERIOD_S - 1e-9
    assert np.diff(made).max() <= MIN_SHARE * PERIOD_S + 6e-3


def test_decision_after_a_stop_at_once() -> None:
    """Also right after another decision, and for a message of any process."""
    made = decisions([0.205, 0.208], message=Stop("test"), robot=9)
    for news_s in (0.205, 0.208):
        assert 0 <= made[made >= news_s][0] - news_s <= 2e-3
    timer = DecisionTimer(0.5, 0.0)
    timer.decided(0.0)
    timer.hasten(0.01)
    assert timer.due_s == 0.01
    timer.hasten(0.02)
    assert timer.due_s == 0.01


@pytest.mark.parametrize(
    ("message", "robot"),
    [(GOALS, 9), (Heartbeat({}), 1), (make_sighting(0.0, np.array([1])), 1)],
)
def test_other_messages_do_not_advance_the_decision(message, robot) -> None:
    np.testing.assert_array_equal(
        decisions(np.arange(0.0, 2.0, 0.01), message=message, robot=robot), decisions([])
    )


def test_late_decision_restarts_the_period() -> None:
    timer = DecisionTimer(PERIOD_S, 0.0)
    timer.decided(5.0)
    assert timer.due_s == 5.0
    timer.decided(5.0)
    assert timer.due_s == pytest.approx(5.1)
