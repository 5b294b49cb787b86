"""Robots leave bodies within their margin, also bodies that move, and others make way for them."""

from dataclasses import fields, replace
from importlib import import_module

import numpy as np
import pytest
from scipy.optimize import brentq

from skyherd.control import AvoidanceRule, BodyRule, MarkerGains, NeighborMemory, Wheels
from skyherd.control.avoidance.avoiding_law import avoiding_law
from skyherd.control.avoidance.make_way import YIELD_SIDES, yielding_sides
from skyherd.control.avoidance.proximity import proximity
from skyherd.control.avoidance.retreat import CLEAR_SIDES, retreat
from skyherd.control.avoidance.speed_bound import Bounds, closing_bounds
from skyherd.datasets.random_streams import RunStream, generator
from skyherd.geometry import to_complex, to_points
from skyherd.messages import ANONYMOUS_ID, BORDER_IDS, Proximity, VelocityCommand
from skyherd.sim.drive import Drive, DriveParameters
from skyherd.sim.world import move_bodies

SIDE_M, STEP_S = 0.4, 0.2
WHEELS = Wheels(0.6, 3.0)
RULE = AvoidanceRule(SIDE_M, WHEELS, nominal_age_s=0.2, superseded_age_s=0.2, step_s=STEP_S, lag_s=0.4)
BODIES = BodyRule(radius_sides=1.0, margin_sides=0.2)
GAINS = MarkerGains(0.4, 2.0, 0.0, SIDE_M)


def nothing(bounds, rule, driven):
    """Return no velocities, as a replacement of `retreat`."""
    return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=complex)


def drive(make_detections, seed: int, steps: int = 150) -> tuple[np.ndarray, float]:
    """Return the final distances (2,) of two robots from their goals, m, and their minimum gap, m.

    They start half a margin apart, with any headings. Each has a goal 3 m away, at most 70 degrees off the
    direction straight away from the other one.
    """
    rng = np.random.default_rng(seed)
    positions = np.array([0.0, 2.1 * SIDE_M]) + 0j
    headings, ids = rng.uniform(-np.pi, np.pi, 2), np.arange(2)
    goals = positions + 3 * np.array([-1, 1]) * np.exp(1j * np.radians(rng.uniform(-70, 70, 2)))
    memory, least = NeighborMemory(ids, ids, RULE.lifetime_s), np.inf
    for step in range(steps):
        now_s = step * STEP_S
        points = 100 * positions.conj() + (400 + 400j)
        seen = make_detections(ids, points, headings=-headings, sides=np.full(2, 100 * SIDE_M), time_s=now_s)
        memory.receive(proximity(seen, ids, BODIES))
        rho = (goals - positions) * np.exp(-1j * headings) / SIDE_M
        v, omega = avoiding_law(rho, GAINS, memory=memory, rule=RULE, time_s=now_s)
        memory.record_rotation(omega, now_s, STEP_S)
        moved, headings = move_bodies(
            to_points(positions), headings, v, omega, step_s=STEP_S, axis_offset_m=0.0
        )
        positions = to_complex(moved)
        least = min(least, abs(positions[1] - positions[0]) - 2 * SIDE_M)
    return np.abs(goals - positions), least


@pytest.mark.parametrize("seed", range(8))
def test_robots_within_margin_separate_and_reach_goals(make_detections, seed) -> None:
    """They come no closer than at the start, since the bound is applied last."""
    left_m, min_m = drive(make_detections, seed)
    assert left_m.max() < 0.05 and min_m > 0.1 * SIDE_M - 1e-9


def test_robots_within_margin_without_rule_deadlock(make_detections, monkeypatch) -> None:
    monkeypatch.setattr(import_module("skyherd.control.avoidance.avoiding_law"), "retreat", nothing)
    assert any(drive(make_detections, seed)[0].max() > 2.5 for seed in range(8))


# --- bodies that move ---

