"""A unit suspects a frozen, late or replayed camera by its own commands, and no other camera."""

import re
from dataclasses import replace

import numpy as np
import pytest

from skyherd.control import (
    AerialController,
    AvoidanceRule,
    CameraRule,
    Hover,
    MarkerGains,
    PixelGains,
    SafetyRadius,
    Template,
    Wheels,
)
from skyherd.control.camera_check import (
    JUMP_SIDES,
    JUMPING,
    MIN_PACE_SIDES_PS,
    RECURRING,
    RECURRING_S,
    STEADY_S,
    STILL_SIDES,
    CameraCheck,
)
from skyherd.control.image_delay import MAX_DELAY_S, MEMORY_S
from skyherd.control.team_view import TeamView
from skyherd.messages import MotionGoals, Proximity

pytestmark = pytest.mark.smoke

SIDE_PX, SIDE_M, FRAME_S, LAG_S, TIMEOUT_S = 20.0, 0.4, 0.1, 0.4, 0.5
IDS = np.arange(8)
RULE = CameraRule(MarkerGains(1.0, 2.0, 0.0, SIDE_M), side_m=SIDE_M, max_speed_mps=1.2, lag_s=LAG_S)


class Scene:
    """Robots that drive straight along the goals of one unit, which a camera sees.

    Args:
        make_detections: fixture.
        rng: draws starts, noise and losses.
        noise_sides: standard deviation of detected centres.
        loss: share of lost goals.
        latency_s: time from an image to the effect of its goals.
        rule: the robots' response to goals.
    """

    def __init__(self, make_detections, rng, *, noise_sides=0.003, loss=0.0, latency_s=0.0, rule=RULE):
        self.make_detections, self.rng = make_detections, rng
        self.noise_sides, self.loss, self.latency_s = noise_sides, loss, latency_s
        self.check = CameraCheck(rule, IDS)
        self.sides = 6 * (rng.normal(size=IDS.size) + 1j * rng.normal(size=IDS.size))
        self.goals = self.sides.copy()
        self.broken = np.zeros(IDS.size, dtype=bool)
        self.time_s, self.images, self.view = 0.0, [], lambda points: points
        self.orders = [(-np.inf, np.zeros(IDS.size, dtype=complex))]
        self.heard_s = np.full(IDS.size, -np.inf)

    def image(self):
        """Return the present image."""
        noise = self.noise_sides * (self.rng.normal(size=(IDS.size, 2)) @ [1, 1j])
        points = self.view(400 + 400j + SIDE_PX * (self.sides + noise))
        return self.make_detections(IDS, points, sides=np.full(IDS.size, SIDE_PX), time_s=self.time_s)

    def step(self, shown=None, reports=(), obeying=None):
        """Take an image, show another one instead if given, and move the robots; return the suspicion."""
        self.images.append(self.image())
        seen = self.images[-1] if shown is None else replace(shown, time_s=self.time_s)
        suspicion = self.check.look(seen, reports)
        if not suspicion:
            places = (seen.centers_px @ [1, 1j] - 400 - 400j) / SIDE_PX
            rho = self.goals - places
            self.check.command(self.message(rho), None, reports, obeying)
            self.orders.append((self.time_s + self.latency_s, rho))
        heard, velocity = self.rng.random(IDS.size) >= self.loss, np.zeros(IDS.size, dtype=complex)
        due = [order for at_s, order in self.orders if at_s <= self.time_s + 1e-9]
        is_new = bool(self.orders[-1][0] + FRAME_S > self.time_s)
        self.heard_s[heard & is_new] = self.time_s
        obeys = (self.time_s - self.heard_s <= TIMEOUT_S) & ~self.broken
        velocity[obeys] = due[-1][obeys]
        pace = np.maximum(np.abs(velocity), 1e-12)
        self.sides += velocity * np.minimum(1.0, 3.0 / pace) * FRAME_S
        self.time_s += FRAME_S
        return suspicion

    def message(self, rho):
        """Return goals with vectors (N,), marker sides."""
        none = np.zeros((IDS.size, 0))
        sides = np.full(IDS.size, SIDE_PX)
        lengths = np.abs(rho) * SIDE_PX
        return MotionGoals(0, self.time_s, IDS, lengths, np.angle(rho), sides, none.astype(int), none)

    def run(self, seconds, **options):
        """Step for a time; return the times, from now, at which the camera was suspected."""
        start_s = self.time_s
        found = []
        for _ in range(round(seconds / FRAME_S)):
            at_s = self.time_s - start_s
            found += [at_s] if self.step(**options) else []
        return np.array(found)


