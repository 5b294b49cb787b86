"""Robots keep away from the border of a lone unit's image while a robot is hidden beyond it."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyherd.control import (
    AerialController,
    AvoidanceRule,
    BodyRule,
    GroundMap,
    Hover,
    NeighborMemory,
    SafetyRadius,
    Template,
    Wheels,
)
from skyherd.control.avoidance.image_border import (
    HIDDEN_SIDES,
    UNSEEN_S,
    HiddenBeyond,
    HiddenRobots,
    ImageBorder,
)
from skyherd.control.avoidance.proximity import proximity
from skyherd.control.avoidance.speed_bound import closing_bounds, slowed
from skyherd.control.rectification.ground_map import ANISOTROPY, LENS, PERSPECTIVE, UNKNOWNS
from skyherd.geometry import to_complex, to_points
from skyherd.messages import BORDER_IDS, Detections, Proximity, UnitReport
from skyherd.sim.world import move_bodies

SIZE = np.array([640, 480])
SIDE_PX = 20.0
BODIES = BodyRule(radius_sides=1.0, margin_sides=0.0)
TEAM = np.array([0, 1, 2])
GOAL_TIMEOUT_S = 2.0
"""Time after which an unseen robot has only stale goals and is static."""


def map_with(squeeze=0.0, horizon=0.0, lens=0.0) -> GroundMap:
    unknowns = np.zeros(UNKNOWNS)
    unknowns[ANISOTROPY] = complex(squeeze).real, complex(squeeze).imag
    unknowns[PERSPECTIVE] = complex(horizon).real, complex(horizon).imag
    unknowns[LENS[0]] = lens
    return GroundMap(unknowns)


def margins_px(points: np.ndarray) -> np.ndarray:
    """Return minimum distances (N,) of image points from the four sides, up to the outer edges of pixels."""
    u, v = points.real, points.imag
    return np.min([u + 0.5, v + 0.5, SIZE[0] - 0.5 - u, SIZE[1] - 0.5 - v], axis=0)


def image_points(seed: int, count: int = 400) -> np.ndarray:
    """Return points all over the image and a fifth of it around."""
    rng = np.random.default_rng(seed)
    low, high = -0.2 * SIZE, 1.2 * SIZE
    return to_complex(rng.uniform(low, high, (count, 2)))


def test_border_depths_equal_distances_from_sides() -> None:
    border = ImageBorder.of(SIZE, GroundMap())
    assert border.depths_px(np.array([10 + 20j])) == pytest.approx(np.array([[20.5, 629.5, 459.5, 10.5]]))
    points = image_points(0)
    assert border.depths_px(points).min(axis=1) == pytest.approx(margins_px(points))


@given(
    squeeze=st.complex_numbers(max_magnitude=0.2),
    horizon=st.complex_numbers(max_magnitude=0.25),
    seed=st.integers(0, 2**31),
)
def test_border_under_tilt_and_anisotropy_contains_exact_image(squeeze, horizon, seed) -> None:
    """The equivalence holds in both directions, since lines stay lines.

    The reference is the camera's own pixels, not the rectified ones.
    """
    ground_map = map_with(squeeze, horizon)
    raw = image_points(seed)
    margins = margins_px(raw)
    raw = raw[np.abs(margins) > 0.01]
    border = ImageBorder.of(SIZE, ground_map)
    rectified = to_complex(ground_map.rectified_px(to_points(raw), SIZE))
    is_inside = (border.depths_px(rectified) > 0).all(axis=1)
    assert (is_inside == (margins_px(raw) > 0)).all()


@pytest.mark.parametrize("lens", [-0.2, -0.05, 0.05, 0.2])
def test_border_under_lens_touches_innermost_point_of_side(lens) -> None:
    """Barrel and pincushion, tilted: no point of a side lies farther inside, and one lies on the line.

    The tolerance is 1 % of the bend: 17 points per side leave at most (1 / 16)² of an arc.
    """
    ground_map = map_with(horizon=0.1 - 0.05j, lens=lens)
    border = ImageBorder.of(SIZE, ground_map)
    (width, height), along = SIZE, np.linspace(0, 1, 2001)
    upper, right = width * along + 0j, width + 1j * height * along
    lower, left = width * along + 1j * height, 1j * height * along
    for side, raw in enumerate((upper, right, lower, left)):
        rectified = to_complex(ground_map.rectified_px(to_points(raw - (0.5 + 0.5j)), SIZE))
        depths = border.depths_px(rectified)[:, side]
        bend = np.ptp(depths)
        assert bend > 1.0 and -1e-9 < depths.max() < 0.01 * bend


@pytest.mark.parametrize("heading", [0.0, 2.0])
@pytest.mark.parametrize("side", range(4))
def test_border_side_equals_robot_at_nearest_hidden_point(make_detections, side, heading) -> None:
    """Gap, bearing and share are equal to those of an obstacle drawn there."""
    robot, border = 60 + 70j, ImageBorder.of(SIZE, GroundMap())
    depth = border.depths_px(np.array([robot]))[0, side]
    there = robot - border.normals[side] * (depth - HIDDEN_SIDES * SIDE_PX)
    seen = make_detections([0, 9], [robot, there], headings=[heading, 0], sides=[SIDE_PX] * 2, size=SIZE)
    wide = BodyRule(1.0, margin_sides=0.3, horizon_sides=40.0, obstacles={9: 1.0})
    message = proximity(seen, TEAM, wide, HiddenBeyond(border, TEAM))
    (drawn,) = np.flatnonzero((message.robot_ids == 0) & (message.other_ids == 9))
    (told,) = np.flatnonzero((message.robot_ids == 0) & (message.other_ids == BORDER_IDS[side]))
    gaps = message.distances_sides - message.reaches_sides
    assert gaps[told] == pytest.approx(gaps[drawn])
    assert np.exp(1j * message.bearings_rad[told]) == pytest.approx(np.exp(1j * message.bearings_rad[drawn]))
    assert message.shares[told] == message.shares[drawn] == 1.0


def test_border_gap_of_robot_beyond_line_is_zero(
    make_detections,
) -> None:
    """A robot beyond the line has distance 0 from it, at any depth."""
    straight = ImageBorder.of(SIZE, GroundMap())
    border = ImageBorder(straight.normals, straight.offsets_px + np.array([0, 0, 0, 200.0]))
    seen = make_detections([0], [50 + 240j], sides=[SIDE_PX], size=SIZE)
    message = proximity(seen, TEAM, BODIES, HiddenBeyond(border, TEAM))
    assert message.other_ids.tolist() == [BORDER_IDS[3]] and message.distances_sides.tolist() == [0.0]


def test_border_is_reported_to_concerned_robots_in_horizon(make_detections) -> None:
    seen = make_detections([0, 1, 2], [100 + 240j, 100 + 100j, 320 + 240j], sides=[SIDE_PX] * 3, size=SIZE)
    border = ImageBorder.of(SIZE, GroundMap())
    message = proximity(seen, TEAM, BODIES, HiddenBeyond(border, np.array([0, 2])))
    is_side = message.other_ids < 0
    assert message.robot_ids[is_side].tolist() == [0] and message.other_ids[is_side].tolist() == [-2]
    plain = proximity(seen, TEAM, BODIES)
    assert not (plain.other_ids < 0).any()
    assert plain.distances_sides.tolist() == message.distances_sides[~is_side].tolist()


def test_robot_is_hidden_after_a_second_unseen_by_all_units(make_detections, make_report) -> None:
    """Own images and other units' reports count, from the times of their images."""
    hidden = HiddenRobots(TEAM)

    def beyond(time_s: float, ids: list[int], *reports) -> HiddenBeyond | None:
        seen = make_detections(ids, [300.0 + 50 * i for i in ids], size=SIZE, time_s=time_s)
        return hidden.beyond(seen, reports, GroundMap())

    def other(time_s: float, ids: list[int]):
        return replace(make_report(1, ids, [100.0] * len(ids), ids), time_s=time_s)

    assert beyond(5.0, [0]) is None, "at first all count as seen"
    assert beyond(5.9, [0], other(5.5, [1, 2, 7])) is None
    assert beyond(6.4, [0, 1], other(5.5, [1, 2, 7])) is None
    found = beyond(6.6, [0, 1], other(5.5, [1, 2, 7]))
    assert found is not None, "robot 2 was last seen at 5.5 s, in a report that only comes again"
    assert found.concerned_ids.tolist() == [0, 1, 2]
    assert beyond(6.8, [0, 1], other(6.7, [2])) is None, "the other unit has it again"
    found = beyond(8.0, [0, 1], other(7.9, [1]))
    assert found is not None and found.concerned_ids.tolist() == [0, 2], "the other unit sees 1"
    assert beyond(8.2, [2], other(8.1, [0, 1])) is None
    assert AvoidanceRule.lifetime_s > UNSEEN_S, "the border takes over before robots forget"


