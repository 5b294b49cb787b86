"""Robots keep apart for any preferred velocity, delay and message loss, and are free elsewhere."""

from dataclasses import dataclass

import numpy as np
import pytest

from skyherd.control import AvoidanceRule, BodyRule, MarkerGains, NeighborMemory, Wheels
from skyherd.control.avoidance.avoiding_law import avoiding_law
from skyherd.control.avoidance.detour import around, gyroscopic
from skyherd.control.avoidance.proximity import proximity
from skyherd.control.avoidance.speed_bound import Bounds, closing_bounds, slowed
from skyherd.control.robots.unicycle import wheel_law
from skyherd.datasets.random_streams import RunStream, generator
from skyherd.geometry import to_complex, to_points, wrap_angle
from skyherd.messages import BORDER_IDS, Proximity, VelocityCommand
from skyherd.sim.drive import Drive, DriveParameters
from skyherd.sim.world import move_bodies

SIDE_M, STEP_S = 0.2, 0.1
WHEELS = Wheels(0.5, 2.0)
BODIES = BodyRule(radius_sides=1.0, margin_sides=0.0)
REACH_M = 2 * SIDE_M


def rule(**changed) -> AvoidanceRule:
    return AvoidanceRule(SIDE_M, WHEELS, nominal_age_s=0.2, superseded_age_s=0.2, step_s=STEP_S, **changed)


@dataclass
class Crowd:
    """Robots with adverse preferred velocities at full speed, and one unit that sees them."""

    rng: np.random.Generator
    rule: AvoidanceRule
    make_detections: object
    drive: DriveParameters
    count: int = 6
    latency: int = 0
    loss: float = 0.0

    def __post_init__(self) -> None:
        ids = np.arange(self.count)
        self.positions_m, self.headings = self._start(), self.rng.uniform(-np.pi, np.pi, self.count)
        self.memory = NeighborMemory(ids, ids, self.rule.lifetime_s)
        seed = int(self.rng.integers(1000))
        gain_rng, slip_rng = (
            generator(seed, stream) for stream in (RunStream.WHEEL_GAINS, RunStream.WHEEL_SLIP)
        )
        self.wheels = Drive(self.drive, self.count, step_s=STEP_S, gain_rng=gain_rng, slip_rng=slip_rng)
        self.waiting: list = []
        self.min_m, self.pairs = np.inf, np.triu_indices(self.count, 1)

    def _start(self) -> np.ndarray:
        placed: list[complex] = []
        while len(placed) < self.count:
            at = complex(*self.rng.uniform(-0.9, 0.9, 2))
            if all(abs(at - other) > 1.02 * REACH_M for other in placed):
                placed.append(at)
        return to_points(placed)

    def look(self, tick: int) -> None:
        """Return an image of 100 px per metre, v down, as a unit at (0, 0) sees it."""
        points = 100 * to_complex(self.positions_m).conj()
        sides = np.full(self.count, 100 * SIDE_M)
        seen = self.make_detections(
            np.arange(self.count), points, headings=-self.headings, sides=sides, time_s=tick * STEP_S
        )
        self.waiting.append((tick + self.latency, proximity(seen, np.arange(self.count), BODIES)))

    def wants(self) -> tuple[np.ndarray, np.ndarray]:
        others = to_complex(self.positions_m)
        away = others[None, :] - others[:, None] + np.diag(np.full(self.count, np.inf))
        nearest = away[np.arange(self.count), np.abs(away).argmin(axis=1)]
        alpha = wrap_angle(np.angle(nearest) - self.headings)
        hunt = self.rng.random(self.count) < 0.8
        sign = np.where(np.abs(alpha) < np.pi / 2, 1.0, -1.0)
        omega = np.where(hunt, np.clip(4 * wrap_angle(alpha - (sign < 0) * np.pi), -2, 2), 0)
        omega = np.where(hunt, omega, self.rng.uniform(-2, 2, self.count))
        return WHEELS.max_speed_mps * np.where(hunt, sign, self.rng.choice([-1, 1], self.count)), omega

    def step(self, tick: int) -> None:
        if tick % 2 == 0:
            self.look(tick)
        for arrival, message in self.waiting:
            if arrival == tick:
                self.memory.receive(message, self.rng.random(self.count) >= self.loss)
        bounds = closing_bounds(self.memory, self.rule, tick * STEP_S)
        v, omega = slowed(*self.wants(), bounds=bounds, rule=self.rule)
        self.memory.record_rotation(omega, tick * STEP_S, STEP_S)
        v, omega = self.wheels.step(VelocityCommand(np.arange(self.count), v, omega))
        offset = self.rule.wheels.axis_offset_m
        # Tenths of the step at once: a tenth of both speeds for the whole step leads to the same place.
        part = np.linspace(0.1, 1.0, 10)[:, None]
        tenths = part.size, 1
        there, turned = move_bodies(
            np.tile(self.positions_m, tenths),
            np.tile(self.headings, tenths[0]),
            (part * v).ravel(),
            (part * omega).ravel(),
            step_s=STEP_S,
            axis_offset_m=offset,
        )
        there = to_complex(there).reshape(-1, self.count)
        one, other = self.pairs
        self.min_m = min(self.min_m, float(np.abs(there[:, one] - there[:, other]).min()))
        self.positions_m, self.headings = to_points(there[-1]), turned[-self.count :]


