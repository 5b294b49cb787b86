"""What a unit sends: goals for whom, neighbours to whom, and the view that one robot reads."""

import numpy as np
import pytest

from skyherd.control import Template, motion_goals
from skyherd.control.formation.similarity import fit_goals, fit_similarity
from skyherd.errors import DegenerateSetError, MessageError, SingularSetError

NO_ID = np.array([], dtype=np.int64)


def random_scene(seed: int, make_detections, count: int = 12):
    rng = np.random.default_rng(seed)
    ids = np.sort(rng.permutation(50)[:count])
    points = rng.uniform(50, 750, count) + 1j * rng.uniform(50, 750, count)
    order = rng.permutation(count)  # detections come in any order
    seen = make_detections(ids[order], points[order], headings=rng.uniform(-3, 3, count))
    template = Template(ids, rng.standard_normal(count) + 1j * rng.standard_normal(count))
    return seen, template, dict(zip(ids.tolist(), points, strict=True)), rng


@pytest.mark.smoke
@pytest.mark.parametrize("seed", range(10))
def test_neighbours_are_the_shared_robots_and_the_nearest(make_detections, seed) -> None:
    """Against a plain loop over all pairs; distances to rounding."""
    seen, template, place, rng = random_scene(seed, make_detections)
    controlled = rng.permutation(seen.ids)[:7]
    shared = controlled[:2]
    nearest = int(rng.integers(1, 5))
    goals = motion_goals(seen, controlled, template, shared_ids=shared, nearest=nearest)
    assert sorted(goals.ids.tolist()) == sorted(controlled.tolist())
    for robot in goals.ids.tolist():
        others = sorted((abs(place[other] - place[robot]), other) for other in place if other != robot)
        expected = {other: distance for distance, other in others[:nearest]}
        expected |= {int(i): abs(place[int(i)] - place[robot]) for i in shared if i != robot}
        goal = goals.for_robot(robot)
        assert dict(zip(goal.neighbor_ids.tolist(), goal.neighbor_distances_px.tolist(), strict=True)) == (
            pytest.approx(expected, rel=1e-12)
        )


def test_a_shared_robot_that_is_not_in_view_is_not_told_of(make_detections) -> None:
    seen, template, _, _ = random_scene(3, make_detections)
    unseen = int(np.setdiff1d(np.arange(50), seen.ids)[0])
    goals = motion_goals(seen, seen.ids, template, shared_ids=np.array([unseen]), nearest=1)
    assert not (goals.neighbor_ids == unseen).any()


def test_more_nearest_asked_than_there_are_robots(make_detections) -> None:
    seen = make_detections([4, 8, 9], [100 + 100j, 200 + 100j, 100 + 300j])
    template = Template(np.array([4, 8, 9]), np.array([0, 1, 1j]))
    goals = motion_goals(seen, seen.ids, template, shared_ids=NO_ID, nearest=10)
    assert {tuple(sorted(goals.for_robot(i).neighbor_ids.tolist())) for i in (4, 8, 9)} == {
        (8, 9),
        (4, 9),
        (4, 8),
    }


@pytest.mark.parametrize("seed", range(5))
def test_the_wire_view_equals_the_arrays(make_detections, seed) -> None:
    seen, template, _, _ = random_scene(seed, make_detections)
    goals = motion_goals(seen, seen.ids[:6], template, shared_ids=seen.ids[:1], nearest=3)
    for row, robot in enumerate(goals.ids.tolist()):
        wire = goals.for_robot(robot)
        assert (wire.robot_id, wire.unit_id, wire.time_s) == (robot, goals.unit_id, goals.time_s)
        assert wire.rho_px == goals.rho_px[row]
        assert wire.bearing_rad == goals.bearings_rad[row]
        assert wire.side_px == goals.sides_px[row]
        real = goals.neighbor_ids[row] >= 0
        np.testing.assert_array_equal(wire.neighbor_ids, goals.neighbor_ids[row, real])
        np.testing.assert_array_equal(wire.neighbor_distances_px, goals.neighbor_distances_px[row, real])
        assert (wire.neighbor_distances_px > 0).all()
    with pytest.raises(KeyError):
        goals.for_robot(99)


@pytest.mark.smoke
def test_controlled_robots_out_of_view_get_no_goal_and_shape_none(make_detections) -> None:
    """The goals of those in view are what they would be were the other not in the set."""
    seen, template, _, _ = random_scene(1, make_detections)
    gone = int(np.setdiff1d(np.arange(50), seen.ids)[0])
    wider = Template(np.append(template.ids, gone), np.append(template.points_px, 9 + 9j))
    goals = motion_goals(seen, np.append(seen.ids[:5], gone), wider, shared_ids=NO_ID, nearest=2)
    expected = motion_goals(seen, seen.ids[:5], template, shared_ids=NO_ID, nearest=2)
    np.testing.assert_array_equal(goals.ids, expected.ids)
    np.testing.assert_array_equal(goals.rho_px, expected.rho_px)


