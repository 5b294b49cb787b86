"""Live robots with bodies: what one robot does with reports of bodies near it, and whole teams."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from sightings import make_sighting

from skyherd.live.lab import Lab, load_lab
from skyherd.live.robot_core import DRIVING, Order, RobotCore
from skyherd.live.wire import Arm, Envelope, Heartbeat, Message, Stop
from skyherd.messages import MotionGoals, Proximity

ROBOT, OTHER, SIDE_M, PERIOD_S = 3, 4, 0.4, 0.1
REACH_SIDES = 2.2
"""Two radii of 1 and the margin of 0.2, as in the lab `crowd`."""


@dataclass
class Scene:
    """One robot of the lab `crowd`, its true pose, and a unit whose clock shows `offset_s` more.

    The robot's wheels obey at once. Its goal lies far beyond another body, which stands still at `other_m`.
    """

    settings: list[str] = field(default_factory=list)
    offset_s: float = 0.0
    other_m: complex = 2.0
    now_s: float = 100.0
    at_m: complex = 0.0
    heading_rad: float = 0.0

    def __post_init__(self) -> None:
        self.lab: Lab = load_lab("crowd", self.settings)
        self.core: RobotCore = self.lab.make_robot(ROBOT)
        self.core.decide(self.now_s)
        self.now_s += PERIOD_S
        self.core.decide(self.now_s)
        self._hear(Heartbeat({"robot/3": (self.now_s, self.now_s + self.offset_s)}))
        self._hear(make_sighting(self.now_s + self.offset_s, [ROBOT]))
        self.core.receive(Envelope("operator", self.now_s, Arm({"robot/3": self.core.session})), self.now_s)

    def _hear(self, message: Message) -> None:
        self.core.receive(Envelope("unit/0", self.now_s + self.offset_s, message), self.now_s)

    @property
    def bearing_rad(self) -> float:
        """True bearing of the other body."""
        return float(np.angle((self.other_m - self.at_m) * np.exp(-1j * self.heading_rad)))

    @property
    def gap_m(self) -> float:
        """True gap to the other body, less the margin."""
        return float(abs(self.other_m - self.at_m) - REACH_SIDES * SIDE_M)

    def see(self, *, bodies: bool = True, goal_rad: float | None = None) -> None:
        """Report an image taken now; the goal lies behind the other body, or in direction `goal_rad`."""
        taken_s = self.now_s + self.offset_s
        center_px = np.conj(self.at_m) / SIDE_M * 20.0
        self._hear(make_sighting(taken_s, [ROBOT], center_px=center_px, heading_rad=-self.heading_rad))
        bearing_rad = self.bearing_rad if goal_rad is None else goal_rad
        empty = np.zeros((1, 0))
        self._hear(MotionGoals(0, taken_s, [ROBOT], [400.0], [bearing_rad], [20.0], empty, empty))
        if bodies:
            distance = abs(self.other_m - self.at_m) / SIDE_M
            pair = [ROBOT], [OTHER], [distance], [self.bearing_rad], [REACH_SIDES], [1.0]
            self._hear(Proximity(0, taken_s, 8.0, [ROBOT, OTHER], *pair))

    def step(self, step_s: float = PERIOD_S) -> Order:
        """Decide, and drive for a while."""
        order = self.core.decide(self.now_s)
        turned = order.omega_radps * step_s
        chord = order.v_mps * step_s * np.sinc(turned / (2 * np.pi))
        self.at_m += chord * np.exp(1j * (self.heading_rad + turned / 2))
        self.heading_rad += turned
        self.now_s += step_s
        return order

    def remembered_rad(self) -> float:
        """Bearing of the other body as the robot remembers it."""
        memory = self.core._team.neighbors
        assert memory is not None
        return float(memory.bearings_rad(memory.fresh(self.now_s), self.now_s)[0])


class TestRobot:
    """One robot near another body."""

    @pytest.mark.parametrize("offset_s", [0.0, 0.8, -0.8])
    def test_robot_stops_at_margin_by_any_clock(self, offset_s) -> None:
        scene = Scene(offset_s=offset_s)
        gaps_m = []
        for _ in range(300):
            scene.see()
            assert scene.step().reason == DRIVING
            gaps_m.append(scene.gap_m)
        assert min(gaps_m) > 0
        assert gaps_m[-1] < gaps_m[0] / 4, "it does come near"

    def test_robot_without_avoidance_drives_through(self) -> None:
        scene = Scene(["avoidance.on=false"])
        least_m = np.inf
        for _ in range(300):
            scene.see(goal_rad=0.0)
            scene.step()
            least_m = min(least_m, scene.gap_m)
        assert least_m < -SIDE_M

    def test_robot_without_reports_of_bodies_stands(self) -> None:
        scene = Scene()
        for _ in range(20):
            scene.see(bodies=False)
            order = scene.step()
            assert order.v_mps == 0.0
        scene.see()
        scene.step()
        assert scene.step().v_mps > 0

    def test_approach_stays_within_bound_as_reports_age(self) -> None:
        """The bound `γ g exp(-γ (age + margin + A))`, for the true gap at the image."""
        scene = Scene(["avoidance.detour=none"])
        rule = scene.lab.make_avoidance()
        assert rule is not None
        for _ in range(10):
            scene.see()
            scene.step()
        imaged_s, gap_m = scene.now_s, scene.gap_m
        scene.see()
        for _ in range(8):
            age_s = scene.now_s - imaged_s
            most_mps = rule.gamma_ps * gap_m * np.exp(-rule.gamma_ps * (age_s + 0.2 + rule.held_s))
            order = scene.step()
            assert order.reason == DRIVING
            assert 0 < order.v_mps <= most_mps * (1 + 1e-9)

    @pytest.mark.parametrize("step_s", [0.03, 0.1, 0.16])
    def test_bearing_follows_told_turns_at_any_interval(self, step_s) -> None:
        """The limit on acceleration lets wheels turn more slowly than the law asks for."""
        scene = Scene(["limits.max_turn_accel_radps2=1.0"])
        scene.see(goal_rad=1.2)
        orders = [scene.step(step_s) for _ in range(5)]
        assert scene.heading_rad > 0.005
        assert orders[0].omega_radps < 0.5 * orders[0].wanted_omega_radps
        assert scene.remembered_rad() == pytest.approx(-scene.heading_rad, abs=1e-9)

    def test_bearing_of_disarmed_robot_does_not_turn(self) -> None:
        scene = Scene()
        scene.core.receive(Envelope("operator", scene.now_s, Stop("test")), scene.now_s)
        scene.see(goal_rad=1.2)
        orders = [scene.step() for _ in range(5)]
        assert all(order.reason == "disarmed" and order.wanted_omega_radps > 0 for order in orders)
        assert scene.remembered_rad() == pytest.approx(0.0, abs=1e-9)

    def test_late_report_has_bearing_of_its_image(self) -> None:
        scene = Scene()
        scene.see(goal_rad=1.2)
        scene.step()
        scene.step()
        taken_s, heading_rad = scene.now_s, scene.heading_rad
        scene.step()
        scene.step()
        pair = [ROBOT], [OTHER], [5.0], [0.7], [REACH_SIDES], [1.0]
        scene._hear(Proximity(0, taken_s, 8.0, [ROBOT, OTHER], *pair))
        assert scene.heading_rad - heading_rad > 0.2
        # The clock estimate ages by 2e-4 s/s, which is far below 1e-3 rad at 1.5 rad/s.
        assert scene.remembered_rad() == pytest.approx(0.7 - (scene.heading_rad - heading_rad), abs=1e-3)


class TestTeam:
    """Crowded starts of whole teams over a radio with delay and loss."""

    def test_few_seconds_of_crowd_have_no_contact(self, load_benchmark) -> None:
        bodies = load_benchmark("live_bodies")
        row = bodies.run_in_memory("fixed roles", 1, 10.0, small=True)
        assert row["min_gap_m"] > 0
        assert abs(row["error"] - row["start_error"]) > 0.01, "robots do move"

    def test_same_seconds_without_avoidance_have_contact(self, load_benchmark) -> None:
        bodies = load_benchmark("live_bodies")
        row = bodies.run_in_memory("fixed roles, no avoidance", 1, 10.0, small=True)
        assert row["min_gap_m"] < -0.1

    @pytest.mark.slow
    @pytest.mark.parametrize("seed", range(100, 103))
    def test_crowd_forms_without_contact(self, load_benchmark, seed) -> None:
        row = load_benchmark("live_bodies").run_in_memory("exchanged roles", seed)
        assert row["min_gap_m"] > 0 and row["formed"]

    @pytest.mark.slow
    @pytest.mark.parametrize("seed", range(100, 103))
    def test_crowd_with_fixed_roles_has_no_contact(self, load_benchmark, seed) -> None:
        row = load_benchmark("live_bodies").run_in_memory("fixed roles", seed)
        assert row["min_gap_m"] > 0

    def test_table_counts_contacts_by_kind(self, load_benchmark) -> None:
        bodies = load_benchmark("live_bodies")
        rows = [
            bodies._row("a", seed, np.array([0.2, least_m]), 0.1, 0.01)
            for seed, least_m in enumerate((0.1, -0.1))
        ]
        assert bodies.table(rows).splitlines()[-1] == "| a | 2 | 1 | -0.100 | 0.1 | 2 |"
