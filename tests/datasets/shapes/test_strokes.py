"""Robots along polylines."""

import numpy as np
import pytest

from skyherd.datasets import polyline_points
from skyherd.errors import InputError

L_SHAPE = np.array([[0.0, 2.0], [0.0, 0.0], [1.0, 0.0]])
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.02, -0.01]])


def gaps(points, order):
    return np.linalg.norm(np.diff(points[order], axis=0), axis=1)


def test_open_line_has_robots_at_its_ends_and_corners() -> None:
    points, order = polyline_points(L_SHAPE, 10)
    assert order == list(range(10))
    np.testing.assert_allclose(points[[0, 6, 9]], L_SHAPE)
    np.testing.assert_allclose(gaps(points, order), 1 / 3)


def test_click_near_the_first_corner_closes_the_line() -> None:
    points, order = polyline_points(SQUARE, 12)
    assert order == [*range(12), 0]
    np.testing.assert_allclose(points[[0, 3, 6, 9]], SQUARE[:4])
    np.testing.assert_allclose(gaps(points, order), 1 / 3)


def test_more_corners_than_robots_leave_equal_steps() -> None:
    angles = np.linspace(0.0, 2 * np.pi, 101)
    points, order = polyline_points(np.column_stack([np.cos(angles), np.sin(angles)]), 8)
    assert len(order) == 9
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, atol=2e-3)
    np.testing.assert_allclose(gaps(points, order), 2 * np.sin(np.pi / 8), rtol=2e-3)


@pytest.mark.parametrize("count", [2, 3, 7, 40])
def test_every_number_of_robots_is_distinct_and_on_the_line(count) -> None:
    points, _ = polyline_points(L_SHAPE, count)
    assert len(points) == count and np.unique(points, axis=0).shape[0] == count
    on_first, on_second = np.abs(points[:, 0]) < 1e-9, np.abs(points[:, 1]) < 1e-9
    assert (on_first | on_second).all()


@pytest.mark.parametrize(
    ("corners", "what"),
    [
        (np.zeros((0, 2)), "0 different ones"),
        (np.zeros((3, 2)), "1 different ones"),
        (np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.001]]), "too close"),
    ],
)
def test_line_without_room_is_rejected(corners, what) -> None:
    with pytest.raises(InputError, match=what):
        polyline_points(corners, 9)
