"""Follow law: a unit keeps its own robots and two in common with each neighbour in view."""

import numpy as np
import pytest

from skyherd.control import FlightTask, Follow
from skyherd.geometry import to_points

CENTRE, HALF_PX = 399.5 + 399.5j, 400.0
PLACES = np.array([-0.5 + 0.1j, -0.4 - 0.2j, 0.1 + 0.3j, 0.2 - 0.1j, 0.45 + 0.2j, 0.6 + 0.0j])
"""Robots 0 to 5 in half images from the centre; of 2 to 5, robots 3 and 2 are the nearest to it."""


@pytest.fixture
def fly(make_detections, make_report):
    """Return the last command of a unit that controls all six, beside one that sees each nearer.

    The second unit controls other robots in each image.
    """

    def command(*theirs):
        seen = make_detections(range(6), CENTRE + HALF_PX * PLACES)
        reports = [make_report(1, range(6), CENTRE + HALF_PX * PLACES / 2, members) for members in theirs]
        law = Follow(desired_radius=0.3, dead_band=0.0)
        return [law.command(seen, FlightTask(np.arange(6)), [report]) for report in reports][-1]

    return command


@pytest.mark.parametrize(
    ("theirs", "kept"),
    [
        pytest.param([2, 3, 4, 5], [0, 1, 2, 3], id="of four in common, two"),
        pytest.param([2, 4, 5], [0, 1, 2, 3, 4], id="of three in common, two, though another is nearer"),
        pytest.param([4, 5], [0, 1, 2, 3, 4, 5], id="both of two in common"),
        pytest.param([5], [0, 1, 2, 3, 4], id="one in common makes no neighbour"),
    ],
)
def test_follow_keeps_own_and_two_nearest_common_robots(fly, theirs, kept) -> None:
    """The velocity leads to their centroid; the climb is proportional to the farthest one's excess."""
    command, mean = fly(theirs), PLACES[kept].mean()
    np.testing.assert_allclose(command.lateral_mps, [mean.real, mean.imag], atol=1e-12)
    assert command.climb_mps == pytest.approx(np.abs(PLACES[kept]).max() - 0.3, abs=1e-12)


def test_follow_keeps_robot_released_by_neighbor(fly) -> None:
    np.testing.assert_allclose(
        fly([2, 3, 4, 5], [2, 3]).lateral_mps, to_points(PLACES).mean(axis=0), atol=1e-12
    )
