"""Commands of an operator to a scripted team: confirmations, and reports about other robots."""

import math
from dataclasses import replace

import pytest

from skyherd.live.lab import load_lab
from skyherd.live.mailbox import Air, Mailbox
from skyherd.live.operator import (
    ARM_DELAY_S,
    REPEAT_S,
    SETTLE_S,
    ArmCommand,
    Outcome,
    StopCommand,
    arm,
    stop,
    watch,
)
from skyherd.live.session import Session, outcome_lines
from skyherd.live.stop_latch import MAX_STOP, NO_COMMAND, NOT_HALTED, StopLatch, stop_number
from skyherd.live.wire import Arm, Heartbeat, Stop

LAB = load_lab("triangle")


class ScriptedRobot:
    """Scripted robot that receives commands."""

    def __init__(self, team: "ScriptedTeam", robot: int) -> None:
        self.latch, self.armed, self.ready, self.frozen = NO_COMMAND, False, True, False
        self.is_broken, self.halted, self.trouble = False, NOT_HALTED, ""
        self.mailbox = Mailbox(
            team.air.radio(f"robot/{robot}"),
            LAB.model.team,
            f"robot/{robot}",
            lambda: team.now_s,
            ("arm/**", "stop/**"),
            latch=lambda: self.latch,
        )
        self.commands = []

    def beat(self) -> None:
        session = f"session {self.latch.stop}"
        state = "here" + self.trouble
        self.mailbox.send(Heartbeat({}, state, session, self.armed, self.ready, halted=self.halted))

    def obey(self) -> None:
        for arrival in self.mailbox.fetch():
            self.commands.append(arrival.envelope)
            self.latch = self.latch.merge(arrival.envelope.latch)
            message = arrival.envelope.message
            if isinstance(message, Arm) and self.mailbox.name in message.sessions:
                self.armed = self.ready and not self.latch.stopped
        self.armed = self.armed and not self.latch.stopped
        if not self.is_broken:
            self.halted = NOT_HALTED if self.armed else self.latch.stop


class ScriptedTeam:
    """All robots of the lab `triangle`, and an operator. Its waiting advances the time."""

    def __init__(self, start_s: float = 1000.0, step_s: float = 0.05) -> None:
        self.now_s, self.step_s, self.air = start_s, step_s, Air(now_s=start_s)
        self.robots = {robot: ScriptedRobot(self, robot) for robot in LAB.ids}
        self.watched = watch(LAB, self.air.radio("operator"), lambda: self.now_s)
        self.listen = self.watched.listen
        self.watched.listen = self.pass_time

    def pass_time(self, timeout_s: float) -> None:
        self.now_s += self.step_s
        self.air.advance(self.now_s)
        for robot in self.robots.values():
            if not robot.frozen:
                robot.obey()
                robot.beat()
        self.air.advance(self.now_s)
        self.listen(0.0)


