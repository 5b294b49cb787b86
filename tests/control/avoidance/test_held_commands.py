"""Robots keep apart that decide at different instants and whose wheels obey a command until the next one."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from skyherd.control import AvoidanceRule, BodyRule, LatencyCompensation, MarkerGains, NeighborMemory, Wheels
from skyherd.control.avoidance.avoiding_law import avoiding_law
from skyherd.control.avoidance.proximity import proximity
from skyherd.control.avoidance.speed_bound import closing_bounds
from skyherd.geometry import to_complex
from skyherd.messages import Proximity, VelocityCommand

SIDE_M, TICK_S, PERIOD_S, LIFE_S, IMAGE_S = 0.2, 0.02, 0.1, 0.5, 0.1
WHEELS = Wheels(0.5, 2.0)
ROBOTS = 6
REACH_M = 2 * SIDE_M
RULE = AvoidanceRule(
    SIDE_M,
    WHEELS,
    nominal_age_s=0.2,
    superseded_age_s=0.0,
    step_s=LIFE_S,
    line_s=LIFE_S,
    detour="none",
)
GAINS = MarkerGains(5.0, 20.0, 0.0, SIDE_M)


@dataclass
class Robot:
    """A robot's own computer, and what its wheels obey."""

    row: int
    rule: AvoidanceRule
    due_s: float

    def __post_init__(self) -> None:
        self.motion = LatencyCompensation(1, SIDE_M, memory_s=2.0, hold_s=LIFE_S)
        ids = np.arange(ROBOTS)
        self.memory = NeighborMemory(ids[[self.row]], ids, self.rule.lifetime_s, self.motion)
        self.told, self.told_s = (0.0, 0.0), -np.inf

    def decide(self, rho: complex, now_s: float) -> None:
        """Follow a vector in the robot's frame as fast as the bounds allow."""
        v_mps, omega_radps = avoiding_law(
            np.array([rho]), GAINS, memory=self.memory, rule=self.rule, time_s=now_s
        )
        self.motion.record(VelocityCommand([self.row], v_mps, omega_radps), now_s)
        self.told, self.told_s = (float(v_mps[0]), float(omega_radps[0])), now_s


def least_gap_m(seed: int, rule: AvoidanceRule, make_detections, seconds: float = 8.0) -> float:
    """Return the least gap of robots that drive at one another, or past one another, at full speed.

    Each message is 0.02 to 0.2 s late at each robot, and 30 % are lost. After a fifth of its decisions a
    robot makes no other one for as long as its wheels obey the last.
    """
    rng = np.random.default_rng(seed)
    places: list[complex] = []
    while len(places) < ROBOTS:
        at = complex(*rng.uniform(-0.8, 0.8, 2))
        if all(abs(at - other) > 1.1 * REACH_M for other in places):
            places.append(at)
    at_m, headings = np.array(places), rng.uniform(-np.pi, np.pi, ROBOTS)
    robots = [Robot(row, rule, rng.uniform(0, PERIOD_S)) for row in range(ROBOTS)]
    waiting: list[tuple[float, int, Proximity]] = []
    least_m, first, second = np.inf, *np.triu_indices(ROBOTS, 1)
    for tick in range(round(seconds / TICK_S)):
        now_s = tick * TICK_S
        if tick % round(IMAGE_S / TICK_S) == 0:
            seen = make_detections(
                range(ROBOTS),
                at_m.conj() * 100 / SIDE_M,
                headings=-headings,
                sides=[100.0] * ROBOTS,
                time_s=now_s,
            )
            message = proximity(seen, np.arange(ROBOTS), BodyRule(1.0, margin_sides=0.0))
            waiting += [
                (now_s + rng.uniform(0.02, 0.2), row, message) for row in range(ROBOTS) if rng.random() > 0.3
            ]
        for _, row, message in [entry for entry in waiting if entry[0] <= now_s]:
            robots[row].memory.receive(message, np.arange(ROBOTS) == row)
        waiting = [entry for entry in waiting if entry[0] > now_s]
        for row, robot in enumerate(robots):
            if now_s >= robot.due_s:
                away_m = np.delete(at_m, row) - at_m[row]
                towards = away_m[np.abs(away_m).argmin()]
                aim = towards / abs(towards) * np.exp(1j * rng.choice([0.0, 0.6, -0.6, 1.2, -1.2]))
                robot.decide(aim * np.exp(-1j * headings[row]), now_s)
                robot.due_s = now_s + (LIFE_S if rng.random() < 0.2 else PERIOD_S)
        told = np.array([r.told if now_s - r.told_s < LIFE_S - 1e-9 else (0.0, 0.0) for r in robots])
        middle = headings + told[:, 1] * TICK_S / 2
        at_m = at_m + told[:, 0] * TICK_S * np.exp(1j * middle)
        headings = headings + told[:, 1] * TICK_S
        least_m = min(least_m, float(np.abs(at_m[first] - at_m[second]).min()) - REACH_M)
    return least_m


@pytest.mark.parametrize("seed", range(6))
def test_robots_with_held_commands_do_not_touch(make_detections, seed) -> None:
    assert least_gap_m(seed, RULE, make_detections) > 0


def test_bound_with_life_of_a_period_lets_robots_touch(make_detections) -> None:
    weakened = replace(RULE, step_s=PERIOD_S, line_s=PERIOD_S)
    assert min(least_gap_m(seed, weakened, make_detections) for seed in range(6)) < 0


@pytest.mark.parametrize(("line_s", "touches"), [(LIFE_S, False), (0.0, True)])
def test_line_that_turns_during_a_held_command(make_detections, line_s, touches) -> None:
    """A robot drives straight past another one, which circles it ahead at full speed and never approaches."""
    robot = Robot(0, replace(RULE, line_s=line_s), 0.0)
    at_m = np.array([0.0, 1.01j * REACH_M])
    seen = make_detections([0, 1], at_m.conj() * 100 / SIDE_M, sides=[100.0] * 2, time_s=0.0)
    robot.memory.receive(proximity(seen, np.arange(2), BodyRule(1.0, margin_sides=0.0)))
    robot.decide(0.25 / (GAINS.k * SIDE_M), 0.0)
    least_m = np.inf
    for _ in range(round(LIFE_S / 0.001)):
        line = (at_m[1] - at_m[0]) / abs(at_m[1] - at_m[0])
        at_m = at_m + 0.001 * np.array([robot.told[0], WHEELS.max_speed_mps * -1j * line])
        least_m = min(least_m, abs(at_m[1] - at_m[0]) - REACH_M)
    assert (least_m < 0) == touches
    assert robot.told[0] > 0


def test_slack_has_the_turn_of_the_line_and_the_bearing(make_detections) -> None:
    """Two robots 1.0 m apart, 0.3 s after the image: `asin(2 v (age + line) / d)` and the bearing's error."""
    memory = NeighborMemory(np.array([0]), np.array([0, 1]), 2.0)
    seen = make_detections([0, 1], [0, 500], sides=[100, 100])
    memory.receive(proximity(seen, np.array([0, 1]), BodyRule(1.0)))
    bounds = closing_bounds(memory, replace(RULE, bearing_error_rad=0.25), 0.3)
    assert to_complex(seen.centers_px)[1] == 500
    np.testing.assert_allclose(bounds.slack_rad, np.arcsin(2 * 0.5 * (0.3 + LIFE_S) / 1.0) + 0.25)
