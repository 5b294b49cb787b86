"""A live unit with a clock offset: team time for slots, own time for robots, and withheld goals."""

from dataclasses import fields, replace

import numpy as np
import pytest

from skyherd.control.camera_check import RECURRING, STEADY_S
from skyherd.live.lab import load_lab
from skyherd.live.peers import CONFLICT_S
from skyherd.live.plausible import Roster
from skyherd.live.stop_latch import NO_COMMAND, StopLatch
from skyherd.live.wire import KIND_OF, Envelope, Heartbeat
from skyherd.messages import FlightCommand, RoleMap, Sighting, TreeStatus, UnitReport
from skyherd.messages.ids import NO_ID

pytestmark = pytest.mark.smoke

LAB = load_lab("star")
FRAME_S, DELAY_S = 0.2, 0.05


class TwoUnits:
    """Two units of a lab with simultaneous images of its robots. Messages have the latency `DELAY_S`."""

    def __init__(self, make_detections, offsets_s):
        self.cores, self.offsets_s = [LAB.make_unit(number) for number in range(2)], offsets_s
        ids = LAB.template.ids
        self.image = make_detections(ids, LAB.template.points_of(ids) * 20 + 400 + 400j)
        self.decisions = [[], []]

    def run(self, seconds):
        """Process images for a number of seconds, and deliver each unit's report to the other one."""
        for number in range(round(seconds / FRAME_S)):
            time_s = 100.0 + number * FRAME_S
            for unit, core in enumerate(self.cores):
                own_s = time_s + self.offsets_s[unit]
                news = core.see(replace(self.image, unit_id=unit, time_s=own_s), own_s)
                self.decisions[unit].append(news.decision)
            for unit in (0, 1):
                self.tell(unit, time_s, self.decisions[1 - unit][-1].report)

    def tell(self, unit, sent_s, report):
        """Deliver a report of the other unit, and a heartbeat with the arrival time of a message there."""
        ours_s, theirs_s = self.offsets_s[unit], self.offsets_s[1 - unit]
        sent_before_s = sent_s - 2 * DELAY_S
        heartbeat = Heartbeat({f"unit/{unit}": (sent_before_s + ours_s, sent_before_s + DELAY_S + theirs_s)})
        for message in (heartbeat, report):
            envelope = Envelope(f"unit/{1 - unit}", sent_s + theirs_s, message)
            self.cores[unit].receive(envelope, sent_s + DELAY_S + ours_s)

    def stamps_s(self):
        """Return the image times in the reports of the last second: an array per unit."""
        return [np.array([decision.report.time_s for decision in made[-5:]]) for made in self.decisions]


class TestTime:
    @pytest.mark.parametrize("offsets_s", [(0.0, 0.4), (0.4, 0.0), (-0.3, 0.5)])
    def test_reports_share_team_time_despite_clock_offsets(self, make_detections, offsets_s) -> None:
        """The team time is that of the leading clock. The other unit knows it up to the message latency."""
        team = TwoUnits(make_detections, offsets_s)
        team.run(4.0)
        first_s, second_s = team.stamps_s()
        leader_s = (first_s, second_s)[int(np.argmax(offsets_s))]
        lag_s = leader_s - (first_s, second_s)[int(np.argmin(offsets_s))]
        assert (lag_s > 0).all() and (lag_s <= DELAY_S + 1e-3).all(), "of 0.4 to 0.8 s between the clocks"
        assert not any(core.trouble for core in team.cores)

    def test_messages_to_robots_carry_the_units_own_time(self, make_detections) -> None:
        """Robots compare the unit's clock with theirs. The team time may follow the clock of another unit."""
        team = TwoUnits(make_detections, (0.0, 0.4))
        team.run(4.0)
        behind = team.decisions[0]
        assert all(decision.goals is not None for decision in behind[-5:])
        for number, decision in enumerate(behind):
            own_s = 100.0 + number * FRAME_S
            assert decision.detections.time_s == own_s
            assert decision.goals is None or decision.goals.time_s == own_s
        assert behind[-1].report.time_s > own_s + 0.3

    def test_untrusted_clock_does_not_set_team_time(self, make_detections) -> None:
        team = TwoUnits(make_detections, (0.0, 20.0))
        team.run(4.0)
        own_s = np.array([decision.detections.time_s for decision in team.decisions[0][-5:]])
        assert (team.stamps_s()[0] == own_s).all()
        assert "+20 s off" in team.cores[0].trouble

    def test_report_from_the_future_does_not_set_team_time(self, make_detections) -> None:
        """The sender's clock is correct, but the time in its report is not. It must not set the team time."""
        team = TwoUnits(make_detections, (0.0, 0.0))
        team.run(2.0)
        lie = replace(team.decisions[1][-1].report, time_s=200.0)
        team.tell(0, 102.0, lie)
        assert "in the future" in team.cores[0].trouble
        own_s = 102.2
        news = team.cores[0].see(replace(team.image, time_s=own_s), own_s)
        assert news.decision.report.time_s == own_s