class TestStop:
    def test_robots_that_the_lab_lacks_have_to_confirm(self) -> None:
        """An operator whose lab file has half the robots."""
        team = ScriptedTeam()
        half = replace(LAB, model=LAB.model.model_copy(update={"robots": LAB.model.robots[:3]}))
        team.pass_time(0.0)
        team.robots[5].frozen = True
        outcome = stop(half, team.watched, "test", settle_s=1.5)
        assert outcome.done == [0, 1, 2, 3, 4]
        assert list(outcome.missing) == [5] and outcome.missing[5].startswith("disarmed, here, heard 1.5 s")

    def test_confirmed_by_its_number(self) -> None:
        team = ScriptedTeam()
        outcome = stop(LAB, team.watched, "test")
        assert outcome.done == LAB.ids and outcome.is_complete and team.now_s < 1000.5
        assert all(robot.latch.stopped for robot in team.robots.values())

    def test_not_confirmed_by_old_heartbeat(self) -> None:
        """A heartbeat sent before the stop reports the robot disarmed, and arrives after the stop."""
        team = ScriptedTeam()
        team.pass_time(0.0)
        team.robots[3].frozen = True
        command = StopCommand(LAB, team.watched, "test")
        for _ in range(20):
            team.robots[3].beat()
            team.pass_time(0.05)
            command.advance()
        assert command.outcome().done == [robot for robot in LAB.ids if robot != 3]
        assert "disarmed, here, heard 0.0 s ago" in command.outcome().missing[3]

    def test_not_confirmed_until_the_link_takes_a_zero(self) -> None:
        """Robot 1 took its last zero before the stop; robot 2 has never taken one."""
        team = ScriptedTeam()
        for robot in team.robots.values():
            robot.armed = robot.mailbox.name == "robot/2"
        team.pass_time(0.0)
        for robot in (1, 2):
            team.robots[robot].is_broken, team.robots[robot].trouble = True, "; no link"
        team.pass_time(0.0)
        outcome = stop(LAB, team.watched, "test")
        assert outcome.done == [robot for robot in LAB.ids if robot not in (1, 2)]
        words = "disarmed, here; no link, its link has not taken a zero since, heard 0.0 s ago"
        assert outcome.missing == {1: words, 2: words}
        team.robots[1].is_broken = False
        team.pass_time(0.0)
        assert list(stop(LAB, team.watched, "again").missing) == [2]

    def test_not_confirmed_by_armed_robot(self) -> None:
        team = ScriptedTeam()
        team.robots[2].obey = lambda: None
        team.robots[2].armed, team.robots[2].latch = True, StopLatch(stop=MAX_STOP)
        outcome = stop(LAB, team.watched, "test")
        assert list(outcome.missing) == [2] and outcome.missing[2].startswith("armed, here, heard")

    def test_silent_robot_reported_with_last_state_and_age(self) -> None:
        team = ScriptedTeam()
        team.robots[5].armed = True
        team.pass_time(0.0)
        team.robots[5].frozen = True
        outcome = stop(LAB, team.watched, "test")
        assert outcome.missing == {5: f"armed, here, heard {SETTLE_S:.1f} s ago"}
        assert outcome_lines("stopped", outcome) == [
            "stopped: 0, 1, 2, 3, 4",
            f"NOT stopped: robot 5: armed, here, heard {SETTLE_S:.1f} s ago",
        ]
        never = ScriptedTeam()
        never.robots[0].frozen = True
        assert stop(LAB, never.watched, "test").missing == {0: "never heard"}

    def test_not_confirmed_by_ambiguous_name(self) -> None:
        team = ScriptedTeam()
        twin = ScriptedRobot(team, 4)
        pass_time = team.watched.listen

        def both(timeout_s: float) -> None:
            pass_time(timeout_s)
            twin.obey()
            twin.beat()
            team.air.advance(team.now_s)

        team.watched.listen = both
        for _ in range(3):
            both(0.0)
        assert stop(LAB, team.watched, "test").missing == {4: "two processes are named robot/4"}

    def test_sent_immediately_and_repeated(self) -> None:
        team = ScriptedTeam()
        team.robots[0].frozen = True
        stop(LAB, team.watched, "test")
        team.robots[0].obey()
        stops = [one for one in team.robots[0].commands if isinstance(one.message, Stop)]
        assert stops[0].sent_s == 1000.0 and len({one.latch.stop for one in stops}) == 1
        assert len(stops) == pytest.approx(SETTLE_S / REPEAT_S, abs=3)

    def test_lagging_operator_clock_learns_the_numbers(self) -> None:
        team = ScriptedTeam()
        ahead = StopLatch(stop_number(1e6), stop_number(1e6))
        for robot in team.robots.values():
            robot.latch, robot.armed = ahead, True
        outcome = stop(LAB, team.watched, "test")
        assert outcome.is_complete and team.watched.latch.stop == stop_number(1e6 + 0.001, team.watched.tag)

    @pytest.mark.parametrize("lag_s", [0.0, 5.0])
    def test_never_confirmed_by_the_number_of_an_earlier_stop(self, lag_s) -> None:
        """The team stands since an earlier stop, whose operator arms it without hearing of this one."""
        team = ScriptedTeam(start_s=1000.0 - lag_s)
        earlier = NO_COMMAND.with_stop(998.0, 0)
        for robot in team.robots.values():
            robot.latch = earlier
        outcome = stop(LAB, team.watched, "test")
        assert outcome.is_complete
        assert all(robot.latch.merge(earlier.with_arm()).stopped for robot in team.robots.values())

    def test_learns_the_numbers_once_somebody_is_heard(self) -> None:
        """The radio is up later than an operator needs to learn the numbers of a team that it hears."""
        team = ScriptedTeam()
        ahead = stop_number(2000.0)
        for robot in team.robots.values():
            robot.latch, robot.armed, robot.frozen = StopLatch(ahead, ahead), True, True
        command = StopCommand(LAB, team.watched, "test")
        for step in range(60):
            if step == 40:
                for robot in team.robots.values():
                    robot.frozen = False
            team.pass_time(0.05)
            command.advance()
        assert command.outcome().is_complete and team.watched.latch.stop > ahead

    def test_override_by_newer_arm_reported(self) -> None:
        team = ScriptedTeam()
        team.robots[0].frozen = True
        command = StopCommand(LAB, team.watched, "test")
        for step in range(60):
            team.pass_time(0.05)
            if step == 40:
                team.robots[1].latch = team.robots[1].latch.with_arm()
            command.advance()
        assert command.outcome().failure == "a newer arm command overrides the stop"
        assert not command.outcome().is_complete