@pytest.fixture
def scene(make_detections):
    """Return a scene whose robots have arrived."""
    return Scene(make_detections, np.random.default_rng(3))


class TestFrozen:
    @pytest.mark.parametrize("pace", [MIN_PACE_SIDES_PS * 1.01, 0.5, 3.0])
    def test_suspected_within_one_second_of_commanded_motion(self, scene, pace) -> None:
        assert not scene.run(2.0).size
        scene.goals = scene.goals + pace / RULE.law.k
        frozen = scene.image()
        found = scene.run(2.0, shown=frozen)
        assert found.size and found[0] <= 1.0 + FRAME_S / 2

    def test_not_suspected_while_robots_are_at_rest(self, scene) -> None:
        scene.run(1.0)
        assert not scene.run(10.0, shown=scene.image()).size

    def test_rest_takes_no_memory_and_delays_no_suspicion(self, scene) -> None:
        scene.run(30.0)
        assert len(scene.check._paces) <= 2
        scene.goals = scene.goals + 0.5 / RULE.law.k
        found = scene.run(2.0, shown=scene.image())
        assert found.size and found[0] <= 1.0 + FRAME_S / 2

    def test_not_suspected_below_stated_pace(self, scene) -> None:
        scene.run(1.0)
        scene.goals = scene.goals + 0.95 * MIN_PACE_SIDES_PS / RULE.law.k
        assert not scene.run(10.0, shown=scene.image()).size

    @pytest.mark.parametrize("who", ["shared", "not obeying"])
    def test_robots_that_may_obey_others_do_not_count(self, scene, make_report, who) -> None:
        scene.run(1.0)
        scene.goals = scene.goals + 5.0
        report = make_report(1, [], [], IDS)
        options = {"reports": [report]} if who == "shared" else {"obeying": frozenset()}
        assert not scene.run(5.0, shown=scene.image(), **options).size

    def test_trusted_again_once_image_is_live_and_still(self, scene) -> None:
        scene.run(1.0)
        scene.goals = scene.goals + 5.0
        scene.run(3.0, shown=scene.image())
        assert scene.check.suspicion
        found = scene.run(3.0)
        assert STEADY_S - FRAME_S <= found[-1] <= STEADY_S + 3 * FRAME_S
        scene.run(10.0)
        np.testing.assert_allclose(scene.sides, scene.goals, atol=0.05)

    def test_suspicion_lasts_while_image_is_frozen(self, scene) -> None:
        scene.run(1.0)
        scene.goals = scene.goals + 5.0
        frozen = scene.image()
        scene.run(2.0, shown=frozen)
        assert scene.run(20.0, shown=frozen).size == 200

    def test_reset_trusts_and_judges_again(self, scene) -> None:
        scene.run(1.0)
        scene.goals = scene.goals + 5.0
        frozen = scene.image()
        scene.run(2.0, shown=frozen)
        scene.check.reset()
        found = scene.run(2.0, shown=frozen)
        assert 0.4 < found[0] <= 1.0


class TestLate:
    def test_drives_only_while_the_image_is_current(self, scene) -> None:
        """The unit stops until the late image shows the last motion. It then steers by a true image."""
        scene.run(1.0)
        scene.goals = scene.goals + 20.0
        delay = 30
        errors = []
        for _ in range(600):
            late = scene.images[max(len(scene.images) - delay, 9)]
            was = scene.check.suspicion
            true_px, shown_px = scene.image().centers_px, late.centers_px
            if not scene.step(shown=late) and was:
                errors.append(np.abs(true_px - shown_px).max() / SIDE_PX)
        assert len(errors) >= 3
        assert max(errors) < 0.2


LATCHING = replace(RULE, has_operator=True)