def test_border_is_removed_by_next_image_without_border(make_detections) -> None:
    memory = NeighborMemory(TEAM, TEAM, lifetime_s=2.0)
    border = HiddenBeyond(ImageBorder.of(SIZE, GroundMap()), TEAM)

    def send(time_s: float, hidden: HiddenBeyond | None, ids: list[int]) -> list[int]:
        seen = make_detections(ids, [50 + 240j] * len(ids), size=SIZE, time_s=time_s)
        memory.receive(proximity(seen, TEAM, BODIES, hidden))
        rows, columns = memory.fresh(time_s)
        return memory.other_ids[columns[rows == 0]].tolist()

    assert send(1.0, border, [0]) == [-2]
    assert send(1.5, None, [1]) == [-2], "a message that is not for the robot changes nothing"
    assert send(2.0, None, [0]) == []


@dataclass
class LoneUnit:
    """Image of one unit over ground, 100 px per metre, which moves, and a robot that tries to leave it.

    Robot 0 is visible. The marker of robot 1 is not completely in the image, and robot 1 never moves.
    """

    rng: np.random.Generator
    reports_border: bool
    image_every: int = 2
    camera_mps: complex = 0.0
    rule: AvoidanceRule = field(
        default_factory=lambda: AvoidanceRule(
            0.2, Wheels(0.5, 2.0), nominal_age_s=0.2, superseded_age_s=0.2, step_s=0.1
        )
    )

    def min_gap_m(self, make_detections, ticks: int = 150) -> float:
        """Return the minimum gap between the two bodies while robot 0 drives at robot 1 as well as it can."""
        position_m = complex(*self.rng.uniform(-0.8, 0.8, 2))
        heading = self.rng.uniform(-np.pi, np.pi, 1)
        along = self.rng.uniform(-1.0, 1.0)
        hidden_m = self.rng.choice(
            [3.2 + 0.95j * along, -3.2 + 0.95j * along, along * 1.3 + 2.4j, along * 1.3 - 2.4j]
        )
        memory = NeighborMemory(TEAM[:1], TEAM, self.rule.lifetime_s)
        min_m = np.inf
        for tick in range(ticks):
            now_s = tick * self.rule.step_s
            if tick % self.image_every == 0:
                places_m = np.array([position_m, hidden_m]) - self.camera_mps * now_s
                self._tell(memory, make_detections, places_m, heading, now_s)
            is_commanded = now_s - memory.seen_s < GOAL_TIMEOUT_S
            off = np.angle((hidden_m - position_m) * np.exp(-1j * heading))
            v, omega = slowed(
                np.where(is_commanded, 0.5 * np.sign(np.cos(off)), 0.0),
                np.where(is_commanded, np.clip(4 * np.arctan(np.tan(off)), -2, 2), 0.0),
                bounds=closing_bounds(memory, self.rule, now_s),
                rule=self.rule,
            )
            memory.record_rotation(omega, now_s, self.rule.step_s)
            moved_m, heading = move_bodies(
                to_points([position_m]), heading, v, omega, step_s=self.rule.step_s, axis_offset_m=0.0
            )
            position_m = complex(to_complex(moved_m)[0])
            min_m = min(min_m, abs(hidden_m - position_m))
        return min_m - 2 * BODIES.radius_sides * 0.2

    def _tell(self, memory: NeighborMemory, make_detections, places_m, heading, now_s: float) -> None:
        """Send the message of an image of 100 px per metre, v down; it arrives at once."""
        points = 100 * places_m.conj() + complex(*(SIZE - 1) / 2)
        ids = np.flatnonzero(margins_px(points) > HIDDEN_SIDES * SIDE_PX)
        headings = np.array([-heading[0], 0.0])[ids]
        seen = make_detections(
            ids, points[ids], headings=headings, sides=[SIDE_PX] * ids.size, size=SIZE, time_s=now_s
        )
        hidden = HiddenBeyond(ImageBorder.of(SIZE, GroundMap()), TEAM)
        is_told = self.reports_border and 1 not in ids
        memory.receive(proximity(seen, TEAM, BODIES, hidden if is_told else None))


