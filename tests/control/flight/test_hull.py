"""The convex hull that the perimeter law flies along, against SciPy's."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from skyherd.control.flight.laws import _hull


@pytest.mark.parametrize("raster", [0.0, 0.5], ids=["anywhere", "many in line, some in one place"])
def test_corners_are_those_of_scipys_hull_in_its_order(raster: float) -> None:
    rng = np.random.default_rng(2)
    for count in (*range(3, 17), 100):
        points = rng.normal(size=(count, 2))
        points = np.rint(points / raster) * raster if raster else points
        points[:3] += np.array([[0, 0], [3, 0], [0, 3]])  # no three on a line
        ours, theirs = _hull(points), points[ConvexHull(points).vertices]
        assert ours is not None
        start = int(np.lexsort(theirs.T[::-1])[0])
        np.testing.assert_array_equal(ours, np.roll(theirs, -start, axis=0))


@pytest.mark.parametrize("count", [0, 1, 2, 3, 7])
def test_points_on_a_line_have_none(count: int) -> None:
    rng = np.random.default_rng(3)
    assert _hull(np.array([[0.3, -2.0]]) + np.outer(rng.normal(size=count), [0.7, 0.1])) is None
    assert _hull(np.full((count, 2), 0.25)) is None