ACCEL_MPS2, FAST_MPS = 1.5, 0.1
BRAKES_S = WHEELS.max_speed_mps / ACCEL_MPS2
MOVER_RULE = AvoidanceRule(
    SIDE_M,
    WHEELS,
    nominal_age_s=0.1,
    superseded_age_s=0.1,
    step_s=0.1,
    lag_s=BRAKES_S,
    brakes_s=BRAKES_S,
)


def required_margin_m(speed_mps: float, rule: AvoidanceRule = MOVER_RULE) -> float:
    """Return the margin of the theorem in docs/bodies.md for a body of a speed, without actuation delay."""
    turn_radps = rule.wheels.max_turn_radps

    def excess_mps(delta_rad: float) -> float:
        return ACCEL_MPS2 * delta_rad / turn_radps * np.sin(delta_rad) - speed_mps

    delta_rad = brentq(excess_mps, 0.0, np.pi / 2)
    rise_s = speed_mps / np.sin(delta_rad) / ACCEL_MPS2
    return speed_mps * (rule.nominal_age_s + rule.step_s + delta_rad / turn_radps + rise_s)


def pursue(
    make_detections,
    robots: np.ndarray,
    mover: complex | np.ndarray,
    speed_mps: float,
    margin_m: float,
    *,
    seed: int,
    driven: bool = True,
    seconds: float = 12.0,
    rule: AvoidanceRule = MOVER_RULE,
    straight: bool = False,
) -> float:
    """Return the smallest gap, m, between robots at rest at their goals and bodies that pursue the first.

    Args:
        make_detections: factory of detections.
        robots: (N,) positions, m, which are the goals.
        mover: positions (K,) of the bodies at the start, m, or one position.
        speed_mps: their speed.
        margin_m: margin that the unit reports.
        seed: of the robots' headings.
        driven: whether the robots have goals.
        seconds: simulated time.
        rule: parameters of the robots.
        straight: whether the bodies drive straight to the first robot's place at the start, and beyond.
    """
    count, step_s, movers = robots.size, rule.step_s, np.atleast_1d(mover).astype(complex)
    everything, starts = count + movers.size, robots[0] - movers
    rng, ids = np.random.default_rng([seed, 42]), np.arange(robots.size)
    goals, headings = robots.astype(complex), rng.uniform(-np.pi, np.pi, count)
    positions = goals.copy()
    bodies = BodyRule(
        radius_sides=1.0,
        margin_sides=margin_m / SIDE_M,
        obstacles=dict.fromkeys(range(count, everything), 1.0),
    )
    memory = NeighborMemory(ids, np.arange(everything), rule.lifetime_s)
    streams = (generator(0, stream) for stream in (RunStream.WHEEL_GAINS, RunStream.WHEEL_SLIP))
    parameters = DriveParameters(max_speed_mps=0.6, max_turn_radps=3.0, max_accel_mps2=ACCEL_MPS2)
    gain_rng, slip_rng = streams
    drive = Drive(parameters, count, step_s=step_s, gain_rng=gain_rng, slip_rng=slip_rng)
    least_m = np.inf
    for tick in range(round(seconds / step_s)):
        now_s = tick * step_s
        points = 100 * np.append(positions, movers).conj()
        sides, angles = np.full(everything, 100 * SIDE_M), np.append(-headings, np.zeros(movers.size))
        seen = make_detections(range(everything), points, headings=angles, sides=sides, time_s=now_s)
        memory.receive(proximity(seen, ids, bodies))
        rho = (goals - positions) * np.exp(-1j * headings) / SIDE_M
        v, omega = avoiding_law(
            rho if driven else np.zeros(count, dtype=complex),
            GAINS,
            memory=memory,
            rule=rule,
            time_s=now_s,
            driven=np.full(count, driven),
        )
        memory.record_rotation(omega, now_s, step_s)
        v, omega = drive.step(VelocityCommand(ids, v, omega))
        moved, headings = move_bodies(
            to_points(positions), headings, v, omega, step_s=step_s, axis_offset_m=0.0
        )
        positions = to_complex(moved)
        towards = starts if straight else positions[0] - movers
        movers = movers + speed_mps * step_s * towards / np.abs(towards)
        least_m = min(least_m, float(np.abs(positions - movers[:, None]).min()) - 2 * SIDE_M)
    return least_m


