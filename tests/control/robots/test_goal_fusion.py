"""Equations 4-6: fusion of the goals of several units on one scale, and the content of a robot's inbox."""

import numpy as np
import pytest

from skyherd.control import GoalInboxes, Template, motion_goals
from skyherd.control.robots.goal_fusion import fuse_marker_sides, fuse_pixels, scale_ratios
from skyherd.errors import MessageError
from skyherd.messages import TIME_TOLERANCE_S

SIDE_M = 0.4


class Scene:
    """Robots on the ground, units with a scale (px/m) and yaw each, and consistent goals from all."""

    def __init__(
        self, seed: int, make_detections, sets=((0, 1, 2, 3, 4), (3, 4, 5, 6), (0, 6, 5, 7))
    ) -> None:
        rng = np.random.default_rng(seed)
        self.sets = [np.array(members) for members in sets]
        count = max(max(members) for members in sets) + 1
        self.ids = np.arange(count)
        self.positions = 5 * (rng.standard_normal(count) + 1j * rng.standard_normal(count))
        self.headings = rng.uniform(-np.pi, np.pi, count)
        self.template = rng.standard_normal(count) + 1j * rng.standard_normal(count)  # map sense
        self.scales = rng.uniform(10, 80, len(sets))
        self.yaws = rng.uniform(-np.pi, np.pi, len(sets))
        self.inboxes = GoalInboxes(self.ids, np.arange(len(sets)), 1.0)
        for unit, members in enumerate(self.sets):
            image = self.scales[unit] * np.conj(self.positions * np.exp(-1j * self.yaws[unit]))
            seen = make_detections(
                self.ids,
                image,
                headings=self.yaws[unit] - self.headings,
                sides=np.full(count, SIDE_M * self.scales[unit]),
            )
            shared = [i for i in members if any(i in other for other in self.sets if other is not members)]
            goals = motion_goals(
                seen,
                members,
                Template(self.ids, self.template.conj()),
                shared_ids=np.array(shared),
                nearest=2,
            )
            self.inboxes.receive(type(goals)(**{**vars(goals), "unit_id": unit}), 0.0)

    def metric_sum(self) -> np.ndarray:
        """Return Σ_j (x^{d,j} - x), in each robot's frame, from the ground alone."""
        total = np.zeros(self.ids.size, dtype=complex)
        for members in self.sets:
            t, x = self.template[members], self.positions[members]
            t = t - t.mean()
            total[members] += x.mean() + np.vdot(t, x) / np.vdot(t, t) * t - x
        return total * np.exp(-1j * self.headings)


@pytest.mark.smoke
@pytest.mark.parametrize("seed", range(20))
def test_fuse_pixels_equation_4_equals_equation_5(make_detections, seed) -> None:
    """rho^g = rbar Σ_j (x^{d,j} - x) on consistent data; vectors of 100 px, rounding 1e-12 px."""
    scene = Scene(seed, make_detections)
    held = np.array([np.isin(scene.ids, members) for members in scene.sets])
    mean_scale = (held * scene.scales[:, None]).sum(axis=0) / held.sum(axis=0)
    np.testing.assert_allclose(
        fuse_pixels(scene.inboxes, 0.0), mean_scale * scene.metric_sum(), rtol=0, atol=1e-9
    )


@pytest.mark.parametrize("seed", range(20))
def test_fuse_marker_sides_equals_metric_sum(make_detections, seed) -> None:
    scene = Scene(seed, make_detections)
    np.testing.assert_allclose(
        SIDE_M * fuse_marker_sides(scene.inboxes, 0.0), scene.metric_sum(), rtol=0, atol=1e-11
    )


@pytest.mark.parametrize("seed", range(5))
def test_scale_ratios_match_ground_truth(make_detections, seed) -> None:
    """r_kj = r_k / r_j for every robot with goals of both units, and r_kj r_jk = 1 to rounding."""
    scene = Scene(seed, make_detections)
    ratios = scale_ratios(scene.inboxes)
    for k, ours in enumerate(scene.sets):
        for j, theirs in enumerate(scene.sets):
            both = np.intersect1d(ours, theirs)
            np.testing.assert_allclose(ratios[k, j, both], scene.scales[k] / scene.scales[j], rtol=1e-12)
            np.testing.assert_allclose(ratios[k, j, both] * ratios[j, k, both], 1.0, rtol=1e-14)


