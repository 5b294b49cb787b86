"""Flight of the tree protocol: controlled robots stay in view, whether seen or remembered."""

from dataclasses import replace

import numpy as np
import pytest

from skyherd.control import FlightTask, KeepInView, Template

CENTRE = 399.5 + 399.5j
HALF_PX = 400.0
TEMPLATE = Template(np.arange(8), np.exp(2j * np.pi * np.arange(8) / 8))
NO_ID: list[int] = []


def view_of(make_detections, points, ids=None, **extra):
    """Return detections of robots at points `x + iy` in half images from the centre."""
    points = np.asarray(points, dtype=complex)
    ids = np.arange(points.size) if ids is None else ids
    return make_detections(ids, CENTRE + HALF_PX * points, **extra)


@pytest.mark.parametrize(
    ("farthest", "climb"), [(0.9, 0.15 - 0.02), (0.5, -0.25 + 0.02), (0.76, 0.0), (0.74, 0.0)]
)
def test_height_and_zoom_regulate_farthest_robot(make_detections, farthest, climb) -> None:
    """The climb is proportional to the excess over 0.75 and a dead band of 0.02; the zoom is opposite."""
    seen = view_of(make_detections, [farthest, -0.1, 0.2j])
    command = KeepInView(TEMPLATE, desired_radius=0.75, climb_gain_mps=2.0, zoom_gain_ps=0.3).command(
        seen, FlightTask(seen.ids), []
    )
    assert command.climb_mps == pytest.approx(2 * climb, abs=1e-12)
    assert command.zoom_rate_ps == pytest.approx(-0.3 * climb, abs=1e-12)


@pytest.mark.smoke
def test_lateral_velocity_leads_to_middle_of_control_set(make_detections) -> None:
    """The bounding box is that of robots 0-2; robot 3 is another unit's."""
    seen = view_of(make_detections, [0.1 + 0.2j, 0.5 + 0.6j, 0.3 + 0.3j, -0.9 - 0.9j])
    command = KeepInView(TEMPLATE, desired_radius=0.75, lateral_gain_mps=0.5).command(
        seen, FlightTask(np.array([0, 1, 2])), []
    )
    np.testing.assert_allclose(command.lateral_mps, 0.5 * np.array([0.3, 0.4]), atol=1e-12)


def test_controlled_robot_outside_frame_attracts_unit(make_detections, make_report) -> None:
    """Only another unit, with the same camera half an image away, sees robot 3."""
    ground = np.array([0.1, 0.4j, -0.2, 1.6])
    seen = view_of(make_detections, ground[:3])
    report = make_report(1, range(4), CENTRE + HALF_PX * (ground - 1.0), NO_ID)
    flight = KeepInView(TEMPLATE, desired_radius=0.75, dead_band=0.0, separation_sides=0.0, min_side_px=0.0)
    command = flight.command(seen, FlightTask(np.arange(4)), [report])
    np.testing.assert_allclose(command.lateral_mps, [(1.6 - 0.2) / 2, 0.2], atol=1e-9)
    assert command.climb_mps == pytest.approx(1.6 - 0.75, abs=1e-9)


def test_sought_robot_attracts_only_while_own_robots_in_view(make_detections) -> None:
    """Robot 3, at 0.9, is sought. With an own robot at 0.8, beyond the radius, it causes climb only."""
    for own, middle in ((0.5, (0.9 - 0.3) / 2), (0.8, (0.8 - 0.3) / 2)):
        seen = view_of(make_detections, [own, -0.3, 0.1, 0.9])
        command = KeepInView(TEMPLATE, desired_radius=0.75, dead_band=0.0).command(
            seen, FlightTask(np.arange(3), np.array([3])), []
        )
        np.testing.assert_allclose(command.lateral_mps, [middle, 0.0], atol=1e-12)
        assert command.climb_mps == pytest.approx(0.9 - 0.75, abs=1e-12)


