"""Safety rules of a robot: for any input, wheels turn only while every condition holds."""

import math
import re
from dataclasses import replace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from sightings import make_sighting

from skyherd.control import GoalInboxes, MarkerGains, Wheels
from skyherd.control.robots.motion_check import STANDS, STRAYS
from skyherd.live.drivers import SpeedLimits
from skyherd.live.peers import CONFLICT_S, ClockLimits, PeerClocks
from skyherd.live.robot_core import (
    DRIVING,
    MAX_GAP_S,
    MAX_TROUBLE_S,
    NO_SESSION,
    SESSION_SILENCE_S,
    UNSEEN,
    RobotCore,
    RobotLimits,
)
from skyherd.live.stop_latch import NO_COMMAND, StopLatch
from skyherd.live.wire import SESSION, Arm, Envelope, Heartbeat, Stop
from skyherd.messages import MotionGoals, Proximity

pytestmark = pytest.mark.smoke

LIMITS = RobotLimits(
    SpeedLimits(0.5, 2.0, 1.0, 8.0),
    goal_timeout_s=0.5,
    unseen_s=0.8,
)
ROBOT, STEP_S = 3, 0.05


def make_core(delay_s: float = 0.0, **options) -> RobotCore:
    law, clocks = MarkerGains(k=2.0, k_omega=4.0, b_th=0.01, side_m=0.1), ClockLimits(1.0, 0.1)
    return RobotCore(
        ROBOT,
        [0, 1],
        law,
        Wheels(0.6, 3.0),
        LIMITS,
        side_m=0.1,
        delay_s=delay_s,
        clock_limits=clocks,
        **options,
    )


def goals(time_s: float, unit: int = 0, rho: float = 200.0, bearing: float = 0.3) -> MotionGoals:
    return MotionGoals(unit, time_s, [ROBOT], [rho], [bearing], [20.0], np.zeros((1, 0)), np.zeros((1, 0)))


class Scene:
    """A robot and a unit that exchange messages without latency. The unit's clock is ahead by `offset_s`."""

    def __init__(self, offset_s: float = 0.0, start_s: float = 100.0) -> None:
        self.core, self.now_s, self.offset_s = make_core(), start_s, offset_s
        self.orders = []

    def unit_says(self, message) -> None:
        self.core.receive(Envelope("unit/0", self.now_s + self.offset_s, message), self.now_s)

    def compare_clocks(self) -> None:
        self.unit_says(Heartbeat({"robot/3": (self.now_s, self.now_s + self.offset_s)}))

    def arm(self) -> None:
        latch = self.core.latch.with_arm()
        arm = Arm({"robot/3": self.core.session})
        self.core.receive(Envelope("operator", self.now_s, arm, latch=latch), self.now_s)

    def stop(self) -> None:
        latch = self.core.latch.with_stop(self.now_s, 0)
        self.core.receive(Envelope("operator", self.now_s, Stop("test"), latch=latch), self.now_s)

    def see(self, age_s: float = 0.0, repeated=()) -> None:
        taken_s = self.now_s + self.offset_s - age_s
        self.unit_says(make_sighting(taken_s, [] if ROBOT in repeated else [ROBOT], list(repeated)))
        self.unit_says(goals(taken_s))

    def step(self):
        self.now_s += STEP_S
        self.orders.append(self.core.decide(self.now_s))
        return self.orders[-1]

    def wake(self) -> None:
        """Let the robot make its first decision, and then receive a message from a unit."""
        self.core.decide(self.now_s)
        self.now_s += STEP_S
        self.core.decide(self.now_s)
        self.compare_clocks()

    def drive(self, steps: int = 10):
        self.wake()
        self.see()
        self.arm()
        for _ in range(steps):
            self.see()
            order = self.step()
        return order


