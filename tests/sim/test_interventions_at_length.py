"""Missions that are disturbed while they run, from start to finish."""

from typing import Any

import numpy as np
import pytest

from skyherd.datasets import Mission, load_mission, make_mission
from skyherd.loop import Step, run_steps

pytestmark = pytest.mark.slow

BEGUN_S = 30.0
"""Time of the first change. Chosen: the shape has formed to 0.5 %."""


def with_interventions(mission: Mission, tables: list[dict[str, Any]]) -> Mission:
    return make_mission(mission.scenario.model_dump(mode="json") | {"interventions": tables})


def error_at(steps: list[Step], time_s: float) -> float:
    return next(step.metrics.shape.error for step in steps if step.time_s >= time_s - 1e-6)


def test_star_keeps_its_shape_while_two_cameras_change() -> None:
    """One camera zooms through 1 to 1.5 to 0.8 and back in 5 s, while another tilts to 20 degrees.

    10 s after the last change, the error is at most 0.005 above that of the untouched run.
    """
    mission = load_mission("star", ["duration_s=60"])
    zooms = np.interp(np.arange(1, 51), [0, 20, 45, 50], [1.0, 1.5, 0.8, 1.0])
    changes = [
        {"at_s": BEGUN_S + k / 10, "kind": "camera", "unit": 0, "zoom": float(zoom)}
        for k, zoom in enumerate(zooms, 1)
    ]
    changes += [
        {"at_s": BEGUN_S + k / 10, "kind": "unit", "unit": 1, "tilt_deg": [0.4 * k, 0.0]}
        for k in range(1, 51)
    ]
    plain, changed = list(run_steps(mission)), list(run_steps(with_interventions(mission, changes)))
    assert plain[300].fleet.zooms[0] == 1.0 and np.ptp([s.fleet.zooms[0] for s in changed]) > 0.69
    assert np.degrees(changed[-1].fleet.tilts_rad[1, 0]) == pytest.approx(20.0)
    after_s = BEGUN_S + 5.0 + 10.0
    assert error_at(changed, after_s) <= error_at(plain, after_s) + 0.005
    assert changed[-1].metrics.shape.error < mission.scenario.goal.shape_error


@pytest.mark.parametrize("perception", ["rendered", "noisy"])
def test_disturbed_mission_reaches_its_shape(perception: str) -> None:
    """After each disturbance but the last ones the error falls again; at the end it is that of `star`."""
    mission = load_mission("disturbed", [f"perception={perception}"])
    steps = list(run_steps(mission))
    assert [one for step in steps for one in step.interventions] == mission.scenario.interventions_in_order
    assert error_at(steps, 35.0) > 0.1 > 0.03 > error_at(steps, 50.0)
    assert max(step.metrics.shape.error for step in steps[-50:]) < mission.scenario.goal.shape_error


def test_killed_unit_is_taken_over_and_joins_again() -> None:
    """The mission `failure` with interventions instead of outages, on exact points."""
    outage = load_mission("failure", ["perception=ideal", "duration_s=80", "control.rectify=false"])
    tree = outage.scenario.model_dump(mode="json")
    ((dies_s, returns_s),) = tree["units"][0].pop("outages")
    tree["interventions"] = [
        {"at_s": dies_s, "kind": "kill", "unit": 0},
        {"at_s": returns_s, "kind": "revive", "unit": 0},
    ]
    steps = list(run_steps(make_mission(tree)))
    at = {round(step.time_s, 6): step for step in steps}
    before, orphaned, taken, back = (at[t] for t in (24.8, 25.0, 64.8, 80.0))
    assert before.control_sets[0].size and not orphaned.control_sets[0].size
    held = np.unique(np.concatenate([ids for unit, ids in taken.control_sets.items() if unit]))
    assert held.size == outage.ids.size and taken.metrics.conditions.in_p
    assert back.control_sets[0].size >= 2 and back.metrics.conditions.in_p
    assert back.metrics.shape.error < 0.01