@pytest.mark.parametrize(("side_px", "climb"), [(48.0, 0.25), (12.6, 0.05), (12.0, 0.0), (9.0, -0.25)])
def test_climb_is_limited_by_minimum_marker_side(make_detections, side_px, climb) -> None:
    """A robot is 0.25 too far out and the minimum side is 12 px: the climb uses the margin that is left."""
    seen = view_of(make_detections, [1.0, 0.1, -0.2j], sides=[side_px] * 3)
    flight = KeepInView(TEMPLATE, desired_radius=0.75, dead_band=0.0, zoom_gain_ps=0.3)
    command = flight.command(seen, FlightTask(seen.ids), [])
    assert command.climb_mps == pytest.approx(climb, abs=1e-12)
    assert command.zoom_rate_ps == pytest.approx(-0.3 * climb, abs=1e-12)
    search = flight.command(seen, FlightTask(seen.ids, seen.ids, widen=True), [])
    assert search.climb_mps <= max(0.0, side_px / 12 - 1) + 1e-12
    blind = view_of(make_detections, [])
    assert (
        np.sign(KeepInView(TEMPLATE, desired_radius=0.75).command(blind, FlightTask(blind.ids), []).climb_mps)
        == 1
    ), "it has seen nothing yet"
    assert np.sign(flight.command(blind, FlightTask(blind.ids), []).climb_mps) == np.sign(
        round(side_px / 12 - 1, 9)
    )


@pytest.mark.parametrize(
    ("border_sides", "climb"), [(0.0, -0.1), (2.0, -0.1), (3.0, -0.05), (4.0, 0.05), (5.0, 0.15)]
)
def test_border_margin_makes_unit_climb(make_detections, border_sides, climb) -> None:
    """The farthest robot is 0.35 from the border, and a side is 0.1: 0.35 - 0.1 b is left of a margin b."""
    seen = view_of(make_detections, [0.65, 0.1, -0.2j], sides=[40.0] * 3)
    flight = KeepInView(TEMPLATE, desired_radius=0.75, dead_band=0.0, border_sides=border_sides)
    command = flight.command(seen, FlightTask(seen.ids), [])
    assert command.climb_mps == pytest.approx(climb, abs=1e-12)


def test_controlled_robot_without_position_makes_unit_climb(make_detections) -> None:
    """Robot 5 was never seen; the visible robots are well inside."""
    seen = view_of(make_detections, [0.1, 0.1j, -0.1])
    flight = KeepInView(TEMPLATE, desired_radius=0.75)
    assert flight.command(seen, FlightTask(np.arange(3)), []).climb_mps < 0
    assert flight.command(seen, FlightTask(np.array([0, 1, 2, 5])), []).climb_mps > 0


@pytest.mark.parametrize("seed", range(5))
def test_flight_brings_control_set_into_view_with_margin(make_detections, seed) -> None:
    """Height and position follow the command, robots are static, some out of view at first.

    The farthest ends at 0.75. The loop is linear: after 60 s at gains near one the error is exp(-30) plus the
    dead band, 0.02.
    """
    rng = np.random.default_rng(seed)
    ground = rng.uniform(-4, 4, 8) + 1j * rng.uniform(-4, 4, 8)
    at, height = complex(ground.mean()) + complex(*rng.uniform(-1, 1, 2)), 3.0
    flight = KeepInView(TEMPLATE, desired_radius=0.75, separation_sides=0.0, min_side_px=0.0)
    for tick in range(600):
        points = (ground - at) / height
        inside = np.maximum(np.abs(points.real), np.abs(points.imag)) < 1
        sides = np.full(np.count_nonzero(inside), 60 / height)
        seen = view_of(make_detections, points[inside], TEMPLATE.ids[inside], sides=sides, time_s=0.1 * tick)
        command = flight.command(seen, FlightTask(TEMPLATE.ids), [])
        at += 0.1 * complex(*command.lateral_mps) * height / 3
        height += 0.1 * command.climb_mps * height / 3
    farthest = np.abs((ground - at) / height).max()
    assert inside.all()
    assert farthest == pytest.approx(0.75, abs=0.021)