def min_gap_m(crowd: Crowd, ticks: int = 80) -> float:
    for tick in range(ticks):
        crowd.step(tick)
    return crowd.min_m - REACH_M


ROBOTS_AS_THEY_ARE = {
    "exact": (DriveParameters(), {}),
    "brakes": (DriveParameters(max_accel_mps2=0.25), {"lag_s": 2.0}),
    "brakes by speed": (DriveParameters(max_accel_mps2=0.25), {"lag_s": 2.0, "brakes_s": 2.0}),
    "late": (DriveParameters(delay_s=0.2), {"lag_s": 0.2}),
    "fast": (
        DriveParameters(gain_error=0.2, track_m=0.3),
        {"overshoot": 0.2, "turn_error_radps": 2 * 0.2 * 0.5 / 0.3 + 0.2 * 2.0},
    ),
    "offset": (
        DriveParameters(axis_offset_m=0.05),
        {"wheels": Wheels(0.5, 2.0, axis_offset_m=0.05)},
    ),
}


@pytest.mark.parametrize("kind", ROBOTS_AS_THEY_ARE)
@pytest.mark.parametrize(("latency", "loss"), [(0, 0.0), (2, 0.0), (0, 0.5), (1, 0.9)])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_speed_bound_prevents_all_collisions(make_detections, kind, latency, loss, seed) -> None:
    """Any start without overlap and any preferred velocities: docs/bodies.md has the proof.

    The gap only shrinks by a factor; rounding is 1e-9 m. Robots that violate the rule collide within 60
    ticks, see below.
    """
    drive, known = ROBOTS_AS_THEY_ARE[kind]
    age_s = 0.2 + latency * STEP_S
    usual = {
        "wheels": WHEELS,
        "nominal_age_s": age_s,
        "superseded_age_s": age_s,
        "step_s": STEP_S,
        "lifetime_s": 60.0,
    }
    mine = AvoidanceRule(SIDE_M, **(usual | known))
    crowd = Crowd(np.random.default_rng([seed, 7]), mine, make_detections, drive, latency=latency, loss=loss)
    assert min_gap_m(crowd) > -1e-9