class TestMotion:
    """A robot whose marker moves otherwise than its wheels were told is disarmed."""

    @staticmethod
    def drive(fixed_units, steps: int, side_px: float = 20.0, turn: float = 1.0, speed: float = 1.0):
        """Drive for some steps, with a marker that moves by these shares of the commands."""
        scene, place, heading = Scene(), 0j, 0.0
        scene.core = make_core(fixed_units=fixed_units)
        scene.wake()
        scene.see()
        scene.arm()
        for _ in range(steps):
            seen = {"center_px": place.conjugate(), "heading_rad": -heading}
            scene.unit_says(make_sighting(scene.now_s, [ROBOT], **seen))
            scene.unit_says(goals(scene.now_s))
            order = scene.step()
            heading += turn * order.omega_radps * STEP_S
            place += speed * order.v_mps * STEP_S / 0.1 * side_px * np.exp(1j * heading)
        return scene

    def test_following_robot_drives_on(self) -> None:
        assert self.drive({0: True}, 200).orders[-1].reason == DRIVING

    @pytest.mark.parametrize(
        ("wrong", "fault"), [({"turn": -1.0, "speed": -1.0}, STRAYS), ({"turn": 0, "speed": 0}, STANDS)]
    )
    def test_wrong_motion_disarms_until_the_next_arm_command(self, wrong, fault) -> None:
        scene = self.drive({0: True}, 100, **wrong)
        order = scene.orders[-1]
        assert (order.reason, order.v_mps, order.omega_radps) == (f"disarmed; {fault}", 0.0, 0.0)
        first = [order.reason for order in scene.orders].index(f"disarmed; {fault}")
        assert 3.0 <= first * STEP_S <= 4.0
        scene.arm()
        scene.see()
        assert scene.step().reason == DRIVING
        scene.stop()
        scene.core.receive(
            Envelope("unit/0", scene.now_s, Heartbeat({}), latch=scene.core.latch.with_arm()), 0.0
        )
        scene.see()
        assert scene.step().reason == "disarmed"

    def test_flying_unit_judges_the_turn_alone(self) -> None:
        assert self.drive({0: False}, 200, speed=-1.0).orders[-1].reason == DRIVING
        assert STRAYS in self.drive({0: False}, 200, turn=-1.0).orders[-1].reason

    def test_unit_that_does_not_judge_disarms_no_robot(self) -> None:
        assert self.drive({1: True}, 200, turn=-1.0, speed=-1.0).orders[-1].reason == DRIVING

    def test_late_images_and_a_slow_drive_are_no_fault(self) -> None:
        """The robot turns to and fro, 0.6 s after its commands, in images that are 0.3 s old."""
        scene = Scene()
        scene.core = make_core(fixed_units={0: True})
        scene.wake()
        scene.see()
        scene.arm()
        headings, commands = [0.0], [0.0] * round(0.6 / STEP_S)
        for step in range(400):
            heading = headings[max(len(headings) - 1 - round(0.3 / STEP_S), 0)]
            taken_s = scene.now_s - 0.3
            scene.compare_clocks()
            scene.unit_says(make_sighting(taken_s, [ROBOT], heading_rad=-heading))
            scene.unit_says(goals(taken_s, rho=1.0, bearing=2.0 if step % 60 < 30 else -2.0))
            order = scene.step()
            commands.append(order.omega_radps)
            headings.append(headings[-1] + STEP_S * commands[-1 - round(0.6 / STEP_S)])
        assert scene.core.armed and max(np.abs(np.diff(headings[::20]))) > 1.0

    def test_motion_while_disarmed_does_not_count(self) -> None:
        """Before the first drive a robot is carried to its place."""
        scene = Scene()
        scene.core = make_core(fixed_units={0: True})
        scene.wake()
        for step in range(200):
            if step == 150:
                scene.arm()
            place = min(step, 150) * 3.0
            scene.unit_says(make_sighting(scene.now_s, [ROBOT], center_px=place))
            scene.unit_says(goals(scene.now_s, rho=0.0))
            scene.step()
        assert scene.core.armed


class TestSession:
    """A robot that `live run` runs drives only while that is heard."""

    @staticmethod
    def scene(*, beats: bool) -> Scene:
        scene = Scene()
        scene.core = make_core(supervised=True)
        scene.wake()
        scene.see()
        if beats:
            scene.core.receive(Envelope(SESSION, scene.now_s, Heartbeat({})), scene.now_s)
        return scene

    def test_robot_without_a_session_yet_cannot_be_armed(self) -> None:
        scene = self.scene(beats=False)
        scene.arm()
        assert not scene.core.armed and not scene.core.heartbeat(scene.now_s, "").ready
        assert scene.step().reason == NO_SESSION

    def test_silent_session_disarms_and_does_not_rearm(self) -> None:
        """A suspended session hears no space bar. When it goes on, the robot stands until it is armed."""
        scene = self.scene(beats=True)
        heard_s = scene.now_s
        scene.arm()
        while scene.now_s + STEP_S <= heard_s + SESSION_SILENCE_S:
            scene.see()
            assert scene.step().reason == DRIVING
        scene.see()
        order = scene.step()
        assert (order.reason, order.v_mps, order.omega_radps) == (NO_SESSION, 0.0, 0.0)
        assert not scene.core.armed
        scene.core.receive(Envelope(SESSION, scene.now_s, Heartbeat({})), scene.now_s)
        scene.see()
        assert scene.step().reason == "disarmed"
        scene.arm()
        scene.see()
        assert scene.step().reason == DRIVING

    def test_robot_on_its_own_needs_no_session(self) -> None:
        scene = Scene()
        assert scene.drive(steps=60).reason == DRIVING