@pytest.mark.parametrize("factor", [2.0, 0.37])
def test_keep_in_view_command_is_independent_of_pixel_size(make_detections, make_report, factor) -> None:
    """Points, marker sides and other units' reports through another sensor: equal to rounding, 1e-12.

    `min_side_px` is the exception, as it is in pixels.
    """
    points = np.array([0.1 + 0.2j, 0.5 - 0.6j, -0.3, 0.8j])
    seen = view_of(make_detections, points, sides=[30.0, 20.0, 25.0, 28.0])
    report = make_report(1, range(4), CENTRE + HALF_PX * (points + 0.1), NO_ID)
    size = np.rint(800 * factor).astype(int)
    scale = size / 800

    def moved(points_px):
        return (points_px - 399.5) * scale + (size - 1) / 2

    other = replace(
        seen,
        image_size_px=np.array([size, size]),
        centers_px=moved(seen.centers_px),
        sides_px=seen.sides_px * scale,
        corners_px=moved(seen.corners_px),
    )
    flights = [KeepInView(TEMPLATE, desired_radius=0.75, min_side_px=0.0) for _ in range(2)]
    views = zip(flights, (seen, other), strict=True)
    commands = [flight.command(view, FlightTask(np.arange(3)), [report]) for flight, view in views]
    assert np.abs(commands[0].lateral_mps).max() > 0.01
    np.testing.assert_allclose(commands[1].lateral_mps, commands[0].lateral_mps, rtol=0, atol=1e-12)
    assert commands[1].climb_mps == pytest.approx(commands[0].climb_mps, abs=1e-12)
    assert commands[1].zoom_rate_ps == pytest.approx(commands[0].zoom_rate_ps, abs=1e-12)


@pytest.mark.parametrize(("apart", "parts"), [(0.1, True), (0.29, True), (0.31, False)])
def test_units_too_close_separate(make_detections, make_report, apart, parts) -> None:
    """Six marker sides of 20 px are 0.3 half images: below that, the velocity grows with proximity."""
    points = np.array([0.2 + 0.2j, -0.2 - 0.2j, 0.2 - 0.2j, -0.2 + 0.2j])
    seen = view_of(make_detections, points)
    report = make_report(1, range(4), CENTRE + HALF_PX * (points - apart), NO_ID)
    command = KeepInView(TEMPLATE, desired_radius=0.75).command(seen, FlightTask(np.arange(4)), [report])
    expected = -(1 - apart / 0.3) if parts else 0.0
    np.testing.assert_allclose(command.lateral_mps, [expected, 0.0], atol=1e-9)


@pytest.mark.parametrize(("unit", "stays"), [(0, False), (2, True)])
def test_only_first_of_units_with_same_set_flies(make_detections, make_report, unit, stays) -> None:
    points = np.array([0.9, 0.6, 0.7j])
    seen = view_of(make_detections, points, unit_id=unit)
    report = make_report(1, range(3), CENTRE + HALF_PX * (points + 0.8), [0, 1, 2])
    command = KeepInView(TEMPLATE, desired_radius=0.75).command(seen, FlightTask(np.arange(3)), [report])
    assert (command.climb_mps == 0 and not command.lateral_mps.any()) == stays
    two_of_them = KeepInView(TEMPLATE, desired_radius=0.75).command(
        seen, FlightTask(np.array([0, 1])), [report]
    )
    assert two_of_them.climb_mps > 0, "another set"


def test_units_without_robots_do_not_share_a_set(make_detections, make_report) -> None:
    """The unit keeps all visible robots in view and climbs."""
    seen = view_of(make_detections, [0.3, 0.1j, 0.2], unit_id=1)
    report = make_report(0, NO_ID, NO_ID, NO_ID)
    command = KeepInView(TEMPLATE, desired_radius=0.75).command(
        seen, FlightTask(np.array([], dtype=np.int64)), [report]
    )
    assert command.climb_mps > 0
    np.testing.assert_allclose(command.lateral_mps, [0.15, 0.05], atol=1e-12)