class TestRecurring:
    def scene(self, make_detections, seed=0, *, rule=LATCHING, sides=20.0):
        """Return a scene whose robots have a long way before them, which does not only scale the shape."""
        scene = Scene(make_detections, np.random.default_rng(seed), rule=rule)
        scene.run(1.0)
        scene.goals = scene.goals + sides * np.exp(2j * np.pi * scene.rng.random(IDS.size))
        return scene

    def late(self, scene, seconds, delay_s):
        """Show images of `delay_s` before, but none of the first second; return the suspicions in order."""
        said = [""]
        for _ in range(round(seconds / FRAME_S)):
            shown = scene.images[max(len(scene.images) - round(delay_s / FRAME_S), 9)]
            suspicion = scene.step(shown=shown)
            said += [suspicion] if suspicion != said[-1] else []
        return [one for one in said if one]

    def delays_s(self, said):
        """Return the delays that suspicions name."""
        found = [re.search(r"^images are late: .* after about (\S+) s", one) for one in said]
        return [float(one[1]) for one in found if one]

    @pytest.mark.parametrize("seed", range(3))
    @pytest.mark.parametrize("delay_s", [1.0, 2.0, 3.0])
    def test_late_camera_is_latched_and_its_delay_named(self, make_detections, delay_s, seed) -> None:
        scene = self.scene(make_detections, seed)
        first, *others = self.late(scene, RECURRING_S, delay_s)
        assert "images are late" not in first and len(others) == RECURRING - 1 and scene.check.is_latched
        np.testing.assert_allclose(self.delays_s(others), [delay_s] * len(others), atol=0.4)
        assert others[-1].endswith("suspected 3 times within 30 s") and "times" not in others[-2]

    def test_latched_camera_moves_no_robot_until_reset(self, make_detections) -> None:
        scene = self.scene(make_detections)
        self.late(scene, RECURRING_S, 2.0)
        places = scene.sides.copy()
        assert len(scene.run(60.0)) == 600
        np.testing.assert_array_equal(scene.sides, places)
        scene.check.reset()
        assert not scene.run(10.0).size and not scene.check.is_latched
        np.testing.assert_allclose(scene.sides, scene.goals, atol=0.05)

    def test_late_camera_is_latched_again_after_reset(self, make_detections) -> None:
        scene = self.scene(make_detections, sides=40.0)
        self.late(scene, RECURRING_S, 2.0)
        scene.check.reset()
        assert len(self.late(scene, RECURRING_S, 2.0)) == RECURRING and scene.check.is_latched

    def test_without_operator_nothing_is_latched(self, make_detections) -> None:
        scene = self.scene(make_detections, rule=RULE, sides=200.0)
        said = self.late(scene, 60.0, 1.0)
        assert len(said) > RECURRING and not scene.check.is_latched
        assert len(self.delays_s(said)) == len(said) - 1
        np.testing.assert_allclose(self.delays_s(said), 1.0, atol=0.4)

    def test_delay_near_the_usual_lag_is_not_named(self, make_detections) -> None:
        scene = self.scene(make_detections, rule=RULE, sides=60.0)
        said = self.late(scene, 30.0, LAG_S + 0.2)
        assert said and not self.delays_s(said)

    def test_suspicions_far_apart_are_not_latched(self, make_detections) -> None:
        scene = self.scene(make_detections)
        for _ in range(2 * RECURRING):
            assert scene.run(2.0, shown=scene.images[-1]).size
            assert not scene.check.is_latched
            scene.run(RECURRING_S / (RECURRING - 1))
            scene.goals = scene.goals + 20 * np.exp(2j * np.pi * scene.rng.random(IDS.size))
        assert not scene.check.suspicion

    @pytest.mark.parametrize("seed", range(6))
    def test_frozen_camera_is_not_called_late(self, make_detections, seed) -> None:
        """It is live again after two to four seconds, and freezes again when robots drive."""
        scene = self.scene(make_detections, seed)
        for _ in range(RECURRING):
            scene.run(0.3 + 0.1 * seed)
            said = {scene.step(shown=scene.images[-1])}
            frozen = scene.images[-1]
            said |= {scene.step(shown=frozen) for _ in range(20 + 4 * seed)}
            scene.run(3.0)
            scene.goals = scene.goals + 6 * np.exp(1j * IDS)
            assert not any("images are late" in one for one in said)
        assert scene.check.is_latched

    def test_delay_of_an_earlier_time_is_not_named(self, make_detections) -> None:
        scene = self.scene(make_detections)
        while not scene.check._delay_s:
            self.late(scene, FRAME_S, 2.0)
        scene.goals = scene.sides.copy()
        assert not scene.run(RECURRING_S).size
        scene.goals = scene.sides + 20.0
        scene.run(2.0, shown=scene.images[-1])
        assert "may be frozen" in scene.check.suspicion

    def test_delay_is_named_although_a_robot_is_carried(self, make_detections) -> None:
        scene = self.scene(make_detections)
        self.late(scene, 2.0, 2.0)
        scene.sides[3] += 8.0
        (delay_s,) = self.delays_s(self.late(scene, 6.0, 2.0))
        assert delay_s == pytest.approx(2.0, abs=0.4)

    def test_latency_within_the_usual_lag_is_never_suspected(self, make_detections) -> None:
        scene = self.scene(make_detections)
        assert not self.late(scene, 40.0, LAG_S - FRAME_S)

    def test_memory_of_images_and_goals_is_bounded(self, make_detections) -> None:
        scene = self.scene(make_detections, sides=1e3)
        sizes = []
        for _ in range(3):
            scene.run(20.0)
            sizes.append((len(scene.check._samples), len(scene.check._paces)))
        assert sizes[1] == sizes[2] and max(sizes[2]) <= (MEMORY_S + MAX_DELAY_S) / FRAME_S + 2