class TestUnknownIds:
    def report(self, make_detections, **changes):
        team = TwoUnits(make_detections, (0.0, 0.0))
        team.run(2.0)
        last = team.decisions[1][-1].report
        tree = replace(last.tree, **changes.pop("tree")) if "tree" in changes else last.tree
        team.tell(0, 102.0, replace(last, time_s=102.0, tree=tree, **changes))
        own_s = 102.2
        news = team.cores[0].see(replace(team.image, time_s=own_s), own_s)
        assert news.decision.report is not None
        team.tell(0, 102.3, replace(last, time_s=102.3, tree=tree, **changes))
        return team.cores[0].trouble

    @pytest.mark.parametrize("robot", [49, 2**62])
    @pytest.mark.parametrize("field", ["controlled_ids", "secure_ids"])
    def test_report_with_unknown_robots_is_ignored(self, make_detections, field, robot) -> None:
        assert self.report(make_detections) == ""
        changes = {field: np.array([0, robot])}
        assert self.report(make_detections, **changes) == f"report of unit/1 with unknown ids ({field})"

    def test_report_of_a_marker_beyond_the_lab_is_ignored(self, make_detections) -> None:
        changes = {"ids": np.array([0, 49]), "points_px": np.zeros((2, 2))}
        assert "unknown ids (ids)" in self.report(make_detections, **changes)

    def test_role_map_of_another_team_is_ignored(self, make_detections) -> None:
        roles = RoleMap(9, 1, np.arange(3))
        assert "unknown ids (roles)" in self.report(make_detections, roles=roles)

    def test_tree_with_unknown_ids_is_ignored(self) -> None:
        none = np.zeros(0, dtype=np.int64)
        roster = Roster(frozenset({1, 2}), frozenset({0, 1}))

        def unknown(**changes):
            parts = {name: NO_ID for name in ("tree_id", "asks_id", "heir_id")}
            parts |= {"ask_turn": 0, "ready": True, "pairs": np.zeros((0, 2), dtype=np.int64)}
            names = [field.name for field in fields(TreeStatus) if field.name not in parts]
            tree = TreeStatus(**(parts | {name: none for name in names} | changes))
            return roster.unknown_in(UnitReport(1, 0.0, [9, 9], none, np.zeros((0, 2)), none, none, tree))

        assert unknown() is None
        assert unknown(neighbor_ids=[0], turns=[4], pairs=[[1, NO_ID]]) is None
        assert unknown(neighbor_ids=[0], turns=[4], pairs=[[1, 3]]) == "pairs"
        assert unknown(neighbor_ids=[2], turns=[4], pairs=[[1, 2]]) == "neighbor_ids"
        assert unknown(handed_ids=[5], handed_to_ids=[0], handed_slots=[0]) == "handed_ids"
        assert unknown(handed_ids=[1], handed_to_ids=[7], handed_slots=[0]) == "handed_to_ids"
        assert unknown(heir_id=2) == "heir_id"


def sent_kinds(news) -> list[str]:
    return [KIND_OF[type(message)] for message in news.messages]