@pytest.mark.parametrize(("lab", "drives"), [("one", True), ("", True), ("two", False)])
def test_goals_of_a_unit_with_another_lab_file_are_refused(lab, drives) -> None:
    """An older process has the limits and ids of an older file; one without a digest says nothing of it."""
    scene = Scene()
    scene.core = make_core(lab="one")
    scene.unit_says(Heartbeat({"robot/3": (scene.now_s, scene.now_s)}, lab=lab))
    scene.core.decide(scene.now_s)
    scene.now_s += STEP_S
    scene.core.decide(scene.now_s)
    scene.unit_says(Heartbeat({"robot/3": (scene.now_s, scene.now_s)}, lab=lab))
    scene.see()
    scene.arm()
    order = scene.step()
    assert scene.core.armed == drives
    said = DRIVING if drives else "unit/0 has another lab file: end and start all processes"
    assert order.reason == said
    assert scene.core.heartbeat(scene.now_s, "").lab == "one"


@pytest.mark.parametrize("start_s", [0.0, 100.0, 1e6])
def test_clocks_may_begin_at_any_time(start_s) -> None:
    scene = Scene(start_s=start_s)
    assert scene.drive().reason == DRIVING


def test_messages_before_the_first_decision_move_nothing() -> None:
    scene = Scene()
    scene.compare_clocks()
    scene.see()
    scene.core.decide(scene.now_s)
    scene.arm()
    assert scene.core.armed
    assert scene.step().reason == "no message from a unit since the process started or woke up"


def test_limits_of_time_are_inclusive() -> None:
    """Times that are exact in binary, from 0 s: each limit itself still counts as within it."""
    limits = RobotLimits(LIMITS.speeds, goal_timeout_s=0.5, unseen_s=0.75)
    scene = Scene(start_s=0.0)
    scene.core.limits = limits
    scene.core.decide(0.0)
    assert scene.core.decide(0.0).reason == UNSEEN, "two decisions at one time are no jump"
    assert scene.core.decide(MAX_GAP_S).reason == UNSEEN, "nor are two that are MAX_GAP_S apart"
    scene.now_s = MAX_GAP_S
    scene.compare_clocks()
    scene.see()
    seen_s = scene.now_s
    assert scene.core.is_ready(seen_s + limits.unseen_s)
    assert not scene.core.is_ready(np.nextafter(seen_s + limits.unseen_s, 2 * seen_s))
    scene.see(repeated=[ROBOT])
    assert "two places" in scene.core.decide(seen_s + limits.unseen_s).reason
    scene.core.receive(Envelope("robot/3", seen_s, Heartbeat({}), "another"), seen_s)
    scene.now_s = seen_s + CONFLICT_S
    scene.compare_clocks()
    scene.see()
    assert not scene.core.is_ready(scene.now_s) and scene.core.is_ready(scene.now_s + 0.01)


def test_image_of_exactly_the_timeout_is_fresh() -> None:
    scene = Scene(start_s=0.0)
    scene.wake()
    scene.core.clocks = PeerClocks("robot/3", ClockLimits(1.0, 0.1))
    scene.now_s = 1.0
    scene.compare_clocks()
    scene.see(age_s=LIMITS.goal_timeout_s)
    offset_s = scene.core.clocks.estimate("unit/0", scene.now_s).offset_s
    assert offset_s == 0.0
    assert scene.core.image_age_s(scene.now_s) == LIMITS.goal_timeout_s


@pytest.mark.parametrize("doubled_before_s", [0.75, 0.8])
def test_two_places_are_forgotten_at_jump_after_the_timeout(doubled_before_s) -> None:
    scene = Scene(start_s=0.0)
    scene.core.limits = RobotLimits(LIMITS.speeds, goal_timeout_s=0.5, unseen_s=0.75)
    scene.core.decide(0.0)
    scene.compare_clocks()
    scene.see(repeated=[ROBOT])
    scene.core.decide(doubled_before_s)
    scene.core.decide(10.0)
    assert ("two places" in scene.core.decide(10.0).reason) == (doubled_before_s == 0.75)