def two_units(make_goals, near_0: dict, near_1: dict, sides=(20.0, 50.0)) -> GoalInboxes:
    """Return inboxes with goals of two units for robot 1 of four, with distances to its neighbours."""
    inboxes = GoalInboxes(np.arange(4), np.array([0, 1]), 1.0)
    inboxes.receive(make_goals(0, [1], [3 + 4j], sides=[sides[0]], neighbors=[near_0]), 0.0)
    inboxes.receive(make_goals(1, [1], [1 - 2j], sides=[sides[1]], neighbors=[near_1]), 0.0)
    return inboxes


def test_scale_ratios_use_only_common_neighbors(make_goals) -> None:
    """Both units send robot 0: 10 px and 30 px. A neighbour of only one unit has no effect."""
    inboxes = two_units(make_goals, {0: 10.0, 2: 777.0}, {0: 30.0, 3: 0.1})
    assert scale_ratios(inboxes)[1, 0, 1] == pytest.approx(3.0, rel=1e-14)


def test_scale_ratios_are_least_squares_over_neighbors(make_goals) -> None:
    """Inconsistent distances with errors in both: the ratio of root mean squares, and still r_kj r_jk = 1."""
    inboxes = two_units(make_goals, {0: 10.0, 2: 20.0, 3: 5.0}, {0: 21.0, 2: 39.0, 3: 11.0})
    expected = np.sqrt((21**2 + 39**2 + 11**2) / (10**2 + 20**2 + 5**2))
    ratios = scale_ratios(inboxes)
    assert ratios[1, 0, 1] == pytest.approx(expected, rel=1e-14)
    assert ratios[1, 0, 1] * ratios[0, 1, 1] == pytest.approx(1.0, rel=1e-15)


def test_scale_ratios_without_neighbors_use_marker_sides(make_goals) -> None:
    for near_0, near_1 in (({0: 10.0}, {2: 30.0}), ({}, {})):
        ratios = scale_ratios(two_units(make_goals, near_0, near_1))
        assert ratios[1, 0, 1] == pytest.approx(50.0 / 20.0, rel=1e-14)
        assert ratios[0, 1, 1] == pytest.approx(20.0 / 50.0, rel=1e-14)


def test_scale_ratios_accept_distances_below_one_pixel(make_goals) -> None:
    """Squares of distances below 1 px² are as valid as others."""
    ratios = scale_ratios(two_units(make_goals, {0: 0.5}, {0: 0.25}))
    assert (ratios[1, 0, 1], ratios[0, 1, 1]) == (0.5, 2.0)


def test_fuse_pixels_matches_hand_computation(make_goals) -> None:
    """r_10 = 3: rho^g = 1/2 [(1 + 3) rho^0 + (1/3 + 1) rho^1]."""
    fused = fuse_pixels(two_units(make_goals, {0: 10.0}, {0: 30.0}), 0.0)
    np.testing.assert_allclose(fused[1], 0.5 * (4 * (3 + 4j) + 4 / 3 * (1 - 2j)), rtol=1e-14)
    np.testing.assert_array_equal(fused[[0, 2, 3]], 0)