ALONE = np.zeros(1)


@pytest.mark.parametrize("speed_mps", [0.02, 0.05, 0.1, 0.2])
def test_pursued_robot_with_required_margin_is_not_touched(make_detections, speed_mps) -> None:
    """It stands at its goal, with any heading; the goal pulls it back."""
    margin_m = required_margin_m(speed_mps)
    start = 2 * SIDE_M + margin_m + 0.02
    gaps = [
        pursue(make_detections, ALONE, start * np.exp(1j * seed), speed_mps, margin_m, seed=seed)
        for seed in range(12)
    ]
    assert min(gaps) > 0


@pytest.mark.parametrize(("share", "driven"), [(0.2, True), (1.0, False)])
def test_pursued_robot_with_less_is_touched(make_detections, share, driven) -> None:
    """Negative control: a fifth of the margin, or no goal. Pursued robots use up a third of it."""
    margin_m = share * required_margin_m(FAST_MPS)
    start = 2 * SIDE_M + margin_m + 0.02
    gaps = [
        pursue(make_detections, ALONE, start * np.exp(1j * s), FAST_MPS, margin_m, seed=s, driven=driven)
        for s in range(12)
    ]
    assert min(gaps) < 0


def test_default_margin_suffices_for_a_tenth_metre_per_second() -> None:
    """The margin of 0.2 sides of the built-in scenario `crowd`, whose robots these are."""
    assert required_margin_m(FAST_MPS) < BodyRule(1.0).margin_sides * SIDE_M < required_margin_m(0.16)


BLOCK = 2.6 * SIDE_M * (np.arange(4)[:, None] + 1j * np.array([0, 1, -1, 2, -2])).ravel()


@pytest.mark.parametrize("makes_way", [True, False])
def test_block_makes_way_for_retreating_robot(make_detections, monkeypatch, makes_way) -> None:
    """Twenty robots stand in a block, and a body pursues the one in the middle of a side into it."""
    if not makes_way:
        monkeypatch.setattr(
            import_module("skyherd.control.avoidance.proximity"),
            "yielding_sides",
            lambda gaps_sides, is_robot: np.zeros(gaps_sides.shape),
        )
    rule = replace(MOVER_RULE, retreat_sides=0.1)
    gaps = [
        pursue(make_detections, BLOCK, -2.4 * SIDE_M, FAST_MPS, 0.2 * SIDE_M, seed=s, seconds=30.0, rule=rule)
        for s in range(2)
    ]
    assert (min(gaps) > 0) == makes_way


def test_robots_yield_to_lower_ranks_only() -> None:
    """An obstacle is within the margin of robot 0; robots 1 and 2 are behind it, and robot 3 is far away.

    The gaps are those of a line: obstacle, 0, 1, 2, with 0.5 sides between neighbours.
    """
    at = np.array([0.0, 0.5, 1.0, 9.0, -0.1])
    gaps = np.abs(at[:, None] - at)
    gaps[0, 4] = gaps[4, 0] = 0.0
    np.fill_diagonal(gaps, np.inf)
    gaps[0, 2] = gaps[2, 0] = 1.5
    is_robot = np.array([True, True, True, True, False])
    more = yielding_sides(gaps, is_robot)
    expected = np.zeros((5, 5))
    expected[1, 0] = expected[2, [0, 1]] = expected[3, [0, 1, 2]] = YIELD_SIDES
    np.testing.assert_array_equal(more, expected)
    gaps[0, 4] = gaps[4, 0] = 0.01
    assert not yielding_sides(gaps, is_robot).any(), "an obstacle outside the margin needs no way"