class TestReplayed:
    def test_jump_to_old_images_is_suspected_at_once(self, scene) -> None:
        scene.goals = scene.goals + 4 * np.exp(2j * IDS)
        scene.run(3.0)
        assert scene.step(shown=scene.images[0]).startswith("robots jump")

    def test_single_carried_robot_is_no_fault(self, scene) -> None:
        scene.run(1.0)
        scene.sides[2] += 8.0
        assert not scene.step()

    def test_jumps_are_motions_relative_to_most_robots(self) -> None:
        """For motions of up to twice the reach, among which both outcomes are frequent."""
        check, seen, rng = CameraCheck(RULE, IDS), np.ones(IDS.size, dtype=bool), np.random.default_rng(2)
        reach_sides, expected = JUMP_SIDES + RULE.max_speed_mps / SIDE_M * FRAME_S, []
        for share in np.linspace(0.1, 2.0, 200):
            points, ways = 6 * rng.normal(size=(2, IDS.size, 2)) @ [1, 1j]
            moves = share * reach_sides * ways / np.abs(ways)
            last = TeamView(0.0, SIDE_PX * points, seen, SIDE_PX)
            view = TeamView(FRAME_S, SIDE_PX * (points + moves), seen, SIDE_PX)
            jumping = np.mean(view.relative_sides(last, seen) > reach_sides) >= JUMPING
            assert check._jumps(view, last) == jumping
            expected.append(jumping)
        assert 0.1 < np.mean(expected) < 0.9

    @pytest.mark.parametrize("turn_rad", [0.3, 3.0])
    def test_moving_camera_is_no_fault(self, scene, turn_rad) -> None:
        scene.run(1.0)
        scene.view = lambda points: 1.3 * np.exp(1j * turn_rad) * (points - 380) + 420
        assert not scene.step()


class TestHealthy:
    @pytest.mark.parametrize("seed", range(8))
    def test_never_suspected_with_noise_loss_and_latency(self, make_detections, seed) -> None:
        scene = Scene(
            make_detections, np.random.default_rng(seed), noise_sides=0.004, loss=0.3, latency_s=0.3
        )
        for _ in range(5):
            scene.goals = scene.sides + 4 * (scene.rng.normal(size=(IDS.size, 2)) @ [1, 1j])
            assert not scene.run(4.0).size

    def test_broken_robot_is_not_taken_for_a_frozen_camera(self, scene) -> None:
        """It is the last robot with a goal, and nothing moves in the image."""
        scene.broken[3] = True
        scene.goals = scene.goals + 4 * np.exp(2j * IDS)
        assert not scene.run(15.0).size

    def test_repaired_robot_counts_again(self, scene) -> None:
        scene.broken[:] = IDS == 3
        scene.goals = scene.goals + 4 * np.exp(2j * IDS)
        scene.run(8.0)
        scene.broken[:] = False
        scene.run(8.0)
        scene.goals[3] += 5.0
        assert scene.run(2.0, shown=scene.image()).size


