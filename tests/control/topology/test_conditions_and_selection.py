"""TC1-TC5, the selection of robots, and flight: rules on image quantities alone."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from skyherd.control import FlightTask, Follow, Hover, Perimeter, SafetyRadius, Template
from skyherd.control.topology.conditions import check_conditions, control_matrix, graph_edges
from skyherd.messages import shared_ids


def conditions_of(sets: list[list[int]], robots: int | None = None) -> tuple[bool, ...]:
    count = robots or max(max(members, default=-1) for members in sets) + 1
    matrix = control_matrix(
        {j: np.array(members, dtype=int) for j, members in enumerate(sets)}, np.arange(count)
    )
    c = check_conditions(matrix)
    assert c.in_q == (c.tc1 and c.tc2)
    assert c.in_p == (c.tc1 and c.tc2 and c.tc3 and c.tc4 and c.tc5)
    return c.tc1, c.tc2, c.tc3, c.tc4, c.tc5


class TestConditions:
    @pytest.mark.parametrize(
        ("sets", "robots", "expected"),
        [
            pytest.param([[0, 1, 2]], 3, (1, 1, 1, 1, 1), id="one unit holds all"),
            pytest.param(
                [[0, 1, 2, 3], [2, 3, 4], [0, 1, 5]], 6, (1, 1, 1, 1, 1), id="a tree of shared pairs"
            ),
            pytest.param([[0, 1, 2, 3], [2, 3, 4, 5], [4, 5, 6]], 7, (1, 1, 1, 1, 1), id="a path"),
            # Each of the next violates one condition and what follows: not connected is not a tree either.
            pytest.param([[0, 1, 2], [3, 4, 5]], 6, (0, 1, 1, 1, 0), id="not TC1: two islands (so no tree)"),
            pytest.param([[0, 1, 2], [1, 2, 3]], 5, (1, 0, 1, 1, 1), id="not TC2: robot 4 is nobody's"),
            pytest.param([[0, 1, 2, 3], [1, 2, 3, 4]], 5, (1, 1, 0, 1, 1), id="not TC3: three shared robots"),
            pytest.param(
                [[0, 1, 2, 3], [2, 3, 4, 5], [4, 5, 6, 0]],
                7,
                (1, 1, 0, 1, 1),
                id="not TC3: non-neighbours share one",
            ),
            pytest.param(
                [[0, 1, 2, 3], [2, 3, 4, 5], [4, 5, 0, 1]], 6, (1, 1, 1, 1, 0), id="not TC5: a cycle of pairs"
            ),
            # Three units on one robot: each two then share it, so that TC3 forces all three to be neighbours,
            # sharing two: a cycle. TC4 cannot fail alone: first with TC5, then with TC3.
            pytest.param(
                [[0, 1, 2], [0, 1, 3], [0, 1, 4]], 5, (1, 1, 1, 0, 0), id="not TC4: one pair held by three"
            ),
            pytest.param(
                [[0, 1, 2], [1, 2, 3, 4], [3, 4, 5, 2]],
                6,
                (1, 1, 0, 0, 1),
                id="not TC4: a robot of three on a tree (nor TC3)",
            ),
            pytest.param([[], []], 2, (0, 0, 1, 1, 0), id="no robot is controlled"),
        ],
    )
    def test_of_known_topologies(self, sets, robots, expected) -> None:
        assert conditions_of(sets, robots) == tuple(map(bool, expected))

    def test_match_definitions_of_paper(self) -> None:
        """Random topologies; each condition is written out over sets as in Section II."""
        rng = np.random.default_rng(1)
        seen = set()
        for _ in range(2000):
            units, robots = int(rng.integers(1, 5)), int(rng.integers(2, 9))
            sets = [
                set(np.flatnonzero(rng.random(robots) < rng.uniform(0.2, 0.8)).tolist()) for _ in range(units)
            ]
            pairs = [(j, k) for j in range(units) for k in range(j + 1, units)]
            links = [(j, k) for j, k in pairs if len(sets[j] & sets[k]) >= 2]
            reached, grown = {0}, True
            while grown:
                more = {k for j, k in links if j in reached} | {j for j, k in links if k in reached}
                grown = not more <= reached
                reached |= more
            tc1 = len(reached) == units
            tc2 = set().union(*sets) == set(range(robots))
            tc3 = all(len(sets[j] & sets[k]) == (2 if (j, k) in links else 0) for j, k in pairs)
            triples = [(j, k, m) for j, k in pairs for m in range(k + 1, units)]
            tc4 = not any(sets[j] & sets[k] & sets[m] for j, k, m in triples)
            tc5 = tc1 and len(links) == units - 1
            expected = (tc1, tc2, tc3, tc4, tc5)
            assert conditions_of([sorted(members) for members in sets], robots) == expected
            seen.add(expected)
        assert len(seen) >= 12, "many combinations came up"

    def test_graph_edges_need_two_shared_robots(self) -> None:
        sets = {7: np.array([0, 1, 2]), 3: np.array([1, 2, 5]), 5: np.array([2, 5, 9]), 1: np.array([9])}
        assert graph_edges(sets) == [(3, 5), (3, 7)]

    @pytest.mark.parametrize(
        "sets",
        [
            pytest.param([[0, 1, 2], [1, 2, 3, 4], [3, 4, 5]], id="a path"),
            pytest.param([[0, 1, 2, 3], [2, 3, 4], [0, 1, 5]], id="its middle has no robot of its own"),
            pytest.param([[0, 1, 2, 3, 4, 5, 6], [0, 1], [2, 3], [4, 5]], id="a star"),
            pytest.param([[0, 1], [0, 1, 2, 3, 4]], id="two units"),
        ],
    )
    def test_single_unit_cannot_change_set_size_within_p(self, sets) -> None:
        """All other sets of a unit beside the others' present ones have equal size if they are in P.

        The search is exhaustive, up to 128 sets per unit. Exchanges exist: the statement is not empty.
        """
        robots = max(map(max, sets)) + 1
        topology = np.array([[robot in members for robot in range(robots)] for members in sets])
        assert check_conditions(topology).in_p
        exchanges = 0
        for unit, present in enumerate(topology.copy()):
            for other in itertools.product([False, True], repeat=robots):
                topology[unit] = other
                if check_conditions(topology).in_p:
                    assert sum(other) == present.sum()
                    exchanges += tuple(other) != tuple(present)
            topology[unit] = present
        assert exchanges > 0


def at_radius(make_detections, radii: dict[int, float], time_s: float = 0.0, size=(800, 600)):
    """Return robots at the given distances from the image centre, in halves of the shorter side."""
    centre = complex((size[0] - 1) / 2, (size[1] - 1) / 2)
    points = [centre + min(size) / 2 * r * np.exp(1j * robot) for robot, r in radii.items()]
    return make_detections(list(radii), points, size=size, time_s=time_s)


TEAM = Template(np.arange(10), np.exp(2j * np.pi * np.arange(10) / 10))


class OneUnit:
    """Unit that selects by a safety radius of 0.8, with a leaving radius of 0.88, in slots of 2 s."""

    def __init__(self):
        self.policy = SafetyRadius(radius=0.8, hysteresis=0.1, dwell_s=2.0)

    def update(self, seen, reports):
        self.selection = self.policy.choose(seen, reports, TEAM, None)
        return self.selection.controlled_ids


@pytest.mark.parametrize("size", [(800, 600), (640, 640), (480, 1920)])
def test_centre_distances_are_in_halves_of_shorter_side(make_detections, size) -> None:
    """The origin is the middle of the pixel grid, (width - 1) / 2: exact to rounding for all sizes."""
    seen = at_radius(make_detections, {1: 0.0, 2: 0.5, 3: 1.0}, size=size)
    np.testing.assert_allclose(seen.centre_distances, [0, 0.5, 1.0], atol=1e-12)


class TestSafetyRadius:
    def test_has_hysteresis(self, make_detections, make_report) -> None:
        """A robot enters at 0.8 and leaves at 0.88 if another unit holds it; in between nothing changes."""
        control = OneUnit()
        other = make_report(1, [1, 2, 3], [0, 0, 0], [1, 2, 3], secure=[1, 2, 3])
        # (radius of robot 1, radius of robot 2) and who is controlled: once every dwell slot of 2 s
        story = [
            ((0.79, 0.81), [1]),
            ((0.81, 0.81), [1]),
            ((0.87, 0.79), [1, 2]),
            ((0.89, 0.85), [2]),
            ((0.85, 0.87), [2]),
            ((0.79, 0.89), [1]),
        ]
        for slot, ((one, two), expected) in enumerate(story):
            seen = at_radius(make_detections, {1: one, 2: two, 3: 0.0}, 2.0 * slot)
            assert control.update(seen, [other]).tolist() == [*expected, 3]

    def test_set_changes_once_per_slot(self, make_detections, make_report) -> None:
        """Robots enter and leave at every image: sets change only at multiples of 2 s of the common clock."""
        rng = np.random.default_rng(2)
        control = OneUnit()
        other = make_report(1, range(6), np.zeros(6), range(6), secure=range(6))
        changes, previous = [], None
        for tick in range(600):
            seen = at_radius(make_detections, dict(enumerate(rng.uniform(0, 1.2, 6))), tick * 0.1)
            now = control.update(seen, [other]).tolist()
            if previous is not None and now != previous:
                changes.append(tick)
            previous = now
        assert len(changes) > 20
        assert all(tick % 20 == 0 for tick in changes)

    def test_slots_of_late_times_contain_several_images(self, make_detections) -> None:
        """The numbers of slots are compared by value: an image within the 500th slot changes nothing."""
        control = OneUnit()
        for time_s, robots, expected in ((1000.0, {1: 0.2}, [1]), (1000.1, {1: 0.2, 2: 0.2}, [1])):
            assert control.update(at_radius(make_detections, robots, time_s), []).tolist() == expected

    @pytest.mark.parametrize(("seen_s", "left"), [(0.5, False), (1.9, False), (2.0, True)])
    def test_releases_unseen_robot_after_dwell_time(self, make_detections, make_report, seen_s, left) -> None:
        """Another unit holds robot 1, which this unit sees for the last time at `seen_s` and misses at the
        first image of the next slot: exactly a dwell time later, or earlier.
        """
        control = OneUnit()
        other = make_report(1, [1, 2], [0, 0], [1, 2], secure=[1, 2])
        control.update(at_radius(make_detections, {1: 0.2, 2: 0.1}, 0.0), [])
        control.update(at_radius(make_detections, {1: 0.2, 2: 0.1}, seen_s), [other])
        later = at_radius(make_detections, {2: 0.1}, 4.0 if seen_s >= 2.0 else 2.0)
        assert control.update(later, [other]).tolist() == ([2] if left else [1, 2])

    def test_keeps_robot_until_secured_by_other(self, make_detections, make_report) -> None:
        """The robot is far out or out of view (a missed detection), until a report contains it as secure."""
        control = OneUnit()
        control.update(at_radius(make_detections, {1: 0.2, 2: 0.2}), [])
        far = {1: 1.1, 2: 0.2}
        assert control.update(at_radius(make_detections, far, 2.0), []).tolist() == [1, 2]
        merely_controlled = make_report(1, [1], [0], [1], secure=[])
        assert control.update(at_radius(make_detections, far, 4.0), [merely_controlled]).tolist() == [1, 2]
        assert control.update(at_radius(make_detections, {2: 0.2}, 6.0), [merely_controlled]).tolist() == [
            1,
            2,
        ]
        secured = make_report(1, [1], [0], [1], secure=[1])
        assert control.update(at_radius(make_detections, far, 8.0), [secured]).tolist() == [2]

    def test_secures_robots_inside(self, make_detections) -> None:
        control = OneUnit()
        control.update(at_radius(make_detections, {1: 0.2, 2: 0.7, 3: 0.9}), [])
        control.update(at_radius(make_detections, {1: 0.2, 2: 0.85, 3: 0.3}, 0.1), [])
        assert control.selection.controlled_ids.tolist() == [1, 2]
        assert control.selection.secure_ids.tolist() == [1]

    def test_two_descending_units_do_not_both_release_robot(self, make_detections, make_report) -> None:
        """Each knows the other's last report: robot 1 leaves both discs at once, and both keep it."""
        one, two = OneUnit(), OneUnit()
        near, far = {1: 0.5, 2: 0.1}, {1: 0.95, 2: 0.1}
        for control in (one, two):
            control.update(at_radius(make_detections, near), [])
        for time_s in (2.0, 4.0, 6.0):
            seen = at_radius(make_detections, far, time_s)
            held = [control.selection.controlled_ids for control in (one, two)]
            secure = [ids[ids == 2] for ids in held]  # robot 1 is outside the radius at both
            reports = [make_report(j, [1, 2], [0, 0], held[j], secure=secure[j]) for j in (0, 1)]
            assert 1 in one.update(seen, [reports[1]])
            assert 1 in two.update(seen, [reports[0]])


