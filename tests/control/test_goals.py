"""Messages of a unit: goals, distances to neighbours, and the part for one robot."""

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


class TestMotionGoals:
    @pytest.mark.smoke
    @pytest.mark.parametrize("seed", range(10))
    def test_send_shared_and_nearest_neighbors(self, make_detections, seed) -> None:
        """The reference is a plain loop over all pairs; distances agree to rounding."""
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
            assert dict(
                zip(goal.neighbor_ids.tolist(), goal.neighbor_distances_px.tolist(), strict=True)
            ) == (pytest.approx(expected, rel=1e-12))

    def test_omit_shared_robot_out_of_view(self, make_detections) -> None:
        seen, template, _, _ = random_scene(3, make_detections)
        unseen = int(np.setdiff1d(np.arange(50), seen.ids)[0])
        goals = motion_goals(seen, seen.ids, template, shared_ids=np.array([unseen]), nearest=1)
        assert not (goals.neighbor_ids == unseen).any()

    def test_accept_more_neighbors_than_robots(self, make_detections) -> None:
        seen = make_detections([4, 8, 9], [100 + 100j, 200 + 100j, 100 + 300j])
        template = Template(np.array([4, 8, 9]), np.array([0, 1, 1j]))
        goals = motion_goals(seen, seen.ids, template, shared_ids=NO_ID, nearest=10)
        assert {tuple(sorted(goals.for_robot(i).neighbor_ids.tolist())) for i in (4, 8, 9)} == {
            (8, 9),
            (4, 9),
            (4, 8),
        }

    @pytest.mark.parametrize("seed", range(5))
    def test_robot_goal_equals_rows_of_arrays(self, make_detections, seed) -> None:
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

    def test_robot_out_of_view_gets_no_goal_and_affects_none(self, make_detections) -> None:
        """The goals of the visible robots are those of the set without the other one."""
        seen, template, _, _ = random_scene(1, make_detections)
        gone = int(np.setdiff1d(np.arange(50), seen.ids)[0])
        wider = Template(np.append(template.ids, gone), np.append(template.points_px, 9 + 9j))
        goals = motion_goals(seen, np.append(seen.ids[:5], gone), wider, shared_ids=NO_ID, nearest=2)
        expected = motion_goals(seen, seen.ids[:5], template, shared_ids=NO_ID, nearest=2)
        np.testing.assert_array_equal(goals.ids, expected.ids)
        np.testing.assert_array_equal(goals.rho_px, expected.rho_px)

    @pytest.mark.parametrize(
        "controlled", [[], [4], [8, 9]], ids=["none", "one", "two on one template point"]
    )
    def test_reject_degenerate_set(self, make_detections, controlled) -> None:
        seen = make_detections([4, 8, 9], [100 + 100j, 200 + 100j, 100 + 300j])
        template = Template(np.array([4, 8, 9]), np.array([0, 1, 1]))
        with pytest.raises(DegenerateSetError):
            motion_goals(seen, np.array(controlled, dtype=int), template, shared_ids=NO_ID, nearest=2)

    def test_are_read_only_copies(self, make_detections) -> None:
        seen, template, _, _ = random_scene(2, make_detections)
        goals = motion_goals(seen, seen.ids, template, shared_ids=NO_ID, nearest=2)
        with pytest.raises(ValueError, match="read-only"):
            goals.rho_px[0] = 1.0
        with pytest.raises(ValueError, match="read-only"):
            seen.centers_px[0] = 1.0


def test_detections_mark_and_remove_repeated_ids(make_detections) -> None:
    seen = make_detections([4, 7, 4, 9], [1, 2, 3, 4])
    assert seen.repeated.tolist() == [True, False, True, False]
    assert seen.unambiguous().ids.tolist() == [7, 9]
    assert seen.unambiguous().centers_px[:, 0].tolist() == [2, 4]
    once = seen.unambiguous()
    assert once.unambiguous() is once


def test_messages_reject_repeated_ids_and_invalid_values(make_detections, make_goals) -> None:
    with pytest.raises(MessageError, match=r"repeated id in \[4, 4\]"):
        make_goals(0, [4, 4], [1j, 2j])
    with pytest.raises(MessageError, match="finite"):
        make_detections([4, 5], [1, np.nan])
    with pytest.raises(MessageError, match="positive"):
        make_detections([4, 5], [1, 2], sides=[3, 0])
    with pytest.raises(MessageError, match=r"sides_px: .*; positive sides"):
        make_goals(0, [1], [1j], sides=[-1])


TRIANGLE = np.exp(2j * np.pi * np.arange(3) / 3)


class TestSingularArrangement:
    def test_mirrored_team_leaves_singular_arrangement(self, make_detections) -> None:
        """Remark 2: no rotation of an equilateral triangle fits its mirror image, and it would have no goal.

        Points without limits follow `x' = k ρ`: V falls from first to last. The scale a grows by `a' = k (w
        e^{-kt} - a)` until the fit takes over, at `kt = 1`.
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
    def test_minimum_scale_applies_only_to_poor_fits(self, share, as_it_is) -> None:
        """`share` is the part of the spread that the best fit explains; the rotation is the fit's."""
        mirrored = np.sqrt(1 - share**2) * TRIANGLE.conj()
        places = 50 * (mirrored + share * np.exp(0.7j) * TRIANGLE)
        fitted, led = fit_similarity(TRIANGLE, places), fit_goals(TRIANGLE, places)
        assert (led == fitted) == as_it_is
        assert led.scale == pytest.approx(50 * max(share, 0.01))
        assert led.rotation_rad == pytest.approx(0.7)

    def test_minimum_scale_is_invariant_to_image_and_template(self) -> None:
        places = TRIANGLE.conj() + 0.001 * np.array([1, 1j, -1])
        led = fit_goals(TRIANGLE, places)
        larger = fit_goals(7 * TRIANGLE + 3, 20 * places - 5j)
        assert larger.factor == pytest.approx(20 / 7 * led.factor)