def test_goals_of_late_images_account_for_recorded_motion(monkeypatch) -> None:
    """As with a memory without end. A robot that knows a delay of its drive decides differently."""

    def wanted(memory_s: float | None, delay_s: float = 0.0) -> tuple[float, float]:
        scene = Scene()
        scene.core = make_core(delay_s)
        if memory_s is not None:
            scene.core._motion.memory_s = memory_s
        scene.drive(30)
        scene.now_s += 0.1
        scene.unit_says(make_sighting(scene.now_s, [ROBOT]))
        scene.core._team.inboxes = GoalInboxes(
            np.array([ROBOT]), np.array([0, 1]), LIMITS.goal_timeout_s, distances=False
        )
        scene.unit_says(goals(scene.now_s - 0.48, rho=40.0))
        order = scene.core.decide(scene.now_s)
        assert order.reason == DRIVING
        return order.wanted_v_mps, order.wanted_omega_radps

    assert wanted(None) == wanted(100.0) == wanted(None, delay_s=0.0)
    assert wanted(0.3) != wanted(None) != wanted(None, delay_s=0.2)


def test_report_of_bodies_without_avoidance_has_no_effect() -> None:
    scene = Scene()
    scene.drive()
    pair = [ROBOT], [4], [3.0], [0.0], [2.2], [1.0]
    scene.unit_says(Proximity(0, scene.now_s, 8.0, [ROBOT, 4], *pair))
    scene.see()
    assert scene.step().reason == DRIVING


def test_disarmed_robot_reports_wanted_command() -> None:
    scene = Scene()
    scene.wake()
    for _ in range(5):
        scene.see()
        order = scene.step()
    assert order.reason == "disarmed"
    assert (order.v_mps, order.omega_radps) == (0.0, 0.0)
    assert order.wanted_v_mps > 0 and order.wanted_omega_radps > 0


def test_armed_robot_drives_within_limits() -> None:
    scene = Scene()
    order = scene.drive(20)
    assert order.reason == DRIVING and order.v_mps == LIMITS.speeds.speed_mps
    speeds = [0.0] + [order.v_mps for order in scene.orders]
    assert max(np.diff(speeds)) <= LIMITS.speeds.acceleration_mps2 * STEP_S + 1e-12
    assert scene.orders[0].v_mps > 0


@pytest.mark.parametrize("offset_s", [0.0, 0.2, -0.9])
def test_watchdog_stops_robot_on_stale_goals(offset_s) -> None:
    scene = Scene(offset_s)
    assert scene.drive().reason == DRIVING
    last_s = scene.now_s - STEP_S  # Time of the last image.
    reasons = []
    while scene.now_s < last_s + 2.0:
        order = scene.step()
        reasons.append((scene.now_s - last_s, order))
    for age_s, order in reasons:
        if abs(age_s - LIMITS.goal_timeout_s) > 1e-6:
            assert (order.v_mps != 0) == (age_s < LIMITS.goal_timeout_s), age_s
    assert reasons[-1][1].reason == "no unit sees its marker"


def test_repeated_stale_images_do_not_move_robot() -> None:
    scene = Scene()
    scene.drive()
    for _ in range(30):
        scene.see(age_s=LIMITS.goal_timeout_s + 0.01)
        order = scene.step()
    assert order.v_mps == 0 and "stale image" in order.reason


@pytest.mark.parametrize(("offset_s", "drives"), [(0.2, True), (-0.9, True), (2.0, False), (-20.0, False)])
def test_clock_offset_is_compensated_or_reported(offset_s, drives) -> None:
    order = Scene(offset_s).drive(20)
    assert (order.reason == DRIVING) == drives
    if not drives:
        assert order.v_mps == 0 and f"{offset_s:+.2g} s off" in order.reason


def test_image_from_the_future_is_refused() -> None:
    scene = Scene()
    scene.drive()
    for _ in range(30):
        scene.see(age_s=-0.3)
        order = scene.step()
    assert order.v_mps == 0 and "in the future" in order.reason


def test_robot_without_compared_clocks_stands_still() -> None:
    scene = Scene()
    scene.core.decide(scene.now_s)
    scene.arm()
    for _ in range(10):
        scene.see()
        order = scene.step()
    assert order.v_mps == 0 and "not compared" in order.reason


def test_marker_at_two_places_stops_robot_until_timeout() -> None:
    scene = Scene()
    scene.drive()
    scene.see(repeated=[ROBOT])
    assert scene.step().v_mps == 0
    doubled_s = scene.now_s - STEP_S
    while scene.now_s < doubled_s + 2.0:
        scene.see()
        order = scene.step()
        if scene.now_s - doubled_s <= LIMITS.unseen_s - 1e-6:
            assert order.v_mps == 0 and "two places" in order.reason
    assert order.reason == DRIVING


def test_goals_without_sightings_do_not_move_robot() -> None:
    scene = Scene()
    scene.drive()
    for _ in range(40):
        scene.unit_says(goals(scene.now_s))
        order = scene.step()
    assert order.v_mps == 0 and order.reason == "no unit sees its marker"


