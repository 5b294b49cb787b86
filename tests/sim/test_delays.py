"""Delays of messages in the loop, and their use by robots and units with different clocks."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from skyherd.control import Delivery, RobotClocks, TeamClock
from skyherd.datasets.configuration.mission import make_mission
from skyherd.datasets.generated.random_missions import Crowd, random_mission
from skyherd.loop import run_steps
from skyherd.messages.clock_offset import DRIFT
from skyherd.sim.agents import make_controller
from skyherd.sim.delays import max_message_delay_s, min_message_delay_s, min_report_delay_s, whole_steps
from skyherd.sim.robot_teams import make_avoidance, make_team

OFFSETS_S = (-4.0, 3.0, 1.5)
"""Readings of the units' clocks at the start, s."""

CASES = [
    # latencies, s; images a second; random delay, s; step, s
    ((0.0, 0.0, 0.0), (5.0, 5.0, 5.0), 0.0, 0.2),
    ((0.05, 0.05, 0.05), (5.0, 5.0, 5.0), 0.0, 0.2),
    ((0.15, 0.15, 0.15), (5.0, 5.0, 5.0), 0.0, 0.1),
    ((0.05, 0.25, 0.1), (5.0, 5.0, 5.0), 0.0, 0.1),
    ((0.05, 0.05, 0.05), (5.0, 3.0, 4.0), 0.3, 0.1),
    ((0.1, 0.1, 0.1), (3.0, 3.0, 3.0), 0.0, 0.1),
]
"""Cases of radios and cameras."""


def mission_of(latencies_s, rates_hz, delay_s, step_s, *, offsets_s=OFFSETS_S):
    tree = random_mission(3, Crowd(3, 5)) | {"perception": "ideal", "step_s": step_s}
    tree["network"] = {"delay_s": delay_s}
    for unit, latency_s, rate_hz, offset_s in zip(
        tree["units"], latencies_s, rates_hz, offsets_s, strict=True
    ):
        unit |= {"latency_s": latency_s, "frame_rate_hz": rate_hz, "clock_offset_s": offset_s}
    return make_mission(tree)


def run_for(mission, seconds, heard=lambda *_: None):
    """Yield the steps of a mission with its robots; `heard` receives the reports of each unit's decisions."""
    teams = []

    def keep(*given):
        teams.append(make_team(*given))
        return teams[0]

    def listening(*given):
        controller = make_controller(*given)
        decide = controller.step

        def step(detections, reports):
            heard(detections, reports)
            return decide(detections, reports)

        controller.step = step
        return controller

    steps = run_steps(mission, team_for=keep, controller_for=listening)
    for step in islice(steps, round(seconds / mission.scenario.step_s)):
        yield step, teams[0]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_measured_message_age_is_low_by_at_most_the_margin(case) -> None:
    """The reference is the world's time: each goal in an inbox, from 10 s on, when robots move.

    The speed bound depends on this margin. With one latency and no random delay the margin is 0, and ages are
    exact up to the clocks' drift.
    """
    mission = mission_of(*case)
    margin_s = make_avoidance(mission.scenario).clock_margin_s
    assert (margin_s == 0) == (len(set(case[0])) == 1 and case[2] == 0)
    taken_s, short_s = {}, []
    for step, team in run_for(mission, 16.0):
        for unit, frame in step.frames.items():
            taken_s[unit, frame.decision.report.time_s] = step.time_s
        now_s = step.time_s + team.clocks.lead_s(step.time_s)
        for unit, robot in np.argwhere(np.isfinite(team.inboxes.imaged_s)).tolist():
            stamp_s = team.inboxes.imaged_s[unit, robot]
            age_s = step.time_s - taken_s[unit, stamp_s]
            if step.time_s >= 10 and age_s <= 1.0:
                short_s.append(age_s - (now_s[robot] - stamp_s))
    assert len(short_s) > 500
    assert max(short_s) <= margin_s + 2 * DRIFT
    if len(set(case[1])) == 1 and margin_s == 0:
        assert min(short_s) >= -2 * DRIFT, "units that take images at one time share one time"


@pytest.mark.parametrize("case", CASES, ids=str)
def test_min_message_delay_is_attained_and_never_undercut(case) -> None:
    """With equal clocks, the minimum is exact for units and robots in the loop."""
    mission = mission_of(*case, offsets_s=(0.0, 0.0, 0.0))
    scenario, received, reported = mission.scenario, [], []

    def heard(detections, reports):
        reported.extend(detections.time_s - report.time_s for report in reports)

    for step, team in run_for(mission, 10.0, heard):
        fresh = np.isclose(team.inboxes.received_s, step.time_s)
        received += (step.time_s - team.inboxes.imaged_s[fresh]).tolist()
    min_s, max_s = min_message_delay_s(scenario), max_message_delay_s(scenario)
    assert min(received) == pytest.approx(min_s, abs=1e-9)
    assert max(received) <= max_s + 1e-9
    assert min(reported) >= min_report_delay_s(scenario) - 1e-9
    if len(set(case[1])) == 1:
        assert min(reported) == pytest.approx(min_report_delay_s(scenario), abs=1e-9)


def test_delays_are_rounded_up_to_whole_steps() -> None:
    """0.3 s are three steps of 0.1 s, in spite of the rounding of the quotient."""
    assert whole_steps(0.3, 0.1) == pytest.approx(0.3)
    assert whole_steps(0.31, 0.1) == pytest.approx(0.4)
    assert whole_steps(0.0, 0.1) == 0.0


def test_leading_unit_clock_becomes_team_time_of_robots() -> None:
    """Units' clocks show -4, 3 and 1.5 s at the start: from 3 s on, all stamps lead the world by 3 s."""
    for step, team in run_for(mission_of(*CASES[1]), 12.0):
        if step.time_s < 3.0:
            continue
        ahead_s = [frame.decision.report.time_s - step.time_s for frame in step.frames.values()]
        assert ahead_s == pytest.approx([3.0] * len(ahead_s), abs=2 * DRIFT)
        heard = np.isfinite(team.inboxes.received_s).any(axis=0)
        assert team.clocks.lead_s(step.time_s)[heard] == pytest.approx(3.0, abs=2 * DRIFT)
    assert heard.all()


def test_robots_learn_team_time_only_from_received_messages(make_goals) -> None:
    clocks = RobotClocks(
        lambda time_s: np.array([10.0, 20.0, 30.0]) + time_s, TeamClock(0.5, 3, listens=True)
    )
    goals = replace(make_goals(0, [4, 6], [1, 1]), time_s=2.0)
    clocks.hear(Delivery(goals, np.array([True, False])), np.array([4, 5, 6]), 1.0)
    assert clocks.lead_s(1.0).tolist() == [1.5, 20.0, 30.0]