def test_unit_without_detections_climbs(make_detections) -> None:
    seen = make_detections([], [])
    command = KeepInView(TEMPLATE, desired_radius=0.75).command(
        seen, FlightTask(np.array([], dtype=np.int64)), []
    )
    assert command.climb_mps == 0.5 and not command.lateral_mps.any()
    assert command.yaw_rate_radps == 0


def test_unit_that_searches_climbs_by_half_radius(make_detections) -> None:
    """The set is within its radius, so that only the search makes the unit climb; it never turns."""
    seen = view_of(make_detections, [0.75, 0.1, -0.2j], sides=[40.0] * 3)
    flight = KeepInView(TEMPLATE, desired_radius=0.75, climb_gain_mps=2.0, zoom_gain_ps=0.3)
    command = flight.command(seen, FlightTask(seen.ids, widen=True), [])
    assert command.climb_mps == pytest.approx(2.0 * 0.75 / 2)
    assert command.zoom_rate_ps == pytest.approx(-0.3 * 0.75 / 2)
    assert command.yaw_rate_radps == 0


def test_unit_with_room_to_climb_does_not_patrol(make_detections) -> None:
    """The set exceeds the radius by more than the unit may climb, but it may still climb by 20 %.

    At the ceiling, the negative control, it flies to the robot seen longest ago.
    """
    for side_px, patrols in ((14.4, False), (12.0, True)):
        flight = KeepInView(TEMPLATE, desired_radius=0.5, separation_sides=0.0)
        seen = view_of(make_detections, [0.95, -0.9, 0.9j], sides=[side_px] * 3)
        command = flight.command(seen, FlightTask(seen.ids), [])
        middle = [(0.95 - 0.9) / 2, 0.45]
        assert np.allclose(command.lateral_mps, middle, atol=1e-9) != patrols


def test_patrol_observes_each_robot_for_stated_time(make_detections) -> None:
    """An image every 0.5 s shows the robot that is observed, and three others of another unit.

    The unit goes on to the next robot once it has seen one for 2 s, four intervals.
    """
    flight = KeepInView(TEMPLATE, desired_radius=0.3, separation_sides=0.0, patrol_s=2.0)
    points = np.array([0.9, -0.9, 0.9j, 0.1, 0.1j, -0.1])
    targets = []
    for tick in range(20):
        ids = [targets[-1], 3, 4, 5] if targets else [0, 1, 2, 3, 4, 5]
        seen = view_of(make_detections, points[ids], ids, time_s=0.5 * tick, sides=[12.0] * len(ids))
        lateral = complex(*flight.command(seen, FlightTask(np.arange(3)), []).lateral_mps)
        targets.append(int(np.argmin(np.abs(points[:3] - lateral))))
    assert np.flatnonzero(np.diff(targets)).tolist() == [3, 7, 11, 15]
    assert len(set(targets)) == 3


def fly_below_a_ceiling(make_detections, seconds, *, is_known=True, **settings):
    """Return the robots visible in each image for a unit at its ceiling, over a line of robots of four views.

    Robots are static. A robot is visible within half an image of the unit's position. The unit knows its
    ceiling as the minimum side of markers, or must learn it.
    """
    ground = np.array([-2.4, -2.0, -1.2, -0.6, 0.0, 0.3, 1.1, 1.9])
    flight = KeepInView(TEMPLATE, separation_sides=0.0, **settings)
    place, views = 0.0, []
    for tick in range(int(5 * seconds)):
        away = ground - place
        ids = np.flatnonzero(np.abs(away) < 1.0)
        seen = view_of(
            make_detections,
            away[ids],
            ids,
            time_s=0.2 * tick,
            sides=np.full(ids.size, 12.0 if is_known else 40.0),
        )
        command = flight.command(seen, FlightTask(np.arange(8)), [])
        place += 0.2 * float(command.lateral_mps[0])
        if tick == 0:
            flight.memory.points_px[:] = CENTRE + HALF_PX * away
            flight.memory.known[:] = True
        views.append(ids)
    return views