@pytest.mark.parametrize("jump_s", [-5.0, -0.5, 3.0, math.nan, math.inf])
def test_jump_of_own_clock_stops_robot(jump_s) -> None:
    scene = Scene()
    scene.drive()
    order = scene.core.decide(scene.now_s + jump_s)
    assert (order.v_mps, order.omega_radps) == (order.wanted_v_mps, order.wanted_omega_radps) == (0.0, 0.0)
    assert "its own clock" in order.reason
    if math.isfinite(jump_s):
        assert order.reason == f"its own clock jumped by {jump_s:+.3g} s between two decisions"


def test_goals_of_others_and_from_strangers_have_no_effect() -> None:
    scene = Scene()
    scene.drive()
    for _ in range(20):
        scene.unit_says(replace(goals(scene.now_s), ids=[ROBOT + 1]))
        stranger = Envelope("unit/7", scene.now_s, goals(scene.now_s, unit=7))
        scene.core.receive(stranger, scene.now_s)
        order = scene.step()
    assert order.v_mps == 0


def hear(scene: Scene, latch: StopLatch, message=None) -> None:
    """Deliver a message of the unit with a latch to the robot."""
    message = message or Heartbeat({})
    sent_s = scene.now_s + scene.offset_s
    scene.core.receive(Envelope("unit/0", sent_s, message, latch=latch), scene.now_s)


def test_messages_without_valid_clock_are_ignored() -> None:
    scene = Scene()
    scene.wake()
    for _ in range(3):
        taken_s = scene.now_s
        scene.core.receive(Envelope("unit/0", taken_s, make_sighting(taken_s, [ROBOT])), math.inf)
        scene.core.receive(Envelope("unit/0", taken_s, goals(taken_s)), math.nan)
        assert scene.step().reason == "no unit sees its marker"
    assert not scene.core.is_ready(scene.now_s)
    scene.see()
    scene.arm()
    assert scene.step().reason == DRIVING, "clocks are known as before"


def test_arming_requires_recent_sighting() -> None:
    scene = Scene()
    scene.wake()
    scene.arm()
    assert not scene.core.armed and not scene.core.heartbeat(scene.now_s, "").ready
    scene.see()
    assert scene.core.heartbeat(scene.now_s, "").ready
    scene.now_s += LIMITS.unseen_s + 0.01
    scene.arm()
    assert not scene.core.armed
    scene.see(repeated=[ROBOT])
    scene.see()
    scene.arm()
    assert not scene.core.armed, "seen at two places"


def test_namesake_disarms_and_is_reported() -> None:
    scene = Scene()
    scene.drive()
    scene.core.receive(Envelope("robot/3", scene.now_s, Heartbeat({}), "another"), scene.now_s)
    met_s = scene.now_s
    while scene.now_s < met_s + CONFLICT_S - STEP_S:
        scene.see()
        scene.arm()
        order = scene.step()
        assert order.v_mps == 0 and order.reason == "another process is named robot/3"
        assert not scene.core.armed
    scene.step()
    scene.see()
    scene.arm()
    assert scene.step().reason == DRIVING


def test_goals_from_ambiguous_name_are_refused() -> None:
    scene = Scene()
    scene.drive()
    for turn in range(40):
        taken_s = scene.now_s
        for message in (make_sighting(taken_s, [ROBOT]), goals(taken_s)):
            scene.core.receive(Envelope("unit/0", taken_s, message, "ab"[turn % 2]), taken_s)
        order = scene.step()
    assert order.v_mps == 0 and order.reason == "two processes are named unit/0"


def test_goals_of_restarted_unit_are_followed() -> None:
    scene = Scene()
    scene.drive()
    for instance in ("b", "b", "c", "c"):
        taken_s = scene.now_s
        for message in (make_sighting(taken_s, [ROBOT]), goals(taken_s)):
            scene.core.receive(Envelope("unit/0", taken_s, message, instance), taken_s)
        assert scene.step().reason == DRIVING


def test_goal_ages_from_capture_of_its_image() -> None:
    scene = Scene()
    scene.drive()
    scene.now_s += 0.3
    scene.core.decide(scene.now_s)
    scene.see(age_s=0.4)
    captured_s = scene.now_s - 0.4
    while scene.now_s < captured_s + LIMITS.goal_timeout_s + 0.2:
        scene.unit_says(make_sighting(scene.now_s, [ROBOT]))
        order = scene.step()
        age_s = scene.now_s - captured_s
        if abs(age_s - LIMITS.goal_timeout_s) > 1e-6:
            assert (order.reason == DRIVING) == (age_s < LIMITS.goal_timeout_s), age_s
    assert order.reason == "no fresh goal"