@pytest.mark.parametrize("camera_mps", [0.0, 0.1 + 0.1j, -0.15j])
def test_lone_unit_keeps_robots_off_hidden_robot(make_detections, camera_mps) -> None:
    """Full speed towards the robot, from anywhere, on each of the four sides, under any unit motion."""
    for seed in range(12):
        unit = LoneUnit(np.random.default_rng(seed), reports_border=True, camera_mps=camera_mps)
        assert unit.min_gap_m(make_detections) > 0, seed


def test_lone_unit_without_border_allows_collision(make_detections) -> None:
    gaps = [
        LoneUnit(np.random.default_rng(seed), reports_border=False).min_gap_m(make_detections)
        for seed in range(12)
    ]
    assert sum(gap < 0 for gap in gaps) >= 6


@dataclass
class KnownCamera:
    """Stand-in for a rectifier with a known camera, which receives rectified detections."""

    ground_map: GroundMap

    def rectify(self, detections: Detections) -> Detections:
        return detections


@pytest.mark.parametrize("ground_map", [GroundMap(), map_with(horizon=0.1)])
def test_unit_reports_border_while_robot_is_missing(make_detections, make_report, ground_map) -> None:
    """The border has its rectified distance; it is not reported while another unit sees the robot."""
    template = Template(TEAM, np.array([0, 100, 100j]))
    policy, near_only = SafetyRadius(radius=1.5), BodyRule(1.0, margin_sides=0.0, horizon_sides=4.0)
    unit = AerialController(template, policy, Hover(), rectifier=KnownCamera(ground_map), bodies=near_only)

    def near(time_s: float, ids: list[int], *reports: UnitReport) -> Proximity:
        seen = make_detections(ids, [50 + 240j, 320 + 240j, 330 + 300j][: len(ids)], size=SIZE, time_s=time_s)
        return unit.step(seen, reports).proximity

    for tick in range(6):
        assert not (near(0.2 * tick, [0, 1]).other_ids < 0).any()
    message = near(1.2, [0, 1])
    assert message.other_ids.tolist() == [BORDER_IDS[3]]
    depth = ImageBorder.of(SIZE, ground_map).depths_px(np.array([50 + 240j]))[0, 3]
    assert message.distances_sides == pytest.approx([depth / SIDE_PX])
    elsewhere = replace(make_report(1, [2], [100.0], [2]), time_s=1.3)
    assert not (near(1.4, [0, 1], elsewhere).other_ids < 0).any()
    assert (near(2.6, [0, 1], elsewhere).other_ids < 0).any()
    assert not (near(2.8, [0, 1, 2]).other_ids < 0).any()