@pytest.mark.parametrize(
    ("kind", "forgotten"), [("brakes", "lag_s"), ("late", "lag_s"), ("fast", "overshoot"), ("exact", "gamma")]
)
def test_speed_bound_with_wrong_wheel_limits_fails(make_detections, kind, forgotten) -> None:
    """Negative control: each part of the bound is needed."""
    drive, _ = ROBOTS_AS_THEY_ARE[kind]
    blind = AvoidanceRule(
        SIDE_M, WHEELS, nominal_age_s=0.2, superseded_age_s=0.2, step_s=STEP_S, lifetime_s=60.0
    )
    if forgotten == "gamma":
        blind = AvoidanceRule(
            SIDE_M, WHEELS, nominal_age_s=0.0, superseded_age_s=0.2, step_s=0.001, lifetime_s=60.0
        )
    gaps = (
        min_gap_m(Crowd(np.random.default_rng([seed, 7]), blind, make_detections, drive), 60)
        for seed in range(8)
    )
    assert any(gap < 0 for gap in gaps)


def test_proximity_report_equals_ground_truth(make_detections) -> None:
    """Distances are in marker sides, bearings in each robot's frame, counter-clockwise."""
    rng = np.random.default_rng(8)
    crowd = Crowd(rng, rule(), make_detections, DriveParameters())
    crowd.look(0)
    message = crowd.waiting[0][1]
    here = to_complex(crowd.positions_m)
    away = here[message.other_ids] - here[message.robot_ids]
    assert message.distances_sides == pytest.approx(np.abs(away) / SIDE_M, rel=1e-9)
    assert wrap_angle(
        message.bearings_rad - np.angle(away) + crowd.headings[message.robot_ids]
    ) == pytest.approx(0, abs=1e-9)
    assert message.robot_ids.size == 6 * 5 and (message.shares == 0.5).all()


def test_obstacle_gap_is_entirely_the_robots_share(make_detections) -> None:
    seen = make_detections([0, 1, 40], [0, 300, 60], sides=[20, 20, 20])
    bodies = BodyRule(1.0, margin_sides=0.5, horizon_sides=4.0, obstacles={40: 0.25})
    message = proximity(seen, np.array([0, 1, 2]), bodies)
    assert message.robot_ids.tolist() == [0] and message.other_ids.tolist() == [40]
    assert message.distances_sides.tolist() == [3.0] and message.reaches_sides.tolist() == [1.75]
    assert message.shares.tolist() == [1.0]


def test_memory_replaces_stale_messages_and_clears_absent_bodies(make_detections) -> None:
    memory = NeighborMemory(np.array([0, 1]), np.array([0, 1]), 2.0)
    bodies = BodyRule(1.0, horizon_sides=4.0)

    def send(time_s: float, apart_px: float, ids=(0, 1)) -> None:
        points = [0, apart_px][: len(ids)]
        seen = make_detections(ids, points, sides=[20] * len(ids), time_s=time_s)
        memory.receive(proximity(seen, np.array([0, 1]), bodies))

    send(1.0, 100)
    send(0.5, 60)
    assert memory.distances_sides[0, BORDER_IDS.size + 1] == 5.0, "an older message changes nothing"
    send(1.2, 0, ids=(0,))
    assert memory.fresh(1.3)[0].size == 2, "an unseen body stays in memory"
    send(1.4, 400)
    assert memory.fresh(1.5)[0].size == 0, "a pair seen far apart is removed"
    send(2.0, 100)
    assert memory.fresh(4.1)[0].size == 0, "stale messages are ignored"


@pytest.mark.parametrize(("imaged_s", "lead_s"), [(0.0, 0.0), (0.1, 0.0), (0.2, 0.0), (0.3, 0.0), (0.2, 7.0)])
def test_memory_bearings_rotate_with_robot(make_detections, imaged_s, lead_s) -> None:
    """Bearings count from the time of the image, not of reception: at 1 rad/s until 0.5 s.

    This also holds if the stamping clock is ahead of the robot's.
    """
    memory = NeighborMemory(np.array([0]), np.array([0, 1]), 2.0)
    for tick in range(5):
        if tick == 3:
            seen = make_detections([0, 1], [0, 60], time_s=imaged_s + lead_s)
            near = proximity(seen, np.array([0]), BodyRule(1.0, obstacles={1: 1.0}))
            memory.receive(near, lead_s=np.array([lead_s]))
        memory.record_rotation(np.array([1.0]), 0.1 * tick, 0.1)
    assert memory.bearings_rad(memory.fresh(0.5 + lead_s), 0.5) == pytest.approx([imaged_s - 0.5])


