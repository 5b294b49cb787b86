"""The unmodified built-in missions, with all of their images."""

import pytest
from mission_checks import (
    THRESHOLD,
    TREES,
    check_mission_from_pixels,
    check_noisy_mission,
    check_tree_mission,
)

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", THRESHOLD)
def test_long_mission_forms_shape_from_pixels(name):
    check_mission_from_pixels(name)


@pytest.mark.parametrize(("name", "seconds"), {"triangle": 70, "star": 40, "grid": 40, "circle": 30}.items())
def test_long_noisy_mission_forms_shape_with_all_robots(name, seconds):
    """The run lasts until the shape has been held for long enough."""
    check_noisy_mission(name, f"duration_s={seconds}")


@pytest.mark.parametrize("name", TREES)
def test_long_tree_mission_forms_shape_from_pixels(name):
    check_tree_mission(name, "rendered")


@pytest.mark.parametrize("name", TREES)
def test_long_noisy_mission_keeps_tree(name):
    """In `failure`, the unit returns at 65 s, and must be in the tree at the end."""
    check_tree_mission(name, "noisy")
