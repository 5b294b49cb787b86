"""Knowledge of a unit, placed on the ground beside the truth."""

import numpy as np
import pytest
from play_pages import moved, wait_until

from skyherd.analysis.goal_points import desired_on_ground
from skyherd.datasets import load_mission
from skyherd.geometry import to_complex
from skyherd.loop import run_steps
from skyherd.play.belief import belief_of


def beliefs(*settings, name="triangle", until_s=3.0, unit=0):
    """Return mission, and step and belief of each image of a unit."""
    mission = load_mission(name, ["perception=ideal", f"duration_s={until_s}", *settings])
    steps = [step for step in run_steps(mission) if unit in step.frames]
    return mission, [(step, belief_of(step.frames[unit], step, mission)) for step in steps]


def test_knowledge_of_a_level_camera_is_the_truth() -> None:
    mission, found = beliefs()
    for step, belief in found:
        np.testing.assert_allclose(belief.seen_m, step.positions_m, atol=1e-9)
        template = mission.shape_at(step.time_s, step.roles).points_of(mission.ids).conj()
        goals = desired_on_ground(template, to_complex(step.positions_m))
        np.testing.assert_allclose(to_complex(belief.goals_m), goals, atol=1e-9)
        np.testing.assert_allclose(belief.starts_m, step.positions_m, atol=1e-9)


def test_knowledge_of_a_tilted_camera_is_off_unless_it_rectifies() -> None:
    """The picture cannot be made equal to the truth: the largest error is a part of the formation's size."""
    errors = []
    for settings in (("control.rectify=false",), ("control.rectify=true",)):
        _, found = beliefs("units.*.tilt_deg=[12.0,0.0]", *settings, until_s=8.0)
        step, belief = found[-1]
        size_m = np.ptp(step.positions_m, axis=0).max()
        errors.append(np.linalg.norm(belief.seen_m - step.positions_m, axis=1).max() / size_m)
    assert errors[0] > 0.01 and errors[1] < 1e-4


def test_outline_joins_the_goals() -> None:
    mission, found = beliefs(name="star", until_s=1.0)
    _, belief = found[-1]
    corners = np.concatenate(belief.outline_m)
    nearest = np.linalg.norm(corners[:, None] - belief.goals_m, axis=2).min(axis=0)
    assert nearest.max() < 1e-9 and len(belief.goals_m) < len(mission.ids)


def test_unit_with_one_robot_in_view_has_no_picture() -> None:
    _, found = beliefs("units.*.position_m=[500.0,0.0]", until_s=0.5)
    assert all(belief is None for _, belief in found)


def test_chosen_unit_is_shown_until_nobody_is_chosen(open_page) -> None:
    with open_page(speed=1.0) as page:
        node = page._scene._lines["belief"]._node
        wait_until(lambda: page._step is not None)
        assert not node.visible
        for value, shows in (("unit 1", True), ("nobody", False)):
            moved(page._panel._belief._node, value)
            wait_until(lambda shows=shows: node.visible is shows)


@pytest.mark.parametrize("unit", [0, 2])
def test_killed_unit_knows_nothing(open_page, unit) -> None:
    from skyherd.play.session import Change

    with open_page(speed=1.0) as page:
        node = page._scene._lines["belief"]._node
        moved(page._panel._belief._node, f"unit {unit}")
        wait_until(lambda: node.visible)
        page.session.ask(Change(({"kind": "kill", "unit": unit},)))
        wait_until(lambda: not node.visible)