class TestArm:
    def test_command_that_was_suspended_arms_nothing(self) -> None:
        """`live arm` asked a silent robot, was suspended, and went on after the time for an arm command."""
        team = ScriptedTeam()
        team.robots[5].frozen = True
        team.pass_time(0.0)
        command = ArmCommand(LAB, team.watched)
        team.pass_time(0.0)
        assert not command.advance() and not command.outcome().failure
        team.pass_time(0.0)
        team.now_s += ARM_DELAY_S
        for robot in team.robots.values():
            robot.armed, robot.commands = False, []
        team.pass_time(0.0)
        assert command.advance()
        team.pass_time(0.0)
        assert not any(robot.armed or robot.commands for robot in team.robots.values())
        assert command.outcome().failure == "the command was given more than 20 s ago"

    def test_single_robots_are_armed_alone(self) -> None:
        """A robot that its commands move away from its goal shows that alone, without others near."""
        team = ScriptedTeam()
        outcome = arm(LAB, team.watched, robots=[4, 2])
        assert outcome.is_complete and outcome.done == [2, 4]
        assert [robot for robot, each in team.robots.items() if each.armed] == [2, 4]

    def test_command_that_starts_late_arms_nothing(self) -> None:
        team = ScriptedTeam()
        outcome = arm(LAB, team.watched, given_s=team.now_s - ARM_DELAY_S)
        assert not outcome.is_complete and not any(robot.armed for robot in team.robots.values())

    def test_learns_the_stop_before_clearing_it(self) -> None:
        team = ScriptedTeam()
        for robot in team.robots.values():
            robot.latch = StopLatch(stop=70)
        outcome = arm(LAB, team.watched)
        assert outcome.is_complete and outcome.done == LAB.ids
        assert team.watched.latch == StopLatch(70, 70)

    def test_cancelled_by_newer_stop(self) -> None:
        team = ScriptedTeam()
        team.robots[5].frozen = True
        team.pass_time(0.0)
        command = ArmCommand(LAB, team.watched)
        for step in range(60):
            team.pass_time(0.05)
            if step == 20:
                team.robots[1].latch = StopLatch(stop=99)
            if command.advance():
                break
        assert 20 <= step <= 22
        assert command.outcome().failure == "a stop is newer than this command"
        assert command.outcome().done == []

    @pytest.mark.parametrize(
        ("stop_s", "clears"),
        [
            pytest.param(997.5, True, id="before the command"),
            pytest.param(998.0, False, id="in the same millisecond"),
            pytest.param(998.5, False, id="while it started"),
            pytest.param(1000.5, False, id="by a clock that is a little ahead"),
            pytest.param(4600.0, True, id="by a clock that is an hour ahead"),
        ],
    )
    def test_does_not_clear_a_stop_that_was_given_since(self, stop_s, clears) -> None:
        """The command was given at 998 s, and its process listens from 1000 s on."""
        team = ScriptedTeam()
        for robot in team.robots.values():
            robot.latch = NO_COMMAND.with_stop(stop_s, 0)
        outcome = arm(LAB, team.watched, given_s=998.0)
        assert all(robot.armed == clears for robot in team.robots.values())
        assert team.watched.latch.stopped != clears
        assert outcome.failure == ("" if clears else "a stop is newer than this command")

    def test_does_not_clear_a_stop_that_it_hears_meanwhile(self) -> None:
        """Its clock is far behind, so that its number says nothing about its time."""
        team = ScriptedTeam()
        other = watch(LAB, team.air.radio("other"), lambda: team.now_s - 500.0, "other")
        StopCommand(LAB, other, "test")
        assert arm(LAB, team.watched).failure == "a stop is newer than this command"
        assert not any(robot.armed for robot in team.robots.values())

    def test_names_each_robot_until_it_is_armed(self) -> None:
        """The same command does not arm a robot again that was disarmed, by a restart for example."""
        team = ScriptedTeam()
        team.robots[5].ready = False
        command = ArmCommand(LAB, team.watched)
        for _ in range(20):
            team.pass_time(0.05)
            command.advance()
        assert command.outcome().done == [0, 1, 2, 3, 4]
        team.robots[0].armed = False
        for _ in range(20):
            team.pass_time(0.05)
            command.advance()
        assert not team.robots[0].armed
        last = [one for one in team.robots[5].commands if isinstance(one.message, Arm)][-1]
        assert set(last.message.sessions) == {"robot/5"}

    def test_after_forged_stop_reports_remedy(self) -> None:
        team = ScriptedTeam()
        team.robots[3].latch = StopLatch(stop=MAX_STOP)
        outcome = arm(LAB, team.watched)
        assert outcome.done == [] and "restart the whole team" in outcome.failure
        assert stop(LAB, team.watched, "test").is_complete, "a stop still holds"