def test_inbox_keeps_newer_image_under_reordering(make_goals) -> None:
    inboxes = GoalInboxes(np.arange(3), np.array([0, 1]), 1.0)
    inboxes.receive(make_goals(0, [0, 1], [1, 2], time_s=0.5, neighbors=[{2: 4.0}, {2: 4.0}]), 0.6)
    inboxes.receive(make_goals(0, [1, 2], [20, 30], time_s=0.4, neighbors=[{0: 9.0}, {0: 9.0}]), 0.7)
    np.testing.assert_array_equal(inboxes.rho_px[0], [1, 2, 30])
    np.testing.assert_array_equal(inboxes.imaged_s[0], [0.5, 0.5, 0.4])
    np.testing.assert_array_equal(inboxes.received_s[0], [0.6, 0.6, 0.7])
    np.testing.assert_array_equal(inboxes.squares_px2[0], [[0, 0, 16], [0, 0, 16], [81, 0, 0]])
    inboxes.receive(make_goals(0, [1], [5j], time_s=0.6, neighbors=[{0: 3.0}]), 0.8)
    assert inboxes.rho_px[0, 1] == pytest.approx(5j)
    np.testing.assert_array_equal(inboxes.squares_px2[0, 1], [9, 0, 0])


@pytest.mark.parametrize(
    ("mask", "words"),
    [
        (np.ones(2, dtype=bool), r"shape \(2,\); shape \(3,\)"),
        (np.ones(4, dtype=bool), r"shape \(4,\); shape \(3,\)"),
        (np.ones((3, 1), dtype=bool), r"shape \(3, 1\); shape \(3,\)"),
        (np.ones((), dtype=bool), r"shape \(\); shape \(3,\)"),
        (np.array([0, 1, 2]), "; an array of booleans"),
        ([True, True, True], "; an array of booleans"),
    ],
)
def test_inbox_refuses_mask_of_another_shape(make_goals, mask, words) -> None:
    inboxes = GoalInboxes(np.array([3, 5, 8]), np.array([0]), 1.0)
    with pytest.raises(MessageError, match=words):
        inboxes.receive(make_goals(0, [8, 3, 5], [8j, 3j, 5j]), 0.0, mask)
    assert np.isneginf(inboxes.received_s).all()


def test_inbox_under_message_loss_updates_only_receivers(make_goals) -> None:
    inboxes = GoalInboxes(np.array([3, 5, 8]), np.array([0]), 1.0)
    inboxes.receive(make_goals(0, [8, 3, 5], [8j, 3j, 5j]), 0.0, np.array([True, False, True]))
    np.testing.assert_allclose(inboxes.rho_px[0], [0, 5j, 8j], atol=1e-14)
    np.testing.assert_array_equal(inboxes.fresh(0.0)[0], [False, True, True])


def test_goal_is_stale_after_lifetime(make_goals) -> None:
    """The lifetime starts at reception: a late message is still followed for the whole time."""
    inboxes = GoalInboxes(np.arange(2), np.array([0]), lifetime_s=0.5)
    inboxes.receive(make_goals(0, [0], [7 + 0j], time_s=0.0), 0.3)
    assert fuse_pixels(inboxes, 0.8)[0] == 7
    assert fuse_marker_sides(inboxes, 0.8)[0] == pytest.approx(7 / 20)
    assert fuse_pixels(inboxes, 0.81)[0] == 0
    assert fuse_marker_sides(inboxes, 0.81)[0] == 0


def test_goal_is_fresh_up_to_end_of_lifetime(make_goals) -> None:
    """The lifetime includes the tolerance of times, to the last bit."""
    inboxes = GoalInboxes(np.arange(1), np.array([0]), lifetime_s=0.5)
    last_s = 1.0 - 0.5 - TIME_TOLERANCE_S
    inboxes.receive(make_goals(0, [0], [7 + 0j], time_s=0.0), last_s)
    assert inboxes.fresh(1.0).all()
    assert not inboxes.fresh(np.nextafter(1.0, 2.0)).any()


def test_fusion_excludes_unit_with_stale_goals(make_goals) -> None:
    """After unit 0 falls silent the fusion is unit 1's alone: card(C_i) counts received units."""
    inboxes = GoalInboxes(np.arange(4), np.array([0, 1]), lifetime_s=0.5)
    inboxes.receive(make_goals(0, [1], [3 + 4j], neighbors=[{0: 10.0}]), 0.0)
    inboxes.receive(make_goals(1, [1], [1 - 2j], neighbors=[{0: 30.0}]), 0.4)
    assert fuse_pixels(inboxes, 0.7)[1] == pytest.approx(1 - 2j)