def bounds_of(bearings_deg, speeds_mps, gaps_m, is_side=False) -> Bounds:
    """Return bounds of one robot without errors, for bodies of two sides across with a margin."""
    gaps_m = np.array(gaps_m)
    return Bounds(
        rows=np.zeros(gaps_m.size, dtype=np.int64),
        bearings_rad=np.radians(bearings_deg),
        speeds_mps=np.array(speeds_mps),
        slack_rad=np.zeros(gaps_m.size),
        gaps_m=gaps_m,
        distances_m=gaps_m + 2.2 * SIDE_M,
        retreat_mps=np.array(speeds_mps),
        is_side=np.full(gaps_m.size, is_side),
        unseen_mps=np.array([10.0]),
    )


EXACT = replace(MOVER_RULE, lag_s=0.0, brakes_s=0.0)
FAR_M = CLEAR_SIDES * SIDE_M


@pytest.mark.parametrize(
    ("bearings_deg", "speeds_mps", "gaps_m", "leaves_deg"),
    [
        ([0], [0.0], [0.0], 180),
        ([120], [0.0], [0.0], -10),  # -60 opens faster, but needs a longer turn
        ([0, 150], [0.0, 0.01], [0.0, FAR_M], -120),  # a right angle to the second body
        ([0, 90], [0.0, 0.0], [0.0, 0.0], -140),  # the middle is -135, between two of 36 directions
    ],
)
def test_retreat_opens_smallest_gap_soonest(bearings_deg, speeds_mps, gaps_m, leaves_deg) -> None:
    rows, velocities = retreat(bounds_of(bearings_deg, speeds_mps, gaps_m), EXACT, np.ones(1, dtype=bool))
    assert rows.tolist() == [0] and abs(velocities[0]) == pytest.approx(WHEELS.max_speed_mps)
    assert velocities[0] / WHEELS.max_speed_mps == pytest.approx(np.exp(1j * np.radians(leaves_deg)))


def test_robot_between_two_bodies_leaves_sideways_in_time() -> None:
    """A body is within the margin, and a second one opposite at a tenth of a side beyond it.

    Straight away from the first the bound of the second still allows 0.05 m/s, but only for a short way.
    """
    bounds = bounds_of([0, 180], [0.03, 0.05], [-0.001, 0.04])
    _, velocities = retreat(bounds, EXACT, np.ones(1, dtype=bool))
    assert abs(np.cos(np.angle(velocities[0]))) < 0.1
    beyond = bounds_of([0, 180], [0.03, 0.3], [-0.001, FAR_M])
    _, velocities = retreat(beyond, EXACT, np.ones(1, dtype=bool))
    assert np.cos(np.angle(velocities[0])) < -0.3, "negative control: a body that is clear does not count"


@pytest.mark.parametrize(
    ("body_gap", "body_id", "makes_way"), [(-0.01, 7, False), (0.01, 7, True), (-0.01, ANONYMOUS_ID, False)]
)
def test_robot_near_foreign_body_does_not_make_way(body_gap, body_id, makes_way) -> None:
    """Units that do not see the body ask it to. Both robots would otherwise make way for each other."""
    memory = NeighborMemory(np.array([1]), np.array([1, 2, 7]), 2.0)
    gap, way = 0.4, 1.0
    message = Proximity(
        0,
        0.0,
        8.0,
        [1, 2],
        [1, 1],
        [2, body_id],
        [2.2 + gap, 2.2 + body_gap],
        [0.0, 2.0],
        [2.2, 2.2],
        [0.5, 1.0 if body_id == 7 else 0.5],
        [way, 0.0],
    )
    memory.receive(message)
    bounds = closing_bounds(memory, MOVER_RULE, 0.0)
    to_robot = bounds.gaps_m[np.argmax(bounds.distances_m)] / SIDE_M
    assert to_robot == pytest.approx(gap - way if makes_way else gap)