class TestStop:
    def test_disarms_and_voids_pending_arm(self) -> None:
        scene = Scene()
        scene.drive()
        late = Envelope("operator", scene.now_s, Arm({"robot/3": scene.core.session}), latch=StopLatch(0, 0))
        scene.stop()
        scene.see()
        assert scene.step().reason == "stopped"
        scene.core.receive(late, scene.now_s)
        scene.see()
        assert scene.step().reason == "stopped" and not scene.core.armed
        scene.arm()
        scene.see()
        assert scene.step().reason == DRIVING

    @pytest.mark.parametrize("message", [Heartbeat({}), Arm({}), make_sighting(1e3, [ROBOT])])
    def test_newer_stop_in_any_message_disarms(self, message) -> None:
        scene = Scene()
        scene.drive()
        hear(scene, StopLatch(stop=1), message)
        scene.see()
        assert scene.step().reason == "stopped" and not scene.core.armed

    def test_newer_stop_disarms_without_valid_clock(self) -> None:
        scene = Scene()
        scene.drive()
        scene.core.receive(Envelope("unit/0", 0.0, Heartbeat({}), latch=StopLatch(stop=1)), math.nan)
        assert not scene.core.armed and scene.core.latch.stopped

    def test_old_number_disarms_without_latching(self) -> None:
        scene = Scene()
        hear(scene, StopLatch(stop=8, cleared=8))
        scene.drive()
        scene.core.receive(
            Envelope("operator", scene.now_s, Stop("late"), latch=StopLatch(stop=5)), scene.now_s
        )
        scene.see()
        assert scene.step().reason == "disarmed"
        scene.arm()
        scene.see()
        assert scene.step().reason == DRIVING

    def test_arm_below_known_stop_has_no_effect(self) -> None:
        scene = Scene()
        scene.wake()
        scene.see()
        ignorant = Envelope("operator", scene.now_s, Arm({"robot/3": scene.core.session}), latch=NO_COMMAND)
        hear(scene, StopLatch(stop=4))
        scene.core.receive(ignorant, scene.now_s)
        assert not scene.core.armed
        scene.arm()
        assert scene.core.armed

    def test_speed_after_stop_grows_from_zero(self) -> None:
        scene = Scene()
        assert scene.drive(20).v_mps == LIMITS.speeds.speed_mps
        scene.stop()
        scene.see()
        assert scene.step().v_mps == 0
        scene.arm()
        scene.see()
        assert 0 < scene.step().v_mps <= LIMITS.speeds.acceleration_mps2 * STEP_S + 1e-12


def test_two_places_are_remembered_across_clock_jump() -> None:
    scene = Scene()
    scene.drive()
    scene.see(repeated=[ROBOT])
    scene.now_s += 0.1
    scene.core.decide(scene.now_s)
    woke_s = scene.now_s = scene.now_s + 5.0
    scene.core.decide(scene.now_s)
    while scene.now_s < woke_s + LIMITS.unseen_s - STEP_S:
        scene.see()
        order = scene.step()
        assert order.reason == "its marker is seen at two places"
    scene.see()
    scene.step()
    scene.see()
    assert scene.step().reason == DRIVING


def test_sighting_from_the_future_counts_from_now() -> None:
    scene = Scene()
    scene.drive()
    scene.see(age_s=-0.04)
    seen_s = scene.now_s
    while scene.now_s < seen_s + LIMITS.unseen_s:
        order = scene.step()
    scene.now_s = seen_s + LIMITS.unseen_s + 0.02
    assert not scene.core.is_ready(scene.now_s)
    assert order.v_mps == 0


def test_robot_after_sleep_waits_for_newly_sent_message() -> None:
    """A goal sent before the process woke up has no effect, whatever the age of its image."""
    scene = Scene()
    scene.drive()
    asleep = scene.now_s + 2.0
    scene.now_s = asleep
    sent_before = Envelope("unit/0", asleep - 0.01, goals(asleep - 0.01))
    seen_before = Envelope("unit/0", asleep - 0.01, make_sighting(asleep - 0.01, [ROBOT]))
    assert "its own clock jumped" in scene.core.decide(scene.now_s).reason
    for envelope in (seen_before, sent_before):
        scene.core.receive(envelope, scene.now_s)
    assert scene.step().reason == "no message from a unit since the process started or woke up"
    scene.see()
    assert scene.step().reason == DRIVING