class TestPaces:
    def paces(self, scene, gap_sides, *, avoids=True):
        """Return the paces of robots of which the first has a body at a gap, with goals 1 side away."""
        wheels = Wheels(1.2, 3.0)
        bound = AvoidanceRule(SIDE_M, wheels, nominal_age_s=0.1, superseded_age_s=0.1, step_s=0.1)
        rule = replace(RULE, avoidance=bound if avoids else None)
        pair = (np.array([0]), np.array([1]), np.array([2.2 + gap_sides]), np.zeros(1))
        near = Proximity(0, 0.0, 8.0, IDS, *pair, np.array([2.2]), np.array([0.5]))
        return rule.paces(scene.message(np.ones(IDS.size, dtype=complex)), near)

    def test_body_nearby_bounds_the_pace(self, scene) -> None:
        """The bound is `share γ g exp(-γ (age + A))`, at an age of 0.2 s and γ = 5 /s; A = 0.1 s."""
        paces = self.paces(scene, 0.4)
        assert paces[0] == pytest.approx(0.5 * 5 * 0.4 * np.exp(-5 * 0.3))
        np.testing.assert_allclose(paces[1:], 1.0)
        assert self.paces(scene, -0.1)[0] == 0.0
        np.testing.assert_allclose(self.paces(scene, 20.0), 1.0)
        np.testing.assert_allclose(self.paces(scene, -0.1, avoids=False), 1.0)

    def test_top_speed_bounds_the_pace(self, scene) -> None:
        paces = RULE.paces(scene.message(np.full(IDS.size, 50.0 + 0j)), None)
        np.testing.assert_allclose(paces, 1.2 / SIDE_M)

    def test_pixel_gains_are_converted_to_sides(self, scene) -> None:
        rule = CameraRule(PixelGains(0.01, 1.0, 0.0), side_m=SIDE_M, max_speed_mps=9.0)
        paces = rule.paces(scene.message(np.full(IDS.size, 2.0 + 0j)), None)
        np.testing.assert_allclose(paces, 0.01 * 2.0 * SIDE_PX / SIDE_M)


class TestNeighbors:
    def reports(self, scene, make_report, sides, time_s):
        """Return a neighbour's report, in its own scale and direction."""
        points = 300 + 200j + 33 * np.exp(1j) * sides
        return [replace(make_report(1, IDS, points, IDS), time_s=time_s)]

    def watch(self, scene, make_report, move):
        """Show one image for 2 s, with reports in which robots move by `move(t)` sides; return suspicions."""
        frozen, start_s, found = scene.image(), scene.time_s, []
        for _ in range(20):
            sides = scene.sides + move(scene.time_s - start_s)
            reports = self.reports(scene, make_report, sides, scene.time_s)
            found.append(scene.step(shown=frozen, reports=reports))
        return found

    def test_motion_in_neighbors_image_alone_is_suspected(self, scene, make_report) -> None:
        found = self.watch(scene, make_report, lambda t: 0.5 * t * np.exp(2j * IDS))
        assert "another unit's" in found[-1]
        assert sum(map(bool, found)) >= 15

    @pytest.mark.parametrize("move", [lambda t: 0.0, lambda t: 0.5 * t, lambda t: 0.5 * t * (IDS == 2)])
    def test_neighbors_camera_or_one_marker_moves(self, scene, make_report, move) -> None:
        assert not any(self.watch(scene, make_report, move))

    def test_late_reports_of_motion_seen_before_are_no_fault(self, scene, make_report) -> None:
        """Robots of the neighbour stop after 1 s. Its reports are 0.5 s late."""
        start, past = scene.sides, []
        for tick in range(40):
            scene.sides = scene.goals = start + min(0.1 * tick, 1.0) * np.exp(2j * IDS)
            past.append((scene.time_s, scene.sides))
            time_s, sides = past[max(tick - 5, 0)]
            assert not scene.step(reports=self.reports(scene, make_report, sides, time_s))


def test_still_threshold_exceeds_noise_of_centers() -> None:
    """The difference of two centres of 14 px markers at noise 2 has a deviation below 0.1 px: 0.007 sides."""
    assert STILL_SIDES > 2 * 0.007


def test_suspecting_controller_sends_nothing(make_detections) -> None:
    points = 400 + 400j + 100 * np.exp(1j * np.arange(4))
    template = Template(np.arange(4), np.array([0, 1, 1 + 1j, 2j]) * 50)
    unit = AerialController(template, SafetyRadius(radius=1.5), Hover(0.5), camera=RULE)
    decisions = [unit.step(make_detections(np.arange(4), points, time_s=0.1 * n)) for n in range(20)]
    assert decisions[0].goals is not None and decisions[0].flight.yaw_rate_radps == 0.5
    last = decisions[-1]
    assert last.suspicion and last.goals is None and last.proximity is None
    assert last.flight.yaw_rate_radps == 0.0 and not last.flight.lateral_mps.any()
    assert not last.report.controlled_ids.size and last.report.ids.tolist() == [0, 1, 2, 3]