def test_shared_ids_are_own_robots_controlled_by_others(make_report) -> None:
    reports = [make_report(1, [1, 2], [0, 0], [1, 9]), make_report(2, [3], [0], [3])]
    assert shared_ids(np.array([1, 2, 3]), reports).tolist() == [1, 3]
    assert shared_ids(np.array([1, 2, 3]), []).tolist() == []


def scaled(seen, factor: float, size: tuple[int, int]):
    """Return the same view through another sensor, with `factor` times the pixels."""
    return replace(
        seen,
        image_size_px=np.array(size),
        centers_px=(seen.centers_px - (seen.image_size_px - 1) / 2) * factor + (np.array(size) - 1) / 2,
        sides_px=seen.sides_px * factor,
        corners_px=seen.corners_px * factor,
    )


FLIGHTS = {
    "follow": lambda: Follow(0.7),
    "perimeter": lambda: Perimeter(0.7, 0.2),
    "hover": lambda: Hover(0.1),
}


@pytest.mark.parametrize("name", FLIGHTS)
def test_flight_command_is_independent_of_pixel_size(make_detections, name) -> None:
    """Twice the pixels, the same scene: equal commands to rounding."""
    rng = np.random.default_rng(3)
    seen = at_radius(make_detections, dict(enumerate(rng.uniform(0.1, 0.9, 6))), size=(600, 600))
    commands = [
        FLIGHTS[name]().command(view, FlightTask(np.arange(6)), [])
        for view in (seen, scaled(seen, 2.0, (1200, 1200)), scaled(seen, 0.37, (222, 222)))
    ]
    for command in commands[1:]:
        np.testing.assert_allclose(command.lateral_mps, commands[0].lateral_mps, rtol=0, atol=1e-12)
        assert command.climb_mps == pytest.approx(commands[0].climb_mps, abs=1e-12)
        assert command.yaw_rate_radps == commands[0].yaw_rate_radps