def test_leaving_robot_may_use_up_part_of_margin() -> None:
    """The bound of a retreat is the bound at a gap that is larger by `retreat_sides`."""
    memory = NeighborMemory(np.arange(1), np.arange(2), 2.0)
    gaps_sides, lent = np.array([-0.05, 0.3]), 0.1
    at = (np.zeros(2, dtype=np.int64), np.array([4, 5]))
    memory.reaches_sides[at], memory.distances_sides[at] = 2.2, 2.2 + gaps_sides
    memory.imaged_s[at] = memory.seen_s[:] = 0.0
    for rule in (MOVER_RULE, replace(MOVER_RULE, retreat_sides=lent)):
        bounds = closing_bounds(memory, rule, 0.0)
        more = (gaps_sides + rule.retreat_sides) * SIDE_M
        np.testing.assert_allclose(bounds.retreat_mps, rule.limit_mps(np.maximum(more, 0.0), np.zeros(2)))
        np.testing.assert_array_equal(bounds.of_retreat(np.array([0])).speeds_mps, bounds.retreat_mps)
        none = bounds.of_retreat(np.zeros(0, dtype=np.int64))
        np.testing.assert_array_equal(none.speeds_mps, bounds.speeds_mps)
        assert bounds.speeds_mps[0] == 0 < bounds.speeds_mps[1]


@pytest.mark.parametrize("other_id", [int(BORDER_IDS[1]), ANONYMOUS_ID])
def test_robot_at_goal_leaves_bodies_but_not_image_sides(other_id) -> None:
    """A side moves with its camera, so robots in their places would be driven out of the shape."""
    memory = NeighborMemory(np.array([1]), np.array([1, 2]), 2.0)
    memory.receive(Proximity(0, 0.0, 8.0, [1], [1], [other_id], [1.5], [0.0], [2.2], [1.0]))
    v_mps, _ = avoiding_law(np.zeros(1, complex), GAINS, memory=memory, rule=MOVER_RULE, time_s=0.0)
    assert (v_mps[0] < -0.1) == (other_id == ANONYMOUS_ID)
    v_mps, _ = avoiding_law(np.ones(1, complex), GAINS, memory=memory, rule=MOVER_RULE, time_s=0.0)
    assert v_mps[0] <= 0, "neither is approached"


def joined(*bounds: Bounds) -> Bounds:
    """Return the bounds of one robot for all pairs of several."""
    names = [field.name for field in fields(Bounds) if field.name != "unseen_mps"]
    return replace(bounds[0], **{n: np.concatenate([getattr(b, n) for b in bounds]) for n in names})


def test_robot_near_image_side_leaves_no_body_beyond_its_margin() -> None:
    side, body = bounds_of([0], [0.0], [-0.1], is_side=True), bounds_of([90], [0.1], [0.1])
    assert retreat(joined(body, side), EXACT, np.ones(1, dtype=bool))[0].size == 0


def test_image_side_bounds_retreat_from_body() -> None:
    """The robot leaves along a side behind it, not through it. It does not leave a side beside it."""
    body, side = bounds_of([0], [0.01], [0.0]), bounds_of([180], [0.01], [0.3], is_side=True)
    beside = bounds_of([90], [0.0], [0.0], is_side=True)
    for bounds, cosine in ((body, -1.0), (joined(body, side), 0.0), (joined(body, beside), -1.0)):
        _, velocities = retreat(bounds, EXACT, np.ones(1, dtype=bool))
        assert np.cos(np.angle(velocities[0])) == pytest.approx(cosine, abs=0.1)


def test_enclosed_robot_or_robot_without_goal_does_not_retreat() -> None:
    around = bounds_of([0, 120, 240], [0.0] * 3, [0.0] * 3)
    assert retreat(around, EXACT, np.ones(1, dtype=bool))[0].size == 0
    behind = bounds_of([180], [0.0], [0.0])
    assert retreat(behind, EXACT, np.zeros(1, dtype=bool))[0].size == 0
    outside = bounds_of([180], [0.3], [0.1])
    assert retreat(outside, EXACT, np.ones(1, dtype=bool))[0].size == 0