def test_avoiding_law_without_neighbors_equals_wheel_law(make_detections) -> None:
    """Bit by bit, for robots 10 sides apart whose goals lead away from one another."""
    gains = MarkerGains(0.5, 2.0, 0.0, SIDE_M)
    rho = np.array([3 + 1j, -2 + 4j])
    memory = NeighborMemory(np.array([0, 1]), np.array([0, 1]), 2.0)
    points = np.array([0, 200])
    memory.receive(proximity(make_detections([0, 1], points), np.array([0, 1]), BODIES))
    assert np.array_equal(
        avoiding_law(rho, gains, memory=memory, rule=rule(), time_s=0.0), wheel_law(rho, gains, WHEELS)
    )


@pytest.mark.smoke
def test_detour_velocity_satisfies_all_bounds() -> None:
    """Of two robots that meet head-on each keeps to the right; an unblocked one is unchanged."""
    rng = np.random.default_rng(9)
    rows = np.repeat(np.arange(20), 5)
    bearings, speeds = rng.uniform(-np.pi, np.pi, 100), rng.uniform(0, 0.2, 100)
    preferred = 0.3 * np.exp(1j * rng.uniform(-np.pi, np.pi, 20))
    blocked, velocities = around(preferred, rows=rows, bearings_rad=bearings, speeds_mps=speeds)
    taken = preferred.copy()
    taken[blocked] = velocities
    assert ((np.exp(-1j * bearings) * taken[rows]).real <= speeds + 1e-12).all()
    free = np.setdiff1d(np.arange(20), blocked)
    assert blocked.size and free.size
    head_on = around(
        np.array([0.3, 0.3 + 0j]), rows=np.arange(2), bearings_rad=np.zeros(2), speeds_mps=np.full(2, 0.01)
    )[1]
    assert (head_on.imag < 0).all(), "to the right"


def test_detour_prefers_right_over_slightly_shorter_left() -> None:
    """A body is a tenth of a degree to the right.

    A direction 80 degrees to the left passes it 2 % faster, which is less than the penalty of the left. A
    body farther to the right is passed on the left.
    """

    def detour(bearing_deg: float) -> complex:
        bearings = np.radians([bearing_deg])
        row, slow = np.zeros(1, dtype=np.int64), np.full(1, 0.1)
        return around(np.ones(1, dtype=complex), rows=row, bearings_rad=bearings, speeds_mps=slow)[1][0]

    for bearing_deg in (0.0, -0.1):
        assert np.angle(detour(bearing_deg), deg=True) == pytest.approx(-80)
    assert np.angle(detour(-1.0), deg=True) == pytest.approx(80)


@pytest.mark.parametrize(("unseen_mps", "left_mps"), [(0.1, 0.1), (0.3, 0.3), (0.5, 0.4)])
def test_unreported_bodies_limit_speed_in_every_direction(unseen_mps, left_mps) -> None:
    none = np.zeros(0)
    bounds = Bounds(none.astype(np.int64), *[none] * 6, none.astype(bool), np.array([unseen_mps]))
    for sign in (-1, 1):
        v_mps, _ = slowed(np.array([sign * 0.4]), np.zeros(1), bounds=bounds, rule=rule())
        assert v_mps == pytest.approx(sign * left_mps)