class TestFollow:
    @pytest.mark.parametrize(
        ("farthest", "climb"), [(0.9, 0.2 - 0.05), (0.5, -0.2 + 0.05), (0.73, 0.0), (0.66, 0.0)]
    )
    def test_climbs_for_robot_beyond_desired_radius(self, make_detections, farthest, climb) -> None:
        """The climb is proportional to the excess over 0.7 beyond a dead band of 0.05, in both directions."""
        seen = at_radius(make_detections, {1: 0.1, 2: farthest, 3: 0.3})
        command = Follow(0.7, climb_gain_mps=2.0, dead_band=0.05).command(seen, FlightTask(seen.ids), [])
        assert command.climb_mps == pytest.approx(2 * climb, abs=1e-12)

    def test_flies_towards_centroid_of_kept_robots(self, make_detections) -> None:
        """Robots at +u, +v of the centre, without others' robots: speed proportional to the distance."""
        half, centre = 400, 399.5 + 399.5j
        seen = make_detections([1, 2, 3], centre + half * np.array([0.2 + 0.4j, 0.4 + 0j, -0.9 - 0.9j]))
        command = Follow(0.7, lateral_gain_mps=0.5).command(seen, FlightTask(np.array([1, 2])), [])
        np.testing.assert_allclose(command.lateral_mps, 0.5 * np.array([0.3, 0.2]), atol=1e-12)

    def test_keeps_two_common_robots_nearest_to_center(self, make_detections, make_report) -> None:
        """A neighbour has 1-4 nearer to its own centre: of these, 3 and 1 are kept; 5 is the unit's own."""
        seen = at_radius(make_detections, {1: 0.3, 2: 0.6, 3: 0.2, 4: 0.8, 5: 0.4})
        centre = complex(399.5, 299.5)
        theirs = make_report(1, [1, 2, 3, 4], [centre] * 4, [1, 2, 3, 4], size=(800, 600))
        flight = Follow(0.7, climb_gain_mps=1.0, dead_band=0.0)
        command = flight.command(seen, FlightTask(seen.ids), [theirs])
        assert command.climb_mps == pytest.approx(0.4 - 0.7), (
            "5, the unit's own, is the farthest of {1, 3, 5}"
        )
        kept = seen.select([1, 3, 5]).centers_px
        np.testing.assert_allclose(
            command.lateral_mps, ((kept - [399.5, 299.5]) / 300).mean(axis=0), atol=1e-12
        )

    def test_keeps_pairs_only_for_initial_neighbors(self, make_detections, make_report) -> None:
        """A unit that shared one robot at the start is not a neighbour: later it may take the pair."""
        centre = complex(399.5, 299.5)
        flight = Follow(0.7, dead_band=0.0)
        seen = at_radius(make_detections, {1: 0.3, 2: 0.6, 3: 0.5})
        flight.command(seen, FlightTask(seen.ids), [make_report(1, [1], [centre], [1], size=(800, 600))])
        command = flight.command(
            seen, FlightTask(seen.ids), [make_report(1, [1, 2], [centre] * 2, [1, 2], size=(800, 600))]
        )
        assert command.climb_mps == pytest.approx(0.6 - 0.7), (
            "2 and 3 are charges from the start, 1 is the other's"
        )
        kept = seen.select([2, 3]).centers_px
        np.testing.assert_allclose(
            command.lateral_mps, ((kept - [399.5, 299.5]) / 300).mean(axis=0), atol=1e-12
        )

    def test_assigns_shared_robot_to_exactly_one_unit(self, make_detections, make_report) -> None:
        """Both units see robots 1 and 2, at equal distance or not: their responsibilities are disjoint."""
        rng = np.random.default_rng(4)
        for _ in range(50):
            views = []
            for unit in range(2):
                radii = {robot: float(np.round(rng.uniform(0, 0.9), 1)) for robot in (1, 2, 3)}
                views.append(replace(at_radius(make_detections, radii, size=(600, 600)), unit_id=unit))
            points = [view.centers_px[:, 0] + 1j * view.centers_px[:, 1] for view in views]
            reports = [make_report(j, [1, 2, 3], points[j], [1, 2, 3], size=(600, 600)) for j in range(2)]
            flights = [Follow(0.7), Follow(0.7)]
            for j, flight in enumerate(flights):
                flight.command(views[j], FlightTask(np.array([1, 2, 3])), [reports[1 - j]])
            charges = [set(flight._responsible_for.tolist()) for flight in flights]
            assert charges[0] | charges[1] == {1, 2, 3}
            assert not charges[0] & charges[1]