class Lines(list):
    def __call__(self, name: str, line: str) -> None:
        self.append(line)


def session_of(team: ScriptedTeam, *, arms: bool) -> tuple[Session, Lines]:
    lines = Lines()
    return Session(LAB, team.watched, lines, arms=arms), lines


class TestSession:
    def test_arms_when_all_robots_are_ready(self) -> None:
        team = ScriptedTeam()
        team.robots[2].ready = False
        session, lines = session_of(team, arms=True)
        for _ in range(30):
            session.step("", 0.05)
        assert session.arms and not any(robot.armed for robot in team.robots.values())
        team.robots[2].ready = True
        for _ in range(30):
            session.step("", 0.05)
        assert lines == ["armed: 0, 1, 2, 3, 4, 5"]

    def test_arms_no_robot_twice(self) -> None:
        team = ScriptedTeam()
        session, lines = session_of(team, arms=True)
        for _ in range(20):
            session.step("", 0.05)
        team.robots[4].armed = False
        heard = len(team.robots[4].commands)
        for _ in range(100):
            session.step("", 0.05)
        assert not team.robots[4].armed and len(team.robots[4].commands) == heard and len(lines) == 1

    def test_stop_of_any_operator_cancels_pending_arm(self) -> None:
        team = ScriptedTeam()
        team.robots[2].frozen = True
        session, lines = session_of(team, arms=True)
        for _ in range(10):
            session.step("", 0.05)
        team.robots[1].latch = StopLatch(stop=5)
        session.step("", 0.05)
        team.robots[2].frozen = False
        for _ in range(50):
            session.step("", 0.05)
        assert not session.arms and not any(robot.armed for robot in team.robots.values())
        assert lines == ["the team was stopped: press a to arm the robots"]
        for _ in range(20):
            session.step("a" if _ == 0 else "", 0.05)
        assert lines[1:] == ["armed: 0, 1, 2, 3, 4, 5"]

    def test_space_bar_stops_before_messages_are_read(self) -> None:
        team = ScriptedTeam()
        session, lines = session_of(team, arms=True)
        for _ in range(20):
            session.step("", 0.05)
        session.step(" ", 0.05)
        assert not any(robot.armed for robot in team.robots.values())
        for _ in range(5):
            session.step("", 0.05)
        assert lines[-1] == "stopped: 0, 1, 2, 3, 4, 5"

    def test_stop_of_the_page_has_priority_over_arm(self) -> None:
        """Later the key arms as before."""
        team = ScriptedTeam()
        session, lines = session_of(team, arms=False)
        session.step("a", 0.05, page_stops=True)
        for _ in range(20):
            session.step("", 0.05)
        assert not any(robot.armed for robot in team.robots.values())
        assert lines == ["stopped: 0, 1, 2, 3, 4, 5"]
        for number in range(20):
            session.step("a" if number == 0 else "", 0.05)
        assert lines[-1] == "armed: 0, 1, 2, 3, 4, 5"

    def test_key_does_not_clear_a_stop_that_arrives_after_it(self) -> None:
        team = ScriptedTeam()
        session, said = session_of(team, arms=False)
        session.step("", 0.05)
        StopCommand(LAB, watch(LAB, team.air.radio("other"), lambda: team.now_s, "other"), "test")
        session.step("a", 0.05)
        for _ in range(20):
            session.step("", 0.05)
        assert not any(robot.armed for robot in team.robots.values()) and team.watched.latch.stopped
        assert "NOT armed: a stop is newer than this command" in said
        session.step("a", 0.05)
        session.step("", 0.05)
        assert not team.watched.latch.stopped

    def test_stop_of_the_page_cancels_pending_arm(self) -> None:
        team = ScriptedTeam()
        team.robots[2].frozen = True
        session, _ = session_of(team, arms=True)
        session.step("", 0.05, page_stops=True)
        team.robots[2].frozen = False
        for _ in range(30):
            session.step("", 0.05)
        assert not session.arms and not any(robot.armed for robot in team.robots.values())

    def test_heartbeat_carries_stop_to_restarted_processes(self) -> None:
        team = ScriptedTeam()
        session, _ = session_of(team, arms=False)
        session.step(" ", 0.05)
        heard = []
        newcomer = Mailbox(
            team.air.radio("unit/0"), LAB.model.team, "unit/0", lambda: team.now_s, ("heartbeat/**",)
        )
        for _ in range(10):
            session.step("", 0.05)
        heard = [arrival.envelope for arrival in newcomer.fetch() if arrival.envelope.sender == "operator"]
        assert heard and all(envelope.latch.stopped for envelope in heard)

    def test_sends_heartbeats_at_their_period(self) -> None:
        """The clock starts at zero, and its times are exact in binary."""
        team = ScriptedTeam(start_s=0.0, step_s=0.125)
        session, _ = session_of(team, arms=False)
        unit = Mailbox(
            team.air.radio("unit/0"), LAB.model.team, "unit/0", lambda: team.now_s, ("heartbeat/**",)
        )
        for _ in range(9):
            session.step("", 0.05)
        team.air.advance(team.now_s)
        sent_s = [one.envelope.sent_s for one in unit.fetch() if one.envelope.sender == "operator"]
        assert sent_s == [0.125, 0.375, 0.625, 0.875, 1.125]

    @pytest.mark.parametrize("step_s", [0.125, 0.7])
    @pytest.mark.parametrize(("key", "word"), [("a", "armed"), (" ", "stopped")])
    def test_command_of_key_ends_after_settle_time(self, key, word, step_s) -> None:
        """Robot 5 is silent. A stop begins before messages are read, an arm command after."""
        team = ScriptedTeam(step_s=step_s)
        team.robots[5].frozen = True
        session, lines = session_of(team, arms=False)
        team.pass_time(0.0)
        began_s = team.now_s + step_s * (key == "a")
        session.step(key, 0.05)
        while not lines and team.now_s < 1020:
            session.step("", 0.05)
        assert team.now_s - began_s == pytest.approx(math.ceil(SETTLE_S / step_s) * step_s)
        assert lines == [f"{word}: 0, 1, 2, 3, 4", f"NOT {word}: robot 5: never heard"]

    @pytest.mark.parametrize("key", ["A", "b", "x", "!", "~", "\r"])
    def test_other_keys_have_no_effect(self, key) -> None:
        team = ScriptedTeam()
        session, lines = session_of(team, arms=False)
        for _ in range(3):
            session.step(key, 0.05)
        session.step("", 0.05)
        assert not lines and not any(robot.commands for robot in team.robots.values())

    def test_run_on_another_machine_is_reported_once(self) -> None:
        team = ScriptedTeam()
        session, lines = session_of(team, arms=False)
        session.step("", 0.05)
        assert not lines
        other = Mailbox(team.air.radio("session"), LAB.model.team, "session", lambda: team.now_s, ())
        for _ in range(5):
            other.send(Heartbeat({}, "runs the lab"))
            session.step("", 0.05)
        assert lines == ["another `live run` of this team runs on another machine: end one of them"]