def test_memory_keeps_rotations_for_whole_message_lifetime(make_detections) -> None:
    """The image has exactly the maximum age: times are sums of powers of two."""
    memory = NeighborMemory(np.array([0]), np.array([0, 1]), 0.5)
    for tick in range(5):
        memory.record_rotation(np.array([1.0]), 0.125 * tick, 0.125)
    seen = make_detections([0, 1], [0, 60], time_s=0.0)
    memory.receive(proximity(seen, np.array([0]), BodyRule(1.0, obstacles={1: 1.0})))
    assert memory.bearings_rad(memory.fresh(0.5), 0.5) == pytest.approx([-0.625])


def test_slowed_static_robot_gives_zero_without_division() -> None:
    limits = rule()
    standing = closing_bounds(remembered(0.1), limits, 0.0)
    with np.errstate(divide="raise", invalid="raise"):
        v_mps, omega_radps = slowed(np.zeros(1), np.zeros(1), bounds=standing, rule=limits)
    assert (v_mps.tolist(), omega_radps.tolist()) == ([0.0], [0.0])


def test_body_rule_defaults_for_margin_and_horizon(make_detections) -> None:
    """The margin is a fifth of a side, and gaps of up to eight sides are reported."""
    for gap, reported in ((7.9, 2), (8.1, 0)):
        points = 100 * SIDE_M * np.array([0, 2.2 + gap])
        seen = make_detections([0, 1], points, sides=np.full(2, 100 * SIDE_M))
        message = proximity(seen, np.array([0, 1]), BodyRule(1.0))
        assert message.reaches_sides.tolist() == pytest.approx([2.2] * reported)


def test_gyroscopic_detour_turns_to_tangent_without_braking() -> None:
    """The tangent is that of the most blocking body, on the nearer side, or to the right if head-on."""
    rows = np.array([0, 0, 1, 2, 3])
    bearings, speeds = np.array([0.3, -1.2, -0.4, 0.0, 3.0]), np.full(5, 0.05)
    blocked, velocities = gyroscopic(
        np.full(4, 0.3 + 0j), rows=rows, bearings_rad=bearings, speeds_mps=speeds
    )
    assert blocked.tolist() == [0, 1, 2]
    np.testing.assert_allclose(
        velocities, 0.3 * np.exp(1j * np.array([0.3 - np.pi / 2, -0.4 + np.pi / 2, -np.pi / 2]))
    )
    none = gyroscopic(
        np.ones(1, dtype=complex), rows=rows[:0], bearings_rad=bearings[:0], speeds_mps=speeds[:0]
    )
    assert none[0].size == 0


# --- each term of the bound, by its formula ---


def remembered(age_s: float, distance_sides: float = 10.0) -> NeighborMemory:
    """Return a memory of one robot with another one ahead, from a message of an age at time 0."""
    memory = NeighborMemory(np.array([0]), np.array([0, 1]), lifetime_s=5.0)
    near = Proximity(
        unit_id=0,
        time_s=-age_s,
        horizon_sides=20.0,
        ids=[0, 1],
        robot_ids=[0],
        other_ids=[1],
        distances_sides=[distance_sides],
        bearings_rad=[0.0],
        reaches_sides=[2.0],
        shares=[0.5],
    )
    memory.receive(near)
    return memory


def test_bearing_slack_of_stale_image_covers_both_motions() -> None:
    """Each at full speed: the line between them turned by up to `asin(2 v age / d)`."""
    age_s, distance_m = 0.5, 10.0 * SIDE_M
    bounds = closing_bounds(remembered(age_s), rule(), 0.0)
    assert bounds.slack_rad == pytest.approx(np.arcsin(2 * WHEELS.max_speed_mps * age_s / distance_m))
    assert closing_bounds(remembered(0.1), rule(), 0.0).slack_rad == 0


def test_bearing_slack_includes_turn_rate_error() -> None:
    """The error acts since the image and until the command's last effect."""
    wrong = rule(turn_error_radps=0.3, lag_s=0.2)
    slack_rad = closing_bounds(remembered(0.1), wrong, 0.0).slack_rad
    assert slack_rad == pytest.approx(0.3 * (0.1 + STEP_S + 0.2))