@pytest.mark.parametrize("name", ["follow", "perimeter"])
def test_flight_laws_without_detections_hover(make_detections, name) -> None:
    seen = make_detections([], [])
    command = FLIGHTS[name]().command(seen, FlightTask(seen.ids), [])
    assert not command.lateral_mps.any() and command.climb_mps == 0


class TestPerimeter:
    def test_flies_along_and_towards_hull(self, make_detections) -> None:
        """A square around the centre, its nearest edge at +u: along that edge, with a pull towards it."""
        half, centre = 400, 399.5 + 399.5j
        corners = np.array([0.3 - 0.5j, 0.3 + 0.5j, -0.7 + 0.5j, -0.7 - 0.5j])
        seen = make_detections([1, 2, 3, 4, 5], centre + half * np.append(corners, 0.01))
        command = Perimeter(0.7, speed_mps=0.2, lateral_gain_mps=2.0, climb_gain_mps=1.0).command(
            seen, FlightTask(seen.ids), []
        )
        assert command.lateral_mps[0] == pytest.approx(2.0 * 0.3, abs=1e-9)
        assert abs(command.lateral_mps[1]) == pytest.approx(0.2, abs=1e-9)
        assert command.climb_mps == pytest.approx(abs(0.7 + 0.5j) - 0.7, abs=1e-9)

    @pytest.mark.parametrize("half_edge", [0.2, 0.5, 1.5])
    def test_pull_leads_to_the_foot_on_an_edge_of_any_length(self, make_detections, half_edge) -> None:
        """The foot of the perpendicular from the centre divides the nearest edge in the ratio 3 to 1."""
        ends = np.array([0.05 - 0.5j * half_edge, 0.05 + 1.5j * half_edge])
        seen = make_detections(range(4), 399.5 + 399.5j + 400 * np.append(ends, ends - 2.0))
        command = Perimeter(0.7, speed_mps=0.0, lateral_gain_mps=2.0).command(seen, FlightTask(seen.ids), [])
        np.testing.assert_allclose(command.lateral_mps, [0.1, 0.0], atol=1e-9)

    def test_descends_to_small_hull(self, make_detections) -> None:
        """The farthest robot is 0.3 nearer than the desired radius."""
        points = 399.5 + 399.5j + 400 * np.array([0.4, -0.2 + 0.1j, -0.2 - 0.1j])
        seen = make_detections([1, 2, 3], points)
        command = Perimeter(0.7, climb_gain_mps=2.0).command(seen, FlightTask(seen.ids), [])
        assert command.climb_mps == pytest.approx(-0.6, abs=1e-9)

    def test_circles_hull_in_one_sense(self, make_detections) -> None:
        """In a simple world the unit circles the robots' hull: the angle about their centre is monotonic."""
        robots = np.array([2 + 0j, 1.5j, -2 + 0j, -1.5j])
        at, angles = complex(1.0, 0.4), []
        flight = Perimeter(0.9, speed_mps=0.5, lateral_gain_mps=2.0)
        for _ in range(600):
            seen = make_detections(range(4), 399.5 + 399.5j + 100 * (robots - at))
            at += 0.05 * complex(*flight.command(seen, FlightTask(seen.ids), []).lateral_mps)
            angles.append(np.angle(at))
        turned = np.unwrap(angles[20:])
        assert abs(turned[-1] - turned[0]) > 2 * np.pi, "more than a lap"
        assert (np.diff(turned) > 0).all() or (np.diff(turned) < 0).all()