@pytest.mark.parametrize("session", ["", "99.000000/0", "another"])
def test_arm_command_of_another_session_does_nothing(session) -> None:
    """A robot that restarted is in another session than the command names."""
    scene = Scene()
    scene.wake()
    scene.see()
    scene.core.receive(Envelope("operator", scene.now_s, Arm({"robot/3": session})), scene.now_s)
    scene.core.receive(Envelope("operator", scene.now_s, Arm({"robot/4": scene.core.session})), scene.now_s)
    assert not scene.core.armed
    scene.arm()
    assert scene.core.armed


def test_image_age_is_that_of_the_newest_goal() -> None:
    scene = Scene(offset_s=0.3)
    assert scene.core.image_age_s(scene.now_s) is None
    scene.drive()
    scene.see(age_s=0.1)
    assert scene.core.image_age_s(scene.now_s + 0.2) == pytest.approx(0.2 + STEP_S, abs=1e-3)
    assert scene.core.image_age_s(scene.now_s) == pytest.approx(STEP_S, abs=1e-3)


@pytest.mark.parametrize(("ahead_s", "accepted"), [(0.09, True), (0.15, False)])
def test_future_image_is_accepted_within_uncertainty(ahead_s, accepted) -> None:
    """Clocks are known to 0.06 s here; beyond that, `FUTURE_S` of 0.05 s is allowed."""
    scene = Scene()
    scene.wake()
    scene.core.clocks = PeerClocks("robot/3", ClockLimits(1.0, 0.1))
    sent_s = scene.now_s - 0.12
    scene.core.receive(
        Envelope("unit/0", sent_s + 0.06, Heartbeat({"robot/3": (sent_s, sent_s + 0.06)})), scene.now_s
    )
    assert scene.core.clocks.estimate("unit/0", scene.now_s).uncertainty_s == pytest.approx(0.06, abs=1e-3)
    scene.core.receive(Envelope("unit/0", scene.now_s - 0.05, goals(scene.now_s + ahead_s)), scene.now_s)
    assert (scene.core.image_age_s(scene.now_s) is not None) == accepted
    if not accepted:
        assert re.fullmatch(r"image of unit/0 is 0\.1\d s in the future", scene.step().reason)


@pytest.mark.parametrize("slow", ["to the robot", "to the unit"])
def test_watchdog_counts_the_uncertainty_of_clocks_as_age(slow) -> None:
    """Messages take 0.18 s one way and nothing the other, so that the estimated offset is wrong by half."""
    scene = Scene()
    scene.wake()
    scene.core.clocks = PeerClocks("robot/3", ClockLimits(1.0, 0.1))
    down_s, up_s = (0.18, 0.0) if slow == "to the robot" else (0.0, 0.18)
    sent_s = scene.now_s - down_s
    exchange = Heartbeat({"robot/3": (sent_s - up_s, sent_s)})
    scene.core.receive(Envelope("unit/0", sent_s, exchange), scene.now_s)
    assert scene.core.clocks.estimate("unit/0", scene.now_s).uncertainty_s == pytest.approx(0.09, abs=2e-3)
    for message in (make_sighting(sent_s, [ROBOT]), goals(sent_s)):
        scene.core.receive(Envelope("unit/0", sent_s, message), scene.now_s)
    scene.arm()
    while scene.step().reason == DRIVING:
        assert scene.now_s - sent_s <= LIMITS.goal_timeout_s + 1e-9
    assert scene.now_s - sent_s > LIMITS.goal_timeout_s - 0.2
    assert scene.orders[-1].reason == "no fresh goal"
    late = goals(scene.now_s - 0.55)
    scene.core.receive(Envelope("unit/0", scene.now_s - down_s, late), scene.now_s)
    assert re.fullmatch(r"stale image of unit/0: up to 0\.\d+ s old", scene.step().reason)


@pytest.mark.parametrize("other", [ROBOT - 1, ROBOT + 1])
def test_goal_of_another_robot_is_ignored(other) -> None:
    scene = Scene()
    scene.wake()
    empty = np.zeros((2, 0))
    ids, rho = sorted([ROBOT, other]), [1.0, 1.0]
    both = MotionGoals(0, scene.now_s, ids, rho, [0.1 * robot for robot in ids], [20.0, 20.0], empty, empty)
    scene.unit_says(replace(goals(scene.now_s), ids=[other]))
    assert scene.core.image_age_s(scene.now_s) is None
    scene.unit_says(both)
    assert scene.core.image_age_s(scene.now_s) == pytest.approx(0.0, abs=1e-3)
    assert scene.step().wanted_omega_radps == pytest.approx(4.0 * 0.1 * ROBOT, rel=0.2)


