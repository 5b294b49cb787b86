"""Scorer of the benchmark on artificial detections with known results."""

from types import SimpleNamespace

import numpy as np
import pytest

from skyherd.bench.detectors.frames import LabelledFrame
from skyherd.bench.detectors.scorer import Scorer, match

SIDE_PX = 20.0


def frame(ids, centers, headings=None, whole=None, bound=(0.01, 0.01, 0.001)):
    """Return a frame of markers of 20 px whose bound has these standard deviations of u, v and heading."""
    count = len(ids)
    return LabelledFrame(
        image=np.zeros((4, 4), np.uint8),
        unit_id=0,
        time_s=0.0,
        ids=np.array(ids, dtype=np.int64),
        centers_px=np.array(centers, dtype=float).reshape(-1, 2),
        headings_rad=np.zeros(count) if headings is None else np.array(headings, dtype=float),
        sides_px=np.full(count, SIDE_PX),
        whole=np.ones(count, bool) if whole is None else np.array(whole, bool),
        bounds=np.repeat(np.diag(np.square(bound))[None], count, axis=0),
        blur_px=0.8,
    )


def answer(ids, centers, headings=None, deviation=None, qualities=None):
    """Return detections, optionally with a repeated id, which `Detections` itself would reject."""
    count = len(ids)
    covariance = np.zeros((3, 3)) if deviation is None else np.diag(np.square(deviation))
    return SimpleNamespace(
        ids=np.array(ids, dtype=np.int64),
        centers_px=np.array(centers, dtype=float).reshape(-1, 2),
        headings_rad=np.zeros(count) if headings is None else np.array(headings, dtype=float),
        covariances=np.repeat(covariance[None], count, axis=0),
        qualities=np.zeros(count, dtype=np.int64) if qualities is None else np.array(qualities),
    )


def score(*pairs):
    scorer = Scorer()
    for shown, told in pairs:
        scorer.add(shown, told)
    return scorer.score()


THREE = ([1, 5, 9], [(0, 0), (100, 0), (0, 100)])


def test_recall_counts_markers_over_all_frames():
    shown = frame(*THREE)
    result = score((shown, answer([1, 9], [(0, 0), (0, 100)])), (shown, answer([], [])))
    assert (result.images, result.markers, result.found) == (2, 6, 2)
    assert result.recall == pytest.approx(1 / 3)
    assert result.false_positives_per_image == 0


@pytest.mark.parametrize(
    ("ids", "centers", "found", "false"),
    [
        ([5], [(100, 0)], 1, 0),
        ([6], [(100, 0)], 0, 1),  # an id that is not there
        ([1], [(100, 0)], 0, 1),  # an id that is there, on another marker
        ([5], [(100 + 0.51 * SIDE_PX, 0)], 0, 1),  # more than half a side away
        ([5], [(100, 0.49 * SIDE_PX)], 1, 0),
        ([5, 5], [(103, 0), (100, 1)], 1, 1),  # twice: the nearer is right
        ([5, 5, 1], [(100, 0), (0, 100), (0, 0)], 2, 1),  # twice, once elsewhere
        ([50, -3], [(0, 0), (0, 0)], 0, 2),  # ids beyond either end of those shown
    ],
)
def test_match_separates_correct_and_false_detections(ids, centers, found, false):
    result = score((frame(*THREE), answer(ids, centers)))
    assert (result.found, result.false_positives_per_image) == (found, false)


def test_nearer_of_two_detections_is_scored():
    answers, rows = match(frame(*THREE), answer([5, 5], [(103, 0), (100, 1)]))
    np.testing.assert_array_equal(answers, [1])
    np.testing.assert_array_equal(rows, [1])


def test_partial_markers_are_ignored():
    shown = frame(*THREE, whole=[True, False, True])
    result = score((shown, answer([1, 5], [(0, 0), (105, 0)])))
    assert (result.markers, result.found, result.false_positives_per_image) == (2, 1, 0)
    assert result.rmse_px == 0


def test_ids_in_any_order_are_matched():
    shown = frame([9, 1, 5], [(0, 100), (0, 0), (100, 0)])
    assert score((shown, answer([5, 9, 1], [(100, 0), (0, 100), (0, 0)]))).found == 3


def test_bias_and_rmse_match_given_errors():
    """Errors (3, 4) and (-1, 0): bias |(1, 2)|, RMSE per axis sqrt((9 + 16 + 1) / 4)."""
    shown = frame([1, 2], [(0, 0), (50, 0)], headings=[0.0, 1.0])
    result = score((shown, answer([1, 2], [(3, 4), (49, 0)], headings=[0.02, 1.04])))
    assert result.bias_px == pytest.approx(5**0.5)
    assert result.rmse_px == pytest.approx((26 / 4) ** 0.5)
    assert result.bias_deg == pytest.approx(np.degrees(0.03))
    assert result.rmse_deg == pytest.approx(np.degrees((0.5 * (0.02**2 + 0.04**2)) ** 0.5))