def test_speed_limit_is_reduced_by_creep_speed() -> None:
    share_m, age_s = np.array([0.4]), np.array([0.1])
    plain, creeping = rule(), rule(creep_mps=0.05, overshoot=0.25)
    bound_mps = plain.gamma_ps * share_m * np.exp(-plain.gamma_ps * (age_s + STEP_S))
    assert plain.limit_mps(share_m, age_s) == pytest.approx(bound_mps)
    assert creeping.limit_mps(share_m, age_s) == pytest.approx((bound_mps - 0.05) / 1.25)


def test_slowed_includes_turn_during_actuation_lag() -> None:
    """A body 60 degrees off the path comes nearer to it by `max_turn lag`."""
    lagging, v = rule(lag_s=0.2), np.array([0.4])
    bounds = Bounds(
        rows=np.array([0]),
        bearings_rad=np.array([np.pi / 3]),
        speeds_mps=np.array([0.1]),
        slack_rad=np.zeros(1),
        gaps_m=np.ones(1),
        distances_m=np.ones(1),
        retreat_mps=np.array([0.1]),
        is_side=np.zeros(1, dtype=bool),
        unseen_mps=np.array([10.0]),
    )
    slower, _ = slowed(v, np.zeros(1), bounds=bounds, rule=lagging)
    assert slower == pytest.approx(0.1 / np.cos(np.pi / 3 - WHEELS.max_turn_radps * 0.2))
    unlagged, _ = slowed(v, np.zeros(1), bounds=bounds, rule=rule())
    assert unlagged == pytest.approx(0.1 / np.cos(np.pi / 3))


def test_unreported_body_bound_uses_half_horizon() -> None:
    """Both bodies may have come nearer since: each may use up half of the horizon."""
    (unseen_mps,) = closing_bounds(remembered(0.1), rule(), 0.0).unseen_mps
    gamma_ps = rule().gamma_ps
    assert unseen_mps == pytest.approx(gamma_ps * 20.0 * SIDE_M / 2 * np.exp(-gamma_ps * (0.1 + STEP_S)))


def test_clock_margin_increases_message_age() -> None:
    """All bounds are those of a message older by the margin, with equal clocks."""
    late = closing_bounds(remembered(0.1), rule(clock_margin_s=0.4), 0.0)
    older = closing_bounds(remembered(0.5), rule(), 0.0)
    for name in ("speeds_mps", "slack_rad", "unseen_mps"):
        assert getattr(late, name) == pytest.approx(getattr(older, name), rel=1e-12)
    assert late.speeds_mps[0] < closing_bounds(remembered(0.1), rule(), 0.0).speeds_mps[0]


def test_message_age_uses_each_robots_own_time() -> None:
    """Two robots have one message on each other; the time of the second one is 0.4 s ahead."""
    memory = NeighborMemory(np.array([0, 1]), np.array([0, 1]), lifetime_s=5.0)
    pair = Proximity(
        unit_id=0,
        time_s=0.0,
        horizon_sides=20.0,
        ids=[0, 1],
        robot_ids=[0, 1],
        other_ids=[1, 0],
        distances_sides=[10.0, 10.0],
        bearings_rad=[0.0, 0.0],
        reaches_sides=[2.0, 2.0],
        shares=[0.5, 0.5],
    )
    memory.receive(pair)
    bounds = closing_bounds(memory, rule(), np.array([0.1, 0.5]))
    for robot, age_s in ((0, 0.1), (1, 0.5)):
        alone = closing_bounds(remembered(age_s), rule(), 0.0)
        assert bounds.speeds_mps[robot] == pytest.approx(alone.speeds_mps[0], rel=1e-12)
        assert bounds.slack_rad[robot] == pytest.approx(alone.slack_rad[0], rel=1e-12)