actions = st.one_of(
    st.tuples(st.just("see"), st.floats(-1, 2)),
    st.tuples(st.just("double"), st.just(0.0)),
    st.tuples(st.just("compare"), st.floats(-30, 30)),
    st.tuples(st.just("arm"), st.just(0.0)),
    st.tuples(st.just("stop"), st.just(0.0)),
    st.tuples(st.just("goal"), st.floats(0, 1e300)),
    st.tuples(st.just("clock"), st.one_of(st.floats(-3, 3), st.sampled_from([math.nan, math.inf, 1e300]))),
    st.tuples(st.just("wait"), st.floats(0, 0.4)),
)


@given(st.lists(actions, max_size=60))
@settings(max_examples=30)
def test_wheels_turn_only_while_all_conditions_hold(script) -> None:
    """An independent model decides when the robot may move, for any order of events."""
    scene, core = Scene(), make_core()
    scene.core = core
    armed = False
    newest_goal_s = newest_sight_s = -math.inf
    since_double_s = math.inf
    before = (0.0, 0.0)
    decided_s = scene.now_s
    core.decide(scene.now_s)
    for action, value in [("compare", 0.0), ("arm", 0.0), ("see", 0.0), *script]:
        if action == "see":
            scene.see(age_s=value)
            newest_goal_s = max(newest_goal_s, min(scene.now_s - value, scene.now_s))
            newest_sight_s = max(newest_sight_s, min(scene.now_s - value, scene.now_s))
        elif action == "double":
            scene.see(repeated=[ROBOT])
            since_double_s = 0.0 if abs(scene.offset_s) < 0.9 else since_double_s
            newest_goal_s = scene.now_s
        elif action == "compare":
            scene.offset_s = value
            scene.compare_clocks()
        elif action == "arm":
            scene.arm()
            armed = True
        elif action == "stop":
            scene.stop()
            armed = False
        elif action == "goal":
            scene.unit_says(goals(scene.now_s + scene.offset_s, rho=value))
            newest_goal_s = scene.now_s
        elif action == "clock" and not math.isfinite(value):
            assert core.decide(value).v_mps == 0
        else:
            scene.now_s += value
        order = core.decide(scene.now_s)
        gap_s = scene.now_s - decided_s
        decided_s = scene.now_s
        since_double_s += abs(gap_s)
        assert abs(order.v_mps) <= LIMITS.speeds.speed_mps
        assert abs(order.omega_radps) <= LIMITS.speeds.turn_radps
        if order.v_mps or order.omega_radps:
            assert armed and 0 <= gap_s <= 1.0
            assert scene.now_s - newest_goal_s <= LIMITS.goal_timeout_s + 0.2
            assert scene.now_s - newest_sight_s <= LIMITS.unseen_s + 0.2
            grown = abs(order.v_mps) - abs(before[0]), abs(order.omega_radps) - abs(before[1])
            assert grown[0] <= LIMITS.speeds.acceleration_mps2 * gap_s + 1e-9
            assert grown[1] <= LIMITS.speeds.turn_acceleration_radps2 * gap_s + 1e-9
            assert since_double_s >= LIMITS.unseen_s - 1e-6
        before = order.v_mps, order.omega_radps


class TestTroubleOfTheLink:
    def test_robot_with_trouble_is_not_ready(self) -> None:
        scene = Scene()
        scene.wake()
        scene.see()
        assert scene.core.is_ready(scene.now_s)
        scene.core.decide(scene.now_s, "no link")
        assert not scene.core.is_ready(scene.now_s) and not scene.core.heartbeat(scene.now_s, "").ready
        scene.arm()
        assert not scene.core.armed
        scene.core.decide(scene.now_s)
        assert scene.core.is_ready(scene.now_s)

    @pytest.mark.parametrize(
        ("trouble_s", "drives"), [(MAX_TROUBLE_S - STEP_S, True), (MAX_TROUBLE_S + STEP_S, False)]
    )
    def test_long_trouble_disarms_the_robot(self, trouble_s, drives) -> None:
        scene = Scene()
        scene.drive()
        session, began_s = scene.core.session, scene.now_s
        while scene.now_s - began_s < trouble_s + STEP_S / 2:
            scene.now_s += STEP_S
            scene.see()
            order = scene.core.decide(scene.now_s, "no link")
        scene.see()
        after = scene.step()
        assert scene.core.armed == drives == (scene.core.session == session)
        assert (order.reason, after.reason) == ((DRIVING, DRIVING) if drives else ("no link", "disarmed"))
        assert drives or order.v_mps == order.omega_radps == after.v_mps == 0.0

    def test_short_troubles_do_not_add_up(self) -> None:
        scene = Scene()
        scene.drive()
        for number in range(60):
            scene.now_s += STEP_S
            scene.see()
            scene.core.decide(scene.now_s, "no link" if number % 10 else None)
        assert scene.core.armed