@pytest.mark.parametrize("controlled", [[], [4], [8, 9]], ids=["none", "one", "two on one template point"])
def test_a_set_without_a_shape_is_refused(make_detections, controlled) -> None:
    seen = make_detections([4, 8, 9], [100 + 100j, 200 + 100j, 100 + 300j])
    template = Template(np.array([4, 8, 9]), np.array([0, 1, 1]))
    with pytest.raises(DegenerateSetError):
        motion_goals(seen, np.array(controlled, dtype=int), template, shared_ids=NO_ID, nearest=2)


def test_goals_are_copies_and_read_only(make_detections) -> None:
    seen, template, _, _ = random_scene(2, make_detections)
    goals = motion_goals(seen, seen.ids, template, shared_ids=NO_ID, nearest=2)
    with pytest.raises(ValueError, match="read-only"):
        goals.rho_px[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        seen.centers_px[0] = 1.0


def test_detections_mark_repeated_ids_and_do_without_them(make_detections) -> None:
    seen = make_detections([4, 7, 4, 9], [1, 2, 3, 4])
    assert seen.repeated.tolist() == [True, False, True, False]
    assert seen.unambiguous().ids.tolist() == [7, 9]
    assert seen.unambiguous().centers_px[:, 0].tolist() == [2, 4]
    once = seen.unambiguous()
    assert once.unambiguous() is once


def test_messages_refuse_repeated_ids_and_nonsense(make_detections, make_goals) -> None:
    with pytest.raises(MessageError, match=r"repeated id in \[4, 4\]"):
        make_goals(0, [4, 4], [1j, 2j])
    with pytest.raises(MessageError, match="finite"):
        make_detections([4, 5], [1, np.nan])
    with pytest.raises(MessageError, match="positive"):
        make_detections([4, 5], [1, 2], sides=[3, 0])
    with pytest.raises(MessageError, match="sides_px must be positive"):
        make_goals(0, [1], [1j], sides=[-1])


TRIANGLE = np.exp(2j * np.pi * np.arange(3) / 3)


def test_a_team_that_stands_as_the_mirror_image_of_its_shape_is_led_out_of_it(make_detections) -> None:
    """Remark 2: no rotation of an equilateral triangle fits its mirror image. It would get no goal for ever.

    Points without limits follow `x' = k ρ`: V falls from first to last. The scale a grows by
    `a' = k (w e^{-kt} - a)` up to where the fit takes over, at `kt = 1`.
    """
    template = Template([0, 1, 2], TRIANGLE)
    places = 400 + 400j + 100 * TRIANGLE.conj()
    with pytest.raises(SingularSetError):
        fit_similarity(TRIANGLE, places)
    costs = []
    for _ in range(400):
        seen = make_detections([0, 1, 2], places)
        goals = motion_goals(seen, seen.ids, template, shared_ids=np.zeros(0, int), nearest=2)
        places = places + 0.05 * goals.rho_px * np.exp(-1j * goals.bearings_rad)
        centred = places - places.mean()
        along = np.vdot(TRIANGLE, centred) / 3
        costs.append(np.linalg.norm(centred - along * TRIANGLE))
    assert (np.diff(costs) < 0).all() and costs[-1] < 1e-6
    assert abs(along) == pytest.approx(100 * 0.01 / np.e, rel=0.05)


@pytest.mark.parametrize(("share", "as_it_is"), [(0.012, True), (0.008, False)])
def test_only_starts_that_hardly_resemble_the_shape_are_led(share, as_it_is) -> None:
    """`share` is the part of the spread that the best fit explains; the rotation is the fit's."""
    mirrored = np.sqrt(1 - share**2) * TRIANGLE.conj()
    places = 50 * (mirrored + share * np.exp(0.7j) * TRIANGLE)
    fitted, led = fit_similarity(TRIANGLE, places), fit_goals(TRIANGLE, places)
    assert (led == fitted) == as_it_is
    assert led.scale == pytest.approx(50 * max(share, 0.01))
    assert led.rotation_rad == pytest.approx(0.7)


def test_where_it_is_led_to_depends_neither_on_pixels_nor_on_the_templates_size() -> None:
    places = TRIANGLE.conj() + 0.001 * np.array([1, 1j, -1])
    led = fit_goals(TRIANGLE, places)
    larger = fit_goals(7 * TRIANGLE + 3, 20 * places - 5j)
    assert larger.factor == pytest.approx(20 / 7 * led.factor)