def test_heading_errors_wrap():
    """Just below pi and just above -pi are neighbours; so are a full turn and none."""
    shown = frame([1, 2], [(0, 0), (50, 0)], headings=[np.pi - 0.01, 0.0])
    result = score((shown, answer([1, 2], [(0, 0), (50, 0)], headings=[-np.pi + 0.01, 2 * np.pi + 0.02])))
    assert result.rmse_deg == pytest.approx(np.degrees(0.02))


@pytest.mark.smoke
def test_ratio_uses_bound_of_same_markers():
    """The one of two markers with the wide bound is missed: only the other's counts."""
    wide, narrow = frame([1], [(0, 0)], bound=(9, 9, 9)), frame([1], [(0, 0)], bound=(0.1, 0.3, 0.01))
    result = score((wide, answer([], [])), (narrow, answer([1], [(0.2, 0.0)], headings=[0.03])))
    assert result.crb_px == pytest.approx(((0.01 + 0.09) / 2) ** 0.5)
    assert result.ratio_px == pytest.approx((0.04 / 2) ** 0.5 / 0.05**0.5)
    assert result.ratio_deg == pytest.approx(3.0)


def gaussian(count, deviation, claimed, seed):
    """Return the score of `count` detections with Gaussian errors, whose stated covariance is `claimed`."""
    rng = np.random.default_rng(seed)
    scorer = Scorer()
    for _ in range(count // 50):
        ids, centers = np.arange(50), rng.uniform(0, 1000, (50, 2)) + 100 * np.arange(50)[:, None]
        headings, error = rng.uniform(-3, 3, 50), rng.standard_normal((50, 3)) * deviation
        scorer.add(
            frame(ids, centers, headings, bound=deviation),
            answer(ids, centers + error[:, :2], headings + error[:, 2], claimed),
        )
    return scorer.score()


@pytest.mark.parametrize("too_sure", [1.0, 2.0, 0.5])
def test_nees_of_known_gaussian(too_sure):
    """A mean of N squares of unit normals has sigma sqrt(2 / N), 2.6 %; five times that is allowed."""
    deviation = np.array([0.02, 0.05, 0.003])
    count = 3000
    result = gaussian(count, deviation, deviation / too_sure, seed=4)
    allowed = 5 * (2 / count) ** 0.5
    for value in (result.nees_u, result.nees_v, result.nees_heading, result.nees):
        assert value == pytest.approx(too_sure**2, rel=allowed)


def test_errors_at_bound_have_ratio_one():
    """RMSE over bound of 2N and N normal values: sigma 1 / sqrt(4 N) and 1 / sqrt(2 N); 5 sigma."""
    count = 3000
    result = gaussian(count, np.array([0.02, 0.02, 0.003]), np.ones(3), seed=5)
    assert result.ratio_px == pytest.approx(1.0, abs=5 / (4 * count) ** 0.5)
    assert result.ratio_deg == pytest.approx(1.0, abs=5 / (2 * count) ** 0.5)
    assert result.bias_px < 5 * 0.02 * (2 / count) ** 0.5


def test_photometric_measurements_are_also_scored_alone():
    """One of two markers, measured by its edges, is ten times as far off."""
    shown = frame([1, 2], [(0, 0), (100, 0)], bound=(0.1, 0.1, 0.01))
    told = answer([1, 2], [(0.1, 0.0), (101.0, 0.0)], [0.02, 0.2], (0.1, 0.1, 0.01), [2, 0])
    result = score((shown, told))
    assert (result.found, result.photometric) == (2, 1)
    assert result.photometric_ratio_px == pytest.approx(0.5**0.5)
    assert result.ratio_px == pytest.approx((1.01 / 4) ** 0.5 / 0.1)
    assert result.photometric_ratio_deg == pytest.approx(2.0)
    assert result.photometric_nees == pytest.approx((1 + 0 + 4) / 3)
    none = score((shown, answer([1], [(0.0, 0.0)])))
    assert (none.photometric, none.photometric_ratio_px, none.photometric_nees) == (0, None, None)


def test_nees_is_none_if_a_covariance_is_missing():
    shown = frame(*THREE)
    none = answer(THREE[0], THREE[1])
    honest = answer(THREE[0], THREE[1], deviation=(0.1, 0.1, 0.1))
    assert score((shown, none)).nees is None
    assert score((shown, honest), (shown, none)).nees is None
    assert score((shown, honest)).nees == 0


def test_score_without_detections_keeps_bound():
    result = score((frame(*THREE), answer([], [])))
    assert (result.recall, result.rmse_px, result.bias_px, result.ratio_px) == (0, None, None, None)
    assert result.crb_px == pytest.approx(0.01)


def test_empty_images_have_no_recall_but_false_positives():
    empty = frame([], [])
    result = score((empty, answer([3, 4], [(1, 1), (9, 9)])), (empty, answer([], [])))
    assert result.recall is None and result.crb_px is None
    assert result.false_positives_per_image == 1.0
    assert Scorer().score().false_positives_per_image is None