def test_silent_robot_is_reported_with_news_of_units() -> None:
    """The operator has just started. A unit, whose clock is 50 s ahead, heard the robot 2 s before."""
    team = ScriptedTeam()
    team.robots[0].frozen = True
    clock = lambda: team.now_s + 50.0  # noqa: E731
    unit = Mailbox(team.air.radio("unit/0"), LAB.model.team, "unit/0", clock, ())
    heard_s = clock() - 2.0
    pass_time = team.watched.listen

    def with_unit(timeout_s: float) -> None:
        unit.send(Heartbeat({"robot/0": (1.0, heard_s)}))
        pass_time(timeout_s)

    team.watched.listen = with_unit
    outcome = stop(LAB, team.watched, "test")
    assert outcome.missing == {0: f"silent; unit/0 heard it {2.0 + SETTLE_S:.1f} s ago"}


@pytest.mark.parametrize(
    ("outcome", "complete"),
    [
        (Outcome([1], {}), True),
        (Outcome([1], {2: "never heard"}), False),
        (Outcome([1], {}, "a stop is newer"), False),
    ],
)
def test_outcome_is_complete_without_missing_and_failure(outcome, complete) -> None:
    assert outcome.is_complete == complete


@pytest.mark.parametrize(("cleared", "counts"), [(6, False), (7, True), (8, True)])
def test_armed_robot_counts_if_it_knows_the_cleared_stop(cleared, counts) -> None:
    """A heartbeat with a lower number was sent before the arm command."""
    team = ScriptedTeam()
    team.watched.latch = StopLatch(stop=7)
    command = ArmCommand(LAB, team.watched)
    team.robots[3].frozen = True
    team.robots[3].armed, team.robots[3].latch = True, StopLatch(stop=7, cleared=cleared)
    team.robots[3].beat()
    team.pass_time(0.05)
    command.advance()
    assert (3 in command.outcome().done) == counts


def test_process_is_alive_for_two_seconds_after_a_heartbeat() -> None:
    team = ScriptedTeam()
    team.pass_time(0.0)
    heard_s, name = team.now_s, f"robot/{LAB.ids[0]}"
    for silence_s, alive in ((0.0, True), (1.9, True), (2.1, False), (60.0, False)):
        team.now_s = heard_s + silence_s
        assert (name in team.watched.alive()) == alive