def test_unit_at_ceiling_patrols_all_robots(make_detections) -> None:
    """Each of eight robots comes into view repeatedly, for as long as an adoption takes."""
    views = fly_below_a_ceiling(make_detections, 120.0)
    for robot in range(8):
        seen = np.array([robot in ids for ids in views])
        edges = np.flatnonzero(np.diff(seen.astype(int)) == 1)
        assert edges.size >= 2 or seen[-1], robot
        assert seen.sum() * 0.2 >= 4.0
    assert min(ids.size for ids in views) >= 2, "its position is always determined"


def test_unit_at_ceiling_without_patrol_misses_robots(make_detections) -> None:
    """Negative control: with an infinite patrol time robots at the ends are never seen."""
    views = fly_below_a_ceiling(make_detections, 120.0, patrol_s=1e9)
    assert len({robot for ids in views[100:] for robot in ids.tolist()}) < 8


class TestLearnedCeiling:
    """Robots lie in a ring that exceeds the view. The unit's height follows its command up to a ceiling."""

    def fly(self, make_detections, seconds, *, ceiling=np.inf, noise=0.0, start=4.0, later=None, **settings):
        """Return the flight law, and (time, height, climb, side at the ceiling) of each image."""
        rng = np.random.default_rng(4)
        ground = 20.0 * np.exp(2j * np.pi * np.arange(8) / 8)
        ground[:3] /= 10
        flight = KeepInView(TEMPLATE, separation_sides=0.0, min_side_px=0.0, **settings)
        place, height, rows = 0j, start, []
        for tick in range(int(5 * seconds)):
            if later is not None and tick >= 5 * later[0]:
                ceiling = later[1]
            points = (ground - place) / height
            ids = np.flatnonzero(np.maximum(np.abs(points.real), np.abs(points.imag)) < 1)
            sides = 400 / height * (1 + noise * rng.normal(size=ids.size))
            seen = view_of(make_detections, points[ids], ids, time_s=0.2 * tick, sides=sides)
            command = flight.command(seen, FlightTask(TEMPLATE.ids), [])
            rows.append((0.2 * tick, height, command.climb_mps, flight.ceiling.side_px))
            place += (
                0.2 * complex(*command.lateral_mps) * min(1.0, 2 / max(np.hypot(*command.lateral_mps), 1e-9))
            )
            height = min(max(height + 0.2 * float(np.clip(command.climb_mps, -1, 1)), 1.0), ceiling)
        return flight, np.array(rows)

    @pytest.mark.parametrize("noise", [0.0, 0.003])
    def test_vain_climb_shows_ceiling_in_some_seconds(self, make_detections, noise) -> None:
        _, rows = self.fly(make_detections, 20.0, ceiling=6.0, noise=noise)
        reached_s = rows[rows[:, 1] == 6.0][0, 0]
        known = rows[rows[:, 3] > 0]
        assert reached_s + 2.0 <= known[0, 0] <= reached_s + 6.0
        np.testing.assert_allclose(known[:, 3], 400 / 6.0, rtol=0.01)
        assert np.abs(known[10:, 2]).max() < 0.1, "it asks for no more than noise"

    def test_known_robots_beyond_the_view_are_visited(self, make_detections) -> None:
        """Below an unknown ceiling. Negative control: a unit that cannot learn stays where it is."""
        for vain_m, visited in ((1.0, True), (1e9, False)):
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr("skyherd.control.flight.keep_in_view.VAIN_CLIMB_M", vain_m)
                views = fly_below_a_ceiling(make_detections, 120.0, is_known=False)
            assert ({robot for ids in views for robot in ids.tolist()} == set(range(8))) == visited

    @pytest.mark.parametrize("height", [3.0, 30.0])
    def test_no_ceiling_while_climbs_change_the_scale(self, make_detections, height) -> None:
        _, rows = self.fly(make_detections, 30.0, start=height, noise=0.003)
        assert (rows[:, 3] == 0).all()

    def test_higher_ceiling_is_found_later(self, make_detections) -> None:
        _, rows = self.fly(make_detections, 120.0, ceiling=6.0, later=(20.0, 9.0))
        assert rows[5 * 20 - 1, 1] == 6.0
        assert rows[-1, 1] == 9.0

    def test_ceiling_follows_smallest_side_seen(self, make_detections) -> None:
        """A unit that is higher than its known ceiling does not sink to it."""
        flight, _ = self.fly(make_detections, 20.0, ceiling=6.0)
        points = 0.9 * np.exp(2j * np.pi * np.arange(8) / 8)
        seen = view_of(make_detections, points, time_s=20.0, sides=np.full(8, 400 / 6.5))
        assert flight.command(seen, FlightTask(TEMPLATE.ids), []).climb_mps == 0.0
        assert flight.ceiling.side_px == pytest.approx(400 / 6.5)

    def test_pauses_without_commands_teach_no_ceiling(self, make_detections) -> None:
        """The unit climbs for 0.4 s and then holds its position for 3 s, in which the law is not called."""
        flight, height = KeepInView(TEMPLATE, min_side_px=0.0), 5.0
        for second in range(20):
            for tick in range(3):
                points = 0.9 * np.exp(2j * np.pi * np.arange(8) / 8)
                time_s, sides = 3.4 * second + 0.2 * tick, np.full(8, 400 / height)
                seen = view_of(make_detections, points, time_s=time_s, sides=sides)
                command = flight.command(seen, FlightTask(TEMPLATE.ids, TEMPLATE.ids, widen=True), [])
                height += 0.2 * command.climb_mps * (tick < 2)
            assert flight.ceiling.side_px == 0
        assert height > 6.0

    @pytest.mark.parametrize("pause_s", [0.5, 0.9])
    def test_short_pauses_teach_no_ceiling(self, make_detections, pause_s) -> None:
        """Of a pause counts as much as 1.5 image periods, here 0.15 s, since the unit may have held.

        The unit climbs for one period of 0.1 s in each pause: less than 1 m in all, in more than 2 s.
        """
        flight = KeepInView(TEMPLATE, min_side_px=0.0)
        points, time_s = 0.95 * np.exp(2j * np.pi * np.arange(8) / 8), 0.0
        for tick in range(16):
            time_s += 0.1 if tick % 2 else pause_s
            seen = view_of(make_detections, points, time_s=time_s, sides=np.full(8, 80.0))
            flight.command(seen, FlightTask(TEMPLATE.ids, TEMPLATE.ids, widen=True), [])
            assert flight.ceiling.side_px == 0

    def test_descent_begins_the_test_again(self, make_detections) -> None:
        """Climbs of 1.4 s with a short descent between them teach nothing; without descents they do."""
        for descent_mps, learns in ((-0.1, False), (0.0, False), (1.0, True)):
            flight = KeepInView(TEMPLATE, min_side_px=0.0)
            seen = [view_of(make_detections, [0.1, -0.1], time_s=0.2 * tick) for tick in range(32)]
            for tick, one in enumerate(seen):
                flight.ceiling.look(one, 20.0)
                flight.ceiling.command(descent_mps if tick % 8 == 7 else 1.0)
            assert (flight.ceiling.side_px > 0) == learns

    def test_hovering_teaches_no_ceiling(self, make_detections) -> None:
        """Without a commanded climb an unchanged scale shows nothing."""
        flight = KeepInView(TEMPLATE, min_side_px=0.0)
        points = 0.7 * np.exp(2j * np.pi * np.arange(8) / 8)
        for tick in range(200):
            seen = view_of(make_detections, points, time_s=0.2 * tick)
            assert flight.command(seen, FlightTask(TEMPLATE.ids), []).climb_mps == pytest.approx(
                0.0, abs=1e-12
            )
        assert flight.ceiling.side_px == 0
