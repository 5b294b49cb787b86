"""Sentence on the outcome of a run: it names the cause that the test has planted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from skyherd.analysis.history import History, make_history
from skyherd.analysis.verdict import _changed, _falling, explain_outcome, reached_s
from skyherd.datasets import load_mission, make_mission
from skyherd.loop import run_steps
from skyherd.sim.perception import make_run_perception
from skyherd.vision import create_detector

HOVER = "units.*.flight={kind='hover'}"
FREEZE = "{ kind = 'freeze', start_s = 1.0, end_s = 9.0 }"


def history_of(scenario: str, *settings: str, perception: str = "ideal", **changes: object) -> History:
    mission = load_mission(scenario, [f"perception={perception}", *settings])
    return make_history(mission, run_steps(mission, **changes))


CAUSES = {
    "camera too low": (
        "triangle",
        ["duration_s=2", "units.0.height_m=3", HOVER],
        "unit 0 is too low at 3 m; about",
    ),
    "too few units": (
        "triangle",
        ["duration_s=2", "units.0.height_m=6", "autopilot.max_height_m=6", HOVER],
        "too few units, since autopilot.max_height_m = 6 is too low",
    ),
    "too few units for the markers": (
        "triangle",
        ["duration_s=2", "units.0.height_m=4", "marker.side_m=0.15", HOVER],
        "too few units, since from",
    ),
    "duration too short": ("triangle", ["duration_s=6"], "the run is too short"),
    "no overlap": (
        "star",
        ["duration_s=2", HOVER, "selection.radius=1.4", "units.1.position_m=[-300, 0]"],
        "unit 1 and unit 0 share no pair of robots: fewer than two robots are in view of both",
    ),
    "frozen camera": (
        "triangle",
        ["duration_s=6", f"units.0.camera.faults=[{FREEZE}]"],
        "the images of units 0 contradicted the robots' commands",
    ),
    "speed limit": (
        "triangle",
        ["duration_s=10", "robots.max_speed_mps=0.02"],
        "the wheels are at their speed limit of 0.02 m/s (max_speed_mps)",
    ),
    "turn limit": (
        "triangle",
        ["duration_s=4", "robots.max_turn_radps=0.001"],
        "the wheels are at their turn limit of 0.001 rad/s",
    ),
    "robots outside the radius": (
        "triangle",
        ["duration_s=2", "units.0.height_m=16", "selection.radius=0.2", HOVER],
        "in view, but outside the safety radius of 0.2 (selection.radius)",
    ),
    "radio cut": (
        "tree",
        ["duration_s=2", "network.range_m=3"],
        "the radio reaches 3 m (network.range_m), which cuts the units into groups without contact: 0 |",
    ),
    "nothing in view": (
        "triangle",
        ["duration_s=2", "units.0.position_m=[500, 500]", HOVER],
        "no robot was ever in view of a unit",
    ),
    "goals too rare": (
        "triangle",
        ["duration_s=6", "units.0.frame_rate_hz=0.25"],
        "robots had no fresh goal in",
    ),
    "threshold of the wheels": (
        "triangle",
        ["duration_s=25", "control.b_th=4", "goal.shape_error=0.0001"],
        "the robots stopped within 4 marker sides of their goals (control.b_th)",
    ),
}
"""Scenario, settings, and words of the verdict, by cause."""


@pytest.mark.parametrize("case", CAUSES)
def test_verdict_names_cause(case: str) -> None:
    scenario, settings, words = CAUSES[case]
    assert words in explain_outcome(history_of(scenario, *settings))


@pytest.mark.parametrize(("ceiling_m", "given"), [(4.2, True), (9.0, False)])
def test_verdict_names_views_that_do_not_cover_shape(ceiling_m, given) -> None:
    """One unit below a low ceiling patrols a crowd; below a high one it sees all robots."""
    unit = f"position_m = [0, 0], height_m = {ceiling_m}, camera = {{ half_angle_deg = 35 }}"
    settings = [
        f"units=[{{ {unit}, frame_rate_hz = 2.5, flight = {{ kind = 'keep-in-view' }} }}]",
        *(f"autopilot.max_height_m={ceiling_m}", "step_s=0.2", "duration_s=30", "goal.shape_error=1e-9"),
    ]
    said = explain_outcome(history_of("crowd", *settings))
    assert ("robots are outside the views of their units" in said) == given


def test_verdict_names_a_run_that_is_too_short() -> None:
    """The error of three steps says nothing of its trend."""
    said = explain_outcome(history_of("triangle", "duration_s=0.2"))
    assert "the run lasts 0.2 s, and the shape must be held for" in said


def test_verdict_names_markers_that_cover_each_other() -> None:
    """With a quarter of the images; the robots stand after 30 s."""
    settings = ["duration_s=40", "step_s=0.2", "units.*.frame_rate_hz=2.5", "size.spacing_sides=0.1"]
    said = explain_outcome(history_of("table", *settings, perception="rendered"))
    assert "apart with markers 0.08 m wide, which cover each other; enlarge the shape (size)" in said


def test_verdict_names_small_markers() -> None:
    settings = ["duration_s=0.2", "units.0.height_m=40", "marker.side_m=0.2", HOVER]
    said = explain_outcome(history_of("triangle", *settings, perception="rendered"))
    assert "the markers are too small: 2 px wide" in said


@pytest.mark.parametrize(("height_m", "given"), [(95, True), (17, False)])
def test_verdict_names_a_unit_that_is_too_high_to_see_markers(height_m, given) -> None:
    """The other units detect enough markers; the unit has 16 robots of 3.7 px inside its safety radius."""
    settings = ["duration_s=1", f"units.2.height_m={height_m}", HOVER]
    said = explain_outcome(history_of("star", *settings, perception="rendered"))
    assert ("unit 2 flies too high to control a robot: markers 3.7 px wide are too small" in said) == given
    assert ("fly at 29.6 m or lower, zoom in, or enlarge marker.side_m (12 px are needed)" in said) == given


def test_exact_detections_of_small_markers_are_no_cause() -> None:
    said = explain_outcome(history_of("star", "duration_s=1", "units.2.height_m=95", HOVER))
    assert "too high" not in said


def rendered_by(dictionary: str, shift: int = 0) -> str:
    """Return the verdict on a run whose detector reads another dictionary, or whose ids are shifted."""
    mission = load_mission("triangle", ["duration_s=0.2"])
    perception = make_run_perception(mission)
    detector = create_detector("tracking", dictionary=dictionary)
    perception.detector = detector
    if shift:
        detect = detector.detect
        perception.detector = SimpleNamespace(detect=lambda *a, **k: shifted(detect(*a, **k), shift))
    return explain_outcome(make_history(mission, run_steps(mission, perception)))


def shifted(seen, shift: int):
    object.__setattr__(seen, "ids", seen.ids + shift)
    return seen


def test_verdict_names_wrong_dictionary() -> None:
    said = rendered_by("6X6_50")
    assert "0 % of the markers in view were detected, though they are" in said
    assert "their dictionary may not be 4X4_50 (marker.dictionary)" in said


def test_verdict_names_wrong_ids() -> None:
    assert "the markers in view have ids 20, 21, 22, 23, 24, 25, which no robot has" in rendered_by(
        "4X4_50", 20
    )


def test_verdict_names_pairs_outside_the_radius(scenario_tree) -> None:
    """Each unit holds two of four robots, within 0.2 of its radius, and sees all of them."""
    tree = scenario_tree("triangle")
    unit = tree["units"][0] | {"height_m": 10.0, "flight": {"kind": "hover"}}
    places_m = [[-3.0, 0.0], [-1.0, 0.5], [1.0, 0.0], [3.0, 0.5]]
    tree |= {
        "perception": "ideal",
        "duration_s": 1.0,
        "template": {"shape": "line"},
        "robots": {"positions_m": places_m},
        "selection": {"radius": 0.2},
        "units": [unit | {"position_m": [-2.0, 0.25]}, unit | {"position_m": [2.0, 0.25]}],
    }
    mission = make_mission(tree)
    said = explain_outcome(make_history(mission, run_steps(mission)))
    assert "4 robots are in view of both, but the safety radius of 0.2 cuts them (selection.radius)" in said


def test_verdict_names_time_since_which_robots_are_lost() -> None:
    """Unit 2 dies at 1 s; the step at 1 s is the first without it."""
    said = explain_outcome(history_of("star", "duration_s=3", HOVER, "units.2.outages=[[1, 100]]"))
    assert "no unit controls robot 15 since 1 s (TC2)" in said


def test_verdict_names_robots_that_left_the_images() -> None:
    said = explain_outcome(
        history_of("triangle", "duration_s=6", HOVER, "units.0.zoom=[[0, 1], [1, 1], [3, 3]]")
    )
    assert "robots 0, 1, 5 left the images: unit 0 is too low at 10.7 m" in said


@pytest.fixture(scope="module")
def formed() -> History:
    return history_of("triangle", "goal.shape_error=0.2", "control.k=0.8", "duration_s=12")


def test_verdict_on_reached_shape_names_time_and_error(formed: History) -> None:
    assert explain_outcome(formed).startswith(f"Shape reached after {reached_s(formed):.3g} s and held")


def test_verdict_on_incomplete_run_names_its_end(formed: History) -> None:
    assert explain_outcome(formed, complete=False) == (
        "Cut short after 12 of 12 s; until then, the shape was formed and held."
    )


def test_shape_reached_too_late_counts_as_not_held(formed: History) -> None:
    goal = formed.mission.scenario.goal.model_copy(update={"hold_s": 1000.0})
    scenario = formed.mission.scenario.model_copy(update={"goal": goal})
    late = replace(formed, mission=replace(formed.mission, scenario=scenario))
    assert "but not for the last 1000 s" in explain_outcome(late)


def decay(shape_error, *, changes_s=()) -> SimpleNamespace:
    """Return a run of 10 s with the given shape errors (101,), whose shape changes at the given times."""
    return SimpleNamespace(
        times_s=np.linspace(0, 10, 101),
        shape_error=shape_error,
        mission=SimpleNamespace(
            scenario=SimpleNamespace(goal=SimpleNamespace(shape_error=0.01, hold_s=2.0)),
            later=[(at_s, None) for at_s in changes_s],
        ),
    )


@pytest.mark.parametrize(("rate_ps", "seconds"), [(0.1, 31), (0.2, 12)])
def test_time_needed_follows_an_exponential_decay(rate_ps, seconds) -> None:
    """`log(0.5 exp(-10 r) / 0.01) / r` and the 2 s for which the shape must be held: 31 s and 12 s."""
    history = decay(0.5 * np.exp(-rate_ps * np.linspace(0, 10, 101)))
    assert f"falls by {100 * rate_ps:.1f} % a second; about {seconds} s more are needed" in _falling(history)


@pytest.mark.parametrize("changes_s", [(9.0,), (2.0, 9.0), (9.0, 10.5)])
def test_decay_is_judged_from_the_last_change_of_shape(changes_s) -> None:
    """The error jumps from 0.02 to 0.5 at the change, and falls by 20 % a second before and after it."""
    times_s = np.linspace(0, 10, 101)
    errors = np.where(times_s > 8.95, 0.5 * np.exp(-0.2 * (times_s - 9)), 0.02 * np.exp(-0.2 * times_s))
    assert "still falls by 20.0 % a second" in _falling(decay(errors, changes_s=changes_s))


@pytest.mark.parametrize(("changed_s", "said"), [(10.0, "0 s"), (9.9, "0.1 s"), (8.5, "1.5 s"), (7.9, None)])
def test_change_of_shape_near_the_end_is_named(changed_s, said) -> None:
    """The last 2 of 10 s are judged."""
    history = decay(np.full(101, 0.5), changes_s=[changed_s])
    expected = said and f"the run is too short, since the shape changed {said} before the end"
    assert _falling(history) is None and _changed(history) == expected


@pytest.mark.parametrize(("duration_s", "left_s"), [(1.0, 0), (1.2, 0.2)])
@pytest.mark.parametrize("limit", ["robots.max_speed_mps=0.5", "robots.max_speed_mps=0.02"])
def test_verdict_after_a_late_change_of_shape(duration_s, left_s, limit) -> None:
    line = "template.then=[{ at_s = 1.0, shape = 'line' }]"
    said = explain_outcome(history_of("triangle", line, limit, f"duration_s={duration_s}"))
    assert (
        "speed limit" if left_s and "0.02" in limit else f"shape changed {left_s} s before the end"
    ) in said
