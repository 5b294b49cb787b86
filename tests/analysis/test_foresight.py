"""Warnings of `skyherd scenario check`: each names the cause that the test plants, and no other."""

import pytest

from skyherd.analysis.foresight import foresee
from skyherd.analysis.history import make_history
from skyherd.analysis.verdict import held_to_the_end
from skyherd.datasets import load_mission, scenario_names
from skyherd.loop import run_steps


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["units.0.height_m=4"], "robots 0, 1, 5 in no view at the start"),
        (["marker.side_m=0.2"], "unit 0 sees markers 8.3 px wide"),
        (["duration_s=20"], "duration_s = 20 is below the predicted"),
        (["size.spacing_sides=0.5"], "size.spacing_sides = 0.5 puts markers on top of each other"),
    ],
)
def test_planted_problem_is_the_only_warning(settings: list[str], words: str) -> None:
    (said,) = foresee(load_mission("triangle", settings))
    assert words in said


@pytest.mark.parametrize("name", ["triangle", "star", "handheld", "crowd"])
def test_built_in_scenario_has_no_warning(name: str) -> None:
    assert foresee(load_mission(name)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", scenario_names())
def test_every_built_in_scenario_has_no_warning(name: str) -> None:
    assert foresee(load_mission(name)) == []


def test_run_of_the_predicted_duration_is_close_to_its_goal() -> None:
    """With straight driving (fast turns) and no speed limit, the linear model gives the time to the goal."""
    settings = ["perception=ideal", "control.k_omega=10", "robots.max_turn_radps=100"]
    (said,) = foresee(load_mission("triangle", ["duration_s=5", *settings]))
    predicted_s = float(said.split("predicted ")[1].split(" s")[0])
    for factor, held in ((1.2, True), (0.8, False)):
        mission = load_mission("triangle", [f"duration_s={factor * predicted_s}", *settings])
        assert held_to_the_end(make_history(mission, run_steps(mission))) == held