class OneUnit:
    """A unit of the lab with images of its robots, and heartbeats of one of them."""

    def __init__(self, make_detections) -> None:
        self.core, ids = LAB.make_unit(0), LAB.template.ids
        self.image = make_detections(ids, LAB.template.points_of(ids) * 20 + 400 + 400j)
        self.now_s = 100.0

    def see(self):
        self.now_s += FRAME_S
        return self.core.see(replace(self.image, time_s=self.now_s), self.now_s)

    def hear(self, sent_s: float | None = None, latch=NO_COMMAND, sender="robot/0") -> None:
        self.now_s += 0.01
        sent_s = self.now_s if sent_s is None else sent_s
        heartbeat = Heartbeat({"unit/0": (sent_s, sent_s)})
        self.core.receive(Envelope(sender, sent_s, heartbeat, "x", latch), self.now_s)


class TestGoals:
    def test_sent_after_first_heartbeat(self, make_detections) -> None:
        unit = OneUnit(make_detections)
        assert "goals" not in sent_kinds(unit.see())
        assert "no heartbeat since" in unit.core.withheld(unit.now_s)
        unit.hear()
        assert sent_kinds(unit.see())[:2] == ["sighting", "goals"]
        assert unit.core.withheld(unit.now_s) == ""

    def test_withheld_while_stopped(self, make_detections) -> None:
        unit = OneUnit(make_detections)
        unit.see()
        unit.hear()
        unit.hear(latch=StopLatch(stop=3))
        assert sent_kinds(unit.see()) == ["sighting", "report"]
        assert unit.core.withheld(unit.now_s) == "stopped"
        unit.hear(latch=StopLatch(stop=3, cleared=2))
        assert sent_kinds(unit.see()) == ["sighting", "report"]
        unit.hear(latch=StopLatch(stop=3, cleared=3))
        assert "goals" in sent_kinds(unit.see())

    def test_withheld_after_sleep_until_new_heartbeat(self, make_detections) -> None:
        unit = OneUnit(make_detections)
        unit.see()
        unit.hear()
        assert "goals" in sent_kinds(unit.see())
        before_s, unit.now_s = unit.now_s, unit.now_s + 5.0
        unit.hear(sent_s=before_s + 4.9)
        assert "goals" not in sent_kinds(unit.see())
        unit.hear()
        assert "goals" in sent_kinds(unit.see())

    def test_sent_after_a_message_that_waited_during_detection(self, make_detections) -> None:
        """It arrived before the last call, and is no sign of sleep."""
        unit = OneUnit(make_detections)
        unit.see()
        unit.hear()
        unit.see()
        unit.now_s -= 0.05
        unit.hear()
        unit.now_s += 0.05
        assert unit.core.withheld(unit.now_s) == "" and "goals" in sent_kinds(unit.see())

    def test_withheld_after_a_step_back_of_the_clock(self, make_detections) -> None:
        unit = OneUnit(make_detections)
        unit.see()
        unit.hear()
        unit.now_s -= 5.0
        unit.core.heartbeat(unit.now_s, "")
        assert "no heartbeat since" in unit.core.withheld(unit.now_s)

    def test_flying_unit_hovers_while_goals_are_withheld(self, make_detections) -> None:
        """Its controller would have it climb, as its robots spread."""
        unit = OneUnit(make_detections)
        climb = FlightCommand(0, lateral_mps=[0.1, -0.2], climb_mps=0.3, yaw_rate_radps=0.1)
        decide = unit.core._controller.step
        unit.core._controller.step = lambda *given, **how: replace(decide(*given, **how), flight=climb)
        unit.see()
        unit.hear()
        assert unit.see().decision.flight is climb
        unit.hear(latch=StopLatch(stop=3))
        hover = unit.see().decision.flight
        assert not hover.lateral_mps.any() and hover.climb_mps == hover.yaw_rate_radps == 0
        unit.hear(latch=StopLatch(stop=3, cleared=3))
        assert unit.see().decision.flight is climb

    def test_withheld_while_name_is_ambiguous(self, make_detections) -> None:
        unit = OneUnit(make_detections)
        unit.see()
        unit.hear()
        unit.hear(sender="unit/0")
        assert "goals" not in sent_kinds(unit.see())
        assert unit.core.withheld(unit.now_s) == "another process is named unit/0"
        for _ in range(round(CONFLICT_S / FRAME_S)):
            unit.hear()
            news = unit.see()
        assert "goals" in sent_kinds(news)


def test_sighting_has_the_pose_of_each_marker_that_is_seen_once(make_detections) -> None:
    unit = OneUnit(make_detections)
    image = unit.image = make_detections([4, 2, 5, 2, 0], 100 + 50 * np.arange(5) * (1 + 1j))
    sighting = next(message for message in unit.see().messages if isinstance(message, Sighting))
    once = [0, 2, 4]
    np.testing.assert_array_equal(sighting.ids, image.ids[once])
    np.testing.assert_array_equal(sighting.repeated_ids, [2])
    for name in ("centers_px", "headings_rad", "sides_px"):
        np.testing.assert_array_equal(getattr(sighting, name), getattr(image, name)[once])


class TestCamera:
    def watch(self, unit, seconds, *, state="driving", armed=True):
        """Show the same picture for a time, with heartbeats of all robots; return the last news."""
        for _ in range(round(seconds / FRAME_S)):
            for robot in LAB.ids:
                heartbeat = Heartbeat({"unit/0": (unit.now_s, unit.now_s)}, state, "session", armed)
                unit.core.receive(Envelope(f"robot/{robot}", unit.now_s, heartbeat, "x"), unit.now_s)
            news = unit.see()
        return news

    def scattered(self, make_detections) -> OneUnit:
        """Return a unit whose robots stand far from their places."""
        unit, rng = OneUnit(make_detections), np.random.default_rng(2)
        points = rng.uniform(200, 600, (len(LAB.ids), 2)) @ [1, 1j]
        unit.image = make_detections(LAB.ids, points)
        return unit

    def test_sends_nothing_while_robots_drive_in_a_still_picture(self, make_detections) -> None:
        unit = self.scattered(make_detections)
        assert self.watch(unit, 0.4).messages
        news = self.watch(unit, 2.0)
        assert news.messages == () and "may be frozen" in unit.core.trouble

    @pytest.mark.parametrize(
        ("state", "armed"), [("disarmed", False), ("driving (dry run)", True), ("no fresh goal", True)]
    )
    def test_robots_that_stand_show_nothing_about_it(self, make_detections, state, armed) -> None:
        unit = self.scattered(make_detections)
        assert "goals" in sent_kinds(self.watch(unit, 10.0, state=state, armed=armed))

    def latched(self, make_detections) -> OneUnit:
        """Return a unit whose camera was frozen three times, and is live again."""
        unit = self.scattered(make_detections)
        for _ in range(RECURRING):
            self.watch(unit, 3.0)
            unit.image = replace(unit.image, centers_px=unit.image.centers_px + 10.0)
            self.watch(unit, STEADY_S + 2 * FRAME_S)
        return unit

    def test_recurring_suspicion_lasts_and_says_what_to_do(self, make_detections) -> None:
        unit = self.latched(make_detections)
        assert self.watch(unit, 60.0).messages == ()
        assert unit.core.trouble.endswith(
            "suspected 3 times within 30 s: repair the camera, then stop the team and arm it again"
        )

    @pytest.mark.parametrize(
        "latch", [NO_COMMAND, StopLatch(stop=3), StopLatch(stop=2, cleared=2), StopLatch(stop=3, cleared=2)]
    )
    def test_recurring_suspicion_outlasts_old_arm_commands(self, make_detections, latch) -> None:
        unit = OneUnit(make_detections)
        unit.hear(latch=StopLatch(stop=2, cleared=2))
        old, unit = unit.core.latch, self.latched(make_detections)
        unit.core.latch = old
        unit.hear(latch=latch)
        assert self.watch(unit, 5.0).messages == () and "suspected 3 times" in unit.core.trouble

    def test_recurring_suspicion_ends_with_new_arm_command(self, make_detections) -> None:
        unit = self.latched(make_detections)
        unit.hear(latch=StopLatch(stop=3, cleared=3))
        assert "goals" in sent_kinds(unit.see()) and unit.core.trouble == ""

    def test_new_arm_command_ends_the_suspicion(self, make_detections) -> None:
        unit = self.scattered(make_detections)
        self.watch(unit, 3.0)
        unit.hear(latch=StopLatch(stop=3, cleared=3))
        assert "goals" in sent_kinds(unit.see())
